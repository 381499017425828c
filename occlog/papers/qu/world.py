"""The synthetic video of [Qu] Sec. 4.1 in memory: its views, how they see each other, and its truth."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence

import numpy as np

from occlog.array_types import Floats
from occlog.core.geometry.fundamental import scaled
from occlog.core.image import support_radius
from occlog.core.metrics.mot.frame_pairs import Objects
from occlog.errors import InputError
from occlog.measure.epipolar.from_scene import fundamental_of_cameras
from occlog.measure.epipolar.views import TrackedView, ViewGeometry
from occlog.simulate.balls.config import BallsConfig
from occlog.simulate.balls.motion import ball_cameras
from occlog.simulate.balls.video import BallsFrame
from occlog.track.methods.images.interface import Birth, FrameSet

from .staged import Staging, video_of

FRAME_NS = 40_000_000
"""Time between frames; there are 25 a second."""
WRONG = ("true", "none", "shift", "turn", "swap")
"""Kinds of fundamental matrices that a method may be given, right and wrong ones; see `geometry_of`."""


def geometry_of(config: BallsConfig, use: int, kind: str = "true", amount: float = 0.0) -> ViewGeometry:
    """Fundamental matrices between the first views that a method is given, right or wrong.

    Args:
        config: settings of the video.
        use: number of views.
        kind: `true`: the right ones. `none`: none at all. `shift`: with every line `amount` px lower. `turn`: as if the
            images were turned by `amount` degrees against each other. `swap`: those of the opposite direction.
        amount: size of the error [px or degrees].

    Raises:
        InputError: a kind that is none of `WRONG`.
    """
    if kind not in WRONG:
        raise InputError(f"trial: fundamental is {kind!r}, must be one of {', '.join(WRONG)}", id="unknown-name")
    cameras = ball_cameras(config)
    matrices = np.full((use, use, 3, 3), np.nan)
    for a in range(use):
        for b in range(a + 1, use):
            if kind != "none":
                right = fundamental_of_cameras(cameras[a], cameras[b])
                matrices[a, b] = _made_wrong(right, kind, amount, (config.width, config.height))
                matrices[b, a] = matrices[a, b].T
    return ViewGeometry(matrices, (None,) * use)


def _made_wrong(right: Floats, kind: str, amount: float, size: tuple[int, int]) -> Floats:
    """Wrong fundamental matrix (3, 3) from the right one; unchanged but for its scale for the kind `true`.

    Args:
        right: (3, 3) right matrix.
        kind: one of `WRONG`, without `none`.
        amount: size of the error [px or degrees].
        size: width and height of the images [px].
    """
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


FLYING = Staging()
"""Balls that fly about, and are seen by all views."""


@functools.lru_cache(maxsize=8)
def first_frame(config: BallsConfig, seed: int, staging: Staging = FLYING) -> BallsFrame:
    """First frame of a video; the last few results are kept."""
    return next(video_of(config, seed, staging))


def births_of(frame: BallsFrame, use: int, wrong: Sequence[int] | None = None) -> tuple[Birth, ...]:
    """Initial trackers on the true outlines of all targets, in each of the first views that sees them.

    Args:
        frame: first frame of the video.
        use: number of views.
        wrong: (view, target, other): in this view the tracker of `target` is put on `other`; None: none is.
    """
    out = []
    for view, ellipses in enumerate(frame.ellipses[:use]):
        for target in range(len(ellipses)):
            if np.isnan(ellipses[target]).any():
                continue
            put = wrong[2] if wrong is not None and (view, target) == (wrong[0], wrong[1]) else target
            out.append(Birth(view, target, ellipses[put].copy()))
    return tuple(out)


def views_of(config: BallsConfig) -> tuple[TrackedView, ...]:
    """Names and image sizes of all views."""
    return tuple(TrackedView(c.name, config.width, config.height) for c in ball_cameras(config))


def frame_set_of(frame: BallsFrame, use: int) -> FrameSet:
    """Images of the first `use` views of a frame, with their times, in the form that methods take."""
    return FrameSet(frame.frame * FRAME_NS, np.full(use, frame.frame, dtype=np.int64), frame.images[:use])


def truth_of(frames: Sequence[BallsFrame]) -> tuple[Objects, Floats]:
    """True boxes of all targets in all frames and views, hidden ones too, and the radius of each [px].

    A target that a view does not see (NaN) has no box there.
    """
    ellipses = np.stack([f.ellipses for f in frames])
    T, V, n = ellipses.shape[:3]
    t, view, target = (a.ravel() for a in np.meshgrid(np.arange(T), np.arange(V), np.arange(n), indexing="ij"))
    numbers = np.array([f.frame for f in frames], dtype=np.int64)
    outlines = ellipses.reshape(-1, 5)
    seen = ~np.isnan(outlines).any(axis=1)
    boxes = boxes_of(outlines[seen])
    return Objects(numbers[t[seen]], target[seen], boxes, view[seen]), 0.5 * np.sqrt(boxes[:, 2] * boxes[:, 3])


def of_views(truth: Objects, radius: Floats, use: int) -> tuple[Objects, Floats]:
    """Those of n true boxes and their radii that belong to the first `use` views.

    Args:
        truth: n true boxes, with views.
        radius: (n,) radii [px].
        use: number of views.
    """
    assert truth.view is not None
    kept = truth.view < use
    return Objects(truth.frame[kept], truth.label[kept], truth.position[kept], truth.view[kept]), radius[kept]


def boxes_of(ellipses: Floats) -> Floats:
    """Boxes (n, 4): left, top, width, height [px] around ellipses (n, 5): centre x, y, half axes [px], angle [rad]."""
    half = np.column_stack([support_radius(ellipses, 0.0), support_radius(ellipses, 0.5 * math.pi)])
    return np.column_stack([ellipses[:, :2] - half, 2.0 * half])
