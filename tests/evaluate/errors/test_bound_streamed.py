"""The bound of blocks is that of whole tables: rows, figures, and those after a transient."""

from __future__ import annotations

import numpy as np
import pytest
from bearing_scenes import CASES

from occlog.errors import InputError
from occlog.evaluate.bearings.detections import looks_of
from occlog.evaluate.errors.bound import bound_metrics, compute_bound
from occlog.evaluate.errors.bound_streamed import BoundStreams, Ways
from occlog.evaluate.errors.on_ground import compare
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.paths import paths_of, sensors_of
from occlog.records.tables import Bound, Errors


def made(
    what: str, config: EvaluateConfig, block: int, *, with_errors: bool, late_from: float
) -> tuple[Bound, Bound, dict[str, float], dict[str, float]]:
    """The bound by both ways, and the figures by both ways, those of late errors too."""
    case = CASES[what](2)
    pairs = {k: k for k in paths_of(case.truth, "target")}
    looks = looks_of(case.bearings, case.truth, case.place, pairs, config)
    errors = compare(case.tracks, case.truth, config).errors if with_errors else Errors.empty()
    late = errors.t_ns >= np.quantile(case.tracks.t_ns, late_from)
    whole = compute_bound(looks, case.truth, errors, case.place, config)
    paths = paths_of(case.truth, "target")
    high = {k for k, path in paths.items() if path.high.any()}
    streams = BoundStreams(case.place, config, high, Ways.of(config, high=bool(high)), block)
    streams.add(looks, sensors_of(case.place, looks), errors, late, paths)
    parts: list[Bound] = []
    streams.finish(parts.append)
    figures = bound_metrics(errors, whole, "m")
    figures |= {f"late_{n}": v for n, v in bound_metrics(errors.take(late), whole, "m").items()}
    found = streams.metrics("m") | {f"late_{n}": v for n, v in streams.metrics("m", late=True).items()}
    assert streams.rows == len(whole)
    return whole, Bound.concat(parts), figures, found


@pytest.mark.parametrize("what", CASES)
@pytest.mark.parametrize("block", [pytest.param(1, marks=pytest.mark.jit), 7, 10**6])
@pytest.mark.parametrize("motion", ["waypoint", "cv"])
@pytest.mark.parametrize(
    ("with_errors", "late_from"),
    [
        pytest.param(True, 0.0, marks=pytest.mark.jit),
        (True, 0.5),
        pytest.param(True, 0.99, marks=pytest.mark.jit),
        pytest.param(False, 0.5, marks=pytest.mark.jit),
    ],
)
def test_blocks_give_the_bound_of_whole_tables(
    what: str, block: int, motion: str, with_errors: bool, late_from: float
) -> None:
    config = EvaluateConfig(motion=motion)
    whole, parts, figures, found = made(what, config, block, with_errors=with_errors, late_from=late_from)
    assert len(whole) > 20
    assert np.isfinite(whole.bound_space).any() == (what == "in space" and with_errors)
    for c in Bound.columns():
        np.testing.assert_allclose(getattr(parts, c.name), getattr(whole, c.name), rtol=1e-13, err_msg=c.name)
    assert list(found) == list(figures)
    assert found == pytest.approx(figures, rel=1e-12, nan_ok=True)


@pytest.mark.jit
@pytest.mark.parametrize("with_errors", [True, False])
def test_so_do_bounds_that_are_asked_for_in_space_where_no_error_is(with_errors: bool) -> None:
    config = EvaluateConfig(bound_in="space", prior_z=1.0)
    whole, parts, figures, found = made("hand-made", config, 5, with_errors=with_errors, late_from=0.3)
    assert np.isfinite(whole.bound_space).all()
    assert "bound_rmse_space_m" in figures
    assert "bound_ratio_space" not in figures
    np.testing.assert_allclose(parts.bound_space, whole.bound_space, rtol=1e-13)
    assert found == pytest.approx(figures, rel=1e-12, nan_ok=True)


def test_a_target_without_heights_is_refused_in_space() -> None:
    with pytest.raises(InputError, match="has no height"):
        made("simulated", EvaluateConfig(bound_in="space"), 5, with_errors=True, late_from=0.0)
