"""Fundamental matrices of all pairs of views: from calibration or from matches, and whether matches agree with them."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.sight.fundamental import check_fundamental, symmetric_errors
from occlog.errors import InputError
from occlog.records.scene import Camera, Scene
from occlog.records.view_pairs import Matches, ViewPair, ViewPairs

from .config import EpipolarConfig
from .geometry import bends
from .of_scene import estimate_fundamental, fundamental_of_cameras, ideal_pixels


class PairCheck(NamedTuple):
    """How well matches agree with a fundamental matrix; distances are from the epipolar lines."""

    a: str
    b: str
    matches: int
    median_px: float
    most_px: float  # at most this of 95 % of the matches
    share: float  # of the matches whose two distances are within the tolerance
    chance: float  # the same of wrong pairings
    fits: bool


def calibrated_pairs(scene: Scene) -> ViewPairs:
    """The pairs of all cameras with a pose, but for two at the same place; InputError where there is none."""
    pairs = []
    placed = [camera for camera in scene.cameras if camera.placed]
    for a, b in combinations(placed, 2):
        try:
            matrix = fundamental_of_cameras(a, b)
        except ValueError:  # the same place
            continue
        pairs.append(ViewPair(a.name, b.name, matrix, "calibration", undistorted=bends(a) or bends(b)))
    if not pairs:
        raise InputError(
            f"scene: {len(placed)} of {len(scene.cameras)} cameras have a pose; a fundamental matrix needs two, at "
            "different places; calibrate more, or give matches"
        )
    return ViewPairs(tuple(pairs))


def estimated_pairs(
    matches: Iterable[Matches],
    scene: Scene | None = None,
    config: EpipolarConfig | None = None,
) -> ViewPairs:
    """The pairs that matches tell, lens distortion taken off where the scene states it.

    Args:
        matches: of each pair.
        scene: cameras whose lens may be known; their poses are not used.
        config: model, threshold and largest error, see `estimate_fundamental`.

    Raises:
        InputError: the matches of a pair do not tell its matrix.
    """
    config = config or EpipolarConfig()
    return ViewPairs(tuple(_estimated(m, scene, config) for m in matches))


def checked_pairs(
    pairs: ViewPairs, matches: Iterable[Matches], scene: Scene | None, tolerance_px: float
) -> tuple[PairCheck, ...]:
    """How well the matches of each pair agree with its matrix.

    Raises:
        InputError: no matrix is known of a pair that has matches, it is for other pixels, or
            the matches are too few to tell.
    """
    return tuple(_checked(pairs, m, scene, tolerance_px) for m in matches)


def _estimated(m: Matches, scene: Scene | None, config: EpipolarConfig) -> ViewPair:
    a, b, undistorted = _ideal(m, scene)
    try:
        fit = estimate_fundamental(a, b, config)
    except ValueError as error:
        raise InputError(f"{m.where}: {error}") from error
    return ViewPair(
        a=m.a,
        b=m.b,
        matrix=fit.matrix,
        source="matches",
        noise_px=fit.noise_px,
        error_px=fit.error_px,
        undistorted=undistorted,
        affine=fit.affine,
        matches=len(a),
        inliers=int(fit.inliers.sum()),
        parallax_px=fit.parallax_px,
    )


def _checked(pairs: ViewPairs, m: Matches, scene: Scene | None, tolerance_px: float) -> PairCheck:
    pair = pairs.find(m.a, m.b)
    if pair is None:
        raise InputError(f"{m.where}: no fundamental matrix of these views to check; choose other cameras")
    a, b, undistorted = _ideal(m, scene)
    if pair.undistorted != undistorted:
        pixels = "without lens distortion" if pair.undistorted else "as recorded, but the scene tells lens distortion"
        raise InputError(f"{m.where}: the fundamental matrix is for pixels {pixels}; give the scene it was made with")
    try:
        found = check_fundamental(pair.matrix, a, b, tolerance_px)
    except ValueError as error:
        raise InputError(f"{m.where}: {error}") from error
    errors = symmetric_errors(pair.matrix, a, b)
    most = float(np.percentile(np.where(np.isnan(errors), np.inf, errors), 95, method="lower"))
    return PairCheck(
        a=m.a,
        b=m.b,
        matches=len(a),
        median_px=found.median_px,
        most_px=most,
        share=found.share,
        chance=found.chance,
        fits=found.fits,
    )


def _ideal(m: Matches, scene: Scene | None) -> tuple[Floats, Floats, bool]:
    """The points of both views without lens distortion, and whether there was any."""
    cameras = [None if scene is None else _camera(scene, name, m.where) for name in (m.a, m.b)]
    points = [
        ideal_pixels(camera, p) if camera is not None and bends(camera) else p
        for camera, p in zip(cameras, (m.points_a, m.points_b), strict=True)
    ]
    return points[0], points[1], any(bends(camera) for camera in cameras)


def _camera(scene: Scene, name: str, where: str) -> Camera:
    try:
        return scene.camera(name)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
