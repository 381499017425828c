"""Views, and the epipolar geometry between them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from occlog.array_types import Floats


class TrackedView(NamedTuple):
    """A camera with images, `width` x `height` [px], in which targets are tracked."""

    name: str
    width: int  # of its images [px]
    height: int


class ViewGeometry(NamedTuple):
    """Epipolar geometry of V views.

    Attributes:
        fundamental: (V, V, 3, 3); [a, b] maps a point of view a to its line in view b (b' F a = 0), for undistorted
            pixels; NaN where unknown.
        ideal: for each view the function from recorded to undistorted pixels (N, 2); None: they are equal.
    """

    fundamental: Floats
    ideal: tuple[Callable[[Floats], Floats] | None, ...]
