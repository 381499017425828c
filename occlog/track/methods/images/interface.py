"""What goes into the methods that track in the images of several views, and what comes out: frames, births, ellipses.

There is one state for all targets and views (`occlog.track.methods.images.methods.state`): `initial_state`
makes it without trackers, `initiate_trackers` adds trackers, and `advance` takes in the frames of
one time.  None of them changes its arguments, except the generator, from which it draws, and buffers
inside the state that only the latest state may use.  A target has at most one tracker in each view;
all of them carry its identity.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Bools, Floats, Ints

Image = NDArray[np.uint8]
"""(H, W, 3) BGR or (H, W) grey."""
TrackerKey = tuple[int, int]
"""View and target of a tracker."""

MODES = ("mipf", "idmot", "bmct", "cmct", "mcmc")
"""`TrackerOutlines.likelihood_mode` counts in this order."""
NONE, BAD, GOOD = 1, 2, 3
"""`TrackerOutlines.counterpart`, indices in `occlog.records.declared.views.COUNTERPARTS`; 0: not checked."""
START, LEFT, TERMINATED = 1, 2, 3
"""`TrackerOutlines.lifecycle`, indices in `occlog.records.declared.views.EVENTS`; 0: none."""


class Birth(NamedTuple):
    """A tracker to be started for target `target_id` in a view, at an ellipse (centre, half axes [px], angle [rad])."""

    view: int
    target_id: int
    ellipse: Floats  # (5,) see `occlog.core.image`


class FrameSet(NamedTuple):
    """Frames of V views at one time step, with a detector's regions and foreground masks where there are any."""

    t_ns: int
    number: Ints  # (V,) number of each view's frame; -1: none
    images: tuple[Image | None, ...]  # (V,) None: the view has no frame at this time
    regions: tuple[Floats | None, ...] = ()  # (V,) a detector's ellipses (K, 5); None: not processed; (): no detector
    masks: tuple[Image | None, ...] = ()  # (V,) (H, W), 0 on the background; None or (): not known


class TrackerOutlines(NamedTuple):
    """Output of one time step: ellipses of the n trackers with a frame of their view, sorted by view and target.

    An ellipse is (centre x, y, half axes a, b [px], angle of axis a [rad]), with the covariance of its centre. The
    other fields describe each tracker: its colour similarity, particles, likelihood, neighbours, helping views and end.
    """

    view: Ints  # (n,)
    target_id: Ints  # (n,)
    ellipse: Floats  # (n, 5)
    covariance: Floats  # (n, 3) of the centre: xx, xy, yy [px^2]
    similarity: Floats  # (n,) Bhattacharyya coefficient of the colours, 0 to 1; NaN: not known
    ess: Floats  # (n,) effective sample size; NaN: no particles
    likelihood_mode: Ints  # (n,) index in `MODES`
    counterpart: Ints  # (n,) `NONE`, `BAD` or `GOOD`; 0: not checked
    touching: Bools  # (n, n) which of them touch; false between views
    assisting_views: Bools  # (n, V) views with trackers of the same target that helped
    lifecycle: Ints  # (n,) `LEFT` and `TERMINATED` trackers have ended with this frame; 0: none
