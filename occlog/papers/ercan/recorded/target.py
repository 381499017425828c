"""The target of a recording without ground truth: its own detections, and a stand-in for its true path.

A filter over the detections of all cameras finds the target; of each camera's detections the one
nearest to its track is the target's own.  The stand-in for the true path uses no filter: it is the
points at which the sight lines of these detections meet, smoothed over the meetings before and after.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.sight.triangulate import MET
from occlog.errors import InputError
from occlog.evaluate.bearings.meeting import meeting_points
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.measure.label.config import LabelConfig
from occlog.measure.label.stage import label
from occlog.records.scene import Scene
from occlog.records.tables import UNLABELLED, Bearings, Tracks, Truth
from occlog.track.apf.config import ApfConfig
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import Tracking

TARGET = 0
GATE = 3.0
"""Largest distance of the target's own detection from its track, in standard deviations."""
SKIP = 10
"""Estimates left out at the start, while a filter finds the target."""
LINES = 3
"""Sight lines that must meet (two, where a recording has no more cameras)."""
MEETINGS = 7
"""Meetings, the nearest in time, to which a parabola is fitted."""


@dataclass(frozen=True)
class Recorded:
    """A recorded target: its own bearings, and the stand-in for its true path."""

    scene: Scene
    bearings: Bearings  # of the target alone, labelled
    places: Truth  # the stand-in for the truth, at every time of the bearings

    @property
    def start(self) -> Floats:
        """(2,) first place."""
        return np.array([self.places.x[0], self.places.y[0]])

    @property
    def cameras(self) -> tuple[str, ...]:
        """Cameras that saw the target at least once, in the order of the scene."""
        seen = set(self.bearings.sensor[self.bearings.seen].tolist())
        return tuple(c.name for c in self.scene.cameras if c.name in seen)


def recorded_target(scene: Scene, bearings: Bearings) -> Recorded:
    """Find the target of a recording in metres; InputError if there is none, or fewer than two cameras see it.

    Args:
        scene: cameras with poses.
        bearings: labelled or not; of labelled ones only those of the first target are used.
    """
    if scene.length_unit != "m":
        raise InputError(f"the recording is in {scene.length_unit}, the experiment wants metres")
    config = replace(ApfConfig.in_unit("m"), particles=4000)
    tracks = Tracks.concat([p.tracks for p in track([bearings], scene, Tracking(config, 0))])
    if len(tracks) <= SKIP + 1:
        raise InputError(f"{len(tracks)} times with detections, want more than {SKIP + 1}")
    target = tracks.target_id[0]
    tracks = tracks.take(tracks.target_id == target)
    own = np.isin(bearings.target_id, (UNLABELLED, target)) & np.isin(bearings.t_ns, tracks.t_ns)
    mine = assign(scene, bearings.take(own), tracks)
    found = set(mine.sensor[mine.seen].tolist())
    if len(found) < 2:
        raise InputError(f"{len(found)} cameras saw the target, want at least 2")
    places = stand_in(scene, mine, min(LINES, len(found)))
    return Recorded(scene, mine.take(np.isin(mine.t_ns, places.t_ns)), places)


def assign(scene: Scene, bearings: Bearings, tracks: Tracks) -> Bearings:
    """Return one row of every camera and frame: its detection nearest to a track, or "not seen" where none is near.

    Labels of the detections are not used.  Microphone arrays are left out, since they see nothing.
    """
    own = bearings.take(np.isin(bearings.sensor, [c.name for c in scene.cameras]))
    free = replace(own, target_id=np.full(len(own), UNLABELLED, dtype=np.int32))
    path = replace(tracks, target_id=np.full(len(tracks), TARGET, dtype=np.int32))
    return Bearings.concat([part.bearings for part in label([free], [path], scene, LabelConfig(gate=GATE))])


def unseen(bearings: Bearings, rows: Bools) -> Bearings:
    """Return the bearings with "not seen" in some rows, (n,) true."""
    nothing = {
        n: np.where(rows, np.nan, getattr(bearings, n)) for n in ("bearing", "sigma", "u_px", "sigma_px", "score")
    }
    return replace(bearings, seen=bearings.seen & ~rows, **nothing)


def stand_in(scene: Scene, mine: Bearings, lines: int) -> Truth:
    """Place the target at each time of its bearings, from the first meeting of sight lines to the last.

    Args:
        scene: cameras with poses.
        mine: the target's own bearings.
        lines: number of sight lines that must meet, at least 2.

    Raises:
        InputError: too few meetings to smooth.
    """
    met = meeting_points(mine, scene, EvaluateConfig(lines_min_sensors=lines))[TARGET]
    good = met.status == MET
    if good.sum() < MEETINGS:
        raise InputError(f"{lines} sight lines met at {good.sum()} times, want at least {MEETINGS}")
    at, xy = met.t_ns[good], met.xy[good]
    weight = 1.0 / np.sqrt(met.covariance[good, 0, 0] + met.covariance[good, 1, 1])
    times = np.unique(mine.t_ns)
    times = times[(times >= at[0]) & (times <= at[-1])]
    places = smoothed(at, xy, weight, times)
    n = len(times)
    return Truth.of(
        t_ns=times,
        target_id=np.full(n, TARGET),
        role=["target"] * n,
        x=places[:, 0],
        y=places[:, 1],
        z=np.full(n, np.nan),
    )


def smoothed(at: Ints, xy: Floats, weight: Floats, times: Ints) -> Floats:
    """Return (n, 2) places at `times` on parabolas fitted to the nearest points by weighted least squares.

    Args:
        at: (S,) times of the points, rising, at least `MEETINGS` of them.
        xy: (S, 2) points.
        weight: (S,) one over their standard deviations.
        times: (n,) from the first of `at` to the last.
    """
    out = np.empty((len(times), 2))
    for i, t in enumerate(times.tolist()):
        near = np.argsort(np.abs(at - t), kind="stable")[:MEETINGS]
        since = (at[near] - t) * 1e-9
        rows = np.column_stack([np.ones(MEETINGS), since, since**2]) * weight[near, None]
        out[i] = np.linalg.lstsq(rows, xy[near] * weight[near, None], rcond=None)[0][0]
    return out
