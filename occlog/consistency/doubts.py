"""Reasons not to believe an estimate, found from its row, the scene, and what was seen before.

The checks stand alone: arrays in, booleans out.  `Doubts` applies them to the rows of a run.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats
from occlog.core.sight.camera import wrap_angle
from occlog.core.sight.view_prior import ViewPrior
from occlog.records.scene import Camera, MicrophoneArray, Scene
from occlog.records.tables import Diagnostics, Tracks
from occlog.scans.scan import sensor_names

EDGE, ONE_SENSOR, OUT_OF_VIEW, DISAGREES = "edge", "one-sensor", "out-of-view", "sensor-disagrees"
"""Values of the column `doubt`, in the order in which they stand there."""
WORDS = {
    EDGE: "the target may be at the edge of where targets can be, which was guessed from what the sensors see; "
    "add `room` to the scene",
    ONE_SENSOR: "one sensor alone saw the target for long, which says nothing of its distance; add another sensor, or "
    "track in images and find the target on the ground (occlog ground)",
    OUT_OF_VIEW: "the target is where sensors that are said to see it cannot see; check the calibration, the region "
    "and the choice of the target",
    DISAGREES: "most of what one sensor measured of the target in the last second is not believed; check the clock, "
    "the pose and the labels of that sensor (the residuals say which), or leave it out",
}
"""What each means and what to do."""
EDGE_SIGMAS = 2.0
"""An estimate is at the edge if so many standard deviations reach it."""
VIEW_SIGMAS = 3.0
"""An estimate is out of view if so many standard deviations do not reach the view."""
ALONE_S = 5.0
"""So long after two sensors have seen a target at once, one of them alone tells its distance no more [s]."""
TOGETHER_S = 1.0
"""Two sensors see a target at once if they do within this time; so long a filter waits for a second one [s]."""
NEW = ("restart", "gap")
"""Values of `fallback` of rows in which a filter has begun anew."""


def near_edge(xy: Floats, covariance: Floats, region: Floats) -> Bools:
    """(N,) whether estimates are at the edge of a region, or outside of it.

    Args:
        xy: (N, 2) estimates.
        covariance: (N, 2, 2) of them.
        region: (K, 2) convex polygon, counter-clockwise.
    """
    edge = np.roll(region, -1, axis=0) - region
    inwards = np.column_stack([-edge[:, 1], edge[:, 0]]) / np.hypot(*edge.T)[:, None]
    depth = np.einsum("nki,ki->nk", xy[:, None] - region, inwards)
    sigma = np.sqrt(np.maximum(np.einsum("ki,nij,kj->nk", inwards, covariance, inwards), 0.0))
    return np.asarray(np.any(depth < EDGE_SIGMAS * sigma, axis=1))


def outside_view(xy: Floats, covariance: Floats, origin: Floats, yaw: float, fov: float, reach: float) -> Bools:
    """(N,) whether estimates are clearly outside of a sensor's field of view, or beyond its range.

    Args:
        xy: (N, 2) estimates.
        covariance: (N, 2, 2) of them.
        origin: (2,) where the sensor stands.
        yaw: azimuth of its axis [rad].
        fov: its full field of view [rad]; from 2 pi on it sees all around.
        reach: greatest distance; may be infinite.
    """
    away = xy - origin
    r = np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-12)
    e = away / r[:, None]
    across = np.column_stack([-e[:, 1], e[:, 0]])
    sigma_r, sigma_across = (np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", u, covariance, u), 0.0)) for u in (e, across))
    off = np.abs(wrap_angle(np.arctan2(away[:, 1], away[:, 0]) - yaw)) - 0.5 * fov
    beside = (fov < 2.0 * np.pi) & (off > VIEW_SIGMAS * np.arctan2(sigma_across, r))
    # Within its own uncertainty an estimate is at the sensor, in any direction
    beside &= r > VIEW_SIGMAS * sigma_r
    return np.asarray(beside | (r - reach > VIEW_SIGMAS * sigma_r))


def without_distance(xy: Floats, covariance: Floats, origin: Floats, far: float) -> Floats:
    """(2, 2) covariance of an estimate whose distance from a sensor is not known.

    Along the sight line it is the second moment of the prior, which is even from the sensor to its far limit, about
    the estimate: one sensor's bearings hardly say more, and a filter that believes them too much is sure of a
    distance that its settings of motion and noise have made up.

    Args:
        xy: (2,) estimate.
        covariance: (2, 2) of it; never made smaller.
        origin: (2,) where the sensor stands.
        far: how far it sees.
    """
    away = xy - origin
    r = float(np.hypot(*away))
    e = away / r if r > 0.0 else np.array([1.0, 0.0])
    more = far**2 / 12.0 + (r - 0.5 * far) ** 2 - e @ covariance @ e
    return covariance + max(float(more), 0.0) * np.outer(e, e)


def covariances(tracks: Tracks) -> Floats:
    """(N, 2, 2) covariances of the places of a table's rows."""
    return np.stack([tracks.cov_xx, tracks.cov_xy, tracks.cov_xy, tracks.cov_yy], axis=1).reshape(-1, 2, 2)


class Seen(NamedTuple):
    """When a target was seen, and by which sensors."""

    begun_ns: int  # when the filter began
    last_ns: dict[str, int]  # by sensor, since two of them saw it at once
    together_ns: int | None = None  # when two of them did; None: never since the filter began


class Doubts:
    """Finds the doubts of a run's rows, chunk by chunk; what was seen of each target is remembered."""

    def __init__(self, scene: Scene, *, online: bool, started: bool, distances: bool = False) -> None:
        """Nothing was seen yet.

        Args:
            scene: the sensors.
            online: estimates do not know what comes after them: one sensor alone leaves a doubt, and so does a guessed
                region.
            started: the settings say where the target was at first.
            distances: stations measure distances, too, so that one sensor alone may tell a place.
        """
        self._distances = distances
        self._scene, self._online, self._started = scene, online, started
        self._views: ViewPrior | None = scene.views
        self._row = {name: i for i, name in enumerate(sensor_names(scene))}
        self._sensors: tuple[Camera | MicrophoneArray, ...] = (*scene.cameras, *scene.arrays)
        self._place = {s.name: (float(s.position[0]), float(s.position[1])) for s in self._sensors}
        self._seen: dict[int, Seen] = {}

    def judged(self, tracks: Tracks, diagnostics: Diagnostics) -> tuple[Tracks, Diagnostics]:
        """The rows with their doubts, and with covariances that hold where the distance is not known."""
        if not len(tracks):
            return tracks, diagnostics
        by = [tuple(name for name in text.split(",") if name) for text in diagnostics.seen_by.tolist()]
        xy, covariance = np.column_stack([tracks.x, tracks.y]), covariances(tracks)
        edge = alone = np.zeros(len(by), dtype=np.bool_)
        lone: dict[int, str] = {}
        if self._online and not self._distances:
            alone, lone = self._alone(diagnostics, by)
            tracks, covariance = self._widened(tracks, xy, covariance, lone)
        if self._online and self._views is not None:
            # An unknown distance reaches the edge in any case
            edge = near_edge(xy, covariance, self._scene.region)
            edge[list(lone)] = False
        outside = self._outside(xy, covariance, by)
        doubt = [
            ",".join(name for name, has in zip((EDGE, ONE_SENSOR, OUT_OF_VIEW), row, strict=True) if has)
            for row in zip(edge.tolist(), alone.tolist(), outside.tolist(), strict=True)
        ]
        columns = {c.name: getattr(diagnostics, c.name) for c in Diagnostics.columns()}
        return tracks, Diagnostics(**(columns | {"doubt": np.array(doubt, dtype=np.str_)}))

    def _outside(self, xy: Floats, covariance: Floats, by: list[tuple[str, ...]]) -> Bools:
        """(N,) whether at least half of the sensors that saw the target cannot have done so; arrays by their range.

        With fewer, their bearings are false, which is said of bearings and not of the estimate.
        """
        saw, cannot = np.zeros(len(xy), dtype=np.int64), np.zeros(len(xy), dtype=np.int64)
        for c in self._sensors:
            rows = np.array([c.name in names for names in by], dtype=np.bool_)
            if rows.any():
                fov = c.fov if isinstance(c, Camera) else 2.0 * np.pi
                saw[rows] += 1
                cannot[rows] += outside_view(xy[rows], covariance[rows], c.position[:2], c.yaw, fov, c.range)
        return np.asarray((cannot > 0) & (2 * cannot >= saw))

    def _widened(self, tracks: Tracks, xy: Floats, covariance: Floats, lone: dict[int, str]) -> tuple[Tracks, Floats]:
        """The tracks, and (N, 2, 2) their covariances, with those rows widened whose distance was never known.

        In a room the walls say how far the target can be, and the filter's own covariance stays.
        """
        if self._views is None or not lone:
            return tracks, covariance
        for n, name in lone.items():
            i = self._row[name]
            covariance[n] = without_distance(xy[n], covariance[n], self._views.origin[i], float(self._views.far[i]))
        columns = {c.name: getattr(tracks, c.name) for c in Tracks.columns()}
        columns |= {"cov_xx": covariance[:, 0, 0], "cov_xy": covariance[:, 0, 1], "cov_yy": covariance[:, 1, 1]}
        return Tracks(**{name: np.ascontiguousarray(values) for name, values in columns.items()}), covariance

    def _alone(self, diagnostics: Diagnostics, by: list[tuple[str, ...]]) -> tuple[Bools, dict[int, str]]:
        """(N,) rows of targets that one sensor alone has seen for long; and those of which no distance was ever known.

        The second are numbers of rows with the sensor's name.
        """
        alone = np.zeros(len(by), dtype=np.bool_)
        lone: dict[int, str] = {}
        rows = zip(
            diagnostics.t_ns.tolist(), diagnostics.target_id.tolist(), diagnostics.fallback.tolist(), by, strict=True
        )
        for n, (t_ns, target, fallback, names) in enumerate(rows):
            seen = self._seen.get(target)
            if seen is None or fallback in NEW:
                seen = Seen(t_ns, {}, t_ns if self._started and seen is None else None)
            last = seen.last_ns | dict.fromkeys(names, t_ns)
            # Two sensors at one place tell no more of the distance than one of them
            here = {self._place[s] for s, at in last.items() if t_ns - at <= TOGETHER_S * NS}
            seen = seen._replace(last_ns={}, together_ns=t_ns) if len(here) > 1 else seen._replace(last_ns=last)
            self._seen[target] = seen
            if seen.together_ns is None:
                late = t_ns - seen.begun_ns > TOGETHER_S * NS
            else:
                late = t_ns - seen.together_ns > ALONE_S * NS
            alone[n] = late and len({self._place[s] for s in seen.last_ns}) == 1
            if alone[n] and seen.together_ns is None:
                lone[n] = next(iter(seen.last_ns))
        return alone, lone
