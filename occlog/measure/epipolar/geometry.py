"""Epipolar geometry of the views of a recording, from fundamental matrices or from the scene's camera poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError, option
from occlog.records.scene import Camera, Scene
from occlog.records.view_pairs import ViewPair, ViewPairs

from .from_scene import fundamental_of_cameras, ideal_pixels_anywhere
from .views import TrackedView, ViewGeometry


def view_geometry(
    views: Sequence[TrackedView], scene: Scene | None = None, fundamental: ViewPairs | None = None
) -> ViewGeometry:
    """Fundamental matrices of all pairs of views, with undistortion of their pixels.

    Args:
        views: V views, in the order of the result.
        scene: cameras with poses and lenses; views without a camera in it have neither.
        fundamental: known pairs, which have priority over the poses of the scene.

    Returns:
        Matrices [j, i] from view j to view i; NaN for a view with itself, and for pairs that neither source determines.

    Raises:
        InputError: a given pair is for undistorted pixels and the scene states no distortion of its cameras, or the
            other way round.
    """
    cameras = [_camera(view.name, scene) for view in views]
    matrices = np.full((len(views), len(views), 3, 3), np.nan)
    for i, a in enumerate(views):
        for j, b in enumerate(views[:i]):
            pair = fundamental.find(b.name, a.name) if fundamental is not None else None
            if pair is not None:
                _check_pixels(pair, cameras[j], cameras[i])
            matrix = _of_poses(cameras[j], cameras[i]) if pair is None else pair.matrix
            matrices[j, i], matrices[i, j] = matrix, matrix.T
    return ViewGeometry(matrices, tuple(_ideal(camera) for camera in cameras))


def bends(camera: Camera | None) -> bool:
    """Whether a camera's lens has distortion; False if there is no camera."""
    return camera is not None and not camera.straight


def _camera(name: str, scene: Scene | None) -> Camera | None:
    return next((c for c in scene.cameras if c.name == name), None) if scene is not None else None


def _of_poses(a: Camera | None, b: Camera | None) -> Floats:
    """(3, 3) fundamental matrix from camera a to camera b; NaN without both poses, or at the same position."""
    if a is not None and b is not None and a.placed and b.placed:
        try:
            return fundamental_of_cameras(a, b)
        except ValueError:  # the same position
            pass
    return np.full((3, 3), np.nan)


def _ideal(camera: Camera | None) -> Callable[[Floats], Floats] | None:
    return partial(ideal_pixels_anywhere, camera) if camera is not None and bends(camera) else None


def _check_pixels(pair: ViewPair, a: Camera | None, b: Camera | None) -> None:
    if pair.undistorted == (bends(a) or bends(b)):
        return
    if pair.undistorted:
        raise InputError(
            f"the fundamental matrix of {pair.a} and {pair.b} needs undistorted pixels; give the scene with "
            f"the cameras' lens distortion that it was made with ({option('scene')})",
            id="incompatible-inputs",
        )
    raise InputError(
        f"the fundamental matrix of {pair.a} and {pair.b} is for distorted pixels, but the scene has lens "
        "distortion; make it again with `occlog epipolar` and the scene",
        id="incompatible-inputs",
    )
