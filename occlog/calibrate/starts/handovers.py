"""Relative poses of cameras that share no view, from walkers who pass from one view to the next.

Rahimi, Dunagan and Darrell (CVPR 2004) estimate poses and trajectories jointly: a person who is not seen goes on about
as before, so that where and how they leave one view and enter the next determine the relative pose of two cameras. Here
is where that search starts: each handover from view to view states a relative pose, spanning trees of random handovers
state poses of all cameras, and those that most handovers agree with are refined by robust least squares.

Who passes is decided by time: a track continues the one that ended before it, if only one can be meant.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from occlog.array_types import Bools, Floats, Ints

from ..people import Tracklet
from .alignment import Complexes, PlanarPose

DENSITY, SIGMA_POSITION, SIGMA_SPEED = 0.03, 0.15, 0.12
"""Spectral density of the acceleration between views [m^2/s^3], and standard deviations of positions [m] and velocities
[m/s] at the ends of tracks, per axis: of the search alone."""
DEGREES = 3.0
"""Degrees of freedom of the t distribution of what is off at a handover: people may turn where no camera sees them."""
MAX_OVERLAP_S = 0.5
"""Time for which both views may see a person who passes [s]."""
TREES, REFINED = 3000, 8
"""Random spanning trees, and how many of the best are refined."""
MIN_HANDOVERS = 3
"""Handovers that a camera has, at least: fewer do not tell which of them is false."""
MAX_COST_GAP = 3.0
"""Logarithm of the likelihood ratio from which the best poses are preferred to others."""
SAME_YAW, SAME_POSITION = np.radians(15.0), 1.5
"""Two solutions are one if no camera differs by more [rad, m]."""


class Handovers(NamedTuple):
    """H handovers from one view to the next, each in the level frames of the two cameras.

    Attributes:
        camera: (H, 2) cameras that the person leaves and enters.
        seconds: (H,) time between the two positions [s].
        position: (H, 2) complex positions at leaving and entering.
        velocity: (H, 2) complex velocities there, per second.
    """

    camera: Ints
    seconds: Floats
    position: Complexes
    velocity: Complexes


def walkers(tracklets: Sequence[Tracklet], max_gap_s: float) -> tuple[Ints, int]:
    """Join tracks of different cameras that follow one another in time.

    Args:
        tracklets: n tracks of all cameras.
        max_gap_s: longest time between two views [s].

    Returns:
        (n,) index of the person of each track, and the number of handovers that are omitted because another person
        was seen meanwhile, or two tracks may be continued.
    """
    begin, end = (np.array([t.t_s[k] for t in tracklets]) for k in (0, -1))
    camera = np.array([t.camera for t in tracklets])
    person, ambiguous = np.arange(len(tracklets)), 0
    for j in np.argsort(begin, kind="stable").tolist():
        before = (begin < begin[j]) & (end <= begin[j] + MAX_OVERLAP_S) & (begin[j] - end <= max_gap_s)
        if not before.any():
            continue
        i = int(np.argmax(np.where(before, end, -np.inf)))
        # A person alone is seen by no camera meanwhile, and whoever ended before was continued by track i
        meanwhile = (end > end[i]) & (begin < begin[j])
        meanwhile[[i, j]] = False
        rivals = before & (end > begin[i] + MAX_OVERLAP_S)
        rivals[i] = False
        starts = (begin >= end[i]) & (begin <= begin[j])
        starts[j] = False
        if meanwhile.any() or rivals.any() or starts.any():
            ambiguous += 1
        elif camera[i] != camera[j]:
            person[j] = person[i]
    return person, ambiguous


def handovers(tracklets: Sequence[Tracklet], velocities: Sequence[Complexes], person: Ints) -> Handovers:
    """Handovers of persons between successive tracks.

    Args:
        tracklets: n tracks in the level frames of their cameras.
        velocities: of each, complex, at its times.
        person: (n,) index of the person of each.
    """
    camera, seconds, ends = [], [], []
    for k in np.unique(person).tolist():
        own = sorted(np.flatnonzero(person == k).tolist(), key=lambda i: float(tracklets[i].t_s[0]))
        for i, j in pairwise(own):
            a, b = tracklets[i], tracklets[j]
            camera.append((a.camera, b.camera))
            seconds.append(b.t_s[0] - a.t_s[-1])
            ends.append((a.xy[-1], b.xy[0], velocities[i][-1], velocities[j][0]))
    both = np.array(ends, dtype=np.complex128).reshape(-1, 4)
    return Handovers(np.array(camera, dtype=np.int64).reshape(-1, 2), np.array(seconds), both[:, :2], both[:, 2:])


def poses_of_handovers(seen: Handovers, count: int, metre: float, rng: np.random.Generator) -> list[PlanarPose | None]:
    """Poses of cameras in a common frame that most handovers agree with.

    Args:
        seen: handovers.
        count: number of cameras.
        metre: a metre in the unit of the positions.
        rng: draws spanning trees.

    Returns:
        For each camera its pose, without an offset of clocks; None: it is not connected with the others by three
        handovers, or other poses explain them about as well.
    """
    used = _connected(seen.camera, count)
    own = np.flatnonzero(used)
    poses: list[PlanarPose | None] = [None] * count
    keep = used[seen.camera].all(axis=1)
    if len(own) < 2:
        return poses
    number = np.cumsum(used) - 1
    part = Handovers(number[seen.camera[keep]], seen.seconds[keep], seen.position[keep], seen.velocity[keep])
    tried = [_tree(part, len(own), rng.permutation(len(part.seconds))) for _ in range(TREES)]
    costs = np.array([np.sum(_residuals(part, yaw, at, metre) ** 2) for yaw, at in tried])
    found = [_refined(part, tried[k], metre) for k in np.argsort(costs, kind="stable")[:REFINED].tolist()]
    best = min(found, key=lambda each: each[0])
    doubtful = np.zeros(len(own), dtype=np.bool_)
    for cost, yaw, at in found:
        if cost < best[0] + MAX_COST_GAP:
            doubtful |= np.abs(np.angle(np.exp(1j * (yaw - best[1])))) > SAME_YAW
            doubtful |= np.abs(at - best[2]) > SAME_POSITION * metre
    for k, c in enumerate(own.tolist()):
        poses[c] = None if doubtful[k] else PlanarPose(float(best[1][k]), complex(best[2][k]), 0.0)
    return poses


def _connected(camera: Ints, count: int) -> Bools:
    """(C,) mask of the cameras that are joined with most others by handovers (H, 2), by three or more each."""
    used = np.ones(count, dtype=np.bool_)
    while True:
        kept = camera[used[camera].all(axis=1)]
        few = used & (np.bincount(kept.ravel(), minlength=count) < MIN_HANDOVERS)
        if not few.any():
            break
        used &= ~few
    group = np.arange(count)
    for a, b in kept.tolist():
        group[group == group[b]] = group[a]
    sizes = np.bincount(group[used], minlength=count)
    return np.asarray(used & (group == int(np.argmax(sizes))))


def _tree(seen: Handovers, count: int, order: Ints) -> tuple[Floats, Complexes]:
    """Yaws (C,) [rad] and complex positions (C,) of cameras along the spanning tree of the first handovers in an order.

    The first camera is at the origin.
    """
    yaw, at, group = np.zeros(count), np.zeros(count, dtype=np.complex128), np.arange(count)
    for h in order.tolist():
        a, b = seen.camera[h].tolist()
        if group[a] == group[b]:
            continue
        # Where the person is straight on, in the frame of a; then all cameras of the group of b move
        turn = np.angle(seen.velocity[h, 0]) - np.angle(seen.velocity[h, 1])
        mean = 0.5 * (seen.velocity[h, 0] + np.exp(1j * turn) * seen.velocity[h, 1])
        shift = seen.position[h, 0] + seen.seconds[h] * mean - np.exp(1j * turn) * seen.position[h, 1]
        turn, shift = yaw[a] + turn, at[a] + np.exp(1j * yaw[a]) * shift
        moved, back = group == group[b], turn - yaw[b]
        at[moved] = shift + np.exp(1j * back) * (at[moved] - at[b])
        yaw[moved] += back
        group[moved] = group[a]
    return yaw - yaw[0], np.exp(-1j * yaw[0]) * (at - at[0])


def _residuals(seen: Handovers, yaw: Floats, at: Complexes, metre: float) -> Floats:
    """(H, 4) residuals of handovers by the poses; their sum of squares is that of minus twice the log density.

    The motion is white acceleration: the change of the velocity, and the way less the mean velocity times the time, are
    independent. Densities are of the t distribution.
    """
    turn, T, span = np.exp(1j * yaw[seen.camera]), seen.seconds, np.abs(seen.seconds)
    p, v = at[seen.camera] + turn * seen.position, turn * seen.velocity
    sigma_v = np.sqrt(2.0 * SIGMA_SPEED**2 + DENSITY * span) * metre
    sigma_p = np.sqrt(2.0 * SIGMA_POSITION**2 + 0.5 * (SIGMA_SPEED * T) ** 2 + DENSITY * span**3 / 12.0) * metre
    off = np.column_stack([(v[:, 1] - v[:, 0]) / sigma_v, (p[:, 1] - p[:, 0] - T * v.mean(axis=1)) / sigma_p])
    square = np.maximum((np.abs(off) ** 2).sum(axis=1), 1e-12)
    root = np.sqrt((DEGREES + 4.0) * np.log1p(square / DEGREES) / square)[:, None]
    return np.hstack([off.real * root, off.imag * root])


def _refined(seen: Handovers, start: tuple[Floats, Complexes], metre: float) -> tuple[float, Floats, Complexes]:
    """Cost, yaws [rad] and complex positions of a local optimum near a start (yaws, positions); camera 0 is held."""
    yaw, at = start
    n = len(yaw) - 1

    def of(values: Floats) -> tuple[Floats, Complexes]:
        turned, x, y = values.reshape(3, n)
        return np.append(0.0, turned), np.append(0.0, metre * (x + 1j * y))

    def residuals(values: Floats) -> Floats:
        return _residuals(seen, *of(values), metre).ravel()

    begin = np.concatenate([yaw[1:], at[1:].real / metre, at[1:].imag / metre])
    found = least_squares(residuals, begin, max_nfev=50)
    return float(found.cost), *of(found.x)
