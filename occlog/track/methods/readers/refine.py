"""Visual refinement: lines of sight of cameras improve a tag's coarse position ([Lee] Sec. 5.2.3, Figs. 5-34 and 5-36).

The thesis moves the coarse position by what two cameras see between it and the tag, on planes parallel to theirs
through the coarse position (`printed-1`, Eq. 5.39), and corrects for the tag's depth (`parallel`, Eq. 5.40).  `rays`
crosses the lines of sight instead, with the coarse position as prior; it requires one camera at least, the others two.

Which line of sight of a camera is of which tag: by its label, or else by the tag's coarse position.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats
from occlog.records.scene import Camera
from occlog.records.tables import UNLABELLED, Bearings, TagTracks

PRINTED, PARALLEL, RAYS = "printed-1", "parallel", "rays"
FORMS = (RAYS, PRINTED, PARALLEL)
ITERATIONS = 40
"""Maximum iterations of Levenberg-Marquardt."""
FIRST_DAMPING = 1e-3
"""Initial damping of Levenberg-Marquardt, as a share of the trace of the information."""
NEAREST = 1e-6
"""Depth below which a camera does not constrain a position; lines of sight more parallel than this do not cross."""


class TagSightings(NamedTuple):
    """Bearings of tags from C cameras, for N coarse positions, one for each window of reads; NaN: not seen."""

    position: Floats  # (C, 2) of the cameras on the ground
    yaw: Floats  # (C,) azimuth of their axes [rad]
    bearing: Floats  # (N, C) azimuths of the lines of sight [rad]
    sigma: Floats  # (N, C) their standard deviations [rad]


class Refined(NamedTuple):
    """N positions of radio tags, refined by lines of sight of C cameras where these suffice, else coarse.

    Attributes:
        xy: (N, 2) positions on the ground.
        covariance: (N, 2, 2) covariances of the positions.
        used: (N, C) whether a camera's line of sight refined the position.
    """

    xy: Floats
    covariance: Floats
    used: Bools


def refine(xy: Floats, covariance: Floats, sights: TagSightings, form: str) -> Refined:
    """Return coarse positions refined by lines of sight of cameras; a position without enough of them stays.

    Args:
        xy: (N, 2) coarse positions.
        covariance: (N, 2, 2) covariances of the coarse positions.
        sights: bearings of the tag from the cameras.
        form: `rays` (from one camera on), `printed-1` or `parallel` (from two cameras on).
    """
    seen = np.isfinite(sights.bearing)
    if form == RAYS:
        return _by_rays(xy, covariance, sights, seen)
    return _by_planes(xy, covariance, sights, seen, deep=form == PARALLEL)


def _by_rays(xy: Floats, covariance: Floats, sights: TagSightings, seen: Bools) -> Refined:
    """Refine positions as the mode of Gaussian bearings with the coarse positions as prior, by Levenberg-Marquardt.

    Args:
        xy: (N, 2) coarse positions.
        covariance: (N, 2, 2) covariances of the coarse positions.
        sights: bearings of the tag from the cameras.
        seen: (N, C) whether a camera sees the tag.
    """
    prior = np.linalg.inv(covariance)
    weight = np.where(seen, 1.0 / np.where(seen, sights.sigma, 1.0) ** 2, 0.0)
    bearing = np.where(seen, sights.bearing, 0.0)

    def residuals(at: Floats) -> tuple[Floats, Floats, Floats]:
        """Return offsets from the cameras (N, C, 2), bearing residuals (N, C), and cost (N,)."""
        away = at[:, None, :] - sights.position
        off = _wrapped(bearing - np.arctan2(away[..., 1], away[..., 0]))
        moved = at - xy
        cost = (weight * off**2).sum(axis=1) + np.einsum("ni,nij,nj->n", moved, prior, moved)
        return away, off, cost

    at, damping = xy.copy(), np.full(len(xy), FIRST_DAMPING)
    away, off, cost = residuals(at)
    information = prior
    for _ in range(ITERATIONS):
        squared = np.maximum((away**2).sum(axis=2), NEAREST**2)
        gradient = np.stack([-away[..., 1], away[..., 0]], axis=2) / squared[..., None]
        information = prior + np.einsum("nc,nci,ncj->nij", weight, gradient, gradient)
        score = np.einsum("nc,nci->ni", weight * off, gradient) - np.einsum("nij,nj->ni", prior, at - xy)
        size = np.trace(information, axis1=1, axis2=2)[:, None, None]
        step = np.linalg.solve(information + damping[:, None, None] * size * np.eye(2), score[..., None])[..., 0]
        tried = residuals(at + step)
        better = tried[2] <= cost
        at = np.where(better[:, None], at + step, at)
        damping = np.where(better, 0.1 * damping, np.minimum(10.0 * damping, 1e6))
        away, off, cost = residuals(at)
    used = np.asarray(seen.any(axis=1))
    return Refined(
        np.where(used[:, None], at, xy),
        np.where(used[:, None, None], np.linalg.inv(information), covariance),
        seen,
    )


def _by_planes(xy: Floats, covariance: Floats, sights: TagSightings, seen: Bools, *, deep: bool) -> Refined:
    """Refine positions by the first two cameras that see the tag, on planes through the coarse position.

    This is [Lee] Sec. 5.2.3.

    With cameras at a right angle, one along each axis, (dx, dy) = (du_2, du_1) as printed; else the two displacements
    across the cameras' axes are solved for. The covariance is propagated to first order from that of the coarse
    position and of the bearings.

    Args:
        xy: (N, 2) coarse positions.
        covariance: (N, 2, 2) covariances of the coarse positions.
        sights: bearings of the tag from the cameras.
        seen: (N, C) whether a camera sees the tag.
        deep: correct for the tag's depth (Eq. 5.40); else Eq. 5.39.
    """
    n = len(xy)
    first = np.argsort(~seen, axis=1, kind="stable")[:, :2]
    rows = np.arange(n)[:, None]
    axis = np.stack([np.cos(sights.yaw), np.sin(sights.yaw)], axis=1)[first]  # (N, 2, 2) by camera
    across = np.stack([-axis[..., 1], axis[..., 0]], axis=2)
    bearing = np.where(seen, sights.bearing, 0.0)[rows, first]
    slope = np.tan(_wrapped(bearing - sights.yaw[first]))
    away = xy[:, None, :] - sights.position[first]
    depth = np.einsum("nci,nci->nc", axis, away)
    # Displacement on the object plane through the coarse position: du = tan(beta) d - offset
    shift = slope * depth - np.einsum("nci,nci->nc", across, away)
    determinant = across[:, 0, 0] * across[:, 1, 1] - across[:, 0, 1] * across[:, 1, 0]
    ahead = (np.abs(_wrapped(bearing - sights.yaw[first])) < 0.5 * np.pi) & (depth > NEAREST)
    good = (seen.sum(axis=1) >= 2) & (np.abs(determinant) > NEAREST) & ahead.all(axis=1)
    solve = np.where(good[:, None, None], across, np.eye(2))
    moved = np.linalg.solve(solve, shift[..., None])[..., 0]  # Eq. 5.39
    if deep:
        # Eq. 5.40: du_r = du (d + dd) / d, with the depth dd that Eq. 5.39 finds
        deeper = np.einsum("nci,ni->nc", axis, moved)
        scaled = shift * (depth + deeper) / np.where(ahead, depth, 1.0)
        moved = np.linalg.solve(solve, scaled[..., None])[..., 0]
    sigma = np.where(seen, sights.sigma, 0.0)[rows, first]
    turn = np.linalg.solve(solve, slope[..., None] * axis)
    noise = np.linalg.inv(solve) * (sigma * depth * (1.0 + slope**2))[:, None, :]
    spread = turn @ covariance @ np.swapaxes(turn, 1, 2) + noise @ np.swapaxes(noise, 1, 2)
    used = np.zeros_like(seen)
    used[rows, first] = good[:, None]
    return Refined(np.where(good[:, None], xy + moved, xy), np.where(good[:, None, None], spread, covariance), used)


def _wrapped(angle: Floats) -> Floats:
    """Return angles [rad] wrapped to [-pi, pi)."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


class RefineBearings:
    """Bearings of the cameras that refine tag positions, searchable by time."""

    def __init__(self, bearings: Bearings, cameras: Sequence[Camera], frame_age_s: float, gate: float, pace: float):
        """Keep the rows of the given cameras that have a detection.

        Args:
            bearings: bearings in the order of time.
            cameras: cameras to use.
            frame_age_s: largest time between a frame and a window of reads [s].
            gate: standard deviations within which a candidate without a label is of a tag.
            pace: speed of tags [length/s], which widens bearings of other times.
        """
        self.cameras = tuple(cameras)
        self._rows = [bearings.take((bearings.sensor == c.name) & bearings.seen) for c in cameras]
        self._age_ns, self._gate, self._pace = round(frame_age_s * NS), gate, pace

    def of(self, tracks: TagTracks) -> TagSightings:
        """Return the bearing of each camera for each row of the tracks: by label, else the best-fitting candidate.

        Bearings are NaN where a camera has none within the age and the gate.
        """
        n, c = len(tracks), len(self.cameras)
        bearing, sigma = np.full((n, c), np.nan), np.full((n, c), np.nan)
        for k, camera in enumerate(self.cameras):
            for row in range(n):
                found = self._choose(k, camera, tracks, row)
                if found is not None:
                    bearing[row, k], sigma[row, k] = found
        positions = np.array([camera.ground for camera in self.cameras]).reshape(-1, 2)
        return TagSightings(positions, np.array([camera.yaw for camera in self.cameras]), bearing, sigma)

    def _choose(self, k: int, camera: Camera, tracks: TagTracks, row: int) -> tuple[float, float] | None:
        """Return the bearing [rad] of camera number `k` for row `row` of the tracks, and its standard deviation [rad].

        None without one. The standard deviation includes what the tag may have moved since the frame.
        """
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
        # Gate: candidates of no person, by the coarse position's spread across the line
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


def refined_positions(tracks: TagTracks, lines: RefineBearings, form: str) -> TagTracks:
    """Return the tracks with positions refined by the lines of sight of cameras.

    Velocities follow by correlation for form `rays`, and become unknown (NaN) for other forms.
    """
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
    """Return the columns of velocities and their covariances, by name, given positions refined by lines of sight.

    For forms other than `rays` they are NaN in refined rows.

    Args:
        tracks: tracks before the refinement.
        before: (n, 2) positions before.
        covariance: (n, 2, 2) covariances of these.
        found: refined positions.
        form: `rays`, `printed-1` or `parallel`.
    """
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
    """Return (n, 2, 2) matrices ((a, b), (c, d)) from four columns (n,)."""
    return np.stack([np.stack([a, b], axis=1), np.stack([c, d], axis=1)], axis=1)
