"""Frames of cameras of unequal rate, number or numbering: each keeps its own, and no frame is made up."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from occlog.errors import InputError, UsageError
from occlog.io.files.timing.frame_choice import FrameChoice
from occlog.io.files.timing.frame_times import FrameTimes
from occlog.io.formats.boxes.reader import BoxFile, BoxOptions, read_boxes, survey_boxes
from occlog.io.frames.streams import rate_times, sidecar_times
from occlog.records.tables import Boxes


def table(
    path: Path, frames: list[int], times: list[float] | None = None, column: str = "time", boxes: int = 1
) -> Path:
    """A table with `boxes` boxes in each frame."""
    head = f"frame,left,top,width,height{f',{column}' if times else ''}"
    rows = [
        f"{frame},{10 + 30 * box},{20 + n % 7},20,50{f',{times[n]}' if times else ''}"
        for n, frame in enumerate(frames)
        for box in range(boxes)
    ]
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


def frames_of(
    *files: BoxFile, times: dict[str, FrameTimes] | None = None, options: BoxOptions | None = None
) -> dict[str, list[int]]:
    """Numbers of the frames of each camera, with and without boxes."""
    how = options or BoxOptions()
    survey = survey_boxes(files, (), how)
    clocks = {**survey.times, **(times or {})}
    found = Boxes.merge(list(read_boxes(files, survey, clocks, (), how, Boxes)))
    ranges = survey.frames(clocks)
    frames = {name: sorted(set(found.frame[found.sensor == name].tolist())) for name in survey.cameras}
    assert frames == {name: list(each) for name, each in ranges.items()}
    return frames


def at(hz: float) -> FrameTimes:
    return rate_times(Fraction(hz), "given")


def test_cameras_of_unequal_rate_by_a_column_of_times(tmp_path: Path) -> None:
    left = table(tmp_path / "l.csv", list(range(200)), [k / 10 for k in range(200)])
    right = table(tmp_path / "r.csv", list(range(40)), [k / 2 for k in range(40)])
    assert frames_of(BoxFile(left, "l"), BoxFile(right, "r")) == {"l": list(range(200)), "r": list(range(40))}


@pytest.mark.parametrize(("fast", "slow"), [(10, 2), (30, 12.5), (29.97, 25)])
def test_cameras_of_unequal_rate_by_given_rates(tmp_path: Path, fast: float, slow: float) -> None:
    """The last frame of each is the last one that is not after the last box of the other, within half a frame."""
    left, right = table(tmp_path / "l.csv", list(range(300))), table(tmp_path / "r.csv", [0, 5])
    found = frames_of(BoxFile(left, "l"), BoxFile(right, "r"), times={"l": at(fast), "r": at(slow)})
    assert found == {"l": list(range(300)), "r": list(range(int((299 + 0.5) / fast * slow) + 1))}


def test_a_slow_camera_that_counts_the_frames_of_a_fast_one(tmp_path: Path) -> None:
    left, right = table(tmp_path / "l.csv", list(range(200))), table(tmp_path / "r.csv", list(range(0, 200, 5)))
    clocks = dict.fromkeys("lr", at(10))
    assert frames_of(BoxFile(left, "l"), BoxFile(right, "r"), times=clocks) == {
        "l": list(range(200)),
        "r": list(range(0, 200, 5)),
    }


def test_few_frames_in_steps_are_those_of_a_detector_that_missed_people(tmp_path: Path) -> None:
    left, right = table(tmp_path / "l.csv", list(range(40))), table(tmp_path / "r.csv", [0, 2, 4, 10, 20])
    found = frames_of(BoxFile(left, "l"), BoxFile(right, "r"), times=dict.fromkeys("lr", at(10)))
    assert found["r"] == list(range(40))


def test_folders_of_labels_in_unequal_steps(tmp_path: Path) -> None:
    for name, step in (("l", 1), ("r", 5)):
        folder = tmp_path / "labels" / name
        folder.mkdir(parents=True)
        for n in range(0, 100, step):
            (folder / f"{n:04d}.txt").write_text("0 .5 .5 .1 .2\n")
    options = BoxOptions(classes=(), sizes={"l": (640, 480), "r": (640, 480)})
    found = frames_of(BoxFile(tmp_path / "labels", None), times=dict.fromkeys("lr", at(10)), options=options)
    assert found == {"l": list(range(100)), "r": list(range(0, 100, 5))}


def coco(path: Path, images: int) -> Path:
    """COCO with a box in the first three frames alone."""
    path.write_text(
        json.dumps(
            {
                "images": [{"id": n, "file_name": f"{n}.jpg"} for n in range(images)],
                "annotations": [{"id": n, "image_id": n, "bbox": [1, 2, 30, 40], "category_id": 1} for n in range(3)],
                "categories": [{"id": 1, "name": "person"}],
            }
        )
    )
    return path


def test_a_format_that_lists_its_images_states_how_many_a_camera_has(tmp_path: Path) -> None:
    files = BoxFile(coco(tmp_path / "l.json", 100), "l"), BoxFile(coco(tmp_path / "r.json", 60), "r")
    found = frames_of(*files, times=dict.fromkeys("lr", at(10)), options=BoxOptions(classes=()))
    assert found == {"l": list(range(100)), "r": list(range(60))}


def test_a_camera_that_stops_with_people_in_view_has_no_frames_afterwards(tmp_path: Path) -> None:
    left = table(tmp_path / "l.csv", list(range(200)), boxes=3)
    for boxes, last in ((3, 100), (2, 100), (1, 200)):
        right = table(tmp_path / "r.csv", list(range(100)), boxes=boxes)
        found = frames_of(BoxFile(left, "l"), BoxFile(right, "r"), times=dict.fromkeys("lr", at(10)))
        assert found["r"] == list(range(last))
    late = table(tmp_path / "r.csv", list(range(50, 200)), boxes=2)
    found = frames_of(BoxFile(left, "l"), BoxFile(late, "r"), times=dict.fromkeys("lr", at(10)))
    assert found["r"] == list(range(50, 200))


def test_a_camera_without_boxes_in_the_last_frames_has_them(tmp_path: Path) -> None:
    left = table(tmp_path / "l.csv", list(range(200)), boxes=3)
    right = table(tmp_path / "r.csv", list(range(5, 191)), boxes=3)
    found = frames_of(BoxFile(left, "l"), BoxFile(right, "r"), times=dict.fromkeys("lr", at(10)))
    assert found["r"] == list(range(200))


def test_times_in_a_file_end_the_frames_of_a_camera(tmp_path: Path) -> None:
    left, right = table(tmp_path / "l.csv", list(range(200))), table(tmp_path / "r.csv", list(range(30)))
    clocks = {"l": at(10), "r": sidecar_times(np.arange(35, dtype=np.int64) * 10**8, "r.txt")}
    assert frames_of(BoxFile(left, "l"), BoxFile(right, "r"), times=clocks)["r"] == list(range(35))


def test_cameras_with_clocks_of_other_origins_keep_the_same_frames(tmp_path: Path) -> None:
    left, right = table(tmp_path / "l.csv", list(range(50))), table(tmp_path / "r.csv", list(range(40)))
    clocks = {"l": at(10), "r": rate_times(Fraction(10), "given", 10**18)}
    assert frames_of(BoxFile(left, "l"), BoxFile(right, "r"), times=clocks)["r"] == list(range(50))


def test_a_stated_range_is_that_of_all_cameras_in_their_steps(tmp_path: Path) -> None:
    left, right = table(tmp_path / "l.csv", list(range(50))), table(tmp_path / "r.csv", list(range(0, 50, 2)), boxes=2)
    files = BoxFile(left, "l"), BoxFile(right, "r")
    options = BoxOptions(frames=FrameChoice((9, 60)))
    found = frames_of(*files, times={"l": at(10), "r": at(10)}, options=options)
    assert found == {"l": list(range(9, 60)), "r": list(range(10, 60, 2))}


def test_a_range_of_a_camera_is_its_own_and_others_keep_theirs(tmp_path: Path) -> None:
    left, right = table(tmp_path / "l.csv", list(range(200))), table(tmp_path / "r.csv", list(range(40)))
    files, clocks = (BoxFile(left, "l"), BoxFile(right, "r")), {"l": at(10), "r": at(2)}
    for own, expected in (
        ({"r": (5, 40)}, {"l": list(range(200)), "r": list(range(5, 40))}),
        ({"l": (0, 100), "r": (0, 20)}, {"l": list(range(100)), "r": list(range(20))}),
    ):
        options = BoxOptions(frames=FrameChoice(own=own))
        assert frames_of(*files, times=clocks, options=options) == expected
        assert survey_boxes(files, (), options).rows == sum(
            len(set(range(200 if n == "l" else 40)) & set(expected[n])) for n in "lr"
        )


def test_one_range_of_cameras_of_unequal_rate_is_refused(tmp_path: Path) -> None:
    left, right = table(tmp_path / "l.csv", list(range(200))), table(tmp_path / "r.csv", list(range(40)))
    survey = survey_boxes([BoxFile(left, "l"), BoxFile(right, "r")], (), BoxOptions(frames=FrameChoice((0, 200))))
    with pytest.raises(UsageError, match=r"0:200: cameras have 10 \(l\) and 2 \(r\) frames per second.* l=0:200"):
        survey.frames({"l": at(10), "r": at(2)})


@pytest.mark.parametrize("column", ["time", "t", "timestamp"])
def test_times_in_another_unit_are_asked_for(tmp_path: Path, column: str) -> None:
    path = table(tmp_path / "l.csv", list(range(100)), [100 * k for k in range(100)], column)
    with pytest.raises(InputError, match=rf"column {column}: 100 s from frame to frame .*: t_ms, t_us or t_ns, or t_s"):
        survey_boxes([BoxFile(path, "l")], (), BoxOptions())


@pytest.mark.parametrize(("column", "step", "step_s"), [("t_ms", 100, 0.1), ("t_s", 100, 100.0), ("time", 1.9, 1.9)])
def test_times_in_a_stated_or_possible_unit_are_taken(tmp_path: Path, column: str, step: float, step_s: float) -> None:
    path = table(tmp_path / "l.csv", list(range(100)), [step * k for k in range(100)], column)
    survey = survey_boxes([BoxFile(path, "l")], (), BoxOptions())
    assert survey.times["l"].at(np.array([1])).tolist() == [round(step_s * 1e9)]


@pytest.mark.parametrize("factor", [1e3, 1e6])
def test_times_of_one_camera_in_another_unit_than_its_column_states_are_refused(tmp_path: Path, factor: float) -> None:
    """The others had frames for as long as that, which took gigabytes."""
    files = [table(tmp_path / f"{c}.csv", list(range(100)), [0.1 * k for k in range(100)], "t_s") for c in "ab"]
    files.append(table(tmp_path / "c.csv", list(range(100)), [0.1 * factor * k for k in range(100)], "t_s"))
    with pytest.raises(InputError, match=r"c\.csv: camera c: frames are 1e?\+?0\d+ s apart") as error:
        survey_boxes([BoxFile(path, path.stem) for path in files], (), BoxOptions())
    assert error.value.id == "missing-unit"


def test_dates_and_sparse_boxes_are_no_reason_to_ask(tmp_path: Path) -> None:
    dates = [f"2026-05-01T12:{k:02d}:00" for k in range(30)]
    assert survey_boxes([BoxFile(table(tmp_path / "d.csv", list(range(30)), dates), "l")], (), BoxOptions()).times
    sparse = table(tmp_path / "s.csv", list(range(0, 9000, 300)), [30.0 * k for k in range(30)])
    assert survey_boxes([BoxFile(sparse, "l")], (), BoxOptions()).times


def test_the_cases_of_shared_recordings(shared_cases: Path) -> None:
    case = shared_cases / "v14-cameras-of-unequal-rate"
    found = frames_of(BoxFile(case / "left.csv", "left"), BoxFile(case / "right.csv", "right"))
    assert {name: len(each) for name, each in found.items()} == {"left": 200, "right": 40}
    case = shared_cases / "v06-time-column-in-ms"
    with pytest.raises(InputError, match="column time: 100 s from frame to frame"):
        survey_boxes([BoxFile(case / "left.csv", "left")], (), BoxOptions())


def test_a_camera_has_no_more_frames_than_were_recorded(tmp_path: Path) -> None:
    left, right = table(tmp_path / "l.csv", list(range(50))), table(tmp_path / "r.csv", list(range(20)))
    survey = survey_boxes([BoxFile(left, "l"), BoxFile(right, "r")], (), BoxOptions())
    clocks = dict.fromkeys("lr", at(10))
    assert survey.frames(clocks)["r"] == range(50)
    assert replace(survey, recorded={"r": 30}).frames(clocks) == {"l": range(50), "r": range(30)}
    assert replace(survey, recorded={"r": 10}).frames(clocks)["r"] == range(20)
