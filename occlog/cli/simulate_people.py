"""`occlog simulate --scene people`: options to the configuration of a rendered room."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ..errors import UsageError
from ..stages.people_room import CLEARANCE, people_room
from .simulate_run import make_setup
from .simulate_video import Setup


def people_setup(given: Mapping[str, Any], fps: float | None, workers: int | None) -> Setup:
    """The configuration from the options that were given.

    Args:
        given: values of the options that were given.
        fps: frames a second; None: 25.
        workers: threads; None: one a processor.
    """
    views, size, rate = given.get("views", 3), given.get("size", (640, 480)), fps or 25.0
    if min(size) < 64:
        raise UsageError(f"--size: people need images of 64 px or more a side, got {size[0]}x{size[1]}")
    own = {"frames", "views", "size", "people", "grey", "overlap"}
    values = {
        "render": True,
        "targets": given.get("people", 4),
        "steps": given.get("frames", 400),
        "rate_hz": rate,
        "clearance": CLEARANCE,
        **{k: v for k, v in given.items() if k not in own},
    }
    setup = make_setup(people_room(views, size, rate), values, None, workers)
    assert setup.render is not None  # it was asked for
    video = replace(setup.render, alike=True, min_visible=0.0)
    return replace(setup, render=video, grey=bool(given.get("grey")), apart=not given.get("overlap"))
