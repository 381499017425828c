"""Names of files and folders whose bytes are not UTF-8, as other systems left them."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from places import ROOT

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.tables.parquet import read_table
from occlog.records.tables import Bearings

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
ODD = os.fsdecode(b"caf\xe9")
TWO = ("--cameras", "southwest,northeast")


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recording and its videos."""
    return Path(shutil.copytree(ROOT / "sample_data" / "room", tmp_path_factory.mktemp("odd") / ODD))


@pytest.fixture(scope="module")
def detected(room: Path) -> Path:
    """Bearings of that recording, next to it."""
    path = room / f"{ODD}.parquet"
    assert run(["detect", str(room / "recording.mcap"), "-o", str(path), "-q", *TWO]) == ExitCode.DONE
    return path


def test_videos_are_read_and_written_there(detected: Path, tmp_path: Path) -> None:
    known = ROOT / "sample_data" / "room" / "recording.mcap"
    assert run(["detect", str(known), "-o", str(tmp_path / "b.parquet"), "-q", *TWO]) == ExitCode.DONE
    found, wanted = (read_table(path, Bearings) for path in (detected, tmp_path / "b.parquet"))
    np.testing.assert_array_equal(found.bearing, wanted.bearing)
    (tmp_path / ODD).mkdir()
    made = tmp_path / ODD / "made.mcap"
    words = ["simulate", str(ROOT / "examples" / "room.yaml"), "--render", "--seconds", "0.2", "--store", "ffv1"]
    assert run([*words, "-o", str(made), "-q"]) == ExitCode.DONE
    assert run(["detect", str(made), "-o", str(tmp_path / "made.parquet"), "-q"]) == ExitCode.DONE


def test_pages_show_such_names(room: Path, detected: Path, tmp_path: Path) -> None:
    tracks, page = tmp_path / f"t{ODD}.parquet", tmp_path / f"{ODD}.html"
    scene = str(room / "recording.mcap")
    assert run(["track", str(detected), "--scene", scene, "-o", str(tracks), "-q"]) == ExitCode.DONE
    words = ["report", str(tracks), "--scene", scene, "-o", str(page), "--markdown", str(tmp_path / "m.md"), "-q"]
    assert run(words) == ExitCode.DONE
    assert r"caf\udce9.parquet" in page.read_text(encoding="utf-8")


def test_a_link_that_cannot_be_is_one_line(room: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    words = ["recover", str(room / "recording.mcap"), "-o", str(tmp_path / "r.mcap")]
    assert run(words) == ExitCode.BAD_INPUT
    assert "a recording cannot name this file; its name is not UTF-8; rename it" in capfd.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_networks_are_loaded(room: Path, tmp_path: Path) -> None:
    from small_networks import colour_network

    colour_network(tmp_path / "red.onnx", image=(1, 3, 64, 64)).rename(tmp_path / f"{ODD}.onnx")
    words = ["detect", str(room / "recording.mcap"), "--onnx", str(tmp_path / f"{ODD}.onnx"), "--head", "yolo", "-q"]
    assert run([*words, "-o", str(tmp_path / "v.parquet")]) == ExitCode.DONE


def test_arrow_of_others_is_read(tmp_path: Path) -> None:
    table = pa.table({"t_ns": [0, 1, 2], "target_id": [0, 0, 0], "x": [0.0, 1.0, 2.0], "y": [0.0, 1.0, 2.0]})
    with (tmp_path / f"{ODD}.arrow").open("wb") as file, pa.ipc.new_file(file, table.schema) as out:
        out.write_table(table)
    assert run(["export", str(tmp_path / f"{ODD}.arrow"), "-o", str(tmp_path / "t.csv")]) == ExitCode.DONE
    assert (tmp_path / "t.csv").read_text().count("\n") == 4
