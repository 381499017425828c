"""Candidates without a label: bring them together on the ground, and follow their objects from moment to moment."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.assignment import assign
from occlog.core.sight.locate_sources import NO_SOURCE, Directions, localise
from occlog.measure.fuse.kernels.sight_lines import Place, Sight, ahead, misfit, points

from .cameras import PlacedCameras
from .config import FuseConfig
from .decide import Decision, ObjectMemory, decide


class CandidateDecisions(NamedTuple):
    """Decisions about the candidates of one moment."""

    objects: list[ObjectMemory]  # those that are followed further
    decisions: list[tuple[Decision, Ints]]  # with the rows of the candidates that each is about
    nobody: Ints  # rows of candidates of no declared object


def fuse_candidates(
    objects: Sequence[ObjectMemory],
    t_ns: int,
    sight: Sight,
    rows: Ints,
    looked: Ints,
    cameras: PlacedCameras,
    config: FuseConfig,
) -> CandidateDecisions:
    """Decisions about the objects known, then about what the other candidates may be of.

    A candidate is of one object at most.

    Args:
        objects: with a motion each, at earlier moments.
        t_ns: the moment.
        sight: of all rows.
        rows: those of the moment's candidates.
        looked: cameras that delivered a frame, rising.
        cameras: those with a pose.
        config: settings in the scene's unit.
    """
    # Decide about known objects with the candidates assigned to each.
    free = rows
    followed: list[ObjectMemory] = []
    decisions: list[tuple[Decision, Ints]] = []
    for memory, mine in zip(objects, _shared_out(objects, t_ns, sight, rows, config), strict=True):
        decision = decide(memory, t_ns, sight.take(mine), looked, cameras, config)
        decisions.append((decision, mine))
        free = free[~np.isin(free, mine[decision.kept])]
        if decision.memory.motion is not None:
            followed.append(decision.memory)
    # Group the rest, and decide about what each group may be of.
    for mine in _groups(sight, free, cameras, config):
        decision = decide(ObjectMemory(), t_ns, sight.take(mine), looked, cameras, config)
        decisions.append((decision, mine))
        free = free[~np.isin(free, mine[decision.kept])]
        if decision.memory.motion is not None:
            followed.append(decision.memory)
    return CandidateDecisions(followed, decisions, free)


def _shared_out(objects: Sequence[ObjectMemory], t_ns: int, sight: Sight, rows: Ints, config: FuseConfig) -> list[Ints]:
    """Rows of each object: of every camera at most one, within reach of the prediction."""
    out: list[list[int]] = [[] for _ in objects]
    if objects and len(rows):
        mine = sight.take(rows)
        cost = np.column_stack([_off(memory, t_ns, mine, config) for memory in objects])
        for camera in np.unique(mine.sensor).tolist():
            own = np.flatnonzero(mine.sensor == camera)
            for row, column in zip(*assign(cost[own], config.reach**2), strict=True):
                out[int(column)].append(int(rows[own[row]]))
    return [np.array(sorted(r), dtype=np.int64) for r in out]


def _off(memory: ObjectMemory, t_ns: int, sight: Sight, config: FuseConfig) -> Floats:
    if memory.motion is None:  # objects that are followed have one
        return np.full(len(sight.azimuth), np.inf)
    place = ahead(memory.motion, t_ns, config.acceleration).place
    return misfit(sight, place, config.sigma**2)


def _groups(sight: Sight, rows: Ints, cameras: PlacedCameras, config: FuseConfig) -> Iterator[Ints]:
    """Candidates that may be of one object: those that meet, the most first; those with feet in one place; the rest."""
    left = rows
    for place in [*_meetings(sight.take(rows), cameras, config), *_standing(sight.take(rows))]:
        mine = _nearest(sight, left, place, config.gate)
        if len(mine):
            left = left[~np.isin(left, mine)]
            yield mine
    yield from left[:, None]


def _meetings(sight: Sight, cameras: PlacedCameras, config: FuseConfig) -> list[Place]:
    if len(np.unique(sight.sensor)) < 2:
        return []
    lines = Directions(sight.sensor, sight.origin, sight.azimuth, sight.sigma)
    crossing = math.radians(config.min_crossing_deg)
    found = localise(lines, NO_SOURCE, np.empty((0, 2, 2)), cameras.region, config.gate, crossing)
    order = np.argsort(-found.arrays, kind="stable").tolist()
    return [Place(found.xy[i], found.covariance[i]) for i in order]


def _standing(sight: Sight) -> list[Place]:
    return [Place(xy, cov) for xy, cov in zip(*points(sight.take(np.isfinite(sight.distance))), strict=True)]


def _nearest(sight: Sight, rows: Ints, place: Place, gate: float) -> Ints:
    """Rows near a place, of every camera the nearest."""
    off = misfit(sight.take(rows), place)
    out = []
    for camera in np.unique(sight.sensor[rows]).tolist():
        own = np.flatnonzero((sight.sensor[rows] == camera) & (off <= gate**2))
        if len(own):
            out.append(int(rows[own[np.argmin(off[own])]]))
    return np.array(sorted(out), dtype=np.int64)
