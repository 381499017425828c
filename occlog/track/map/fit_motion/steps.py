"""Positions of trajectories as measurements of a motion that goes in equal steps.

Time is cut into nodes one step apart.  A measured position belongs to the node nearest in
time, and tells of the position there plus the velocity there times what it is off in time;
what the motion is disturbed by in that part of a step is neglected (it is nothing for
positions at equal steps, and at most 1/8 of a step's share where they are half a step off).
Nodes without a measurement are gaps; where a gap is longer than allowed a new trajectory
begins.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.interpolate import interpolate_positions

BRIDGED = 2.0
"""Steps between two positions between which others are interpolated."""


class Path(NamedTuple):
    """Positions of one object, as measured."""

    t_ns: Ints  # (N,) rising
    xy: Floats  # (N, 2)
    cov: Floats | None = None  # (N, 2, 2) of the error of xy


class Nodes(NamedTuple):
    """Trajectories on their grids, one after the other."""

    first: Bools  # (K,) a trajectory begins here
    seen: Bools  # (K,) there is a measurement
    off: Floats  # (K,) time of the measurement after the node, in steps
    xy: Floats  # (K, 2) measured; 0 where there is none
    cov: Floats  # (K, 2, 2) of the error of xy as stated; 0 where it is not
    skipped: int  # measurements left out: another of the same trajectory was nearer to the node


def median_step(paths: Iterable[Path]) -> float:
    """Median time between successive positions [s].

    Raises:
        ValueError: no path has two positions at different times.
    """
    steps = np.concatenate([np.diff(p.t_ns) for p in paths] or [np.empty(0, np.int64)])
    steps = steps[steps > 0]
    if not len(steps):
        raise ValueError("no object has two positions at different times")
    return float(np.median(steps)) / 1e9


def make_nodes(paths: Iterable[Path], step_s: float, longest_gap_s: float) -> Nodes:
    """All paths on their grids; trajectories of a single position are left out (and not counted as skipped).

    Args:
        paths: one for each object and file.
        step_s: time between nodes, > 0.
        longest_gap_s: positions farther apart in time belong to different trajectories.
    """
    parts = [n for path in paths for piece in split(path, longest_gap_s) if (n := _nodes_of(piece, step_s)) is not None]
    if not parts:
        none = np.empty(0)
        flags = np.empty(0, np.bool_)
        return Nodes(flags, flags, none, none.reshape(0, 2), none.reshape(0, 2, 2), 0)
    first, seen, off, xy, cov, skipped = zip(*parts, strict=True)
    join = np.concatenate
    return Nodes(join(first), join(seen), join(off), join(xy), join(cov), sum(skipped))


def split(path: Path, longest_gap_s: float) -> list[Path]:
    """The path cut where two positions are farther apart in time than that."""
    cuts = np.flatnonzero(np.diff(path.t_ns) > longest_gap_s * 1e9 * (1.0 + 1e-9)) + 1
    bounds = [0, *cuts.tolist(), len(path.t_ns)]
    return [
        Path(path.t_ns[a:b], path.xy[a:b], None if path.cov is None else path.cov[a:b])
        for a, b in itertools.pairwise(bounds)
    ]


def _nodes_of(path: Path, step_s: float) -> Nodes | None:
    """One trajectory on its grid, which begins at its first position; None if only one node is measured."""
    if len(path.t_ns) < 2:
        return None
    steps = (path.t_ns - path.t_ns[0]) * 1e-9 / step_s
    node = np.rint(steps).astype(np.int64)
    off = steps - node
    # Of several positions at one node the one nearest in time; of equally near ones the first.
    order = np.lexsort((np.arange(len(node)), np.abs(off), node))
    used = order[np.unique(node[order], return_index=True)[1]]
    if len(used) < 2:
        return None
    K, at = int(node[-1]) + 1, node[used]
    out = Nodes(np.zeros(K, np.bool_), np.zeros(K, np.bool_), np.zeros(K), np.zeros((K, 2)), np.zeros((K, 2, 2)), 0)
    out.first[0] = True
    out.seen[at], out.off[at], out.xy[at] = True, off[used], path.xy[used]
    if path.cov is not None:
        out.cov[at] = path.cov[used]
    return out._replace(skipped=len(node) - len(used))


def transitions_by_differences(paths: Iterable[Path], step_s: float, longest_gap_s: float) -> tuple[Floats, Floats]:
    """(M, 4) states u u' v v' by central differences, in steps, and (M, 4) the next states.

    Positions are interpolated linearly to equal steps, over gaps of at most BRIDGED steps.
    """
    pairs = [_pairs(piece, step_s) for path in paths for piece in split(path, longest_gap_s)]
    if not pairs:
        return np.empty((0, 4)), np.empty((0, 4))
    return np.concatenate([a for a, _ in pairs]), np.concatenate([b for _, b in pairs])


def _pairs(path: Path, step_s: float) -> tuple[Floats, Floats]:
    steps = int((path.t_ns[-1] - path.t_ns[0]) * 1e-9 / step_s + 1e-6) if len(path.t_ns) else 0
    if steps < 3:
        return np.empty((0, 4)), np.empty((0, 4))
    t_ns = path.t_ns[0] + np.rint(np.arange(steps + 1) * (step_s * 1e9)).astype(np.int64)
    t_ns = np.minimum(t_ns, path.t_ns[-1])  # the last may be late by rounding
    xy, good = interpolate_positions(t_ns, path.t_ns, path.xy, round(BRIDGED * step_s * 1e9))
    states = np.empty((steps - 1, 4))
    states[:, [0, 2]] = xy[1:-1]
    states[:, [1, 3]] = 0.5 * (xy[2:] - xy[:-2])
    known = good[:-2] & good[1:-1] & good[2:]
    both = known[:-1] & known[1:]
    return states[:-1][both], states[1:][both]
