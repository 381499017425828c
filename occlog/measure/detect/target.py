"""Which region is the target: by appearance, and among equals by where it was last seen."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.measure.regions.appearance import likeness
from occlog.measure.regions.regions import Regions

from .config import DetectConfig

JUMP = 2.0  # standard deviations of a person's width that a step of the target may be long and still count as close


@dataclass
class Memory:
    """Where one camera last saw each target: target's number to time, x, y."""

    last: dict[int, tuple[int, float, float]] = field(default_factory=dict)


def likenesses(appearance: Floats, config: DetectConfig) -> Floats:
    """(K, T) likeness of regions (K, 72) to each target: the best of the target's appearances, NaN if unknown."""
    columns = [likeness(appearance, target.appearances).max(axis=1, initial=-np.inf) for target in config.targets]
    return np.column_stack(columns) if columns else np.empty((len(appearance), 0))


def choose(t_ns: int, regions: Regions, like: Floats, memory: Memory, config: DetectConfig) -> Ints:
    """(T,) region of each target in one frame, -1 = not seen; `memory` is brought up to date.

    With appearances, pairs of target and region are taken in falling order of likeness
    plus `margin` times closeness, each region for one target at most, as long as the
    likeness reaches its least value.  Without, the one target is the region with the
    most foreground, times 1 + closeness so that it does not change between similar ones.
    A region that is much larger than a person is no target.

    Args:
        t_ns: time of the frame.
        regions: K regions.
        like: (K, T) likenesses; ignored without targets.
        memory: of the camera.
        config: options.
    """
    n_targets = max(len(config.targets), 1)
    close = np.column_stack([_closeness(t_ns, regions, memory.last.get(n), config) for n in range(n_targets)])
    chosen = np.full(n_targets, -1, dtype=np.int64)
    plausible = regions.fill <= config.most
    if not plausible.any():
        return chosen
    if not config.targets:
        chosen[0] = int(np.argmax(np.where(plausible, regions.mass * (1.0 + close[:, 0]), -np.inf)))
    else:
        good = plausible[:, None] & (like >= config.likeness)
        score = np.where(good, like + config.margin * close, -np.inf)
        while (best := np.unravel_index(int(np.argmax(score)), score.shape)) and score[best] > -np.inf:
            k, n = int(best[0]), int(best[1])
            chosen[n] = k
            score[k, :] = score[:, n] = -np.inf
    for n in np.flatnonzero(chosen >= 0).tolist():
        x, y = regions.means[chosen[n]].tolist()
        memory.last[n] = (t_ns, x, y)
    return chosen


def _closeness(t_ns: int, regions: Regions, last: tuple[int, float, float] | None, config: DetectConfig) -> Floats:
    """(K,) 1 where the target was last seen, falling to 0 with distance; 0 everywhere if that is long ago."""
    if last is None or (t_ns - last[0]) * 1e-9 > config.memory_s:
        return np.zeros(len(regions.mass))
    widths = np.sqrt(regions.person[:, 0])
    far = np.hypot(regions.means[:, 0] - last[1], regions.means[:, 1] - last[2]) / (JUMP * widths)
    closeness: Floats = np.exp(-0.5 * far**2)
    return closeness
