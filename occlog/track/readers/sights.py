"""Which sight line of a camera is of which tag: by its label, or else by the tag's coarse position."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from occlog.array_types import NS, Floats
from occlog.records.scene import Camera
from occlog.records.tables import UNLABELLED, Bearings, TagTracks

from .refine import Refined, Sights, refine


class SightLines:
    """Bearings of the cameras that refine, to be asked for by time."""

    def __init__(self, bearings: Bearings, cameras: Sequence[Camera], frame_age_s: float, gate: float, pace: float):
        """Keep the rows of the cameras that saw something.

        Args:
            bearings: in the order of time.
            cameras: those that refine.
            frame_age_s: frames farther away in time than this are not used.
            gate: standard deviations within which a candidate without a label is of a tag.
            pace: speed of tags in units of length.
        """
        self.cameras = tuple(cameras)
        self._rows = [bearings.take((bearings.sensor == c.name) & bearings.seen) for c in cameras]
        self._age_ns, self._gate, self._pace = round(frame_age_s * NS), gate, pace

    def of(self, tracks: TagTracks) -> Sights:
        """Choose the sight line of each camera for each row: the tag's own, else the candidate that agrees best."""
        n, c = len(tracks), len(self.cameras)
        bearing, sigma = np.full((n, c), np.nan), np.full((n, c), np.nan)
        for k, camera in enumerate(self.cameras):
            for row in range(n):
                found = self._choose(k, camera, tracks, row)
                if found is not None:
                    bearing[row, k], sigma[row, k] = found
        places = np.array([camera.ground for camera in self.cameras]).reshape(-1, 2)
        return Sights(places, np.array([camera.yaw for camera in self.cameras]), bearing, sigma)

    def _choose(self, k: int, camera: Camera, tracks: TagTracks, row: int) -> tuple[float, float] | None:
        """The sight line of a camera for a row, and its standard deviation; None: it has none."""
        own, t_ns = self._rows[k], int(tracks.t_ns[row])
        low, high = np.searchsorted(own.t_ns, [t_ns - self._age_ns, t_ns + self._age_ns + 1])
        if low == high:
            return None
        # The frame that is nearest in time
        times = own.t_ns[low:high]
        nearest = times[int(np.argmin(np.abs(times - t_ns)))]
        frame = np.flatnonzero(times == nearest) + low
        away = np.array([tracks.x[row], tracks.y[row]]) - camera.ground
        distance = max(float(np.hypot(away[0], away[1])), 1e-9)
        moved = self._pace * abs(int(nearest) - t_ns) / NS / distance
        sigma = np.hypot(own.sigma[frame], moved)
        labelled = np.flatnonzero(own.target_id[frame] == tracks.target_id[row])
        if len(labelled):
            return float(own.bearing[frame[labelled[0]]]), float(sigma[labelled[0]])
        # Gate: candidates of nobody, by the coarse position's spread across the line
        free = np.flatnonzero(own.target_id[frame] == UNLABELLED)
        if not len(free):
            return None
        across = np.array([-away[1], away[0]]) / distance**2
        xx, xy, yy = (float(getattr(tracks, f"cov_{name}")[row]) for name in ("xx", "xy", "yy"))
        spread = across @ np.array([[xx, xy], [xy, yy]]) @ across
        off = own.bearing[frame[free]] - np.arctan2(away[1], away[0])
        score = np.abs((off + np.pi) % (2.0 * np.pi) - np.pi) / np.sqrt(spread + sigma[free] ** 2)
        best = int(np.argmin(score))
        return (float(own.bearing[frame[free[best]]]), float(sigma[free[best]])) if score[best] <= self._gate else None


def refined(tracks: TagTracks, lines: SightLines, form: str) -> TagTracks:
    """Refine the positions of tracks; velocities follow as a Gaussian's do, where the form has a posterior (`rays`)."""
    if not len(tracks):
        return tracks
    before = np.column_stack([tracks.x, tracks.y])
    covariance = _matrices(tracks.cov_xx, tracks.cov_xy, tracks.cov_xy, tracks.cov_yy)
    found = refine(before, covariance, lines.of(tracks), form)
    columns = {c.name: getattr(tracks, c.name) for c in tracks.columns()}
    names = np.array([c.name for c in lines.cameras], dtype=np.str_)
    columns |= {
        "x": found.xy[:, 0],
        "y": found.xy[:, 1],
        "cov_xx": found.covariance[:, 0, 0],
        "cov_xy": found.covariance[:, 0, 1],
        "cov_yy": found.covariance[:, 1, 1],
        "refined_by": np.array([",".join(names[used].tolist()) for used in found.used], dtype=np.str_),
    }
    columns |= _velocities(tracks, before, covariance, found, form)
    return TagTracks.of(**columns)


def _velocities(tracks: TagTracks, before: Floats, covariance: Floats, found: Refined, form: str) -> dict[str, Floats]:
    """Velocities and their covariances given the refined positions; NaN where these are no posterior."""
    names = ("vx_vx", "vx_vy", "vy_vy", "x_vx", "x_vy", "y_vx", "y_vy")
    if form != "rays":
        changed = found.used.any(axis=1)
        return {f"cov_{n}": np.where(changed, np.nan, getattr(tracks, f"cov_{n}")) for n in names} | {
            n: np.where(changed, np.nan, getattr(tracks, n)) for n in ("vx", "vy")
        }
    # Rows v, columns x; NaN stays NaN where the method estimates no velocity
    cross = _matrices(tracks.cov_x_vx, tracks.cov_y_vx, tracks.cov_x_vy, tracks.cov_y_vy)
    gain = cross @ np.linalg.inv(covariance)
    velocity = np.column_stack([tracks.vx, tracks.vy]) + np.einsum("nij,nj->ni", gain, found.xy - before)
    spread = _matrices(tracks.cov_vx_vx, tracks.cov_vx_vy, tracks.cov_vx_vy, tracks.cov_vy_vy)
    spread = spread - gain @ (covariance - found.covariance) @ np.swapaxes(gain, 1, 2)
    cross = gain @ found.covariance
    values = (spread[:, 0, 0], spread[:, 0, 1], spread[:, 1, 1], *(cross[:, i, j] for i, j in _XV))
    return {f"cov_{n}": v for n, v in zip(names, values, strict=True)} | {"vx": velocity[:, 0], "vy": velocity[:, 1]}


_XV = ((0, 0), (1, 0), (0, 1), (1, 1))
"""Places of x_vx, x_vy, y_vx and y_vy in a matrix with rows v and columns x."""


def _matrices(a: Floats, b: Floats, c: Floats, d: Floats) -> Floats:
    """(n, 2, 2) matrices of four columns by rows."""
    return np.stack([np.stack([a, b], axis=1), np.stack([c, d], axis=1)], axis=1)
