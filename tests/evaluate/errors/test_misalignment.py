"""A constant delay between tracks and truth, and other times, units and axes, found from the positions alone."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occlog.array_types import NS
from occlog.cli.main import run
from occlog.errors import spelled
from occlog.evaluate.errors.misalignment import (
    MAX_WINDOWS,
    MIN_TRACKS,
    DelaySums,
    PositionSamples,
    TruthAlignment,
    alternative,
    tracks_per_target,
    velocities,
)
from occlog.evaluate.matching.paths import ObjectPath
from occlog.records.messages import VERDICT
from occlog.records.tables import Tracks, Truth

RATE = 10.0


def walks(seed: int, people: int = 4, seconds: float = 30.0) -> tuple[np.ndarray, np.ndarray]:
    """(T,) times and (people, T, 2) positions of walkers with smooth random velocities in a room of 10 x 8 m."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    angle = np.cumsum(rng.normal(0.0, 0.15, (people, len(t))), axis=1) + rng.uniform(0.0, 7.0, (people, 1))
    step = rng.uniform(0.8, 1.5, (people, 1, 1)) * np.stack([np.cos(angle), np.sin(angle)], axis=-1) / RATE
    walked = rng.uniform(1.0, 7.0, (people, 1, 2)) + np.cumsum(step, axis=1)
    wide = np.array([10.0, 8.0])
    return t, np.abs(np.mod(walked, 2.0 * wide) - wide)  # walls reflect


def lasting(rng: np.random.Generator, shape: tuple[int, ...], sigma: float, seconds: float = 1.0) -> np.ndarray:
    """Errors (people, T, 2) that are correlated over time."""
    rho = math.exp(-1.0 / (RATE * seconds))
    out = rng.normal(0.0, sigma, shape)
    for k in range(1, shape[1]):
        out[:, k] = rho * out[:, k - 1] + math.sqrt(1.0 - rho**2) * out[:, k]
    return out


def delay_of(seed: int, delay_s: float, sigma: float = 0.05) -> DelaySums:
    """Sums over estimates with lasting errors that are of `delay_s` before."""
    t, true = walks(seed)
    rng = np.random.default_rng(seed + 1000)
    sums = DelaySums()
    error = lasting(rng, true.shape, sigma)
    t_ns = (t * NS).round().astype(np.int64)
    for own, wrong in zip(true, error, strict=True):
        late = np.column_stack([np.interp(t - delay_s, t, own[:, axis]) for axis in (0, 1)])
        inner = (t > 1.0) & (t < t[-1] - 1.0)
        v = velocities({0: ObjectPath(t_ns, own)}, np.zeros(len(t), np.int64), t_ns, None)
        sums.update(t_ns[inner], (late + wrong - own)[inner], v[inner])
    return sums


@pytest.mark.parametrize(("step_s", "found"), [(0.1, True), (1.0, False)])
def test_a_lag_of_part_of_a_time_step_must_explain_half_of_the_errors(step_s: float, found: bool) -> None:
    """A Kalman filter of two stations at 2 Hz, consistent and 0.25 s behind in turns, was no longer plausible."""
    rng = np.random.default_rng(0)
    t_ns = (np.arange(400) * step_s * NS).astype(np.int64)
    v = rng.normal(size=(400, 2))
    for lag, always in ((0.3, False), (1.0, True)):
        sums = DelaySums()
        sums.update(t_ns, -lag * v + rng.normal(0.0, 0.4, v.shape), v)
        assert any(check.found for check in sums.checks("m")) == (found or always)


@pytest.mark.parametrize("ppm", [-1000.0, 0.0, 1000.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_frame_rate_of_ntsc_in_place_of_its_nominal_one_is_named(ppm: float, seed: int) -> None:
    """Over ten minutes errors were six times as large, without a word."""
    rng = np.random.default_rng(seed)
    t_ns = (np.arange(6000) * 0.1 * NS).astype(np.int64)
    v = np.repeat(rng.normal(size=(200, 2)), 30, axis=0)
    lasting_error = np.repeat(rng.normal(0.0, 0.05, (600, 2)), 10, axis=0)
    sums = DelaySums()
    for part in np.split(np.arange(6000), [1000, 3500]):
        sums.update(t_ns[part], (lasting_error - 1e-6 * ppm * t_ns[:, None] / NS * v)[part], v[part])
    found = {check.id: check.figures for check in sums.checks("m") if check.found}
    assert list(found) == (["tracks-clock-drift"] if ppm else [])
    if ppm:
        assert found["tracks-clock-drift"]["ppm"] == pytest.approx(1000.0, rel=0.05)
        assert found["tracks-clock-drift"]["without"] < 0.1


def test_the_delay_is_that_of_a_regression_with_a_constant() -> None:
    rng = np.random.default_rng(0)
    v, t_ns = rng.normal(size=(400, 2)), np.sort(rng.integers(0, 40 * NS, 400))
    e = -0.3 * v + [0.2, -0.1] + rng.normal(0.0, 0.1, v.shape)
    sums = DelaySums()
    sums.update(t_ns[:150], e[:150], v[:150])
    sums.update(t_ns[150:], e[150:], v[150:])
    found = sums.estimate()
    assert found is not None
    # Both axes have one slope and a constant each
    design = np.zeros((800, 3))
    design[:400, 0], design[400:, 0] = v[:, 0], v[:, 1]
    design[:400, 1] = design[400:, 2] = 1.0
    slope = np.linalg.lstsq(design, e.T.ravel(), rcond=None)[0]
    assert found.seconds == pytest.approx(-slope[0], rel=1e-9)
    left = e.T.ravel() - design @ slope
    centred = e - e.mean(axis=0)
    assert found.gain == pytest.approx(1.0 - left @ left / np.sum(centred**2), rel=1e-9)
    # Errors of clusters by the sandwich of the centred design
    score = ((v - v.mean(axis=0)) * left.reshape(2, 400).T).sum(axis=1)
    of = np.unique(t_ns // (2 * NS), return_inverse=True)[1]
    clusters = of.max() + 1
    variance = np.sum(np.bincount(of, score) ** 2) / np.sum((v - v.mean(axis=0)) ** 2) ** 2 * clusters / (clusters - 1)
    assert found.sigma == pytest.approx(math.sqrt(variance), rel=1e-9)


def test_a_delay_is_found_with_its_error_and_lasting_errors_are_none() -> None:
    """20 recordings each: 0.2 s within 4 standard errors, and none stated where there is none."""
    for seed in range(20):
        found = delay_of(seed, 0.2)
        estimate = found.estimate()
        assert estimate is not None
        assert abs(estimate.seconds - 0.2) < 4.0 * estimate.sigma + 0.01
        assert [check.id for check in found.checks("m")] == ["tracks-delayed"]
        assert [check.id for check in delay_of(seed, 0.0).checks("m")] == [""]


def test_tracks_that_are_early_are_reported_to_be_so() -> None:
    (findings,) = delay_of(3, -0.15).checks("m")
    assert findings.id == "tracks-delayed"
    assert "ahead of" in findings.text


def test_many_windows_are_joined_and_change_nothing_but_the_error() -> None:
    rng = np.random.default_rng(1)
    n = 3 * MAX_WINDOWS
    t_ns, v = np.arange(n) * 2 * NS, rng.normal(size=(n, 2))
    e = -0.1 * v + rng.normal(0.0, 0.1, v.shape)
    whole = DelaySums()
    for part in np.array_split(np.arange(n), 5):
        whole.update(t_ns[part], e[part], v[part])
    found = whole.estimate()
    assert found is not None
    c = v - v.mean(axis=0)
    assert found.seconds == pytest.approx(-np.sum(c * e) / np.sum(c * c), rel=1e-9)


def test_targets_that_stand_still_have_no_delay() -> None:
    sums = DelaySums()
    t_ns = np.arange(300) * NS // 10
    sums.update(t_ns, np.random.default_rng(0).normal(size=(300, 2)), np.zeros((300, 2)))
    assert [check.status for check in sums.checks("m")] == ["not applicable"]


def positions(seed: int = 0, people: int = 4) -> PositionSamples:
    t, xy = walks(seed, people)
    return PositionSamples(np.repeat(t, people), xy.transpose(1, 0, 2).reshape(-1, 2))


def turned(degrees: float, xy: np.ndarray) -> np.ndarray:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    out: np.ndarray = xy @ np.array([[c, s], [-s, c]])
    return out


CHANGES = {
    "time-unit-differs": lambda p: p._replace(t=1000.0 * p.t),
    "times-shifted": lambda p: p._replace(t=p.t + 3.0),
    "frame-rate-differs": lambda p: p._replace(t=1.2 * p.t),
    "length-unit-differs": lambda p: p._replace(xy=100.0 * p.xy),
    "axes-differ": lambda p: p._replace(xy=p.xy[:, ::-1]),
}
WORDS = {
    "time-unit-differs": "multiplied by 0.001",
    "times-shifted": "shifted by -3 s",
    "frame-rate-differs": "multiplied by 0.83",
    "length-unit-differs": "lengths times 0.01",
    "axes-differ": "x and y exchanged",
}


@pytest.mark.parametrize("id", CHANGES)
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.statistics)])
def test_each_change_is_named(id: str, seed: int) -> None:
    truth = positions(seed)
    rng = np.random.default_rng(seed)
    tracks = CHANGES[id](PositionSamples(truth.t, truth.xy + rng.normal(0.0, 0.05, truth.xy.shape)))
    found = alternative(tracks, truth, 1.0)
    assert found is not None
    best, now, gate = found
    assert gate == 1.0
    assert best.id == id
    assert WORDS[id] in best.change
    assert best.met > 0.9
    assert now < 0.5


def test_a_shift_in_a_crowd_is_named_though_somebody_is_within_the_gate_anyway() -> None:
    truth = positions(0, people=40)
    tracks = PositionSamples(truth.t + 0.8, truth.xy + np.random.default_rng(0).normal(0.0, 0.05, truth.xy.shape))
    found = alternative(tracks, truth, 1.0)
    assert found is not None
    best, now, gate = found
    assert (best.id, gate) == ("times-shifted", 0.25)
    assert "shifted by -0.8 s" in best.change
    assert best.met > 0.9
    assert now < 0.6


UTC = 1_714_564_800.0


@pytest.mark.parametrize(
    ("times", "id", "words"),
    [
        (lambda t: t + UTC - 315_964_782.0, "times-shifted", "times shifted by +315964782 s (GPS time)"),
        (lambda t: t + UTC + 37.0, "times-shifted", "times shifted by -37 s (TAI)"),
        (lambda t: t + UTC + 7200.0, "times-shifted", "times shifted by -7200 s (a time zone)"),
        (lambda t: t + UTC - 20_700.0, "times-shifted", "times shifted by +20700 s (a time zone)"),
        (lambda t: t + 12.5, "times-shifted", "times shifted by +1714564787.5 s (times since a start)"),
        (lambda t: t + UTC + 25.0, "times-shifted", "times shifted by -25 s"),
        (lambda t: (t + UTC) / 86_400.0 + 25_569.0, "times-in-days", "times as days of Excel"),
        (lambda t: (t + UTC) / 86_400.0 + 719_529.0, "times-in-days", "times as days of MATLAB"),
        (lambda t: (t + UTC) / 86_400.0 + 2_440_587.5, "times-in-days", "times as days of Julian dates"),
    ],
)
def test_other_clocks_are_named(times: Any, id: str, words: str) -> None:
    here = positions()
    truth = here._replace(t=here.t + UTC)
    found = alternative(here._replace(t=times(here.t)), truth, 1.0)
    assert found is not None
    assert (found[0].id, found[0].change) == (id, words)


@pytest.mark.parametrize("factor", [100.0, 1000.0, 1.0 / 0.3048, 1.0 / 0.0254, 40.0])
def test_a_truth_in_a_smaller_unit_is_named(factor: float) -> None:
    truth = positions(3)
    rng = np.random.default_rng(3)
    tracks = truth._replace(xy=truth.xy + rng.normal(0.0, 0.05, truth.xy.shape))
    found = alternative(tracks, truth._replace(xy=factor * truth.xy), 1.0)
    assert found is not None
    assert (found[0].id, found[0].change) == ("length-unit-differs", f"lengths times {factor:.6g}")


def test_clocks_since_other_dates_are_aligned() -> None:
    truth = positions()
    tracks = truth._replace(t=truth.t + 1.7e9)
    found = alternative(tracks, truth, 1.0)
    assert found is not None
    assert (found[0].id, found[1]) == ("times-shifted", 0.0)


def test_a_turned_and_moved_world_is_found() -> None:
    truth = positions(2)
    found = alternative(PositionSamples(truth.t, turned(-37.0, truth.xy - [3.0, -2.0])), truth, 1.0)
    assert found is not None
    assert found[0].id == "axes-differ"
    assert "turned by 37 degrees and moved by (" in found[0].change
    assert found[0].met > 0.9


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("of", ["truth", "tracks"])
def test_y_up_is_named(of: str, sign: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    true = positions(2)
    ground, y_up = ["time,id,x,y"], ["time,id,x,y,z"]
    for n, (t, (x, y)) in enumerate(zip(true.t, true.xy, strict=True)):
        ground.append(f"{t:.1f},{n % 4},{x:.3f},{y:.3f}")
        y_up.append(f"{t:.1f},{n % 4},{x:.3f},0.9,{sign * y:.3f}")
    for name, lines in ((of, y_up), ({"truth": "tracks", "tracks": "truth"}[of], ground)):
        (tmp_path / f"{name}.csv").write_text("\n".join(lines) + "\n")
    assert run(["evaluate", str(tmp_path / "tracks.csv"), "--truth", str(tmp_path / "truth.csv"), "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)["warnings"]
    assert found["id"] == "axes-differ"
    assert f"x and z of the {of}" in found["message"]


def test_frame_numbers_in_place_of_times_are_named() -> None:
    truth = positions(2)
    found = alternative(PositionSamples(25.0 * (truth.t - truth.t[0]), truth.xy), truth, 1.0)
    assert found is not None
    assert (found[0].id, found[0].change) == ("frame-rate-differs", "times multiplied by 0.04 from the first one on")


@pytest.mark.parametrize("seed", range(6))
def test_people_of_another_recording_are_no_change_of_this_one(seed: int) -> None:
    assert alternative(positions(10 + seed), positions(20 + seed), 1.0) is None


def test_without_positions_nothing_is_tried() -> None:
    none = PositionSamples(np.zeros(0), np.zeros((0, 2)))
    assert alternative(none, positions(), 1.0) is None
    assert alternative(positions(), none, 1.0) is None


@pytest.mark.parametrize(
    ("runs", "every", "hall"),
    [(2, 1, 1.0), (3, 1, 1.0), (2, 3, 1.0), (2, 1, 0.3), (1, 1, 1.0), (1, 3, 1.0), (1, 1, 0.3)],
)
def test_tracks_of_several_runs_in_one_file_are_counted(runs: int, every: int, hall: float) -> None:
    """Also where tracks and truth have other rates, the truth has half of the people, or people are close together."""
    rng = np.random.default_rng(runs + every)
    t, true = walks(5, people=6)
    true = true * hall
    labelled = PositionSamples(*(np.repeat(t, 3), true[:3].swapaxes(0, 1).reshape(-1, 2)))
    parts = [(t[::every], each[::every] + rng.normal(0.0, 0.1, each[::every].shape)) for each in true] * runs
    times, xy = np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])
    order = np.argsort(times, kind="stable")
    count = tracks_per_target(PositionSamples(times[order] + 0.03, xy[order]), labelled, 0.5)
    assert (count >= MIN_TRACKS) == (runs > 1)
    assert hall < 1.0 or count == pytest.approx(runs, rel=0.15)


@pytest.mark.parametrize("runs", [1, 2])
def test_tracks_of_two_runs_are_named(runs: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t, true = walks(2, people=3)
    rows = [(k, i, *true[i, k]) for i in range(3) for k in range(len(t))]
    (tmp_path / "truth.csv").write_text(_csv(rows))
    doubled = [(k, 10 * run + i, x + 0.2 * run, y) for run in range(runs) for k, i, x, y in rows]
    (tmp_path / "mine.csv").write_text(_csv(doubled))
    run(["evaluate", str(tmp_path / "mine.csv"), "--truth", str(tmp_path / "truth.csv"), "--json"])
    warnings = json.loads(capsys.readouterr().out)["warnings"]
    assert [each["id"] for each in warnings if each["id"] == "tracks-doubled"] == ["tracks-doubled"] * (runs - 1)


@pytest.mark.parametrize("tracked", [True, False])
def test_tracks_of_occluders_are_stated(tracked: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A tracker of all people had a precision of 0.5 without a word."""
    t, true = walks(2, people=3)
    lines = ["t,id,role,x,y"]
    lines += [
        f"{time:.1f},{i},{'occluder' if i else 'target'},{x:.4f},{y:.4f}"
        for k, time in enumerate(t)
        for i, (x, y) in enumerate(true[:, k])
    ]
    (tmp_path / "truth.csv").write_text("\n".join(lines))
    moved = np.where(np.arange(3) > 0, 0.0 if tracked else 4.0, 0.0)
    (tmp_path / "mine.csv").write_text(
        _csv([(k, i, true[i, k, 0] + moved[i], true[i, k, 1]) for i in range(3) for k in range(len(t))])
    )
    run(["evaluate", str(tmp_path / "mine.csv"), "--truth", str(tmp_path / "truth.csv"), "--json"])
    out = capsys.readouterr()
    assert (VERDICT["occluders-tracked"].text.format(share=1.0) in out.err) == tracked


def _csv(rows: list[tuple[int, int, float, float]]) -> str:
    lines = (f"{k / RATE:.1f},{i},{x:.4f},{y:.4f}" for k, i, x, y in sorted(rows))
    return "\n".join(["t,id,x,y", *lines]) + "\n"


def test_only_tracks_far_from_the_truth_are_compared_with_changes() -> None:
    rows = Truth.of(t_ns=[0], target_id=[0], x=[0.0], y=[0.0], z=[np.nan], role=["target"])
    asked = []

    def sources() -> tuple[list[Tracks], list[Truth]]:
        asked.append(1)
        return [Tracks.empty()], [rows]

    aligned = TruthAlignment(sources, 1.0, "m")
    for metrics, read in (({"mota": 0.5}, 0), ({"error_median_m": 0.5}, 0), ({"mota": 0.1}, 1)):
        assert all(not check.found for check in aligned.checks(metrics))
        assert len(asked) == read


@pytest.mark.parametrize(
    ("tracks", "id"), [("mine_ms.csv", "time-unit-differs"), ("mine_mm.csv", "length-unit-differs")]
)
def test_tracks_in_ms_or_mm_are_named(
    tracks: str, id: str, shared_cases: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = shared_cases / "v21-tracks-in-ms-or-mm"
    assert run(["evaluate", str(folder / tracks), "--truth", str(folder / "truth.csv"), "--json"]) == 0
    assert [stdout["id"] for stdout in json.loads(capsys.readouterr().out)["warnings"]] == [id]


def test_a_truth_of_frames_numbered_two_lower_is_a_delay(
    shared_cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Estimates are the truth of 0.2 s earlier: the same number of frames, with errors of 3 cm."""
    lines = (shared_cases / "w07_two_frames_apart" / "truth.csv").read_text().split()
    head, rows = lines[0].split(","), [line.split(",") for line in lines[1:]]
    at, rng = {name: n for n, name in enumerate(head)}, np.random.default_rng(0)
    late, true = ["time,id,x,y"], ["time,id,x,y"]
    for row in rows:
        t, who, x, y = int(row[at["frame"]]) / 10.0, row[at["id"]], float(row[at["x"]]), float(row[at["y"]])
        true.append(f"{t},{who},{x},{y}")
        late.append(f"{t + 0.2:.1f},{who},{x + rng.normal(0.0, 0.03):.4f},{y + rng.normal(0.0, 0.03):.4f}")
    for name, text in (("tracks.csv", late), ("truth.csv", true)):
        (tmp_path / name).write_text("\n".join(text) + "\n")
    assert run(["evaluate", str(tmp_path / "tracks.csv"), "--truth", str(tmp_path / "truth.csv"), "--json"]) == 0
    (stdout,) = json.loads(capsys.readouterr().out)["warnings"]
    assert stdout["id"] == "tracks-delayed"
    assert stdout["figures"]["delay_s"] == pytest.approx(0.2, abs=4.0 * stdout["figures"]["sigma_s"])


@pytest.mark.parametrize(
    ("change", "id", "remedy"),
    [
        (lambda p: p._replace(t=p.t / 60.0), "time-unit-differs", "for tracks in minutes: multiply the times by 60"),
        (lambda p: p._replace(t=p.t / 3600.0), "time-unit-differs", "for tracks in hours: multiply the times by 3600"),
        (
            lambda p: p._replace(t=p.t * 1000.0),
            "time-unit-differs",
            "for tracks in ms: write t_ms, or input_units FILE:ms",
        ),
        (
            lambda p: p._replace(xy=p.xy / 0.3048),
            "length-unit-differs",
            "for tracks in ft: write x_ft, or input_units FILE:ft",
        ),
        (
            lambda p: p._replace(xy=p.xy / 0.0254),
            "length-unit-differs",
            "for tracks in in: write x_in, or input_units FILE:in",
        ),
        (
            lambda p: p._replace(xy=p.xy * 0.001),
            "length-unit-differs",
            "for a truth in mm: write x_mm, or input_units FILE:mm",
        ),
    ],
)
def test_the_remedy_for_another_unit_is_how_to_state_it(change: Any, id: str, remedy: str) -> None:
    truth = positions(3)
    found = alternative(change(truth), truth, 1.0)
    assert found is not None
    assert (found[0].id, spelled(found[0].remedy).replace("--input-units", "input_units")) == (id, remedy)


@pytest.mark.parametrize("which", ["tracks", "truth"])
def test_the_table_with_times_in_days_is_named(which: str) -> None:
    seconds = positions()._replace(t=positions().t + UTC)
    days = seconds._replace(t=seconds.t / 86_400.0 + 25_569.0)
    found = alternative(*((days, seconds) if which == "tracks" else (seconds, days)), 1.0)
    assert found is not None
    assert (found[0].id, found[0].which) == ("times-in-days", which)


def test_tracks_in_ms_of_which_few_are_in_the_time_of_the_truth_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, unit in (("ms.tum", 1000.0), ("s.tum", 1.0)):
        rows = [f"{0.1 * k * unit:.1f} {3.0 * np.cos(0.03 * k):.4f} {0.01 * k:.4f} 1 0 0 0 1" for k in range(200)]
        (tmp_path / name).write_text("\n".join(rows) + "\n")
    assert run(["evaluate", str(tmp_path / "ms.tum"), "--truth", str(tmp_path / "s.tum"), "--json"]) == 0
    assert [each["id"] for each in json.loads(capsys.readouterr().out)["warnings"]] == ["time-unit-differs"]
