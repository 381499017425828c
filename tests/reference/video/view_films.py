"""Short films of balls, their geometry, and trackers run over them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from itertools import islice
from typing import Any

import numpy as np

from occlog.core.geometry.fundamental import fundamental_from_poses
from occlog.measure.epipolar.views import TrackedView, ViewGeometry
from occlog.simulate.balls.config import BallsConfig
from occlog.simulate.balls.motion import ball_cameras
from occlog.simulate.balls.video import BallsFrame, render_balls
from occlog.track.methods.images.interface import Birth, FrameSet, TrackerOutlines
from occlog.track.methods.images.methods.config import CONFIGS
from occlog.track.methods.images.methods.state import initial_state
from occlog.track.methods.images.methods.step import advance, initiate_trackers

PERIOD_NS = 40_000_000
SMALL = BallsConfig(frames=40, width=120, height=90, balls=3, radius=9.0, ball_speed=2.0, background_clutter=2)


@lru_cache(maxsize=8)
def film(config: BallsConfig = SMALL, seed: int = 1, count: int | None = None) -> tuple[BallsFrame, ...]:
    """The first frames of a film, or all."""
    return tuple(islice(render_balls(config, seed), count))


def views_of(config: BallsConfig = SMALL) -> list[TrackedView]:
    return [TrackedView(camera.name, *camera.image_size) for camera in ball_cameras(config)]


def geometry_of(config: BallsConfig = SMALL) -> ViewGeometry:
    """Fundamental matrices from the cameras' poses."""
    cameras = ball_cameras(config)
    out = np.full((len(cameras), len(cameras), 3, 3), np.nan)
    for a, one in enumerate(cameras):
        for b, other in enumerate(cameras):
            if a != b:
                sides = [(_inner(c), c.rotation, c.position) for c in (one, other)]
                out[a, b] = fundamental_from_poses(*sides[0], *sides[1])
    return ViewGeometry(out, (None,) * len(cameras))


def _inner(camera: Any) -> np.ndarray:
    f, p = camera.focal_px, camera.principal_px
    return np.array([[f[0], 0.0, p[0]], [0.0, f[1], p[1]], [0.0, 0.0, 1.0]])


def frame_set(frame: BallsFrame, without: Iterable[int] = ()) -> FrameSet:
    """A frame of all views but some."""
    images = tuple(None if v in set(without) else image for v, image in enumerate(frame.images))
    return FrameSet(frame.frame * PERIOD_NS, np.array([-1 if i is None else frame.frame for i in images]), images)


def births_of(frame: BallsFrame) -> list[Birth]:
    views, balls = frame.ellipses.shape[:2]
    return [Birth(v, k, frame.ellipses[v, k]) for v in range(views) for k in range(balls)]


def begun(
    method: str, frames: Sequence[BallsFrame], config: BallsConfig = SMALL, seed: int = 0, **settings: Any
) -> Any:
    """State with trackers on all balls of the first frame, and the generator."""
    state = initial_state(views_of(config), geometry_of(config), CONFIGS[method](**settings))
    return initiate_trackers(state, frame_set(frames[0]), births_of(frames[0])), np.random.default_rng(seed)


def tracked(
    method: str,
    frames: Sequence[BallsFrame],
    config: BallsConfig = SMALL,
    seed: int = 0,
    between: Callable[[int, Any], Any] = lambda _, state: state,
    without: Callable[[int], Iterable[int]] = lambda _: (),
    **settings: Any,
) -> tuple[list[TrackerOutlines], Any]:
    """What a method says of all frames after the first, and its last state.

    `between` may change the state before frame t, `without` names the views that have no frame t.
    """
    state, rng = begun(method, frames, config, seed, **settings)
    out = []
    for t, frame in enumerate(frames[1:], 1):
        state, report = advance(between(t, state), frame_set(frame, without(t)), rng)
        out.append(report)
    return out, state


def off(frames: Sequence[BallsFrame], reported: Sequence[TrackerOutlines]) -> np.ndarray:
    """(T, V, n) distances of the trackers from the centres of their balls; inf without tracker."""
    out = np.full((len(reported), *frames[0].ellipses.shape[:2]), np.inf)
    for t, (frame, one) in enumerate(zip(frames[1:], reported, strict=True)):
        true = frame.ellipses[one.view, one.target_id, :2]
        out[t, one.view, one.target_id] = np.linalg.norm(one.ellipse[:, :2] - true, axis=1)
    return out
