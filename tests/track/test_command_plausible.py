"""Estimates that cannot be believed say so from the command line, and `--strict` makes that an exit code."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from occlog.array_types import Floats
from occlog.cli.main import run
from occlog.core.geometry.camera import planar_offsets, u_to_azimuth
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.records.tables import Bearings, Truth

SIZE = np.array([10.0, 8.0])
CORNERS = ((0, 0, 45), (10, 8, 225), (10, 0, 135), (0, 8, 315))
FOCAL, RATE, T = 150.0, 5.0, 70


def scene_text(read_px: float) -> str:
    head = ["occlog_scene: 1", "length_unit: m", "room: [[0, 0], [10, 0], [10, 8], [0, 8]]", "cameras:"]
    cameras = [
        f"- {{name: cam{n}, position: [{x}, {y}], yaw_deg: {yaw}, focal_px: {FOCAL}, fov_deg: 100, "
        f"noise: {{position: 0, yaw: 0, measurement_noise_px: {read_px}}}}}"
        for n, (x, y, yaw) in enumerate(CORNERS, start=1)
    ]
    return "\n".join([*head, *cameras]) + "\n"


def walks(people: int, seed: int) -> Floats:
    """(people, T, 2) places of people who walk between random points at 1 m/s."""
    rng = np.random.default_rng([seed, 5])
    out = np.empty((people, T, 2))
    for person in range(people):
        at, goal = rng.uniform(1.0, SIZE - 1.0), rng.uniform(1.0, SIZE - 1.0)
        for k in range(T):
            out[person, k] = at
            far = float(np.hypot(*(goal - at)))
            if far < 0.3:
                goal = rng.uniform(1.0, SIZE - 1.0)
                far = float(np.hypot(*(goal - at)))
            at = at + (goal - at) / far * min(1.0 / RATE, far)
    return out


class Files(NamedTuple):
    scene: Path
    bearings: Path
    truth: Path
    tracks: Path
    diagnostics: Path

    @property
    def track(self) -> list[str]:
        own = [str(self.bearings), "--scene", str(self.scene), "-o", str(self.tracks)]
        return ["track", *own, "--diagnostics", str(self.diagnostics), "--overwrite"]

    @property
    def evaluate(self) -> list[str]:
        compared = ["--truth", str(self.truth), "--bearings", str(self.bearings), "--scene", str(self.scene)]
        return ["evaluate", str(self.tracks), *compared, "--diagnostics", str(self.diagnostics)]


def record(
    folder: Path,
    *,
    people: int = 1,
    labelled: bool = True,
    stated_px: float = 2.0,
    true_px: float = 2.0,
    off_rad: float = 0.0,
    seed: int = 0,
) -> Files:
    """Bearings and truth of people in a room; `off_rad` turns the first camera without saying so."""
    rng, paths = np.random.default_rng(seed), walks(people, seed)
    scene = scene_from_yaml(scene_text(stated_px), "a room")
    t_ns = np.round(np.arange(T) / RATE * 1e9).astype(np.int64)
    tables = []
    for n, camera in enumerate(scene.cameras):
        for person in range(people):
            h, d = planar_offsets(paths[person], camera.ground, camera.yaw)
            z = FOCAL * h / np.maximum(d, 1e-3) + true_px * rng.standard_normal(T)
            seen = (d > 0.2) & (np.abs(h) < math.tan(math.radians(50)) * d) & (rng.random(T) < 0.9)
            columns = {
                "bearing": u_to_azimuth(-z, camera.yaw, FOCAL) + (off_rad if n == 0 else 0.0),
                "sigma": stated_px / (FOCAL * (1.0 + (z / FOCAL) ** 2)),
                "u_px": -(FOCAL * np.tan(np.arctan(z / FOCAL) + (off_rad if n == 0 else 0.0))),
                "sigma_px": np.full(T, stated_px),
            }
            table = Bearings.of(
                t_ns=t_ns,
                sensor=np.full(T, camera.name),
                target_id=np.full(T, person if labelled else -1, np.int32),
                seen=seen,
                score=np.full(T, np.nan),
                **{name: np.where(seen, values, np.nan) for name, values in columns.items()},
            )
            tables.append(table if labelled else table.take(seen))
    made = Provenance("test", {}, None, (), ())
    names = ("room.yaml", "bearings.parquet", "truth.parquet", "tracks.parquet", "diagnostics.parquet")
    files = Files(*(folder / name for name in names))
    files.scene.write_text(scene_text(stated_px))
    write_table(files.bearings, Bearings.merge(tables), made, length_unit="m")
    true = [
        Truth.of(
            t_ns=t_ns,
            target_id=np.full(T, person, np.int32),
            role=np.full(T, "target"),
            x=paths[person, :, 0],
            y=paths[person, :, 1],
            z=np.full(T, np.nan),
        )
        for person in range(people)
    ]
    write_table(files.truth, Truth.merge(true), made, length_unit="m")
    return files


class Told(NamedTuple):
    code: int
    warnings: dict[str, str]
    summary: dict[str, Any]


def report_of(capsys: pytest.CaptureFixture[str], args: list[str]) -> Told:
    capsys.readouterr()
    code = run([*args, "--json"])
    summary = json.loads(capsys.readouterr().out)
    assert summary["plausible"] is (not summary["warnings"])
    return Told(code, {w["id"]: w["message"] for w in summary["warnings"]}, summary)


METHODS = (["--method", "apf"], ["--method", "map"])


@pytest.mark.jit
@pytest.mark.parametrize("method", METHODS, ids=lambda m: m[-1])
def test_what_is_as_stated_is_plausible(method: list[str], tmp_path, capsys) -> None:
    files = record(tmp_path)
    assert report_of(capsys, [*files.track, *method, "--strict"])[:2] == (ExitCode.DONE, {})
    assert report_of(capsys, [*files.evaluate, "--strict"])[:2] == (ExitCode.DONE, {})


@pytest.mark.jit
@pytest.mark.parametrize("method", METHODS, ids=lambda m: m[-1])
def test_noise_that_is_stated_too_small_is_reported_with_its_factor(method: list[str], tmp_path, capsys) -> None:
    files = record(tmp_path, stated_px=1.0, true_px=2.5)
    for command in ([*files.track, *method], files.evaluate):
        found = report_of(capsys, command)
        assert found.code == ExitCode.DONE
        assert "nis-large" in found.warnings


@pytest.mark.jit
def test_noise_that_is_stated_too_large_is_a_note(tmp_path, capsys) -> None:
    files = record(tmp_path, stated_px=4.0, true_px=2.0)
    assert run([*files.track, "--strict"]) == ExitCode.DONE
    heard = capsys.readouterr()
    assert re.search(
        r"note: the stated standard deviations of the bearings are (1\.9|2\.0|2\.1) times too large", heard.err
    )
    assert re.search("^plausible: +yes$", heard.out, re.MULTILINE)


@pytest.mark.jit
def test_a_camera_that_is_turned_is_named(tmp_path, capsys) -> None:
    files = record(tmp_path, off_rad=0.2)
    found = report_of(capsys, [*files.track, "--method", "map"])
    assert any("cam1" in sentence for sentence in found.warnings.values())


@pytest.mark.jit
def test_too_few_particles_are_reported(tmp_path, capsys) -> None:
    files = record(tmp_path, stated_px=0.5, true_px=0.5)
    found = report_of(capsys, [*files.track, "--particles", "8"])
    assert "particles-depleted" in found.warnings


@pytest.mark.jit
def test_nearly_exact_bearings_are_right_or_stated_to_be_wrong(tmp_path, capsys) -> None:
    files = record(tmp_path, stated_px=1e-3, true_px=1e-3)
    found = report_of(capsys, files.track)
    rmse = report_of(capsys, files.evaluate).summary["rmse_m"]
    assert found.warnings or rmse < 0.01


@pytest.mark.jit
def test_a_crowd_offered_to_a_filter_of_one_target_is_reported(tmp_path, capsys) -> None:
    files = record(tmp_path, people=6, labelled=False)
    found = report_of(capsys, files.track)
    assert "several-targets" in found.warnings
    assert "several-targets" in report_of(capsys, files.evaluate).warnings


@pytest.mark.jit
def test_two_people_offered_to_a_filter_of_one_target_are_reported(tmp_path, capsys) -> None:
    assert "several-targets" in report_of(capsys, record(tmp_path, people=2, labelled=False).track).warnings


@pytest.mark.jit
def test_one_person_of_a_crowd_who_is_followed_from_a_given_start_is_reported_to_be_among_others(
    tmp_path, capsys
) -> None:
    files, (x, y) = record(tmp_path, people=6, labelled=False), walks(6, 0)[0, 0]
    assert "several-targets" in report_of(capsys, [*files.track, "--start", f"{x},{y},0.3"]).warnings


@pytest.mark.jit
def test_one_person_without_label_is_one_target(tmp_path, capsys) -> None:
    assert report_of(capsys, record(tmp_path, labelled=False).track).warnings == {}


@pytest.mark.jit
def test_the_truth_of_somebody_else_is_reported(tmp_path, capsys) -> None:
    files = record(tmp_path, people=2)
    assert run([*files.track, "--target", "0", "-q"]) == ExitCode.DONE
    other = tmp_path / "other.parquet"
    paths, t_ns = walks(2, 0), np.round(np.arange(T) / RATE * 1e9).astype(np.int64)
    columns = {"x": paths[1, :, 0], "y": paths[1, :, 1], "z": np.full(T, np.nan), "role": np.full(T, "target")}
    table = Truth.of(t_ns=t_ns, target_id=np.zeros(T, np.int32), **columns)
    write_table(other, table, Provenance("test", {}, None, (), ()), length_unit="m")
    found = report_of(capsys, files._replace(truth=other).evaluate)
    assert {"nees-large", "low-detection-rate"} <= set(found.warnings)


@pytest.mark.jit
def test_strict_writes_outputs_and_ends_with_six(tmp_path, capsys) -> None:
    files, page = record(tmp_path, stated_px=0.5, true_px=2.5), tmp_path / "page.html"
    assert run([*files.track, "-q"]) == ExitCode.DONE
    files.tracks.unlink()
    assert run([*files.track, "--strict", "-q"]) == ExitCode.THRESHOLD
    assert files.tracks.exists()
    metrics = tmp_path / "metrics.json"
    assert run([*files.evaluate, "-o", str(metrics), "--strict", "-q"]) == ExitCode.THRESHOLD
    assert json.loads(metrics.read_text())["plausible"] is False
    shown = ["--bearings", str(files.bearings), "--scene", str(files.scene), "--metrics", str(metrics)]
    assert run(["report", str(files.tracks), *shown, "-o", str(page)]) == ExitCode.DONE
    heard = capsys.readouterr()
    assert "occlog: warning: the bearings are" in heard.err
    assert "plausible: no (" in " ".join(heard.out.split())
    assert run(["report", str(files.tracks), *shown, "-o", str(page), "--overwrite", "--strict"]) == ExitCode.THRESHOLD
    assert "Not reliable as they are" in page.read_text()
    assert "<strong>nis-large</strong>" in page.read_text()
