"""The verdict of `track` in every later stage: three cameras, one turned by 6 degrees, without a truth and with it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import people_boxes as hall
import pyarrow.parquet as pq
import pytest
from msgspec.structs import replace as replace_struct

from occlog.cli.main import run
from occlog.core.geometry.camera import rotation_from_angles
from occlog.errors import ExitCode
from occlog.io.files.inputs import verdicts_of_file
from occlog.io.files.tables.parquet import read_provenance, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.models.schemas import verdict_schema
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.pipeline.batch import run as batch
from occlog.pipeline.executors.interface import InThisProcess
from occlog.records.tables import PeopleTracks
from occlog.records.verdicts import all_plausible, found_by_stage

SECONDS, CROOKED = 8.0, "b"
INGEST = "  boxes: {a: a.csv, b: b.csv, c: c.csv}\n  scene: scene.yaml\n  fps: 10\n"
STAGES = "occlog_run: 1\nseed: 1\ningest:\n%strack: {method: jipda}\n"

pytestmark = [pytest.mark.slow, pytest.mark.jit]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Boxes, scene and truth; the camera `CROOKED` stood 6 degrees further to the left than the scene says."""
    place, scene = tmp_path_factory.mktemp("crooked"), hall.hall()
    stood = tuple(
        replace(
            camera,
            rotation=rotation_from_angles(
                np.radians(hall.CORNERS[camera.name][2] + 6.0 * (camera.name == CROOKED)), np.radians(-20.0), 0.0
            ),
        )
        for camera in scene.cameras
    )
    boxes = hall.boxes(replace(scene, cameras=stood), SECONDS)
    for name in "abc":
        own = boxes.take((boxes.sensor == name) & (boxes.box >= 0))
        edges = np.column_stack([own.left_px, own.top_px, own.width_px, own.height_px]).round(2)
        rows = [f"{f},{','.join(map(str, e))},0.9" for f, e in zip(own.frame.tolist(), edges.tolist(), strict=True)]
        text = "\n".join(["frame,left_px,top_px,width_px,height_px,confidence", *rows])
        (place / f"{name}.csv").write_text(text + "\n")
    (place / "scene.yaml").write_text(scene_to_yaml(scene))
    times = [0.1 * k for k in range(round(10 * SECONDS))]
    walks = [(t, person, *hall.place(person, t)) for t in times for person in range(hall.PEOPLE)]
    (place / "truth.csv").write_text(
        "time,id,x,y\n" + "".join(f"{t:.1f},{k},{x:.4f},{y:.4f}\n" for t, k, x, y in walks)
    )
    (place / "plain.yaml").write_text(STAGES % INGEST + "report: {title: crooked}\n")
    (place / "truth.yaml").write_text(STAGES % (INGEST + "  truth: truth.csv\n") + "evaluate: {}\nreport: {title: c}\n")
    (place / "batch.yaml").write_text("occlog_run: 1\nseed: 1\ntrack: {method: jipda}\n")
    return place


@pytest.fixture(scope="module")
def done(folder: Path) -> Path:
    """The run without a truth."""
    assert run(["run", str(folder / "plain.yaml"), "-o", str(folder / "plain")]) == ExitCode.DONE
    return folder / "plain"


def leans(stages_and_checks: Any) -> list[tuple[str, tuple[str, ...]]]:
    return [(stage, check.sensors) for stage, check in stages_and_checks if check.id == "camera-rotated"]


def test_track_stores_what_it_checked_with_its_tracks(done: Path) -> None:
    *before, verdict = read_provenance(done / "tracks.parquet").judged
    assert all(each.plausible for each in before)
    assert (verdict.stage, verdict.plausible) == ("track", False)
    status = {check.name: check.status for check in verdict.checks}
    assert status["camera orientations"] == "failed"
    assert status["camera clocks"] == "passed"
    metadata = pq.read_metadata(done / "tracks.parquet").metadata
    jsonschema.validate(json.loads(metadata[b"occlog.provenance"])["verdicts"][-1], verdict_schema())


def test_a_strict_run_names_the_stage_the_finding_and_the_camera(done: Path, folder: Path, capsys: Any) -> None:
    args = ["run", str(folder / "plain.yaml"), "-o", str(done), "--strict"]
    assert run(args) == ExitCode.THRESHOLD
    captured = capsys.readouterr()
    assert f"plausible: no (track: camera-fits-if {CROOKED}, camera-rotated {CROOKED}" in " ".join(captured.out.split())
    assert f"warning: track: camera {CROOKED} is rotated " in captured.err
    assert run([*args, "--json"]) == ExitCode.THRESHOLD
    summary = json.loads(capsys.readouterr().out)
    warning = next(each for each in summary["warnings"] if each["id"] == "camera-rotated")
    assert (warning["stage"], warning["sensors"]) == ("track", [CROOKED])


def test_the_page_has_the_verdict_at_its_top_and_says_what_was_checked(done: Path) -> None:
    page = (done / "report.html").read_text()
    verdict = page[page.index('<section class="lost" aria-labelledby="verdict">') :]
    verdict = verdict[: verdict.index("</section>")]
    assert f"<strong>camera-rotated</strong> (track): camera {CROOKED} is rotated " in verdict
    assert "camera orientations" in verdict
    assert "particles" not in verdict, "what was not checked is not said to have been"
    assert page.index('id="verdict"') < page.index("<figure")


def test_with_a_truth_the_camera_is_named_too(folder: Path, capsys: Any) -> None:
    args = ["run", str(folder / "truth.yaml"), "-o", str(folder / "with"), "--strict"]
    assert run(args) == ExitCode.THRESHOLD
    parts = capsys.readouterr().err.split(f"warning: track: camera {CROOKED} is rotated ")
    assert len(parts) == 2
    assert "occlog: track ..." in parts[0]
    assert "occlog: evaluate ..." in parts[1]
    for name in ("tracks.parquet", "errors.parquet", "metrics.json"):
        assert ("track", (CROOKED,)) in leans(found_by_stage(verdicts_of_file(folder / "with" / name)))
    figures = json.loads((folder / "with/metrics.json").read_text())
    assert figures["plausible"] is False
    assert "camera-rotated" in {each["id"] for each in figures["warnings"]}


def test_a_batch_names_it_and_its_tables_carry_it(
    done: Path, folder: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch, "executor_of", lambda *_, **__: InThisProcess())
    out = folder / "all"
    args = ["batch", str(folder / "batch.yaml"), str(done / "recording.mcap"), "-o", str(out), "--tables", "tracks"]
    assert run([*args, "--strict"]) == ExitCode.THRESHOLD
    captured = capsys.readouterr()
    assert "not plausible: 1" in " ".join(captured.out.split())
    assert f"plausible: no (track: camera-fits-if {CROOKED}, camera-rotated {CROOKED}" in captured.err
    (row,) = pq.read_table(out / "runs.parquet").to_pylist()
    assert row["plausible"] is False
    assert any(text.startswith(f"track: camera-rotated: camera {CROOKED} is rotated ") for text in row["warnings"])
    assert all_plausible(verdicts_of_file(out / "tracks.parquet")) is False
    assert all_plausible(verdicts_of_file(out / "runs.parquet")) is False


def test_info_says_that_tracks_are_not_plausible(done: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert run(["info", str(done / "tracks.parquet")]) == ExitCode.DONE
    stdout = capfd.readouterr().out
    assert "plausible no (track: camera-fits-if b, camera-rotated b" in stdout
    assert "warning: track: " in stdout


def test_stages_before_track_store_what_they_checked(
    done: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    recording, bearings, fused = done / "recording.mcap", tmp_path / "bearings.parquet", tmp_path / "fused.parquet"
    assert run(["detect", str(recording), "-o", str(bearings), "-q"]) == ExitCode.DONE
    assert run(["fuse", str(bearings), "--scene", str(recording), "-o", str(fused), "-q"]) == ExitCode.DONE
    assert [verdict.stage for verdict in verdicts_of_file(fused)] == ["ingest", "detect", "fuse"]
    assert run(["info", str(fused)]) == ExitCode.DONE
    stdout = capfd.readouterr().out
    assert "checked   detect: 5 passed" in stdout
    assert "checked   fuse: 0 passed, 1 not applicable" in stdout


def test_a_strict_run_ends_with_6_where_ingest_finds_a_sensor_of_another_time(
    folder: Path, tmp_path: Path, capsys: Any
) -> None:
    late = INGEST.replace("fps: 10", "fps: 10\n  start_time: [c=86400]").replace(": {a: a", f": {{a: {folder}/a")
    late = late.replace(" b.csv", f" {folder}/b.csv").replace(" c.csv", f" {folder}/c.csv")
    late = late.replace("scene.yaml", f"{folder}/scene.yaml")
    (tmp_path / "late.yaml").write_text(f"occlog_run: 1\nseed: 1\ningest:\n{late}detect: {{}}\n")
    args = ["run", str(tmp_path / "late.yaml"), "-o", str(tmp_path / "late"), "--strict"]
    assert run(args) == ExitCode.THRESHOLD
    assert "plausible: no (ingest: sensor-times-disjoint c; " in " ".join(capsys.readouterr().out.split())


def test_diff_and_export_say_that_tracks_are_not_plausible(done: Path, tmp_path: Path, capsys: Any) -> None:
    tracks, other = done / "tracks.parquet", tmp_path / "tracks.parquet"
    made = read_provenance(tracks)
    good = tuple(replace_struct(verdict, plausible=True, checks=()) for verdict in made.judged)
    write_table(other, read_table(tracks, PeopleTracks), replace(made, verdicts=good))
    assert run(["diff", str(tracks), str(other)]) == ExitCode.DIFFERENT
    stdout = capsys.readouterr().out
    assert "different  tracks.parquet: verdict" in stdout
    assert f"camera-rotated {CROOKED}' in A, '' in B" in stdout
    for name in ("tracks.csv", "view.mcap"):
        assert run(["export", str(tracks), "-o", str(tmp_path / name)]) == ExitCode.DONE
        assert f"warning: track: camera {CROOKED} is rotated " in capsys.readouterr().err


def test_compare_says_of_which_method_the_tracks_are_not_plausible(
    folder: Path, done: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    methods = [str(done / "tracks.parquet"), str(done / "tracks.parquet")]
    words = ["compare", *methods, "--truth", str(folder / "truth.csv"), "--metric", "idf1", "--markdown"]
    assert run([*words, str(tmp_path / "c.md"), "--json"]) == ExitCode.DONE
    found = json.loads(capfd.readouterr().out)["implausible"]
    assert [each["method"] for each in found] == methods
    assert all(any("camera b " in text for text in each["warnings"]) for each in found)
    assert (tmp_path / "c.md").read_text().count("**Not plausible**") == 2
