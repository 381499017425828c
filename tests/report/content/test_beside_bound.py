"""Errors beside the bound: figures of pieces are those of whole tables."""

from __future__ import annotations

import numpy as np
import pytest
from made_up import run

from occlog.records.pieces import Side, in_step
from occlog.records.tables import Bound, Errors
from occlog.report.content.beside_bound import BesideBound, with_bound
from occlog.report.drawing.thin import running_rms


def tables(*, smoothed: bool) -> tuple[Errors, Bound]:
    """Errors and bounds of two targets, each with rows that the other has not; heights and smoothing now and then."""
    data, random = run(steps=300, targets=2), np.random.default_rng(4)
    assert data.errors is not None
    assert data.bound is not None
    n = len(data.errors)
    up = np.where(random.random(n) < 0.5, np.nan, random.normal(0, 1, n))
    columns = {c.name: getattr(data.errors, c.name) for c in Errors.columns()}
    errors = Errors.of(**columns | {"error_z": up, "error_space": np.hypot(data.errors.error, up)})
    columns = {c.name: getattr(data.bound, c.name) for c in Bound.columns()}
    columns |= {"bound_zz": np.full(n, 0.04), "bound_space": np.hypot(data.bound.bound, 0.2)}
    if smoothed:
        told = (data.bound.target_id == 1) | (random.random(n) < 0.7)
        columns["smoothed"] = np.where(told, 0.5 * data.bound.bound, np.nan)
    bound = Bound.of(**columns)
    return errors.take(random.random(n) < 0.9), bound.take(random.random(n) < 0.8)


@pytest.mark.parametrize("rows", [1, 23, 10**6])
@pytest.mark.parametrize("smoothed", [False, True])
def test_figures_of_pieces_are_those_of_whole_tables(rows: int, smoothed: bool) -> None:
    errors, bound = tables(smoothed=smoothed)
    sides = (
        Side((errors.take(slice(s, s + rows)) for s in range(0, len(errors), rows)), Errors),
        Side((bound.take(slice(s, s + rows + 3)) for s in range(0, len(bound), rows + 3)), Bound),
    )
    found, so_far = BesideBound(), [np.zeros((0, 2))]
    for limits in in_step(sides, (0, 0)):
        so_far.append(found.add(limits.of(sides[0]), limits.of(sides[1])))
    for target in (None, 0, 1):
        mine = errors if target is None else errors.take(errors.target_id == target)
        its = bound if target is None else bound.take(bound.target_id == target)
        for where in ("", "_space"):
            for later in (False, True):
                wanted = with_bound(mine, its, where, smoothed=later)
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
    found = BesideBound()
    found.add(errors.take(errors.t_ns < 10**9), bound.take(bound.t_ns > 10**9))
    assert np.isnan(found.figures()).all()
