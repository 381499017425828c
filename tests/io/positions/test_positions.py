"""Files of positions on the ground: units, times, grids, errors, and what is refused."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from occlog.errors import InputError, UsageError
from occlog.io.files.timing.frame_times import FrameTimes
from occlog.io.formats.positions import PositionGrid, PositionOptions, parse_grid, read_positions

WILDTRACK = PositionGrid(0.025, -3.0, -9.0)
TEN = {"": FrameTimes("given", rate=Fraction(10))}


def written(folder: Path, text: str, name: str = "bev.csv") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_text_of_mvdet_has_frame_and_cells(tmp_path: Path) -> None:
    path = written(tmp_path, "1800 308 660\n1800 392 824\n1805 284 528\n", "test.txt")
    log = read_positions(path, PositionOptions(times=TEN, grid=WILDTRACK))
    there = log.table.take(log.table.detection >= 0)
    # The first cell is across (480 of them), the second along (1440), 2.5 cm each, from (-3 m, -9 m)
    np.testing.assert_allclose(there.x, [4.7, 6.8, 4.1])
    np.testing.assert_allclose(there.y, [7.5, 11.6, 4.2])
    assert there.t_ns.tolist() == [180 * 10**9, 180 * 10**9, 180_500_000_000]
    assert there.detection.tolist() == [0, 1, 0]
    assert log.sources == ("test",)


def test_cells_without_a_grid_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path, "0 346 951\n0 240 934\n", "gt.txt")
    with pytest.raises(UsageError, match="cells of a grid"):
        read_positions(path, PositionOptions(times=TEN))


def test_times_scores_and_errors_of_a_table(tmp_path: Path) -> None:
    text = "time,x,y,score,cov_xx,cov_xy,cov_yy,sensor\n"
    text += "2.5,1.0,2.0,0.9,0.04,0.01,0.09,radar\n0.5,3.0,4.0,0.8,,,,lidar\n"
    table = read_positions(written(tmp_path, text), PositionOptions(start_ns=10**9)).table
    assert table.t_ns.tolist() == [1_500_000_000, 3_500_000_000]
    assert table.sensor.tolist() == ["lidar", "radar"]
    np.testing.assert_allclose(table.cov_xx, [np.nan, 0.04])
    np.testing.assert_allclose(table.cov_xy, [np.nan, 0.01])
    np.testing.assert_allclose(table.confidence, [0.8, 0.9])


def test_a_standard_deviation_is_a_covariance(tmp_path: Path) -> None:
    table = read_positions(written(tmp_path, "t_ns,x,y,sigma\n5,1,2,0.3\n"), PositionOptions()).table
    np.testing.assert_allclose([table.cov_xx[0], table.cov_xy[0], table.cov_yy[0]], [0.09, 0.0, 0.09])


def test_frames_between_without_a_position_are_frames_without_a_detection(tmp_path: Path) -> None:
    rows = "".join(f"{frame},1,2\n" for frame in (*range(0, 60, 5), 70))
    table = read_positions(written(tmp_path, "frame,x,y\n" + rows), PositionOptions(times=TEN)).table
    empty = table.take(table.detection < 0)
    assert empty.frame.tolist() == [60, 65]
    assert empty.t_ns.tolist() == [6_000_000_000, 6_500_000_000]
    assert np.isnan(empty.x).all()


def test_repeated_rows_count_once(tmp_path: Path) -> None:
    log = read_positions(written(tmp_path, "t_ns,x,y\n5,1,2\n5,1,2\n5,1,3\n"), PositionOptions())
    assert log.duplicates == 1
    assert log.table.y.tolist() == [2.0, 3.0]


def test_parquet_has_the_same_columns(tmp_path: Path) -> None:
    path = tmp_path / "bev.parquet"
    columns = {"t_ns": [7, 8], "X": [0.1, 0.2], "y": [1.5, 2.5], "conf": [None, 0.25]}
    pq.write_table(pa.table(columns), path)
    table = read_positions(path, PositionOptions(sensor="bev")).table
    assert table.x.tolist() == [0.1, 0.2]
    np.testing.assert_allclose(table.confidence, [np.nan, 0.25])
    pq.write_table(pa.table({**columns, "speed": [1.0, 2.0]}), path)
    with pytest.raises(InputError, match="unknown column 'speed'"):
        read_positions(path, PositionOptions(sensor="bev"))


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("t_ns,x,y\n1,nan,2\n", "line 2: x is"),
        ("t_ns,x,y,cov_xx,cov_xy,cov_yy\n1,1,2,0.01,0.02,0.01\n", "line 2: covariance .* is not positive definite"),
        ("t_ns,x,y,cov_xx,cov_yy\n1,1,2,0.01,\n", "line 2: has one of cov_xx and cov_yy"),
        ("t_ns,x,y,sigma\n1,1,2,-0.1\n", "sigma is -0.1; it must be above 0"),
        ("t_ns,x,y,sigma,cov_xx,cov_yy\n1,1,2,0.1,1,1\n", "line 2: states its error twice"),
        ("t_ns,x,y,conf\n1,1,2,7\n", "line 2: confidence is 7"),
        ("t_ns,x,y,speed\n1,1,2,7\n", "unknown column 'speed'"),
        ("x,y\n1,2\n", "neither a column of times"),
        ("t_ns,x,y\n", "positions"),
        ("1 2 3 4 5\n", "5 columns without a header"),
        ("frame,x,y\n1,1,2\n999999999,1,2\n", "frames 1 to 999999999 have 2 rows: more than 1000000 without one"),
    ],
)
def test_faults_are_named(tmp_path: Path, text: str, what: str) -> None:
    with pytest.raises(InputError, match=what):
        read_positions(written(tmp_path, text), PositionOptions(times=TEN))


def test_frames_need_a_rate(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="give the frame rate"):
        read_positions(written(tmp_path, "frame,x,y\n1,1.5,2\n"), PositionOptions())


def test_grid_is_three_numbers() -> None:
    assert parse_grid("0.025,-3,-9") == WILDTRACK
    for text in ("0.025", "0,-3,-9", "a,b,c", "0.025,nan,0"):
        with pytest.raises(UsageError, match="SIZE,X,Y"):
            parse_grid(text)


def test_sources_of_unequal_steps_keep_their_own_frames(tmp_path: Path) -> None:
    rows = [f"{n},1,{n % 7},lidar" for n in range(60)] + [f"{n},2,{n % 5},radar" for n in range(0, 60, 5) if n != 20]
    table = read_positions(written(tmp_path, "\n".join(["frame,x,y,sensor", *rows])), PositionOptions(times=TEN)).table
    assert table.frame[table.sensor == "radar"].tolist() == list(range(0, 60, 5))
    assert table.frame[table.sensor == "lidar"].tolist() == list(range(60))


def test_times_of_positions_in_another_unit_are_asked_for(tmp_path: Path) -> None:
    rows = "".join(f"{100 * n},1,2\n" for n in range(30))
    with pytest.raises(InputError, match="column time: 100 s from frame to frame"):
        read_positions(written(tmp_path, "time,x,y\n" + rows), PositionOptions())
    assert len(read_positions(written(tmp_path, "t_ms,x,y\n" + rows), PositionOptions()).table) == 30
