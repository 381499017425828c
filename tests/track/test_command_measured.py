"""`occlog track` with ranges, signal strengths and time differences, as a user gives them: text tables."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

import occlog
from occlog.api.results import OcclogWarning
from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.tables.parquet import read_provenance, read_table
from occlog.io.open import open_input
from occlog.records.declared.sensors import Measurements
from occlog.records.tables import Diagnostics, Residuals, Tracks

PLACES = {"a": (0.0, 0.0), "b": (10.0, 0.0), "c": (0.0, 8.0), "d": (10.0, 8.0)}
TIMES = np.arange(0, 6, 0.2)
PER_TIME = {"tdoa": 3}
"""Measurements at each time, where these are not 4."""


def walked() -> np.ndarray:
    return np.column_stack([5 + 3 * np.cos(0.2 * TIMES), 4 + 2 * np.sin(0.2 * TIMES)])


def files(folder: Path) -> None:
    """Stations, and a log of each kind with noise of 0.1 m, or of 3 dB."""
    own = np.random.default_rng(1)
    rng, paths = np.random.default_rng(0), {name: [] for name in ("ranges", "rssi", "tdoa", "radar", "bearings")}
    for t, xy in zip(TIMES.tolist(), walked(), strict=True):
        far = {name: float(np.hypot(*(xy - position))) for name, position in PLACES.items()}
        for name, d in far.items():
            paths["ranges"].append(f"{t},{name},{d + 0.1 * rng.standard_normal():.6f},0.1")
            paths["rssi"].append(f"{t},{name},{-60 - 20 * np.log10(d) + 3 * rng.standard_normal():.3f}")
            if name != "a":
                late = (d - far["a"] + 0.1 * rng.standard_normal()) / 343.0
                paths["tdoa"].append(f"{t},{name},a,{late * 1e6:.3f},{0.1 / 343.0 * 1e6:.3f}")
        for name in ("a", "d"):
            away, noise = xy - np.array(PLACES[name]), own.standard_normal(2)
            angle = np.degrees(np.arctan2(away[1], away[0])) + noise[1]
            paths["radar"].append(f"{t},{name},{far[name] + 0.1 * noise[0]:.6f},0.1,{angle:.6f},1")
        turn = np.degrees(np.arctan2(xy[1], xy[0])) + 0.5 * rng.standard_normal()
        paths["bearings"].append(f"{t},a,{turn:.4f},0.5,0")
    heads = {
        "ranges": "time,anchor,range_m,sigma_range_m",
        "rssi": "time,anchor,rssi_dbm",
        "tdoa": "time,anchor,reference,tdoa_us,sigma_tdoa_us",
        "radar": "time,station,range_m,sigma_range_m,bearing_deg,sigma_bearing_deg",
        "bearings": "time,station,bearing_deg,sigma_deg,id",
    }
    for name, lines in paths.items():
        (folder / f"{name}.csv").write_text("\n".join([heads[name], *lines]) + "\n")
    places = [f"{name},{x},{y}" for name, (x, y) in PLACES.items()]
    (folder / "stations.csv").write_text("\n".join(["name,x,y", *places]) + "\n")


def track(folder: Path, log: str, method: str, *more: str) -> ExitCode:
    scene = ["--scene", str(folder / "stations.csv")] if "--scene" not in more else []
    out = ["-o", str(folder / "t.parquet"), "--overwrite", "-q"]
    return run(["track", str(folder / f"{log}.csv"), *scene, "--method", method, *out, *more])


def off(folder: Path) -> np.ndarray:
    """Distances of the track from the truth at its times."""
    found = read_table(folder / "t.parquet", Tracks)
    row = np.searchsorted(np.round(TIMES * 1e9).astype(np.int64), found.t_ns)
    return np.hypot(*(np.column_stack([found.x, found.y]) - walked()[row]).T)


def truth_of(folder: Path) -> str:
    """The true path as a text table."""
    rows = [f"{t},{x},{y}" for t, (x, y) in zip(TIMES.tolist(), walked().tolist(), strict=True)]
    (folder / "truth.csv").write_text("\n".join(["t,x,y", *rows]) + "\n")
    return str(folder / "truth.csv")


@pytest.mark.jit
@pytest.mark.parametrize("method", ["apf", "ekf", pytest.param("ukf", marks=pytest.mark.statistics)])
def test_bearings_with_ranges_are_smoothed(tmp_path: Path, method: str) -> None:
    files(tmp_path)
    errors = []
    for more in ([], ["--smooth"], ["--lag", "1"]):
        assert track(tmp_path, "radar", method, *more) == ExitCode.DONE
        errors.append(float(np.sqrt(np.mean(off(tmp_path) ** 2))))
    assert errors[1] < 0.9 * errors[0]
    assert errors[2] < errors[0]


@pytest.mark.parametrize(
    ("cells", "expected"),
    [(",,30,1", "without a range"), ("2,0.1,30,", "sigma_bearing"), ("2,0.1,30,-1", "above 0")],
)
def test_a_bearing_wants_a_range_and_a_standard_deviation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], cells: str, expected: str
) -> None:
    files(tmp_path)
    with (tmp_path / "radar.csv").open("a") as file:
        file.write(f"7,a,{cells}\n")
    assert track(tmp_path, "radar", "ekf") == ExitCode.BAD_INPUT
    assert expected in capsys.readouterr().err


@pytest.mark.jit
@pytest.mark.parametrize("method", ["fix", "apf", "map", "ekf", "ukf"])
@pytest.mark.parametrize(
    ("log", "more", "most"),
    [
        ("ranges", [], 0.15),
        ("tdoa", ["--propagation-speed", "sound"], 0.15),
        ("rssi", ["--sigma-rssi", "3"], 4.0),
        ("radar", [], 0.15),
    ],
)
def test_a_log_of_five_columns_becomes_a_track(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], method: str, log: str, more: list[str], most: float
) -> None:
    files(tmp_path)
    reported = ["--residuals", str(tmp_path / "r.parquet"), "--json"]
    assert track(tmp_path, log, method, *more, *reported) == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    assert "bearings" not in summary
    assert summary["measurements"] == len(TIMES) * PER_TIME.get(log, 4)
    assert len(off(tmp_path)) == len(TIMES)
    assert np.sqrt(np.mean(off(tmp_path)[5:] ** 2)) < most
    residuals = read_table(tmp_path / "r.parquet", Residuals)
    assert len(residuals) == len(TIMES) * PER_TIME.get(log, 4)
    assert np.mean(residuals.inlier_probability > 0.5) > 0.95
    assert np.all(np.diff(residuals.t_ns) >= 0)
    assert read_provenance(tmp_path / "t.parquet").parameters["measurements"]["propagation_speed"] == (
        "sound" if log == "tdoa" else None
    )
    if method != "ekf":
        return  # the bound is that of any method
    compare = ["evaluate", str(tmp_path / "t.parquet"), "--truth", truth_of(tmp_path), "-q"]
    compare += ["--scene", str(tmp_path / "stations.csv"), "--measurements", str(tmp_path / f"{log}.csv")]
    assert run([*compare, "-o", str(tmp_path / "m.json")]) == ExitCode.DONE
    metrics = json.loads((tmp_path / "m.json").read_text())
    assert 0.0 < metrics["bound_rmse_m"] < most
    given = {"scene": tmp_path / "stations.csv", "measurements": tmp_path / f"{log}.csv"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OcclogWarning)  # the verdict of the track, which is carried on
        same = occlog.evaluate(tmp_path / "t.parquet", truth_of(tmp_path), **given)
    assert same["bound_rmse_m"] == metrics["bound_rmse_m"]


@pytest.mark.jit
@pytest.mark.parametrize("method", ["fix", "apf", "map", "ekf", "ukf"])
def test_bearings_and_ranges_of_one_station_are_a_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], method: str
) -> None:
    files(tmp_path)
    more = ["--measurements", str(tmp_path / "ranges.csv"), "--cameras", "a"]
    assert track(tmp_path, "bearings", method, *more) == ExitCode.DONE
    assert np.sqrt(np.mean(off(tmp_path)[5:] ** 2)) < 0.2
    if method != "ekf":
        return
    # The bound says that it lacks the ranges where they are not given
    compare = ["evaluate", str(tmp_path / "t.parquet"), "--truth", truth_of(tmp_path)]
    compare += ["--scene", str(tmp_path / "stations.csv"), "--bearings", str(tmp_path / "bearings.csv")]
    for more, text in (([], True), (["--measurements", str(tmp_path / "ranges.csv")], False)):
        assert run([*compare, *more]) == ExitCode.DONE
        assert ("the bound knows nothing of the ranges" in capsys.readouterr().err) == text


def test_two_ranges_are_flagged_as_ambiguous(tmp_path: Path) -> None:
    files(tmp_path)
    text = ["--without", "a,b", "--diagnostics", str(tmp_path / "d.parquet"), "--overwrite"]
    assert track(tmp_path, "ranges", "fix", *text) == ExitCode.DONE
    assert set(read_table(tmp_path / "d.parquet", Diagnostics).fallback.tolist()) == {"ambiguous"}


@pytest.mark.parametrize(
    ("log", "method", "more", "message"),
    [
        ("tdoa", "fix", [], "require the speed of propagation"),
        (
            "tdoa",
            "fix",
            ["--propagation-speed", "warp"],
            "--propagation-speed warp: must be sound, light, or a number above 0",
        ),
        ("ranges", "iekf", [], "use method apf, ekf, fix, map or ukf"),
        ("ranges", "fix", ["--set", "estimator=huber"], "huber takes bearings alone"),
        ("ranges", "apf", ["--select", "greedy"], "leave select or the measurements out"),
        ("bearings", "fix", ["--tag-height", "1"], "--tag-height goes with ranges"),
        ("ranges", "map", ["--set", "solver=clarabel"], "solver clarabel takes bearings alone"),
        ("ranges", "map", ["--occluders", "OCCLUDERS"], "do not go together"),
        ("ranges", "fix", ["--without", "e"], "no sensor 'e'"),
        ("ranges", "fix", ["--nlos-probability", "1"], "'--nlos-probability': 1.0 is not in the range"),
        ("bearings", "fix", ["--nlos-bias", "2"], "--nlos-bias goes with ranges"),
    ],
)
def test_what_cannot_be_says_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], log: str, method: str, more: list[str], message: str
) -> None:
    files(tmp_path)
    (tmp_path / "occluders.csv").write_text("t,id,x,y,cov_xx,cov_xy,cov_yy\n0,1,5,4,0.1,0,0.1\n")
    more = [text.replace("OCCLUDERS", str(tmp_path / "occluders.csv")) for text in more]
    assert track(tmp_path, log, method, *more) in (ExitCode.USAGE, ExitCode.BAD_INPUT)
    stderr = capsys.readouterr().err
    assert message in stderr
    assert "Traceback" not in stderr


@pytest.mark.parametrize(
    ("head", "line", "more", "message"),
    [
        (
            "range_m,sigma_range_m",
            "{t},{s},-3.0,0.1",
            [],
            "standard deviations below 0; name a column of range differences",
        ),
        ("range_m,sigma_range_m", "{t},{s},5.0,0.1\n{t},{s},5.0,0.1", [], "is a duplicate"),
        ("rssi_dbm", "{t},{s},70", [], "above the limit of 20 dBm; add missing minus signs"),
        (
            "reference,tdoa_us",
            "{t},{s},d,9000",
            ["--propagation-speed", "light"],
            "exceed the distance of their stations",
        ),
    ],
)
def test_measurements_that_cannot_be_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], head: str, line: str, more: list[str], message: str
) -> None:
    files(tmp_path)
    rows = [line.format(t=t, s=s) for t in range(6) for s in "abc"]
    (tmp_path / "wrong.csv").write_text("\n".join([f"time,sensor,{head}", *rows]) + "\n")
    assert track(tmp_path, "wrong", "fix", "--sigma-range-difference", "0.1", *more) == ExitCode.BAD_INPUT
    assert message in capsys.readouterr().err


def test_a_range_log_with_heights_wants_that_of_the_tag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files(tmp_path)
    (tmp_path / "high.csv").write_text("name,x,y,z\na,0,0,2\nb,10,0,2\nc,0,8,2\nd,10,8,2\n")
    high = ["--scene", str(tmp_path / "high.csv")]
    assert track(tmp_path, "ranges", "fix", *high) == ExitCode.BAD_INPUT
    assert "state the height of the targets" in capsys.readouterr().err
    assert track(tmp_path, "ranges", "fix", *high, "--tag-height", "2") == ExitCode.DONE


def test_columns_of_a_range_log_in_several_units(tmp_path: Path) -> None:
    path = tmp_path / "plaza.csv"
    path.write_text("time,tag,node,range_cm\n10.5,3,a,250\n10.0,3,b,125.5\n")
    found = open_input(path)
    assert found.table == "measurements"
    assert found.length_unit == "cm"
    rows = found.read(Measurements)
    assert rows.range.tolist() == [125.5, 250.0]
    assert rows.target_id.tolist() == [3, 3]
    path.write_text("t_ns,sensor,ref,tdoa_ns,tdoa_std_ns\n0,a,b,20,5\n")
    rows = open_input(path).read(Measurements)
    np.testing.assert_allclose([rows.tdoa[0], rows.sigma_tdoa[0]], [20e-9, 5e-9])
    path.write_text("t,sensor,ref,tdoa_m\n0,a,b,-1.5\n")
    assert open_input(path).read(Measurements).range_difference.tolist() == [-1.5]


@pytest.mark.parametrize(
    ("head", "message"),
    [("time,sensor,ref,tdoa", "does not state its unit"), ("time,sensor,x", "requires")],
)
def test_columns_that_say_too_little_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], head: str, message: str
) -> None:
    (tmp_path / "m.csv").write_text(f"{head}\n0,a,1{',1' if 'ref' in head else ''}\n")
    (tmp_path / "stations.csv").write_text("name,x,y\na,0,0\nb,1,0\n")
    assert track(tmp_path, "m", "fix") == ExitCode.BAD_INPUT
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("method", "message"), [("apf", "and use method jipda"), ("jipda", "or a calibration to ingest\n")]
)
def test_advice_on_boxes_without_a_calibration_leads_to_a_calibration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], method: str, message: str
) -> None:
    (tmp_path / "det.txt").write_text("".join(f"{n},1,{10 * n},20,30,80,0.9,-1,-1,-1\n" for n in range(1, 6)))
    walk = str(tmp_path / "walk.mcap")
    given = ["--boxes", f"cam1={tmp_path / 'det.txt'}", "--fps", "25", "--allow-uncalibrated", "-q"]
    assert run(["ingest", "-o", walk, *given]) == ExitCode.DONE
    assert run(["detect", walk, "-o", str(tmp_path / "b.parquet")]) == ExitCode.DONE
    assert "no camera has a pose in space" in capsys.readouterr().err
    assert run(["track", walk, "--method", method, "-o", str(tmp_path / "t.parquet")]) == ExitCode.BAD_INPUT
    stderr = capsys.readouterr().err
    assert message in stderr
    assert "bmct" not in stderr
