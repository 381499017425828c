"""`occlog plan` on files: map, picture, page, rankings; one line on bad input."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from places import EXAMPLES

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import describe, read_provenance, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.records.declared.world import PlanMap
from occlog.records.tables import Tracks

ROOM = EXAMPLES / "room.yaml"
QUICK = ("--cells", "30", "--samples-per-cell", "4", "--set", "settling_s=1", "-q")


def plan(scene: Path, *args: str) -> int:
    return run(["plan", str(scene), *QUICK, *args])


def scene_file(path: Path, text: str) -> Path:
    path.write_text("occlog_scene: 1\n" + text)
    return path


CAMERA = "{name: %s, position: [%g, %g, 1.2], yaw_deg: %g, focal_px: 142, image_size_px: [256, 128]}"


@pytest.mark.drawn
def test_all_outputs_of_one_call_agree(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    table, picture, page = (tmp_path / name for name in ("plan.parquet", "plan.svg", "plan.html"))
    code = plan(
        ROOM, "--people", "4", "--max-expected-error", "0.3", "--along-walls", "southwest",
        "--spacing", "6", "--add", "1",
        "--remove", "-o", str(table), "--picture", str(picture), "--report", str(page), "--json",
    )  # fmt: skip
    result = json.loads(capsys.readouterr().out)
    assert code == ExitCode.DONE
    rows = read_table(table, PlanMap)
    assert result["cells"] == len(rows)
    assert result["rmse_m"] == pytest.approx(float(np.sqrt(rows.weight @ rows.rmse**2)))
    assert result["share_within"] == pytest.approx(float(rows.weight[rows.rmse < 0.3].sum()))
    np.testing.assert_allclose(rows.seen_by_0 + rows.seen_by_1 + rows.seen_by_2, 1.0, atol=1e-12)
    errors = [row["rmse_m"] for row in result["candidates"]]
    assert errors == sorted(errors)
    assert errors[-1] <= result["rmse_m"]
    assert result["added"] == result["candidates"][:1]
    assert {row["name"] for row in result["without"]} == {"southwest", "southeast", "northeast", "northwest"}
    assert min(row["rmse_m"] for row in result["without"]) >= result["rmse_m"]
    assert read_provenance(table).parameters["people"] == 4
    assert picture.read_bytes().startswith(b"<?xml")
    text = page.read_text()
    assert "default-src 'none'" in text
    assert "<script" not in text
    assert "<image" not in text
    assert f"{result['rmse_m']:.3f}" in text
    assert result["added"][0]["name"] in text


def test_lengths_are_in_the_scenes_unit(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    text = ROOM.read_text()
    table = tmp_path / "feet.parquet"
    scene = tmp_path / "feet.yaml"
    scene.write_text(text.replace("length_unit: m", "length_unit: ft"))
    assert plan(scene, "-o", str(table), "--json") == ExitCode.DONE
    assert "rmse_ft" in json.loads(capsys.readouterr().out)
    assert describe(table)["length_unit"] == "ft"


def test_people_of_tracks_weigh_the_floor(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    zero = np.zeros(5)
    rows = Tracks.of(
        t_ns=np.arange(5), target_id=np.zeros(5, dtype=np.int32), x=zero + 1.0, y=zero + 1.0, vx=zero, vy=zero,
        cov_xx=zero, cov_xy=zero, cov_yy=zero,
    )  # fmt: skip
    tracks, table = tmp_path / "tracks.parquet", tmp_path / "plan.parquet"
    write_table(tracks, rows, Provenance("track"))
    assert plan(ROOM, "--paths", str(tracks), "-o", str(table), "--json") == ExitCode.DONE
    found = read_table(table, PlanMap)
    k = int(np.argmax(found.weight))
    assert found.weight[k] == 1.0
    assert np.hypot(found.x[k] - 1.0, found.y[k] - 1.0) < 1.0
    assert json.loads(capsys.readouterr().out)["rmse_m"] == pytest.approx(found.rmse[k])


def test_candidates_of_a_file_are_ranked_for_a_person(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = scene_file(
        tmp_path / "more.yaml", f"cameras: [{CAMERA % ('a', 4, 0.1, 90)}, {CAMERA % ('b', 0.2, 0.1, 37)}]\n"
    )
    assert plan(ROOM, "--candidates", str(file)) == ExitCode.DONE
    line = next(row for row in capsys.readouterr().out.splitlines() if row.startswith("candidates"))
    assert line.index("a 0.") < line.index("b 0.")


def test_a_blind_room_is_reported_to_be_blind(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    room = "room: [[0, 0], [20, 0], [20, 20], [0, 20]]\n"
    scene = scene_file(tmp_path / "blind.yaml", room + f"cameras: [{CAMERA % ('only', 0.1, 0.1, 45)}]\n")
    assert run(["plan", str(scene), *QUICK[:-1], "--json"]) == ExitCode.DONE
    out, err = capsys.readouterr()
    result = json.loads(out)
    assert result["unlocalised_share"] > 0.5
    assert "no sensor sees the target" in result["warnings"][0]
    assert result["warnings"][0] in err


@pytest.mark.parametrize(
    ("args", "code", "words"),
    [
        (["--add", "1"], ExitCode.USAGE, "--add adds candidates"),
        (["--spacing", "1"], ExitCode.USAGE, "--spacing is of positions along the walls"),
        (["--along-walls", "east"], ExitCode.BAD_INPUT, "no camera named 'east'"),
        (["--along-walls", "southwest", "--candidates", str(ROOM)], ExitCode.USAGE, "exclude each other"),
        (["--candidates", str(EXAMPLES / "people.yaml")], ExitCode.BAD_INPUT, "people.yaml"),
        (["--candidates", str(EXAMPLES / "room100.yaml")], ExitCode.BAD_INPUT, "use the same unit"),
        (["--picture", "map.gif"], ExitCode.USAGE, "the picture is PNG or SVG"),
        (["--report", "map.txt"], ExitCode.USAGE, "the report is HTML"),
        (["--people", "-1"], ExitCode.USAGE, "--people"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(
    args: list[str], code: ExitCode, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    output = tmp_path / "plan.parquet"
    assert plan(ROOM, "-o", str(output), *args) == code
    err = capsys.readouterr().err
    assert words in err
    assert err.count("\n") == 1
    assert not output.exists()


def test_a_candidate_may_not_be_a_sensor_of_the_scene(capsys: pytest.CaptureFixture[str]):
    assert plan(ROOM, "--candidates", str(ROOM)) in (ExitCode.BAD_INPUT, ExitCode.USAGE)
    assert "southwest is a sensor of the scene already" in capsys.readouterr().err


@pytest.mark.parametrize(("text", "words"), [("room: [[0, 0], [8, 0], [8, 6]]\n", "no camera"), ("", "no room")])
def test_scenes_without_sensors_or_room_are_refused(
    text: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    camera = "" if text else f"cameras: [{CAMERA % ('a', 4, 0.1, 90)}]\n"
    assert plan(scene_file(tmp_path / "scene.yaml", text + camera)) == ExitCode.BAD_INPUT
    assert words in capsys.readouterr().err
