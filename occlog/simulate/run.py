"""What `occlog simulate` does: options to configurations, and a scene to a recording, chunk by chunk."""

from __future__ import annotations

import itertools
import json
import math
import os
from collections import Counter, deque
from collections.abc import Iterator, Mapping
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

from occlog.cli import options
from occlog.core.numerics.time_grid import Grid
from occlog.errors import InputError, UsageError
from occlog.io.files.atomic import Together
from occlog.io.files.provenance import Provenance, hash_inputs
from occlog.io.recording.writer import RecordingWriter
from occlog.records.scene import Scene
from occlog.records.scripts import Script
from occlog.records.tables import Truth
from occlog.simulate.render.people import RenderConfig
from occlog.simulate.render.reference import reference_appearances
from occlog.simulate.world.people_room import CLEARANCE, people_apart, people_room
from occlog.simulate.world.truth_grid import truth_grid

from .stage import (
    ObserveConfig,
    SoundConfig,
    WorldConfig,
    check_inside,
    grid_truth,
    observe,
    observe_arrays,
    silences,
    simulate_paths,
    simulate_truth,
    world_config,
)
from .video import RENDER_ONLY, Setup, film

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


ARRAYS_ONLY = ("silence", "false_doa", "label_doa")


def sound_config(scene: Scene, given: Mapping[str, Any], step_s: float, heights: bool) -> SoundConfig:
    """Configuration from the options that were given; UsageError where they do not fit.

    Args:
        scene: must have arrays if any of the options is given.
        given: their values.
        step_s: time between two steps [s].
        heights: whether targets have known heights.
    """
    for name in ARRAYS_ONLY:
        if name in given and not scene.arrays:
            raise UsageError(f"--{name.replace('_', '-')} is about microphone arrays, but the scene has none")
    silence = _means(given["silence"]) if "silence" in given else None
    label = bool(given.get("label_doa"))
    return SoundConfig(silence, float(given.get("false_doa", 0.0)), label, step_s, heights)


def _means(text: str) -> tuple[float, float]:
    try:
        sounding, silent = (float(part) for part in text.split(","))
    except ValueError:
        raise UsageError(f"--silence: want SOUND_S,SILENT_S, two numbers of seconds, got {text!r}") from None
    if not all(math.isfinite(mean) and mean > 0 for mean in (sounding, silent)):
        raise UsageError(f"--silence: both mean times must be above 0 s, got {text!r}")
    return sounding, silent


APPEARANCE = "appearance.json"


def make_setup(
    scene: Scene, values: Mapping[str, Any], fps: float | None, workers: int | None, script: Script | None = None
) -> Setup:
    """Configurations from the values of the options; None stands for an option that was not given."""
    given = {k: v for k, v in values.items() if v is not None}
    if fps is not None:
        scene = replace(scene, cameras=tuple(replace(c, rate_hz=fps) for c in scene.cameras))
    rendering = bool(given.get("render"))
    if not rendering:
        for name in RENDER_ONLY:
            if name in given:
                raise UsageError(f"--{name.replace('_', '-')} is about video; add --render")
    world = _world(scene, given, rendering) if script is None else scripted_world(scene, given, script)
    observing = bool(given.get("bearings", not rendering))
    watch = replace(ObserveConfig(diameter=world.diameter), **_of(ObserveConfig, given)) if observing else None
    video = _render(world, given, workers) if rendering else None
    heights = world.z == world.z or (script is not None and script.heights)
    sound = sound_config(scene, given, world.step_s, heights)
    return Setup(scene, world, watch, video, given.get("store", "png"), sound, script)


def _of(kind: type[Any], given: Mapping[str, Any]) -> dict[str, Any]:
    return {f.name: given[f.name] for f in fields(kind) if f.name in given}


def _world(scene: Scene, given: Mapping[str, Any], rendering: bool) -> WorldConfig:
    world = replace(world_config(scene.length_unit), **_of(WorldConfig, given))
    if "rate_hz" in given:
        world = replace(world, step_s=1.0 / given["rate_hz"])
    if "seconds" in given:
        if "steps" in given:
            raise UsageError("--seconds and --steps both say how long the recording is; give one")
        world = replace(world, steps=round(given["seconds"] / world.step_s) + 1)
    if rendering and "clearance" not in given:
        world = replace(world, clearance=max(world.clearance, 0.5 * world.diameter))
    return world


def _render(world: WorldConfig, given: Mapping[str, Any], workers: int | None) -> RenderConfig:
    names = {"image_noise": "noise", "light_period": "light_period_s"}
    values = {names.get(n, n): given[n] for n in RENDER_ONLY if n in given and n != "store"}
    return RenderConfig(diameter=world.diameter, workers=workers or os.cpu_count() or 1, **values)


def run_simulate(
    inputs: list[Path], setup: Setup, output: Path, seed: int, *, overwrite: bool = False, quiet: bool = False
) -> dict[str, Any]:
    """Write the recording; what it holds."""
    made = Provenance("simulate", _parameters(setup), seed, hash_inputs(inputs))
    if setup.apart:
        setup = replace(setup, start=people_apart(setup.scene, setup.world.targets, seed))
    if setup.render is not None and setup.script is not None:
        for chunk in _truth(setup, seed):
            check_inside(setup.scene, truth_grid(chunk), setup.world.start_ns)
    counts: Counter[str] = Counter()
    with (
        Together() as together,
        RecordingWriter(output, setup.scene, made, overwrite=overwrite, together=together) as writer,
    ):
        if setup.render is not None:
            looks = reference_appearances(setup.scene, _targets(setup), setup.render, seed)
            writer.attach(APPEARANCE, "application/json", json.dumps(looks).encode())
        chunks = _recorded(writer, setup, seed, counts)
        if setup.render is None:
            deque(options.progress(chunks, "simulate", quiet=quiet), maxlen=0)
        else:
            film(writer, setup, output, chunks, seed, counts, overwrite=overwrite, quiet=quiet)
    return _summary(setup, output, seed, counts)


def _parameters(setup: Setup) -> dict[str, Any]:
    """Every value that changes the result; NaN as null."""
    parts = {"world": setup.world, "observe": setup.observe, "render": setup.render}
    values: dict[str, Any] = {}
    for name, part in parts.items():
        values[name] = None if part is None else {k: None if v != v else v for k, v in asdict(part).items()}
    if values["render"] is not None:
        del values["render"]["workers"]
        values["store"] = setup.store
        values |= {"grey": setup.grey, "start_apart": setup.apart}
    if setup.sound != SoundConfig(step_s=setup.sound.step_s, heights=setup.sound.heights):
        values["sound"] = asdict(setup.sound)
    if setup.script is not None:
        values["world"] = {k: values["world"][k] for k in ("steps", "step_s", "diameter", "z", "start_ns")}
    values["rates_hz"] = {c.name: c.rate_hz for c in setup.scene.cameras}
    return values


def _targets(setup: Setup) -> list[int]:
    """Numbers of the targets, rising."""
    if setup.script is None:
        return list(range(setup.world.targets))
    return [t.id for t in setup.script.targets if t.role == "target"]


def _truth(setup: Setup, seed: int) -> Iterator[Truth | Grid]:
    world, script = setup.world, setup.script
    if script is None:
        return simulate_truth(setup.scene, world, seed, setup.start)
    return simulate_paths(script, world.steps, world.step_s, world.z, world.start_ns, seed)


def _recorded(writer: RecordingWriter, setup: Setup, seed: int, counts: Counter[str]) -> Iterator[Truth | Grid]:
    """The chunks of truth, each written, with what the sensors say of it, when it is passed on."""
    truth, seen, heard = itertools.tee(_truth(setup, seed), 3)
    bearings = observe(setup.scene, seen, setup.observe or ObserveConfig(), seed)
    silent = silences(setup.script, setup.world.start_ns) if setup.script is not None else {}
    sounds = observe_arrays(setup.scene, heard, setup.observe or ObserveConfig(), seed, setup.sound, silent)
    for chunk in truth:
        writer.table(grid_truth(chunk) if isinstance(chunk, Grid) else chunk)
        if setup.observe is not None:
            rows = next(bearings)
            writer.table(rows)
            counts.update(bearings=len(rows), seen=int(rows.seen.sum()))
        else:
            next(seen)
        if setup.scene.arrays:
            sound = next(sounds)
            writer.table(sound)
            counts["doa"] += len(sound)
        else:
            next(heard)
        yield chunk


def _summary(setup: Setup, output: Path, seed: int, counts: Counter[str]) -> dict[str, Any]:
    world = setup.world
    summary: dict[str, Any] = {
        "recording": str(output),
        "seed": seed,
        "steps": world.steps,
        "seconds": (world.steps - 1) * world.step_s,
        "targets": world.targets,
        "occluders": world.occluders,
        "cameras": len(setup.scene.cameras),
    }
    if setup.observe is not None:
        summary |= {"bearings": counts["bearings"], "seen": counts["seen"]}
    if setup.scene.arrays:
        summary["doa"] = counts["doa"]
    if setup.render is not None:
        summary |= {n: counts[n] for n in ("frames", "boxes", "video_bytes")}
    return summary


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
