"""Ground truth: every format, real files, and contradictions."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from occlog.errors import InputError, UsageError
from occlog.io.formats.truth import TruthOptions, read_board, read_sync_times, read_truth
from occlog.io.frames.streams import rate_times
from occlog.records.tables import Truth, TruthBoxes

RATE = rate_times(Fraction(10), "given")
ONE = TruthOptions(cameras=("cam",), times={"cam": RATE})


def read(path: Path, options: TruthOptions = ONE) -> tuple[Truth, TruthBoxes]:
    tables = list(read_truth(path, options))
    return (
        Truth.concat(t for t in tables if isinstance(t, Truth)),
        TruthBoxes.concat(t for t in tables if isinstance(t, TruthBoxes)),
    )


def write(tmp_path: Path, text: str, name: str = "truth.csv") -> Path:
    path = tmp_path / name
    path.write_text(text)
    return path


def test_positions_of_a_table(tmp_path: Path) -> None:
    text = "time,id,x,y,z,role\n1.5,2,3,4,,occluder\n1.5,1,5,6,1.7,target\n0.5,1,7,8,0,target\n"
    truth, boxes = read(write(tmp_path, text), TruthOptions())
    assert truth.t_ns.tolist() == [500_000_000, 1_500_000_000, 1_500_000_000]
    assert truth.target_id.tolist() == [1, 1, 2]
    assert truth.role.tolist() == ["target", "target", "occluder"]
    assert np.array_equal(truth.z, [0, 1.7, np.nan], equal_nan=True)
    assert len(boxes) == 0


def test_positions_by_frame_take_the_times_of_the_frames(tmp_path: Path) -> None:
    truth, _ = read(write(tmp_path, "frame,x,y\n0,1,2\n7,3,4\n"))
    assert truth.t_ns.tolist() == [0, 700_000_000]
    assert truth.target_id.tolist() == [0, 0]


def test_frames_of_cameras_that_differ_in_time_are_not_guessed(tmp_path: Path) -> None:
    path = write(tmp_path, "frame,x,y\n0,1,2\n")
    other = rate_times(Fraction(10), "given", 5)
    with pytest.raises(UsageError, match="counts frames, which have other times in each camera"):
        read(path, TruthOptions(cameras=("a", "b"), times={"a": RATE, "b": other}))
    truth, _ = read(path, TruthOptions(camera="b", cameras=("a", "b"), times={"a": RATE, "b": other}))
    assert truth.t_ns.tolist() == [5]
    with pytest.raises(UsageError, match="give the frame rate"):
        read(path, TruthOptions())


def test_motchallenge_gives_boxes_and_world_positions(tmp_path: Path) -> None:
    text = "1,4,10,20,30,40,1,2.5,3.5,0\n2,4,11,20,30,40,1,-1,-1,-1\n2,5,1,2,3,4,0,9,9,9\n"
    truth, boxes = read(write(tmp_path, text, "gt.txt"))
    assert (truth.x.tolist(), truth.y.tolist(), truth.t_ns.tolist()) == ([2.5], [3.5], [0])
    assert boxes.frame.tolist() == [0, 1]
    assert boxes.target_id.tolist() == [4, 4]  # a row with confidence 0 does not count


def test_boxes_in_a_table_with_cameras(tmp_path: Path) -> None:
    text = "frame,camera,id,left,top,width,height\n0,1,3,1,1,2,2\n1,2,3,1,1,2,2\n"
    options = TruthOptions(cameras=("cam1", "cam2"), times={"cam1": RATE, "cam2": RATE})
    _, boxes = read(write(tmp_path, text), options)
    assert boxes.sensor.tolist() == ["cam1", "cam2", "cam1", "cam2"]
    assert boxes.box.tolist() == [0, -1, -1, 0]


XML = """<?xml version="1.0" encoding="utf-8"?>
<dataset>
 <frame number="1"><objectlist>
  <object id="9"><box h="80" w="30" xc="100" yc="200"/></object>
  <object id="4"><box h="60" w="20" xc="50" yc="70"/></object></objectlist></frame>
 <frame number="2"><objectlist/></frame>
 <frame number="9"><objectlist><object id="4"><box h="60" w="20" xc="51" yc="70"/></object></objectlist></frame>
</dataset>"""


def test_xml_frames_that_are_listed_empty_are_rows_and_others_are_not(tmp_path: Path) -> None:
    _, boxes = read(write(tmp_path, XML, "gt.xml"))
    assert boxes.frame.tolist() == [1, 1, 2, 9]
    assert boxes.box.tolist() == [0, 1, -1, 0]
    assert [boxes.left_px[0], boxes.top_px[0], boxes.width_px[0], boxes.height_px[0]] == [85, 160, 30, 80]
    assert boxes.t_ns.tolist() == [10**8, 10**8, 2 * 10**8, 9 * 10**8]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("t.csv", "time,x\n1,2\n", "has no column y"),
        ("t.csv", "time,x,y\n1,2,nan\n", "line 2: y is missing"),
        ("t.csv", "x,y\n1,2\n", "neither a column of times"),
        ("t.csv", "time,id,x,y\n1,1,2,3\n1,1,4,5\n", "lines 2 and 3: target 1 is twice at 1 s"),
        ("t.csv", "time,x,y,role\n1,2,3,wall\n", "line 2: role 'wall' must be target or occluder"),
        ("t.csv", "tme,x,y\n1,2,3\n", "did you mean 'time'"),
        ("t.csv", "1,2,3\n", "not ground truth of a known format .*; name its columns in a header line"),
        ("t.csv", "time [s],x [m]\n1,2\n", "has no column y; add it"),
        ("t.csv", "", "is empty"),
        ("g.xml", XML.replace('h="80"', 'h="-80"'), "frame 1: object 9: box of 30 x -80 px"),
        ("g.xml", XML.replace('xc="100"', 'xc="a"'), "xc of <box> is 'a'"),
        ("g.xml", XML.replace('number="9"', 'number="2"'), "frame 2 does not come after"),
        ("g.xml", XML[:-30], "not XML"),
        ("g.xml", "<dataset></dataset>", "has no <frame>"),
        ("g.xml", XML.replace('id="9"', ""), "<object> has no attribute id"),
    ],
)
def test_faults_are_named(tmp_path: Path, name: str, text: str, message: str) -> None:
    path = write(tmp_path, text, name)
    with pytest.raises(InputError, match=message) as caught:
        read(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_pets_annotations(shared_data: Path) -> None:
    path = shared_data / "pets2009_s2l1_view1/annotations/PETS2009-S2L1_frames_000-399.xml"
    _, boxes = read(path)
    assert len(np.unique(boxes.frame)) == 400
    assert (boxes.frame.min(), boxes.frame.max()) == (0, 399)
    assert len(boxes) == path.read_text().count("<object ")
    first = boxes.take(boxes.frame == 0)
    assert first.target_id.tolist() == [9, 15, 19]
    assert first.left_px[0] + first.width_px[0] / 2 == pytest.approx(514.7109)


def test_tud_world_positions(shared_data: Path) -> None:
    truth, boxes = read(shared_data / "tud_mot/TUD-Stadtmitte/gt.txt")
    assert len(truth) == (boxes.box >= 0).sum() == 1156
    assert truth.x[0] == 4.4852
    truth, boxes = read(shared_data / "tud_mot/TUD-Campus/gt.txt")
    assert (len(truth), (boxes.box >= 0).sum()) == (0, 359)


def test_the_board_of_caliscope_is_one_fixed_point(shared_data: Path) -> None:
    folder = shared_data / "caliscope_4cam/session_a/calibration/extrinsic"
    truth, _ = read(
        folder / "CHARUCO/xyz_CHARUCO.csv", TruthOptions(sync_ns=read_sync_times(folder / "timestamps.csv"))
    )
    assert len(truth) == 57
    path = np.column_stack([truth.x, truth.y, truth.z])
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert steps.max() < 0.1  # the board is waved by hand, 6 times a second
    assert (np.diff(truth.t_ns) > 0).all()


def test_corners_that_come_and_go_do_not_move_the_board(tmp_path: Path) -> None:
    rows = [f"{s},0,{k},{k},{k % 2},0," for s in range(4) for k in range(6) if not (s == 2 and k == 5)]
    path = write(tmp_path, "sync_index,object_id,keypoint_id,x_coord,y_coord,z_coord,frame_time\n" + "\n".join(rows))
    truth = read_board(path, {s: 10 * s for s in range(4)})
    assert truth.x.tolist() == [2.0] * 4
    with pytest.raises(InputError, match="sync_index 3 has no time"):
        read_board(path, {s: s for s in range(3)})
    with pytest.raises(UsageError, match=r"states sync_index, not times"):
        read_board(path, None)


@pytest.mark.parametrize(("gone", "times"), [([(2, 3)], [0, 10, 20, 30]), ([(2, 3), (1, 2)], [0, 30])])
def test_three_corners_that_are_always_there_are_enough_and_two_are_not(
    tmp_path: Path, gone: list[tuple[int, int]], times: list[int]
) -> None:
    rows = [f"{s},0,{k},{k},0,0," for s in range(4) for k in range(4) if (s, k) not in gone]
    path = write(tmp_path, "sync_index,object_id,keypoint_id,x_coord,y_coord,z_coord,frame_time\n" + "\n".join(rows))
    assert read_board(path, {s: 10 * s for s in range(4)}).t_ns.tolist() == times


def test_a_corner_that_is_there_twice_is_refused(tmp_path: Path) -> None:
    """The last one counted."""
    rows = [f"0,0,{n},0,0,0,0" for n in (0, 1, 2, 1)]
    path = write(tmp_path, "sync_index,object_id,keypoint_id,x_coord,y_coord,z_coord,frame_time\n" + "\n".join(rows))
    with pytest.raises(InputError, match=r"corner \d+ is there twice at sync_index 0"):
        list(read_truth(path, TruthOptions(sync_ns={0: 0})))


@pytest.mark.parametrize(("names", "factor"), [("x_mm,y_mm", 1e-3), ("x [cm],y [cm]", 1e-2)])
def test_positions_by_frame_in_another_unit_of_length(tmp_path: Path, names: str, factor: float) -> None:
    path = write(tmp_path, f"frame,id,{names}\n0,3,1000,2000\n7,3,3000,4000\n")
    truth, _ = read(path)
    assert truth.t_ns.tolist() == [0, 700_000_000]
    assert truth.x == pytest.approx([1000 * factor, 3000 * factor])
    assert read(path, replace(ONE, length_unit="mm"))[0].y == pytest.approx([2e6 * factor, 4e6 * factor])
    with pytest.raises(InputError, match="cannot be converted to px"):
        read(path, replace(ONE, length_unit="px"))
