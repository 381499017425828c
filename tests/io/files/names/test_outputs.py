"""Files under the names of other formats: no recording is written there, and what is none is not salvaged."""

from __future__ import annotations

from pathlib import Path

import pytest
from sweep_scene import SCENE

from occlog.cli.main import run
from occlog.errors import ExitCode


def test_a_recording_is_not_written_under_the_name_of_another_format(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """MCAP stood in files named .parquet and .csv."""
    (tmp_path / "scene.yaml").write_text(SCENE)
    simulate = ["simulate", str(tmp_path / "scene.yaml"), "--steps", "3", "-q", "-o"]
    assert run([*simulate, str(tmp_path / "r.mcap")]) == ExitCode.DONE
    for ending in (".parquet", ".csv", ".yaml"):
        out = tmp_path / f"out{ending}"
        for args in ([*simulate, str(out)], ["recover", str(tmp_path / "r.mcap"), "-o", str(out)]):
            assert run(args) == ExitCode.USAGE
            assert f"recordings are written as MCAP, not {ending}; name it out.mcap" in capsys.readouterr().err
            assert not out.exists()
    assert run([*simulate, str(tmp_path / "no_ending")]) == ExitCode.DONE


@pytest.mark.parametrize(("option", "name", "right"), [("-o", "a.png", "a.html"), ("--png", "a.jpg", "a.png")])
def test_a_page_is_not_written_under_the_name_of_another_format(
    option: str, name: str, right: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """HTML stood in files named .png."""
    (tmp_path / "scene.yaml").write_text(SCENE)
    report = ["report", "--scene", str(tmp_path / "scene.yaml"), option, str(tmp_path / name)]
    assert run([*report, *([] if option == "-o" else ["-o", str(tmp_path / "b.html")])]) == ExitCode.USAGE
    assert right in capsys.readouterr().err
    assert not list(tmp_path.glob("*.html"))


def test_what_is_neither_a_recording_nor_a_table_is_not_salvaged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Text was stated to be no MCAP file, whatever it was."""
    (tmp_path / "a.csv").write_text("t_ns,id,x,y\n1,0,2,3\n")
    assert run(["recover", str(tmp_path / "a.csv"), "-o", str(tmp_path / "b.parquet")]) == ExitCode.BAD_INPUT
    assert "a.csv: is neither a recording (MCAP) nor a table (Parquet); nothing of it" in capsys.readouterr().err
    assert not (tmp_path / "b.parquet").exists()
