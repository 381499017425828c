"""`occlog export` in pieces: a file is the same whether a table is read in one piece or in many small ones."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.examine.export.trajectories import ExportedPositions, geojson_texts, places_of
from occlog.io import open as opening
from occlog.io.files.geodetic import Origin
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import iter_table
from occlog.io.files.tables.table_writer import write_table
from occlog.records.columns import ColumnTable
from occlog.records.declared.views import ViewTracks
from occlog.records.tables import Boxes, Tracks, Truth

STEPS, TARGETS = 7, 3
T_NS = np.repeat(np.arange(STEPS) * 10**8, TARGETS)
IDS = np.tile(np.array([5, 2, 9], dtype=np.int32), STEPS)
X = np.linspace(0.0, 3.0, len(IDS))


def tracks() -> Tracks:
    """Three targets, whose rows of a time are not in the order of identities."""
    ones = {name: np.ones(len(IDS)) for name in ("vx", "vy", "cov_xx", "cov_yy")}
    return Tracks.of(t_ns=T_NS, target_id=IDS, x=X, y=-X, cov_xy=np.zeros(len(IDS)), **ones)


def truth() -> Truth:
    role = np.where(IDS == 9, "occluder", "target")
    return Truth.of(t_ns=T_NS, target_id=IDS, role=role, x=X, y=X, z=np.zeros(len(IDS)))


def in_images(frame: np.ndarray) -> ViewTracks:
    """Three targets in two cameras."""
    numbers = ("a_px", "b_px", "cov_xx_px", "cov_yy_px", "similarity", "ess")
    values = {name: np.ones(len(IDS)) for name in numbers} | {
        "rho": np.zeros(len(IDS)),
        "cov_xy_px": np.zeros(len(IDS)),
    }
    texts = {
        name: np.full(len(IDS), "")
        for name in ("likelihood_mode", "counterpart", "neighbours", "assisting_views", "lifecycle")
    }
    sensor = np.where(IDS == 9, "b", "a")
    return ViewTracks.of(t_ns=T_NS, sensor=sensor, frame=frame, target_id=IDS, x_px=X, y_px=X, **values, **texts)


def boxes() -> Boxes:
    """Boxes of one camera, and a frame of it without a box."""
    there = T_NS != 2 * 10**8
    edges = {name: np.where(there, X + 1.0, np.nan) for name in ("left_px", "top_px", "width_px", "height_px")}
    keep = there | (IDS == 5)
    columns = {"t_ns": T_NS, "frame": T_NS // 10**8, "box": np.where(there, IDS, -1), "confidence": edges["top_px"]}
    columns |= {"sensor": np.full(len(IDS), "a"), "target_id": np.where(there, IDS, -1), **edges}
    return Boxes.of(**{name: values[keep] for name, values in columns.items()})


FRAME = T_NS // 10**8
CASES = [
    (tracks(), "out.txt", ("--to", "mot3d")),
    (tracks(), "out.tum", ("--target", "2")),
    (tracks(), "out.trc", ()),
    (tracks(), "out.geojson", ("--origin", "52.5,13.4,20")),
    (truth(), "out.trc", ("--target", "2")),
    (truth(), "out.txt", ("--to", "mot3d")),
    (truth(), "out.csv", ()),
    (in_images(FRAME), "out.txt", ("--to", "mot", "--camera", "a")),
    (in_images(FRAME), "out.txt", ("--to", "kitti", "--camera", "a")),
    (in_images(FRAME), "out.json", ()),
    (in_images(FRAME), "out.json", ("--camera", "a")),
    (in_images(FRAME // 2), "out.json", ()),
    (boxes(), "out.txt", ("--to", "mot")),
    (boxes(), "out.json", ()),
]


@pytest.mark.parametrize(("table", "name", "args"), CASES, ids=[f"{t.NAME}-{a or n}" for t, n, a in CASES])
def test_small_pieces_make_the_same_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, table: ColumnTable, name: str, args: tuple[str, ...]
) -> None:
    write_table(tmp_path / "in.parquet", table, Provenance("test"))
    made = []
    for rows in (1000, 2):
        monkeypatch.setattr(opening, "iter_table", partial(iter_table, rows=rows))
        output = tmp_path / name
        assert run(["export", str(tmp_path / "in.parquet"), "-o", str(output), "--overwrite", *args]) == ExitCode.DONE
        made.append(output.read_bytes())
    assert len(made[0].splitlines()) >= (1 if name.endswith("json") else STEPS)
    assert made[1] == made[0]


def test_frames_that_go_back_are_no_text_of_rising_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_table(tmp_path / "in.parquet", in_images(FRAME[::-1].copy()), Provenance("test"))
    for rows in (1000, 2):
        monkeypatch.setattr(opening, "iter_table", partial(iter_table, rows=rows))
        args = ["--to", "mot", "--camera", "a", "-o", str(tmp_path / "out.txt")]
        assert run(["export", str(tmp_path / "in.parquet"), *args]) == ExitCode.BAD_INPUT
        assert "t_ns goes back at row 2 (500000000 after 600000000)" in capsys.readouterr().err
        assert not (tmp_path / "out.txt").exists()


def test_an_empty_table_of_boxes_is_an_empty_data_set(tmp_path: Path) -> None:
    write_table(tmp_path / "in.parquet", Boxes.empty(), Provenance("test"))
    assert run(["export", str(tmp_path / "in.parquet"), "-o", str(tmp_path / "out.json")]) == ExitCode.DONE
    assert '"images": [], "annotations": []' in (tmp_path / "out.json").read_text()


def test_a_line_longer_than_is_kept_in_memory_is_written_in_two_passes() -> None:
    whole, origin = places_of(tracks(), ()), Origin(52.5, 13.4, 20.0)
    wanted = "".join(geojson_texts(lambda: [whole], origin, "m"))
    cut = [ExportedPositions(*(column[n : n + 4] for column in whole)) for n in range(0, len(whole.t_ns), 4)]
    for most in (1, STEPS, 2 * STEPS):
        assert "".join(geojson_texts(lambda: cut, origin, "m", most)) == wanted
    features = json.loads(wanted)["features"]
    assert [each["properties"]["target_id"] for each in features] == [2, 5, 9]
    assert all(len(each["geometry"]["coordinates"]) == len(each["properties"]["t_ns"]) == STEPS for each in features)
