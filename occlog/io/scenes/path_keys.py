"""The keys of a path file, with types, limits and meanings: `schemas/paths.json` is made from this."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from .scene_keys import Spec

LIMIT = 1e9
Number = Annotated[float, Meta(ge=-LIMIT, le=LIMIT)]
Time = Annotated[float, Meta(ge=0, le=LIMIT)]
Vector = Annotated[list[Number], Meta(min_length=2, max_length=3)]
Interval = tuple[Time, Time]


class SegmentSpec(Spec, kw_only=True):
    """A stretch of a path; without `lateral` and `acceleration` one of constant velocity."""

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


class TargetSpec(Spec, kw_only=True):
    """One object and its path."""

    id: Annotated[int, Meta(ge=0, le=2**31 - 1)]
    role: Literal["target", "occluder"] = "target"
    position: Annotated[Vector, Meta(description="x, y and, where known, z at its start")]
    velocity: Vector | None = None
    from_s: Annotated[Time, Meta(description="when it comes")] = 0.0
    until_s: Annotated[Time, Meta(description="when it goes; default: it stays")] | None = None
    noise_density: Annotated[
        float, Meta(ge=0, le=LIMIT, description="variance of the velocity gathered in a second, for each axis")
    ] = 0.0
    segments: tuple[SegmentSpec, ...] = ()
    silent: Annotated[tuple[Interval, ...], Meta(description="from, to: when it makes no sound")] = ()


class PathsSpec(Spec, kw_only=True):
    """A file of scripted targets; times are seconds after the first step."""

    occlog_paths: Annotated[Literal[1], Meta(description="version of this format")]
    length_unit: (
        Annotated[Literal["m", "unit", "ft", "in", "px"], Meta(description="must be the scene's; default: the scene's")]
        | None
    ) = None
    seconds: Annotated[Time, Meta(description="length of the recording")] | None = None
    rate_hz: Annotated[float, Meta(gt=0, le=LIMIT, description="steps a second")] | None = None
    targets: Annotated[list[TargetSpec], Meta(min_length=1)]


def paths_schema() -> dict[str, Any]:
    """JSON Schema of path files."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **msgspec.json.schema(PathsSpec)}
