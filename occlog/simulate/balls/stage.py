"""The synthetic video of balls as tables: the scene, and what is truly in each frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from occlog.array_types import Floats
from occlog.core.image.ellipse import support_radius
from occlog.records.scene import Camera, Scene
from occlog.records.tables import Truth, TruthBoxes

from .config import BallsConfig
from .motion import ball_box, ball_cameras
from .video import BallsFrame


def balls_scene(config: BallsConfig, rate_hz: float) -> Scene:
    """Cameras `view1`, `view2`, ... about the box in which the balls fly; lengths are pixels.

    Args:
        config: balls and views.
        rate_hz: frames a second.
    """
    x, y, z = ball_box(config).tolist()
    return Scene(
        cameras=tuple(replace(camera, rate_hz=rate_hz) for camera in ball_cameras(config)),
        room=np.array([[-x, -y], [x, -y], [x, y], [-x, y]]),
        room_height=0.5 * config.height + z,
        length_unit="px",
    )


def balls_truth(centres: Floats, t_ns: int) -> Truth:
    """Places of the centres (n, 3) of all balls at one time; each is a target."""
    n = len(centres)
    return Truth.of(
        t_ns=np.full(n, t_ns),
        target_id=np.arange(n, dtype=np.int32),
        role=np.full(n, "target"),
        x=centres[:, 0],
        y=centres[:, 1],
        z=centres[:, 2],
    )


def balls_boxes(frame: BallsFrame, cameras: tuple[Camera, ...], t_ns: int) -> list[TruthBoxes]:
    """For each view the boxes around the whole outlines of all balls that reach into the image.

    Hidden balls have theirs too: the visible share of the part that is in the image says so.
    """
    return [_boxes(frame.ellipses[k], frame.share[k], camera, frame.frame, t_ns) for k, camera in enumerate(cameras)]


def _boxes(ellipses: Floats, share: Floats, camera: Camera, frame: int, t_ns: int) -> TruthBoxes:
    width, height = camera.image_size or (0, 0)
    across, down = support_radius(ellipses, 0.0), support_radius(ellipses, 0.5 * np.pi)
    x, y = ellipses[:, 0], ellipses[:, 1]
    inside = (x + across > -0.5) & (x - across < width - 0.5) & (y + down > -0.5) & (y - down < height - 0.5)
    ids = np.flatnonzero(inside) if inside.any() else np.array([-1])
    n, nan = len(ids), np.full(len(ids), np.nan)
    some = ids[0] >= 0
    return TruthBoxes.of(
        t_ns=np.full(n, t_ns),
        sensor=np.full(n, camera.name),
        frame=np.full(n, frame),
        box=(np.arange(n) if some else ids).astype(np.int32),
        target_id=ids.astype(np.int32),
        left_px=(x - across)[ids] if some else nan,
        top_px=(y - down)[ids] if some else nan,
        width_px=2 * across[ids] if some else nan,
        height_px=2 * down[ids] if some else nan,
        confidence=nan,
        visible=share[ids] if some else nan,
    )
