"""`occlog diff` of tables that other programs made, with ours and with one another."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.records.declared.tracks import FusedTracks
from occlog.records.tables import Calibration, Truth

ROWS = "1000,0,1.25,2\n2000,0,1.5,2\n"


@pytest.fixture
def ours(tmp_path: Path) -> Path:
    rows = Truth.of(t_ns=[1000, 2000], target_id=[0, 0], x=[1.25, 1.5], y=[2.0, 2.0], z=[0, 0], role=["target"] * 2)
    write_table(tmp_path / "ours.parquet", rows, Provenance("test"))
    return tmp_path / "ours.parquet"


def text(path: Path, header: str, rows: str) -> str:
    path.write_text(f"{header}\n{rows}")
    return str(path)


def test_an_export_is_the_same(ours: Path, tmp_path: Path, capsys: Any) -> None:
    exported = tmp_path / "truth.csv"
    assert run(["export", str(ours), "-o", str(exported)]) == ExitCode.DONE
    assert run(["diff", str(ours), str(exported)]) == ExitCode.DONE
    assert run(["diff", str(exported), str(ours)]) == ExitCode.DONE


def test_lengths_are_brought_to_one_unit(ours: Path, tmp_path: Path, capsys: Any) -> None:
    cm = text(tmp_path / "cm.csv", "t_ns,id,x_cm,y_cm", "1000,0,125,200\n2000,0,150,200\n")
    m = text(tmp_path / "m.csv", "t_ns,id,x_m,y_m", ROWS)
    assert run(["diff", m, cm]) == ExitCode.DONE
    assert run(["diff", m, text(tmp_path / "b.csv", "t_ns,id,x_cm,y_cm", ROWS)]) == ExitCode.DIFFERENT
    assert "x" in capsys.readouterr().out


def test_a_column_that_one_lacks_is_a_difference_and_the_others_are_compared(
    ours: Path, tmp_path: Path, capsys: Any
) -> None:
    other = text(tmp_path / "other.csv", "t_ns,id,x,y", ROWS.replace("1.5", "1.75"))
    assert run(["diff", str(ours), other]) == ExitCode.DIFFERENT
    out = capsys.readouterr().out
    assert "column z is only in A" in out
    assert "x is 1.5 in A, 1.75 in B" in out


def test_a_table_of_another_kind_and_an_unknown_tolerance_are_refused(ours: Path, tmp_path: Path, capsys: Any) -> None:
    other = text(tmp_path / "other.csv", "t_ns,sensor,bearing,sigma", "1000,a,0,1\n")
    assert run(["diff", str(ours), other]) == ExitCode.BAD_INPUT
    assert "truth requires x; y" in capsys.readouterr().err
    same = text(tmp_path / "same.csv", "t_ns,id,x,y", ROWS)
    assert run(["diff", same, same, "--tol", "xx=1"]) == ExitCode.USAGE
    assert "did you mean 'x'?" in capsys.readouterr().err


def test_text_that_is_no_table_is_compared_as_text(tmp_path: Path, capsys: Any) -> None:
    a, b = text(tmp_path / "a.csv", "word,number", "a,1\n"), text(tmp_path / "b.csv", "word,number", "a,2\n")
    assert run(["diff", a, b]) == ExitCode.DIFFERENT
    assert "line 2" in capsys.readouterr().out


def test_a_table_without_a_unit_is_in_metres_next_to_one_that_states_another(tmp_path: Path) -> None:
    """1 and 1 cm were the same."""
    bare = text(tmp_path / "bare.csv", "t_ns,id,x,y", ROWS)
    cm = text(tmp_path / "cm.csv", "t_ns,id,x_cm,y_cm", ROWS)
    m = text(tmp_path / "m.csv", "t_ns,id,x_m,y_m", ROWS)
    assert run(["diff", bare, cm]) == run(["diff", cm, bare]) == ExitCode.DIFFERENT
    assert run(["diff", bare, m]) == run(["diff", m, bare]) == ExitCode.DONE


def test_columns_that_no_table_has_are_compared_too(tmp_path: Path, capsys: Any) -> None:
    """Two files that differ in them alone were the same."""
    a = text(tmp_path / "a.csv", "t_ns,id,x,y,note", "1000,0,1,2,one\n2000,0,1,2,2.0\n")
    b = text(tmp_path / "b.csv", "t_ns,id,x,y,note", "1000,0,1,2,one\n2000,0,1,2,2\n")
    c = text(tmp_path / "c.csv", "t_ns,id,x,y,note", "1000,0,1,2,one\n2000,0,1,2,two\n")
    d = text(tmp_path / "d.csv", "t_ns,id,x,y", "1000,0,1,2\n2000,0,1,2\n")
    assert run(["diff", a, b]) == ExitCode.DONE
    capsys.readouterr()
    assert run(["diff", a, c]) == ExitCode.DIFFERENT
    assert "row 1 of note: 2.0 in A, two in B" in capsys.readouterr().out
    assert run(["diff", a, d]) == ExitCode.DIFFERENT
    assert "column note is only in A" in capsys.readouterr().out


def test_columns_that_only_a_wider_table_has_are_compared(tmp_path: Path, capsys: Any) -> None:
    def fused(name: str, doubt: str) -> str:
        nothing = {key: [0.0, 0.0] for key in ("x", "y", "vx", "vy", "cov_xx", "cov_xy", "cov_yy")}
        rows = FusedTracks.of(t_ns=[1, 2], target_id=[0, 0], **nothing, seen_by=["a", "a"], quality_flags=["", doubt])
        write_table(tmp_path / name, rows, Provenance("test"))
        return str(tmp_path / name)

    a, b = fused("a.parquet", ""), fused("b.parquet", "single_view")
    assert run(["diff", a, fused("c.parquet", "")]) == ExitCode.DONE
    assert run(["diff", a, b]) == ExitCode.DIFFERENT
    assert "quality_flags is '' in A, 'single_view' in B" in capsys.readouterr().out


def test_an_export_of_a_wider_table_is_the_same_and_read_as_wide(tmp_path: Path, capsys: Any) -> None:
    """The columns that tracks of several views have more were not read from text."""
    nothing = {key: [0.0, 0.0] for key in ("x", "y", "vx", "vy", "cov_xx", "cov_xy", "cov_yy")}
    rows = FusedTracks.of(
        t_ns=[1, 2], target_id=[0, 0], **nothing, seen_by=["a", "b"], quality_flags=["", "single_view"]
    )
    ours, exported, again = (str(tmp_path / name) for name in ("a.parquet", "b.csv", "c.csv"))
    write_table(tmp_path / "a.parquet", rows, Provenance("test"))
    assert run(["export", ours, "-o", exported]) == run(["export", exported, "-o", again]) == ExitCode.DONE
    assert Path(again).read_text() == Path(exported).read_text()
    assert run(["diff", ours, exported]) == run(["diff", exported, ours]) == ExitCode.DONE
    Path(again).write_text(Path(exported).read_text().replace("single_view", "possible_switch"))
    assert run(["diff", ours, again]) == run(["diff", exported, again]) == ExitCode.DIFFERENT
    capsys.readouterr()
    assert run(["info", exported]) == ExitCode.DONE
    stdout = capsys.readouterr().out
    assert "vx_m_s: vx [m/s]" in stdout
    assert "quality_flags: quality_flags\n" in stdout


def test_trajectories_are_compared_with_tables(tmp_path: Path, capsys: Any) -> None:
    """Their names kept them apart: two files of different kinds, or text that was compared byte by byte."""
    rows = Truth.of(t_ns=[1000, 2000], target_id=[0, 0], x=[1.25, 1.5], y=[2.0, 2.0], z=[0, 0], role=["target"] * 2)
    write_table(tmp_path / "a.parquet", rows, Provenance("test"))
    for name, origin in (("a.tum", ()), ("a.trc", ()), ("a.geojson", ("--origin", "52,13"))):
        assert run(["export", str(tmp_path / "a.parquet"), "-o", str(tmp_path / name), "-q", *origin]) == ExitCode.DONE
        capsys.readouterr()
        assert run(["diff", str(tmp_path / "a.parquet"), str(tmp_path / name), "--json"]) == ExitCode.DIFFERENT
        (part,) = json.loads(capsys.readouterr().out)["parts"]
        assert (part["rows"]["a"], part["rows"]["b"]) == (2, 2)
        assert "role" in {each["column"] for each in part["schema"]}
    assert run(["diff", str(tmp_path / "a.tum"), str(tmp_path / "a.tum")]) == ExitCode.DONE


def test_a_standard_deviation_is_no_angle_that_a_turn_leaves_alone(tmp_path: Path) -> None:
    def poses(name: str, yaw: float, deviation: float) -> str:
        values = {"dx": [0.0], "dy": [0.0], "dyaw": [yaw], "sd_dx": [0.1], "sd_dy": [0.1], "sd_dyaw": [deviation]}
        rows = Calibration.of(t_ns=[1], target_id=[0], sensor=["a"], **values)
        write_table(tmp_path / name, rows, Provenance("test"))
        return str(tmp_path / name)

    a = poses("a.parquet", 0.1, 0.1)
    assert run(["diff", a, poses("b.parquet", 0.1 + 2 * math.pi, 0.1)]) == ExitCode.DONE
    assert run(["diff", a, poses("c.parquet", 0.1, 0.1 + 2 * math.pi)]) == ExitCode.DIFFERENT
