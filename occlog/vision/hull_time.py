"""Polygons of a visual hull over time: stable identities, and no phantoms.

Where the cones of two objects cross, the hull has polygons without an object.  Such a phantom
comes and goes, or all of its runs are explained by others.  A polygon has *evidence* at a time
if one of its runs has no other polygon.  A polygon is given out if it was there long enough,
and had evidence lately or is needed: a run of it has no trusted polygon.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..columns import Floats
from ..core.assignment import assign
from .hull import Polygon


class Rules(NamedTuple):
    """When a polygon is believed in; lengths in the scene's unit, times in ns."""

    persist_ns: int  # it must have been there for so long
    memory_ns: int  # evidence counts for so long
    lost_ns: int  # an identity that is not seen for so long is forgotten
    speed: float  # of the fastest object, per second
    reach: float  # a polygon's centre may move by this besides


class Known(NamedTuple):
    """An identity."""

    identity: int
    centre: Floats  # (2,)
    first_ns: int
    last_ns: int
    evidence_ns: int | None  # when it last had evidence; None: never


class Memory(NamedTuple):
    """What is known from earlier moments."""

    known: tuple[Known, ...] = ()
    next_identity: int = 0


def follow(memory: Memory, t_ns: int, polygons: Sequence[Polygon], rules: Rules) -> tuple[Memory, list[int | None]]:
    """The next memory, and the identity of each polygon; None for one that is not believed in (yet).

    Args:
        memory: after the last moment; `Memory()` at first.
        t_ns: later than that of the last moment.
        polygons: of this moment.
        rules: when polygons are believed in.
    """
    old = [k for k in memory.known if t_ns - k.last_ns <= rules.lost_ns]
    centres = np.array([[p.shape.centroid.x, p.shape.centroid.y] for p in polygons]).reshape(-1, 2)
    sure = evidence(polygons)
    current = _identities(old, memory.next_identity, t_ns, centres, sure, rules)
    seen = sorted(k.identity for k in current)
    gone = [k for k in old if k.identity not in seen]
    newest = max([memory.next_identity, *(i + 1 for i in seen)])
    after = Memory(tuple(sorted([*current, *gone], key=lambda k: k.identity)), newest)
    return after, [k.identity if b else None for k, b in zip(current, _believed(polygons, current, t_ns, rules),
                                                            strict=True)]  # fmt: skip


def evidence(polygons: Sequence[Polygon]) -> list[bool]:
    """For each polygon: whether one of its runs has no other polygon."""
    count: dict[tuple[int, int], int] = {}
    for p in polygons:
        for r in p.runs:
            count[r] = count.get(r, 0) + 1
    return [any(count[r] == 1 for r in p.runs) for p in polygons]


def _identities(
    old: list[Known], fresh: int, t_ns: int, centres: Floats, sure: list[bool], rules: Rules
) -> list[Known]:
    """An identity for each polygon: a known one near by, or a new one."""
    mine: dict[int, Known] = {}
    if old and len(centres):
        there = np.array([k.centre for k in old])
        away = np.hypot(*(centres[:, None] - there[None]).transpose(2, 0, 1))
        ages = np.array([t_ns - k.last_ns for k in old]) * 1e-9
        limit = rules.reach + rules.speed * ages
        rows, columns = assign(away / limit, 1.0)
        mine = {i: old[j] for i, j in zip(rows.tolist(), columns.tolist(), strict=True)}
    out = []
    for i, (centre, good) in enumerate(zip(centres, sure, strict=True)):
        before = mine.get(i)
        if before is None:
            before = Known(fresh, centre, t_ns, t_ns, None)
            fresh += 1
        out.append(before._replace(centre=centre, last_ns=t_ns, evidence_ns=t_ns if good else before.evidence_ns))
    return out


def _believed(polygons: Sequence[Polygon], current: list[Known], t_ns: int, rules: Rules) -> list[bool]:
    lately = [k.evidence_ns is not None and t_ns - k.evidence_ns <= rules.memory_ns for k in current]
    trusted = sorted({r for p, good in zip(polygons, lately, strict=True) if good for r in p.runs})
    out = []
    for p, k, good in zip(polygons, current, lately, strict=True):
        needed = any(r not in trusted for r in p.runs)
        out.append((good or needed) and t_ns - k.first_ns >= rules.persist_ns)
    return out
