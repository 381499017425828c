"""Figures for many targets straight from their definitions: dictionaries, loops and enumeration, no assignment solver.

A scene is `{frame: (truth, tracks)}`, either side `{label: place}`; boxes are (left, top, width, height).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import combinations, permutations

import numpy as np

from occlog.core.metrics.mot.frame_pairs import Objects

Place = tuple[float, ...]
Scene = dict[int, tuple[dict[int, Place], dict[int, Place]]]
Pair = tuple[int, int]
Measure = Callable[[Place, Place], float]
EPS = 2.3e-16


def iou(a: Place, b: Place) -> float:
    width = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0])
    height = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    shared = max(width, 0.0) * max(height, 0.0)
    return shared / (a[2] * a[3] + b[2] * b[3] - shared)


def closeness(limit: float) -> Measure:
    return lambda a, b: max(0.0, 1.0 - math.dist(a, b) / (2.0 * limit))


def one_to_one(left: list[int], right: list[int]) -> Iterator[tuple[Pair, ...]]:
    """All ways to pair some of the left with some of the right."""
    for n in range(min(len(left), len(right)) + 1):
        for a in combinations(left, n):
            for b in permutations(right, n):
                yield tuple(zip(a, b, strict=True))


def random_scene(seed: int, boxes: bool, frames: int = 12, targets: int = 4) -> Scene:
    """Targets that wander among each other; tracks that miss, invent, and change hands."""
    rng = np.random.default_rng(seed)
    scene: Scene = {}
    at = rng.uniform(0.0, 4.0, (targets, 2))
    owner = rng.permutation(targets + 1)[:targets]
    for frame in range(frames):
        at += rng.normal(0.0, 0.3, at.shape)
        if rng.random() < 0.3:
            i, j = rng.choice(targets, 2, replace=False)
            owner[i], owner[j] = owner[j], owner[i]
        truth = {10 + k: tuple(at[k]) for k in range(targets) if rng.random() < 0.9}
        tracks = {3 + int(owner[k]): tuple(at[k] + rng.normal(0.0, 0.4, 2)) for k in range(targets)}
        tracks = {label: place for label, place in tracks.items() if rng.random() < 0.8}
        if rng.random() < 0.3:
            tracks[20 + frame % 2] = tuple(rng.uniform(0.0, 4.0, 2))
        if boxes:
            truth = {label: (*place, *rng.uniform(1.0, 2.0, 2)) for label, place in truth.items()}
            tracks = {label: (*place, *rng.uniform(1.0, 2.0, 2)) for label, place in tracks.items()}
        scene[frame] = truth, tracks
    return scene


def objects(scene: Scene, side: int, view: int | None = None, seed: int | None = None) -> Objects:
    """One side of a scene as columns; rows shuffled with a seed."""
    rows = [(frame, label, place) for frame, sides in scene.items() for label, place in sides[side].items()]
    width = next((len(place) for sides in scene.values() for part in sides for place in part.values()), 2)
    order = np.arange(len(rows)) if seed is None else np.random.default_rng(seed).permutation(len(rows))
    frame, label = (np.array([rows[n][k] for n in order], dtype=np.int64) for k in range(2))
    positions = np.array([rows[n][2] for n in order], dtype=np.float64).reshape(-1, width)
    return Objects(frame, label, positions, None if view is None else np.full(len(rows), view, dtype=np.int64))


def clear(scene: Scene, similar: Measure, distance: Measure, memory: float, most: bool) -> dict[str, float]:
    held: dict[int, Pair] = {}
    lives: dict[int, list[bool]] = {}
    out = dict.fromkeys(("tp", "fp", "fn", "switches", "fragmentations", "distance", "similarity"), 0.0)
    for frame, (truth, tracks) in sorted(scene.items()):
        pairs: dict[int, int] = {}
        for i in sorted(truth):
            j, when = held.get(i, (-1, -1))
            free = j in tracks and j not in pairs.values() and frame - when <= memory
            if free and similar(truth[i], tracks[j]) >= 0.5 - EPS:
                pairs[i] = j
        left, right = sorted(set(truth) - set(pairs)), sorted(set(tracks) - set(pairs.values()))
        best, chosen = (-1.0, 0.0), ()
        for way in one_to_one(left, right):
            if any(similar(truth[i], tracks[j]) < 0.5 - EPS for i, j in way):
                continue
            apart = sum(distance(truth[i], tracks[j]) for i, j in way)
            score = (len(way), -apart) if most else (sum(similar(truth[i], tracks[j]) for i, j in way), 0.0)
            if score > best:
                best, chosen = score, way
        pairs.update(chosen)
        for i, j in pairs.items():
            out["switches"] += i in held and held[i][0] != j
            out["distance"] += distance(truth[i], tracks[j])
            out["similarity"] += similar(truth[i], tracks[j])
            held[i] = j, frame
        for i in truth:
            lives.setdefault(i, []).append(i in pairs)
        out["tp"] += len(pairs)
        out["fp"] += len(tracks) - len(pairs)
        out["fn"] += len(truth) - len(pairs)
    for life in lives.values():
        segments = "".join("x" if on else " " for on in life).split()
        out["fragmentations"] += max(len(segments) - 1, 0)
    shares = [sum(life) / len(life) for life in lives.values()]
    out["mostly_tracked"], out["mostly_lost"] = sum(s >= 0.8 for s in shares), sum(s < 0.2 for s in shares)
    return out


def idtp(scene: Scene, similar: Measure) -> int:
    """Most rows that one fixed pairing of targets and tracks explains."""
    targets = sorted({i for truth, _ in scene.values() for i in truth})
    tracks = sorted({j for _, found in scene.values() for j in found})
    met = {
        (i, j): sum(i in a and j in b and similar(a[i], b[j]) >= 0.5 - EPS for a, b in scene.values())
        for i in targets
        for j in tracks
    }
    wide = [*tracks, *(-k for k in range(1, len(targets) + 1))]
    return max(
        sum(met.get(pair, 0) for pair in zip(targets, way, strict=True)) for way in permutations(wide, len(targets))
    )


def hota(scene: Scene, similar: Measure, alpha: float) -> dict[str, float]:
    """HOTA at one threshold with TPA, FNA and FPA counted again for every true positive."""
    rows = [(i, j, t) for t, (a, b) in scene.items() for i in a for j in b]
    value = {(i, j, t): similar(scene[t][0][i], scene[t][1][j]) for i, j, t in rows}

    def share(i: int, j: int, t: int) -> float:
        whole = sum(value[i, k, t] for k in scene[t][1]) + sum(value[k, j, t] for k in scene[t][0]) - value[i, j, t]
        return value[i, j, t] / whole if whole > 0 else 0.0

    def life(label: int, side: int) -> int:
        return sum(label in sides[side] for sides in scene.values())

    met: dict[Pair, float] = {}
    for i, j, t in rows:
        met[i, j] = met.get((i, j), 0.0) + share(i, j, t)
    similar_rows = {(i, j): s / (life(i, 0) + life(j, 1) - s) for (i, j), s in met.items()}
    hits: list[tuple[int, int, int]] = []
    for t, (a, b) in scene.items():
        ways = one_to_one(sorted(a), sorted(b))
        way = max(ways, key=lambda way: sum(similar_rows[i, j] * value[i, j, t] for i, j in way))
        hits += [(i, j, t) for i, j in way if value[i, j, t] >= alpha - EPS]
    tp = len(hits)
    total_truth, total_tracks = (sum(len(sides[k]) for sides in scene.values()) for k in range(2))
    ass = re = pr = 0.0
    for i, j, _ in hits:
        tpa = sum((i, j) == hit[:2] for hit in hits)
        ass += tpa / (life(i, 0) + life(j, 1) - tpa)
        re, pr = re + tpa / life(i, 0), pr + tpa / life(j, 1)
    m = max(tp, 1)
    det = tp / max(total_truth + total_tracks - tp, 1)
    return {
        "hota": math.sqrt(det * ass / m),
        "det_a": det,
        "ass_a": ass / m,
        "ass_re": re / m,
        "ass_pr": pr / m,
        "det_re": tp / max(total_truth, 1),
        "det_pr": tp / max(total_tracks, 1),
        "loc_a": sum(value[hit] for hit in hits) / tp if tp else 1.0,
    }


def gospa(a: list[Place], b: list[Place], distance: Measure, cutoff: float, p: float, alpha: float) -> float:
    """The definition: the smaller set is paired as a whole, distances are cut off, the surplus is paid for."""
    small, large = (a, b) if len(a) <= len(b) else (b, a)
    costs = (
        sum(min(distance(x, large[k]), cutoff) ** p for x, k in zip(small, way, strict=True))
        for way in permutations(range(len(large)), len(small))
    )
    return (min(costs) + cutoff**p / alpha * (len(large) - len(small))) ** (1.0 / p)


def gospa_parts(a: list[Place], b: list[Place], distance: Measure, cutoff: float, p: float) -> float:
    """With alpha = 2: the least over all partial pairings of d^p of the pairs and c^p / 2 of all the others."""
    return min(
        sum(distance(a[i], b[j]) ** p for i, j in way) + cutoff**p / 2.0 * (len(a) + len(b) - 2 * len(way))
        for way in one_to_one(list(range(len(a))), list(range(len(b))))
    )


def failures(scene: Scene, tau: dict[int, float]) -> list[tuple[int, int, str]]:
    """Rows frame, label, cause of [Qu] Eq. 9 with the rule of the module under test."""
    rows: list[tuple[int, int, str]] = []
    for frame, (truth, trackers) in scene.items():
        on: dict[int, int] = {}
        for k, place in trackers.items():
            if k in truth and math.dist(place, truth[k]) <= tau[k]:
                on[k] = k
                continue
            near = [(math.dist(place, truth[i]), i) for i in truth if math.dist(place, truth[i]) <= tau[i]]
            if near:
                on[k] = min(near)[1]
        for i in truth:
            if i not in on.values():
                there = i in trackers
                away = f"its tracker is {math.dist(trackers[i], truth[i]):.4g} px away" if there else "no tracker"
                rows.append((frame, i, f"its tracker is on target {on[i]}" if i in on else away))
        rows += [(frame, k, f"tracker on target {i}") for k, i in on.items() if k != i]
    return sorted(rows)
