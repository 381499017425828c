"""What a picture of video frames with trackers drawn on them is made of; see `shotplot`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..columns import Floats


class Mark(NamedTuple):
    """A tracker."""

    target: int
    ellipse: Floats  # (5,) centre, half axes, angle of the first
    good: bool  # it is on its own target


class Line(NamedTuple):
    """An epipolar line."""

    target: int  # whose
    line: Floats  # (3,) points (x, y) with line . (x, y, 1) = 0


class Shot(NamedTuple):
    """One image."""

    title: str
    image: NDArray[np.uint8]  # (H, W, 3) BGR
    marks: tuple[Mark, ...]
    links: tuple[tuple[Floats, Floats], ...]  # centres of trackers that touch
    lines: tuple[Line, ...]


class Shots(NamedTuple):
    """A picture: images in rows and columns."""

    title: str
    caption: str
    rows: tuple[str, ...]  # names
    shots: tuple[tuple[Shot, ...], ...]  # by row
