"""Recordings under the names of other formats are refused, by every command that writes one."""

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
