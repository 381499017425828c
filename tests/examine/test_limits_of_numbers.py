"""Numbers of targets and sensors: many are processed in linear time, too many are refused in one line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode, InputError
from occlog.evaluate.errors import survey
from occlog.examine.export import trajectories
from occlog.records.scene import MAX_SENSORS, MicrophoneArray, Scene
from occlog.report import gather


def a_table(folder: Path, targets: int, at_once: bool) -> str:
    """Positions of targets, all at two times, or each at a time of its own; the path."""
    path, times = folder / "targets.csv", 2 if at_once else 1
    rows = [f"{t if at_once else i},{i},{i % 10},{i % 7}" for t in range(times) for i in range(targets)]
    path.write_text("time,id,x,y\n" + "\n".join(rows) + "\n")
    return str(path)


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The only line of a command that ends with bad input."""
    assert run(arguments) == ExitCode.BAD_INPUT
    lines = [line for line in capsys.readouterr().err.splitlines() if "occlog: error" in line]
    assert len(lines) == 1
    return lines[0]


def test_evaluate_refuses_more_identities_than_the_limit(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setattr(survey, "MAX_IDENTITIES", 29)
    table = a_table(tmp_path, 30, at_once=False)
    assert "more than 29 targets" in refused(["evaluate", table, "--truth", table], capsys)


@pytest.mark.parametrize(("at_once", "pairs"), [(True, 900), (False, 30)])
def test_pairs_are_counted_where_lifetimes_overlap(tmp_path, capsys, monkeypatch, at_once, pairs) -> None:
    monkeypatch.setattr(survey, "MAX_PAIRS", pairs - 1)
    table = a_table(tmp_path, 30, at_once=at_once)
    assert f" {pairs} pairs" in refused(["evaluate", table, "--truth", table], capsys)
    monkeypatch.setattr(survey, "MAX_PAIRS", pairs)
    assert run(["evaluate", table, "--truth", table]) == 0


def test_trc_refuses_more_cells_than_the_limit(tmp_path, capsys, monkeypatch) -> None:
    table, output = a_table(tmp_path, 30, at_once=False), tmp_path / "out.trc"
    monkeypatch.setattr(trajectories, "MAX_CELLS", 3 * 30 * 30 - 1)
    assert "--target" in refused(["export", table, "-o", str(output)], capsys)
    assert not output.exists()
    monkeypatch.setattr(trajectories, "MAX_CELLS", 3 * 30 * 30)
    assert run(["export", table, "-o", str(output)]) == 0
    lines = output.read_text().splitlines()[6:]
    assert [len(line.split("\t")) for line in lines] == [2 + 3 * 30] * 30
    # Each target is at one time, in its own three columns
    assert all(line.split("\t")[2 + 3 * n] == str(float(n % 10)) for n, line in enumerate(lines))


def test_geojson_of_many_targets_has_each_once(tmp_path) -> None:
    table, output = a_table(tmp_path, 3000, at_once=True), tmp_path / "out.geojson"
    assert run(["export", table, "--origin", "50,8", "-o", str(output)]) == 0
    found = json.loads(output.read_text())["features"]
    assert [each["properties"]["target_id"] for each in found] == list(range(3000))


def test_report_refuses_more_tracks_than_the_limit(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setattr(gather, "MAX_DRAWN_TRACKS", 29)
    table = a_table(tmp_path, 30, at_once=True)
    assert "30 tracks" in refused(["report", table, "-o", str(tmp_path / "page.html")], capsys)


def test_a_scene_has_a_largest_number_of_sensors() -> None:
    stations = tuple(MicrophoneArray(f"s{n}", np.zeros(3)) for n in range(MAX_SENSORS + 1))
    assert len(Scene(arrays=stations[:-1]).sensors) == MAX_SENSORS
    with pytest.raises(InputError, match=f"at most {MAX_SENSORS}"):
        Scene(arrays=stations)
