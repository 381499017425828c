"""How large the noise of bearings is, learned from how far the sight lines of three or more sensors miss one another.

Two sight lines in a plane always meet, n of them leave n - 2 degrees of freedom.  The squares of a scan's residuals at
the least-squares point, over their stated variances, sum up to S.  Where stated standard deviations are to be
multiplied by s, S / s^2 has a chi-squared distribution of n - 2 degrees.  s^2 is the sum of all S over that of the
degrees of freedom, without the scans that have a false bearing: those beyond the 99.9 % point of their distribution,
found by iteration from the median of S over that of the distribution.

Errors of the poses are in it, as they are for a filter.  What is wrong in the same way in all sensors is not.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from occlog.array_types import NS, Floats, Ints
from occlog.core.sight import triangulate
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.paths import sensors_of
from occlog.records.scene import Scene
from occlog.records.tables import Bearings

from .meeting import Metrics, scan_starts

FEWEST_SCANS = 20
"""From fewer scans no noise is learned."""
CHANCE = 1e-3
"""Scans that are less probable than this have a false bearing."""
ITERATIONS = 50
"""Of the choice of scans; it settles in a few."""


def noise_metrics(bearings: Bearings, scene: Scene, config: EvaluateConfig) -> Metrics:
    """The factor by which stated standard deviations are to be multiplied, and the noise in pixels that this means.

    Args:
        bearings: labelled ones count; sensors held out are left out.
        scene: the sensors.
        config: window of a scan, and least angle of a crossing.

    Returns:
        Figures, NaN where fewer than `FEWEST_SCANS` labelled scans of at least three sensors met; none where none did.
    """
    use = bearings.seen & (bearings.target_id >= 0) & ~np.isin(bearings.sensor, config.held_out)
    rows = bearings.take(use)
    if not len(rows):
        return {}
    grounds = {name: s.ground for name, s in sensors_of(scene, np.unique(rows.sensor).tolist()).items()}
    found = [
        _misses(own, np.array([grounds[name] for name in own.sensor.tolist()]), config)
        for own in (rows.take(rows.target_id == k) for k in np.unique(rows.target_id))
    ]
    squares, degrees = np.concatenate([s for s, _ in found]), np.concatenate([d for _, d in found])
    if not len(squares):
        return {}
    scale = noise_scale(squares, degrees)
    sigma_px = rows.sigma_px[np.isfinite(rows.sigma_px)]
    return {
        "noise_scans": len(squares),
        "noise_scale": scale,
        "noise_px": scale * float(np.median(sigma_px)) if len(sigma_px) else float("nan"),
    }


def noise_scale(squares: Floats, degrees: Ints) -> float:
    """The factor on stated standard deviations; NaN from fewer than `FEWEST_SCANS` scans.

    Args:
        squares: (S,) sums of squared residuals over stated variances.
        degrees: (S,) of freedom, >= 1.
    """
    if len(squares) < FEWEST_SCANS:
        return float("nan")
    scale2 = float(np.median(squares / chdtri(degrees, 0.5)))
    for _ in range(ITERATIONS):
        believed = squares <= scale2 * chdtri(degrees, CHANCE)
        scale2 = float(squares[believed].sum() / degrees[believed].sum())
    return float(np.sqrt(scale2))


def _misses(rows: Bearings, origins: Floats, config: EvaluateConfig) -> tuple[Floats, Ints]:
    """Sums of squared residuals and degrees of freedom of one target's scans that met with three lines or more."""
    starts = scan_starts(rows, round(config.lines_window_s * NS))
    found = triangulate.sight_lines_meet(
        origins, rows.bearing, rows.sigma, starts=starts, loss="gauss", min_crossing=config.lines_min_crossing
    )
    size = np.diff(starts)
    scan = np.repeat(np.arange(len(size)), size)
    good = (size > 2) & (found.status == triangulate.MET)
    each = np.where(good[scan], (found.residual / rows.sigma) ** 2, 0.0)
    return np.bincount(scan, weights=each, minlength=len(size))[good], size[good] - 2
