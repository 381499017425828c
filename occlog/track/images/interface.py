"""Interface of the methods that track in the images of several views: frames in, ellipses out, and a state in between.

There is one state for all targets and views.  `init` makes it without trackers, `born` adds
trackers, and `step` takes in the frames of one time.  None of them changes its arguments,
except the generator, from which it draws, and buffers inside the state that only the latest
state may use.  A target has at most one tracker in each view; all of them carry its identity.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from occlog.array_types import Bools, Floats, Ints
from occlog.measure.epipolar.views import Geometry, View

Image = NDArray[np.uint8]
"""(H, W, 3) BGR or (H, W) grey."""
TrackerKey = tuple[int, int]
"""View and target of a tracker."""

MODES = ("mipf", "idmot", "bmct", "cmct", "mcmc")
"""`Outlines.mode` counts in this order."""
NONE, BAD, GOOD = 1, 2, 3
"""`Outlines.counterpart`, places in `occlog.records.declared.views.COUNTERPARTS`; 0: not checked."""
START, LEFT, LOST = 1, 2, 3
"""`Outlines.event`, places in `occlog.records.declared.views.EVENTS`; 0: none."""


class Birth(NamedTuple):
    """A target that gets a tracker in a view."""

    view: int
    target_id: int
    ellipse: Floats  # (5,) see `occlog.core.image.ellipse`


class FrameSet(NamedTuple):
    """The frames of V views at one time."""

    t_ns: int
    number: Ints  # (V,) number of each view's frame; -1: none
    images: tuple[Image | None, ...]  # (V,) None: the view has no frame at this time
    regions: tuple[Floats | None, ...] = ()  # (V,) a detector's ellipses (K, 5); None: it did not look; (): no detector
    masks: tuple[Image | None, ...] = ()  # (V,) (H, W), 0 on the background; None or (): not known


class Outlines(NamedTuple):
    """The n trackers of the views that had a frame, ordered by view and target, after that frame."""

    view: Ints  # (n,)
    target_id: Ints  # (n,)
    ellipse: Floats  # (n, 5)
    covariance: Floats  # (n, 3) of the centre: xx, xy, yy [px^2]
    likeness: Floats  # (n,) Bhattacharyya coefficient of the colours, 0 to 1; NaN: not known
    ess: Floats  # (n,) effective sample size; NaN: no particles
    mode: Ints  # (n,) place in `MODES`
    counterpart: Ints  # (n,) `NONE`, `BAD` or `GOOD`; 0: not checked
    touching: Bools  # (n, n) which of them touch; false between views
    helpers: Bools  # (n, V) views whose trackers of the same target helped
    event: Ints  # (n,) `LEFT` and `LOST` trackers have ended with this frame; 0: none


S = TypeVar("S")
"""State of a method."""
C = TypeVar("C")
"""Settings of a method: a frozen dataclass, validated, see `occlog.settings.configure`."""


class Collaboration(NamedTuple, Generic[S, C]):
    """How a method uses the epipolar geometry between views."""

    alone: str  # what the method does where no other view can help
    at_bottom: Callable[[C], bool]  # whether the lowest points of ellipses stand for targets; else their centres
    with_geometry: Callable[[S, Geometry], S]  # the state for the same views, of which fewer matrices are known


class Visual(NamedTuple, Generic[S, C]):
    """A method that tracks in images."""

    config: type[C]
    init: Callable[[Sequence[View], Geometry, C, Generator], S]  # the state without trackers
    born: Callable[[S, FrameSet, Sequence[Birth]], S]  # adds trackers, whose appearance is that in the frames
    step: Callable[[S, FrameSet, Generator], tuple[S, Outlines]]  # takes in the frames after those of births
    ended: Callable[[S, Sequence[TrackerKey]], S]  # removes trackers
    collaboration: Collaboration[S, C] | None = None  # None: views do not help each other


AnyVisual = Visual[Any, Any]
"""A method that was chosen by its name; only the method itself knows the types of its state and settings."""
