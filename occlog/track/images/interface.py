"""What a method that tracks in the images of several views is: frames in, ellipses out, and a state in between.

There is one state for all targets and views.  `init` makes it without a tracker, `born`
adds trackers, and `step` takes in the frames of one time; none of them changes its
arguments but for the generator, from which it draws, and buffers inside the state that only
the latest state may use.  A target has at most one tracker in each view, all with its identity.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from occlog.array_types import Bools, Floats, Ints
from occlog.measure.epipolar.views import Geometry, View

Image = NDArray[np.uint8]
"""(H, W, 3) BGR or (H, W) grey."""

MODES = ("mipf", "idmot", "bmct", "cmct", "mcmc")
"""`Outlines.mode` counts in this order."""
NONE, BAD, GOOD = 1, 2, 3
"""`Outlines.counterpart`, places in `occlog.records.views.COUNTERPARTS`; 0: not checked."""
START, LEFT, LOST = 1, 2, 3
"""`Outlines.event`, places in `occlog.records.views.EVENTS`; 0: none."""


class Birth(NamedTuple):
    """A target that is to be tracked in a view from now on."""

    view: int
    target_id: int
    ellipse: Floats  # (5,) see `occlog.core.image.ellipse`


class Looks(NamedTuple):
    """The frames of all views at one time."""

    t_ns: int
    frame: Ints  # (V,) number of each view's frame; -1: none
    images: tuple[Image | None, ...]  # (V,) None: the view has no frame at this time
    regions: tuple[Floats | None, ...] = ()  # (V,) a detector's ellipses (K, 5); None: it did not look; (): no detector
    masks: tuple[Image | None, ...] = ()  # (V,) (H, W), 0 where there is background; None, (): not told


class Outlines(NamedTuple):
    """The n trackers of the views that had a frame, by view and target, after it."""

    view: Ints  # (n,)
    target_id: Ints  # (n,)
    ellipse: Floats  # (n, 5)
    covariance: Floats  # (n, 3) of the centre: xx, xy, yy
    likeness: Floats  # (n,) NaN: not known
    ess: Floats  # (n,) NaN: no particles
    mode: Ints  # (n,) place in `MODES`
    counterpart: Ints  # (n,)
    touching: Bools  # (n, n) which of them touch; false between views
    helpers: Bools  # (n, V) views that helped
    event: Ints  # (n,) a tracker that `LEFT` or is `LOST` is gone after this


class Visual(NamedTuple):
    """A method that tracks in images."""

    summary: str
    config: type  # frozen dataclass of its settings, validated; see `settings.configure`
    init: Callable[[Sequence[View], Geometry, Any, Generator], Any]  # the state without trackers
    born: Callable[[Any, Looks, Sequence[Birth]], Any]  # state with new trackers, whose colours are those in the frames
    step: Callable[[Any, Looks, Generator], tuple[Any, Outlines]]  # the frames after those of births
    ended: Callable[[Any, Sequence[tuple[int, int]]], Any] | None = None  # state without the trackers (view, target_id)
