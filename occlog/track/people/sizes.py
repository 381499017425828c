"""How tall people are by their boxes and the cameras' poses: the unit of a scene, and calibrations that cannot be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from occlog.array_types import Floats
from occlog.records.scene import Camera
from occlog.settings import LENGTH_POWER, Settings, declaration, declared

from .boxes_by_moment import FrameLook

S = TypeVar("S", bound=Settings)

FEWEST = 10
"""Of fewer boxes of a camera nothing is said."""
BORDER_PX = 3.0
"""A box this near to the lower or upper border of the image may be cut by it."""
APART = 1.6
"""A camera in which people are so many times taller or shorter than in the others is not calibrated as they are."""
WRONG = 2.5
"""People so many times taller or shorter than stated are not people: the unit of the scene is another one."""


NOBODYS = 10.0
"""Nobody, not even a child or a tall machine, is so many times taller or shorter than people usually are."""


def statures(looks: Sequence[FrameLook], cameras: Sequence[Camera]) -> Floats:
    """(C,) median height of who is in the boxes of each camera, in the scene's unit; NaN where few boxes tell.

    The feet are at the middle of the lower edge, on the floor; the head is above them, in the row of the upper edge.
    """
    out = np.full(len(cameras), np.nan)
    for c, camera in enumerate(cameras):
        boxes = np.concatenate([np.zeros((0, 4)), *(each.look.boxes for each in looks if each.look.camera == c)])
        heights = _statures(boxes, camera)
        if len(heights) >= FEWEST:
            out[c] = np.median(heights)
    return out


def _statures(boxes: Floats, camera: Camera) -> Floats:
    """(k,) heights of the k boxes whose feet are on the floor and that no border cuts."""
    left, top, right, bottom = boxes.T
    if camera.image_size is not None:
        whole = (bottom < camera.image_size[1] - 1 - BORDER_PX) & (top > BORDER_PX)
        left, top, right, bottom = (edge[whole] for edge in (left, top, right, bottom))
    middle = 0.5 * (left + right)
    feet, head = camera.rays(np.column_stack([middle, bottom])), camera.rays(np.column_stack([middle, top]))
    with np.errstate(divide="ignore", invalid="ignore"):
        away = -camera.position[2] / feet[:, 2] * np.hypot(feet[:, 0], feet[:, 1])
        heights = camera.position[2] + away * head[:, 2] / np.hypot(head[:, 0], head[:, 1])
    good: Floats = heights[(feet[:, 2] < 0) & np.isfinite(heights) & (heights > 0)]
    return good


def typical(heights: Floats) -> float:
    """Median over the cameras that tell; NaN where none does."""
    told = heights[np.isfinite(heights)]
    return float(np.median(told)) if len(told) else float("nan")


def odd_cameras(heights: Floats) -> Mapping[int, float]:
    """Cameras in which people are `APART` times as tall or as short as in the median of the others, and how tall."""
    found = {}
    for c in np.flatnonzero(np.isfinite(heights)).tolist():
        others = typical(np.delete(heights, c))
        if np.isfinite(others) and not 1.0 / APART < heights[c] / others < APART:
            found[c] = float(heights[c])
    return found


def in_units_of(config: S, metre: float) -> S:
    """The settings with every length, stated in metres, in a unit of which so many are a metre."""
    changed = {}
    for f in declared(type(config)):
        power, value = LENGTH_POWER.get(declaration(f).unit, 0), getattr(config, f.name)
        if power and isinstance(value, float):
            changed[f.name] = value * metre**power
    return replace(config, **changed)
