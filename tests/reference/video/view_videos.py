"""Small recordings with video of balls in two views, and methods that track in images without looking at them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from occlog.io.files.provenance import Provenance
from occlog.io.recording.writer import RecordingWriter
from occlog.measure.epipolar.views import Geometry
from occlog.records.frames import Image
from occlog.records.scene import Scene
from occlog.records.tables import Boxes
from occlog.simulate.balls.config import BallsConfig
from occlog.simulate.balls.motion import ball_cameras
from occlog.simulate.balls.stage import balls_boxes, balls_scene
from occlog.simulate.balls.video import BallsFrame, render_balls
from occlog.track.images.interface import LEFT, Collaboration, FrameSet, Outlines, Visual

SMALL = BallsConfig(frames=16, width=160, height=120, balls=3, radius=11.0, speed=2.0)
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
        detector: with boxes of a detector that sees everything and knows nobody.
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


@dataclass(frozen=True)
class StillConfig:
    """Settings of `still`."""

    particles: int = 1
    drift_px: float = 0.0
    leaves: int = 0  # frames after which a tracker leaves; 0: never


@dataclass(frozen=True)
class Still:
    """State of `still`."""

    config: StillConfig
    geometry: Geometry
    ellipses: dict[tuple[int, int], np.ndarray]
    ages: dict[tuple[int, int], int]


def _born(state: Still, frames: FrameSet, births: Any) -> Still:
    new = {(b.view, b.target_id): b.ellipse for b in births}
    return replace(state, ellipses=state.ellipses | new, ages=state.ages | dict.fromkeys(new, 0))


def _ended(state: Still, keys: Any) -> Still:
    kept = {k: e for k, e in state.ellipses.items() if k not in keys}
    return replace(state, ellipses=kept, ages={k: state.ages[k] for k in kept})


def _step(state: Still, frames: FrameSet, rng: Any) -> tuple[Still, Outlines]:
    here = [k for k in sorted(state.ellipses) if frames.images[k[0]] is not None]
    step = np.array([state.config.drift_px, 0.0, 0.0, 0.0, 0.0])
    ages = {k: state.ages[k] + (k in here) for k in state.ellipses}
    moved = {k: e + step * (k in here) for k, e in state.ellipses.items()}
    gone = [k for k in here if ages[k] == state.config.leaves]
    n = len(here)
    outlines = Outlines(
        view=np.array([k[0] for k in here], dtype=np.int64),
        target_id=np.array([k[1] for k in here], dtype=np.int64),
        ellipse=np.array([moved[k] for k in here]).reshape(-1, 5),
        covariance=np.tile([1.0, 0.0, 1.0], (n, 1)),
        likeness=np.full(n, 0.9),
        ess=np.full(n, 1.0),
        mode=np.zeros(n, dtype=np.int64),
        counterpart=np.zeros(n, dtype=np.int64),
        touching=np.zeros((n, n), dtype=bool),
        helpers=np.zeros((n, len(frames.images)), dtype=bool),
        event=np.array([LEFT if k in gone else 0 for k in here], dtype=np.int64),
    )
    return _ended(replace(state, ellipses=moved, ages=ages), gone), outlines


def _with_geometry(state: Still, geometry: Geometry) -> Still:
    """Keeps the geometry, for a test to see."""
    return replace(state, geometry=geometry)


STILL: Visual[Still, StillConfig] = Visual(
    config=StillConfig,
    init=lambda views, geometry, config, rng: Still(config, geometry, {}, {}),
    born=_born,
    step=_step,
    ended=_ended,
)
STILL_TOGETHER = STILL._replace(collaboration=Collaboration("does the same", lambda config: False, _with_geometry))
"""The same, as a method whose views help each other."""
