"""Tables of others: read as the tables of this program, converted, completed, sorted, or refused with the place."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.feather as feather
import pyarrow.ipc
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.cli.main import run
from occlog.errors import InputError
from occlog.io.external import source
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.open import check_unit, is_external, open_if_ours, open_input
from occlog.records.columns import ColumnTable
from occlog.records.tables import Bearings, Boxes, Doa, Occluders, Tracks, Truth, TruthBoxes, Views


def text(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n")
    return path


def same(a: ColumnTable, b: ColumnTable) -> None:
    for c in a.columns():
        np.testing.assert_array_equal(getattr(a, c.name), getattr(b, c.name), err_msg=c.name)


def bearings(rows: int, seed: int = 0) -> Bearings:
    """Random rows, some of which are not seen."""
    rng = np.random.default_rng(seed)
    seen = rng.random(rows) < 0.7
    value = np.where(seen, rng.uniform(-np.pi, np.pi, rows), np.nan)
    return Bearings.of(
        t_ns=1_714_564_800_000_000_000 + np.sort(rng.integers(0, 10**10, rows)),
        sensor=[f"cam{n}" for n in rng.integers(0, 3, rows)],
        target_id=rng.integers(-1, 3, rows),
        seen=seen,
        bearing=value,
        sigma=np.where(seen, 0.01, np.nan),
        u_px=np.full(rows, np.nan),
        sigma_px=np.full(rows, np.nan),
        score=np.where(seen, rng.random(rows), np.nan),
    ).sorted()


def frame_of(table: ColumnTable) -> pd.DataFrame:
    """The columns as pandas has them; NaN becomes a gap."""
    wide = {c.name for c in table.columns() if c.width}
    return pd.DataFrame({c.name: getattr(table, c.name) for c in table.columns() if c.name not in wide})


def write(path: Path, frame: pd.DataFrame, kind: str) -> Path:
    if kind == "parquet":
        frame.to_parquet(path)
    elif kind == "feather":
        feather.write_feather(frame, path)
    elif kind == "stream":
        table = pa.Table.from_pandas(frame)
        with pa.ipc.new_stream(path, table.schema) as sink:
            sink.write_table(table)
    elif kind == "csv.gz":
        with gzip.open(path, "wt") as file:
            frame.to_csv(file, index=False)
    else:
        frame.to_csv(path, index=False)
    return path


@pytest.mark.parametrize("kind", ["parquet", "feather", "stream", "csv", "csv.gz"])
def test_what_pandas_wrote_is_the_same_table(tmp_path: Path, kind: str) -> None:
    table = bearings(50)
    path = write(tmp_path / f"b.{kind}", frame_of(table), kind)
    opened = open_input(path, Bearings)
    assert is_external(path)
    assert opened.table == "bearings"
    same(opened.read(Bearings), table)


@given(seed=st.integers(0, 2**32 - 1), rows=st.integers(1, 40), kind=st.sampled_from(["parquet", "csv"]))
def test_any_bearings_come_back(tmp_path_factory: pytest.TempPathFactory, seed: int, rows: int, kind: str) -> None:
    table = bearings(rows, seed)
    path = write(tmp_path_factory.mktemp("x") / f"b.{kind}", frame_of(table), kind)
    same(open_input(path).read(Bearings), table)


def test_our_own_tables_are_not_of_others(tmp_path: Path) -> None:
    write_table(tmp_path / "b.parquet", bearings(5), Provenance("test"))
    assert not is_external(tmp_path / "b.parquet")
    assert open_input(tmp_path / "b.parquet").external_table is None


def test_degrees_seconds_and_gaps(tmp_path: Path) -> None:
    path = text(tmp_path / "b.csv", "time,station,bearing_deg,sigma_deg", "0.5,w,,", "0,e,190,1", "0,w,-180,2")
    found = open_input(path).read(Bearings)
    assert found.t_ns.tolist() == [0, 0, 500_000_000]
    assert found.sensor.tolist() == ["e", "w", "w"]
    assert found.seen.tolist() == [True, True, False]
    assert found.target_id.tolist() == [-1, -1, -1]
    np.testing.assert_allclose(found.bearing, [np.radians(-170), -np.pi, np.nan])
    np.testing.assert_allclose(found.sigma, [np.radians(1), np.radians(2), np.nan])


@pytest.mark.parametrize(("unit", "metres"), [("cm", 0.01), ("mm", 0.001), ("ft", 0.3048), ("in", 0.0254), ("m", 1.0)])
def test_lengths_are_converted_to_the_unit_of_the_scene(tmp_path: Path, unit: str, metres: float) -> None:
    names = f"t,x_{unit},y_{unit},vx_{unit}_s,vy_{unit}_s,cov_xx_{unit}2,cov_xy_{unit}2,cov_yy_{unit}2"
    opened = open_input(text(tmp_path / "t.csv", names, "0,100,-50,10,0,4,1,9"), Tracks)
    assert opened.length_unit == unit
    check_unit(opened, "m")
    found = opened.read(Tracks)
    np.testing.assert_allclose([found.x[0], found.y[0], found.vx[0]], np.array([100, -50, 10]) * metres)
    np.testing.assert_allclose([found.cov_xx[0], found.cov_xy[0], found.cov_yy[0]], np.array([4, 1, 9]) * metres**2)


def test_lengths_without_a_unit_are_those_of_the_scene(tmp_path: Path) -> None:
    opened = open_input(text(tmp_path / "t.csv", "t,x,y", "0,100,-50"), Truth)
    check_unit(opened, "ft")
    assert opened.length_unit is None
    assert opened.read(Truth).x[0] == 100


def test_times_of_every_kind(tmp_path: Path) -> None:
    wanted = 1_714_564_800_250_000_000
    moment = pd.Timestamp(wanted, tz="UTC")
    columns = {
        "t_ns": [wanted],
        "t_us": [wanted // 1000],
        "t_ms": [1_714_564_800_250.0],
        "timestamp": [moment],
        "frame_time": [moment.tz_localize(None)],
        "time": ["2024-05-01T12:00:00.25Z"],
        "t": [1_714_564_800.25],
        "seconds": pd.array([wanted // 10**9], dtype="Int64"),
    }
    for name, values in columns.items():
        path = write(tmp_path / f"{name}.parquet", pd.DataFrame({name: values, "x": 1.0, "y": 2.0}), "parquet")
        expected = wanted if name != "seconds" else wanted // 10**9 * 10**9
        assert open_input(path, Truth).read(Truth).t_ns.tolist() == [expected], name


@pytest.mark.parametrize(
    ("name", "limit"), [("t_ns", np.nextafter(2.0**62, 0.0)), ("t_us", 2**62 // 1000), ("t_ms", 2**62 // 10**6)]
)
def test_a_time_that_no_number_of_nanoseconds_holds_is_refused(tmp_path: Path, name: str, limit: float) -> None:
    for value in (float(limit), 2.0 * limit, 1e300, -1e300):
        path = write(tmp_path / "t.parquet", pd.DataFrame({name: [value], "x": 1.0, "y": 2.0}), "parquet")
        if value == limit:
            assert open_input(path, Truth).read(Truth).t_ns[0] == pytest.approx(2.0**62, rel=1e-9)
            continue
        with pytest.raises(InputError, match=f"t.parquet: column {name}: a time in {name[2:]} is out of range"):
            open_input(path, Truth).read(Truth)


def test_names_of_kinds_that_databases_write(tmp_path: Path) -> None:
    table = pa.table(
        {
            "t_ns": pa.array([0, 1], pa.int64()),
            "sensor": pa.array(["a", "b"]).dictionary_encode(),
            "target_id": pa.array([0, None], pa.int64()),
            "bearing": pa.array([0.5, None], pa.float32()),
            "sigma": pa.array([1, None]).cast(pa.decimal128(22, 3)),
        }
    )
    pq.write_table(table, tmp_path / "b.parquet")
    found = open_input(tmp_path / "b.parquet").read(Bearings)
    assert found.target_id.tolist() == [0, -1]
    assert found.seen.tolist() == [True, False]
    assert found.sensor.tolist() == ["a", "b"]


def test_boxes_get_numbers_and_frames_by_their_times(tmp_path: Path) -> None:
    path = text(
        tmp_path / "boxes.csv",
        "time,camera,x1,y1,x2,y2,score,track_id",
        "0,a,10,20,30,60,.9,4",
        "0,b,0,0,5,5,.5,",
        "0,a,50,20,70,60,.8,5",
        "1,b,,,,,,",
        "2,a,1,2,3,4,.7,4",
    )
    found = open_input(path, Boxes, Views).read(Boxes)
    assert list(zip(found.sensor.tolist(), found.frame.tolist(), found.box.tolist(), strict=True)) == [
        ("a", 0, 0),
        ("a", 0, 1),
        ("b", 0, 0),
        ("b", 1, -1),
        ("a", 1, 0),
    ]
    assert found.target_id.tolist() == [4, 5, -1, -1, 4]
    np.testing.assert_array_equal(found.width_px, [20, 20, 5, np.nan, 2])


def test_frames_are_numbered_on_from_part_to_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = [f"{n // 2},{'ab'[n % 2]},1,1,2,2" for n in range(20)]
    path = text(tmp_path / "boxes.csv", "time,camera,left,top,width,height", *lines)
    frame = pd.read_csv(path)
    frame.to_parquet(tmp_path / "boxes.parquet")
    monkeypatch.setattr(source, "ROWS", 3)
    found = open_input(tmp_path / "boxes.parquet", Boxes).read(Boxes)
    assert found.frame.tolist() == [n // 2 for n in range(20)]
    assert (found.box == 0).all()


@pytest.mark.parametrize(
    ("wants", "lines", "message"),
    [
        (
            Bearings,
            ("time,station,bearing_deg,sigma_deg", "0,e,1,x"),
            "line 2: sigma_deg is 'x'; a number was expected",
        ),
        (Bearings, ("time,station,bearing_deg,sigma_deg", "0,e,1,"), "line 2: bearing_deg has a value, and sigma_deg"),
        (Bearings, ("time,station,bearing_deg,sigma_deg", "0,e,1,0"), "line 2: sigma_deg is 0; it must be above 0"),
        (
            Bearings,
            ("time,station,bearing_rad,sigma_rad", "0,e,1,1e-300"),
            "sigma_rad is 1e-300; it must be at least 1e-15",
        ),
        (Bearings, ("time,station,bearing_rad,sigma_rad", "0,e,190,1"), "line 2: bearing_rad is 190 rad; if it is in"),
        (
            Bearings,
            ("time,station,bearing_rad,sigma_rad,u_px,sigma_px", "0,e,1,1,3,1e-12"),
            "line 2: sigma_px is 1e-12; it must be at least 1e-09 px",
        ),
        (
            Bearings,
            ("time,station,bearing_rad,sigma_rad,u_px,sigma_px", "0,e,1,1,3,1e300"),
            r"line 2: sigma_px is 1e\+300; it must be within 1e\+15",
        ),
        (
            Occluders,
            ("t,id,x,y,cov_xx,cov_xy,cov_yy", "0,1,1,1,1e300,0,1"),
            r"line 2: cov_xx is 1e\+300; it must be within 1e\+30",
        ),
        (
            Doa,
            ("time,array,azimuth_deg,elevation_deg", "0,e,1,91"),
            "line 2: elevation_deg is 91; it must be",
        ),
        (Boxes, ("time,camera,x1,y1,x2,y2", "0,a,3,3,3,4"), "line 2: x2 gives a width of 0; it must be above 0"),
        (Boxes, ("time,camera,left,top,width,height,score", "0,a,1,1,1,1,70"), "score is 70; it must be 0 to 1"),
        (
            Boxes,
            ("time,camera,left,top,width,height,score", "0,a,1,1,1,1,1.0000001"),
            "score is 1.0000001; it must be 0 to 1",
        ),
        (Truth, ("t,id,x,y", "0,1,1,1", "0,1,2,2"), r"rows 0 and 1 \(from 0\): target_id 1 is twice at 0 s"),
        (Truth, ("t,id,x,y", "0,1.5,1,1"), "line 2: id is '1.5'; a whole number was expected"),
        (Truth, ("t,id,x,y", "1e12,1,1,1"), "known to 1e\\+09 s only"),
        (
            Truth,
            ("t,id,x,y", "5,1,1,1", "1714564800000,1,1,1"),
            "line 2: times 5 and 1714564800000 are in several units",
        ),
        (
            Truth,
            ("t,id,x,y", "2024-10-27T02:30:00+02:00,1,1,1", "2024-10-27T03:30:00,1,1,1"),
            "line 3: time '2024-10-27T03:30:00': some times of the column have a time zone",
        ),
        (Truth, ("t,id,x,y", "2016-12-31T23:59:60Z,1,1,1"), "line 2: .*: a leap second"),
        (Truth, ("t,id,x,y,role", "0,1,1,1,ghost"), "among rows 0 to 0: .*role 'ghost' must be target or occluder"),
        (Tracks, ("t,id,u,v", "0,1,1,1"), "tracks requires x; y; the file has t, id, u, v"),
        (Occluders, ("t,id,x,y", "0,1,1,1"), "occluders requires cov_xx; cov_xy; cov_yy; the file has t, id, x, y"),
    ],
)
def test_what_does_not_fit_is_refused_with_its_place(
    tmp_path: Path, wants: type[ColumnTable], lines: tuple[str, ...], message: str
) -> None:
    path = text(tmp_path / "w.csv", *lines)
    with pytest.raises(InputError, match=message) as error:
        open_input(path, wants).read(wants)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


NOON = 1_714_564_800_000_000_000


@pytest.mark.parametrize("times", ["1714564800", "1714564800000", "1714564800000000", "1714564800000000000"])
@pytest.mark.parametrize("kind", ["csv", "tum", "parquet"])
def test_times_without_a_unit_have_that_of_their_size(tmp_path: Path, times: str, kind: str) -> None:
    path = tmp_path / f"t.{kind}"
    if kind == "parquet":
        pq.write_table(pa.table({"t": [int(times)], "id": [1], "x": [1.0], "y": [2.0]}), path)
    elif kind == "tum":
        text(path, f"{times} 1 2 0 0 0 0 1")
    else:
        text(path, "t,id,x,y", f"{times},1,1,2")
    assert open_input(path, Truth).read(Truth).t_ns.tolist() == [NOON]


@pytest.mark.parametrize("zone", ["Z", "+00", "+00:00", "+0000"])
def test_zones_are_written_with_or_without_minutes(tmp_path: Path, zone: str) -> None:
    path = text(tmp_path / "t.csv", "time,id,x,y", f"2024-05-01 12:00:00.000000{zone},1,1,1")
    assert open_input(path, Truth).read(Truth).t_ns.tolist() == [NOON]


def test_units_in_brackets_and_a_header_behind_a_hash_mark_are_read(tmp_path: Path) -> None:
    euroc = text(
        tmp_path / "data.csv",
        "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []",
        f"{NOON},1.5,2.5,0.5,1,0,0,0",
    )
    found = open_input(euroc, Truth)
    assert found.length_unit == "m"
    table = found.read(Truth)
    assert (table.t_ns.tolist(), table.x.tolist(), table.z.tolist()) == ([NOON], [1.5], [0.5])
    spaced = text(tmp_path / "b.csv", "time (ms),pos x [cm],pos y [cm],bearing [deg]", "1500,10,20,90")
    table = open_input(spaced, Truth).read(Truth)
    assert (table.t_ns.tolist(), table.x.tolist()) == ([1_500_000_000], [10.0])
    # A comment of words, or one above a header, names no columns
    comment = text(tmp_path / "c.csv", "# made by me, on a Monday, x", "t,x,y", "1,2,3")
    assert open_input(comment, Truth).read(Truth).x.tolist() == [2.0]


def test_a_folder_of_parquet_is_one_table(tmp_path: Path) -> None:
    folder = tmp_path / "walks"
    for identity in (7, 3):
        part = folder / f"id={identity}"
        part.mkdir(parents=True)
        pq.write_table(
            pa.table({"t": [0.0, 0.1], "x": [1.0 * identity, 2.0], "y": [0.0, 0.0]}), part / "part-0.parquet"
        )
    (folder / "_SUCCESS").touch()
    opened = open_input(folder, Tracks)
    table = opened.read(Tracks)
    assert is_external(folder)
    assert table.target_id.tolist() == [3, 7, 3, 7]
    assert table.x.tolist() == [3.0, 7.0, 2.0, 2.0]
    pq.write_table(pa.table({"t": [0.0], "x": [1.0], "z": [0.0]}), folder / "id=7" / "part-1.parquet")
    with pytest.raises(
        InputError, match=r"part-1\.parquet: columns y, z are in this file or in part-0\.parquet, but not"
    ):
        open_input(folder, Tracks)
    (folder / "notes.txt").touch()
    with pytest.raises(InputError, match="is a folder"):
        open_input(folder, Tracks)


@pytest.mark.parametrize(
    ("case", "tracks", "truth"),
    [
        ("c21_tum_ns", "ns_int.tum", "truth.csv"),
        ("c23_euroc", "est.csv", "euroc.csv"),
        ("c25_duckdb", "duck.csv", "truth.csv"),
    ],
)
def test_tables_as_other_programs_write_them_are_evaluated(
    shared_cases: Path, case: str, tracks: str, truth: str, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [str(shared_cases / case / name) for name in (tracks, truth)]
    assert run(["evaluate", files[0], "--truth", files[1], "--match", "optimal", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rmse_m"] == pytest.approx(0.0767, abs=5e-5)


def test_a_folder_of_parts_by_identity_is_described(shared_cases: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", str(shared_cases / "c30_hive" / "hive"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["table"], found["rows"], found["columns"]["id"]) == ("tracks", 120, "target_id")


@pytest.mark.parametrize(
    ("column", "values", "message"),
    [
        ("x", ["a"], "row 0: x is 'a'; a number was expected"),
        ("x", [None], "row 0: x is null; a finite number was expected"),
        ("x", [np.inf], "row 0: x is inf; a finite number was expected"),
        ("id", [1.5], "row 0: id is 1.5; a whole number was expected"),
        ("id", [None], "row 0: id is null"),
        ("t", [None], "row 0: t is null; a time was expected"),
        ("t", [1e25], "column t: a time in ns is out of range"),
    ],
)
def test_cells_of_columns_are_refused_with_their_row(
    tmp_path: Path, column: str, values: list[object], message: str
) -> None:
    whole: dict[str, list[object]] = {"t": [0.0], "id": [1], "x": [1.0], "y": [1.0], column: values}
    table = pa.table({name: pa.array(v) for name, v in whole.items()})
    if values == [None]:
        kind = {"x": pa.float64(), "id": pa.int64(), "t": pa.float64()}[column]
        table = table.set_column(table.schema.get_field_index(column), column, pa.array(values, kind))
    pq.write_table(table, tmp_path / "t.parquet")
    with pytest.raises(InputError, match=message):
        open_input(tmp_path / "t.parquet", Truth).read(Truth)


@pytest.mark.parametrize(
    ("sensors", "word"),
    [
        (pa.array(["a", "b", ""]), "empty"),
        (pa.array(["a", "b", None]), "null"),
        (pa.DictionaryArray.from_arrays(pa.array([0, 1, 2], pa.int8()), pa.array(["a", "b", None])), "empty"),
    ],
)
def test_a_sensor_without_a_name_is_refused_as_in_text(tmp_path: Path, sensors: pa.Array, word: str) -> None:
    columns = {"t_ns": [1, 2, 3], "sensor": sensors, "bearing": [0.1] * 3, "sigma": [0.1] * 3}
    feather.write_feather(pa.table(columns), path := tmp_path / "a.feather")
    with pytest.raises(InputError, match=f"row 2: sensor is {word}; a text was expected"):
        open_input(path, Bearings).read(Bearings)


def test_a_file_is_what_a_command_wants_of_it(tmp_path: Path) -> None:
    """Places with a time are tracks or a truth, whichever is wanted; alone they are taken for tracks."""
    path = text(tmp_path / "p.csv", "t,id,x,y", "0,1,1,1")
    assert open_input(path).table == "tracks"
    assert open_input(path, Truth, TruthBoxes).table == "truth"
    assert open_input(path).read(Truth).role.tolist() == ["target"]
    assert np.isnan(open_input(path).read(Tracks).cov_xx).all()


def test_other_files_are_left_to_their_readers(tmp_path: Path) -> None:
    assert open_if_ours(text(tmp_path / "m.csv", "1,1,10,10,5,5,1,-1,-1,-1")) is None
    assert open_if_ours(text(tmp_path / "scene.yaml", "occlog_scene: 1")) is None
    assert open_if_ours(text(tmp_path / "stations.csv", "name,x,y", "a,1,2")) is None
    with pytest.raises(InputError, match="bearings requires t_ns"):
        open_input(text(tmp_path / "x.csv", "station,bearing_deg,sigma_deg", "a,1,2"), Bearings)


@pytest.mark.parametrize("content", [b"\x1f\x8b\x08\x00broken", b"ARROW1\x00\x00junk", b"\xff\xff\xff\xff\x00\x00"])
def test_damaged_files_are_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"x\.csv.*(damaged|again)") as error:
        open_input(path, Bearings).read(Bearings)
    assert "\n" not in str(error.value)


def test_a_cut_gzip_file_says_so(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    lines = "".join(f"{n},{x},{y}\n" for n, (x, y) in enumerate(rng.random((3000, 2))))
    whole = gzip.compress(("t,x,y\n" + lines).encode())
    (tmp_path / "t.csv.gz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="damaged gzip file"):
        open_input(tmp_path / "t.csv.gz", Truth).read(Truth)


@pytest.mark.parametrize("stated", [0x00, 0x7F])
def test_a_column_that_states_no_values_is_refused(tmp_path: Path, stated: int) -> None:
    """The library ends at such a column without a word, where it reads batches."""
    path = tmp_path / "t.parquet"
    pd.DataFrame({"time": np.arange(8) / 10.0, "x": 1.0, "y": 2.0}).to_parquet(path, index=False)
    data = bytearray(path.read_bytes())
    head = b"\x18\x01y\x15\x02\x16"  # of column y: path_in_schema, codec, num_values
    at = data.rindex(head) + len(head)
    assert data[at] == 0x10  # 8
    data[at] = stated
    path.write_bytes(data)
    with pytest.raises(InputError, match="8 rows are stated, and 0 can be read"):
        open_input(path, Truth).read(Truth)
