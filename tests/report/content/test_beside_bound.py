"""Errors next to the bound: figures of pieces are those of whole tables."""

from __future__ import annotations

import numpy as np
import pytest
from made_up import run

from occlog.records.tables import Bound, Errors, TableBuffer, in_step
from occlog.report.content.accuracy import ErrorsAgainstBound


def tables(*, smoothed: bool) -> tuple[Errors, Bound]:
    """Errors and bounds of two targets, each with rows that the other has not; heights and smoothing now and then."""
    data, random = run(steps=100, targets=2), np.random.default_rng(4)
    assert data.errors is not None
    assert data.bound is not None
    n = len(data.errors)
    up = np.where(random.random(n) < 0.5, np.nan, random.normal(0, 1, n))
    columns = {c.name: getattr(data.errors, c.name) for c in Errors.columns()}
    errors = Errors.of(**columns | {"error_z": up, "error_space": np.hypot(data.errors.error, up)})
    columns = {c.name: getattr(data.bound, c.name) for c in Bound.columns()}
    columns |= {"bound_zz": np.full(n, 0.04), "bound_space": np.hypot(data.bound.bound, 0.2)}
    if smoothed:
        reported = (data.bound.target_id == 1) | (random.random(n) < 0.7)
        columns["smoothed"] = np.where(reported, 0.5 * data.bound.bound, np.nan)
    bound = Bound.of(**columns)
    return errors.take(random.random(n) < 0.9), bound.take(random.random(n) < 0.8)


def with_bound(errors: Errors, bound: Bound, where: str, column: str) -> tuple[float, float]:
    """RMSE and root mean square bound over the rows that have both."""
    error, least = getattr(errors, f"error{where}"), getattr(bound, column)
    its = {(t, k): b for t, k, b in zip(bound.t_ns, bound.target_id, least, strict=True) if np.isfinite(b)}
    both = [
        (e, its[t, k])
        for t, k, e in zip(errors.t_ns, errors.target_id, error, strict=True)
        if np.isfinite(e) and (t, k) in its
    ]
    rmse, rms = np.sqrt(np.mean(np.square(both), axis=0)).tolist()
    return rmse, rms


def running_rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.cumsum(values**2) / np.arange(1, len(values) + 1))


@pytest.mark.parametrize("rows", [1, 23, 10**6])
@pytest.mark.parametrize("smoothed", [False, True])
def test_figures_are_the_same_in_chunks_of_any_length(rows: int, smoothed: bool) -> None:
    errors, bound = tables(smoothed=smoothed)
    sides = (
        TableBuffer((errors.take(slice(s, s + rows)) for s in range(0, len(errors), rows)), Errors),
        TableBuffer((bound.take(slice(s, s + rows + 3)) for s in range(0, len(bound), rows + 3)), Bound),
    )
    found, so_far = ErrorsAgainstBound(), [np.zeros((0, 2))]
    for limits in in_step(sides, (0, 0)):
        so_far.append(found.add(limits.of(sides[0]), limits.of(sides[1])))
    for target in (None, 0, 1):
        mine = errors if target is None else errors.take(errors.target_id == target)
        its = bound if target is None else bound.take(bound.target_id == target)
        for where in ("", "_space"):
            for later in (False, True):
                known = later and np.isfinite(getattr(its, f"smoothed{where}")).any()
                wanted = with_bound(mine, its, where, f"{'smoothed' if known else 'bound'}{where}")
                assert found.figures(target, where, smoothed=later) == pytest.approx(wanted, rel=1e-12)
                assert np.isfinite(wanted).all()
    least = np.concatenate(so_far)
    for target in (0, 1):
        own = bound.target_id == target
        np.testing.assert_allclose(least[own, 0], running_rms(bound.bound[own]), rtol=1e-12)
        np.testing.assert_allclose(least[own, 1], running_rms(bound.smoothed[own]), rtol=1e-12)
        assert found.smooths(target) == (smoothed and target == 1)


def test_without_anything_in_common_there_is_no_figure() -> None:
    errors, bound = tables(smoothed=False)
    found = ErrorsAgainstBound()
    found.add(errors.take(errors.t_ns < 10**9), bound.take(bound.t_ns > 10**9))
    assert np.isnan(found.figures()).all()
