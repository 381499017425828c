"""Errors in space: of tracks with heights whose target's height is known, beside the errors on the ground."""

from __future__ import annotations

import numpy as np

from ..columns import Bools, Floats
from ..core.metrics import CHI2_95_3D, normalised_squared_errors_in_space, quantile, ratio, root_mean_square
from ..records import Errors, Tracks

Metrics = dict[str, float]


def errors_in_space(tracks: Tracks, error: Floats, covariance: Floats, truth_z: Floats) -> dict[str, Floats]:
    """The columns of `Errors` about heights, NaN where the estimate or the truth has none.

    Args:
        tracks: N estimates.
        error: (N, 2) their errors on the ground.
        covariance: (N, 2, 2) theirs on the ground.
        truth_z: (N,) true heights, NaN where not known.
    """
    error_z = tracks.z - truth_z
    whole = np.empty((len(tracks), 3, 3))
    whole[:, :2, :2] = covariance
    whole[:, 0, 2] = whole[:, 2, 0] = tracks.cov_xz
    whole[:, 1, 2] = whole[:, 2, 1] = tracks.cov_yz
    whole[:, 2, 2] = tracks.cov_zz
    return {
        "z": tracks.z,
        "truth_z": truth_z,
        "error_z": error_z,
        "error_space": np.sqrt(np.sum(error**2, axis=1) + error_z**2),
        "nees_space": normalised_squared_errors_in_space(np.column_stack([error, error_z]), whole),
    }


def in_space(errors: Errors) -> Bools:
    """(N,) bool: errors of estimates whose height and true height are known."""
    return np.isfinite(errors.error_space)


def space_metrics(errors: Errors, unit: str, whose: str) -> Metrics:
    """RMSE along z and in space and consistency there (mean NEES 3); nothing if no error in space is known.

    Over the errors in space only, which may be fewer than those on the ground.
    """
    high = errors.take(in_space(errors))
    if not len(high):
        return {}
    nees = high.nees_space[np.isfinite(high.nees_space)]
    return {
        f"rmse_z{whose}_{unit}": root_mean_square(high.error_z),
        f"rmse_space{whose}_{unit}": root_mean_square(high.error_space),
        f"nees_space_mean{whose}": ratio(float(nees.sum()), len(nees)),
        f"nees_space_share_95{whose}": ratio(int(np.count_nonzero(nees <= CHI2_95_3D)), len(nees)),
        f"nees_space_singular{whose}": len(high) - len(nees),
        f"estimates_space{whose}": len(high),
    }


def space_spread(errors: Errors, unit: str) -> Metrics:
    """Mean and quantiles of the distance in space, and the mean error along z; nothing if none is known."""
    high = errors.take(in_space(errors))
    if not len(high):
        return {}
    return {
        f"error_space_mean_{unit}": ratio(float(high.error_space.sum()), len(high)),
        f"error_space_median_{unit}": quantile(high.error_space, 0.5),
        f"error_space_p95_{unit}": quantile(high.error_space, 0.95),
        f"error_space_max_{unit}": quantile(high.error_space, 1.0),
        f"bias_z_{unit}": ratio(float(high.error_z.sum()), len(high)),
    }
