"""Frames of `bmct` against the same algorithm in plain NumPy: the synthetic video of [Qu], 6 targets in 2 views."""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median
from types import ModuleType
from typing import Any

import numpy as np

from benchmarks.references import reference
from occlog.core.geometry.fundamental import fundamental_from_poses
from occlog.measure.epipolar.views import TrackedView, ViewGeometry
from occlog.papers.qu.timing import likelihood_seconds
from occlog.records.scene import Camera
from occlog.simulate.balls.config import BallsConfig
from occlog.simulate.balls.motion import ball_cameras
from occlog.simulate.balls.video import BallsFrame, render_balls
from occlog.track.methods.images.interface import Birth, FrameSet
from occlog.track.methods.images.methods.config import BmctConfig
from occlog.track.methods.images.methods.state import initial_state
from occlog.track.methods.images.methods.step import advance, initiate_trackers

NAME = "views"
SUMMARY = "bmct, 6 targets x 60 particles x 2 views of 320x240, map of bins included: time to that of plain NumPy"
LIMIT = 0.5
FRAMES = 60
SEED = 21


def inner(camera: Camera) -> np.ndarray:
    """(3, 3) matrix of focal lengths and principal point."""
    (fx, fy), (cx, cy) = camera.focal_px.tolist(), camera.principal_px.tolist()
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def geometry(config: BallsConfig) -> ViewGeometry:
    a, b = ((inner(c), c.rotation, c.position) for c in ball_cameras(config))
    out = np.full((2, 2, 3, 3), np.nan)
    out[0, 1], out[1, 0] = fundamental_from_poses(*a, *b), fundamental_from_poses(*b, *a)
    return ViewGeometry(out, (None, None))


def frame_set(frame: BallsFrame) -> FrameSet:
    return FrameSet(frame.frame * 40_000_000, np.full(2, frame.frame), frame.images)


def states(frames: list[BallsFrame], config: BallsConfig, **settings: Any) -> list[tuple[Any, FrameSet, Any]]:
    """The state before each frame, the frame, and the state of the generator."""
    rng = np.random.default_rng(SEED)
    views = [TrackedView(c.name, *c.image_size) for c in ball_cameras(config)]
    state = initial_state(views, geometry(config), BmctConfig(**settings))
    births = [Birth(v, k, e) for v, row in enumerate(frames[0].ellipses) for k, e in enumerate(row)]
    state, out = initiate_trackers(state, frame_set(frames[0]), births), []
    for frame in frames[1:]:
        out.append((state, frame_set(frame), rng.bit_generator.state))
        state, _ = advance(state, frame_set(frame), rng)
    return out


def generator(bits: Any) -> np.random.Generator:
    rng = np.random.default_rng()
    rng.bit_generator.state = bits
    return rng


def ours(cases: list[tuple[Any, FrameSet, Any]]) -> float:
    """CPU milliseconds a frame of all views."""
    rngs = [generator(bits) for _, _, bits in cases]
    start = time.thread_time()
    for (state, frame, _), rng in zip(cases, rngs, strict=True):
        advance(state, frame, rng)
    return 1e3 * (time.thread_time() - start) / len(cases)


def plain(cases: list[tuple[Any, FrameSet, Any]], ref: ModuleType) -> float:
    """The same of the plain form, its random numbers and maps of bins included."""
    rngs = [generator(bits) for _, _, bits in cases]
    start = time.thread_time()
    for (state, frame, _), rng in zip(cases, rngs, strict=True):
        t = state.trackers
        normals, order, u = rng.standard_normal(t.particles.shape), rng.permutation(2), rng.random(len(t.view))
        bins = [ref.bins_of(image) for image in frame.images]
        ref.frame(t, state.config, state.geometry.fundamental, bins, normals, order, u)
    return 1e3 * (time.thread_time() - start) / len(cases)


def shares(cases: list[tuple[Any, FrameSet, Any]]) -> dict[str, float]:
    """CPU milliseconds a frame of each likelihood, as in [Qu] Table 1."""
    rows = [likelihood_seconds(state, state.config, frame, generator(bits), 3) for state, frame, bits in cases]
    names = ("local likelihood ms", "interaction likelihood ms", "collaboration likelihood ms")
    return dict(zip(names, (1e3 * np.mean(rows, axis=0)).tolist(), strict=True))


def run(repeats: int = 5) -> dict[str, Any]:
    """Ratio of a frame's time to the plain form's, both measured in turn; median over repeats."""
    config, ref = BallsConfig(frames=FRAMES), reference("view_reference")
    frames = list(render_balls(config, SEED))
    cases, dense = states(frames, config), states(frames, config, pixel_step=1)
    timed: Callable[[], tuple[float, float]] = lambda: (ours(cases), plain(cases[:20], ref))  # noqa: E731
    pairs = [timed() for _ in range(repeats)]
    mine, theirs = (median(p[k] for p in pairs) for k in range(2))
    every = median(ours(dense) for _ in range(repeats))
    return {
        "ratio": median(a / b for a, b in pairs),
        "limit": LIMIT,
        "parts": {
            "frame pair ms": mine,
            "frame pairs per CPU second": 1e3 / mine,
            "plain NumPy frame pair ms": theirs,
            "every pixel (pixel_step=1): frame pairs per CPU second": 1e3 / every,
            "every pixel, times plain NumPy": plain(dense[:20], ref) / every,
            **shares(cases),
        },
    }
