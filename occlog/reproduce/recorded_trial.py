"""One trial on recorded detections, described by plain values so that it can be stored and done by any process."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

from ..trackers.select import read_selection
from .model import Size, Spec
from .recorded import Crowd, crowd_of, trial
from .recorded_files import Source, read_source
from .recorded_target import Recorded, recorded_target


def recorded_spec(source: Source, size: Size, run: int, kind: str, cameras: list[str], **more: Any) -> Spec:
    """Description of a trial; see `recorded_trial`."""
    return {
        "recording": {**source._asdict(), "content": list(source.content)}, "seed": size.seed + run,
        "steps": size.steps, "particles": size.particles, "kind": kind, "cameras": cameras, **more,
    }  # fmt: skip


def recorded_trial(spec: Mapping[str, Any]) -> dict[str, float]:
    """Figures of `recorded.trial`.

    Args:
        spec: `recording` (fields of `Source`), `seed` (of the virtual people and of the
            filter), `steps`, `particles`, `kind`, `cameras`, and optional `select` (fields
            of `SelectConfig`).
    """
    source = Source(**{**spec["recording"], "content": tuple(spec["recording"]["content"])})
    seed = int(spec["seed"])
    select = None if spec.get("select") is None else read_selection(spec["select"])
    size = Size(1, int(spec["steps"]), particles=int(spec["particles"]))
    return trial(target_of(source), _crowd(source, seed), spec["kind"], spec["cameras"], size, seed, select)


@functools.lru_cache(maxsize=1)
def target_of(source: Source) -> Recorded:
    """The target of a recording."""
    return recorded_target(*read_source(source))


@functools.lru_cache(maxsize=2)
def _crowd(source: Source, seed: int) -> Crowd:
    return crowd_of(target_of(source), seed)
