"""Non-maximum suppression: of boxes that cover each other the most confident one."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats, Ints


def suppress(boxes: Floats, score: Floats, label: Ints, overlap: float) -> Ints:
    """Places of the boxes that stay, by falling score.

    Greedy, within each class: a box goes where its intersection over union with one that stays is above `overlap`.  Of
    equal scores the earlier box comes first.

    Args:
        boxes: (n, 4) left, top, right, bottom.
        score: (n,).
        label: (n,) classes.
        overlap: 0 to 1.
    """
    left, top, right, bottom = boxes.T
    area = (right - left) * (bottom - top)
    rest = np.argsort(-score, kind="stable")
    kept = []
    while len(rest):
        best, rest = rest[0], rest[1:]
        kept.append(best)
        width = np.minimum(right[best], right[rest]) - np.maximum(left[best], left[rest])
        height = np.minimum(bottom[best], bottom[rest]) - np.maximum(top[best], top[rest])
        shared = np.maximum(width, 0.0) * np.maximum(height, 0.0)
        # shared / union > overlap, without a division by an area of 0
        covered = shared > overlap * (area[best] + area[rest] - shared)
        rest = rest[~(covered & (label[rest] == label[best]))]
    return np.array(kept, dtype=np.int64)
