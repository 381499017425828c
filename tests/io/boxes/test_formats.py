"""Boxes in the formats of other programs: YOLO text, COCO, JSON, Ultralytics, supervision, any score and class."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.errors import InputError, UsageError
from occlog.examine.export.in_images import coco_texts
from occlog.io.files.timing.frame_choice import FrameChoice
from occlog.io.formats.boxes.mot_challenge import write_mot
from occlog.io.formats.boxes.reader import BoxFile, BoxOptions, BoxSurvey, read_boxes, survey_boxes
from occlog.io.frames.streams import rate_times
from occlog.records.tables import Boxes

RATE = rate_times(Fraction(10), "given")
SIZES = {"a": (200, 100), "b": (400, 100)}
PEOPLE = BoxOptions(classes=(), sizes=SIZES)


def read(*files: BoxFile, options: BoxOptions = PEOPLE) -> tuple[Boxes, BoxSurvey]:
    survey = survey_boxes(files, (), options)
    times = {**dict.fromkeys(survey.cameras, RATE), **survey.times}
    return Boxes.merge(list(read_boxes(files, survey, times, (), options, Boxes))), survey


def edges(boxes: Boxes) -> list[list[float]]:
    there = boxes.take(boxes.box >= 0)
    return np.column_stack([there.left_px, there.top_px, there.width_px, there.height_px]).round(6).tolist()


def yolo(folder: Path, files: dict[str, str]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text)
    return folder


def saved(path: Path, value: object) -> Path:
    path.write_text(value if isinstance(value, str) else json.dumps(value))
    return path


def test_yolo_text_counts_in_shares_and_writes_no_file_for_no_one(tmp_path: Path) -> None:
    folder = yolo(tmp_path / "l", {"000002.txt": "0 0.5 0.5 0.1 0.4 0.75\n", "000004.txt": "0 0.25 0.5 0.5 1 0.5\n"})
    yolo(folder, {"000005.txt": "", "notes.txt": "not numbered"})
    boxes, survey = read(BoxFile(folder, "a"))
    assert edges(boxes) == [[90, 30, 20, 40], [0, 0, 100, 100]]
    assert boxes.frame.tolist() == [2, 3, 4, 5]
    assert boxes.box.tolist() == [0, -1, 0, -1]
    assert boxes.confidence[[0, 2]].tolist() == [0.75, 0.5]
    assert survey.classes == {("0",): 2}
    assert survey.shares == {"a"}


def test_a_folder_of_folders_has_one_camera_each(tmp_path: Path) -> None:
    yolo(tmp_path / "a" / "labels", {"v_1.txt": "0 0.5 0.5 0.1 0.4\n"})
    yolo(tmp_path / "b", {"v_3.txt": "0 0.5 0.5 0.1 0.4\n"})
    boxes, survey = read(BoxFile(tmp_path, None))
    assert survey.cameras == ("a", "b")
    assert boxes.frame.tolist() == [1, 1, 2, 2, 3, 3]
    assert edges(boxes) == [[90, 30, 20, 40], [180, 30, 40, 40]]
    with pytest.raises(InputError, match="several cameras"):
        read(BoxFile(tmp_path, "a"))
    with pytest.raises(InputError, match="does not name it"):
        read(BoxFile(tmp_path / "b", None))


@pytest.mark.parametrize(
    ("lines", "ids", "confidence"),
    [
        (("0 .5 .5 .1 .1 7", "0 .5 .5 .1 .1 9"), [7, 9], [np.nan, np.nan]),
        (("0 .5 .5 .1 .1 0.7", "0 .5 .5 .1 .1 1"), [-1, -1], [0.7, 1]),
        (("0 .5 .5 .1 .1 0.7 7", "0 .5 .5 .1 .1 0.5"), [7, -1], [0.7, 0.5]),
        (("0 .5 .5 .1 .1", "0 .5 .5 .1 .1 9"), [-1, 9], [np.nan, np.nan]),
        (("0 .5 .5 .1 .1" + " 0.3" * 51 + " 0.7 7", "0 .5 .5 .1 .1" + " 0.3" * 51 + " 0.5"), [7, -1], [0.7, 0.5]),
    ],
)
def test_the_numbers_after_a_yolo_box_are_confidence_and_identity(
    tmp_path: Path, lines: tuple[str, str], ids: list[int], confidence: list[float]
) -> None:
    boxes, _ = read(BoxFile(yolo(tmp_path / "l", {"1.txt": lines[0], "2.txt": lines[1]}), "a"))
    assert boxes.target_id.tolist() == ids
    assert np.array_equal(boxes.confidence, confidence, equal_nan=True)


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"1.txt": "0 512 300 40 90\n"}, r"1.txt: line 1: x is 512; .*fractions of the image size.*pixels"),
        ({"1.txt": "0 .5 .5 .1 1.0011\n"}, "height is 1.0011"),
        ({"a_7.txt": "0 .5 .5 .1 .1\n", "b_7.txt": "0 .5 .5 .1 .1\n"}, "b_7.txt: has frame number 7, as a_7.txt has"),
        ({"1.txt": "0 .5 .5 .1 .1 .9\n0 .5 .5 .1 .1 .9\n"}, "line 2: duplicate box; .*earlier run"),
        ({"1.txt": "0 .5 .5 .1\n"}, "line 1: 4 numbers; expected class"),
        ({"1.txt": "0 .5 .5 .1 .1 .2 .3 .4 .5\n"}, "9 numbers.*outlines"),
        ({"1.txt": "0 .5 .5 .1 x\n"}, "'x'; a number was expected"),
        ({"1.txt": "0 .5 .5 .1 .1\n", "2.txt": "0 .5 .5 .1 .1 .9\n"}, "with and without a confidence"),
        ({"1.txt": "0 .5 .5 .1 .1\n", "2.txt": "0 .5 .5 .1 .1 .9 3\n"}, "lines of 5 and of 7"),
        ({"1.txt": "0 .5 .5 .1 .1 .9 3\n0 .6 .5 .1 .1 .8 3\n"}, "frame 1 .from 0.: identity 3 has two boxes"),
        ({"1.txt": "0 .5 .5 0 .1\n"}, "box of 0 x"),
        ({"1.txt": ".5 .5 .1 .1 .9\n"}, "line 1: class is '.5'"),
        ({"readme.md": ""}, "holds no YOLO labels"),
    ],
)
def test_half_right_yolo_folders_are_refused(tmp_path: Path, files: dict[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(BoxFile(yolo(tmp_path / "l", files), "a"))


def people_in_shares(columns: str, people: int = 40) -> dict[str, str]:
    """Labels with these columns of standing people who are anywhere in the image."""
    rng = np.random.default_rng(0)
    w, h = rng.uniform(0.05, 0.1, people), rng.uniform(0.3, 0.5, people)
    x, y = rng.uniform(0.5 * w, 1.0 - 0.5 * w), rng.uniform(0.5 * h, 1.0 - 0.5 * h)
    values = {"x": x, "y": y, "w": w, "h": h, "p": rng.uniform(0.3, 0.95, people)}
    values |= {"l": x - 0.5 * w, "t": y - 0.5 * h, "r": x + 0.5 * w, "b": y + 0.5 * h}
    return {
        f"{n}.txt": " ".join(["0", *(f"{values[column][n]:.4f}" for column in columns)]) + "\n" for n in range(people)
    }


@pytest.mark.parametrize(
    "columns", ["pxywh", "ltrbp", "ltrb", "tlbrp", "tlbr", "ltwhp", "ltwh", "pltrb", "pltwh", "whxyp", "xyhwp", "xwyhp"]
)
def test_yolo_text_with_columns_in_another_order_is_refused(tmp_path: Path, columns: str) -> None:
    with pytest.raises(InputError) as error:
        read(BoxFile(yolo(tmp_path / "l", people_in_shares(columns)), "a"))
    assert error.value.id == "unsupported-format"
    named = str(error.value).partition("columns were class, ")[2].partition(";")[0].split(", ")
    assert "".join(name[0] for name in named).replace("c", "p") == columns.removesuffix("p")


@pytest.mark.parametrize("columns", ["xywhp", "xywh"])
def test_yolo_text_with_columns_in_order_is_read(tmp_path: Path, columns: str) -> None:
    assert len(read(BoxFile(yolo(tmp_path / "l", people_in_shares(columns)), "a"))[0].box) == 40


def test_yolo_text_needs_the_size_of_the_images(tmp_path: Path) -> None:
    folder = yolo(tmp_path / "l", {"1.txt": "0 .5 .5 .1 .1\n"})
    with pytest.raises(UsageError, match="the image size, which is unknown for camera z"):
        read(BoxFile(folder, "z"))


def test_a_share_may_pass_1_by_the_rounding_of_labels(tmp_path: Path) -> None:
    boxes, _ = read(BoxFile(yolo(tmp_path / "l", {"1.txt": "0 .5 .5 1.001 .5\n"}), "a"))
    assert boxes.width_px.tolist() == pytest.approx([200.2])


def test_numbers_in_steps_are_frames_and_those_between_are_none(tmp_path: Path) -> None:
    folder = yolo(tmp_path / "l", {f"{n:08d}.txt": "0 .5 .5 .1 .1\n" for n in (0, 5, 15)})
    boxes, survey = read(BoxFile(folder, "a"))
    assert survey.ranges["a"].step == 5
    assert boxes.frame.tolist() == [0, 5, 10, 15]
    assert boxes.box.tolist() == [0, 0, -1, 0]


def test_classes_are_chosen_by_number_or_name_and_never_mixed_in_silence(tmp_path: Path) -> None:
    folder = yolo(tmp_path / "l", {"1.txt": "0 .5 .5 .1 .1\n2 .5 .5 .2 .2\n", "classes.txt": "person\nbicycle\ncar\n"})
    with pytest.raises(InputError, match=r"boxes of 2 classes: 0 person \(1\), 2 car \(1\); choose"):
        read(BoxFile(folder, "a"))
    for name in ("person", "Person", "0", "0.0"):
        boxes, survey = read(BoxFile(folder, "a"), options=BoxOptions(classes=(name,), sizes=SIZES))
        assert edges(boxes) == [[90, 45, 20, 10]]
        assert survey.left_out == {("2", "car"): 1}
    (folder / "classes.txt").unlink()
    with pytest.raises(InputError, match=r"no box is of class person; there are .*numbers only"):
        read(BoxFile(folder, "a"), options=BoxOptions(classes=("person",), sizes=SIZES))
    table = saved(tmp_path / "t.csv", "frame,left,top,width,height\n0,1,2,30,40\n")
    with pytest.raises(InputError, match="has no classes"):
        read(BoxFile(table, "a"), options=BoxOptions(classes=("person",)))


SUPERVISION = """x_min,y_min,x_max,y_max,class_id,confidence,tracker_id,class_name,frame_index
10.5,20,30.5,60,0,0.9,4,person,0
1,2,3,8,0,0.8,5,person,2
"""


def test_supervision_csv_and_json_keep_tracker_and_class(tmp_path: Path) -> None:
    boxes, survey = read(BoxFile(saved(tmp_path / "s.csv", SUPERVISION), "a"))
    assert edges(boxes) == [[10.5, 20, 20, 40], [1, 2, 2, 6]]
    assert boxes.target_id.tolist() == [4, -1, 5]
    assert survey.classes == {("0", "person"): 2}
    records = [
        {"x_min": 10.5, "y_min": 20.0, "x_max": 30.5, "y_max": 60.0, "class_id": 0, "confidence": 0.9,
         "tracker_id": 4, "class_name": "person", "frame_index": 0},
        {"x_min": 1.0, "y_min": 2.0, "x_max": 3.0, "y_max": 8.0, "class_id": 0, "confidence": 0.8,
         "tracker_id": 5, "class_name": "person", "frame_index": 2},
    ]  # fmt: skip
    lines = "\n".join(json.dumps(r) for r in records)
    for again in (saved(tmp_path / "s.json", records), saved(tmp_path / "s.jsonl", lines)):
        assert repr(read(BoxFile(again, "a"))[0]) == repr(boxes)


def test_ultralytics_tables_have_one_column_of_edges(tmp_path: Path) -> None:
    record = {"name": "person", "class": 0, "confidence": 0.9, "box": {"x1": 1.5, "y1": 2, "x2": 5, "y2": 9}}
    record |= {"track_id": 3}
    by_frames = [[record], [], [record | {"track_id": 4}]]
    boxes, survey = read(BoxFile(saved(tmp_path / "u.json", by_frames), "a"))
    assert (boxes.frame.tolist(), boxes.target_id.tolist()) == ([0, 1, 2], [3, -1, 4])
    assert edges(boxes) == [[1.5, 2, 3.5, 7]] * 2
    assert survey.classes == {("0", "person"): 2}
    text = "frame,name,class,confidence,box,track_id\n" + "".join(
        f"{f},person,0,0.9,\"{{'x1': 1.5, 'y1': 2, 'x2': 5, 'y2': 9}}\",{i}\n" for f, i in ((0, 3), (2, 4))
    )
    assert repr(read(BoxFile(saved(tmp_path / "u.csv", text), "a"))[0]) == repr(boxes)
    with pytest.raises(InputError, match=r"line 2: box is 'x'; expected"):
        read(BoxFile(saved(tmp_path / "v.csv", "frame,box\n0,x\n"), "a"))


COCO = {
    "images": [
        {"id": 11, "file_name": "a/000001.jpg"},
        {"id": 12, "file_name": "b/000001.jpg"},
        {"id": 13, "file_name": "a/000002.jpg"},
        {"id": 14, "file_name": "a/000003.jpg"},
    ],
    "annotations": [
        {"id": 1, "image_id": 11, "category_id": 1, "bbox": [1, 2, 30, 40], "score": 0.5, "track_id": 8},
        {"id": 2, "image_id": 14, "category_id": 1, "bbox": [5, 6, 7, 8], "attributes": {"track_id": 9}},
        {"id": 3, "image_id": 14, "category_id": 1, "bbox": [5, 6, 70, 8], "iscrowd": 1},
    ],
    "categories": [{"id": 1, "name": "person"}],
}  # fmt: skip


def test_coco_images_name_frame_and_camera_and_may_be_empty(tmp_path: Path) -> None:
    boxes, survey = read(BoxFile(saved(tmp_path / "c.json", COCO), None))
    assert list(zip(boxes.sensor.tolist(), boxes.frame.tolist(), boxes.target_id.tolist(), strict=True)) == [
        ("a", 1, 8), ("b", 1, -1), ("a", 2, -1), ("b", 2, -1), ("a", 3, 9), ("b", 3, -1),
    ]  # fmt: skip
    assert edges(boxes) == [[1, 2, 30, 40], [5, 6, 7, 8]]
    assert survey.classes == {("1", "person"): 2}


@pytest.mark.parametrize(
    ("second", "expected"),
    [
        ({"file_name": "b/000001.jpg"}, "is of folder b, and the first image of camera cam1 of folder a"),
        ({"file_name": "b/000002.jpg"}, "omit cam1=, so that each folder is a camera"),
        (
            {"file_name": "a/000002.jpg", "camera": "b"},
            "is of camera b, and the first image of camera cam1",
        ),
        ({"file_name": "a/000002.jpg", "video_id": 2}, "is of folder a, video 2, and the first"),
    ],
)
def test_coco_of_several_cameras_is_not_one_camera_s(tmp_path: Path, second: dict[str, object], expected: str) -> None:
    """Where the numbers of frames differed, they became one camera."""
    images = [{"id": 0, "file_name": "a/000001.jpg"}, {"id": 1, **second}]
    path = saved(tmp_path / "c.json", {**COCO, "images": images, "annotations": []})
    with pytest.raises(InputError, match=f"image 2: .*{expected}"):
        read(BoxFile(path, "cam1"))


def test_coco_of_several_cameras_has_each_by_its_own_name(tmp_path: Path) -> None:
    images = [{"id": n, "file_name": f"{camera}/000001.jpg"} for n, camera in enumerate("ab")]
    path = saved(tmp_path / "c.json", {**COCO, "images": images, "annotations": []})
    assert read(BoxFile(path, None))[1].cameras == ("a", "b")
    images = [{"id": n, "file_name": f"{part}/00000{n}.jpg", "camera": "a"} for n, part in enumerate(("train", "val"))]
    path = saved(tmp_path / "c.json", {**COCO, "images": images, "annotations": []})
    assert read(BoxFile(path, "cam1"))[0].frame.tolist() == [0, 1]


def test_folders_of_one_last_name_are_not_one_camera(tmp_path: Path) -> None:
    images = [{"id": n, "file_name": f"{seq}/img1/00000{n}.jpg"} for n, seq in enumerate("ab")]
    path = saved(tmp_path / "c.json", {**COCO, "images": images, "annotations": []})
    with pytest.raises(InputError, match="is of folder b/img1, and the first image of camera img1 of folder a/img1"):
        read(BoxFile(path, None))


def test_coco_results_take_the_image_for_the_frame(tmp_path: Path) -> None:
    results = [{"image_id": n, "category_id": 1, "bbox": [1, 2, 3, 4], "score": 0.25} for n in (4, "img_7")]
    boxes, _ = read(BoxFile(saved(tmp_path / "r.json", results), "a"))
    assert boxes.frame[boxes.box >= 0].tolist() == [4, 7]
    with pytest.raises(InputError, match="do not name their camera"):
        read(BoxFile(tmp_path / "r.json", None))
    results = [{"image_id": f"{camera}/{n}", "bbox": [1, 2, 3, 4]} for n, camera in enumerate("ab")]
    with pytest.raises(InputError, match="images of the folders a and b, which are not one camera"):
        read(BoxFile(saved(tmp_path / "r.json", results), "a"))


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("[1, 2", "not valid JSON"),
        ('{"a": 1}\n{"a": \n', "not valid JSON"),
        ([1], "entry 1: '1'; an object with a box was expected"),
        ([{"frame": 0, "bbox": [1, 2, 3]}], r"entry 1: bbox is \[1, 2, 3\]"),
        ([{"frame": 0, "box": {"x1": 1, "y1": 2, "x2": 3, "y2": 4, "x3": 5}}], "entry 1: box has"),
        ([{"frame": 0, "bbox": [1, 2, 3, 4], "confidense": 1}], "did you mean 'confidence'"),
        ([{"frame": 0, "bbox": [1, 2, 3, None]}], "entry 1: height is missing"),
        ([{"bbox": [1, 2, 3, 4]}], "has no column frame"),
        ({**COCO, "annotations": [{"image_id": 99, "bbox": [1, 2, 3, 4]}]}, "annotation 1: its image_id"),
        ({**COCO, "images": [*COCO["images"], {"id": 15, "file_name": "a/3.jpg"}]}, "image 5: is the same image or"),
        (
            {**COCO, "images": [{"id": 1, "file_name": f"{camera}/0.jpg"} for camera in "ab"]},
            "image 2: its id 1 is that of a/0.jpg and of b/0.jpg, as of two exports that were merged",
        ),
        ({"images": [{"id": 1, "file_name": "x.jpg"}], "annotations": []}, "has no number of the frame"),
        ([{"frame": 0, "x1": 0.1, "y1": 0.1, "x2": 0.4, "y2": 0.9}] * 2, "seem to be fractions of the image size"),
    ],
)
def test_half_right_json_is_refused(
    tmp_path: Path, value: str | list[object] | dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        read(BoxFile(saved(tmp_path / "x.json", value), None if "images" in value else "a"))


MOT_DPM = "1,-1,10,20,30,40,96.3,-1,-1,-1\n2,-1,10,20,30,40,-12.4,-1,-1,-1\n"


def test_scores_of_any_size_are_mapped_or_left_out_but_not_guessed(tmp_path: Path) -> None:
    path = saved(tmp_path / "det.txt", MOT_DPM)
    with pytest.raises(InputError, match=r"line 1: confidence 96.3; it must be 0 to 1;.*logit"):
        read(BoxFile(path, "a"))
    boxes, _ = read(BoxFile(path, "a"), options=BoxOptions(scores="logit", confidence_scale=100.0))
    assert boxes.confidence.tolist() == pytest.approx([1 / (1 + np.exp(-0.963)), 1 / (1 + np.exp(0.124))])
    boxes, _ = read(BoxFile(path, "a"), options=BoxOptions(scores="unknown"))
    assert np.isnan(boxes.confidence).all()


def test_the_class_column_of_mot17_truth_is_a_class(tmp_path: Path) -> None:
    path = saved(tmp_path / "gt.txt", "1,1,10,20,30,40,1,1,1\n1,2,50,20,30,40,1,3,0.5\n")
    boxes, _ = read(BoxFile(path, "a"), options=BoxOptions(classes=("1",)))
    assert boxes.target_id.tolist() == [1]
    with pytest.raises(InputError, match=r"2 classes: 1 \(1\), 3 \(1\)"):
        read(BoxFile(path, "a"))


numbers = st.floats(-50, 1000, allow_nan=False).map(lambda v: round(v, 3))
rows = st.lists(
    st.tuples(st.integers(0, 6), numbers, numbers, st.floats(2, 90), st.floats(2, 90), st.floats(0, 1)), min_size=1
)


@given(rows)
def test_boxes_exported_as_mot_or_coco_are_read_again_as_they_were(
    tmp_path_factory: pytest.TempPathFactory, given_rows: list[tuple[int, float, float, float, float, float]]
) -> None:
    tmp_path = tmp_path_factory.mktemp("again")
    table = "frame,left,top,width,height,confidence,id\n"
    table += "".join(",".join(map(repr, (*row, n))) + "\n" for n, row in enumerate(given_rows))
    boxes, survey = read(BoxFile(saved(tmp_path / "t.csv", table + "7,1,1,5,5,1,999\n"), "a"))
    there = boxes.take(boxes.box >= 0)
    write_mot(tmp_path / "t.txt", there, "tracks")
    frames = BoxOptions(frames=FrameChoice((survey.first, survey.stop)))
    again, _ = read(BoxFile(tmp_path / "t.txt", "a"), options=frames)
    back, _ = read(
        BoxFile(saved(tmp_path / "t.json", "".join(coco_texts(lambda: [there], None))), None), options=frames
    )
    for other in (again, back):
        key = lambda b: np.lexsort((b.target_id, b.frame))  # noqa: E731
        mine, others = boxes.take(key(boxes)), other.take(key(other))
        for column in ("t_ns", "frame", "target_id", "left_px", "top_px", "width_px", "height_px", "confidence"):
            assert np.array_equal(getattr(mine, column), getattr(others, column), equal_nan=True)


def test_two_keys_of_a_record_that_say_the_same_are_refused(tmp_path: Path) -> None:
    """Whichever came last counted: the number of an annotation became the identity of a track."""
    path = tmp_path / "records.json"
    record = {"frame": 0, "track_id": 3, "id": 100, "left": 1, "top": 1, "width": 20, "height": 50}
    path.write_text(json.dumps([record]))
    with pytest.raises(InputError, match="entry 1: keys 'track_id' and 'id' both state id; leave one out"):
        read(BoxFile(path, "a"))
    path.write_text(json.dumps([{"frame": 0, "bbox": [1, 1, 20, 50], "x1": 5, "score": 0.5}]))
    with pytest.raises(InputError, match="keys 'bbox' and 'x1' both state left"):
        read(BoxFile(path, "a"))


@pytest.mark.parametrize("names", ["cx,cy,w,h", "x_center,y_center,width,height"])
def test_centres_are_columns(tmp_path: Path, names: str) -> None:
    path = saved(tmp_path / "b.csv", f"frame,{names}\n0,100,50,20,40\n1,nan,50,20,40\n2,90,50,20,40\n3,80,50,20,40\n")
    boxes, _ = read(BoxFile(path, "a"), options=replace(PEOPLE, lenient=True))
    assert edges(boxes) == [[90, 30, 20, 40], [80, 30, 20, 40], [70, 30, 20, 40]]
    record = {"frame": 0, **dict(zip(names.split(","), (100, 50, 20, 40), strict=True))}
    assert edges(read(BoxFile(saved(tmp_path / "b.json", [record]), "a"))[0]) == [[90, 30, 20, 40]]


def test_centres_next_to_edges_are_refused(tmp_path: Path) -> None:
    path = saved(tmp_path / "b.csv", "frame,cx,cy,left,top,w,h\n0,100,50,90,30,20,40\n")
    with pytest.raises(InputError, match="both left edges and centres"):
        read(BoxFile(path, "a"))


def test_names_of_images_have_the_number_of_the_frame(tmp_path: Path) -> None:
    rows = "x/f_000007.jpg,1,2,21,42\nx\\f_000009.jpg,1,2,21,42\n"
    boxes, _ = read(BoxFile(saved(tmp_path / "b.csv", f"filename,xmin,ymin,xmax,ymax\n{rows}"), "a"))
    assert boxes.frame[boxes.box >= 0].tolist() == [7, 9]
    rows = "filename,xmin,ymin,xmax,ymax,width,height\nf_7.jpg,1,2,21,42,640,480\n"
    with pytest.raises(InputError, match="is width of the image"):
        read(BoxFile(saved(tmp_path / "c.csv", rows), "a"))
    with pytest.raises(InputError, match=r"line 2: image 'f.jpg' has no number"):
        read(BoxFile(saved(tmp_path / "d.csv", "filename,xmin,ymin,xmax,ymax\nf.jpg,1,2,21,42\n"), "a"))


def test_label_studio_is_named(tmp_path: Path) -> None:
    task = {"id": 1, "video": "a.mp4", "annotations": [{"result": []}]}
    with pytest.raises(InputError, match="JSON of Label Studio, which is not read; export it as COCO or YOLO"):
        read(BoxFile(saved(tmp_path / "b.json", [task]), "a"))


@pytest.mark.parametrize("frame", ["1e-9", "x", "", "9" * 5000])
def test_a_frame_of_cvat_that_is_no_number_is_refused(tmp_path: Path, frame: str) -> None:
    box = f'<box frame="{frame}" outside="0" xtl="1" ytl="2" xbr="5" ybr="9"/>'
    text = f'<?xml version="1.0"?><annotations><track id="1" label="person">{box}</track></annotations>'
    path = saved(tmp_path / "a.xml", text)
    with pytest.raises(InputError, match=r"box 1: (frame is|a cell of more)"):
        read(BoxFile(path, "a"))


def test_a_task_of_cvat_with_every_fifth_frame_has_no_others(tmp_path: Path) -> None:
    task = "<start_frame>0</start_frame><stop_frame>20</stop_frame><frame_filter>step=5</frame_filter>"
    box = '<box frame="{}" outside="0" xtl="1" ytl="2" xbr="21" ybr="42"/>'
    track = f'<track id="0" label="person">{box.format(5)}{box.format(10)}</track>'
    text = f'<?xml version="1.0"?><annotations><meta><task>{task}</task></meta>{track}</annotations>'
    boxes, _ = read(BoxFile(saved(tmp_path / "b.xml", text), "a"))
    assert boxes.frame.tolist() == [0, 5, 10, 15, 20]
    assert boxes.box.tolist() == [-1, 0, 0, -1, -1]
