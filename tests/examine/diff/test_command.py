"""`occlog diff` on files: exit codes, the first difference named, one-line errors."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.examine.diff.content import content
from occlog.examine.diff.result import DiffSettings, Tolerances
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.files.texts.documents import write_json
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.io.recording.writer import RecordingWriter
from occlog.records.tables import Bearings, Tracks, Truth

MADE = Provenance("test", {"option": 1}, seed=1)
OTHER = Provenance("test", {"option": 2}, seed=2)
SCENE = """
occlog_scene: 1
room: [[0, 0], [20, 0], [20, {depth}], [0, 20]]
cameras:
  - {{name: east, position: [0, 10], yaw_deg: 0, focal_px: 100, fov_deg: 90, noise: {{measurement_noise_px: 1}}}}
"""


def tracks(**changes: Any) -> Tracks:
    n = 50
    columns: dict[str, Any] = {"t_ns": np.arange(n) * 1000, "target_id": np.zeros(n, int)}
    columns |= {c.name: np.linspace(1, 2, n) for c in Tracks.columns() if c.kind == "f8"}
    columns["cov_xy"] = np.zeros(n)
    for name, (row, value) in changes.items():
        columns[name] = columns[name].copy()
        columns[name][row] = value
    return Tracks.of(**columns)


def bearings(angle: float) -> Bearings:
    one = np.ones(1)
    return Bearings.of(
        t_ns=np.zeros(1, int),
        sensor=["east"],
        target_id=[0],
        seen=[True],
        bearing=[angle],
        sigma=0.1 * one,
        u_px=one,
        sigma_px=one,
        score=one,
    )


def recording(
    path: Path, *, made: Provenance = MADE, depth: float = 20, pixel: int = 9, level: int = 1, x: float = 1.0
) -> None:
    """Two frames, a truth row at each."""
    scene = scene_from_yaml(SCENE.format(depth=depth), "scene")
    with RecordingWriter(path, scene, made) as out:
        for index in range(2):
            image = np.full((8, 8, 3), 100, np.uint8)
            image[3, 3] = pixel if index else 9
            data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, level])[1].tobytes()
            out.image("east", 1000 * index, index, data, "png")
        two = np.ones(2)
        out.table(Truth.of(t_ns=[0, 1000], target_id=[0, 0], role=["target"] * 2, x=[1.0, x], y=two, z=two))


@pytest.fixture
def folder(tmp_path: Path) -> tuple[Path, Path]:
    """Two equal run folders that were made in different ways."""
    for name, made in (("a", MADE), ("b", OTHER)):
        place = tmp_path / name
        place.mkdir()
        recording(place / "recording.mcap", made=made)
        write_table(place / "bearings.parquet", bearings(0.5), made)
        write_table(place / "tracks.parquet", tracks(), made)
        write_json(place / "metrics.json", {"rmse_m": 0.5, "_provenance": made.as_dict()})
        write_json(place / "run.json", {"stages": {"track": name}})
        (place / "notes.txt").write_text("one\ntwo\n")
        (place / "report.html").write_text(f"<!DOCTYPE html>\n<p>same</p><footer>\n{name}</footer>")
        (place / ".hidden").write_text(name)
    return tmp_path / "a", tmp_path / "b"


def diff(capsys: pytest.CaptureFixture[str], *args: object) -> tuple[int, str, str]:
    code = run(["diff", *(str(a) for a in args)])
    out, err = capsys.readouterr()
    return code, out, err


def test_exit_code_0_for_equal_tables_whatever_their_provenance(folder: tuple[Path, Path], capsys: Any) -> None:
    a, b = (place / "tracks.parquet" for place in folder)
    assert diff(capsys, a, b) == (ExitCode.DONE, "same       tracks.parquet (50 rows)\n", "")
    code, out, _ = diff(capsys, a, b, "--provenance")
    assert code == ExitCode.DIFFERENT
    assert "first   parameters.option is 1 in A, 2 in B" in out


def test_exit_code_5_names_the_first_difference(folder: tuple[Path, Path], capsys: Any) -> None:
    a, b = folder[0] / "tracks.parquet", folder[1] / "tracks.parquet"
    write_table(b, tracks(y=(7, 9.0), x=(30, 1.25)), OTHER, overwrite=True)
    code, out, err = diff(capsys, a, b)
    assert code == ExitCode.DIFFERENT
    assert err == ""
    lines = out.splitlines()
    assert lines[0] == "different  tracks.parquet: 50 and 50 rows, 50 in both"
    assert lines[1].startswith("    first   time 0.000007 s, target_id 0: y is 1.142857142857142")
    assert lines[1].endswith("in A, 9.0 in B (7.85714 m apart, limit 9e-09)")
    assert [line.split()[0] for line in lines[2:]] == ["x", "y"]
    assert "1 row differs, most by" in lines[2]


def test_json_output(folder: tuple[Path, Path], capsys: Any) -> None:
    a, b = folder[0] / "tracks.parquet", folder[1] / "tracks.parquet"
    write_table(b, tracks(y=(7, 9.0)), OTHER, overwrite=True)
    code, out, _ = diff(capsys, a, b, "--json")
    found = json.loads(out)
    assert code == ExitCode.DIFFERENT
    assert found["same"] is False
    assert found["first"]["column"] == "y"
    assert found["first"]["key"] == {"t_ns": 7000, "target_id": 0}
    assert found["parts"][0]["columns"]["y"]["rows"] == 1
    code, out, _ = diff(capsys, a, a, "--json")
    assert (code, json.loads(out)["same"], json.loads(out)["first"]) == (ExitCode.DONE, True, None)


@pytest.mark.parametrize(
    "options",
    [["--tol", "y=8"], ["--tol", "tracks.y=0:0.9"], ["--tol-unit", "m=8"], ["--atol", "8"], ["--rtol", "0.9"]],
)
def test_tolerances(folder: tuple[Path, Path], capsys: Any, options: list[str]) -> None:
    a, b = folder[0] / "tracks.parquet", folder[1] / "tracks.parquet"
    write_table(b, tracks(y=(7, 9.0)), OTHER, overwrite=True)
    assert diff(capsys, a, b)[0] == ExitCode.DIFFERENT
    assert diff(capsys, a, b, *options)[0] == ExitCode.DONE


def test_time_tolerance(folder: tuple[Path, Path], capsys: Any) -> None:
    a, b = folder[0] / "tracks.parquet", folder[1] / "tracks.parquet"
    write_table(b, tracks(t_ns=(7, 7040)), OTHER, overwrite=True)
    code, out, _ = diff(capsys, a, b)
    assert code == ExitCode.DIFFERENT
    assert "1 only in A, 1 only in B" in out
    assert "only in A: time 0.000007 s, target_id 0" in out
    assert diff(capsys, a, b, "--time-tol", "0.04us")[0] == ExitCode.DONE


def test_angles_are_wrapped(folder: tuple[Path, Path], capsys: Any) -> None:
    a, b = folder[0] / "bearings.parquet", folder[1] / "bearings.parquet"
    write_table(a, bearings(-np.pi), MADE, overwrite=True)
    write_table(b, bearings(np.nextafter(np.pi, 0)), MADE, overwrite=True)
    assert diff(capsys, a, b)[0] == ExitCode.DONE


def test_other_units_and_columns_are_reported_first(folder: tuple[Path, Path], capsys: Any) -> None:
    a, b = folder[0] / "tracks.parquet", folder[1] / "tracks.parquet"
    write_table(b, tracks(), OTHER, overwrite=True, length_unit="ft")
    code, out, _ = diff(capsys, a, b)
    assert code == ExitCode.DIFFERENT
    assert out.splitlines()[1:] == ["    schema  length unit: m in A, ft in B"]


@pytest.mark.parametrize(
    ("units", "options", "code"),
    [
        (("mm", "mm"), ["--tol-unit", "m=0.01"], ExitCode.DONE),
        (("mm", "mm"), ["--tol-unit", "m=0.006"], ExitCode.DIFFERENT),
        (("mm", "mm"), ["--tol-unit", "mm=8"], ExitCode.DONE),
        (("ft", "ft"), ["--tol-unit", "m=3"], ExitCode.DONE),
        (("ft", "ft"), ["--tol-unit", "m=2"], ExitCode.DIFFERENT),
        (("unit", "unit"), ["--tol-unit", "unit=8"], ExitCode.DONE),
        (("unit", "unit"), ["--tol-unit", "m=8"], ExitCode.DIFFERENT),
        (("mm", "ft"), ["--tol-unit", "m=8", "--tol-unit", "ft=8"], ExitCode.DIFFERENT),
    ],
)
def test_tolerances_of_lengths_are_in_the_unit_that_they_name(
    folder: tuple[Path, Path], capsys: Any, units: tuple[str, str], options: list[str], code: ExitCode
) -> None:
    """They were numbers in whatever unit the tables had, and differences were stated to be in m."""
    a, b = folder[0] / "tracks.parquet", folder[1] / "tracks.parquet"
    write_table(a, tracks(), OTHER, overwrite=True, length_unit=units[0])
    write_table(b, tracks(y=(0, 8.0)), OTHER, overwrite=True, length_unit=units[1])
    found, out, _ = diff(capsys, a, b, *options)
    assert found == code
    if code == ExitCode.DIFFERENT:
        assert f"(7{f' {units[0]}' if units[0] == units[1] else ''} apart, limit" in out


def test_folders_are_the_same_whatever_their_provenance(folder: tuple[Path, Path], capsys: Any) -> None:
    code, out, err = diff(capsys, *folder)
    assert (code, err) == (ExitCode.DONE, "")
    names = [line.split()[1].rstrip(":") for line in out.splitlines()[:-1]]
    assert names == [
        "recording.mcap",
        "recording.mcap",
        "recording.mcap",
        "bearings.parquet",
        "tracks.parquet",
        "metrics.json",
        "report.html",
        "notes.txt",
    ]
    assert out.splitlines()[-1] == "the same"


def test_the_earliest_stage_is_named_first(folder: tuple[Path, Path], capsys: Any) -> None:
    a, b = folder
    write_json(b / "metrics.json", {"rmse_m": 0.6}, overwrite=True)
    write_table(b / "tracks.parquet", tracks(y=(7, 9.0)), OTHER, overwrite=True)
    (b / "notes.txt").write_text("one\nthree\n")
    (b / "extra.csv").write_text("x\n")
    code, out, _ = diff(capsys, a, b)
    assert code == ExitCode.DIFFERENT
    assert out.splitlines()[-1] == "4 of 9 parts differ, first: tracks.parquet"
    assert "different  extra.csv: only in B" in out
    assert "first   byte 5, line 2: 'two' in A, 'three' in B" in out.replace("at byte", "byte")
    assert "rmse_m is 0.5 in A, 0.6 in B (0.1 apart" in out
    code, out, _ = diff(capsys, a, b, "--exclude", "*.parquet", "--exclude", "notes.txt", "--exclude", "extra*")
    assert out.splitlines()[-1] == "1 of 5 parts differ, first: metrics.json"
    assert diff(capsys, a, b, "--exclude", "*")[:2] == (ExitCode.DONE, "same: there is nothing to compare\n")


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ({"depth": 21}, "recording.mcap: files"),
        ({"pixel": 10}, "recording.mcap: frames"),
        ({"x": 1.5}, "recording.mcap: truth"),
    ],
)
def test_recordings(tmp_path: Path, capsys: Any, change: dict[str, Any], part: str) -> None:
    recording(tmp_path / "a.mcap")
    recording(tmp_path / "b.mcap", made=OTHER, **change)
    code, out, _ = diff(capsys, tmp_path / "a.mcap", tmp_path / "b.mcap", "--json")
    found = json.loads(out)
    assert code == ExitCode.DIFFERENT
    assert [p["name"] for p in found["parts"] if not p["same"]] == [part.replace("recording", "a")]


def test_frames_by_their_pixels(tmp_path: Path, capsys: Any) -> None:
    a, b = tmp_path / "a.mcap", tmp_path / "b.mcap"
    recording(a)
    recording(b, level=9)
    code, out, _ = diff(capsys, a, b)
    assert code == ExitCode.DIFFERENT
    assert "topic /camera/east/image: content is" in out
    assert diff(capsys, a, b, "--pixels")[0] == ExitCode.DONE
    recording(tmp_path / "c.mcap", level=9, pixel=10)
    code, out, _ = diff(capsys, a, tmp_path / "c.mcap", "--pixels")
    assert code == ExitCode.DIFFERENT
    assert "time 0.000001 s, topic east: content" in out


@pytest.mark.parametrize(
    ("args", "code", "expected"),
    [
        (["a/tracks.parquet", "a/none.parquet"], ExitCode.BAD_INPUT, "no such file"),
        (["a", "none"], ExitCode.BAD_INPUT, "no such"),
        (["a/tracks.parquet", "b"], ExitCode.USAGE, "is a folder"),
        (["a/tracks.parquet", "a/recording.mcap"], ExitCode.USAGE, "different kinds"),
        (["a/tracks.parquet", "a/bearings.parquet"], ExitCode.USAGE, "holds tracks"),
        (["a", "b", "--tol", "x"], ExitCode.USAGE, "expected NAME=ATOL"),
        (["a", "b", "--tol", "x=-1"], ExitCode.USAGE, "expected NAME=ATOL"),
        (["a", "b", "--tol-unit", "parsec=1"], ExitCode.USAGE, "no column has this unit"),
        (["a", "b", "--time-tol", "5"], ExitCode.USAGE, "expected a number with"),
        (["a", "b", "--rtol", "nan"], ExitCode.USAGE, "finite"),
        (
            ["a/tracks.parquet", "b/tracks.parquet", "--tol", "cov_x=1"],
            ExitCode.USAGE,
            "did you mean 'cov_x_vx' or 'cov_x_vy'?",
        ),
    ],
)
def test_wrong_usage_is_one_line(
    folder: tuple[Path, Path], capsys: Any, monkeypatch: Any, args: list[str], code: int, expected: str
) -> None:
    monkeypatch.chdir(folder[0].parent)
    found, out, err = diff(capsys, *args)
    assert found == code
    assert out == ""
    assert expected in err
    assert len([line for line in err.splitlines() if line.startswith("occlog: error")]) == 1
    assert "Traceback" not in err


@pytest.mark.parametrize("name", ["recording.mcap", "tracks.parquet", "metrics.json"])
def test_exit_code_4_for_damaged_files(folder: tuple[Path, Path], capsys: Any, name: str) -> None:
    a, b = folder
    data = (b / name).read_bytes()
    (b / name).write_bytes(data[: len(data) // 2])
    for pair in ((a / name, b / name), (a, b)):
        code, out, err = diff(capsys, *pair)
        assert (code, out) == (ExitCode.BAD_INPUT, "")
        assert name in err
        assert len(err.splitlines()) == 1


def test_tables_and_recordings_are_known_by_their_content(folder: tuple[Path, Path], capsys: Any) -> None:
    a, b = folder
    for name, parts in (("tracks.parquet", "50 rows"), ("recording.mcap", "frames")):
        shutil.copy(b / name, b / "renamed.txt")
        code, out, _ = diff(capsys, a / name, b / "renamed.txt")
        assert (code, parts in out) == (ExitCode.DONE, True)


def test_a_table_and_a_recording_are_of_different_kinds_whatever_their_names(
    folder: tuple[Path, Path], capsys: Any
) -> None:
    a, b = folder
    shutil.copy(b / "recording.mcap", b / "tracks.parquet")
    code, _, err = diff(capsys, a / "tracks.parquet", b / "tracks.parquet")
    assert (code, "different kinds" in err) == (ExitCode.USAGE, True)
    code, out, _ = diff(capsys, a, b)
    assert code == ExitCode.DIFFERENT
    assert "different  tracks.parquet" in out


def test_empty_files_are_compared_as_others(folder: tuple[Path, Path], capsys: Any) -> None:
    a, b = folder
    for place in folder:
        (place / "notes.txt").write_bytes(b"")
    assert diff(capsys, a / "notes.txt", b / "notes.txt")[0] == ExitCode.DONE
    (b / "notes.txt").write_bytes(b"x")
    assert diff(capsys, a / "notes.txt", b / "notes.txt")[0] == ExitCode.DIFFERENT
    (b / "tracks.parquet").write_bytes(b"")
    code, _, err = diff(capsys, a / "tracks.parquet", b / "tracks.parquet")
    assert (code, "tracks.parquet" in err) == (ExitCode.BAD_INPUT, True)


def test_pages_and_pictures_are_known_by_their_content(folder: tuple[Path, Path], capsys: Any) -> None:
    """What a report says of its making is left out of a page and of a picture, whatever their names."""
    a, b = folder
    for place, made in ((a, "one"), (b, "two")):
        (place / "page").write_text(f"<!doctype html><p>same</p><footer>{made}</footer>")
        (place / "text").write_text(f"no page <footer>{made}</footer>")
    assert diff(capsys, a / "page", b / "page")[0] == ExitCode.DONE
    assert diff(capsys, a / "text", b / "text")[0] == ExitCode.DIFFERENT


@pytest.mark.parametrize(("other", "code"), [("0.124", 0), ("0.125", 5), ("0.1234", 0), ("0.12", 0), ("1", 5)])
def test_numbers_of_pages_may_differ_by_one_unit_of_their_last_digit(
    folder: tuple[Path, Path], capsys: Any, other: str, code: int
) -> None:
    for place, number in ((folder[0], "0.123"), (folder[1], other)):
        (place / "page.html").write_text(f"<!doctype html><p>RMSE {number} m, 7 people</p>")
    assert diff(capsys, folder[0] / "page.html", folder[1] / "page.html")[0] == code


def test_copies_of_a_folder_are_the_same_with_provenance_too(folder: tuple[Path, Path], capsys: Any) -> None:
    shutil.copytree(folder[0], folder[0].parent / "c")
    code, out, _ = diff(capsys, folder[0], folder[0].parent / "c", "--provenance")
    assert code == ExitCode.DONE
    assert "run.json" in out


def test_help_ends_in_an_example(capsys: Any) -> None:
    code, out, _ = diff(capsys, "--help")
    assert code == ExitCode.DONE
    assert "occlog diff a/tracks.parquet b/tracks.parquet" in out


def test_footers_without_an_end_stay(tmp_path: Path) -> None:
    """Each end is looked for once: 100,000 of them took minutes."""
    path = tmp_path / "page.html"
    path.write_text("<html>a<footer>1</footer>b<footer><footer>2</footer>c" + "<footer>" * 100_000)
    found = content(path, DiffSettings(Tolerances()))
    assert found == b"<html>abc" + b"<footer>" * 100_000
