"""Tracks of people who meet, with their truth: on the ground, and as boxes in images."""

from __future__ import annotations

import numpy as np

from occlog.array_types import NS
from occlog.records.tables import Boxes, Tracks, Truth, TruthBoxes


def crowd(seed: int, people: int = 5, moments: int = 90) -> tuple[Tracks, Truth]:
    """People who meet in a small room; tracks are born, exchanged, lost for a while, false, and at other times."""
    random = np.random.default_rng(seed)
    place, pace = random.uniform(0, 4, (people, 2)), random.normal(0, 0.1, (people, 2))
    begin, end = random.integers(0, 30, people), moments - random.integers(0, 30, people)
    names, new = np.arange(people), 100
    true: list[tuple[float, ...]] = []
    ours: list[tuple[float, ...]] = []
    for t in range(moments):
        place = place + pace
        pace = np.where((place < 0) | (place > 4), -pace, pace)
        at, seen = int(0.2 * t * NS), int((0.2 * t + random.choice([0.0, 0.03])) * NS)
        if random.random() < 0.1:
            a, b = random.integers(0, people, 2)
            names[[a, b]] = names[[b, a]]
        if random.random() < 0.1:
            names[random.integers(0, people)], new = new, new + 1
        true += [(at, k, *place[k]) for k in range(people) if begin[k] <= t < end[k] and random.random() < 0.95]
        lost = 20 <= t < 32
        near = [
            k for k in range(people) if begin[k] <= t < end[k] + 3 and random.random() < 0.8 and not (lost and k == 0)
        ]
        ours += [(seen, names[k], *(place[k] + random.normal(0, 0.25, 2))) for k in near]
        if random.random() < 0.3:
            ours, new = [*ours, (seen, new, *random.uniform(0, 4, 2))], new + 1
    a, b = (np.array(sorted(rows)) for rows in (ours, true))
    n, m = len(a), len(b)
    spread = random.uniform(0.02, 0.2, n)
    tracks = Tracks.of(
        t_ns=a[:, 0].astype(np.int64),
        target_id=a[:, 1].astype(np.int32),
        x=a[:, 2],
        y=a[:, 3],
        vx=np.zeros(n),
        vy=np.zeros(n),
        cov_xx=spread,
        cov_xy=np.zeros(n),
        cov_yy=np.where(random.random(n) < 0.05, 0.0, spread),
    )
    truth = Truth.of(
        t_ns=b[:, 0].astype(np.int64),
        target_id=b[:, 1].astype(np.int32),
        role=np.full(m, "target"),
        x=b[:, 2],
        y=b[:, 3],
        z=np.full(m, np.nan),
    )
    return tracks, truth


def rows_of(kind: type[Boxes], rows: list[tuple[int, str, int, int, float, float]]) -> Boxes:
    """Boxes of 40 x 60 px; identity -1: a frame without one."""
    rows = sorted(rows)
    t_ns, sensor, frame, label, left, top = (np.array(column) for column in zip(*rows, strict=True))
    none = label < 0
    size = {name: np.where(none, np.nan, length) for name, length in (("width_px", 40.0), ("height_px", 60.0))}
    place = {"left_px": np.where(none, np.nan, left), "top_px": np.where(none, np.nan, top)}
    more = {"box": np.where(none, -1, label), "confidence": np.full(len(rows), np.nan)}
    more |= {"visible": np.where(none, np.nan, 0.5)} if kind is TruthBoxes else {}
    return kind.of(t_ns=t_ns, sensor=sensor, frame=frame, target_id=label.astype(np.int32), **place, **size, **more)


def views(seed: int) -> tuple[Boxes, TruthBoxes]:
    """Four people in two cameras, and in a third one that no track is in; frames without anybody, other frames."""
    random, true, ours = np.random.default_rng(seed), [], []
    for c, name in enumerate(("a", "b", "c")):
        place, names = random.uniform(0, 250, (4, 2)), np.arange(4)
        for t in range(40):
            place = place + random.normal(0, 6, (4, 2))
            if random.random() < 0.15:
                i, j = random.integers(0, 4, 2)
                names[[i, j]] = names[[j, i]]
            at = 10**8 * t + 1000 * c
            there = [k for k in range(4) if not 10 <= t < 13 and random.random() < 0.9]
            true += [(at, name, t + 3, k, *place[k]) for k in there] or [(at, name, t + 3, -1, 0.0, 0.0)]
            if name != "c":
                near = [k for k in range(4) if random.random() < 0.8]
                ours += [(at, name, t + 3, int(names[k]) + 2, *(place[k] + random.normal(0, 5, 2))) for k in near]
    ours.append((10**10, "a", 200, 3, 1.0, 1.0))
    truth = rows_of(TruthBoxes, true)
    assert isinstance(truth, TruthBoxes)
    return rows_of(Boxes, ours), truth
