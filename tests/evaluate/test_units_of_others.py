"""Tables of other programs in several units of length, without a scene: one that states none is in metres."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.settings import METRES

ERROR_M = 0.1


def rows(path: Path, unit: str, x: float) -> Path:
    """Forty rows of one person who walks, x shifted [m]."""
    ending, metre = (f"_{unit}", 1 / METRES[unit]) if unit else ("", 1.0)
    lines = [f"{k * 10**8},1,{(0.1 * k + x) * metre!r},{2 * metre!r}" for k in range(40)]
    path.write_text("\n".join([f"t_ns,id,x{ending},y{ending}", *lines]) + "\n")
    return path


@pytest.mark.parametrize(
    ("tracks", "truth", "unit"),
    [("", "ft", "m"), ("mm", "", "m"), ("ft", "ft", "ft"), ("", "", "m"), ("mm", "ft", "ft")],
)
def test_lengths_without_a_unit_are_metres_next_to_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], tracks: str, truth: str, unit: str
) -> None:
    """They were taken for those of the other table: 1 m was 1 ft, and an error of 0.1 m one of metres."""
    mine, true = rows(tmp_path / "a.csv", tracks, ERROR_M), rows(tmp_path / "b.csv", truth, 0.0)
    assert run(["evaluate", str(mine), "--truth", str(true), "--match", "id", "--json"]) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)[f"rmse_{unit}"] * METRES[unit] == pytest.approx(ERROR_M, rel=1e-9)

    same = rows(tmp_path / "c.csv", "cm" if tracks else "", ERROR_M)
    assert run(["compare", str(mine), str(same), "--truth", str(true), "--json"]) == ExitCode.DONE
    result = json.loads(capsys.readouterr().out)
    (found,) = [row for row in result["rows"] if row["figure"] == "matched_rmse"]
    for which in ("first", "this"):
        assert found[which] * METRES[result["length_unit"]] == pytest.approx(ERROR_M, rel=1e-9)


def test_a_page_of_two_runs_says_the_unit_of_its_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Figures in metres were stated to be in ft, the unit of the truth."""
    mine, true = rows(tmp_path / "a.csv", "", ERROR_M), rows(tmp_path / "b.csv", "ft", 0.0)
    page = tmp_path / "page.html"
    assert run(["report", str(mine), str(mine), "--truth", str(true), "-o", str(page), "--json"]) == ExitCode.DONE
    result = json.loads(capsys.readouterr().out)
    assert result["length_unit"] == "m"
    assert result["figures"]["matched_rmse"]["a"] == pytest.approx(ERROR_M, rel=1e-9)
