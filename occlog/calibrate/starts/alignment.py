"""Relative poses and clock offsets of cameras, from paths of people on the ground.

Each camera has paths in its own level frame (`occlog.calibrate.starts.ground_plane`). Two paths of one person are
congruent: a rotation, a translation and a clock offset map one to the other. Every pair of paths proposes such a map
(in closed form, for all pairs at once), and the proposal with most support over all times is taken. Cameras are joined
along the pairs with most support.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from occlog.array_types import Floats, Ints

Complexes = NDArray[np.complex128]

MIN_OVERLAP_S, MIN_SAMPLES = 3.0, 6
"""Two paths propose an alignment if they overlap for this long, by as many samples, ..."""
MIN_SPREAD_HEIGHTS = 0.5
"""... are spread by as many heights of a person (root mean square), ..."""
MAX_RESIDUAL_RATIO = 0.35
"""... and are congruent to this share of the spread."""
MATCH_HEIGHTS = 0.5
"""Two cameras agree about a person if their positions are this near, in heights of people."""
MAX_PROPOSALS = 150
"""Proposals of a pair of cameras that are judged."""
MAX_TIMES = 80
"""Times at which a proposal is judged, evenly spread."""
MIN_SUPPORT, MIN_SHARE = 15.0, 0.2
"""Agreements beyond chance, and their share of those possible, from which a pair of cameras is aligned."""
ROUNDS = 4
"""Refinements of a proposal by all the people who agree."""


class PlanarPose(NamedTuple):
    """Planar pose of a camera's level frame in a reference frame, and the offset between their clocks.

    Attributes:
        yaw: yaw of the camera [rad].
        position: x + i y of the point below the camera.
        late: delay of the camera's clock relative to that of the reference [steps of the time grid].
    """

    yaw: float
    position: complex
    late: float

    def of(self, inner: PlanarPose) -> PlanarPose:
        """Compose two poses: that of `inner`, given in this camera's frame, in this pose's reference frame."""
        turned = self.position + np.exp(1j * self.yaw) * inner.position
        return PlanarPose(self.yaw + inner.yaw, complex(turned), self.late + inner.late)

    def inverse(self) -> PlanarPose:
        """Inverse: pose and clock offset of the reference frame in this camera's frame."""
        return PlanarPose(-self.yaw, complex(-np.exp(-1j * self.yaw) * self.position), -self.late)


class PairAlignment(NamedTuple):
    """Estimated pose of camera b in the level frame of camera a, with its support.

    Attributes:
        a: index of a camera.
        b: index of another one.
        pose: planar pose of b in the level frame of a.
        support: number of agreeing positions beyond chance.
        share: share of the possible number, 0 to 1.
    """

    a: int
    b: int
    pose: PlanarPose
    support: float
    share: float


def align_pair(
    a: Complexes,
    b: Complexes,
    step_s: float,
    person_height: float,
    max_late: int,
    rough: PlanarPose | None = None,
    tolerance: tuple[float, float] = (np.inf, np.inf),
) -> tuple[PlanarPose, float, float] | None:
    """Find the relative planar pose and clock offset of two cameras with most support by common people.

    Args:
        a: (A, T) x + i y of the A paths of a camera on a grid of times, in its level frame; NaN: absent.
        b: (B, T) x + i y of the B paths of another camera, in its level frame.
        step_s: step of the grid [s].
        person_height: height of a person, in the unit of the positions.
        max_late: largest clock offset that is tried [steps].
        rough: stated pose of b in the frame of a; None: none.
        tolerance: largest differences from it: yaw [rad] and position.

    Returns:
        Pose of b in a, number of agreeing positions beyond chance, and its share of those possible; None if no paths
        agree in shape and no pose is stated.
    """
    found: list[tuple[Floats, Ints, Floats, Complexes]] = []
    for late in range(-max_late, max_late + 1):
        part = _proposals(a, _shifted(b, late), step_s, person_height)
        weight, yaw, position = part
        good = np.ones(len(weight), dtype=np.bool_)
        if rough is not None:
            away = np.angle(np.exp(1j * (yaw - rough.yaw)))
            good = (np.abs(away) <= tolerance[0]) & (np.abs(position - rough.position) <= tolerance[1])
        found.append((weight[good], np.full(np.count_nonzero(good), late), yaw[good], position[good]))
    if rough is not None:
        lates = np.arange(-max_late, max_late + 1)
        n = len(lates)
        found.append(
            (np.full(n, np.inf), lates, np.full(n, rough.yaw), np.full(n, rough.position, dtype=np.complex128))
        )
    weights, offsets, yaws, positions = (np.concatenate(part) for part in zip(*found, strict=True))
    order = np.argsort(-weights, kind="stable")[: MAX_PROPOSALS + (0 if rough is None else 2 * max_late + 1)]
    there, seen = _by_time(a), _by_time(b)
    best: tuple[PlanarPose, float, float] | None = None
    for k in order.tolist():
        pose = PlanarPose(float(yaws[k]), complex(positions[k]), float(offsets[k]))
        support, share = _support(there, seen, pose, person_height)
        if best is None or support > best[1]:
            best = pose, support, share
    if best is None:
        return None
    for _ in range(ROUNDS):
        for change in (0, 1, -1):
            tried = best[0]._replace(late=best[0].late + change)
            if abs(tried.late) > max_late:
                continue
            pose = _refined(there, seen, tried, person_height)
            support, share = _support(there, seen, pose, person_height)
            if support > best[1]:
                best = pose, support, share
    return best


def _shifted(paths: Complexes, late: int) -> Complexes:
    """Paths (n, T) shifted by `late` steps: the samples of a clock with that delay, at the times of the other clock.

    NaN where there are none.
    """
    out = np.full_like(paths, np.nan)
    if late >= 0:
        out[:, : paths.shape[1] - late] = paths[:, late:]
    else:
        out[:, -late:] = paths[:, :late]
    return out


def _proposals(a: Complexes, b: Complexes, step_s: float, person_height: float) -> tuple[Floats, Floats, Complexes]:
    """Weights, yaws [rad] and translations (n,) of the planar congruences that map paths of b to paths of a.

    One for each pair of paths that agree in shape; translations are x + i y.

    Args:
        a: (A, T) x + i y of paths; NaN: absent.
        b: (B, T) x + i y of paths in the frame of the other camera.
        step_s: time step [s].
        person_height: height of a person, in the unit of the positions.
    """
    there_a, there_b = np.isfinite(a), np.isfinite(b)
    za, zb = np.where(there_a, a, 0.0), np.where(there_b, b, 0.0)
    ma, mb = there_a.astype(np.float64), there_b.astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        n = ma @ mb.T
        sum_a, sum_b = za @ mb.T, ma @ zb.T
        cross = za @ np.conj(zb).T - sum_a * np.conj(sum_b) / n
        square_a = (np.abs(za) ** 2) @ mb.T - np.abs(sum_a) ** 2 / n
        square_b = ma @ (np.abs(zb) ** 2).T - np.abs(sum_b) ** 2 / n
        residual = np.maximum(square_a + square_b - 2.0 * np.abs(cross), 0.0) / n
        spread = np.minimum(square_a, square_b) / n
        good = (n >= max(MIN_SAMPLES, MIN_OVERLAP_S / step_s)) & (spread >= (MIN_SPREAD_HEIGHTS * person_height) ** 2)
        good &= residual <= MAX_RESIDUAL_RATIO**2 * spread
        yaw = np.angle(cross[good])
        position = (sum_a[good] - np.exp(1j * yaw) * sum_b[good]) / n[good]
        weight = n[good] * np.log(spread[good] / (residual[good] + (0.05 * person_height) ** 2))
    return weight, yaw, position


def _by_time(paths: Complexes) -> Complexes:
    """(K, T) positions present at each time, without the absent ones; padded with NaN. `paths` is (n, T), n >= K."""
    there = np.isfinite(paths)
    most = int(there.sum(axis=0).max(initial=0))
    order = np.argsort(~there, axis=0, kind="stable")[:most]
    return np.take_along_axis(paths, order, axis=0)


def _support(a: Complexes, b: Complexes, pose: PlanarPose, person_height: float) -> tuple[float, float]:
    """Number of agreeing positions beyond chance for a pose of b in a, and its share of the possible number.

    Args:
        a: (A, T) x + i y of paths; NaN: absent.
        b: (B, T) x + i y of paths in the frame of the other camera.
        pose: pose of b in the frame of a.
        person_height: height of a person, by which the distance of agreeing positions is limited.
    """
    moved = pose.position + np.exp(1j * pose.yaw) * _shifted(b, round(pose.late))
    filled = np.flatnonzero(np.isfinite(a).any(axis=0) & np.isfinite(moved).any(axis=0))
    if len(filled) < 2:
        return 0.0, 0.0
    at = filled[np.unique(np.linspace(0, len(filled) - 1, MAX_TIMES).round().astype(np.int64))]
    other = np.roll(at, len(at) // 2)
    met = _mutual(a[:, at], moved[:, at], MATCH_HEIGHTS * person_height)
    chance = _mutual(a[:, at], moved[:, other], MATCH_HEIGHTS * person_height)
    scale = len(filled) / len(at)
    support = float(np.count_nonzero(met) - np.count_nonzero(chance)) * scale
    possible = np.minimum(np.isfinite(a[:, at]).sum(axis=0), np.isfinite(moved[:, at]).sum(axis=0)).sum() * scale
    return support, support / max(float(possible), 1.0)


def _mutual(a: Complexes, b: Complexes, limit: float) -> NDArray[np.bool_]:
    """(A, B, T) mask of mutual nearest neighbours of positions a (A, T) and b (B, T), within a distance limit.

    Positions are complex; NaN: absent.
    """
    if not (len(a) and len(b)):
        return np.zeros((len(a), len(b), a.shape[1]), dtype=np.bool_)
    gap = a[:, None] - b[None]
    away = gap.real**2 + gap.imag**2
    away[~np.isfinite(away)] = np.inf
    first = away <= away.min(axis=0)
    second = away <= away.min(axis=1)[:, None]
    return np.asarray(first & second & (away <= limit**2))


def _refined(a: Complexes, b: Complexes, pose: PlanarPose, person_height: float) -> PlanarPose:
    """Refine a pose by least squares over all positions that agree (inliers); unchanged if there are too few.

    The clock offset is kept.

    Args:
        a: (A, T) x + i y of paths; NaN: absent.
        b: (B, T) x + i y of paths in the frame of the other camera.
        pose: pose of b in the frame of a.
        person_height: height of a person, in the unit of the positions.
    """
    late = _shifted(b, round(pose.late))
    moved = pose.position + np.exp(1j * pose.yaw) * late
    i, j, t = np.nonzero(_mutual(a, moved, MATCH_HEIGHTS * person_height))
    if len(t) < MIN_SAMPLES:
        return pose
    p, q = a[i, t], late[j, t]
    yaw = float(np.angle(((p - p.mean()) * np.conj(q - q.mean())).sum()))
    return PlanarPose(yaw, complex(p.mean() - np.exp(1j * yaw) * q.mean()), pose.late)


def joined(count: int, pairs: Sequence[PairAlignment]) -> list[PlanarPose | None]:
    """Planar poses of all cameras in the frame of the one with most support; None for cameras not connected to it.

    Along the spanning tree with the largest support. `count` is the number of cameras; pairs with too little
    support are ignored.
    """
    good = [each for each in pairs if each.support >= MIN_SUPPORT and each.share >= MIN_SHARE]
    poses: list[PlanarPose | None] = [None] * count
    if not good:
        return poses
    weight = np.zeros((count, count))
    for each in good:
        weight[each.a, each.b] = weight[each.b, each.a] = each.support
    root = int(np.argmax(weight.sum(axis=0)))
    # Costs must not be 0, which is no edge
    largest = weight.max() + 1.0
    tree = minimum_spanning_tree(csr_array(np.where(np.triu(weight) > 0.0, largest - np.triu(weight), 0.0)))
    order, before = breadth_first_order(tree, root, directed=False)
    poses[root] = PlanarPose(0.0, 0.0 + 0.0j, 0.0)
    by_pair = {(each.a, each.b): each.pose for each in good}
    for k in order[1:].tolist():
        parent = int(before[k])
        inner = by_pair.get((parent, k)) or by_pair[k, parent].inverse()
        outer = poses[parent]
        poses[k] = None if outer is None else outer.of(inner)
    return poses
