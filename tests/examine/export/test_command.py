"""`occlog export`: every format by what it says, what is read again, and what is refused."""

from __future__ import annotations

import gzip
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from random_tables import random_table

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.open import open_input
from occlog.records.columns import ColumnTable
from occlog.records.declared.people import PeopleTracks
from occlog.records.declared.views import ViewTracks
from occlog.records.tables import TABLES, Boxes, Tracks, Truth

MADE = Provenance("test")
NARROW = [table for table in TABLES.values() if not any(c.width and c.nan is None for c in table.columns())]
"""Tables whose lists of numbers may be unknown, so that text can hold the rest."""


def put(folder: Path, table: ColumnTable, unit: str = "m") -> str:
    write_table(folder / "in.parquet", table, MADE, overwrite=True, length_unit=unit)
    return str(folder / "in.parquet")


def export(folder: Path, table: ColumnTable, output: str, *args: str, unit: str = "m") -> Path:
    assert run(["export", put(folder, table, unit), "-o", str(folder / output), "--overwrite", *args]) == ExitCode.DONE
    return folder / output


def tracks() -> Tracks:
    """Two targets; the second is there once, and nothing is known of its height."""
    values = {"t_ns": [0, 10**9, 10**9], "target_id": [3, 3, 7], "x": [1.0, 2.0, 5.0], "y": [0.0, 1.0, -2.5]}
    zero = {name: [0.0] * 3 for name in ("cov_xx", "cov_xy", "cov_yy")}
    return Tracks.of(**values, **zero, vx=[0.0, 0.0, np.nan], vy=[1.0, 1.0, np.nan], z=[0.5, 0.25, np.nan])


def boxes() -> Boxes:
    return Boxes.of(
        t_ns=[0, 0, 5],
        sensor=["a", "b", "a"],
        frame=[0, 0, 1],
        box=[0, 0, -1],
        target_id=[4, 2, -1],
        left_px=[10.5, 1.0, np.nan],
        top_px=[20.0, 2.0, np.nan],
        width_px=[30.0, 3.0, np.nan],
        height_px=[40.0, 4.0, np.nan],
        confidence=[0.75, np.nan, np.nan],
    )


@pytest.mark.parametrize(
    ("table", "ending"),
    [*((t, ending) for ending in (".csv", "-plain.parquet") for t in NARROW), (NARROW[0], ".csv.gz")],
    ids=lambda value: value if isinstance(value, str) else value.NAME,
)
def test_what_is_exported_and_read_again_is_the_same(tmp_path: Path, table: type[ColumnTable], ending: str) -> None:
    wanted = random_table(table, 24).sorted()
    found = open_input(export(tmp_path, wanted, f"out{ending}"), table).read(table)
    for c in table.columns():
        if not (c.width and "csv" in ending):
            np.testing.assert_array_equal(getattr(found, c.name), getattr(wanted, c.name), err_msg=c.name)


def test_names_that_a_spreadsheet_would_run_are_marked_and_read_again(tmp_path: Path) -> None:
    named = random_table(TABLES["doa"], 3)
    named = replace(named, sensor=np.array(["=cmd|calc!A1", "'=x", "mic"])).sorted()
    out = export(tmp_path, named, "d.csv")
    assert {"'=cmd|calc!A1", "''=x", "mic"} == {row.split(",")[1] for row in out.read_text().splitlines()[1:]}
    assert open_input(out, TABLES["doa"]).read(TABLES["doa"]).sensor.tolist() == named.sensor.tolist()


def test_names_of_columns_state_their_units(tmp_path: Path) -> None:
    head = export(tmp_path, tracks(), "t.csv", unit="cm").read_text().splitlines()
    assert head[0].startswith("t_ns,target_id,x_cm,y_cm,vx_cm_s,vy_cm_s,cov_xx_cm2,")
    assert head[3].split(",")[:6] == ["1000000000", "7", "5.0", "-2.5", "", ""]
    doa = random_table(TABLES["doa"], 2)
    assert "azimuth_rad" in export(tmp_path, doa, "d.csv").read_text().splitlines()[0]


def test_pandas_reads_plain_parquet_with_nulls(tmp_path: Path) -> None:
    frame = pd.read_parquet(export(tmp_path, tracks(), "out.parquet"))
    assert frame["z_m"].isna().tolist() == [False, False, True]
    assert frame["t_ns"].dtype == np.int64


def test_further_columns_of_tracks_of_people_are_kept(tmp_path: Path) -> None:
    people = random_table(PeopleTracks, 3)
    names = export(tmp_path, people, "p.csv").read_text().splitlines()[0].split(",")
    assert {"existence_probability", "height_m", "seen_by"} <= set(names)


def test_the_same_bytes_each_time(tmp_path: Path) -> None:
    first = export(tmp_path, tracks(), "t.csv.gz").read_bytes()
    assert export(tmp_path, tracks(), "t.csv.gz").read_bytes() == first
    assert gzip.decompress(first) == export(tmp_path, tracks(), "t.csv").read_bytes()


def test_standard_output_has_the_table_alone(tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]) -> None:
    assert run(["export", put(tmp_path, tracks()), "-o", "-", "--to", "mot3d"]) == ExitCode.DONE
    assert capfdbinary.readouterr().out == (
        b"1,3,-1,-1,-1,-1,-1,1.0,0.0,0.5\n2,3,-1,-1,-1,-1,-1,2.0,1.0,0.25\n2,7,-1,-1,-1,-1,-1,5.0,-2.5,0.0\n"
    )


def test_the_summary_counts_the_rows_that_are_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    export(tmp_path, tracks(), "t.tum", "--target", "3", "--json")
    assert json.loads(capsys.readouterr().out)["rows"] == 2


def test_of_many_targets_ten_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = Truth.of(t_ns=[0] * 12, target_id=range(12), role=["target"] * 12, x=[0.0] * 12, y=[0.0] * 12, z=[0.0] * 12)
    assert run(["export", put(tmp_path, truth), "-o", str(tmp_path / "t.tum")]) == ExitCode.USAGE
    assert "there are 0, 1, 2, 3, 4, 5, 6, 7, 8, 9 and 2 more; choose one (--target)" in capsys.readouterr().err


def test_tum_is_one_target_that_looks_where_it_goes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = export(tmp_path, tracks(), "t.tum", "--target", "3").read_text().splitlines()
    assert lines[1].startswith("1.000000000 2.0 1.0 0.25 0 0 ")
    np.testing.assert_allclose([float(v) for v in lines[0].split()[6:]], [np.sqrt(0.5), np.sqrt(0.5)])
    assert export(tmp_path, tracks(), "t.tum", "--target", "7").read_text().endswith(" 0 0 0.0 1.0\n")
    assert run(["export", put(tmp_path, tracks()), "-o", str(tmp_path / "two.tum")]) == ExitCode.USAGE
    assert "holds one target, and there are 3, 7; choose one (--target)" in capsys.readouterr().err


def test_geojson_lies_on_the_ellipsoid(tmp_path: Path) -> None:
    path = export(tmp_path, tracks(), "t.geojson", "--origin", "52.5,13.25")
    line, point = json.loads(path.read_text())["features"]
    assert line["geometry"]["type"] == "LineString"
    assert point["geometry"]["type"] == "Point"
    assert line["properties"] == {"target_id": 3, "t_ns": [0, 10**9]}
    # Length of a degree by the radii of curvature of WGS 84 [m]
    sine, e2 = np.sin(np.radians(52.5)), 0.00669437999014
    vertical = 6_378_137.0 / np.sqrt(1 - e2 * sine**2)
    east = np.radians(vertical) * np.cos(np.radians(52.5))
    north = np.radians(6_378_137.0 * (1 - e2) / (1 - e2 * sine**2) ** 1.5)
    lon, lat = point["geometry"]["coordinates"]
    assert lon == pytest.approx(13.25 + 5.0 / east, abs=2e-9)
    assert lat == pytest.approx(52.5 - 2.5 / north, abs=2e-9)
    turned = export(tmp_path, tracks(), "t.geojson", "--origin", "52.5,13.25,90")
    lon, lat = json.loads(turned.read_text())["features"][1]["geometry"]["coordinates"]
    assert lon == pytest.approx(13.25 + 2.5 / east, abs=2e-9)
    assert lat == pytest.approx(52.5 + 5.0 / north, abs=2e-9)


def test_a_sequence_of_motchallenge_has_its_info(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "SEQ" / "det").mkdir(parents=True)
    (tmp_path / "scene.yaml").write_text(
        "occlog_scene: 1\ncameras:\n  - {name: a, position: [0, 0, 2], yaw_deg: 0, focal_px: 500, "
        "image_size_px: [640, 480], noise: {measurement_noise_px: 1}}\n"
    )
    args = ["--to", "mot", "--camera", "a", "--scene", str(tmp_path / "scene.yaml")]
    export(tmp_path, boxes(), "SEQ/det/det.txt", *args)
    lines = (tmp_path / "SEQ" / "seqinfo.ini").read_text().splitlines()
    assert lines[:2] == ["[Sequence]", "name=SEQ"]
    assert {"seqLength=2", "imWidth=640", "imHeight=480", "frameRate=2e+08"} <= set(lines)
    (tmp_path / "SEQ" / "seqinfo.ini").unlink()
    (tmp_path / "SEQ" / "det" / "det.txt").unlink()
    without = ["export", put(tmp_path, boxes()), "-o", str(tmp_path / "SEQ" / "det" / "det.txt"), *args[:4]]
    assert run(without) == ExitCode.DONE
    assert "seqinfo.ini: not written: the size of the images of a is not known" in capsys.readouterr().err
    assert not (tmp_path / "SEQ" / "seqinfo.ini").exists()


def test_boxes_of_one_camera_as_text(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert export(tmp_path, boxes(), "a.txt", "--to", "mot", "--camera", "a").read_text() == (
        "1,-1,10.5,20.0,30.0,40.0,0.75,-1,-1,-1\n"
    )
    assert export(tmp_path, boxes(), "a.txt", "--to", "kitti", "--camera", "a").read_text() == (
        "0 4 Pedestrian -1 -1 -10 10.5 20.0 40.5 60.0 -1 -1 -1 -1000 -1000 -1000 -10 0.75\n"
    )
    assert run(["export", put(tmp_path, boxes()), "-o", str(tmp_path / "x.txt"), "--to", "mot"]) == ExitCode.USAGE
    assert "holds one camera, and there are a, b; choose one (--camera)" in capsys.readouterr().err


def test_coco_has_images_boxes_and_a_category(tmp_path: Path) -> None:
    found = json.loads(export(tmp_path, boxes(), "c.json").read_text())
    assert [(i["id"], i["file_name"]) for i in found["images"]] == [(1, "a/000000.jpg"), (2, "b/000000.jpg")]
    first, second = found["annotations"]
    assert first["bbox"] == [10.5, 20.0, 30.0, 40.0]
    assert (first["area"], first["track_id"], first["score"]) == (1200.0, 4, 0.75)
    assert "score" not in second
    assert found["categories"] == [{"id": 1, "name": "person"}]


def test_ellipses_become_the_boxes_that_touch_them(tmp_path: Path) -> None:
    one = random_table(ViewTracks, 1)
    values = {c.name: getattr(one, c.name) for c in ViewTracks.columns()}
    values |= {"x_px": [100.0], "y_px": [50.0], "a_px": [20.0], "b_px": [10.0], "rho": [np.pi / 6], "target_id": [2]}
    found = json.loads(export(tmp_path, ViewTracks.of(**values), "c.json").read_text())["annotations"][0]["bbox"]
    phi = np.linspace(0, 2 * np.pi, 100_001)
    along, across = 20 * np.cos(phi), 10 * np.sin(phi)
    x = 100 + along * np.cos(np.pi / 6) - across * np.sin(np.pi / 6)
    y = 50 + along * np.sin(np.pi / 6) + across * np.cos(np.pi / 6)
    np.testing.assert_allclose(found, [x.min(), y.min(), np.ptp(x), np.ptp(y)], atol=1e-6)


def test_trc_has_a_marker_a_target_and_empty_cells(tmp_path: Path) -> None:
    lines = export(tmp_path, tracks(), "t.trc", unit="cm").read_text().split("\n")
    assert lines[2] == "1\t1\t2\t2\tmm\t1\t1\t2"
    assert lines[3].split("\t")[2::3][:2] == ["target_3", "target_7"]
    assert lines[6].split("\t") == ["1", "0.0", "10.0", "0.0", "5.0", "", "", ""]
    assert lines[7].split("\t") == ["2", "1.0", "20.0", "10.0", "2.5", "50.0", "-25.0", "0.0"]


@pytest.mark.parametrize(
    ("args", "code", "message"),
    [
        (["-o", "t.doc"], ExitCode.USAGE, "its name does not state the format; end it in one of .csv"),
        (["-o", "t.json"], ExitCode.BAD_INPUT, "holds truth; expected"),
        (["-o", "t.csv", "--target", "1"], ExitCode.USAGE, "target: format csv writes all rows; leave it out"),
        (["-o", "t.tum", "--camera", "a"], ExitCode.USAGE, "camera: format tum has no images; leave it out"),
        (
            ["-o", "t.geojson"],
            ExitCode.USAGE,
            "origin: format geojson requires the position of the scene's origin on earth",
        ),
        (["-o", "t.csv", "--origin", "1,2"], ExitCode.USAGE, "origin: format csv takes none"),
        (["-o", "t.geojson", "--origin", "north"], ExitCode.USAGE, "'north' is not LAT,LON[,DEG[,HEIGHT]]"),
        (["-o", "t.geojson", "--origin", "85.1,0"], ExitCode.USAGE, "latitude must be within 85 degrees"),
        (["-o", "t.tum", "--target", "9"], ExitCode.BAD_INPUT, "no target 9; there are: 1"),
        (["-o", "t.csv", "--table", "views"], ExitCode.BAD_INPUT, "holds truth; expected views"),
    ],
)
def test_what_cannot_be_is_refused(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    args: list[str],
    code: ExitCode,
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    truth = Truth.of(t_ns=[0], target_id=[1], role=["target"], x=[0.0], y=[0.0], z=[np.nan])
    source = put(tmp_path, truth)
    assert run(["export", source, *args]) == code
    assert message in capsys.readouterr().err
    assert not list(tmp_path.glob("t.*"))


def test_an_origin_at_the_limit_is_taken(tmp_path: Path) -> None:
    assert export(tmp_path, tracks(), "t.geojson", "--origin", "85,180").is_file()
