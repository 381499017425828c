"""What a comparison with the truth says against tracks, at the limits and just beyond."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.consistency.bearings import ResidualStatistics
from occlog.consistency.verdict import MIN_SAMPLES, ConsistencyEvidence
from occlog.core.metrics.errors import CHI2_95_2D
from occlog.core.metrics.normalised_squares import Ratio
from occlog.evaluate.verdict import (
    MAX_BOUND_RATIO,
    MAX_OUTSIDE_95_SHARE,
    MIN_DETECTION_RATE,
    NEES_HIGH,
    CovarianceConsistency,
    TrackProvenance,
    checks_with_truth,
)
from occlog.io.files.provenance import Provenance
from occlog.records.tables import Errors
from occlog.records.verdicts import Check, findings

N = 1000


def errors(nees: np.ndarray) -> Errors:
    n = len(nees)
    names = ("x", "y", "truth_x", "truth_y", "error_x", "error_y", "error")
    zeros = dict.fromkeys(names, np.zeros(n))
    return Errors.of(t_ns=np.arange(n), target_id=np.zeros(n, np.int32), nees=nees, **zeros)


def chi_square(factor: float = 1.0, n: int = N) -> np.ndarray:
    """Squares of two dimensions in a random order, with the quantiles of their distribution."""
    return factor * np.random.default_rng(0).permutation(-2.0 * np.log((np.arange(n) + 0.5) / n))


def judge(nees: np.ndarray, metrics: dict[str, float] | None = None) -> tuple[Check, ...]:
    """The verdict on tracks with errors of these normalised squares."""
    against = CovarianceConsistency(TrackProvenance(), None)
    against.update(errors(nees))
    return checks_with_truth(
        ConsistencyEvidence(rows=N), TrackProvenance(), against, unknown=False, metrics=metrics or {}
    )


def codes(nees: np.ndarray | None = None, **metrics: float) -> list[str]:
    return [f.id for f in findings(judge(chi_square() if nees is None else nees, metrics))]


def test_what_cannot_be_asked_is_not_applicable() -> None:
    made = judge(chi_square())
    assert not findings(made)
    status = {check.name: check.status for check in made}
    assert status["covariances against the truth (NEES)"] == "passed"
    assert status["effective sample size"] == "not applicable"


@pytest.mark.parametrize(("factor", "expected"), [(0.22, []), (0.18, ["nees-small"]), (1.0, []), (1.4, [])])
def test_covariances_that_are_about_right_pass(factor: float, expected: list[str]) -> None:
    assert codes(chi_square(factor)) == expected


def test_covariances_that_are_too_small_are_reported_with_the_numbers() -> None:
    found = judge(chi_square(1.2 * NEES_HIGH))
    (only,) = findings(found)
    assert (only.id, only.severity) == ("nees-large", "warning")
    assert "mean NEES 4.8, allowed: 4;" in only.text


def test_many_errors_outside_of_the_ellipse_are_reported_though_a_few_make_the_mean() -> None:
    def with_outside(share: float) -> np.ndarray:
        nees = chi_square(0.5)
        nees[np.random.default_rng(1).permutation(N)[: round(share * N)]] = CHI2_95_2D + 1e-6
        return nees

    assert codes(with_outside(0.5 * MAX_OUTSIDE_95_SHARE)) == []
    assert codes(with_outside(1.3 * MAX_OUTSIDE_95_SHARE)) == ["nees-large"]


def test_one_error_of_a_million_squared_sigmas_is_reported_if_others_are_outside() -> None:
    nees = chi_square(2.0)
    nees[7] = 1e7
    assert "nees-large" in codes(nees)


def test_singular_covariances_are_reported() -> None:
    nees = chi_square()
    nees[: round(0.01 * N)] = np.nan
    assert codes(nees) == []
    nees[: round(0.03 * N)] = np.nan
    assert codes(nees) == ["covariances-singular"]
    assert codes(np.full_like(nees, np.nan)) == ["covariances-singular"]


@pytest.mark.parametrize(
    ("rate", "expected"), [(MIN_DETECTION_RATE, []), (MIN_DETECTION_RATE - 0.1, ["low-detection-rate"])]
)
def test_bearings_that_are_not_of_the_truth_are_reported(rate: float, expected: list[str]) -> None:
    assert codes(detection_rate=rate, visible=500.0) == expected
    assert codes(detection_rate=rate, visible=2.0) == []


@pytest.mark.parametrize(
    ("nees", "there", "own", "reported"),
    [
        (9.0, 9.0, 1.0, True),
        (1.0, 9.0, 1.0, False),  # errors are as large as they say
        (9.0, 3.0, 1.0, False),  # bearings agree with the truth, too
        (9.0, 9.0, 9.0, False),  # bearings do not agree with the tracks either
    ],
)
def test_bearings_that_agree_with_the_tracks_and_not_with_the_truth_are_of_something_else(
    monkeypatch: pytest.MonkeyPatch, nees: float, there: float, own: float, reported: bool
) -> None:
    monkeypatch.setattr(ResidualStatistics, "nis", Ratio(own, 0.1))
    monkeypatch.setattr(ResidualStatistics, "doubted", 0.0)
    found = judge(chi_square(nees), {"bearing_nis": there})
    assert ("truth-of-another-target" in {f.id for f in found}) == reported


@pytest.mark.parametrize(
    ("ratio", "expected"), [(MAX_BOUND_RATIO, []), (MAX_BOUND_RATIO + 0.01, ["error-far-above-bound"])]
)
def test_an_error_far_above_the_bound_is_a_note(ratio: float, expected: list[str]) -> None:
    assert codes(bound_ratio=ratio, bound_estimates=float(MIN_SAMPLES)) == expected
    assert codes(bound_ratio=ratio, bound_estimates=MIN_SAMPLES - 1.0) == []


def test_provenance_says_how_tracks_were_made() -> None:
    parameters = {"method": "apf", "sensors": ["a", "b"], "window_ns": 5, "unlabelled": False}
    made = TrackProvenance.of(Provenance("track", parameters, 1, (), ()))
    assert made == TrackProvenance(False, True, False, frozenset("ab"), 5)
    assert not TrackProvenance.of(Provenance("track", {"method": "imm"}, 1, (), ())).one_target
    assert TrackProvenance.of(Provenance("track", {"method": "map"}, 1, (), ())).smoothed
    assert TrackProvenance.of(Provenance("ground", {}, 1, (), ())) == TrackProvenance()
