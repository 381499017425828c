"""What is exported comes back as it is, or is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.boxes.reader import BoxFile, BoxOptions, survey_boxes
from occlog.io.open import open_input
from occlog.io.recording.writer import RecordingWriter
from occlog.records.columns import MAX_NS
from occlog.records.tables import Boxes, Doa, Failures, TruthBoxes


def directions(path: Path, sensor: str, t_ns: int = 0) -> Path:
    nan = [np.nan]
    table = Doa.of(
        t_ns=[t_ns], sensor=[sensor], source_id=[0], azimuth=[0.5], elevation=nan, sigma_azimuth=nan,
        sigma_elevation=nan, confidence=nan,
    )  # fmt: skip
    write_table(path, table, Provenance("test"))
    return path


@pytest.mark.parametrize(
    "name", ['a"b', '"', "a,b", "=a", "'=a", "'a", "-1", "007", "nan", "a\u2028b", "#a", "a;b", "a\tb"]
)
@pytest.mark.parametrize("ending", ["csv", "csv.gz", "parquet"])
def test_names_come_back(tmp_path: Path, name: str, ending: str) -> None:
    source, out = directions(tmp_path / "t.parquet", name), tmp_path / f"out.{ending}"
    assert run(["export", str(source), "-o", str(out)]) == ExitCode.DONE
    assert open_input(out).read(Doa).sensor.tolist() == [name]


@pytest.mark.parametrize("name", ["a\nb", "a\rb", " a", "a ", "\u00a0a", ""])
def test_names_that_would_not_come_back_are_refused(tmp_path: Path, capsys: Any, name: str) -> None:
    """Lines broke, and blanks were lost."""
    source, out = directions(tmp_path / "t.parquet", name), tmp_path / "out.csv"
    assert run(["export", str(source), "-o", str(out)]) == ExitCode.BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert f"t.parquet: sensor {name!r}: a text table takes no line break" in line
    assert not out.exists()
    assert run(["export", str(source), "-o", str(tmp_path / "out.parquet")]) == ExitCode.DONE
    if name:  # an empty one may be of another program, which left it out
        assert open_input(tmp_path / "out.parquet").read(Doa).sensor.tolist() == [name]


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_times_come_back(tmp_path: Path, ending: str) -> None:
    for t_ns in (-MAX_NS, MAX_NS):
        source, out = directions(tmp_path / f"{t_ns}.parquet", "a", t_ns), tmp_path / f"out.{t_ns}.{ending}"
        assert run(["export", str(source), "-o", str(out)]) == ExitCode.DONE
        assert open_input(out).read(Doa).t_ns.tolist() == [t_ns]


def test_cameras_of_coco_come_back_by_their_names(tmp_path: Path) -> None:
    """`a/b` lay in a folder a/b, and came back as b."""
    one = [0.5]
    boxes = Boxes.of(
        t_ns=[0], sensor=["hall/b"], frame=[0], box=[0], target_id=[1], left_px=one, top_px=one, width_px=one,
        height_px=one, confidence=one,
    )  # fmt: skip
    write_table(tmp_path / "t.parquet", boxes, Provenance("test"))
    assert run(["export", str(tmp_path / "t.parquet"), "-o", str(tmp_path / "o.json")]) == ExitCode.DONE
    assert survey_boxes([BoxFile(tmp_path / "o.json", None)], (), BoxOptions()).cameras == ("hall/b",)


def test_failures_on_the_ground_have_no_camera(tmp_path: Path) -> None:
    """They were exported, and refused when they were read."""
    values = {c.name: ["" if c.kind == "U" else 0] for c in Failures.columns()}
    values["kind"] = ["position"]
    write_table(tmp_path / "t.parquet", Failures.of(**values), Provenance("test"))
    assert run(["export", str(tmp_path / "t.parquet"), "-o", str(tmp_path / "o.csv")]) == ExitCode.DONE
    assert open_input(tmp_path / "o.csv", Failures).read(Failures).sensor.tolist() == [""]


def test_true_boxes_have_their_identities_in_mot_text(tmp_path: Path, capsys: Any) -> None:
    """Each was written as a detection, with identity -1."""
    box = {"left_px": [1.5] * 3, "top_px": [2.0] * 3, "width_px": [10.0] * 3, "height_px": [20.0] * 3}
    times = {"t_ns": [0, 0, 10**9], "sensor": ["a"] * 3, "frame": [0, 0, 1], "confidence": [np.nan] * 3}
    truth = TruthBoxes.of(**times, **box, box=[0, 1, 0], target_id=[4, 9, 9], visible=[1.0, 0.5, 1.0])
    with RecordingWriter(tmp_path / "r.mcap", None, Provenance("test")) as out:
        out.table(truth)
    args = ["export", str(tmp_path / "r.mcap"), "--table", "truth_boxes", "--to", "mot", "-o", str(tmp_path / "gt.txt")]
    assert run(args) == ExitCode.DONE
    assert "visible" in capsys.readouterr().err
    assert (tmp_path / "gt.txt").read_text().splitlines() == [
        "1,4,1.5,2.0,10.0,20.0,1,1,1", "1,9,1.5,2.0,10.0,20.0,1,1,1", "2,9,1.5,2.0,10.0,20.0,1,1,1",
    ]  # fmt: skip
