"""Detector boxes: formats, frames without a box, malformed rows."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.errors import InputError, UsageError
from occlog.io.files.timing.frame_choice import FrameChoice
from occlog.io.formats.boxes.reader import BoxFile, BoxOptions, read_boxes, survey_boxes
from occlog.io.frames.streams import rate_times
from occlog.records.tables import Boxes

RATE = rate_times(Fraction(10), "given")


def read(
    *files: BoxFile, known: tuple[str, ...] = (), options: BoxOptions | None = None, timed: bool = False
) -> tuple[Boxes, list[Boxes]]:
    """All rows, and the tables they came in."""
    how = options or BoxOptions()
    survey = survey_boxes(files, known, how)
    times = dict(survey.times) if timed else dict.fromkeys(survey.cameras, RATE)
    parts = list(read_boxes(files, survey, times, known, how, Boxes))
    return Boxes.merge(parts), parts


def write(tmp_path: Path, text: str, name: str = "boxes.csv") -> Path:
    path = tmp_path / name
    path.write_text(text)
    return path


SIMPLE = """frame,camera,left,top,right,bottom,confidence
3,b,10,20,30,60,0.5
3,a,0,0,5,9,1
5,a,1,1,4,5,
5,a,2,2,4,5,0.25
"""


def test_frames_without_a_row_are_looked_saw_no_one(tmp_path: Path) -> None:
    boxes, _ = read(BoxFile(write(tmp_path, SIMPLE), None))
    columns = (boxes.frame, boxes.sensor, boxes.box, boxes.width_px)
    rows = list(zip(*(c.tolist() for c in columns), strict=True))
    nan = float("nan")
    third, fourth = [(3, "a", 0, 5.0), (3, "b", 0, 20.0)], [(4, "a", -1, nan), (4, "b", -1, nan)]
    want = [*third, *fourth, (5, "a", 0, 3.0), (5, "a", 1, 2.0), (5, "b", -1, nan)]
    assert str(rows) == str(want)
    assert boxes.t_ns.tolist() == [f * 10**8 for f in (3, 3, 4, 4, 5, 5, 5)]
    assert np.array_equal(boxes.confidence, [1, 0.5, nan, nan, nan, 0.25, nan], equal_nan=True)
    assert (boxes.target_id == -1).all()


def test_a_stated_range_of_frames_is_filled_and_cut(tmp_path: Path) -> None:
    path = write(tmp_path, SIMPLE)
    boxes, _ = read(BoxFile(path, None), options=BoxOptions(frames=FrameChoice((0, 5))))
    assert sorted(set(boxes.frame.tolist())) == [0, 1, 2, 3, 4]
    assert (boxes.box >= 0).sum() == 2
    assert len(boxes) == 10


def test_a_file_without_a_box_says_that_no_one_was_seen_in_the_stated_frames(tmp_path: Path) -> None:
    path = write(tmp_path, "frame,left,top,w,h\n")
    boxes, _ = read(BoxFile(path, "cam"), options=BoxOptions(frames=FrameChoice((2, 5))))
    assert boxes.frame.tolist() == [2, 3, 4]
    assert boxes.box.tolist() == [-1, -1, -1]


def test_other_names_and_width_and_height(tmp_path: Path) -> None:
    text = "Frame_ID;X1;Y1;W;H;track_id;class\n1;2;3;4;5;77;person\n"
    boxes, _ = read(BoxFile(write(tmp_path, text), "cam"), options=BoxOptions(first_number=1))
    assert (boxes.frame[0], boxes.target_id[0]) == (0, 77)
    assert [boxes.left_px[0], boxes.top_px[0], boxes.width_px[0], boxes.height_px[0]] == [2, 3, 4, 5]
    assert np.isnan(boxes.confidence[0])


def test_x_and_y_may_be_any_point_of_a_box(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match="x and y: they may be a corner or the middle of a box; call them left and top"
    ):
        read(BoxFile(write(tmp_path, "frame,x,y,w,h\n1,2,3,4,5\n"), "cam"))
    boxes, _ = read(
        BoxFile(write(tmp_path, "frame,left,top,w,h,x,y\n1,2,3,4,5,6,7\n"), "cam"),
        options=BoxOptions(ignore_extra=True),
    )
    assert boxes.left_px.tolist()[-1] == 2


def test_labels_of_cameras_are_matched_with_those_of_the_scene(tmp_path: Path) -> None:
    path = write(tmp_path, SIMPLE.replace(",a,", ",1,").replace(",b,", ",2,"))
    boxes, _ = read(BoxFile(path, None), known=("cam1", "cam2"))
    assert sorted(set(boxes.sensor.tolist())) == ["cam1", "cam2"]
    with pytest.raises(InputError, match="camera '2' is none of cam1"):
        read(BoxFile(path, None), known=("cam1",))


def test_a_column_of_times_gives_the_times(tmp_path: Path) -> None:
    text = "frame,time,left,top,width,height\n10,1.0,1,1,2,2\n12,1.4,1,1,2,2\n13,1.5,1,1,2,2\n"
    boxes, _ = read(BoxFile(write(tmp_path, text), "c"), timed=True, options=BoxOptions(frames=FrameChoice((9, 15))))
    assert (boxes.t_ns / 1e9).round(6).tolist() == [0.833333, 1.0, 1.2, 1.4, 1.5, 1.666667]


def test_times_since_1970_stay_exact(tmp_path: Path) -> None:
    text = "frame,t_ns,left,top,w,h\n0,1700000000123456789,1,1,2,2\n1,1700000000223456788,1,1,2,2\n"
    boxes, _ = read(BoxFile(write(tmp_path, text), "c"), timed=True)
    assert boxes.t_ns.tolist() == [1700000000123456789, 1700000000223456788]


def test_motchallenge_counts_from_one(tmp_path: Path) -> None:
    text = "1,-1,10,20,30,40,0.9,-1,-1,-1\n3,5,1,2,3,4,-1,-1,-1,-1\n"
    path = write(tmp_path, text, "det.txt")
    boxes, _ = read(BoxFile(path, "cam"))
    assert boxes.frame.tolist() == [0, 1, 2]
    assert boxes.box.tolist() == [0, -1, 0]
    assert boxes.target_id.tolist() == [-1, -1, 5]
    assert np.isnan(boxes.confidence[2])
    with pytest.raises(InputError, match=r"give CAMERA=det\.txt"):
        read(BoxFile(path, None))


def test_several_files_share_the_range_of_frames(tmp_path: Path) -> None:
    a = write(tmp_path, "1,1,0,0,2,2,1\n2,1,0,0,2,2,1\n", "a.txt")
    b = write(tmp_path, "4,1,0,0,2,2,1\n", "b.txt")
    boxes, _ = read(BoxFile(a, "a"), BoxFile(b, "b"))
    assert [(boxes.sensor == s).sum() for s in "ab"] == [4, 4]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frame,left,top,right,bottom\n0,1,2,x,4\n", "line 2: right is 'x'; a number was expected"),
        ("frame,left,top,right,bottom\n0,1,2,3,nan\n", "line 2: bottom is missing"),
        ("frame,left,top,right,bottom\n0,1,2,3,inf\n", "line 2: bottom is 'inf'"),
        ("frame,left,top,right,bottom\n0,1,2,3,4\n1.5,1,2,3,4\n", "line 3: frame is '1.5'; a whole number"),
        ("frame,left,top,right,bottom\n-1,1,2,3,4\n", "line 2: frame -1 is before the first one, 0"),
        ("frame,left,top,right,bottom\n0,5,2,3,4\n", r"line 2: box of -2 x 2 px; both must be above 0"),
        ("frame,left,top,right,bottom,score\n0,1,2,3,4,55\n", "line 2: confidence 55.*which divides it"),
        ("frame,left,top,right,bottom,id\n0,1,2,3,4,9999999999\n", "line 2: identity 9999999999"),
        ("frame,left,top,right,bottom\n0,1,2,3\n", "line 2: 4 cells, but the first line has 5"),
        ("frame,left,top,right,botom\n0,1,2,3,4\n", "unknown column 'botom'.* did you mean 'bottom'"),
        ("frame,left,top,right\n0,1,2,3\n", "has no column right and bottom"),
        ("frame,left,left,right,bottom\n0,1,2,3,4\n", "are both read as 'left'"),
        ("left,top,right,bottom\n1,2,3,4\n", "has no column frame"),
        ("1,2,3,4,5\n", "5 columns; MOTChallenge has 7 to 10"),
        ("frame,time,left,top,w,h\n0,1,1,1,1,1\n0,2,1,1,1,1\n", "line 3: frame 0 of camera cam has two times"),
        ("frame,time,left,top,w,h\n0,2,1,1,1,1\n1,1,1,1,1,1\n", "frame 1 has time 1 s, not after"),
        ("frame,left,top,w,h\n0,1,1,1,1\n100000001,1,1,1,1\n", "frames 0 to 100000001 are more than 100000000"),
        ("frame,left,top,w,h\n2000000000,1,1,1,1\n", "line 2: frame 2000000000; it must be below 1000000000"),
        ("frame,left,top,w,h\n0,-1e308,1,2e308,1\n", "line 2: width is '2e308'; a finite number was expected"),
        ("frame,x1,y1,x2,y2\n0,-1e308,1,1e308,2\n", "line 2: box that reaches to inf px; no image is larger"),
        ("frame,left,top,w,h\n0,1,1e308,1,1\n", r"line 2: box that reaches to 1e\+308 px; no image is larger"),
        ("frame,left,top,w,h\n", "no row with a box"),
        ("frame,left\0,top,w,h\n", "not text"),
    ],
)
def test_a_malformed_row_is_named_by_line_value_and_remedy(tmp_path: Path, text: str, message: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(InputError, match=message) as caught:
        read(BoxFile(path, "cam"))
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_without_a_camera_or_a_time_it_is_reported_which_option_helps(tmp_path: Path) -> None:
    path = write(tmp_path, "frame,left,top,w,h\n0,1,1,1,1\n")
    with pytest.raises(InputError, match=r"has no column camera; add it, or name the camera: CAMERA=boxes\.csv"):
        survey_boxes([BoxFile(path, None)], (), BoxOptions())
    files = [BoxFile(path, "cam")]
    survey = survey_boxes(files, (), BoxOptions())
    with pytest.raises(UsageError, match="camera cam: its frames have no times"):
        list(read_boxes(files, survey, {}, (), BoxOptions(), Boxes))


def test_a_box_that_stands_there_twice_is_refused_wherever_it_stands(tmp_path: Path) -> None:
    head = "frame,camera,left,top,w,h,conf\n"
    path = write(tmp_path, head + "0,a,1,1,9,9,0.5\n1,a,1,1,9,9,0.5\n1,b,1,1,9,9,0.5\n1,a,1,1,9,9,0.6\n")
    assert len(read(BoxFile(path, None))[0]) == 5  # and a observation of b at no one
    path = write(tmp_path, head + "0,a,1,1,9,9,0.5\n1,a,1,1,9,9,0.5\n0,a,1,1,9,9,0.5\n")
    with pytest.raises(InputError, match=r"camera a, frame 0 \(from 0\): the box at \(1, 1\) px is a duplicate"):
        read(BoxFile(path, None))


def test_extra_columns_can_be_skipped_and_confidences_scaled(tmp_path: Path) -> None:
    path = write(tmp_path, "frame,left,top,w,h,conf,colour\n0,1,1,1,1,55,red\n")
    boxes, _ = read(BoxFile(path, "cam"), options=BoxOptions(confidence_scale=100, ignore_extra=True))
    assert boxes.confidence.tolist() == [0.55]


@given(
    st.lists(st.tuples(st.integers(0, 10), st.integers(0, 2), st.integers(2, 9)), min_size=1, max_size=60, unique=True),
    st.booleans(),
)
def test_every_frame_of_every_camera_has_its_boxes_or_one_empty_row(
    rows: list[tuple[int, int, int]], in_order: bool
) -> None:
    import tempfile

    if in_order:
        rows = sorted(rows, key=lambda row: row[0])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "b.csv"
        path.write_text("frame,camera,left,top,w,h\n" + "".join(f"{f},c{c},0,0,{w},1\n" for f, c, w in rows))
        boxes, parts = read(BoxFile(path, None))
    cameras = sorted({c for _, c, _ in rows})
    first, last = min(r[0] for r in rows), max(r[0] for r in rows)
    for frame in range(first, last + 1):
        for camera in cameras:
            want = [w for f, c, w in rows if (f, c) == (frame, camera)]
            mine = (boxes.frame == frame) & (boxes.sensor == f"c{camera}")
            if want:
                assert boxes.width_px[mine].tolist() == want
                assert boxes.box[mine].tolist() == list(range(len(want)))
            else:
                assert boxes.box[mine].tolist() == [-1]
    assert sum(map(len, parts)) == len(boxes)


def test_long_files_come_in_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import occlog.io.formats.boxes.columns as module
    import occlog.io.formats.boxes.rows as box_rows
    from occlog.io.files.texts.csv_rows import read_rows

    monkeypatch.setattr(box_rows, "FRAMES_PER_CHUNK", 7)
    monkeypatch.setattr(module, "read_rows", lambda *a, **k: read_rows(*a, **{**k, "rows": 10}))
    rng = np.random.default_rng(0)
    frames = np.sort(rng.integers(0, 100, 300))
    path = write(tmp_path, "frame,left,top,w,h\n" + "".join(f"{f},{k},0,1,1\n" for k, f in enumerate(frames)))
    boxes, parts = read(BoxFile(path, "c"))
    assert len(parts) > 10
    assert max(np.ptp(p.frame) for p in parts) < 7
    assert boxes.left_px[boxes.box >= 0].tolist() == list(range(300))
    assert len(set(boxes.frame.tolist())) == frames[-1] - frames[0] + 1


@pytest.mark.parametrize(("name", "frames", "rows"), [("CMC1", 261, 3344), ("CMC2", 263, 8137), ("CMC4", 147, 1630)])
def test_real_detections_of_four_cameras(shared_data: Path, name: str, frames: int, rows: int) -> None:
    path = shared_data / f"cmc_detections/{name}_detections.csv"
    boxes, _ = read(BoxFile(path, None), known=("cam1", "cam2", "cam3", "cam4"))
    assert (boxes.box >= 0).sum() == rows
    assert len(np.unique(boxes.frame)) == frames
    assert all(len(np.unique(boxes.frame[boxes.sensor == f"cam{n}"])) == frames for n in (1, 2, 3, 4))
    assert np.nanmax(boxes.confidence) <= 1


@pytest.mark.parametrize(("name", "rows", "frames"), [("TUD-Campus", 222, 71), ("TUD-Stadtmitte", 749, 179)])
def test_real_motchallenge_results(shared_data: Path, name: str, rows: int, frames: int) -> None:
    boxes, _ = read(BoxFile(shared_data / f"tud_mot/{name}/test.txt", "cam"))
    assert ((boxes.box >= 0).sum(), len(np.unique(boxes.frame))) == (rows, frames)
    assert boxes.frame[0] == 0


def test_widths_that_contradict_the_edges_are_of_the_image(tmp_path: Path) -> None:
    """Tables for TensorFlow have the size of the image next to all four edges."""
    head = "frame,width,height,class,xmin,ymin,xmax,ymax"
    with pytest.raises(InputError, match=r"line 2: width is 1280, but right is 80\.5 and the near edge 10"):
        read(BoxFile(write(tmp_path, f"{head}\n0,1280,720,person,10,20,80.5,90\n"), "cam"))
    boxes, _ = read(BoxFile(write(tmp_path, f"{head}\n0,70,71,person,10,20,80.5,90\n"), "cam"))
    assert (boxes.width_px[0], boxes.height_px[0]) == (70, 71)  # the last pixel counts, or not


def test_files_that_name_their_cameras_say_nothing_of_those_of_others(tmp_path: Path) -> None:
    """Each file stated of the cameras of the other one that they saw no one in any frame."""
    head = "frame,camera,left,top,w,h"
    a = write(tmp_path, f"{head}\n0,a,1,1,5,5\n1,a,1,1,5,5\n", "a.csv")
    b = write(tmp_path, f"{head}\n0,b,1,1,5,5\n1,b,1,1,5,5\n", "b.csv")
    boxes, _ = read(BoxFile(a, None), BoxFile(b, None))
    assert boxes.box.tolist() == [0, 0, 0, 0]
    boxes, _ = read(BoxFile(a, None), BoxFile(b, "c"))
    assert boxes.box.tolist() == [0, 0, 0, 0]


@pytest.mark.parametrize("camera", ["a", None])
def test_boxes_of_a_camera_in_two_files_are_refused(tmp_path: Path, camera: str | None) -> None:
    """Each file stated of the frames of the other one that no one was seen in them."""
    head = "frame,left,top,w,h" if camera else "frame,camera,left,top,w,h"
    mark = "" if camera else "a,"
    files = [write(tmp_path, f"{head}\n{n},{mark}1,1,5,5\n", f"{n}.csv") for n in range(2)]
    with pytest.raises(InputError, match=r"camera a: has boxes in .*0\.csv, too"):
        read(*(BoxFile(file, camera) for file in files))


def test_shares_of_the_image_are_found_in_each_camera(tmp_path: Path) -> None:
    text = "frame,left,top,right,bottom\n0,0.1,0.2,0.3,0.4\n1,0.1,0.2,0.3,0.4\n"
    files = [
        BoxFile(write(tmp_path, text, "a.csv"), "a"),
        BoxFile(write(tmp_path, "frame,left,top,right,bottom\n0,1,2,30,40\n", "b.csv"), "b"),
    ]
    with pytest.raises(InputError, match=r"a.csv: camera a: no box reaches beyond 0.3 px"):
        survey_boxes(files, (), BoxOptions())


def test_a_column_with_four_numbers_is_a_box_as_in_coco(tmp_path: Path) -> None:
    boxes, _ = read(BoxFile(write(tmp_path, 'frame,bbox\n0,"[10.5, 20, 30, 40]"\n'), "a"))
    assert [boxes.left_px[0], boxes.top_px[0], boxes.width_px[0], boxes.height_px[0]] == [10.5, 20, 30, 40]
    with pytest.raises(InputError, match=r"line 2: bbox is '10\.5 20'; expected"):
        read(BoxFile(write(tmp_path, "frame,bbox\n0,10.5 20\n"), "a"))


def test_other_forms_of_json_are_named_with_what_to_write(tmp_path: Path) -> None:
    for text, words in (
        ('[{"frame": 0, "boxes": [[1, 2, 3, 4]]}]', r"boxes is a list; write an object for each box"),
        ('[{"frame": 0, "box": [1, 2, 3, 4]}]', r"box is a list; write an object for each box"),
    ):
        with pytest.raises(InputError, match=words):
            read(BoxFile(write(tmp_path, text, "a.json"), "a"))
    (tmp_path / "pose").mkdir()
    write(tmp_path / "pose", '{"version": 1.3, "people": []}', "a_000_keypoints.json")
    with pytest.raises(InputError, match="keypoints of OpenPose"):
        read(BoxFile(tmp_path / "pose", "a"))


@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_a_header_line_that_begins_with_a_number_sign_names_the_columns(tmp_path: Path, mark: str) -> None:
    """As `numpy.savetxt` writes it."""
    names = "frame,left,top,right,bottom,confidence"
    commented = write(tmp_path, f"{mark}# {names}\n0.0,1,2,3,4,0.5\n2.0,1,2,3,4,0.5\n")
    plain = write(tmp_path, f"{names}\n0,1,2,3,4,0.5\n2,1,2,3,4,0.5\n", "plain.csv")
    ours, same = read(BoxFile(commented, "cam"))[0], read(BoxFile(plain, "cam"))[0]
    for column in ("frame", "left_px", "width_px", "confidence"):
        np.testing.assert_array_equal(getattr(ours, column), getattr(same, column))
    mot = write(tmp_path, "# frame,id,left,top,width,height,conf\n1,-1,1,2,3,4,1\n2,-1,1,2,3,4,1\n")
    assert read(BoxFile(mot, "cam"))[0].frame.min() == 0
