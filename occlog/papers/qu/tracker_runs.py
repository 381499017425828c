"""Runs any number of methods on one synthetic video of [Qu].

Every frame is drawn once and given to all methods in turn, and no image is kept: several methods
cost one rendering, and memory does not grow with the video.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.metrics.mot.frame_pairs import Objects
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.errors import InputError
from occlog.measure.epipolar.views import ViewGeometry
from occlog.simulate.balls.config import BallsConfig
from occlog.simulate.balls.video import BallsFrame
from occlog.track.methods.images.interface import START, Birth, TrackerOutlines
from occlog.track.methods.images.methods.config import BmctConfig, MipfConfig
from occlog.track.methods.images.methods.state import VisualState, initial_state
from occlog.track.methods.images.methods.step import advance, initiate_trackers

from .staged import Staging, video_of
from .timing import likelihood_seconds
from .world import FLYING, frame_set_of, truth_of, views_of


class DivertedTracker(NamedTuple):
    """Tracker that is moved off its target, and at rest then.

    Attributes:
        view, target: numbers of the view and of the tracker's target.
        frame: number of the frame before which it is moved.
        x, y: position in the image that it is moved to [px].
    """

    view: int
    target: int
    frame: int
    x: float
    y: float


class Runner(NamedTuple):
    """A method to be run on a video, and what it is given.

    Attributes:
        config: settings of the method; their class selects it.
        geometry: fundamental matrices between views that it is given.
        births: trackers of the first frame.
        seed: seed of the trackers.
        use: number of views that it is given, the first ones of the video.
        exchange: view, two targets, and the frame before which their trackers exchange positions; None: never.
        diverted: tracker that is moved off its target; None: none.
        timed: whether the time of each part of the likelihood is measured, for `bmct` alone.
    """

    config: MipfConfig
    geometry: ViewGeometry
    births: tuple[Birth, ...]
    seed: int
    use: int
    exchange: tuple[int, int, int, int] | None = None
    diverted: DivertedTracker | None = None
    timed: bool = False


class TrackerOutput(NamedTuple):
    """Output of a method on a video: a row for each tracker and frame; the first frame has the initial ellipses.

    Attributes:
        frame: (n,) number of the frame.
        view: (n,) number of the view.
        target: (n,) identity of the tracker.
        ellipse: (n, 5) centre x, y [px], half axes [px], angle of the first axis [rad].
        mode: (n,) index in `MODES` of the likelihood; -1 in the first frame.
        counterpart: (n,) result of the loop check by another view: `NONE`, `BAD` or `GOOD`; 0: not checked.
        event: (n,) `START` in the first frame, `LEFT` or `TERMINATED` if the tracker ended with the frame; else 0.
        ess: (n,) effective sample size; NaN without particles, and in the first frame.
        seconds: (steps,) CPU time of each step of the method [s].
        parts: (k, 3) CPU time of the local, the interaction and the collaboration likelihood in some of the steps [s];
            (0, 3) for a method that is not `timed`.
    """

    frame: Ints
    view: Ints
    target: Ints
    ellipse: Floats
    mode: Ints
    counterpart: Ints
    event: Ints
    ess: Floats
    seconds: Floats
    parts: Floats


EVERY, REPEATS = 5, 3
"""The parts of the likelihood are timed in every fifth frame, three times each."""
PLACED = ("particles", "estimate", "velocity", "path", "axes", "similarities", "weak")
"""Columns of the trackers' state that move when two trackers are exchanged."""


class FollowedFrame(NamedTuple):
    """A frame of the video, and the trackers of each method in it by label."""

    frame: BallsFrame
    rows: Mapping[str, TrackerOutlines]


def follow(
    config: BallsConfig,
    seed: int,
    runners: Mapping[str, Runner],
    watch: Callable[[FollowedFrame], None] | None = None,
    staging: Staging = FLYING,
) -> tuple[dict[str, TrackerOutput], Objects, Floats]:
    """Run all methods on one video, frame by frame.

    Args:
        config: settings of the video.
        seed: seed of the video.
        runners: methods by label.
        watch: is called with each frame after all methods have done their step; None: nothing is called.
        staging: scene and unseen balls of the video.

    Returns:
        The output of each method by label; the truth as boxes, with `view`; and the radius of each true box [px].

    Raises:
        InputError: there is no such tracker to exchange or to divert.
    """
    done: dict[str, list[TrackerOutlines]] = {label: [] for label in runners}
    seconds: dict[str, list[float]] = {label: [] for label in runners}
    parts: dict[str, list[tuple[float, float, float]]] = {label: [] for label in runners}
    states, rngs = {}, {label: generator(r.seed, RandomStream.TRACK) for label, r in runners.items()}
    frames: list[BallsFrame] = []
    views = views_of(config)
    for frame in video_of(config, seed, staging):
        for label, r in runners.items():
            frame_set = frame_set_of(frame, r.use)
            if not frames:
                empty = initial_state(views[: r.use], r.geometry, r.config)
                states[label] = initiate_trackers(empty, frame_set, r.births)
                done[label].append(_first(r.births, r.use))
                continue
            if r.exchange is not None and r.exchange[3] == frame.frame:
                states[label] = exchanged(states[label], *r.exchange[:3])
            if r.diverted is not None and r.diverted.frame == frame.frame:
                states[label] = diverted_state(states[label], r.diverted)
            if r.timed and isinstance(r.config, BmctConfig) and frame.frame % EVERY == 1:
                rng = np.random.default_rng(frame.frame)
                parts[label].append(likelihood_seconds(states[label], r.config, frame_set, rng, REPEATS))
            start = time.thread_time()
            states[label], outlines = advance(states[label], frame_set, rngs[label])
            seconds[label].append(time.thread_time() - start)
            done[label].append(outlines)
        if watch is not None:
            watch(FollowedFrame(frame, {label: rows[-1] for label, rows in done.items()}))
        frames.append(frame._replace(images=()))
    truth, radius = truth_of(frames)
    return {label: _joined(done[label], seconds[label], parts[label]) for label in runners}, truth, radius


def exchanged(state: VisualState, view: int, one: int, other: int) -> VisualState:
    """Copy of the state with the positions of two trackers of a view exchanged; `one`, `other`: their targets.

    Raises:
        InputError: the view has no such trackers.
    """
    t = state.trackers
    rows = [np.flatnonzero((t.view == view) & (t.target == k)) for k in (one, other)]
    if any(len(r) != 1 for r in rows):
        raise InputError(
            f"trial: view {view} has no trackers of targets {one} and {other} to exchange", id="unknown-name"
        )
    order = np.arange(len(t.view))
    order[np.concatenate(rows)] = order[np.concatenate(rows[::-1])]
    return state._replace(trackers=t._replace(**{name: getattr(t, name)[order] for name in PLACED}))


def diverted_state(state: VisualState, diverted: DivertedTracker) -> VisualState:
    """Copy of the state in which one tracker is at rest in another position.

    Raises:
        InputError: there is no such tracker.
    """
    t = state.trackers
    rows = np.flatnonzero((t.view == diverted.view) & (t.target == diverted.target))
    if len(rows) != 1:
        raise InputError(
            f"trial: view {diverted.view} has no tracker of target {diverted.target} to divert", id="unknown-name"
        )
    i, particles, estimate = rows[0], t.particles.copy(), t.estimate.copy()
    particles[i, :, :2], estimate[i, :2] = (diverted.x, diverted.y), (diverted.x, diverted.y)
    velocity, path = t.velocity.copy(), t.path.copy()
    velocity[i], path[i] = 0.0, 0.0
    return state._replace(trackers=t._replace(particles=particles, estimate=estimate, velocity=velocity, path=path))


def _first(births: Sequence[Birth], views: int) -> TrackerOutlines:
    """Rows of the first frame, of trackers that were just initiated; `views`: number of views."""
    n = len(births)
    zero, unknown = np.zeros(n, dtype=np.int64), np.full(n, np.nan)
    return TrackerOutlines(
        view=np.array([b.view for b in births], dtype=np.int64),
        target_id=np.array([b.target_id for b in births], dtype=np.int64),
        ellipse=np.stack([b.ellipse for b in births]),
        covariance=np.full((n, 3), np.nan),
        similarity=unknown,
        ess=unknown,
        likelihood_mode=zero - 1,
        counterpart=zero,
        touching=np.zeros((n, n), dtype=np.bool_),
        assisting_views=np.zeros((n, views), dtype=np.bool_),
        lifecycle=zero + START,
    )


def _joined(
    rows: Sequence[TrackerOutlines], seconds: Sequence[float], parts: Sequence[tuple[float, float, float]]
) -> TrackerOutput:
    """Output of a method from the rows of frames 0, 1, ...

    Args:
        rows: trackers in each frame.
        seconds: CPU time of each step [s].
        parts: times of the three likelihoods in some of the steps [s]; empty: not measured.
    """
    return TrackerOutput(
        frame=np.repeat(np.arange(len(rows)), [len(o.view) for o in rows]),
        view=np.concatenate([o.view for o in rows]),
        target=np.concatenate([o.target_id for o in rows]),
        ellipse=np.concatenate([o.ellipse for o in rows]),
        mode=np.concatenate([o.likelihood_mode for o in rows]),
        counterpart=np.concatenate([o.counterpart for o in rows]),
        event=np.concatenate([o.lifecycle for o in rows]),
        ess=np.concatenate([o.ess for o in rows]),
        seconds=np.array(seconds),
        parts=np.array(parts).reshape(-1, 3),
    )
