"""Options of `occlog simulate` together with what a path file says."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ..errors import InputError, UsageError
from ..scene import Scene
from ..script import Script
from ..stages.simulate import WorldConfig, world_config

WALKERS_ONLY = ("targets", "occluders", "speed", "sigma", "redirect", "clearance")
"""Options that mean nothing with --paths."""


def scripted_world(scene: Scene, given: Mapping[str, Any], script: Script) -> WorldConfig:
    """Number and times of the steps, and sizes; options go before the file, and that before the defaults.

    Args:
        scene: its unit decides on the defaults and must be that of the file.
        given: values of the options that were given.
        script: what the file says.

    Returns:
        The configuration; UsageError or InputError for what does not go together.
    """
    for name in WALKERS_ONLY:
        if name in given:
            raise UsageError(f"--{name} is about random walkers; leave it out with --paths")
    if script.length_unit not in (None, scene.length_unit):
        raise InputError(f"--paths: its length unit is {script.length_unit}, the scene's {scene.length_unit}; make one")
    if "seconds" in given and "steps" in given:
        raise UsageError("--seconds and --steps both say how long the recording is; give one")
    roles = [t.role for t in script.targets]
    world = replace(
        world_config(scene.length_unit),
        targets=roles.count("target"),
        occluders=roles.count("occluder"),
        z=given.get("z", math.nan),
    )
    if "diameter" in given:
        world = replace(world, diameter=given["diameter"])
    rate_hz = given.get("rate_hz", script.rate_hz)
    if rate_hz is not None:
        world = replace(world, step_s=1.0 / rate_hz)
    seconds = given.get("seconds", script.seconds)
    if "steps" in given:
        return replace(world, steps=given["steps"])
    return world if seconds is None else replace(world, steps=round(seconds / world.step_s) + 1)
