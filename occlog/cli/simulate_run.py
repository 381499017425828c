"""Work of `occlog simulate`: options to configurations, and a scene to a recording, chunk by chunk."""

from __future__ import annotations

import itertools
import json
import os
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from ..errors import UsageError
from ..io.image_codec import encode_image
from ..io.provenance import Provenance, hash_inputs
from ..io.recording_writer import RecordingWriter
from ..records import Truth
from ..scene import Scene
from ..stages.simulate import (
    ObserveConfig,
    WorldConfig,
    observe,
    observe_arrays,
    simulate_truth,
    world_config,
)
from ..vision.render import RenderConfig, Rendered, render
from ..vision.render_reference import reference_appearances
from . import options

APPEARANCE = "appearance.json"
RENDER_ONLY = ("image_noise", "colour_noise", "texture", "light_drift", "light_period", "shadows", "lookalike")


@dataclass(frozen=True)
class Setup:
    """Everything that decides on the recording, but for the seed."""

    scene: Scene
    world: WorldConfig
    observe: ObserveConfig | None  # None: no simulated bearings
    render: RenderConfig | None  # None: no video


def make_setup(scene: Scene, values: Mapping[str, Any], fps: float | None, workers: int | None) -> Setup:
    """Configurations from the values of the options; None stands for an option that was not given."""
    given = {k: v for k, v in values.items() if v is not None}
    if fps is not None:
        scene = replace(scene, cameras=tuple(replace(c, rate_hz=fps) for c in scene.cameras))
    rendering = bool(given.get("render"))
    if not rendering:
        for name in RENDER_ONLY:
            if name in given:
                raise UsageError(f"--{name.replace('_', '-')} is about video; add --render")
    world = _world(scene, given, rendering)
    observing = bool(given.get("bearings", not rendering))
    watch = replace(ObserveConfig(diameter=world.diameter), **_of(ObserveConfig, given)) if observing else None
    return Setup(scene, world, watch, _render(world, given, workers) if rendering else None)


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
    values = {names.get(n, n): given[n] for n in RENDER_ONLY if n in given}
    return RenderConfig(diameter=world.diameter, workers=workers or os.cpu_count() or 1, **values)


def run_simulate(
    source: Path, setup: Setup, output: Path, seed: int, *, overwrite: bool = False, quiet: bool = False
) -> dict[str, Any]:
    """Write the recording; what it holds."""
    made = Provenance("simulate", _parameters(setup), seed, hash_inputs([source]))
    counts: Counter[str] = Counter()
    with RecordingWriter(output, setup.scene, made, overwrite=overwrite) as writer:
        if setup.render is not None:
            looks = reference_appearances(setup.scene, range(setup.world.targets), setup.render, seed)
            writer.attach(APPEARANCE, "application/json", json.dumps(looks).encode())
        chunks = _recorded(writer, setup, seed, counts)
        if setup.render is None:
            deque(options.progress(chunks, "simulate", quiet=quiet), maxlen=0)
        else:
            _film(writer, setup, chunks, seed, counts, quiet)
    return _summary(setup, output, seed, counts)


def _parameters(setup: Setup) -> dict[str, Any]:
    """Every value that changes the result; NaN as null."""
    parts = {"world": setup.world, "observe": setup.observe, "render": setup.render}
    values: dict[str, Any] = {}
    for name, part in parts.items():
        values[name] = None if part is None else {k: None if v != v else v for k, v in asdict(part).items()}
    if values["render"] is not None:
        del values["render"]["workers"]
    values["rates_hz"] = {c.name: c.rate_hz for c in setup.scene.cameras}
    return values


def _recorded(writer: RecordingWriter, setup: Setup, seed: int, counts: Counter[str]) -> Iterator[Truth]:
    """The chunks of truth, each written, with what the sensors say of it, when it is passed on."""
    truth, seen, heard = itertools.tee(simulate_truth(setup.scene, setup.world, seed), 3)
    bearings = observe(setup.scene, seen, setup.observe or ObserveConfig(), seed)
    sounds = observe_arrays(setup.scene, heard, setup.observe or ObserveConfig(), seed)
    for chunk in truth:
        writer.table(chunk)
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


def _film(
    writer: RecordingWriter, setup: Setup, chunks: Iterable[Truth], seed: int, counts: Counter[str], quiet: bool
) -> None:
    """Render, compress and write the frames of all cameras."""
    assert setup.render is not None
    frames = render(setup.scene, chunks, setup.render, seed)
    total = _frames_in_all(setup)
    for frame, data in _compressed(options.progress(frames, "render", total, quiet=quiet), setup.render.workers):
        writer.image(frame.sensor, frame.t_ns, frame.index, data, "png")
        writer.table(frame.boxes)
        counts.update(frames=1, image_bytes=len(data), boxes=int((frame.boxes.box >= 0).sum()))


def _frames_in_all(setup: Setup) -> int:
    length_s = (setup.world.steps - 1) * setup.world.step_s
    rates = [c.rate_hz or 1.0 / setup.world.step_s for c in setup.scene.cameras if c.placed]
    return sum(int(length_s * rate + 1e-9) + 1 for rate in rates)


def _compressed(frames: Iterable[Rendered], workers: int) -> Iterator[tuple[Rendered, bytes]]:
    """Frames with their PNG bytes, in order; some are compressed while the next ones are drawn."""
    waiting: deque[tuple[Rendered, Future[bytes]]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        for frame in frames:
            waiting.append((frame, pool.submit(encode_image, frame.image, "png", 0)))
            if len(waiting) > 2 * workers:
                done, data = waiting.popleft()
                yield done, data.result()
        for done, data in waiting:
            yield done, data.result()


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
        summary |= {n: counts[n] for n in ("frames", "boxes", "image_bytes")}
    return summary
