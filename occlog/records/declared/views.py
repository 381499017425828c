"""The tables of trackers that work in the images: their estimates, and where these fail.  Conventions: see `tables`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from occlog.array_types import Floats, Ints, Ints32, Strings
from occlog.records.columns import ColumnTable, column

from .sensors import Boxes

EVENTS = ("", "start", "left", "terminated")
"""`event` of a view track."""
COUNTERPARTS = ("", "none", "bad", "good")
"""`counterpart` of a view track."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewTracks(ColumnTable):
    """Targets tracked in the images: a row for each tracker and frame of its view.

    A target has one tracker in each view; the trackers of one target share its identity.
    """

    NAME: ClassVar[str] = "view_tracks"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "sensor", "target_id")
    ONCE: ClassVar[bool] = True

    t_ns: Ints = column("time of the frame since the Unix epoch", "ns")
    sensor: Strings = column("name of the camera in the scene")
    frame: Ints = column("number of the frame in the camera's stream, from 0")
    target_id: Ints32 = column("identity of the target, the same in all views")
    x_px: Floats = column("estimated centre of the ellipse in the image as recorded, to the right", "px")
    y_px: Floats = column("estimated centre of the ellipse in the image as recorded, down", "px")
    a_px: Floats = column("half axis along rho, > 0", "px")
    b_px: Floats = column("half axis across rho, > 0", "px")
    rho: Floats = column("angle of axis a, from +x (to the right) to +y (down), in [-pi/2, pi/2)", "rad")
    cov_xx_px: Floats = column("covariance of the centre", "px^2")
    cov_xy_px: Floats = column("covariance of the centre", "px^2")
    cov_yy_px: Floats = column("covariance of the centre", "px^2")
    similarity: Floats = column(
        "Bhattacharyya coefficient of the estimate's colours with the target's, 0 to 1",
        nan="the method compares no colours",
    )
    ess: Floats = column(
        "effective sample size of the weights, 1 to the number of particles", nan="the method has no particles"
    )
    likelihood_mode: Strings = column(
        "what the tracker did in the frame: `mipf` (alone), `idmot` (repulsion by its neighbours), `bmct` (other "
        "views too), `cmct`, `mcmc`; empty in the row where it starts. Of trackers of boxes: `box` (the frame has a "
        "box of the target), `ground` (the position on the ground alone), `predicted` (boxes of other frames)"
    )
    counterpart: Strings = column(
        "the target in other views by the loop check: `good`, `bad`, `none`; empty: not checked"
    )
    neighbours: Strings = column("targets that it touches, separated by commas")
    assisting_views: Strings = column("views that helped it in the frame, separated by commas")
    lifecycle: Strings = column("empty; `start` of the tracker; its last row: `left` the image, or `terminated`")

    def check(self) -> None:
        """InputError unless half axes are positive, and identities at least 0.

        `lifecycle` and `counterpart` must have known values.
        """
        self.refuse(~((self.a_px > 0) & (self.b_px > 0)), "half axes {a_px:g} and {b_px:g} px must be above 0")
        self.refuse(self.target_id < 0, "target_id {target_id} must be at least 0")
        for name, known in (("lifecycle", EVENTS), ("counterpart", COUNTERPARTS)):
            words = ", ".join(word or "empty" for word in known)
            self.refuse(~np.isin(getattr(self, name), known), f"{name} {{{name}!r}} must be one of {words}")


@dataclass(frozen=True, slots=True, eq=False)
class Failures(ColumnTable):
    """Failures of single-target trackers by frame and view: a target without tracker, or a tracker on another target.

    Position failures and label failures of [Qu] Eq. 9.
    """

    NAME: ClassVar[str] = "failures"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "sensor", "target_id")

    t_ns: Ints = column("time of the frame since the Unix epoch", "ns")
    sensor: Strings = column("name of the camera; empty: on the ground")
    frame: Ints = column("number of the frame in the camera's stream, from 0; on the ground: of the time")
    target_id: Ints32 = column(
        "position failure: the target that has no tracker; label failure: the tracker's own target"
    )
    kind: Strings = column("`position` (no tracker on the target) or `label` (tracker on another target)")
    other_id: Ints32 = column("label failure: the target that the tracker is on; position failure: -1")
    cause: Strings = column("the same in words")
    visible: Floats = column(
        "visible share of the target: of the one without a tracker, or the one that a tracker left",
        nan="unknown in the truth",
    )

    def check(self) -> None:
        """InputError unless each kind is `position` or `label`."""
        self.refuse(~np.isin(self.kind, ("position", "label")), "kind {kind!r} must be position or label")


@dataclass(frozen=True, slots=True, eq=False)
class Counts(ColumnTable):
    """Numbers of true targets and tracks on the ground at each time, of pairs, misses, false tracks and switches."""

    NAME: ClassVar[str] = "counts"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns",)

    t_ns: Ints = column("time of the frame since the Unix epoch", "ns")
    frame: Ints = column("number of the time among those of the truth, from 0")
    targets: Ints = column("true targets")
    tracks: Ints = column("tracks")
    paired: Ints = column("targets with a track within the match distance, one to one")
    missed: Ints = column("targets without")
    false: Ints = column("tracks without a target")
    switches: Ints = column("targets with another track than they had last")


def boxes_of_ellipses(tracks: ViewTracks) -> Boxes:
    """Upright bounding boxes of the ellipses of tracks, not clipped to the image: a row of `Boxes` for each row.

    Times, cameras, frames and identities are those of the tracks; boxes are numbered through the whole table, and the
    confidence is NaN.
    """
    cos, sin = np.cos(tracks.rho), np.sin(tracks.rho)
    half_width = np.hypot(tracks.a_px * cos, tracks.b_px * sin)
    half_height = np.hypot(tracks.a_px * sin, tracks.b_px * cos)
    n = len(tracks)
    return Boxes.of(
        t_ns=tracks.t_ns,
        sensor=tracks.sensor,
        frame=tracks.frame,
        box=np.arange(n, dtype=np.int32),
        target_id=tracks.target_id,
        left_px=tracks.x_px - half_width,
        top_px=tracks.y_px - half_height,
        width_px=2.0 * half_width,
        height_px=2.0 * half_height,
        confidence=np.full(n, np.nan),
    )
