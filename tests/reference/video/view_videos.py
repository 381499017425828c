"""Small recordings with video of balls in two views."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from occlog.io.files.provenance import Provenance
from occlog.io.recording.writer import RecordingWriter
from occlog.records.frames import Image
from occlog.records.scene import Scene
from occlog.records.tables import Boxes
from occlog.simulate.balls.config import BallsConfig
from occlog.simulate.balls.motion import ball_cameras
from occlog.simulate.balls.video import BallsFrame, balls_boxes, balls_scene, render_balls

SMALL = BallsConfig(frames=16, width=160, height=120, balls=3, radius=11.0, ball_speed=2.0)
STEP_NS = 40_000_000
START_NS = 1_600_000_000_000_000_000


@cache
def small_balls(seed: int = 3, frames: int = SMALL.frames) -> tuple[BallsFrame, ...]:
    """Frames of three balls in two views."""
    return tuple(render_balls(SMALL, seed))[:frames]


def small_scene() -> Scene:
    """Their scene."""
    return balls_scene(SMALL, 25.0)


def record_balls(
    path: Path,
    *,
    seed: int = 3,
    keep: Callable[[str, int], bool] = lambda view, frame: True,
    change: Callable[[str, int, Image], Image | bytes] = lambda view, frame, image: image,
    late_ns: Mapping[str, int] = {},
    scene: Scene | None = None,
    posed: bool = True,
    boxes: bool = True,
    detector: bool = False,
) -> Path:
    """A recording of the balls.

    Args:
        path: of the file.
        seed: of the video.
        keep: whether a view delivers a frame; the others have no number.
        change: what a frame's image becomes; bytes are stored as they are.
        late_ns: by how much a view's clock is late.
        scene: another one.
        posed: with a scene.
        boxes: with true boxes.
        detector: with boxes of a detector that sees everything and knows no one.
    """
    cameras = ball_cameras(SMALL)
    count = dict.fromkeys((c.name for c in cameras), 0)
    with RecordingWriter(path, (scene or small_scene()) if posed else None, Provenance("test")) as out:
        for frame in small_balls(seed):
            t_ns = START_NS + frame.frame * STEP_NS
            for camera, image, table in zip(cameras, frame.images, balls_boxes(frame, cameras, t_ns), strict=True):
                name = camera.name
                if not keep(name, frame.frame):
                    continue
                made = change(name, frame.frame, image)
                data = made if isinstance(made, bytes) else cv2.imencode(".png", made)[1].tobytes()
                when, number = t_ns + late_ns.get(name, 0), count[name]
                out.image(name, when, number, data, "png")
                count[name] += 1
                moved = {"t_ns": np.full(len(table), when), "frame": np.full(len(table), number)}
                columns = {c.name: getattr(table, c.name) for c in table.columns()} | moved
                if boxes:
                    out.table(type(table).of(**columns))
                if detector:
                    plain = {c.name: columns[c.name] for c in Boxes.columns()}
                    out.table(Boxes.of(**plain | {"target_id": np.full(len(table), -1)}))
    return path
