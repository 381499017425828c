"""`occlog report` on files: page and picture, subsets of inputs, exit codes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.files.texts.documents import write_json
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.io.recording.writer import RecordingWriter
from occlog.records.losses import Loss
from occlog.records.tables import Bearings, Tracks, Truth
from occlog.report.request import PageRequest
from occlog.report.run import read_input

SCENE = """
occlog_scene: 1
room: [[0, 0], [20, 0], [20, 20], [0, 20]]
cameras:
  - {name: east, position: [0, 10], yaw_deg: 0, focal_px: 100, fov_deg: 90, noise: {measurement_noise_px: 1}}
  - {name: north, position: [10, 0], yaw_deg: 90, focal_px: 100, fov_deg: 90, noise: {measurement_noise_px: 1}}
"""
LOSS = Loss("east", "frame 7", "cut short", 3)
T = np.arange(5) * 10**9


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A run folder with what a run of two cameras leaves."""
    five, nan = np.full(5, 10.0), np.full(5, np.nan)
    truth = Truth.of(t_ns=T, target_id=[0] * 5, role=["target"] * 5, x=five, y=five, z=nan)
    tracks = Tracks.of(
        t_ns=T, target_id=[0] * 5, x=five + 0.5, y=five, vx=nan, vy=nan, cov_xx=five, cov_xy=0 * five, cov_yy=five
    )
    sensor = np.tile(["east", "north"], 5)
    ten = np.ones(10)
    bearings = Bearings.of(
        t_ns=np.repeat(T, 2),
        sensor=sensor,
        target_id=np.zeros(10, int),
        seen=ten > 0,
        bearing=np.where(sensor == "east", 0.0, np.pi / 2),
        sigma=0.01 * ten,
        u_px=ten,
        sigma_px=ten,
        score=ten,
    )
    run_folder = tmp_path / "run"
    run_folder.mkdir()
    made = Provenance("track", {"particles": 1234}, 7, (), (LOSS,))
    with RecordingWriter(run_folder / "recording.mcap", scene_from_yaml(SCENE, "scene"), Provenance("ingest")) as out:
        out.table(truth)
    write_table(run_folder / "tracks.parquet", tracks, made)
    write_table(run_folder / "bearings.parquet", bearings, made)
    write_json(run_folder / "metrics.json", {"rmse_m": 0.5})
    (tmp_path / "scene.yaml").write_text(SCENE)
    return run_folder


def report(*args: object) -> int:
    return run(["report", *(str(a) for a in args)])


@pytest.mark.drawn
def test_a_run_folder_to_page_and_picture(folder: Path, capsys: Any) -> None:
    page, png = folder.parent / "report.html", folder.parent / "report.png"
    assert report(folder, "-o", page, "--png", png, "--title", "A & B") == ExitCode.DONE
    out, err = capsys.readouterr()
    assert "lost earlier: east: frame 7: cut short (3 lost)" in err
    assert "tracks 5" in out
    text = page.read_text()
    assert "<title>A &amp; B</title>" in text
    assert "&#34;particles&#34;: 1234" in text
    assert "cut short" in text
    assert str(folder) not in text
    assert png.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    again = folder.parent / "again.html"
    assert report(folder, "-o", again, "--title", "A & B", "--quiet") == ExitCode.DONE
    assert again.read_bytes() == page.read_bytes()


def test_json_summary(folder: Path, capsys: Any) -> None:
    page = folder.parent / "report.html"
    args = (folder / "tracks.parquet", "--bearings", folder / "bearings.parquet", "--scene", folder / "recording.mcap")
    assert report(*args, "-o", page, "--json", "-q") == ExitCode.DONE
    out, err = capsys.readouterr()
    assert err == ""
    verdict = {"plausible": None, "warnings": []}
    result = json.loads(out)
    assert [loss["count"] for loss in result.pop("lost_earlier")] == [3]
    assert result == {"page": str(page), "targets": 1, "rows": {"tracks": 5, "bearings": 10}, **verdict, "losses": []}
    assert "Track and lines of sight" in page.read_text()


def test_bearings_of_sensors_that_the_scene_lacks_are_reported(folder: Path, capsys: Any) -> None:
    """They stood in a table of the page alone."""
    (folder / "scene.yaml").write_text(SCENE.replace("north", "south"))
    args = ["report", str(folder), "--scene", str(folder / "scene.yaml"), "-o", str(folder / "r.html"), "--json"]
    assert run(args) == ExitCode.DONE
    captured = capsys.readouterr()
    assert "warning: bearings of 'north', not in the scene, are counted and not drawn; give the scene" in captured.err
    assert json.loads(captured.out)["unknown_sensors"] == ["north"]


def test_a_scene_alone(folder: Path) -> None:
    page = folder.parent / "report.html"
    assert report("--scene", folder.parent / "scene.yaml", "-o", page) == ExitCode.DONE
    assert "Floor plan" in page.read_text()


def test_outputs_are_not_overwritten_unless_asked(folder: Path, capsys: Any) -> None:
    page = folder.parent / "report.html"
    page.write_text("mine")
    args = ("--scene", folder.parent / "scene.yaml", "-o", page)
    assert report(*args) == ExitCode.EXISTS
    assert page.read_text() == "mine"
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert report(*args, "--overwrite") == ExitCode.DONE
    assert "Floor plan" in page.read_text()


@pytest.mark.parametrize(
    ("args", "code", "expected"),
    [
        ([], ExitCode.USAGE, "nothing to show"),
        (["none.parquet"], ExitCode.BAD_INPUT, "no such file"),
        (["run/bearings.parquet"], ExitCode.BAD_INPUT, "expected tracks"),
        ([".", "--title", "x"], ExitCode.BAD_INPUT, "holds no tracks.parquet"),
        (
            ["run/tracks.parquet", "--scene", "feet.yaml"],
            ExitCode.BAD_INPUT,
            "lengths are in m, but in ft in the scene",
        ),
        (["run/tracks.parquet", "--metrics", "scene.yaml"], ExitCode.BAD_INPUT, "not valid JSON"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    folder: Path, capsys: Any, monkeypatch: Any, args: list[str], code: int, expected: str
) -> None:
    monkeypatch.chdir(folder.parent)
    Path("feet.yaml").write_text(f"length_unit: ft{SCENE}")
    assert report(*args, "-o", "report.html", "--png", "report.png") == code
    err = capsys.readouterr().err
    assert expected in err
    assert "Traceback" not in err
    assert not list(Path().glob("report.*"))


def in_csv(path: Path, tracks: Tracks, unit: str, scale: float) -> Path:
    """Tracks of another program, whose lengths are in a unit."""
    rows = zip(tracks.t_ns, tracks.target_id, scale * tracks.x, scale * tracks.y, strict=True)
    text = "".join(f"{t},{k},{float(x)!r},{float(y)!r}\n" for t, k, x, y in rows)
    path.write_text(f"t_ns,id,x{unit},y{unit}\n{text}")
    return path


@pytest.mark.parametrize(("unit", "scale"), [("_cm", 100.0), ("_mm", 1000.0), ("", 1.0)])
def test_tables_of_others_are_shown_in_the_unit_of_the_scene(folder: Path, unit: str, scale: float) -> None:
    tracks = in_csv(folder / "tracks.csv", read_table(folder / "tracks.parquet", Tracks), unit, scale)
    paths = PageRequest(output=folder / "page.html", tracks=tracks, scene=folder.parent / "scene.yaml")
    paths = replace(paths, truth=folder / "recording.mcap", bearings=folder / "bearings.parquet")
    data = read_input(paths)
    assert data.tracks is not None
    np.testing.assert_allclose(data.tracks.x, 10.5)
    assert (data.length_unit, data.unit) == ("m", "m")
