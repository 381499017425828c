"""Bearings in stretches of time: figures, findings and tables are those of whole tables, however these are cut."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bearing_scenes import CASES, Case, hand_made, simulated

from occlog.cli.main import run
from occlog.consistency.verdict import Finding
from occlog.errors import ExitCode
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.stage import Evaluation, evaluate
from occlog.evaluate.stretches import sources
from occlog.evaluate.verdict import Made, judge
from occlog.io import open as opening
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import iter_table, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.recording.writer import RecordingWriter
from occlog.io.scenes.scene import scene_to_yaml
from occlog.records.tables import Bearings, Bound, Errors, Tracks

MADE = Provenance("track", {"method": "apf", "sensors": ["a", "b", "c", "ear"], "window_ns": 40_000_000})
WHOLE = 10**6


WAYS: tuple[tuple[EvaluateConfig, str], ...] = (
    (EvaluateConfig(), ""),
    (
        EvaluateConfig(
            match="optimal", skip_s=2.0, lines_window_s=0.05, lines_limit=0.5, motion="cv", occluder_diameter=0.6
        ),
        "--match optimal --skip-seconds 2 --lines-window 0.05 --lines-limit 0.5 --motion cv --occluder-diameter 0.6",
    ),
    (
        EvaluateConfig(max_gap_s=100.0, gate_px=5.0, bound_in="ground"),
        "--max-gap 100 --gate-px 5 --bound-in ground",
    ),
)


def whole_of(
    case: Case, config: EvaluateConfig, given: frozenset[str]
) -> tuple[Evaluation, tuple[Finding, ...] | None]:
    """Figures and findings of whole tables."""
    mine, true = (getattr(case, n) if n in given else None for n in ("tracks", "truth"))
    found = evaluate(mine, true, case.bearings, case.place, config)
    said = judge(
        mine,
        case.place,
        Made.of(MADE),
        diagnostics=case.diagnostics if "diagnostics" in given else None,
        bearings=case.bearings,
        errors=found.errors,
        metrics=found.metrics,
    )
    return found, said


def streamed(
    folder: Path, patch: pytest.MonkeyPatch, case: Case, given: frozenset[str], rows: int, options: str = ""
) -> dict[str, Any]:
    """Figures by the command, of tables that are read so many rows at a time."""
    (folder / "scene.yaml").write_text(scene_to_yaml(case.place))
    for name in ("tracks", "truth", "bearings", "diagnostics"):
        write_table(folder / f"{name}.parquet", getattr(case, name), MADE, overwrite=True, length_unit="m")
    patch.setattr(opening, "iter_table", partial(iter_table, rows=rows))
    args = ["evaluate", *([str(folder / "tracks.parquet")] if "tracks" in given else [])]
    for name in ("truth", "diagnostics"):
        args += [f"--{name}", str(folder / f"{name}.parquet")] if name in given else []
    args += ["--bearings", str(folder / "bearings.parquet"), "--scene", str(folder / "scene.yaml"), "--overwrite"]
    args += ["--errors", str(folder / "errors.parquet"), "--bound", str(folder / "bound.parquet")]
    assert run([*args, "-o", str(folder / "m.json"), *options.split()]) == ExitCode.DONE
    return read(folder / "m.json")


def read(path: Path) -> dict[str, Any]:
    """Figures; what is not a number is null in JSON."""
    return {name: np.nan if value is None else value for name, value in json.loads(path.read_text()).items()}


@pytest.mark.parametrize(("way", "rows"), [(0, 1), (0, 13), (0, 17), (0, WHOLE), (1, 13), (2, 17)])
@pytest.mark.parametrize("what", CASES)
def test_the_command_gives_what_whole_tables_give(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str, way: int, rows: int
) -> None:
    config, options = WAYS[way]
    case, given = CASES[what](way), frozenset({"tracks", "truth", "diagnostics"})
    whole, said = whole_of(case, config, given)
    found = streamed(tmp_path, monkeypatch, case, given, rows, options)
    assert len(whole.bound) > 20 < len(whole.errors)
    assert 0 < whole.metrics["detected"] < whole.metrics["detection_looks"]
    assert {n: found[n] for n in whole.metrics} == pytest.approx(whole.metrics, rel=1e-10, abs=1e-13, nan_ok=True)
    counts = [n for n, value in whole.metrics.items() if float(value).is_integer()]
    exact = counts + [n for n in whole.metrics if "median" in n or "p95" in n or "_max" in n]
    assert len(exact) > 40
    assert {n: found[n] for n in exact} == pytest.approx(
        {n: whole.metrics[n] for n in exact}, rel=0, abs=0, nan_ok=True
    )
    warnings = [{"code": f.code, "sentence": f.sentence} for f in said or () if f.severity == "warning"]
    assert found["warnings"] == warnings
    for kind, table in ((Errors, whole.errors), (Bound, whole.bound)):
        again = read_table(tmp_path / f"{kind.NAME}.parquet", kind)
        for c in kind.columns():
            np.testing.assert_allclose(getattr(again, c.name), getattr(table, c.name), rtol=1e-12, err_msg=c.name)


@pytest.mark.parametrize("rows", [13, WHOLE])
@pytest.mark.parametrize("given", [frozenset({"tracks"}), frozenset({"truth"}), frozenset({"tracks", "diagnostics"})])
@pytest.mark.parametrize("what", CASES)
def test_so_do_tracks_or_a_truth_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str, given: frozenset[str], rows: int
) -> None:
    case = CASES[what](5)
    whole, said = whole_of(case, EvaluateConfig(lines_window_s=0.05), given)
    found = streamed(tmp_path, monkeypatch, case, given, rows, "--lines-window 0.05")
    assert len(whole.metrics) > 10
    assert {n: found[n] for n in whole.metrics} == pytest.approx(whole.metrics, rel=1e-10, abs=1e-13, nan_ok=True)
    assert set(found) - {"_provenance", "plausible", "warnings"} == set(whole.metrics)
    assert ("warnings" in found) == (said is not None)
    assert len(read_table(tmp_path / "bound.parquet", Bound)) == len(whole.bound)


@pytest.mark.parametrize("given", [frozenset({"tracks", "truth"}), frozenset({"tracks"})])
def test_frames_are_those_of_the_truth_or_of_the_bearings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: frozenset[str]
) -> None:
    case = hand_made(3)
    times = np.unique(case.truth.t_ns[case.truth.role == "target"] if "truth" in given else case.bearings.t_ns)
    low, high = times[10], times[45]
    part = Case(case.place, *(t.take((t.t_ns >= low) & (t.t_ns < high)) for t in case[1:]))
    whole, _ = whole_of(part, EvaluateConfig(), given)
    found = streamed(tmp_path, monkeypatch, case, given, 11, "--frames 10:45")
    assert {n: found[n] for n in whole.metrics} == pytest.approx(whole.metrics, rel=1e-10, abs=1e-13, nan_ok=True)


def test_frames_that_are_not_there_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    case, given = simulated(1), frozenset({"tracks", "truth"})
    streamed(tmp_path, monkeypatch, case, given, 11, "--frames 59:99")
    table = str(tmp_path / "tracks.parquet")
    args = ["evaluate", table, "--truth", str(tmp_path / "truth.parquet"), "--frames", "60:99"]
    assert run(args) == ExitCode.BAD_INPUT
    assert "frames 60:99: there are 60 of them, numbered from 0" in capsys.readouterr().err


@pytest.mark.parametrize("long", [10, 10**6])
def test_bearings_and_directions_in_a_recording_give_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, long: int
) -> None:
    monkeypatch.setattr(sources, "LONG", long)
    case = simulated(2)
    with RecordingWriter(tmp_path / "run.mcap", case.place, Provenance("ingest")) as out:
        out.table(case.truth)
        out.table(case.bearings)
    write_table(tmp_path / "tracks.parquet", case.tracks, MADE, length_unit="m")
    recording = str(tmp_path / "run.mcap")
    args = ["evaluate", str(tmp_path / "tracks.parquet"), "--truth", recording, "--bearings", recording]
    assert run([*args, "-o", str(tmp_path / "m.json")]) == ExitCode.DONE
    found = read(tmp_path / "m.json")
    whole, _ = whole_of(case, EvaluateConfig(), frozenset({"tracks", "truth"}))
    assert {n: found[n] for n in whole.metrics} == pytest.approx(whole.metrics, rel=1e-10, abs=1e-13, nan_ok=True)


@pytest.mark.parametrize("rows", [5, WHOLE])
def test_tracks_without_covariances_are_compared_with_bearings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], rows: int
) -> None:
    case = hand_made(3)
    for name in ("cov_xx", "cov_xy", "cov_yy"):
        getattr(case.tracks, name)[::2] = np.nan
    for name, table in (("tracks", case.tracks), ("bearings", case.bearings), ("truth", case.truth)):
        write_table(tmp_path / f"{name}.parquet", table, Provenance("x"))
    (tmp_path / "scene.yaml").write_text(scene_to_yaml(case.place))
    monkeypatch.setattr(opening, "iter_table", partial(iter_table, rows=rows))
    args = [f"--{name}={tmp_path / name}.parquet" for name in ("bearings", "truth")]
    args += [f"--scene={tmp_path / 'scene.yaml'}", "-o", str(tmp_path / "m.json")]
    assert run(["evaluate", str(tmp_path / "tracks.parquet"), *args]) == ExitCode.DONE
    found = json.loads((tmp_path / "m.json").read_text())
    assert found["detected"] > 0 < found["rmse_m"]
    assert not any(name.startswith("nees") for name in found)
    assert "estimates have no covariance" in capsys.readouterr().err


@pytest.mark.parametrize("rows", [5, WHOLE])
def test_candidates_are_not_of_a_track_whose_number_is_below_0(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows: int
) -> None:
    case = hand_made(3)
    free = np.where(case.bearings.seen, -1, case.bearings.target_id).astype(np.int32)
    free = Bearings.of(**{c.name: getattr(case.bearings, c.name) for c in Bearings.columns()} | {"target_id": free})
    (tmp_path / "scene.yaml").write_text(scene_to_yaml(case.place))
    monkeypatch.setattr(opening, "iter_table", partial(iter_table, rows=rows))
    first, found = int(case.tracks.target_id[0]), []
    for number in (1000, -1):
        names = np.where(case.tracks.target_id == first, number, case.tracks.target_id).astype(np.int32)
        ours = Tracks.of(**{c.name: getattr(case.tracks, c.name) for c in Tracks.columns()} | {"target_id": names})
        whole = evaluate(ours.sorted(), case.truth, free.sorted(), case.place, EvaluateConfig(match="optimal")).metrics
        for name, table in (("tracks", ours), ("bearings", free), ("truth", case.truth)):
            write_table(tmp_path / f"{name}.parquet", table, Provenance("x"), overwrite=True)
        args = [f"--{name}={tmp_path / name}.parquet" for name in ("bearings", "truth")]
        args += [f"--scene={tmp_path / 'scene.yaml'}", "-o", str(tmp_path / f"{number}.json"), "--match", "optimal"]
        assert run(["evaluate", str(tmp_path / "tracks.parquet"), *args]) == ExitCode.DONE
        found += [whole, json.loads((tmp_path / f"{number}.json").read_text())]
    names_of = [name for name, value in found[0].items() if np.isfinite(value)]
    assert {"detected", "missed", "false_alarms", "bound_rmse_m"} <= set(names_of)
    for other in found[1:]:
        assert [other[name] for name in names_of] == pytest.approx([found[0][name] for name in names_of], rel=1e-9)
