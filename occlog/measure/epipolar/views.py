"""Views, and the epipolar geometry between them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from occlog.array_types import Floats


class TrackedView(NamedTuple):
    """A camera with images in which targets are tracked."""

    name: str
    width: int  # of its images [px]
    height: int


class ViewGeometry(NamedTuple):
    """Epipolar geometry of V views.

    Attributes:
        fundamental: (V, V, 3, 3); [a, b] maps a point of view a to its line in view b (b' F a = 0, see
            `occlog.core.geometry.fundamental`), for pixels without distortion; NaN where it is not known.
        ideal: for each view what takes recorded pixels (N, 2) to pixels without distortion; None: they are the same.
    """

    fundamental: Floats
    ideal: tuple[Callable[[Floats], Floats] | None, ...]
