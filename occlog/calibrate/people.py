"""Joining of image tracks of one person across cameras, as observations for the bundle adjustment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.track.methods.jipda.interface import STATE_SIZE
from occlog.track.people.camera_checks.pair_overlap import BORDER_PX

from .adjustment import BodyPrior, Clocks, Observations
from .starts.alignment import Complexes

MATCH_HEIGHTS = 0.45
"""Tracks of two cameras are of one person if the median of their distances is smaller, in heights of people."""
MIN_COMMON = 3
"""Times that both have, at least."""
MAX_CONFLICTS = 1
"""Common times of two tracks of one camera that may still be of one person, at most."""
MAX_GAP_S = 3.0
"""A person who is not seen for longer begins again."""
MIN_KNOTS = 5
"""Time steps of a person, at least."""
MAX_KNOTS = 2500
"""Time steps of all people that are used at most: people whom most cameras see go first."""


class Tracklet(NamedTuple):
    """Track of a person in the images of one camera, with ground positions.

    Attributes:
        camera: index of the camera.
        t_s: (n,) stamped times [s].
        boxes: (n, 4) left, top, right, bottom [px].
        xy: (n,) positions on the ground as x + i y, in the world.
    """

    camera: int
    t_s: Floats
    boxes: Floats
    xy: Complexes


def on_grid(t_s: Floats, xy: Complexes, times: Floats, max_gap_s: float) -> Complexes:
    """(T,) positions linearly interpolated at the times of a grid; NaN outside and in gaps.

    NaN everywhere for fewer than two samples.

    Args:
        t_s: (n,) increasing times of the samples [s].
        xy: (n,) positions as x + i y.
        times: (T,) times of the grid [s].
        max_gap_s: longest interval that is interpolated [s].
    """
    out = np.interp(times, t_s, xy.real) + 1j * np.interp(times, t_s, xy.imag)
    if len(t_s) < 2:
        return np.full(len(times), np.nan, dtype=np.complex128)
    k = np.clip(np.searchsorted(t_s, times), 1, len(t_s) - 1)
    out[(times < t_s[0]) | (times > t_s[-1]) | (t_s[k] - t_s[k - 1] > max_gap_s)] = np.nan
    return out


def persons(tracklets: Sequence[Tracklet], clocks: Clocks, times: Floats, max_gap_s: float, height: float) -> Ints:
    """(n,) person of each tracklet, as index of one of its tracklets; those that coincide on the ground are joined.

    Tracklets of two cameras are joined greedily, pairs with the most common times and least distance first, unless two
    tracks of one camera would be of one person at the same time.

    Args:
        tracklets: n tracklets of all cameras.
        clocks: clocks of the cameras.
        times: (T,) grid of times at which positions are compared [s].
        max_gap_s: longest gap of a tracklet that is interpolated [s].
        height: height of a person, in the unit of the positions; it scales the largest distance.
    """
    n = len(tracklets)
    grid = np.array([on_grid(t.t_s - clocks.errors(t.camera, t.t_s), t.xy, times, max_gap_s) for t in tracklets])
    camera = np.array([t.camera for t in tracklets], dtype=np.int64)
    there = np.isfinite(grid)
    pairs: list[tuple[float, int, int]] = []
    for i in range(n):
        own = np.flatnonzero(there[i])
        if not len(own):
            continue
        others = np.flatnonzero((camera > camera[i]) & (there[:, own].sum(axis=1) >= MIN_COMMON))
        if not len(others):
            continue
        away = np.abs(grid[others][:, own] - grid[i, own])
        median, common = np.nanmedian(away, axis=1), np.isfinite(away).sum(axis=1)
        for j, distance, count in zip(others.tolist(), median.tolist(), common.tolist(), strict=True):
            if distance < MATCH_HEIGHTS * height:
                pairs.append((-count * (1.0 - distance / (MATCH_HEIGHTS * height)), i, j))
    group = np.arange(n)
    members: dict[int, list[int]] = {k: [k] for k in range(n)}
    # Times of a group that each camera has
    taken: dict[int, dict[int, np.ndarray]] = {k: {int(camera[k]): there[k]} for k in range(n)}
    for _, i, j in sorted(pairs):
        a, b = int(group[i]), int(group[j])
        if a == b or _conflict(taken[a], taken[b]):
            continue
        group[members[b]] = a
        members[a] += members.pop(b)
        for c, mask in taken.pop(b).items():
            taken[a][c] = taken[a].get(c, False) | mask
    return group


def _conflict(a: dict[int, np.ndarray], b: dict[int, np.ndarray]) -> bool:
    """Whether two groups of tracklets have tracks of one camera at more than `MAX_CONFLICTS` common times.

    `a` and `b` map a camera to the mask (T,) of times at which the group has a track there.
    """
    return any(np.count_nonzero(a[c] & b[c]) > MAX_CONFLICTS for c in set(a) & set(b))


def observations(
    rows: Sequence[tuple[int, int, float, Floats, complex]],
    clocks: Clocks,
    window_s: float,
    sizes: Sequence[tuple[int, int] | None],
    body: BodyPrior,
    max_gap_s: float = MAX_GAP_S,
    *,
    shared: bool = True,
) -> tuple[Observations, Floats]:
    """Observations of people for the bundle adjustment, and initial states.

    Args:
        rows: person, camera, stamped time [s], box (4,), and position on the ground.
        clocks: of the cameras.
        window_s: observations this near in time are of one time step.
        sizes: (C,) width and height of the images; None: not known.
        body: of people.
        max_gap_s: a person who is not seen for longer begins again [s].
        shared: people count whom two cameras see at one time, those of most cameras first; else all.
    """
    by_person: dict[int, list[int]] = {}
    stamps = np.array([row[2] for row in rows])
    true = stamps - clocks.errors(np.array([row[1] for row in rows], dtype=np.int64), stamps)
    for k, row in enumerate(rows):
        by_person.setdefault(row[0], []).append(k)
    chains: list[tuple[int, list[list[int]]]] = []
    for own in by_person.values():
        chain: list[list[int]] = []
        before = -np.inf
        for k in sorted(own, key=lambda k: true[k]):
            if true[k] - before > max_gap_s and chain:
                chains.append((len(chain), chain))
                chain = []
            if chain and true[k] - true[chain[-1][0]] <= window_s:
                chain[-1].append(k)
            else:
                chain.append([k])
            before = true[k]
        chains.append((len(chain), chain))
    useful = [
        (sum(len({rows[k][1] for k in knot}) - 1 for knot in chain), chain)
        for length, chain in chains
        if length >= MIN_KNOTS
    ]
    useful = [each for each in useful if each[0] >= MIN_KNOTS or not shared]
    useful.sort(key=lambda each: -each[0])
    first, camera, knot, delay, boxes, time, states = [0], [], [], [], [], [], []
    for _, chain in useful:
        if first[-1] and first[-1] + len(chain) > MAX_KNOTS:
            continue
        when = np.array([np.mean(true[each]) for each in chain])
        where = np.array([np.mean([rows[k][4] for k in each]) for each in chain])
        speed = np.gradient(where, when) if len(when) > 1 else np.zeros(1)
        for n, each in enumerate(chain):
            time.append(when[n])
            limit = 2.0 * body.metre
            v = speed[n] if abs(speed[n]) < limit else limit * speed[n] / abs(speed[n])
            states.append([where[n].real, where[n].imag, v.real, v.imag, body.height, body.width])
            for k in each:
                camera.append(rows[k][1])
                knot.append(len(time) - 1)
                delay.append(rows[k][2] - when[n])
                boxes.append(rows[k][3])
        first.append(len(time))
    box = np.array(boxes, dtype=np.float64).reshape(-1, 4)
    use = np.ones(box.shape, dtype=np.bool_)
    of = np.array(camera, dtype=np.int64)
    for c, size in enumerate(sizes):
        if size is not None:
            own = of == c
            use[own, :2] = box[own, :2] > BORDER_PX
            use[own, 2:] = box[own, 2:] < np.array(size) - 1.0 - BORDER_PX
    seen = Observations(
        of, np.array(knot, dtype=np.int64), np.array(delay), box, use, np.array(first, dtype=np.int64), np.array(time)
    )
    return seen, np.array(states).reshape(-1, STATE_SIZE)
