"""The tables of trackers that work in the images: their estimates, and where these fail.  Conventions: see `tables`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from occlog.array_types import Floats, Ints, Ints32, Strings
from occlog.errors import InputError
from occlog.records.columns import ColumnTable, check_order, column, first_row

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

    t_ns: Ints = column("i8", "ns", "time of the frame since the Unix epoch")
    sensor: Strings = column("U", "1", "name of the camera in the scene")
    frame: Ints = column("i8", "1", "number of the frame in the camera's stream, from 0")
    target_id: Ints32 = column("i4", "1", "identity of the target, the same in all views")
    x_px: Floats = column("f8", "px", "estimated centre of the ellipse in the image as recorded, to the right")
    y_px: Floats = column("f8", "px", "estimated centre of the ellipse in the image as recorded, down")
    a_px: Floats = column("f8", "px", "half axis along rho, > 0")
    b_px: Floats = column("f8", "px", "half axis across rho, > 0")
    rho: Floats = column("f8", "rad", "angle of axis a, from +x (to the right) to +y (down), in [-pi/2, pi/2)")
    cov_xx_px: Floats = column("f8", "px^2", "covariance of the centre")
    cov_xy_px: Floats = column("f8", "px^2", "covariance of the centre")
    cov_yy_px: Floats = column("f8", "px^2", "covariance of the centre")
    similarity: Floats = column(
        "f8",
        "1",
        "Bhattacharyya coefficient of the estimate's colours with the target's, 0 to 1",
        nan="the method compares no colours",
    )
    ess: Floats = column(
        "f8",
        "1",
        "effective sample size of the weights, 1 to the number of particles",
        nan="the method has no particles",
    )
    likelihood_mode: Strings = column(
        "U",
        "1",
        "what the tracker did in the frame: `mipf` (alone), `idmot` (repulsion by its neighbours), `bmct` "
        "(other views too), `cmct`, `mcmc`; empty in the row where it starts. Of trackers of boxes: `box` (the frame "
        "has a box of the target), `ground` (the position on the ground alone), `predicted` (boxes of other frames)",
    )
    counterpart: Strings = column(
        "U", "1", "the target in other views by the loop check: `good`, `bad`, `none`; empty: not checked"
    )
    neighbours: Strings = column("U", "1", "targets that it touches, separated by commas")
    assisting_views: Strings = column("U", "1", "views that helped it in the frame, separated by commas")
    lifecycle: Strings = column(
        "U", "1", "empty; `start` of the tracker; its last row: `left` the image, or `terminated`"
    )

    def check(self) -> None:
        """InputError unless times are in order, half axes positive, and identities at least 0.

        `lifecycle` and `counterpart` must have known values.
        """
        check_order(self)
        if (bad := ~((self.a_px > 0) & (self.b_px > 0))).any():
            row = first_row(bad)
            raise InputError(
                f"ViewTracks: row {row}: half axes {self.a_px[row]:g} and {self.b_px[row]:g} px must be above 0"
            )
        if (bad := self.target_id < 0).any():
            row = first_row(bad)
            raise InputError(f"ViewTracks: row {row}: target_id {self.target_id[row]} must be at least 0")
        for name, known in (("lifecycle", EVENTS), ("counterpart", COUNTERPARTS)):
            values = getattr(self, name)
            if (bad := ~np.isin(values, known)).any():
                words = ", ".join(word or "empty" for word in known)
                raise InputError(
                    f"ViewTracks: row {first_row(bad)}: {name} {str(values[first_row(bad)])!r} must be one of {words}"
                )


@dataclass(frozen=True, slots=True, eq=False)
class Failures(ColumnTable):
    """Failures of single-target trackers by frame and view: a target without tracker, or a tracker on another target.

    Position failures and label failures of [Qu] Eq. 9.
    """

    NAME: ClassVar[str] = "failures"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "sensor", "target_id")

    t_ns: Ints = column("i8", "ns", "time of the frame since the Unix epoch")
    sensor: Strings = column("U", "1", "name of the camera; empty: on the ground")
    frame: Ints = column("i8", "1", "number of the frame in the camera's stream, from 0; on the ground: of the time")
    target_id: Ints32 = column(
        "i4", "1", "position failure: the target that has no tracker; label failure: the tracker's own target"
    )
    kind: Strings = column("U", "1", "`position` (no tracker on the target) or `label` (tracker on another target)")
    other_id: Ints32 = column("i4", "1", "label failure: the target that the tracker is on; position failure: -1")
    cause: Strings = column("U", "1", "the same in words")
    visible: Floats = column(
        "f8",
        "1",
        "visible share of the target: of the one without a tracker, or the one that a tracker left",
        nan="unknown in the truth",
    )

    def check(self) -> None:
        """InputError unless times are in order, and each kind is `position` or `label`."""
        check_order(self)
        if (bad := ~np.isin(self.kind, ("position", "label"))).any():
            row = first_row(bad)
            raise InputError(f"Failures: row {row}: kind {str(self.kind[row])!r} must be position or label")


@dataclass(frozen=True, slots=True, eq=False)
class Counts(ColumnTable):
    """Numbers of true targets and tracks on the ground at each time, of pairs, misses, false tracks and switches."""

    NAME: ClassVar[str] = "counts"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns",)

    t_ns: Ints = column("i8", "ns", "time of the frame since the Unix epoch")
    frame: Ints = column("i8", "1", "number of the time among those of the truth, from 0")
    targets: Ints = column("i8", "1", "true targets")
    tracks: Ints = column("i8", "1", "tracks")
    paired: Ints = column("i8", "1", "targets with a track within the match distance, one to one")
    missed: Ints = column("i8", "1", "targets without")
    false: Ints = column("i8", "1", "tracks without a target")
    switches: Ints = column("i8", "1", "targets with another track than they had last")

    def check(self) -> None:
        """InputError unless times are in order."""
        check_order(self)


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
