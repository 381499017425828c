"""Path files (YAML): scripted targets for `occlog simulate --paths`.

`schemas/paths.json` is made from the declared keys, their types, limits and meanings.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from occlog.errors import InputError
from occlog.io.files.texts.yaml import parse_yaml, read_yaml
from occlog.records.scene import MotionScript, ScriptedTarget, Segment, Triple

from .scene import SceneFileSpec

LIMIT = 1e9
Number = Annotated[float, Meta(ge=-LIMIT, le=LIMIT)]
Time = Annotated[float, Meta(ge=0, le=LIMIT)]
Vector = Annotated[list[Number], Meta(min_length=2, max_length=3)]
Interval = tuple[Time, Time]


class SegmentSpec(SceneFileSpec, kw_only=True):
    """Section of a path; with constant velocity unless `lateral` or `acceleration` is given."""

    from_s: (
        Annotated[Time, Meta(description="default: the end of the segment before, or the target's start")] | None
    ) = None
    until_s: Annotated[Time, Meta(description="default: the start of the next segment, or the end")] | None = None
    lateral: (
        Annotated[
            Number,
            Meta(
                description="acceleration that turns the velocity; positive: from the plane's first axis to the second"
            ),
        ]
        | None
    ) = None
    plane: Annotated[Literal["xy", "yz", "zx"], Meta(description="of the turn; default xy")] | None = None
    acceleration: Vector | None = None
    velocity: Annotated[Vector, Meta(description="taken on at the start of the segment")] | None = None


class TargetSpec(SceneFileSpec, kw_only=True):
    """A scripted target and its path."""

    id: Annotated[int, Meta(ge=0, le=2**31 - 1)]
    role: Literal["target", "occluder"] = "target"
    position: Annotated[Vector, Meta(description="x, y and, where known, z at its start")]
    velocity: Vector | None = None
    from_s: Annotated[Time, Meta(description="when it comes")] = 0.0
    until_s: Annotated[Time, Meta(description="when it goes; default: it stays")] | None = None
    noise_density: Annotated[
        float, Meta(ge=0, le=LIMIT, description="variance of the velocity accumulated over 1 s, for each axis")
    ] = 0.0
    segments: tuple[SegmentSpec, ...] = ()
    silent: Annotated[tuple[Interval, ...], Meta(description="from, to: when it makes no sound")] = ()


class PathsSpec(SceneFileSpec, kw_only=True):
    """A file of scripted targets; times are seconds after the first step."""

    occlog_paths: Annotated[Literal[1], Meta(description="version of this format")]
    length_unit: (
        Annotated[Literal["m", "unit", "ft", "in", "px"], Meta(description="must be the scene's; default: the scene's")]
        | None
    ) = None
    seconds: Annotated[Time, Meta(description="length of the recording")] | None = None
    rate_hz: Annotated[float, Meta(gt=0, le=LIMIT, description="steps a second")] | None = None
    targets: Annotated[list[TargetSpec], Meta(min_length=1)]


def paths_schema() -> dict[str, object]:
    """JSON Schema of files with paths of scripted targets."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **msgspec.json.schema(PathsSpec)}


def read_paths(path: Path) -> MotionScript:
    """Read scripted targets from a YAML file.

    Raises:
        InputError: a key or value is invalid, identities repeat, or segments overlap; with its place in the file.
    """
    return _build(read_yaml(path, PathsSpec, "a path file (YAML)"), str(path))


def paths_from_yaml(text: str, source: str) -> MotionScript:
    """Parse scripted targets from YAML text; `source` is its file in messages.

    Raises:
        InputError: a key or value is invalid, identities repeat, or segments overlap.
    """
    return _build(parse_yaml(text, source, PathsSpec), source)


def _build(spec: PathsSpec, source: str) -> MotionScript:
    seen: set[int] = set()
    for t in spec.targets:
        if t.id in seen:
            raise InputError(
                f"{source}: two targets have the id {t.id}; ids must differ, occluders' too", id="duplicate-name"
            )
        seen.add(t.id)
    targets = [_target(t, f"{source}: target {t.id}") for t in spec.targets]
    return MotionScript(tuple(sorted(targets, key=lambda t: t.id)), spec.length_unit, spec.seconds, spec.rate_hz)


def _target(spec: TargetSpec, where: str) -> ScriptedTarget:
    flat = len(spec.position) == 2
    until_s = math.inf if spec.until_s is None else spec.until_s
    if until_s < spec.from_s:
        raise InputError(f"{where}: until_s is {until_s:g}, before from_s {spec.from_s:g}; correct one of them")
    for low, high in spec.silent:
        if not low < high:
            raise InputError(f"{where}: silent: [{low:g}, {high:g}] must go from an earlier time to a later one")
    return ScriptedTarget(
        id=spec.id,
        position=_triple(spec.position, math.nan),
        velocity=_vector(spec.velocity or [0.0, 0.0], flat, f"{where}: velocity"),
        role=spec.role,
        from_s=spec.from_s,
        until_s=until_s,
        noise_density=spec.noise_density,
        segments=_segments(spec, flat, where),
        silent=spec.silent,
    )


def _segments(spec: TargetSpec, flat: bool, where: str) -> tuple[Segment, ...]:
    """Segments of a scripted target, with times that the file omits filled in from their neighbours.

    Args:
        spec: the target in the file.
        flat: the target moves on the ground, without z.
        where: file and target, for messages.

    Raises:
        InputError: segments overlap, or values contradict each other.
    """
    done: list[Segment] = []
    for i, s in enumerate(spec.segments):
        location, before = f"{where}: segments[{i}]", done[-1].until_s if done else spec.from_s
        start = before if s.from_s is None else s.from_s
        if math.isinf(start):
            raise InputError(f"{location}: give from_s, or until_s of the segment before", id="missing-value")
        if math.isinf(before):
            before = done[-1].from_s
        if start < before:
            what = "the segment before ends" if i else "the target starts"
            raise InputError(
                f"{location}: starts at {start:g} s, but {what} at {before:g} s; correct from_s or until_s"
            )
        end = s.until_s
        if end is None:
            following = spec.segments[i + 1].from_s if i + 1 < len(spec.segments) else None
            end = math.inf if following is None else following
        if not end > start:
            raise InputError(f"{location}: ends at {end:g} s, must be after its start at {start:g} s")
        done.append(_segment(s, start, end, flat, location))
    return tuple(done)


def _segment(spec: SegmentSpec, start: float, end: float, flat: bool, where: str) -> Segment:
    if spec.lateral is not None and spec.acceleration is not None:
        raise InputError(
            f"{where}: both lateral and acceleration are given; keep one, or make two segments", id="conflicting-values"
        )
    if spec.plane is not None and spec.lateral is None:
        raise InputError(
            f"{where}: plane is only for a turn; give its acceleration across the path (lateral), or omit plane",
            id="missing-value",
        )
    if flat and spec.plane in ("yz", "zx"):
        raise InputError(
            f"{where}: a turn in the plane {spec.plane} needs a target with a height; give z in position",
            id="missing-value",
        )
    return Segment(
        from_s=start,
        until_s=end,
        lateral=spec.lateral or 0.0,
        plane=spec.plane or "xy",
        acceleration=_vector(spec.acceleration or [0.0, 0.0], flat, f"{where}: acceleration"),
        velocity=None if spec.velocity is None else _vector(spec.velocity, flat, f"{where}: velocity"),
    )


def _vector(values: list[float], flat: bool, where: str) -> Triple:
    if flat and len(values) == 3:
        raise InputError(f"{where}: has 3 numbers, but position has 2; give z there too, or leave it out here")
    return _triple(values, 0.0)


def _triple(values: list[float], z: float) -> Triple:
    return (float(values[0]), float(values[1]), float(values[2]) if len(values) > 2 else z)
