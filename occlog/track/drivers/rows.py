"""Estimates of filters as rows of the tables that tracking gives out, chunk by chunk.

Particles of filters as rows of a table: a cloud of each target at each time, thinned so that it can be drawn.

What tracking costs the network: messages and bytes, and what the selection of cameras saves.

Every camera that is asked sends one message a scan, whether it sees the target or not: its
name (2 bytes), the time (8), and a reading with its standard deviation (4 each).  When
the selection changes, every camera that is switched on or off gets a message with its name
and the order (4 bytes).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints, Ints32
from occlog.consistency.bearings import CandidateFrames, StatedResiduals
from occlog.consistency.estimates import RivalTrajectory
from occlog.consistency.labels import MotionCheck
from occlog.filtering.particles import systematic_ancestors
from occlog.records.tables import Calibration, Cooperation, Diagnostics, Particles, Residuals, Tracks
from occlog.scans.label_continuity import LabelEvents
from occlog.track.interface import BearingResiduals, Estimate, HeightEstimate, NoiseScales, ParticleSet, SmoothedState

MAX_PARTICLES = 200
"""Particles of one cloud."""


def downsample(cloud: ParticleSet, most: int = MAX_PARTICLES) -> ParticleSet:
    """Return at most `most` particles for drawing: the set itself, or particles of equal weight resampled from it.

    Systematic resampling without random numbers: a particle of weight w is kept w * `most` times, rounded up or down.
    Mean and covariance are kept approximately.
    """
    if len(cloud.weights) <= most:
        return cloud
    chosen = systematic_ancestors(cloud.weights, most, 0.5)
    return ParticleSet(cloud.xy[chosen], np.full(most, 1.0 / most))


def particle_rows(clouds: Sequence[tuple[int, int, ParticleSet]]) -> Particles:
    """Return table `particles` of particle sets, each given with its time [ns] and target identity, in their order."""
    if not clouds:
        return Particles.empty()
    sizes: Ints = np.array([len(cloud.weights) for _, _, cloud in clouds], dtype=np.int64)
    xy = np.concatenate([cloud.xy for _, _, cloud in clouds])
    return Particles.of(
        t_ns=np.repeat(np.array([t_ns for t_ns, _, _ in clouds], dtype=np.int64), sizes),
        target_id=np.repeat(np.array([target for _, target, _ in clouds], dtype=np.int32), sizes),
        particle=np.concatenate([np.arange(n, dtype=np.int32) for n in sizes.tolist()]),
        x=xy[:, 0],
        y=xy[:, 1],
        weight=np.concatenate([cloud.weights for _, _, cloud in clouds]),
    )


class Solve(NamedTuple):
    """One optimisation run of a batch method for one target.

    `iterations` and whether it converged; estimated `noise` factors (None: as stated), competing modes `rivals` (None:
    not searched), and range `biases` as (station, bias, standard error).
    """

    target: int
    iterations: int
    converged: bool
    noise: NoiseScales | None = None  # None: taken as stated
    rivals: tuple[RivalTrajectory, ...] | None = None  # None: none were sought
    biases: tuple[tuple[str, float, float], ...] = ()  # station, constant error of its ranges, standard error


class TrackChunk(NamedTuple):
    """A chunk of output: rows of tracks, as many rows of diagnostics, and what was found with them.

    Further tables are `calibration` (pose errors), `cooperation` (camera requests), `residuals` and `particles`;
    `solves` are records of optimisation runs, `labels` events of exchanged or jumping labels, and `frames`, `stated`,
    `motion` and `outliers_matter` inputs of the consistency checks. None or empty where the method or request has none.
    """

    tracks: Tracks
    diagnostics: Diagnostics
    calibration: Calibration  # rows of every sensor and scan; none if it is not estimated
    solves: tuple[Solve, ...] = ()  # of a batch method
    cooperation: Cooperation | None = None  # of a method that asks cameras
    offered: int = 0  # frames that it could have asked for
    residuals: Residuals | None = None  # None: nothing was compared
    frames: tuple[CandidateFrames, ...] = ()  # what candidates without a label were left
    particles: Particles | None = None  # None: not asked for
    labels: LabelEvents | None = None  # exchanged and jumping labels up to here; None: labels were not followed
    stated: tuple[StatedResiduals, ...] = ()  # of all bearings at the estimates
    motion: MotionCheck | None = None  # None: the method has no motion of its own, or judges it itself
    outliers_matter: bool = False  # the method cannot reject bearings that contradict a target's motion


ROWS_PER_CHUNK = 4096
"""Rows that are gathered before they are given out."""


class EstimateRow(NamedTuple):
    """One estimate of one target at a time, with what its output row needs.

    `n_available` is the number of sensor frames since the row before, `selected` the selected cameras (indices), `mse`
    the predicted mean square error at a new selection (NaN: none), `cloud` particles for output (None: not requested).
    """

    target: int
    t_ns: int
    estimate: Estimate
    n_available: int  # frames of sensors since the row before
    selected: tuple[int, ...] = ()
    mse: float = math.nan  # NaN: nothing was reselected
    cloud: ParticleSet | None = None  # None: not asked for

    def smoothed(self, past: SmoothedState) -> EstimateRow:
        """Return this row with position, velocity, covariance and height of the smoothed state `past`."""
        better = self.estimate._replace(
            xy=past.xy, velocity=past.velocity, covariance=past.covariance, height=past.height
        )
        return self._replace(estimate=better)


def tables(rows: Sequence[EstimateRow], names: tuple[str, ...]) -> TrackChunk:
    """Convert estimates in the order of time to the output tables of a chunk.

    `names` are the sensors' names by index.
    """
    if not rows:
        return TrackChunk(Tracks.empty(), Diagnostics.empty(), Calibration.empty())
    estimates = [r.estimate for r in rows]
    return TrackChunk(
        _tracks(rows, estimates),
        _diagnostics(rows, estimates, names),
        _calibration(rows, names),
        residuals=_residuals(rows, names),
        particles=particle_rows([(r.t_ns, r.target, r.cloud) for r in rows if r.cloud is not None]),
    )


def _residuals(rows: Sequence[EstimateRow], names: tuple[str, ...]) -> Residuals | None:
    """Return table `residuals` of the estimates' bearings; None if the method does not compute residuals.

    `names` are the sensors' names by index.
    """
    fits = [(r, r.estimate.fit) for r in rows if r.estimate.fit is not None]
    if not fits:
        return None
    return Residuals.concat(residual_rows(fit, np.array([r.t_ns], dtype=np.int64), r.target, names) for r, fit in fits)


def residual_rows(fit: BearingResiduals, t_ns: Ints, target: int, names: tuple[str, ...]) -> Residuals:
    """Return table `residuals` of one target's bearings.

    Args:
        fit: residuals, with the index of each one's time.
        t_ns: (T,) times to which `fit.row` refers.
        target: identity.
        names: names of the sensors by index.
    """
    return Residuals.of(
        t_ns=t_ns[fit.row],
        target_id=np.full(len(fit.row), target, dtype=np.int32),
        sensor=np.array([names[i] for i in fit.sensor.tolist()], dtype=np.str_),
        residual=fit.residual,
        expected_variance=fit.expected_variance,
        inlier_probability=fit.inlier_probability,
    )


def _tracks(rows: Sequence[EstimateRow], estimates: list[Estimate]) -> Tracks:
    """Return table `tracks` of the rows; `estimates` are theirs."""
    xy, velocity = np.array([e.xy for e in estimates]), np.array([e.velocity for e in estimates])
    cov = np.array([e.covariance for e in estimates])
    return Tracks.of(
        t_ns=_times(rows),
        target_id=_identities(rows),
        x=xy[:, 0],
        y=xy[:, 1],
        vx=velocity[:, 0],
        vy=velocity[:, 1],
        cov_xx=cov[:, 0, 0],
        cov_xy=cov[:, 0, 1],
        cov_yy=cov[:, 1, 1],
        **_heights(estimates),
    )


def _diagnostics(rows: Sequence[EstimateRow], estimates: list[Estimate], names: tuple[str, ...]) -> Diagnostics:
    """Return table `diagnostics` of the rows; `estimates` are theirs, `names` the sensors' names by index."""
    return Diagnostics(
        t_ns=_times(rows),
        target_id=_identities(rows),
        ess=np.array([e.ess for e in estimates], dtype=np.float64),
        log_likelihood=np.array([e.log_likelihood for e in estimates], dtype=np.float64),
        n_observing=np.array([e.n_observing for e in estimates], dtype=np.int32),
        n_detected=np.array([e.n_detected for e in estimates], dtype=np.int32),
        fallback=np.array([e.fallback for e in estimates], dtype=np.str_),
        cameras=np.array([",".join(names[i] for i in e.used) for e in estimates], dtype=np.str_),
        n_available=np.array([r.n_available for r in rows], dtype=np.int32),
        selected=np.array([",".join(names[i] for i in r.selected) for r in rows], dtype=np.str_),
        predicted_mse=np.array([r.mse for r in rows], dtype=np.float64),
        seen_by=np.array([",".join(names[i] for i in e.seen_by or ()) for e in estimates], dtype=np.str_),
    )


def _times(rows: Sequence[EstimateRow]) -> Ints:
    """Return the times (n,) [ns] of the rows."""
    return np.array([r.t_ns for r in rows], dtype=np.int64)


def _identities(rows: Sequence[EstimateRow]) -> Ints32:
    """Return the target identities (n,) of the rows."""
    return np.array([r.target for r in rows], dtype=np.int32)


def _heights(estimates: list[Estimate]) -> dict[str, Floats]:
    """Return the height columns of table `tracks` by name; {} if all estimates are on the ground plane.

    Estimates without a height get NaN.
    """
    if all(e.height is None for e in estimates):
        return {}
    none = HeightEstimate(math.nan, math.nan, np.full(3, math.nan))
    heights = [none if e.height is None else e.height for e in estimates]
    xz, yz, zz = np.array([h.covariance for h in heights]).T
    z, vz = np.array([[h.z, h.vz] for h in heights]).T
    return {"z": z, "vz": vz, "cov_xz": xz, "cov_yz": yz, "cov_zz": zz}


def _calibration(rows: Sequence[EstimateRow], names: tuple[str, ...]) -> Calibration:
    """Return table `calibration`: estimated pose errors of all sensors after each scan; empty if none are estimated.

    `names` are the sensors' names by index.
    """
    found = [(r.t_ns, r.target, r.estimate.calibration) for r in rows if r.estimate.calibration is not None]
    if not found:
        return Calibration.empty()
    n, S = len(found), len(names)
    mean = np.array([c.mean for _, _, c in found]).reshape(n * S, 3)
    deviation = np.array([c.deviation for _, _, c in found]).reshape(n * S, 3)
    table = Calibration(
        np.repeat(np.array([f[0] for f in found], dtype=np.int64), S),
        np.repeat(np.array([f[1] for f in found], dtype=np.int32), S),
        np.tile(np.array(names, dtype=np.str_), n),
        *mean.T,
        *deviation.T,
    )
    return Calibration.merge([table])


REPORT_BYTES = 18
ORDER_BYTES = 4


class NetworkTraffic:
    """Counts of messages and bytes sent to and by cameras, accumulated over tables of diagnostics.

    Each used sensor frame is a report of `REPORT_BYTES`; each camera switched on or off by a new selection gets an
    order of `ORDER_BYTES`.
    """

    def __init__(self) -> None:
        """Start without messages."""
        self.reports = 0
        self.offered = 0
        self.orders = 0
        self.selections = 0
        self._on: dict[int, frozenset[str]] = {}

    def add(self, part: Diagnostics) -> None:
        """Add the messages of one table of diagnostics to the counts."""
        self.reports += int(part.n_observing.sum())
        self.offered += int(part.n_available.sum())
        for row in np.flatnonzero(np.isfinite(part.predicted_mse)).tolist():
            target = int(part.target_id[row])
            now = frozenset(name for name in part.selected[row].split(",") if name)
            self.orders += len(now ^ self._on.get(target, frozenset()))
            self.selections += 1
            self._on[target] = now

    @property
    def bytes(self) -> int:
        """Total number of bytes sent."""
        return self.reports * REPORT_BYTES + self.orders * ORDER_BYTES

    def summary(self) -> dict[str, float | int]:
        """Return messages, bytes and the share saved by the selection, by name; {} if no cameras were selected."""
        if not self.selections:
            return {}
        whole = self.offered * REPORT_BYTES
        return {
            "messages": self.reports + self.orders,
            "bytes": self.bytes,
            "selections": self.selections,
            "bytes_all_cameras": whole,
            "share_saved": 1.0 - self.bytes / whole if whole else 0.0,
        }
