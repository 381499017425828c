"""Units that are stated for columns whose names say none: which columns they are for, and what is refused."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode, UsageError
from occlog.io.files.input_units import stated_units
from occlog.io.files.provenance import Provenance, provenance_from_json
from occlog.io.open import open_input, scene_in
from occlog.records.tables import Bearings, Truth


@pytest.fixture
def bearings(tmp_path: Path) -> Path:
    path = tmp_path / "bearings.csv"
    path.write_text("time,sensor,azimuth,sigma_deg\n1500,a,2,1\n")
    return path


def test_a_unit_alone_is_for_all_columns_of_its_kind_that_say_none(bearings: Path) -> None:
    with stated_units(["rad", "ms"]) as stated:
        rows = open_input(bearings, Bearings).read(Bearings)
        assert stated.unused() == ()
    assert rows.t_ns.tolist() == [1_500_000_000]
    assert rows.bearing[0] == 2
    assert rows.sigma[0] == math.radians(1)


def test_a_column_is_stated_by_its_name(bearings: Path) -> None:
    with stated_units(["Azimuth=deg,time=us"]):
        rows = open_input(bearings, Bearings).read(Bearings)
        assert Provenance("test").input_units == ("azimuth=deg", "time=us")
        again = provenance_from_json(Provenance("test").json(), Path("t.parquet"))
    assert (rows.t_ns[0], rows.bearing[0]) == (1_500_000, math.radians(2))
    assert again.input_units == ("azimuth=deg", "time=us")
    assert "input_units" not in Provenance("test").as_dict()


def test_lengths_and_stations_are_converted(tmp_path: Path) -> None:
    truth, stations = tmp_path / "truth.csv", tmp_path / "stations.csv"
    truth.write_text("t_ns,id,x,y\n0,1,150,20\n")
    stations.write_text("name,x,y\na,0,250\n")
    with stated_units(["cm"]):
        opened = open_input(truth, Truth)
        opened.external_table.convert_to("m")  # type: ignore[union-attr]
        assert opened.read(Truth).x.tolist() == [1.5]
        scene = scene_in(stations)
    assert scene is not None
    assert (scene.length_unit, scene.arrays[0].position[1]) == ("cm", 250)


@pytest.mark.parametrize(
    ("units", "words"),
    [
        ("degs", "did you mean 'deg'?"),
        ("x=cm,x=m", "x is stated to be in cm and in m"),
        ("deg,rad", "angle is stated to be in deg and in rad"),
        ("a.csv:m,a.csv:mm", "a.csv:length is stated to be in m and in mm"),
    ],
)
def test_units_that_cannot_be_are_refused(units: str, words: str) -> None:
    with pytest.raises(UsageError, match=words.replace("?", r"\?")), stated_units([units]):
        pass


@pytest.mark.parametrize(
    ("units", "code", "words"),
    [
        ("sigma_deg=rad,azimuth=deg", ExitCode.USAGE, "column sigma_deg is in deg by its name"),
        (
            "azimuth=cm",
            ExitCode.BAD_INPUT,
            "column azimuth cannot be in cm, as --input-units states; units of angles are deg, rad",
        ),
        ("deg,azimut=deg", ExitCode.USAGE, "--input-units azimut=deg: no table that was read has such a column"),
        ("deg,cm", ExitCode.USAGE, "--input-units cm: no table"),
        ("deg,other.csv:cm", ExitCode.USAGE, "--input-units other.csv:cm: no table"),
    ],
)
def test_a_contradiction_and_a_unit_without_a_column_are_errors(
    bearings: Path, capsys: Any, units: str, code: int, words: str
) -> None:
    assert run(["info", str(bearings), "--input-units", units]) == code
    assert words in capsys.readouterr().err


def test_a_stated_unit_ends_with_its_command(bearings: Path, capsys: Any) -> None:
    assert run(["info", str(bearings), "--input-units", "deg", "--json"]) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["table"] == "bearings"
    assert run(["info", str(bearings)]) == ExitCode.BAD_INPUT


def test_units_of_one_file_leave_the_others(tmp_path: Path, capsys: Any) -> None:
    """R28: tracks in metres, the truth in millimetres, with one name of the column."""
    for name, factor in (("tracks.csv", 1.0), ("truth.csv", 1000.0)):
        rows = [f"{0.1 * k:.1f},1,{factor * (1 + k)},{factor * 2}" for k in range(5)]
        (tmp_path / name).write_text("\n".join(["time,id,x,y", *rows]) + "\n")
    command = ["evaluate", str(tmp_path / "tracks.csv"), "--truth", str(tmp_path / "truth.csv"), "--json"]
    for file in ("truth.csv", str(tmp_path / "truth.csv")):
        assert run([*command, "--input-units", f"{file}:mm"]) == ExitCode.DONE
        assert json.loads(capsys.readouterr().out)["rmse_m"] == pytest.approx(0.0, abs=1e-9)
    assert run([*command, "--input-units", "truth.csv:x=mm,truth.csv:y=mm"]) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["rmse_m"] == pytest.approx(0.0, abs=1e-9)
