"""Polygons of a visual hull over time: stable identities, and no phantoms.

Where the cones of two objects cross, the hull has polygons without an object.  Such a phantom
comes and goes, or all of its runs are explained by others.  A polygon has *evidence* at a time
if one of its runs has no other polygon.  A polygon is given out if it was there long enough,
and had evidence lately or is needed to explain a run.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.assignment import assign

from .hull import Polygon


class Rules(NamedTuple):
    """When a polygon is believed in; lengths in the scene's unit, times in ns."""

    persist_ns: int  # it must have been there for so long
    memory_ns: int  # evidence counts for so long
    lost_ns: int  # an identity that is not seen for so long is forgotten
    hold_ns: int  # one that had evidence keeps its last polygon for so long
    speed: float  # of the fastest object, per second
    reach: float  # a polygon's centre may move by this besides


class FollowedPolygon(NamedTuple):
    """A polygon with its identity, at the last moment at which it was there."""

    identity: int
    polygon: Polygon  # the last one
    centre: Floats  # (2,)
    first_ns: int
    last_ns: int
    evidence_ns: int | None  # when it last had evidence; None: never


class HullMemory(NamedTuple):
    """Identities of polygons after the earlier moments."""

    known: tuple[FollowedPolygon, ...] = ()
    next_identity: int = 0


class BelievedPolygon(NamedTuple):
    """A polygon that is believed in."""

    identity: int
    polygon: Polygon


def follow(
    memory: HullMemory, t_ns: int, polygons: Sequence[Polygon], rules: Rules
) -> tuple[HullMemory, list[BelievedPolygon]]:
    """The next memory, and the polygons that are believed in, by identity.

    Args:
        memory: after the last moment; `HullMemory()` at first.
        t_ns: later than that of the last moment.
        polygons: of this moment.
        rules: when polygons are believed in.
    """
    old = [k for k in memory.known if t_ns - k.last_ns <= rules.lost_ns]
    current = _identities(old, memory.next_identity, t_ns, polygons, rules)
    seen = [k.identity for k in current]
    gone = [k for k in old if k.identity not in seen]
    newest = max([memory.next_identity, *(i + 1 for i in seen)])
    after = HullMemory(tuple(sorted([*current, *gone], key=lambda k: k.identity)), newest)
    held = [k for k in gone if _lately(k, t_ns, rules) and t_ns - k.last_ns <= rules.hold_ns]
    believed = [k for k in _needed(current, t_ns, rules) + held if k.last_ns - k.first_ns >= rules.persist_ns]
    return after, [BelievedPolygon(k.identity, k.polygon) for k in sorted(believed, key=lambda k: k.identity)]


def evidence(polygons: Sequence[Polygon]) -> list[bool]:
    """For each polygon: whether one of its runs has no other polygon."""
    count: dict[tuple[int, int], int] = {}
    for p in polygons:
        for r in p.runs:
            count[r] = count.get(r, 0) + 1
    return [any(count[r] == 1 for r in p.runs) for p in polygons]


def _identities(
    old: list[FollowedPolygon], fresh: int, t_ns: int, polygons: Sequence[Polygon], rules: Rules
) -> list[FollowedPolygon]:
    """An identity for each polygon: a known one near by, or a new one."""
    centres = np.array([[p.shape.centroid.x, p.shape.centroid.y] for p in polygons]).reshape(-1, 2)
    mine: dict[int, FollowedPolygon] = {}
    if old and len(centres):
        there = np.array([k.centre for k in old])
        away = np.hypot(*(centres[:, None] - there[None]).transpose(2, 0, 1))
        ages = np.array([t_ns - k.last_ns for k in old]) * 1e-9
        rows, columns = assign(away / (rules.reach + rules.speed * ages), 1.0)
        mine = {i: old[j] for i, j in zip(rows.tolist(), columns.tolist(), strict=True)}
    out = []
    for i, (p, centre, sure) in enumerate(zip(polygons, centres, evidence(polygons), strict=True)):
        before = mine.get(i) or FollowedPolygon(fresh, p, centre, t_ns, t_ns, None)
        fresh += i not in mine
        proof = t_ns if sure else before.evidence_ns
        out.append(before._replace(polygon=p, centre=centre, last_ns=t_ns, evidence_ns=proof))
    return out


def _lately(known: FollowedPolygon, t_ns: int, rules: Rules) -> bool:
    """Whether there was evidence of it lately."""
    return known.evidence_ns is not None and t_ns - known.evidence_ns <= rules.memory_ns


def _needed(current: list[FollowedPolygon], t_ns: int, rules: Rules) -> list[FollowedPolygon]:
    """Those with evidence, and of the others what explains runs that have none of these.

    Which of two polygons that may both be phantoms is one cannot be told from their runs; what
    explains more is taken first, both of what explains as much.
    """
    chosen = [k for k in current if _lately(k, t_ns, rules)]
    rest = [k for k in current if not _lately(k, t_ns, rules)]
    explained = {r: True for k in chosen for r in k.polygon.runs}
    while True:
        gains = [sum(r not in explained for r in k.polygon.runs) for k in rest]
        most = max(gains, default=0)
        if most == 0:
            return chosen
        taken = [k for k, gain in zip(rest, gains, strict=True) if gain == most]
        chosen += taken
        rest = [k for k, gain in zip(rest, gains, strict=True) if 0 < gain < most]
        explained |= {r: True for k in taken for r in k.polygon.runs}
