"""Tables that are nearly right: what is stated of them, and that none is read as something else in silence."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode, InputError, did_you_mean
from occlog.io.open import open_input
from occlog.records.tables import Bearings, Boxes, Doa, Tracks, Truth


def text(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("names", ["angle_deg,sigma_deg", "heading_deg,std_deg", "baering_deg,sigma_deg"])
def test_angles_of_unknown_names_are_no_reads_of_tags(tmp_path: Path, names: str) -> None:
    with pytest.raises(InputError, match="bearings requires bearing"):
        open_input(text(tmp_path / "t.csv", f"time,station,id,{names}", "0,a,1,10,1"))


def test_reads_of_tags_are_known_by_a_name_of_their_own(tmp_path: Path) -> None:
    assert open_input(text(tmp_path / "t.csv", "time,reader,tag,note", "0,a,1,x")).table == "reads"


@pytest.mark.parametrize("name", ["bearing_std_deg", "std_deg", "sd_bearing_deg", "bearing_sigma_deg"])
def test_standard_deviations_may_be_called_so(tmp_path: Path, name: str) -> None:
    opened = open_input(text(tmp_path / "t.csv", f"time,station,id,bearing_deg,{name}", "0,a,1,10,2"))
    assert opened.table == "bearings"
    assert opened.read(Bearings).sigma[0] == np.radians(2)


@pytest.mark.parametrize(
    ("header", "row", "message"),
    [
        ("time,id,x,x,y", "0,1,1,1,2", "columns 'x' and 'x' are read as the same name"),
        ("id,x,x,y", "1,1,1,2", "two columns are called 'x'; remove or rename one"),
        ("time,id,x_mm,y_m", "0,1,1000,2", "columns x_mm and y_m have different units"),
        ("id,x_mm,y_m", "1,1000,2", "positions are in m and mm; state all in one unit"),
        ("frame,id,x,y", "0,1,1,2", "column frame counts frames, and truth requires times"),
    ],
)
def test_a_table_with_another_fault_is_none_of_stations(tmp_path: Path, header: str, row: str, message: str) -> None:
    """R28: each of these was called a table of stations."""
    with pytest.raises(InputError, match=message):
        open_input(text(tmp_path / "t.csv", header, row), Truth)


def test_stations_in_place_of_bearings_are_a_scene(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds the positions of stations, not their measurements"):
        open_input(text(tmp_path / "t.csv", "name,x,y", "a,0,0"))


def test_a_table_of_another_kind_says_what_it_holds(tmp_path: Path) -> None:
    opened = open_input(text(tmp_path / "t.csv", "time,id,x,y", "0,1,0,0"))
    with pytest.raises(InputError, match="with its present columns it is read as tracks"):
        opened.require(Bearings, Doa)


def test_a_decimal_comma_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="line 2: '0,5' has a decimal comma; write it with a point"):
        open_input(text(tmp_path / "t.csv", "time;id;x;y", "0,5;1;0;0")).read(Truth)


def test_a_name_in_other_letters_is_the_nearest() -> None:
    assert did_you_mean("EAST", ("west", "east")) == "did you mean 'east'?"


def test_times_in_milliseconds_that_are_taken_for_seconds_are_doubted(tmp_path: Path, capsys: Any) -> None:
    scene = text(tmp_path / "stations.csv", "name,x,y", "a,0,0", "b,10,0")
    rows = [f"{500 * k},{name},1,{angle},1" for k in range(6) for name, angle in (("a", 45), ("b", 135))]
    table = text(tmp_path / "t.csv", "time,station,id,bearing_deg,sigma_deg", *rows)
    args = ["track", str(table), "--scene", str(scene), "--method", "ekf", "-o", str(tmp_path / "o.parquet")]
    assert run(args) == ExitCode.DONE
    assert "--input-units t=ms" in capsys.readouterr().err
    assert run([*args, "--overwrite", "--input-units", "ms"]) == ExitCode.DONE
    assert "--input-units" not in capsys.readouterr().err


def test_widths_that_contradict_the_edges_are_of_the_image(tmp_path: Path) -> None:
    head = "time,sensor,width,height,xmin,ymin,xmax,ymax"
    opened = open_input(text(tmp_path / "t.csv", head, "0,a,1280,720,10,20,80.5,90"))
    with pytest.raises(InputError, match=r"line 2: width is 1280, but xmax is 80\.5 and the near edge 10"):
        opened.read(Boxes)
    assert open_input(text(tmp_path / "t.csv", head, "0,a,70,71,10,20,80.5,90")).read(Boxes).width_px[0] == 70


def test_an_angle_without_a_unit_next_to_one_in_degrees_is_not_in_radians(tmp_path: Path) -> None:
    path = text(tmp_path / "t.csv", "t_ns,sensor,bearing_deg,sigma", "0,a,10,2")
    with pytest.raises(InputError, match="column sigma does not state its unit"):
        open_input(path).read(Bearings)


def parquet(tmp_path: Path, **columns: pa.Array) -> Path:
    pq.write_table(pa.table(columns), tmp_path / "t.parquet")
    return tmp_path / "t.parquet"


@pytest.mark.parametrize("name", ["t_ns", "id"])
def test_whole_numbers_above_63_bits_are_refused(tmp_path: Path, name: str) -> None:
    """An exception of Arrow."""
    columns = {"t_ns": pa.array([0]), "x": pa.array([1.0]), "y": pa.array([1.0])}
    path = parquet(tmp_path, **(columns | {name: pa.array([2**63 + 5], pa.uint64())}))
    with pytest.raises(InputError, match=f"row 0: {name} is 9223372036854775813; a whole number was expected"):
        open_input(path).read(Truth)


@pytest.mark.parametrize("value", [2**53 + 1, -(2**53) - 1, 2**63])
def test_whole_numbers_that_float64_does_not_hold_are_refused(tmp_path: Path, value: int) -> None:
    kind = pa.uint64() if value == 2**63 else pa.int64()
    columns = {"t_ns": pa.array([1, 2]), "id": pa.array([1, 1]), "y": pa.array([0.0, 1.0])}
    path = parquet(tmp_path, **columns, x=pa.array([2**53, value], kind))
    with pytest.raises(InputError, match=f"row 1: x is {value}; a number within {2**53} was expected"):
        open_input(path).read(Truth)
    good = parquet(tmp_path, **columns, x=pa.array([2**53, None], kind))
    with pytest.raises(InputError, match="row 1: x is null"):
        open_input(good).read(Truth)


def test_texts_that_are_not_utf_8_are_damage(tmp_path: Path) -> None:
    text = pa.Array.from_buffers(
        pa.string(), 1, [None, pa.py_buffer(np.array([0, 1], np.int32)), pa.py_buffer(b"\xff")]
    )
    path = parquet(tmp_path, t_ns=pa.array([1]), sensor=text, azimuth_deg=pa.array([0.0]))
    with pytest.raises(InputError, match=r"damaged or not a Parquet file .*UTF8"):
        open_input(path).read(Doa)


@pytest.mark.parametrize(("name", "digits"), [("t_ns", 0), ("t", 9)])
def test_times_in_decimals_are_exact(tmp_path: Path, name: str, digits: int) -> None:
    """They went through float64, which has no ns since 1970."""
    time = Decimal(1_714_562_400_123_456_789).scaleb(-digits)
    path = parquet(
        tmp_path, **{name: pa.array([time], pa.decimal128(20, digits)), "x": pa.array([1.0]), "y": pa.array([1.0])}
    )
    assert open_input(path).read(Truth).t_ns.tolist() == [1_714_562_400_123_456_789]


def test_columns_of_one_name_in_other_letters_are_refused(tmp_path: Path) -> None:
    """The first one counted."""
    path = parquet(tmp_path, t_ns=pa.array([0]), x=pa.array([1.0]), X=pa.array([5.0]), y=pa.array([1.0]))
    with pytest.raises(InputError, match="columns 'x' and 'X' are read as the same name; keep one"):
        open_input(path).read(Truth)


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        ("t_ns,x,y/9e18,1,1", "t_ns is '9e18'"),
        ("t_ns,x,y/9000000000000000000,1,1", "out of range"),
        ("t,x,y/1_0,1,1", "neither a number"),
    ],
)
def test_times_that_cannot_be_are_refused(tmp_path: Path, cells: str, expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        open_input(text(tmp_path / "t.csv", *cells.split("/"))).read(Truth)


@pytest.mark.parametrize(
    ("name", "value", "kind", "expected"),
    [
        ("t", 1_714_562_800.25, pa.float32(), "t is 1714562816 in float: known to 128 s only, and 1 ms is the limit"),
        ("t_ns", 1.7e18, pa.float32(), "known to 137.439 s only"),
        ("t", 20_000.5, pa.float32(), "known to 0.00195312 s only"),
        ("t", 9.0, pa.float16(), "in halffloat: known to 0.0078125 s only"),
        ("t", "1.7145628e+09", pa.string(), "known to 100 s only"),
    ],
)
def test_times_in_floats_that_are_too_short_are_refused(
    tmp_path: Path, name: str, value: object, kind: pa.DataType, expected: str
) -> None:
    """They collapsed to every 128th second without a word."""
    numbers = [np.float16(value)] if kind == pa.float16() else [value]
    path = parquet(tmp_path, **{name: pa.array(numbers, kind), "x": pa.array([1.0]), "y": pa.array([1.0])})
    with pytest.raises(InputError, match=f"row 0: .*{expected}"):
        open_input(path).read(Truth)


def test_times_in_floats_that_are_long_enough_are_read(tmp_path: Path) -> None:
    path = parquet(tmp_path, t=pa.array([0.0, 8000.5], pa.float32()), x=pa.array([1.0, 1]), y=pa.array([1.0, 1]))
    assert open_input(path).read(Truth).t_ns.tolist() == [0, 8_000_500_000_000]


def test_times_in_text_that_lost_digits_are_refused(tmp_path: Path) -> None:
    """So pandas writes float32, and MATLAB all but the first five digits."""
    path = text(tmp_path / "t.csv", "t,x,y", "1.7145628e+09,1,1")
    with pytest.raises(InputError, match=r"line 2: time '1\.7145628e\+09': known to 100 s only.*write all digits"):
        open_input(path).read(Truth)
    path.write_text("t,x,y\n1.714562800250000000e+09,1,1\n")
    assert open_input(path).read(Truth).t_ns.tolist() == [1_714_562_800_250_000_000]


@pytest.mark.parametrize(
    ("name", "x", "expected"),
    [
        ("x", pa.array([5_500_000.3], pa.float32()), "x is known to 0.5 only, and 0.01 is the limit"),
        ("x_cm", pa.array([2e7], pa.float32()), "x_cm is known to 2 cm only, and 1 cm is the limit"),
        ("x", pa.array([100.0], pa.float16()), "x is known to 0.0625 only"),
        ("x", "5.50031e+06", "line 2: x is known to 10 only"),
    ],
)
def test_places_in_floats_that_are_too_short_are_refused(
    tmp_path: Path, name: str, x: pa.Array | str, expected: str
) -> None:
    """Northings of UTM in float32 lie half a metre apart."""
    y = "y_cm" if name == "x_cm" else "y"
    if isinstance(x, str):
        path = text(tmp_path / "t.csv", "t,x,y", f"0,{x},1")
    else:
        path = parquet(tmp_path, **{"t_ns": pa.array([0]), name: x, y: pa.array([1.0])})
    with pytest.raises(InputError, match=expected):
        open_input(path).read(Truth)


def test_places_in_short_floats_that_are_near_are_read(tmp_path: Path) -> None:
    near = pa.array([1000.5], pa.float32())
    for columns in ({"x": near, "y": near}, {"x_mm": near, "y_mm": near}):
        path = parquet(tmp_path, t_ns=pa.array([0]), **columns)
        assert open_input(path).read(Truth).x.tolist() == [1000.5]


@pytest.mark.parametrize(
    ("table", "head", "row"),
    [
        (Bearings, "t,sensor,id,bearing_deg,sigma_deg", "a,1,10,1"),
        (Bearings, "t,sensor,bearing_deg,sigma_deg", "a,10,1"),
        (Doa, "t,sensor,azimuth_deg", "a,10"),
        (Boxes, "t,sensor,left,top,width,height", "a,1,2,3,4"),
    ],
)
def test_rows_that_stand_there_twice_are_refused(tmp_path: Path, table: Any, head: str, row: str) -> None:
    """A table that was exported twice counted each direction twice."""
    path = text(tmp_path / "t.csv", head, f"0,{row}", f"1,{row}", f"0,{row}")
    with pytest.raises(InputError, match=r"row 2 \(from 0\) is a duplicate"):
        open_input(path).read(table)
    assert len(open_input(text(tmp_path / "t.csv", head, f"0,{row}", f"1,{row}")).read(table)) == 2


def test_sensors_that_looked_for_several_without_names_are_no_copies(tmp_path: Path) -> None:
    path = text(tmp_path / "t.csv", "t,sensor,bearing_deg,sigma_deg", "0,a,,", "0,a,,")
    assert open_input(path).read(Bearings).seen.tolist() == [False, False]


def test_names_that_an_array_would_cut_are_refused(tmp_path: Path) -> None:
    """Two sensors became one."""
    names = pa.array(["a\0b", "a\0c"])
    path = parquet(tmp_path, t_ns=pa.array([0, 0]), sensor=names, azimuth_deg=pa.array([1.0, 2.0]))
    with pytest.raises(InputError, match=r"column sensor: 'a\\x00.': a text must not contain the character 0"):
        open_input(path).read(Doa)


@pytest.mark.parametrize(
    ("time", "message"),
    [
        ("1714564800,25", "has a decimal comma; write it with a point"),
        ("1,714,564,800.25", "has separators of thousands; write digits alone"),
        ("12:00:00.25", "is a time of day without its date"),
        ("2024-05-01 14:00:00 CEST", "has a zone by name; write its offset"),
        ("2024-05-01 14:00:00 Europe/Berlin", "has a zone by name; write its offset"),
        ("05/01/2024 02:00:00 PM", "has hours of 12"),
        ("01.05.2024 12:00", "is a date that may be read in several orders"),
        ("05/01/2024", "is a date that may be read in several orders"),
        ("", "is missing; remove the row"),
        ("NaT", "is missing; remove the row"),
        ("noon", "neither a number nor a date and time such as .*; correct or remove this row"),
    ],
)
def test_a_time_that_is_not_read_is_refused_with_its_reason(tmp_path: Path, time: str, message: str) -> None:
    with pytest.raises(InputError, match=f"line 2: (time )?'{time}':? {message}"):
        open_input(text(tmp_path / "t.csv", "time;id;x;y", f'"{time}";1;1;2'.replace('""', ""))).read(Truth)


@pytest.mark.parametrize("zone", ["UTC", " UTC", "GMT", "Z", "+00", "+00:00"])
def test_utc_has_several_names(tmp_path: Path, zone: str) -> None:
    read = open_input(text(tmp_path / "t.csv", "time,id,x,y", f"2024-05-01 12:00:00.25{zone},1,1,2")).read(Truth)
    assert read.t_ns.tolist() == [1_714_564_800_250_000_000]


@pytest.mark.parametrize("value", ["", "NA", "NaN", "-", "null", "#N/A", "<NA>", "\\N"])
def test_a_missing_position_is_refused_with_its_line(tmp_path: Path, value: str) -> None:
    with pytest.raises(InputError, match=r"line 3: x is missing .*; remove this line"):
        open_input(text(tmp_path / "t.csv", "time,id,x,y", "0,1,1,2", f"1,1,{value},2")).read(Truth)


ROWS = ("time{0}id{0}x{0}y", "0{0}1{0}1.5{0}2", "1{0}1{0}2.5{0}2")


@pytest.mark.parametrize(
    ("encoding", "mark", "before"),
    [("utf-16", "\t", ""), ("utf-16", ",", ""), ("utf-8-sig", ";", "sep=;\r\n"), ("utf-8", "\t", "sep=\t\n")],
)
def test_texts_of_spreadsheets_are_read(tmp_path: Path, encoding: str, mark: str, before: str) -> None:
    path = tmp_path / "t.csv"
    path.write_text(before + "\n".join(ROWS).format(mark) + "\n", encoding=encoding)
    assert open_input(path).read(Truth).x.tolist() == [1.5, 2.5]


def test_names_of_rows_and_two_tables_in_one_file_are_stated(tmp_path: Path) -> None:
    of_r = text(tmp_path / "r.txt", '"time" "id" "x" "y"', '"1" 0 1 1.5 2')
    with pytest.raises(InputError, match=r"line 2: 5 cells, but the first line has 4; if the first are names of rows"):
        open_input(of_r).read(Truth)
    two = [row.format(",") for row in ROWS]
    with pytest.raises(InputError, match="line 4: a second header line, so two tables in one file"):
        open_input(text(tmp_path / "two.csv", *two, *two)).read(Truth)


def test_positions_without_times_are_no_stations(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no column of times or frame numbers among sec, nsec, id, x, y"):
        open_input(text(tmp_path / "t.csv", "sec,nsec,id,x,y", "0,5,1,1,2", "1,5,1,1,2"))


def test_times_of_whole_seconds_are_stated_where_they_repeat(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"is twice at 5 s; times are whole seconds: write their fractions"):
        open_input(text(tmp_path / "t.csv", "time,id,x,y", "5,1,1,2", "5,1,1,2")).read(Truth)


@pytest.mark.parametrize("kind", ["set back", "grouped", "shuffled", "falling", "in order"])
def test_a_clock_that_was_set_back_is_stated(tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str) -> None:
    """Two people, 40 times: from the 20th on the clock is 30 s behind; other orders are no fault."""
    steps = list(range(40))
    times = {"set back": [k - 300 * (k >= 20) for k in steps], "falling": steps[::-1]}.get(kind, steps)
    rows = [(t, person) for t in times for person in (1, 2)]
    if kind == "grouped":
        rows.sort(key=lambda row: row[1])
    if kind == "shuffled":
        rows = [rows[n] for n in np.random.default_rng(0).permutation(len(rows)).tolist()]
    path = text(tmp_path / "t.csv", "time,id,x,y", *(f"{1000 + t / 10},{person},{person},2" for t, person in rows))
    assert run(["diff", str(path), str(path)]) == ExitCode.DONE
    stderr = capsys.readouterr().err
    assert ("row 40: time goes back by 29.9 s" in stderr) == (kind == "set back")
    assert ("goes back" in stderr) == (kind == "set back")


@pytest.mark.parametrize(
    ("column", "count", "words"), [("t_ms", 2**32, "32 bits in ms"), ("t_us", 2**32, "32 bits in us")]
)
def test_a_counter_that_begins_again_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], column: str, count: int, words: str
) -> None:
    step = 100 if column == "t_ms" else 100_000
    rows = [f"{(count + (k - 20) * step) % count},1,{k},2" for k in range(40)]
    path = text(tmp_path / "t.csv", f"{column},id,x,y", *rows)
    assert run(["diff", str(path), str(path)]) == ExitCode.DONE
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(("epoch", "program"), [(621_355_968, ".NET"), (116_444_736, "Windows")])
def test_ticks_of_100_ns_are_no_nanoseconds(tmp_path: Path, epoch: int, program: str) -> None:
    """They were read as times of 1990 and 1974 that last a hundredth."""
    ticks = [epoch * 10**9 + (1_714_564_800 + k) * 10**7 for k in range(3)]
    path = text(tmp_path / "t.csv", "time,id,x,y", *(f"{t},1,0,0" for t in ticks))
    with pytest.raises(InputError, match=program):
        open_input(path).read(Truth)


@pytest.mark.parametrize(("x", "reported"), [(17437, True), (45, False)])
def test_a_position_without_its_decimal_point_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], x: float, reported: bool
) -> None:
    rows = [f"{t},1,{x if t == 75 else 10 + 0.05 * t},2.5" for t in range(200)]
    opened = open_input(text(tmp_path / "t.csv", "time,id,x,y", *rows))
    assert len(opened.read(Truth)) == 200
    assert ("1 of 200 positions are" in capsys.readouterr().err) == reported


@pytest.mark.parametrize(("lost", "reported"), [("0,0", True), ("0.01,0", False)])
def test_missing_positions_that_are_written_as_zero_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], lost: str, reported: bool
) -> None:
    rows = [f"{t},1,{lost}" if 20 <= t < 25 else f"{t},1,{3 + 0.01 * t:.2f},2.5" for t in range(60)]
    opened = open_input(text(tmp_path / "t.csv", "time,id,x,y", *rows))
    assert len(opened.read(Tracks)) == 60
    assert ("5 of 60 positions are exactly (0, 0), the first in row 20" in capsys.readouterr().err) == reported
