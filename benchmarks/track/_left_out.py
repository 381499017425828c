"""Groups of boxes of the other cameras, triangulated: what predicts a left-out camera's boxes without any tracking.

In each frame the middles of two cameras' boxes are triangulated; a pair whose sight lines miss them by at most
`LIMIT_PX` at a height that a person's middle can have begins a group, which every further camera joins with the box
nearest to where the place is in its image.  Groups of most cameras and of least error come first, and each box is in
one group.
"""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats

LIMIT_PX = 60.0
LOW, HIGH = 0.3, 1.6
"""Height of the middle of a box above the floor [m]."""


class Group(NamedTuple):
    """Boxes of one person by camera, their place in the world and the largest error of a box [px]."""

    boxes: dict[int, int]
    place: Floats  # (3,)
    error: float


def triangulated(matrices: list[Floats], pixels: list[Floats]) -> Floats:
    """(3,) the point that linear triangulation (Hartley and Sturm 1997) gives of N cameras' pixels (2,)."""
    rows = [row for P, (u, v) in zip(matrices, pixels, strict=True) for row in (u * P[2] - P[0], v * P[2] - P[1])]
    scaled = [row / np.linalg.norm(row[:3]) for row in rows]
    x = np.linalg.svd(np.array(scaled))[2][-1]
    return np.asarray(x[:3] / x[3])


def projected(matrix: Floats, position: Floats) -> Floats:
    """(2,) pixels of a place (3,)."""
    p = matrix @ np.append(position, 1.0)
    return np.asarray(p[:2] / p[2])


def groups(middles: dict[int, Floats], matrices: dict[int, Floats]) -> list[Floats]:
    """Places (3,) of the groups of one frame; `middles` are (n, 2) by camera."""
    found = []
    for a, b in combinations(sorted(middles), 2):
        for i in range(len(middles[a])):
            for j in range(len(middles[b])):
                group = _grown({a: i, b: j}, middles, matrices)
                if group is not None:
                    found.append(group)
    found.sort(key=lambda g: (-len(g.boxes), g.error))
    used: set[tuple[int, int]] = set()
    out = []
    for group in found:
        if used.isdisjoint(group.boxes.items()):
            used |= set(group.boxes.items())
            out.append(group.place)
    return out


def _grown(boxes: dict[int, int], middles: dict[int, Floats], matrices: dict[int, Floats]) -> Group | None:
    """The group that begins with two boxes, with those of other cameras that agree; None if the two do not."""
    group = _fitted(boxes, middles, matrices)
    for camera in sorted(set(middles) - set(boxes)):
        if group is None or not len(middles[camera]):
            continue
        away = np.linalg.norm(middles[camera] - projected(matrices[camera], group.place), axis=1)
        wider = _fitted({**group.boxes, camera: int(away.argmin())}, middles, matrices)
        group = wider or group
    return group


def _fitted(boxes: dict[int, int], middles: dict[int, Floats], matrices: dict[int, Floats]) -> Group | None:
    used = sorted(boxes)
    pixels = [middles[c][boxes[c]] for c in used]
    position = triangulated([matrices[c] for c in used], pixels)
    errors = [float(np.linalg.norm(projected(matrices[c], position) - p)) for c, p in zip(used, pixels, strict=True)]
    return Group(boxes, position, max(errors)) if max(errors) <= LIMIT_PX and LOW <= position[2] <= HIGH else None
