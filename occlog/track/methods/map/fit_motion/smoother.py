"""Kalman filter and smoother over trajectories, and the sums that EM needs of them.

The E step of Shumway & Stoffer (1982): x_t+1 = A x_t + N(0, Sigma), position measured at
some nodes, z = C x + N(0, R), the trajectories independent and each begun with the same
vague prior.  Everything here is in units of the data: one step of time, one `scale` of length.

Positions of trajectories as measurements of a motion that goes in equal steps.

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
from occlog.core.numerics.jit import kernel

VAGUE = 25.0
"""Variance of each entry of the first state, about the first position measured and no velocity."""


CV = np.kron(np.eye(2), np.array([[1.0, 1.0], [0.0, 1.0]]))
"""A of constant velocity."""


class SmootherSums(NamedTuple):
    """Expectations of products, summed over n transitions and m measurements, given all measurements (E step).

    With d = x_t+1 - CV x_t, what constant velocity does not explain: DD of d d', DX of d x_t', XX of x_t x_t', each
    (4, 4), and E (2, 2) of (z - C x)(z - C x)' of the measurements z. Sums of x_t+1 itself, which may be far from the
    origin, would lose d by rounding.
    """

    n: int  # transitions
    DD: Floats  # (4, 4) of d d^T
    DX: Floats  # (4, 4) of d x_t^T
    XX: Floats  # (4, 4) of x_t x_t^T
    m: int  # measurements
    E: Floats  # (2, 2) of (z - C x)(z - C x)^T


def smooth(
    first: Bools, seen: Bools, off: Floats, xy: Floats, R: Floats, A: Floats, sigma: Floats
) -> tuple[float, SmootherSums, Floats, Floats]:
    """Run the Kalman filter and Rauch-Tung-Striebel smoother over K nodes of one or more trajectories.

    Args:
        first: (K,) a trajectory begins; true at 0, and every such node is seen.
        seen: (K,) there is a measurement.
        off: (K,) time of the measurement after the node, in steps.
        xy: (K, 2) measured positions.
        R: (K, 2, 2) covariances of the measurements' errors, positive definite where seen.
        A: (4, 4) transition matrix of one step.
        sigma: (4, 4) process noise covariance of one step, positive definite.

    Returns:
        Log likelihood of the measurements, the sums of the E step, smoothed means (K, 4) x, vx, y, vy and covariances
        (K, 4, 4).
    """
    log_likelihood, mean, cov, before, before_cov = _filter(
        first=first, seen=seen, off=off, xy=xy, R=R, A=A, sigma=sigma
    )
    n, DD, DX, XX, m, E = _smooth(
        first=first, seen=seen, off=off, xy=xy, mean=mean, cov=cov, before=before, before_cov=before_cov, A=A, F=CV
    )
    return log_likelihood, SmootherSums(n, DD, DX, XX, m, E), mean, cov


@kernel
def _observation_matrix(off: float) -> Floats:
    """Return the measurement matrix C (2, 4) of a position measured `off` steps after its node: x + off * velocity.

    The state is x, vx, y, vy, velocities per step.
    """
    C = np.zeros((2, 4))
    C[0, 0] = C[1, 2] = 1.0
    C[0, 1] = C[1, 3] = off
    return C


@kernel
def _filter(
    first: Bools, seen: Bools, off: Floats, xy: Floats, R: Floats, A: Floats, sigma: Floats
) -> tuple[float, Floats, Floats, Floats, Floats]:
    """Kalman filter over K nodes of one or more trajectories.

    A first node has the prior (its measured position, velocity 0) with variance `VAGUE`.

    Args:
        first: (K,) a trajectory begins.
        seen: (K,) there is a measurement.
        off: (K,) time of the measurement after the node, in steps.
        xy: (K, 2) measured positions.
        R: (K, 2, 2) covariances of the measurements' errors.
        A: (4, 4) transition matrix of one step.
        sigma: (4, 4) process noise covariance of one step.

    Returns:
        Log likelihood of the measurements, filtered means (K, 4) and covariances (K, 4, 4), and the predicted means and
        covariances before each update.
    """
    K = first.shape[0]
    mean, cov = np.empty((K, 4)), np.empty((K, 4, 4))
    before, before_cov = np.empty((K, 4)), np.empty((K, 4, 4))
    total, At, one = 0.0, np.ascontiguousarray(A.T), np.eye(4)
    x, P = np.zeros(4), np.eye(4)
    for k in range(K):
        if first[k]:
            x, P = np.zeros(4), VAGUE * np.eye(4)
            x[0], x[2] = xy[k, 0], xy[k, 1]
        else:
            # Predict
            x = A @ x
            P = A @ P @ At + sigma
        before[k], before_cov[k] = x, P
        if seen[k]:
            # Update, in the form of Joseph, which stays positive
            C = _observation_matrix(off[k])
            Ct = np.ascontiguousarray(C.T)
            V = C @ P @ Ct + R[k]
            det = V[0, 0] * V[1, 1] - V[0, 1] * V[1, 0]
            inverse = np.array([[V[1, 1], -V[0, 1]], [-V[1, 0], V[0, 0]]]) / det
            e = xy[k] - C @ x
            total -= 0.5 * (e @ inverse @ e + np.log(det)) + np.log(2.0 * np.pi)
            G = P @ Ct @ inverse
            x = x + G @ e
            F = one - G @ C
            P = F @ P @ np.ascontiguousarray(F.T) + G @ R[k] @ np.ascontiguousarray(G.T)
        P = 0.5 * (P + P.T)
        mean[k], cov[k] = x, P
    return total, mean, cov, before, before_cov


@kernel
def _smooth(
    first: Bools,
    seen: Bools,
    off: Floats,
    xy: Floats,
    mean: Floats,
    cov: Floats,
    before: Floats,
    before_cov: Floats,
    A: Floats,
    F: Floats,
) -> tuple[int, Floats, Floats, Floats, int, Floats]:
    """Smooth by Rauch-Tung-Striebel; return n, DD, DX, XX, m and E of `SmootherSums`.

    Args:
        first: (K,) a trajectory begins.
        seen: (K,) there is a measurement.
        off: (K,) time of the measurement after the node, in steps.
        xy: (K, 2) measured positions.
        mean: (K, 4) of the filter; becomes that given all measurements.
        cov: (K, 4, 4) of the filter; becomes that given all measurements.
        before: (K, 4) predictions of the filter.
        before_cov: (K, 4, 4) of the predictions.
        A: (4, 4) transition matrix of one step.
        F: (4, 4) constant-velocity transition, from which d = x_t+1 - F x_t is computed.
    """
    K = first.shape[0]
    DD, DX, XX, E = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((2, 2))
    Ft = np.ascontiguousarray(F.T)
    n = m = 0
    for k in range(K - 1, -1, -1):
        if k + 1 < K and not first[k + 1]:
            J = np.ascontiguousarray(np.linalg.solve(before_cov[k + 1], A @ cov[k]).T)
            late, late_cov = mean[k + 1], cov[k + 1]
            mean[k] = mean[k] + J @ (late - before[k + 1])
            P = cov[k] + J @ (late_cov - before_cov[k + 1]) @ np.ascontiguousarray(J.T)
            cov[k] = 0.5 * (P + P.T)
            d = late - F @ mean[k]
            lag = late_cov @ np.ascontiguousarray(J.T)  # covariance of x_t+1 and x_t
            both = lag @ Ft
            DD += late_cov - both - both.T + F @ cov[k] @ Ft + np.outer(d, d)
            DX += lag - F @ cov[k] + np.outer(d, mean[k])
            XX += cov[k] + np.outer(mean[k], mean[k])
            n += 1
        if seen[k]:
            C = _observation_matrix(off[k])
            e = xy[k] - C @ mean[k]
            E += C @ cov[k] @ np.ascontiguousarray(C.T) + np.outer(e, e)
            m += 1
    return n, DD, DX, XX, m, E


BRIDGED = 2.0
"""Steps between two positions between which others are interpolated."""


class MeasuredPath(NamedTuple):
    """Measured positions of one object: times `t_ns` (N,), ascending, and `xy` (N, 2).

    `cov` (N, 2, 2) are the covariances of the positions' errors; None: unknown.
    """

    t_ns: Ints  # (N,) ascending
    xy: Floats  # (N, 2)
    cov: Floats | None = None  # (N, 2, 2) of the error of xy


class Nodes(NamedTuple):
    """Trajectories on time grids of equal steps, one after another; K nodes in all.

    `first` (K,): a trajectory begins; `seen` (K,): there is a measurement, `off` (K,) steps after the node, at `xy`
    (K, 2) with covariance `cov` (K, 2, 2) (0 if missing). `skipped` is the number of measurements omitted because
    another was nearer to the node.
    """

    first: Bools  # (K,) a trajectory begins here
    seen: Bools  # (K,) there is a measurement
    off: Floats  # (K,) time of the measurement after the node, in steps
    xy: Floats  # (K, 2) measured; 0 where missing
    cov: Floats  # (K, 2, 2) of the error of xy as stated; 0 where it is not
    skipped: int  # measurements omitted: another of the same trajectory was nearer to the node


def median_step(paths: Iterable[MeasuredPath]) -> float:
    """Return the median time between successive positions [s].

    Raises:
        ValueError: no path has two positions at different times.
    """
    steps = np.concatenate([np.diff(p.t_ns) for p in paths] or [np.empty(0, np.int64)])
    steps = steps[steps > 0]
    if not len(steps):
        raise ValueError("no object has two positions at different times; give longer records")
    return float(np.median(steps)) / 1e9


def make_nodes(paths: Iterable[MeasuredPath], step_s: float, longest_gap_s: float) -> Nodes:
    """Put all paths on time grids of equal steps; trajectories with a single measured node are omitted.

    Those are not counted as skipped.

    Args:
        paths: one for each object and file.
        step_s: time between nodes [s], > 0.
        longest_gap_s: positions farther apart in time [s] belong to different trajectories.
    """
    parts = [n for path in paths for piece in split(path, longest_gap_s) if (n := _nodes_of(piece, step_s)) is not None]
    if not parts:
        none = np.empty(0)
        flags = np.empty(0, np.bool_)
        return Nodes(flags, flags, none, none.reshape(0, 2), none.reshape(0, 2, 2), 0)
    first, seen, off, xy, cov, skipped = zip(*parts, strict=True)
    join = np.concatenate
    return Nodes(join(first), join(seen), join(off), join(xy), join(cov), sum(skipped))


def split(path: MeasuredPath, longest_gap_s: float) -> list[MeasuredPath]:
    """Return the parts of a path between gaps longer than `longest_gap_s` [s], in the order of time."""
    cuts = np.flatnonzero(np.diff(path.t_ns) > longest_gap_s * 1e9 * (1.0 + 1e-9)) + 1
    bounds = [0, *cuts.tolist(), len(path.t_ns)]
    return [
        MeasuredPath(path.t_ns[a:b], path.xy[a:b], None if path.cov is None else path.cov[a:b])
        for a, b in itertools.pairwise(bounds)
    ]


def _nodes_of(path: MeasuredPath, step_s: float) -> Nodes | None:
    """Return one trajectory on its grid of steps of `step_s` [s], starting at its first position.

    A position belongs to the nearest node; of several the nearest in time is used. None if only one node is measured.
    """
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


def transitions_by_differences(
    paths: Iterable[MeasuredPath], step_s: float, longest_gap_s: float
) -> tuple[Floats, Floats]:
    """Return M states (M, 4) x, vx, y, vy from central differences, and the states (M, 4) one step later.

    Velocities are per step of `step_s` [s]. Positions are interpolated linearly to equal steps, over gaps of at most
    `BRIDGED` steps; paths are cut at gaps longer than `longest_gap_s` [s].
    """
    pairs = [_pairs(piece, step_s) for path in paths for piece in split(path, longest_gap_s)]
    if not pairs:
        return np.empty((0, 4)), np.empty((0, 4))
    return np.concatenate([a for a, _ in pairs]), np.concatenate([b for _, b in pairs])


def _pairs(path: MeasuredPath, step_s: float) -> tuple[Floats, Floats]:
    """Return the states (M, 4) x, vx, y, vy of one path by central differences, and the states one step later.

    Velocities are per step of `step_s` [s]; empty for paths shorter than 3 steps.
    """
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
