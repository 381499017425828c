"""Who of one run is who of the other: pairs of each frame, and the people that they make."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.metrics.mot.clear_mot import ClearRule, match
from occlog.core.metrics.mot.frame_pairs import of_points
from occlog.core.metrics.mot.idf1 import identity

from .frames import Laid

EACH_FRAME = ClearRule(memory=0)
"""Pairs of each frame alone: as many as can be, then of least total distance."""


@dataclass(frozen=True)
class Person:
    """Tracks of either run that are one person's, as far as the runs agree; one of them may have none.

    Attributes:
        a, b: identities, the one that is there longest first.
    """

    a: tuple[int, ...]
    b: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of the two runs.

    Attributes:
        frame: (n,) number of the frame of each pair.
        a, b: (n,) rows of the runs' `Laid` in a pair.
        distance: (n,) between them.
        alone_a, alone_b: rows of `Laid` that have no partner, ascending.
        people: everybody, those of run A first.
    """

    frame: Ints
    a: Ints
    b: Ints
    distance: Floats
    alone_a: Ints
    alone_b: Ints
    people: tuple[Person, ...]


def pairs_of(a: Laid, b: Laid, near: float) -> Pairs:
    """Pair the two runs, with each other and not with the truth.

    Args:
        a: run A in common frames.
        b: run B.
        near: a pair is at most so far apart.
    """
    frames = of_points(a.objects(), b.objects(), near)
    found = match(frames, EACH_FRAME)
    rows_a, rows_b = frames.truth_row[found.truth], frames.track_row[found.track]
    given = identity(frames).track
    one_to_one = {
        int(label): int(frames.track_key[track, 1])
        for label, track in zip(frames.truth_key[:, 1], given, strict=True)
        if track >= 0
    }
    return Pairs(
        frame=frames.frame[found.frame],
        a=rows_a,
        b=rows_b,
        distance=found.distance,
        alone_a=np.flatnonzero(_lacking(len(a.label), rows_a)),
        alone_b=np.flatnonzero(_lacking(len(b.label), rows_b)),
        people=_people(a, b, one_to_one, a.label[rows_a], b.label[rows_b]),
    )


def _lacking(count: int, rows: Ints) -> Bools:
    out = np.ones(count, dtype=np.bool_)
    out[rows] = False
    return out


def _people(a: Laid, b: Laid, one_to_one: dict[int, int], of_a: Ints, of_b: Ints) -> tuple[Person, ...]:
    """Tracks that are one person's: those of the one-to-one assignment, and each other one with its usual partner."""
    number: dict[tuple[str, int], int] = {}
    for k, label in enumerate(np.unique(a.label).tolist()):
        partner = one_to_one.get(label)
        if partner is not None:
            number["a", label] = number["b", partner] = k
    first = dict(number)
    for run, own, other_run, other, labels in (("a", of_a, "b", of_b, a.label), ("b", of_b, "a", of_a, b.label)):
        for label in np.unique(labels).tolist():
            if (run, label) in first:
                continue
            met, count = np.unique(other[own == label], return_counts=True)
            usual = None if not len(met) else first.get((other_run, int(met[np.argmax(count)])))
            number[run, label] = 1_000_000 + len(number) if usual is None else usual
    lives = {"a": dict(zip(*np.unique(a.label, return_counts=True), strict=True))}
    lives["b"] = dict(zip(*np.unique(b.label, return_counts=True), strict=True))
    people: dict[int, dict[str, list[int]]] = {}
    for (run, label), k in number.items():
        people.setdefault(k, {"a": [], "b": []})[run].append(label)
    out = [
        Person(*(tuple(sorted(own[run], key=lambda n, run=run: (-lives[run][n], n))) for run in ("a", "b")))  # type: ignore[misc]
        for own in people.values()
    ]
    return tuple(sorted(out, key=lambda p: (not p.a, min(p.a or p.b))))
