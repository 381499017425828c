"""RMSE against the bound, on the ground and in space."""

from __future__ import annotations

import numpy as np

from ..columns import Bools, Ints
from ..core.metrics import ratio, root_mean_square
from ..records import Bound, Errors

Metrics = dict[str, float]


def bound_metrics(errors: Errors, bound: Bound, unit: str) -> Metrics:
    """Root of the mean bound and RMSE over it, over the times that both have, for all targets and for each."""
    out = _ratio(errors, bound, unit, "")
    for k in np.unique(bound.target_id).tolist():
        mine = errors.take(errors.target_id == k)
        out |= _ratio(mine, bound.take(bound.target_id == k), unit, f"_target_{k}")
    return out


def _ratio(errors: Errors, bound: Bound, unit: str, whose: str) -> Metrics:
    if not len(errors):
        return {f"bound_rmse{whose}_{unit}": root_mean_square(bound.bound)} | _least_in_space(bound, unit, whose)
    rows, both = _counterparts(errors, bound)
    errors, bound = errors.take(both), bound.take(rows[both])
    least = root_mean_square(bound.bound)
    out = {
        f"bound_rmse{whose}_{unit}": least,
        f"bound_ratio{whose}": ratio(root_mean_square(errors.error), least),
        f"bound_estimates{whose}": len(errors),
    }
    high = np.isfinite(errors.error_space) & np.isfinite(bound.bound_space)
    if not high.any():
        return out | _least_in_space(bound, unit, whose)
    out |= _least_in_space(bound.take(high), unit, whose)
    least = out[f"bound_rmse_space{whose}_{unit}"]
    out[f"bound_ratio_space{whose}"] = ratio(root_mean_square(errors.error_space[high]), least)
    return out


def _least_in_space(bound: Bound, unit: str, whose: str) -> Metrics:
    """Bounds of the RMSE along z and in space; nothing if the bound is on the ground."""
    high = np.isfinite(bound.bound_space)
    if not high.any():
        return {}
    return {
        f"bound_rmse_z{whose}_{unit}": root_mean_square(np.sqrt(bound.bound_zz[high])),
        f"bound_rmse_space{whose}_{unit}": root_mean_square(bound.bound_space[high]),
    }


def _counterparts(errors: Errors, bound: Bound) -> tuple[Ints, Bools]:
    """(N,) row of the bound at the time and of the target of each error, and where there is one."""
    rows, found = np.zeros(len(errors), dtype=np.int64), np.zeros(len(errors), dtype=np.bool_)
    for k in np.unique(bound.target_id):
        mine, its = np.flatnonzero(errors.target_id == k), np.flatnonzero(bound.target_id == k)
        at = np.minimum(np.searchsorted(bound.t_ns[its], errors.t_ns[mine]), len(its) - 1)
        rows[mine], found[mine] = its[at], bound.t_ns[its][at] == errors.t_ns[mine]
    return rows, found
