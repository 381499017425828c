"""Choose the region of each target: by appearance, and among equals by where the target was last seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.errors import InputError, UsageError
from occlog.measure.regions.appearance import likeness
from occlog.measure.regions.regions import Regions
from occlog.records.tables import APPEARANCE_BINS

from ..config import MARGIN, MEMORY_S, MOST

JUMP = 2.0
"""Distance from its last place at which a target's closeness is exp(-1/2), in spreads of a person's width."""


@dataclass(frozen=True, eq=False)
class Target:
    """A person to look for, known by appearance; InputError where a row of `appearances` is no histogram."""

    target_id: int
    appearances: Floats  # (n, 72) histograms of one person, in several views or lights

    def __post_init__(self) -> None:
        a = self.appearances
        ok = a.ndim == 2 and a.shape[1:] == (APPEARANCE_BINS,) and len(a) > 0 and np.isfinite(a).all()
        if not (ok and (a >= 0).all() and np.allclose(a.sum(axis=1), 1.0, atol=1e-3)):
            raise InputError(
                f"target {self.target_id}: an appearance must be {APPEARANCE_BINS} numbers of at least 0 "
                f"that sum to 1; got an array of shape {a.shape}"
            )


def check_targets(targets: Sequence[Target]) -> None:
    """UsageError where two targets have the same identity."""
    ids = [t.target_id for t in targets]
    if len(set(ids)) < len(ids):
        raise UsageError(f"detect: target ids {ids} repeat; give each target its own")


@dataclass
class TargetMemory:
    """The place where one camera last saw each target: number of the target to time [ns], x and y [px]."""

    last: dict[int, tuple[int, float, float]] = field(default_factory=dict)


def likenesses(appearance: Floats, targets: Sequence[Target]) -> Floats:
    """(K, T) likeness of regions (K, 72) to each target: that to its best appearance, NaN where a row has NaN."""
    columns = [likeness(appearance, target.appearances).max(axis=1, initial=-np.inf) for target in targets]
    return np.column_stack(columns) if columns else np.empty((len(appearance), 0))


def choose(
    t_ns: int,
    regions: Regions,
    like: Floats,
    memory: TargetMemory,
    least_likeness: float,
    allowed: Bools | None = None,
) -> Ints:
    """Choose the region of each target in one frame, and update `memory`.

    With appearances, pairs of target and region are taken greedily in falling order of
    likeness plus `MARGIN` times closeness, each region for one target at most, while the
    likeness is at least `least_likeness`.  Without appearances there is one target: the
    region with the most foreground times 1 + closeness, so that it does not change between
    regions of about the same size.  A region of more than `MOST` persons' pixels is no target.

    Args:
        t_ns: time of the frame.
        regions: K regions.
        like: (K, T) likenesses; (K, 0) where no appearance is known.
        memory: of the camera.
        least_likeness: 0 to 1.
        allowed: (K, max(T, 1)) regions that may be of each target; None: all.

    Returns:
        (max(T, 1),) number of each target's region, -1 for a target that is not seen.
    """
    n_targets = max(like.shape[1], 1)
    close = np.column_stack([_closeness(t_ns, regions, memory.last.get(n)) for n in range(n_targets)])
    chosen = np.full(n_targets, -1, dtype=np.int64)
    # Gate: leave out regions that are much larger than a person.
    plausible = np.repeat((regions.fill <= MOST)[:, None], n_targets, axis=1)
    if allowed is not None:
        plausible &= allowed
    if not plausible.any():
        return chosen
    if not like.shape[1]:
        chosen[0] = int(np.argmax(np.where(plausible[:, 0], regions.mass * (1.0 + close[:, 0]), -np.inf)))
    else:
        # Assign greedily: the pair of region and target with the highest score first.
        good = plausible & (like >= least_likeness)
        score = np.where(good, like + MARGIN * close, -np.inf)
        while (best := np.unravel_index(int(np.argmax(score)), score.shape)) and score[best] > -np.inf:
            k, n = int(best[0]), int(best[1])
            chosen[n] = k
            score[k, :] = score[:, n] = -np.inf
    for n in np.flatnonzero(chosen >= 0).tolist():
        x, y = regions.means[chosen[n]].tolist()
        memory.last[n] = (t_ns, x, y)
    return chosen


def _closeness(t_ns: int, regions: Regions, last: tuple[int, float, float] | None) -> Floats:
    """(K,) closeness to the target's last place: 1 there, exp(-far^2 / 2) around it; 0 after `MEMORY_S`."""
    if last is None or (t_ns - last[0]) * 1e-9 > MEMORY_S:
        return np.zeros(len(regions.mass))
    widths = np.sqrt(regions.person[:, 0])
    far = np.hypot(regions.means[:, 0] - last[1], regions.means[:, 1] - last[2]) / (JUMP * widths)
    closeness: Floats = np.exp(-0.5 * far**2)
    return closeness
