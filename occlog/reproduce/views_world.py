"""The synthetic video of [Qu] Sec. 4.1 in memory: its views, how they see each other, and trackers that run on it.

Nothing is stored: every frame is drawn once and given to all trackers in turn, so that any
number of methods on one video costs one rendering, and memory does not grow.
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..columns import Floats, Ints
from ..core.ellipse import support_radius
from ..core.epipolar import scaled
from ..core.mot_frames import Objects
from ..core.seeds import Stage, generator
from ..errors import InputError
from ..trackers.settings import configure
from ..trackers.view_method import START, Birth, Geometry, Looks, Outlines, View, Visual
from ..trackers.views_state import State
from ..trackers.views_timing import likelihood_seconds
from ..vision.epipolar import fundamental_of_cameras
from ..vision.render_balls import BallsFrame, render_balls
from ..vision.render_balls_motion import VIEWS, BallsConfig, ball_cameras

FRAME_NS = 40_000_000
"""Between frames: 25 a second."""
WRONG = ("true", "none", "shift", "turn", "swap")
"""What a method may be told of how the views see each other; see `geometry_of`."""


class Runner(NamedTuple):
    """A method on a video."""

    visual: Visual
    config: Any
    geometry: Geometry
    births: tuple[Birth, ...]
    seed: int
    use: int  # it gets the first so many views
    exchange: tuple[int, int, int, int] | None = None  # view, two targets and the frame before which they are exchanged
    timed: bool = False  # also how long the parts of its likelihood take; for `bmct`


class Followed(NamedTuple):
    """What came of a method: a row for each tracker and frame, the first frame with the ellipses that were given.

    Attributes:
        frame: (n,) number of the frame.
        view: (n,) number of the view.
        target: (n,) identity of the tracker.
        ellipse: (n, 5).
        mode: (n,) place in `MODES`; -1 in the first frame.
        counterpart: (n,) see `Outlines`.
        event: (n,) see `Outlines`.
        ess: (n,) see `Outlines`; NaN in the first frame.
        seconds: CPU time of each step of the method.
        parts: (steps, 3) CPU time of the local, the interaction and the collaboration likelihood in each
            step [s]; (0, 3) where they were not asked for.
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


PLACED = ("particles", "estimate", "velocity", "path", "axes", "likeness", "weak")
"""What of a tracker goes with its place."""


class Rows(NamedTuple):
    """Columns of `Followed` in one frame, and what pictures want besides."""

    frame: Ints
    view: Ints
    target: Ints
    ellipse: Floats
    mode: Ints
    counterpart: Ints
    event: Ints
    ess: Floats
    outlines: Outlines | None


class Step(NamedTuple):
    """A frame, and the rows of each method."""

    frame: BallsFrame
    rows: Mapping[str, Rows]


def balls_config(values: Mapping[str, Any]) -> BallsConfig:
    """What is rendered: fields of `BallsConfig`; `views` may be a number of them. InputError for what cannot be."""
    own = dict(values)
    views = own.pop("views", 2)
    if isinstance(views, int):
        if not 1 <= views <= len(VIEWS):
            raise InputError(f"balls: {views} views, must be 1 to {len(VIEWS)}")
        views = VIEWS[:views]
    own["views"] = tuple((float(yaw), float(pitch)) for yaw, pitch in views)
    return configure(BallsConfig(), own, "balls")


def geometry_of(config: BallsConfig, use: int, kind: str = "true", amount: float = 0.0) -> Geometry:
    """How the first views see each other, as a method is told.

    Args:
        config: the views.
        use: number of them.
        kind: `true`; `none`: nothing is known; wrong ones: `shift`: every line is `amount` px lower,
            `turn`: the images are taken for turned by `amount` degrees against each other,
            `swap`: the matrix of the opposite direction.
        amount: how wrong.

    Raises:
        InputError: a kind that is none of `WRONG`.
    """
    if kind not in WRONG:
        raise InputError(f"trial: fundamental is {kind!r}, must be one of {', '.join(WRONG)}")
    cameras = ball_cameras(config)
    matrices = np.full((use, use, 3, 3), np.nan)
    for a in range(use):
        for b in range(a + 1, use):
            if kind != "none":
                right = fundamental_of_cameras(cameras[a], cameras[b])
                matrices[a, b] = _made_wrong(right, kind, amount, (config.width, config.height))
                matrices[b, a] = matrices[a, b].T
    return Geometry(matrices, (None,) * use)


def _made_wrong(right: Floats, kind: str, amount: float, size: tuple[int, int]) -> Floats:
    if kind == "swap":
        return right.T.copy()
    move = np.eye(3)
    if kind == "shift":
        move[1, 2] = amount
    elif kind == "turn":
        c, s = math.cos(math.radians(amount)), math.sin(math.radians(amount))
        x, y = 0.5 * (size[0] - 1), 0.5 * (size[1] - 1)
        move[:2] = [[c, -s, x - c * x + s * y], [s, c, y - s * x - c * y]]
    # Points of b are taken for points moved by `move`: b' F a = 0 becomes (move^-1 b)' F a = 0.
    return scaled(np.linalg.inv(move).T @ right)


@functools.lru_cache(maxsize=8)
def first_frame(config: BallsConfig, seed: int) -> BallsFrame:
    """The first frame of a video."""
    return next(iter(render_balls(config, seed)))


def births_of(frame: BallsFrame, use: int, wrong: Sequence[int] | None = None) -> tuple[Birth, ...]:
    """Trackers for all targets in the first views, on their true outlines.

    Args:
        frame: the first one.
        use: number of views.
        wrong: (view, target, other): there the tracker of `target` is put on `other`.
    """
    out = []
    for view, ellipses in enumerate(frame.ellipses[:use]):
        for target in range(len(ellipses)):
            put = wrong[2] if wrong is not None and (view, target) == (wrong[0], wrong[1]) else target
            out.append(Birth(view, target, ellipses[put].copy()))
    return tuple(out)


def views_of(config: BallsConfig) -> tuple[View, ...]:
    """The cameras."""
    return tuple(View(c.name, config.width, config.height) for c in ball_cameras(config))


def looks_of(frame: BallsFrame, use: int) -> Looks:
    """The first views of a frame as methods take it."""
    return Looks(frame.frame * FRAME_NS, np.full(use, frame.frame, dtype=np.int64), frame.images[:use])


def follow(
    config: BallsConfig, seed: int, runners: Mapping[str, Runner], seen: Callable[[Step], None] | None = None
) -> tuple[dict[str, Followed], Objects, Floats]:
    """All methods on one video.

    Args:
        config: the video.
        seed: of the video.
        runners: methods by label.
        seen: is told of each frame, and of what each method made of it.

    Returns:
        What came of each method; the truth as boxes, with `view`; and the radius of each true row [px].
    """
    done: dict[str, list[Rows]] = {label: [] for label in runners}
    seconds: dict[str, list[float]] = {label: [] for label in runners}
    parts: dict[str, list[tuple[float, float, float]]] = {label: [] for label in runners}
    states, rngs = {}, {label: generator(r.seed, Stage.TRACK) for label, r in runners.items()}
    frames: list[BallsFrame] = []
    views = views_of(config)
    for frame in render_balls(config, seed):
        for label, r in runners.items():
            looks = looks_of(frame, r.use)
            if not frames:
                fresh = r.visual.init(views[: r.use], r.geometry, r.config, rngs[label])
                states[label] = r.visual.born(fresh, looks, r.births)
                done[label].append(_first(r.births))
                continue
            if r.exchange is not None and r.exchange[3] == frame.frame:
                states[label] = exchanged(states[label], *r.exchange[:3])
            if r.timed:
                parts[label].append(likelihood_seconds(states[label], looks, np.random.default_rng(frame.frame)))
            start = time.thread_time()
            states[label], outlines = r.visual.step(states[label], looks, rngs[label])
            seconds[label].append(time.thread_time() - start)
            done[label].append(_rows(frame.frame, outlines))
        if seen is not None:
            seen(Step(frame, {label: rows[-1] for label, rows in done.items()}))
        frames.append(frame._replace(images=()))
    truth, radius = truth_of(frames)
    return {label: _joined(done[label], seconds[label], parts[label]) for label in runners}, truth, radius


def exchanged(state: Any, view: int, one: int, other: int) -> Any:
    """The state with two trackers of a view in each other's place; InputError where it has no such trackers."""
    if not isinstance(state, State):
        raise InputError("trial: trackers of this method cannot be exchanged")
    t = state.trackers
    rows = [np.flatnonzero((t.view == view) & (t.target == k)) for k in (one, other)]
    if any(len(r) != 1 for r in rows):
        raise InputError(f"trial: view {view} has no trackers of {one} and {other} to exchange")
    order = np.arange(len(t.view))
    order[np.concatenate(rows)] = order[np.concatenate(rows[::-1])]
    return state._replace(trackers=t._replace(**{name: getattr(t, name)[order] for name in PLACED}))


def _first(births: Sequence[Birth]) -> Rows:
    n = len(births)
    view = np.array([b.view for b in births], dtype=np.int64)
    target = np.array([b.target_id for b in births], dtype=np.int64)
    zero = np.zeros(n, dtype=np.int64)
    ellipse, none = np.stack([b.ellipse for b in births]), np.full(n, np.nan)
    return Rows(zero, view, target, ellipse, zero - 1, zero, zero + START, none, None)


def _rows(frame: int, o: Outlines) -> Rows:
    at = np.full(len(o.view), frame, dtype=np.int64)
    return Rows(at, o.view, o.target_id, o.ellipse, o.mode, o.counterpart, o.event, o.ess, o._replace())


def _joined(
    rows: Sequence[Rows], seconds: Sequence[float], parts: Sequence[tuple[float, float, float]]
) -> Followed:  # fmt: skip
    columns: list[Any] = [np.concatenate(column) for column in zip(*(r[:-1] for r in rows), strict=True)]
    columns += [np.array(seconds), np.array(parts).reshape(-1, 3)]
    return Followed(*columns)


def truth_of(frames: Sequence[BallsFrame]) -> tuple[Objects, Floats]:
    """True boxes of all targets in all frames and views, hidden ones too, and the radius of each [px]."""
    ellipses = np.stack([f.ellipses for f in frames])
    T, V, n = ellipses.shape[:3]
    t, view, target = (a.ravel() for a in np.meshgrid(np.arange(T), np.arange(V), np.arange(n), indexing="ij"))
    numbers = np.array([f.frame for f in frames], dtype=np.int64)
    boxes = boxes_of(ellipses.reshape(-1, 5))
    return Objects(numbers[t], target, boxes, view), 0.5 * np.sqrt(boxes[:, 2] * boxes[:, 3])


def of_views(truth: Objects, radius: Floats, use: int) -> tuple[Objects, Floats]:
    """The rows of the first views of what `truth_of` gives."""
    assert truth.view is not None
    kept = truth.view < use
    return Objects(truth.frame[kept], truth.label[kept], truth.place[kept], truth.view[kept]), radius[kept]


def boxes_of(ellipses: Floats) -> Floats:
    """(n, 4) left, top, width, height of the boxes about ellipses (n, 5)."""
    half = np.column_stack([support_radius(ellipses, 0.0), support_radius(ellipses, 0.5 * math.pi)])
    return np.column_stack([ellipses[:, :2] - half, 2.0 * half])
