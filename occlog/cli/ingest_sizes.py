"""Cameras whose frames have another size than they were calibrated with."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..io.decoder import Decoder
from ..scene import Camera, Scene, camera_fov

CROP_PX = 16
"""Video codecs cut or pad to multiples of 16 px; a difference up to this is not a change of scale."""
SHAPE_SLACK = 0.01
MIN_BAR_PX = 2.0
BAR_SLACK_PX = 1.5

Bars = tuple[int, int, int, int]


def fit_sizes(scene: Scene, decoders: Iterable[tuple[str, Decoder]], note: Callable[[str], None]) -> Scene:
    """The scene with cameras that fit their frames."""
    found = dict(decoders)
    cameras = tuple(
        fit_size(c, found[c.name].size, found[c.name].bars, note) if c.name in found else c for c in scene.cameras
    )
    return replace(scene, cameras=cameras)


def fit_size(camera: Camera, size: tuple[int, int], bars: Bars, note: Callable[[str], None]) -> Camera:
    """The camera for frames of another size than it was calibrated with.

    * Black bars that are as wide as a change of scale makes them: scaled and centred.
    * Up to 16 px less or more: cut or padded at the right and lower edge, pixels keep their place.
    * The same shape: scaled.

    Args:
        camera: as calibrated.
        size: width and height of the frames [px].
        bars: width of black bars at the left, top, right and lower edge of the frames [px].
        note: is told what was assumed.

    Raises:
        InputError: the frames have another shape.
    """
    if camera.image_size is None or camera.image_size == size or not camera.placed:
        return replace(camera, image_size=size)
    old, new = np.array(camera.image_size, dtype=np.float64), np.array(size, dtype=np.float64)
    change = f"camera {camera.name}: frames of {size[0]} x {size[1]} px, calibrated for {int(old[0])} x {int(old[1])}"
    scale = float((new / old).min())
    margin = (new - old * scale) / 2
    if margin.max() >= MIN_BAR_PX and _has_bars(bars, margin):
        note(f"{change}: taken for scaled by {scale:.4g} between the black bars that they have")
        return _scaled(camera, size, np.array([scale, scale]), margin)
    if np.abs(new - old).max() <= CROP_PX:
        note(f"{change}: taken for cut at the right and lower edge")
        return _scaled(camera, size, np.ones(2), np.zeros(2))
    if abs((new / old)[0] / (new / old)[1] - 1) > SHAPE_SLACK:
        raise InputError(f"{change}: another shape; give the calibration of this video, or frames of its size")
    note(f"{change}: taken for scaled by {scale:.4g}")
    return _scaled(camera, size, new / old, np.zeros(2))


def _has_bars(bars: Bars, margin: np.ndarray) -> bool:
    """Whether the black bars are as wide as the margins (x, y) on both sides."""
    wanted = np.array([margin[0], margin[1], margin[0], margin[1]])
    there = wanted >= MIN_BAR_PX
    return bool((np.abs(np.array(bars) - wanted)[there] <= BAR_SLACK_PX).all())


def _scaled(camera: Camera, size: tuple[int, int], scale: np.ndarray, margin: np.ndarray) -> Camera:
    focal = camera.focal_px * scale
    # The centre of the first pixel is (0, 0), so the image's corner is at -0.5.
    principal = (camera.principal_px + 0.5) * scale - 0.5 + margin
    fov = camera_fov(size, focal, principal, camera.distortion, camera.distortion_model, camera.rotation)
    return replace(camera, focal_px=focal, principal_px=principal, image_size=size, fov=fov)
