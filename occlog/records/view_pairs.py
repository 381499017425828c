"""Epipolar geometry of pairs of views: matches, and fundamental matrices with their sources."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats

SOURCES = ("calibration", "matches")


class PointMatches(NamedTuple):
    """Pixels of the same points in two views."""

    a: str  # name of the first camera
    b: str
    points_a: Floats  # (N, 2) as recorded [px]
    points_b: Floats
    where: str  # what they are, for messages


class ViewPair(NamedTuple):
    """The fundamental matrix of two views, see `occlog.core.geometry.fundamental`.

    Attributes:
        a: name of the first camera.
        b: name of the second camera.
        matrix: (3, 3); maps a point of view a to its line in view b, b' F a = 0.
        source: `calibration` or `matches`.
        noise_px: standard deviation of a coordinate of the matches; NaN: not known.
        error_px: expected error of the lines; NaN: not known.
        undistorted: it is for pixels of which the lens distortion that the scene states was taken; else for
            pixels as recorded (the same for cameras without distortion).
        affine: parallel rays: cameras far away with long lenses.
        matches: how many it was estimated from; 0: none.
        inliers: how many of them agree.
        parallax_px: how far they are from those of one plane; NaN: not known.
    """

    a: str
    b: str
    matrix: Floats
    source: str = "matches"
    noise_px: float = np.nan
    error_px: float = np.nan
    undistorted: bool = False
    affine: bool = False
    matches: int = 0
    inliers: int = 0
    parallax_px: float = np.nan


class ViewPairs(NamedTuple):
    """Known pairs of views; each pair once, in either order."""

    pairs: tuple[ViewPair, ...]

    def find(self, a: str, b: str) -> ViewPair | None:
        """Pair of two views, transposed if required so that its matrix maps points of a to lines of b.

        None if unknown.
        """
        for pair in self.pairs:
            if (pair.a, pair.b) == (a, b):
                return pair
            if (pair.b, pair.a) == (a, b):
                return pair._replace(a=a, b=b, matrix=pair.matrix.T)
        return None
