"""Findings at their limits and just beyond, and what they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from occlog.consistency.bearings import CandidateFrames, ComparedBearings
from occlog.consistency.estimates import MIN_EFFECTIVE_SAMPLE_SIZE
from occlog.consistency.verdict import (
    FALLBACKS,
    MAX_BLIND_SHARE,
    MAX_DEPLETED_SHARE,
    MAX_FLAGGED_SHARE,
    MAX_MOTION_VARIANCE_FACTOR,
    MAX_PERSISTENT_CANDIDATE_SHARE,
    MAX_POSSIBLE_OUTLIER_SHARE,
    MAX_REJECTED_SHARE,
    MAX_RESTART_SHARE,
    MIN_SAMPLES,
    NIS_HIGH,
    NIS_LOW,
    QUALITY_FLAGS,
    ConsistencyEvidence,
    exceeds_share,
    nis_check,
)
from occlog.core.metrics.normalised_squares import Ratio
from occlog.records.scene import Scene
from occlog.records.tables import Diagnostics, Residuals, Tracks
from occlog.records.verdicts import Verdict, finding, findings, plausible, summary_of

N = 2000


def filter_diagnostics(
    n: int = N, few: int = 0, fallback: tuple[str, int] = ("", 0), doubt: tuple[str, int] = ("", 0), seen: int = 1
) -> Diagnostics:
    nothing, none = np.full(n, np.nan), np.zeros(n, np.int32)
    return Diagnostics.of(
        t_ns=np.arange(n),
        target_id=none,
        ess=np.where(np.arange(n) < few, 0.5 * MIN_EFFECTIVE_SAMPLE_SIZE, 500.0),
        log_likelihood=nothing,
        n_observing=none,
        n_detected=np.full(n, seen, np.int32),
        fallback=np.array([fallback[0]] * fallback[1] + [""] * (n - fallback[1])),
        cameras=np.full(n, ""),
        n_available=none,
        selected=np.full(n, ""),
        predicted_mse=nothing,
        quality_flags=np.array([doubt[0]] * doubt[1] + [""] * (n - doubt[1])),
    )


def residuals(n: int, factor: float = 1.0, doubted: int = 0, sensor: str = "cam1") -> Residuals:
    value = factor * np.random.default_rng(0).permutation(np.sqrt(np.arange(1, n + 1) / (0.5 * (n + 1))))
    return Residuals.of(
        t_ns=np.arange(n),
        target_id=np.zeros(n, np.int32),
        sensor=np.full(n, sensor),
        residual=value,
        expected_variance=np.ones(n),
        inlier_probability=(np.arange(n) >= doubted).astype(float),
    )


def codes(
    *, diagnostics: Diagnostics | None = None, parts: tuple[Residuals, ...] = (), frames=(), one=True
) -> list[str]:
    return [f.id for f in report_of(diagnostics=diagnostics, parts=parts, frames=frames, one=one)]


def report_of(*, diagnostics: Diagnostics | None = None, parts: tuple[Residuals, ...] = (), frames=(), one=True):
    return findings(every(diagnostics=diagnostics, parts=parts, frames=frames, one=one))


def every(*, diagnostics: Diagnostics | None = None, parts: tuple[Residuals, ...] = (), frames=(), one=True):
    found = ConsistencyEvidence()
    found.add_diagnostics(filter_diagnostics() if diagnostics is None else diagnostics)
    for part in parts:
        found.saw(Tracks.empty(), ComparedBearings(part, tuple(frames)), Scene())
    if not parts:
        found.crowd.add(frames)
    return found.checks(one_target=one)


def crowd(n: int, again: int, sensor: str = "cam1") -> CandidateFrames:
    some = np.full(n, 3)
    return CandidateFrames(sensor, np.arange(n), some, some - 1, np.arange(n) < again)


def test_nothing_against_it_is_plausible() -> None:
    found = every(parts=(residuals(N),))
    assert findings(found) == ()
    assert summary_of([Verdict.of("track", found)]) == {"plausible": True, "warnings": []}


def test_chance_may_break_a_limit_with_one_run_in_a_thousand() -> None:
    # P(X >= k) of a binomial variable with n = 100, p = 0.25: 0.0014 at 39, 0.0007 at 40
    assert not exceeds_share(39, 100, 0.25)
    assert exceeds_share(40, 100, 0.25)
    assert not exceeds_share(0, 0, 0.25)


@pytest.mark.parametrize(
    ("share", "code"), [(MAX_DEPLETED_SHARE, "particles-depleted"), (MAX_RESTART_SHARE, "track-loss")]
)
def test_shares_of_rows_are_reported_beyond_their_limit(share: float, code: str) -> None:
    def made(count: int) -> Diagnostics:
        return (
            filter_diagnostics(few=count)
            if code == "particles-depleted"
            else filter_diagnostics(fallback=("restart", count))
        )

    assert codes(diagnostics=made(round(share * N))) == []
    assert codes(diagnostics=made(round(2 * share * N))) == [code]


@pytest.mark.parametrize(
    ("blind", "found"), [(MAX_BLIND_SHARE, []), (MAX_BLIND_SHARE + 0.05, ["selection-without-view"])]
)
def test_cameras_that_were_selected_in_vain_are_reported_beyond_half_of_the_rows(
    blind: float, found: list[str]
) -> None:
    rows = filter_diagnostics()
    saw = np.where(np.arange(N) < blind * N, 1, 2).astype(np.int32)
    assert codes(diagnostics=replace(rows, n_detected=saw, selected=np.full(N, "cam1,cam2,cam3"))) == found
    assert codes(diagnostics=replace(rows, n_detected=saw, selected=np.full(N, "cam1"))) == []


def test_depletion_says_number_limit_and_remedy() -> None:
    (found,) = report_of(diagnostics=filter_diagnostics(few=N))
    assert (found.id, found.severity) == ("particles-depleted", "warning")
    known = {"share": 1.0, "least": MIN_EFFECTIVE_SAMPLE_SIZE, "median": 5.0, "allowed": 0.25}
    assert found.figures == pytest.approx(known, rel=0.01)
    assert found.text.startswith("100% of the rows have fewer than 10 effective particles (allowed: 25%)")
    assert "use more particles" in found.text


@pytest.mark.parametrize("doubt", QUALITY_FLAGS)
def test_doubts_are_a_warning_beyond_one_row_in_twenty_and_a_note_below(doubt: str) -> None:
    for count, severity in (
        (1, "note"),
        (round(MAX_FLAGGED_SHARE * N), "note"),
        (round(MAX_FLAGGED_SHARE * N) + 1, "warning"),
    ):
        (found,) = report_of(diagnostics=filter_diagnostics(doubt=(doubt, count)))
        assert (found.id, found.severity) == (QUALITY_FLAGS[doubt], severity)
        assert found.text.startswith(f"{count} of {N} rows ")
    assert codes(diagnostics=filter_diagnostics(doubt=(doubt, 0))) == []


def test_an_honest_covariance_needs_care_and_is_plausible() -> None:
    found = report_of(diagnostics=filter_diagnostics(fallback=("unobservable", N)))
    assert [(f.id, f.severity) for f in found] == [("unobservable", "note")]
    assert plausible(found)


def test_a_target_that_no_sensor_ever_saw_is_reported() -> None:
    (found,) = report_of(diagnostics=filter_diagnostics(seen=0))
    assert (found.id, found.severity) == ("targets-never-detected", "note")
    assert (found.targets, found.figures) == ((0,), {"count": 1, "of": 1})


def test_a_filter_that_begins_again_in_nearly_every_row_says_how_far_apart_rows_are() -> None:
    minutes = np.arange(N) * 60_000_000_000
    (found,) = report_of(diagnostics=replace(filter_diagnostics(fallback=("gap", round(0.9 * N))), t_ns=minutes))
    assert found.id == "gaps"
    assert found.figures["interval_s"] == pytest.approx(60.0, rel=1e-3)
    assert report_of(diagnostics=replace(filter_diagnostics(fallback=("gap", round(0.5 * N))), t_ns=minutes)) == ()


def test_places_that_are_contested_are_reported_beyond_one_row_in_ten() -> None:
    assert (
        codes(diagnostics=filter_diagnostics(fallback=("possible_outlier", round(MAX_POSSIBLE_OUTLIER_SHARE * N))))
        == []
    )
    assert codes(
        diagnostics=filter_diagnostics(fallback=("possible_outlier", round(MAX_POSSIBLE_OUTLIER_SHARE * N) + 1))
    ) == ["possible-outlier"]


@pytest.mark.parametrize("fallback", [value for value, (_, allowed) in FALLBACKS.items() if not allowed][:3])
def test_rows_of_a_batch_method_that_failed_are_reported(fallback: str) -> None:
    found = report_of(diagnostics=filter_diagnostics(fallback=(fallback, 1)))
    assert [f.id for f in found] == [FALLBACKS[fallback][0]]
    assert not plausible(found)


def test_more_than_a_quarter_not_believed_is_reported_of_the_sensor() -> None:
    def two(n: int, doubted: int) -> tuple[Residuals]:
        return (Residuals.merge([residuals(n, doubted=doubted), residuals(n, sensor="cam2")]),)

    assert codes(parts=two(N, round(MAX_REJECTED_SHARE * N))) == []
    (found,) = report_of(parts=two(N, round(0.35 * N)))
    assert found.id == "measurements-rejected"
    assert found.text.startswith("cam1: 35% of 2000 bearings are rejected (allowed: 25%)")
    assert codes(parts=two(MIN_SAMPLES - 1, MIN_SAMPLES - 1)) == []
    assert codes(parts=two(MIN_SAMPLES, MIN_SAMPLES)) == ["measurements-rejected"]


@pytest.mark.parametrize(("doubted", "said_of_it"), [(0.02, []), (0.05, ["measurements-unconfirmed"])])
def test_bearings_not_believed_are_reported_sooner_where_one_sensor_at_a_time_sees_the_target(
    doubted: float, said_of_it: list[str]
) -> None:
    assert codes(parts=(residuals(N, doubted=round(doubted * N)),)) == said_of_it


@pytest.mark.parametrize(
    ("nis", "code"), [(NIS_HIGH, None), (1.01 * NIS_HIGH, "nis-large"), (NIS_LOW, None), (0.99 * NIS_LOW, "nis-small")]
)
def test_residuals_that_are_not_as_stated_are_reported(nis: float, code: str | None) -> None:
    found = nis_check("the bearings", Ratio(nis, 0.02), 1000.0)
    assert (None if found is None else found.id) == code


def test_residuals_that_chance_can_have_made_are_not_stated() -> None:
    assert nis_check("the bearings", Ratio(4.0, 0.2), float(MIN_SAMPLES)) is not None
    assert nis_check("the bearings", Ratio(4.0, 0.2), MIN_SAMPLES - 1.0) is None
    assert nis_check("the bearings", Ratio(4.0, 4.0), 1000.0) is None


def test_by_how_much_noise_is_misstated_is_reported() -> None:
    (large,) = report_of(parts=(residuals(N, 2.1),))
    assert large.text.startswith("the bearings are 2.1 times as far from the track as stated (NIS 4.4, allowed: 2.25)")
    (small,) = report_of(parts=(residuals(N, 1 / 2.1),))
    assert small.id == "nis-small"
    assert "2.1 times too large" in small.text
    assert small.severity == "note"


def test_one_sensor_whose_residuals_are_too_large_is_named() -> None:
    (found,) = report_of(parts=(residuals(3000), residuals(300, 2.0, sensor="cam7")))
    assert found.text.startswith("the bearings of cam7 are 2.0 times as far")


def test_motion_that_is_livelier_than_stated_is_reported_of_the_target() -> None:
    found = ConsistencyEvidence(rows=1)
    found.agreements.moves(3, MAX_MOTION_VARIANCE_FACTOR)
    found.agreements.moves(4, 2.25 * MAX_MOTION_VARIANCE_FACTOR)
    (only,) = findings(found.checks(one_target=True))
    assert only.text.startswith("target 4 moves 3.0 times as irregularly")


def test_candidates_that_stay_cannot_be_one_target() -> None:
    n = 100
    assert codes(frames=(crowd(n, round(MAX_PERSISTENT_CANDIDATE_SHARE * n)),)) == []
    (found,) = report_of(frames=(crowd(n, round(MAX_PERSISTENT_CANDIDATE_SHARE * n) + 1),))
    assert found.id == "several-targets"
    assert found.text.startswith("of 3.0 candidates a frame in cam1, 2.0 persist near no track")
    assert codes(frames=(crowd(n, n),), one=False) == []
    assert codes(frames=(crowd(MIN_SAMPLES - 1, MIN_SAMPLES - 1),)) == []
    assert codes(frames=(crowd(MIN_SAMPLES, MIN_SAMPLES),)) == ["several-targets"]


def test_a_summary_has_the_warnings_and_not_the_notes() -> None:
    made = (finding("x", "no-covariance"), finding("y", "camera-below-ground", sensors=["cam"]))
    warning = {"stage": "track", "id": "camera-below-ground", "message": made[1].text, "sensors": ["cam"]}
    assert summary_of([Verdict.of("track", made)]) == {"plausible": False, "warnings": [warning]}


@pytest.mark.parametrize(("few", "smoothed", "warns"), [(20, False, False), (20, True, True), (4, True, False)])
def test_smoothed_rows_suffer_from_fewer_depleted_ones(few: int, smoothed: bool, warns: bool) -> None:
    found = ConsistencyEvidence()
    found.particles.add(np.where(np.arange(200) < few, 3.0, 900.0))
    codes = [f.id for f in findings(found.checks(one_target=False, smoothed=smoothed))]
    assert codes == (["particles-depleted"] if warns else [])
