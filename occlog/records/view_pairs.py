"""Epipolar geometry of pairs of views: matches, and fundamental matrices with their sources."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats

SOURCES = ("calibration", "matches")


class PointMatches(NamedTuple):
    """Pixels of the same points in two views.

    Attributes:
        a: name of the first camera.
        b: name of the second camera.
        points_a: (N, 2) pixels in the first view, as recorded.
        points_b: (N, 2) pixels of the same points in the second view.
        where: description of their source, for messages.
    """

    a: str  # name of the first camera
    b: str
    points_a: Floats  # (N, 2) as recorded [px]
    points_b: Floats
    where: str  # what they are, for messages


class ViewPair(NamedTuple):
    """Fundamental matrix of two views, with its source and quality.

    Attributes:
        a: name of the first camera.
        b: name of the second camera.
        matrix: (3, 3) F; maps a pixel of view a, in homogeneous coordinates, to its epipolar line in view b: b' F a =
            0.
        source: `calibration` or `matches`.
        noise_px: standard deviation of a coordinate of the matches; NaN: not known.
        error_px: expected error of the epipolar lines [px]; NaN: not known.
        undistorted: True: it is for pixels after removal of the lens distortion that the scene states; False: for
            pixels as recorded (the same for cameras without distortion).
        affine: an affine fundamental matrix: parallel rays, of distant cameras with long lenses.
        matches: number of point matches it was estimated from; 0: none.
        inliers: how many of them agree with it.
        parallax_px: distance of the matches from a common plane homography; NaN: not known.
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
    """Pairs of views with known fundamental matrices; each pair once, in either order."""

    pairs: tuple[ViewPair, ...]

    def find(self, a: str, b: str) -> ViewPair | None:
        """The pair of two cameras, given by name, with a matrix that maps points of a to lines in b; None if unknown.

        A pair stored as (b, a) is transposed, and its names exchanged.
        """
        for pair in self.pairs:
            if (pair.a, pair.b) == (a, b):
                return pair
            if (pair.b, pair.a) == (a, b):
                return pair._replace(a=a, b=b, matrix=pair.matrix.T)
        return None
