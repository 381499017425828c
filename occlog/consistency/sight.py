"""Bearings at the estimates: residuals with the variance they should have, and candidates that no track explains.

The residual of a bearing that an estimate has used is smaller than the bearing's own error, since the estimate follows
it.  With the standard deviation sigma of the bearing, the gradient g of its angle by the position and the covariance P
of the estimate, a residual in units of sigma has the variance 1 - g'Pg / sigma^2, if both are right.  That holds for
filters, smoothers and least squares alike, as far as they are linear.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.sight.camera import noise_variance, planar_offsets, wrap_angle
from occlog.records.scene import Camera, MicrophoneArray, Scene
from occlog.records.tables import UNLABELLED, Bearings, Diagnostics, Residuals, Tracks

from .doubts import covariances

GATE = 4.0
"""A bearing further from the estimate than so many standard deviations of both together is not believed."""
SURE = 0.1
"""Bearings whose residuals should have a smaller variance say nothing of their noise: estimates go through them."""


class Angles(NamedTuple):
    """What N bearings of one sensor leave at estimates."""

    residual: Floats  # (N,) in standard deviations as stated
    spread: Floats  # (N,) variance of the bearing that the estimate leads one to expect, in the same units


class Frames(NamedTuple):
    """What the candidates of one sensor leave unexplained; F frames, in the order of time."""

    sensor: str
    t_ns: Ints  # (F,)
    candidates: Ints  # (F,) how many there were
    unexplained: Ints  # (F,) how many of them are near no track
    again: Bools  # (F,) whether one of these was there in the frame before, too


def at_estimates(rows: Bearings, sensor: Camera | MicrophoneArray, xy: Floats, covariance: Floats) -> Angles:
    """N bearings of a sensor against estimates.

    Args:
        rows: N bearings.  Those with pixels have the variance of [Ercan] Eq. 2 at the estimate, the others their own.
        sensor: which one.
        xy: (N, 2) estimates at their times.
        covariance: (N, 2, 2) of them.
    """
    away = xy - sensor.position[:2]
    r2 = np.maximum(np.sum(away**2, axis=1), 1e-24)
    variance = rows.sigma**2
    if isinstance(sensor, Camera):
        h, d = planar_offsets(xy, sensor.position[:2], sensor.yaw)
        pixels, before = np.isfinite(rows.u_px), d > 1e-9
        h, d = np.where(before, h, 0.0), np.where(before, d, 1.0)
        read = np.where(np.isfinite(rows.sigma_px), rows.sigma_px, sensor.sigma_read_px)
        f = float(sensor.focal_px[0])
        px = noise_variance(
            h, d, focal_px=f, sigma_position=sensor.sigma_position, sigma_yaw=sensor.sigma_yaw, sigma_read_px=read
        )
        variance = np.where(pixels & before, px / (f * (1.0 + (h / d) ** 2)) ** 2, variance)
    variance = np.maximum(variance, 1e-24)
    g = np.column_stack([-away[:, 1], away[:, 0]]) / r2[:, None]
    told = np.einsum("ni,nij,nj->n", g, covariance, g) / variance
    off = wrap_angle(rows.bearing - np.arctan2(away[:, 1], away[:, 0]))
    return Angles(off / np.sqrt(variance), np.maximum(told, 0.0))


class Sight:
    """Compares bearings with tracks, chunk by chunk."""

    def __init__(self, scene: Scene, window_ns: int = 0) -> None:
        """Nothing was seen yet.

        Args:
            scene: its sensors; arrays that are not upright are left out, as their azimuths have errors of elevations.
            window_ns: an estimate holds for bearings so long before it, at most.
        """
        self._sensors: dict[str, Camera | MicrophoneArray] = {c.name: c for c in scene.cameras if c.placed}
        self._sensors |= {a.name: a for a in scene.arrays if a.upright}
        self._window_ns = window_ns
        self._last: dict[str, tuple[int, Floats]] = {}  # the frame before, and what was unexplained in it

    def compare(
        self, tracks: Tracks, bearings: Bearings, diagnostics: Diagnostics | None = None
    ) -> tuple[Residuals, tuple[Frames, ...]]:
        """Residuals of the bearings of the tracks, and what candidates are left; times of all tracks, once each.

        Of candidates without a label the one nearest to the estimate counts, if it is within `GATE`.

        Args:
            tracks: estimates in the order of time.
            bearings: in the order of time; those without an estimate at their time are left out, and those at an
                estimate whose covariance is not known: nothing says how large their residuals should be.
            diagnostics: of the same estimates, say which sensors were used; None: all.
        """
        seen = bearings.take(bearings.seen)
        paths = list(self._paths(tracks, diagnostics))
        parts: list[Residuals] = []
        frames: list[Frames] = []
        for name, sensor in self._sensors.items():
            own = seen.take(seen.sensor == name)
            if not len(own):
                continue
            free = own.target_id == UNLABELLED
            near = np.zeros(len(own), dtype=np.bool_)
            met = np.zeros(len(own), dtype=np.bool_)
            for path in paths:
                at, found = path.at(own.t_ns, self._window_ns, name)
                labelled = ~free & (own.target_id == path.target)
                rows = found & (labelled | (free & ~np.isin(own.t_ns, own.t_ns[labelled])))
                met |= found & free
                n, i = np.flatnonzero(rows), at[rows]
                told = at_estimates(own.take(n), sensor, path.xy[i], path.covariance[i])
                far = np.abs(told.residual) / np.sqrt(1.0 + told.spread)
                near[n] |= far <= GATE
                keep = labelled[n] | _nearest(i, np.where(labelled[n], np.inf, far))
                parts.append(_table(path, name, i[keep], told, far, keep))
            if met.any():
                frames.append(self._left(name, own.take(met), near[met]))
        return Residuals.merge(parts), tuple(frames)

    def _paths(self, tracks: Tracks, diagnostics: Diagnostics | None) -> Iterator[Path]:
        """Each target's estimates."""
        xy, covariance = np.column_stack([tracks.x, tracks.y]), covariances(tracks)
        used = None if diagnostics is None or len(diagnostics) != len(tracks) else _commas(diagnostics.cameras)
        for target in np.unique(tracks.target_id).tolist():
            own = tracks.target_id == target
            yield Path(target, tracks.t_ns[own], xy[own], covariance[own], None if used is None else used[own])

    def _left(self, name: str, rows: Bearings, near: Bools) -> Frames:
        """What a sensor's candidates leave, frame by frame."""
        times, first = np.unique(rows.t_ns, return_index=True)
        left, again = np.add.reduceat(~near, first, dtype=np.int64), np.zeros(len(times), dtype=np.bool_)
        ends = [*first[1:].tolist(), len(rows)]
        for n, (t_ns, a, b) in enumerate(zip(times.tolist(), first.tolist(), ends, strict=True)):
            bearing, sigma = rows.bearing[a:b][~near[a:b]], rows.sigma[a:b][~near[a:b]]
            before_ns, before = self._last.get(name, (t_ns, np.empty(0)))
            if len(bearing) and len(before):
                reach = 3.0 * np.sqrt(2.0) * sigma + TURN_RATE * (t_ns - before_ns) * 1e-9
                again[n] = bool(np.any(np.abs(wrap_angle(bearing[:, None] - before[None, :])) <= reach[:, None]))
            self._last[name] = (t_ns, bearing)
        return Frames(name, times, np.diff([*first.tolist(), len(rows)]), left, again)


TURN_RATE = 0.25
"""How fast a person's azimuth changes, at 1.2 m/s and a distance of 5 m [rad/s]."""


class Path(NamedTuple):
    """One target's estimates."""

    target: int
    t_ns: Ints  # (T,)
    xy: Floats  # (T, 2)
    covariance: Floats  # (T, 2, 2) NaN: not known
    used: np.ndarray | None  # (T,) names of sensors between commas; None: not known

    def at(self, t_ns: Ints, window_ns: int, sensor: str) -> tuple[Ints, Bools]:
        """(N,) the estimate for each time, the next one not later than the window, and where it used the sensor.

        One whose covariance is not known is none.
        """
        n = np.searchsorted(self.t_ns, t_ns)
        i = np.minimum(n, len(self.t_ns) - 1)
        found = (n < len(self.t_ns)) & (self.t_ns[i] - t_ns <= window_ns) & ~np.isnan(self.covariance[i, 0, 0])
        if self.used is not None:
            found &= (np.strings.find(self.used, f",{sensor},") >= 0)[i]
        return i, np.asarray(found)


def _commas(cameras: np.ndarray) -> np.ndarray:
    """Lists of names with a comma before and after each name."""
    return np.strings.add(np.strings.add(",", cameras), ",")


def _nearest(estimate: Ints, far: Floats) -> Bools:
    """(N,) the nearest of those of each estimate, if it is within the gate."""
    order = np.lexsort([far, estimate])
    first = np.ones(len(order), dtype=np.bool_)
    first[1:] = np.diff(estimate[order]) != 0
    out = np.zeros(len(order), dtype=np.bool_)
    out[order[first]] = True
    return np.asarray(out & (far <= GATE))


def _table(path: Path, name: str, i: Ints, told: Angles, far: Floats, keep: Bools) -> Residuals:
    """Rows of the bearings that count."""
    return Residuals.of(
        t_ns=path.t_ns[i],
        target_id=np.full(len(i), path.target, dtype=np.int32),
        sensor=np.full(len(i), name),
        residual=told.residual[keep],
        expected=np.maximum(1.0 - told.spread[keep], 0.0),
        believed=(far[keep] <= GATE).astype(np.float64),
    )


class Compared(NamedTuple):
    """Residuals of the bearings, and what candidates are left."""

    residuals: Residuals
    frames: tuple[Frames, ...]


class Witness:
    """Keeps bearings that pass by until their estimates come out, and compares both."""

    def __init__(self, scene: Scene, window_ns: int, *, unlabelled: bool) -> None:
        """Nothing passed yet.

        Args:
            scene: see `Sight`.
            window_ns: see `Sight`.
            unlabelled: candidates without a label are used.
        """
        self._sight, self._unlabelled = Sight(scene, window_ns), unlabelled
        self._kept: list[Bearings] = []

    def watch(self, chunks: Iterable[Bearings]) -> Iterator[Bearings]:
        """The chunks as they are."""
        for chunk in chunks:
            self._kept.append(chunk if self._unlabelled else chunk.take(chunk.target_id != UNLABELLED))
            yield chunk

    def compare(self, tracks: Tracks, diagnostics: Diagnostics) -> Compared:
        """The bearings up to the last of these estimates, which are then forgotten."""
        kept = Bearings.concat(self._kept)
        if not len(tracks):
            return Compared(Residuals.empty(), ())
        n = int(np.searchsorted(kept.t_ns, tracks.t_ns[-1], side="right"))
        self._kept = [kept.take(slice(n, None))]
        return Compared(*self._sight.compare(tracks, kept.take(slice(None, n)), diagnostics))
