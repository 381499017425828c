"""What a format does not hold of a table is stated when it is exported."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from occlog.array_types import NS
from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.records.columns import ColumnTable
from occlog.records.tables import Boxes, Tracks, Truth

START = "the time of the first row, 1970-01-01T00:00:05.000Z (5000000000 ns)"
UNKNOWN = "which heights are not known (0 in 1 row)"
EDGES = ("left_px", "top_px", "width_px", "height_px")


def truth() -> Truth:
    rows = {"t_ns": [5 * NS, 5 * NS, 6 * NS], "target_id": [7, 8, 7], "role": ["target", "occluder", "target"]}
    return Truth.of(**rows, x=[1.0, 2.0, 3.0], y=[1.0, 2.0, 3.0], z=[1.5, 1.5, np.nan])


def tracks() -> Tracks:
    values = {key: [1.0] for key in ("x", "y", "vx", "vy", "cov_xx", "cov_yy", "z")}
    return Tracks.of(t_ns=[5 * NS], target_id=[7], cov_xy=[0.0], **values)


def boxes(frames: tuple[int, ...], boxed: tuple[int, ...], names: tuple[int, ...] | None = None) -> Boxes:
    n, there = len(frames), np.isin(frames, boxed)
    edges = {name: np.where(there, 10.0, np.nan) for name in EDGES}
    t_ns = np.array(frames) * NS // 10
    names = names or (-1,) * n
    columns = {"t_ns": t_ns, "frame": frames, "box": np.where(there, 0, -1), "target_id": names}
    return Boxes.of(**columns, sensor=["a"] * n, **edges, confidence=np.where(there, 0.5, np.nan))


@pytest.mark.parametrize(
    ("table", "to", "unit", "expected"),
    [
        (
            truth(),
            "tum",
            "ft",
            ["that lengths are in ft", UNKNOWN, "1 row of other objects than targets", "identities"],
        ),
        (truth(), "trc", "ft", [START, UNKNOWN, "1 row of other objects than targets"]),
        (truth(), "geojson", "m", ["1 row of other objects than targets", "heights"]),
        (
            truth(),
            "mot3d",
            "unit",
            ["that lengths are in unit", UNKNOWN, "1 row of other objects than targets", "times"],
        ),
        (tracks(), "tum", "m", ["identities", "velocities", "covariances"]),
        (tracks(), "csv", "ft", []),
        (boxes((0, 1, 2), (0, 1, 2)), "kitti", "m", ["times"]),
        (boxes((0, 1, 2), (0, 1, 2), (3, 3, 3)), "mot", "m", ["times", "identities"]),
        (boxes((0, 1, 2, 3), (0, 2)), "coco", "m", ["1 frame without a box before the first or behind the last one"]),
        (boxes((0, 3), (0, 3)), "coco", "m", ["that 2 frames between others were not recorded: read as without a box"]),
        (boxes((0, 1, 2), (0, 2)), "coco", "m", []),
    ],
)
def test_what_is_not_held_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], table: ColumnTable, to: str, unit: str, expected: list[str]
) -> None:
    write_table(tmp_path / "in.parquet", table, Provenance("test"), length_unit=unit)
    args = ["export", str(tmp_path / "in.parquet"), "-o", str(tmp_path / "out.txt"), "--to", to]
    args += ["--origin", "52,13"] if to == "geojson" else []
    assert run([*args, "--json"]) == ExitCode.DONE
    printed = capsys.readouterr()
    result = json.loads(printed.out).get("not_representable", [])
    assert len(result) == len(expected)
    assert all(each.startswith(want) for each, want in zip(result, expected, strict=True)), result
    assert printed.err.count("cannot store") == (1 if expected else 0)
    assert run([*args, "--overwrite", "-q"]) == ExitCode.DONE
    assert "cannot store" not in capsys.readouterr().err


def test_it_is_reported_where_the_table_goes_to_standard_output(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_table(tmp_path / "in.parquet", truth(), Provenance("test"))
    assert run(["export", str(tmp_path / "in.parquet"), "-o", "-", "--to", "trc"]) == ExitCode.DONE
    assert START in capsys.readouterr().err
