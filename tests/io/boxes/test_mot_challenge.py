"""MOTChallenge text and folders: what is written, and that reading it gives the same boxes."""

from __future__ import annotations

import configparser
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from occlog.errors import InputError, OutputError, OutputExistsError
from occlog.io.files.timing.frame_choice import FrameChoice
from occlog.io.formats.boxes.mot_challenge import (
    MotSequence,
    WrittenSequence,
    write_layout,
    write_mot,
    write_sequence,
    write_sequence_list,
)
from occlog.io.formats.boxes.reader import BoxFile, BoxOptions, read_boxes, survey_boxes
from occlog.io.frames.streams import rate_times
from occlog.records.tables import Boxes, TruthBoxes

INFO = WrittenSequence("walk", 20, 25.0, 640, 480)


def table(seed: int = 0, kind: type[Boxes] = Boxes, frames: int = 12) -> Boxes:
    """Boxes of one camera with frames that have none, and confidences that are not given."""
    rng = np.random.default_rng(seed)
    parts = []
    for frame in range(frames):
        ids = np.sort(rng.permutation(6)[: rng.integers(0, 5)]) if 0 < frame < frames - 1 else np.array([0, 3])
        n = max(len(ids), 1)
        blank = np.full(n, np.nan)
        place = rng.normal(100.0, 60.0, (n, 2))
        size = rng.uniform(1.0, 90.0, (n, 2))
        sure = np.where(rng.random(n) < 0.4, np.nan, rng.random(n))
        there = len(ids) > 0
        parts.append(
            kind.of(
                t_ns=np.full(n, frame * 40_000_000),
                sensor=np.full(n, "left"),
                frame=np.full(n, frame),
                box=np.arange(n, dtype=np.int32) if there else np.array([-1], dtype=np.int32),
                target_id=ids.astype(np.int32) if there else np.array([-1], dtype=np.int32),
                left_px=place[:, 0] if there else blank,
                top_px=place[:, 1] if there else blank,
                width_px=size[:, 0] if there else blank,
                height_px=size[:, 1] if there else blank,
                confidence=sure if there else blank,
            )
        )
    return kind.concat(parts)


def read(path: Path, frames: int = 12) -> Boxes:
    file, options = [BoxFile(path, "left")], BoxOptions(frames=FrameChoice((0, frames)))
    survey = survey_boxes(file, (), options)
    times = {"left": rate_times(Fraction(25), "given")}
    return Boxes.concat(read_boxes(file, survey, times, (), options, Boxes))


@pytest.mark.parametrize("seed", range(5))
def test_tracks_come_back_as_they_were(tmp_path: Path, seed: int) -> None:
    boxes = table(seed)
    shuffled = boxes.take(np.lexsort((np.random.default_rng(seed).random(len(boxes)), boxes.t_ns)))
    write_mot(tmp_path / "t.txt", shuffled, "tracks")
    again = read(tmp_path / "t.txt")
    for column in Boxes.columns():
        np.testing.assert_array_equal(getattr(again, column.name), getattr(boxes, column.name), column.name)


def test_lines_are_those_of_the_format(tmp_path: Path) -> None:
    one = table().take(np.array([0]))
    one.left_px[:], one.top_px[:], one.width_px[:], one.height_px[:], one.confidence[:] = -2.5, 3, 10, 20.25, np.nan
    texts = {}
    for kind in ("tracks", "detections", "truth"):
        write_mot(tmp_path / kind, one, kind)
        texts[kind] = (tmp_path / kind).read_text()
    assert texts["tracks"] == "1,0,-2.5,3.0,10.0,20.25,-1,-1,-1,-1\n"
    assert texts["detections"] == "1,-1,-2.5,3.0,10.0,20.25,-1,-1,-1,-1\n"
    assert texts["truth"] == "1,0,-2.5,3.0,10.0,20.25,1,1,1\n"


def test_detections_lose_their_identities_and_nothing_else(tmp_path: Path) -> None:
    boxes = table(3)
    write_mot(tmp_path / "det.txt", boxes, "detections")
    again = read(tmp_path / "det.txt")
    assert (again.target_id == -1).all()
    np.testing.assert_array_equal(again.left_px, boxes.left_px)
    np.testing.assert_array_equal(again.confidence, boxes.confidence)


def test_a_sequence_is_a_folder_that_says_its_length(tmp_path: Path) -> None:
    truth = table(1, TruthBoxes)
    write_sequence(tmp_path / "all" / "walk", truth, INFO)
    parser = configparser.ConfigParser()
    parser.read(tmp_path / "all" / "walk" / "seqinfo.ini")
    values = dict(parser["Sequence"])
    assert (values["name"], values["seqlength"], values["framerate"]) == ("walk", "20", "25")
    assert (values["imwidth"], values["imheight"]) == ("640", "480")
    again = read(tmp_path / "all" / "walk" / "gt" / "gt.txt")
    np.testing.assert_array_equal(again.width_px, truth.width_px)
    np.testing.assert_array_equal(again.target_id, truth.target_id)
    assert (again.confidence[again.box >= 0] == 1).all()
    write_sequence_list(tmp_path / "list.txt", ["walk", "run"])
    assert (tmp_path / "list.txt").read_text() == "name\nwalk\nrun\n"


def test_no_boxes_at_all_are_an_empty_file(tmp_path: Path) -> None:
    write_mot(tmp_path / "t.txt", Boxes.empty(), "tracks")
    assert (tmp_path / "t.txt").read_text() == ""


def test_what_the_format_cannot_hold_is_refused(tmp_path: Path) -> None:
    boxes = table(2)
    path = tmp_path / "t.txt"
    sensors = np.where(np.arange(len(boxes)) == 0, "rite", "left")
    two = Boxes.of(**{**_values(boxes), "sensor": sensors})
    with pytest.raises(InputError, match="boxes of 2 cameras \\(left, rite\\)"):
        write_mot(path, two, "tracks")
    lone = boxes.take(np.array([0]))
    lone.target_id[:] = -1
    with pytest.raises(InputError, match="frame 0 has no identity"):
        write_mot(path, lone, "tracks")
    with pytest.raises(InputError, match="identity 0 has two boxes in frame 0"):
        write_mot(path, boxes.take(np.array([0, 0])), "tracks")
    with pytest.raises(InputError, match="frame 11, but the last frame of the sequence is 9"):
        write_sequence(tmp_path / "seq", TruthBoxes.of(**_values(boxes)), INFO._replace(frames=10))
    assert not path.exists()
    assert not (tmp_path / "seq").exists()
    path.write_text("old")
    with pytest.raises(OutputExistsError):
        write_mot(path, boxes, "tracks")
    assert path.read_text() == "old"
    with pytest.raises(OutputError):
        write_sequence(path, TruthBoxes.of(**_values(boxes)), INFO)


def _values(boxes: Boxes) -> dict[str, object]:
    return {c.name: getattr(boxes, c.name) for c in Boxes.columns()}


def boxes(kind: type[Boxes], left: float = 1.5) -> Boxes:
    return kind.of(
        t_ns=[0, 1],
        sensor=["east", "east"],
        frame=[0, 1],
        box=np.zeros(2, np.int32),
        target_id=np.array([4, 4], np.int32),
        left_px=[left, left],
        top_px=[2.0, 2.0],
        width_px=[3.0, 3.0],
        height_px=[4.0, 4.0],
        confidence=[np.nan, np.nan],
    )


def sequence(name: str = "east", left: float = 1.5) -> MotSequence:
    info = WrittenSequence(name, 2, 25.0, 320, 240)
    return MotSequence(info, boxes(TruthBoxes), boxes(Boxes, left))  # type: ignore[arg-type]


def files(folder: Path) -> dict[str, str]:
    return {str(p.relative_to(folder)): p.read_text() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_tracks_of_two_programs_share_the_truth(tmp_path: Path) -> None:
    folder = tmp_path / "mot"
    write_layout(folder, "bmct", [sequence()])
    write_layout(folder, "mipf", [sequence(left=7.0)])
    assert list(tmp_path.iterdir()) == [folder]
    found = files(folder)
    assert found["gt/MOT17-train/east/gt/gt.txt"] == "1,4,1.5,2.0,3.0,4.0,1,1,1\n2,4,1.5,2.0,3.0,4.0,1,1,1\n"
    assert "seqLength=2\n" in found["gt/MOT17-train/east/seqinfo.ini"]
    assert found["gt/seqmaps/MOT17-train.txt"] == "name\neast\n"
    assert found["trackers/MOT17-train/bmct/data/east.txt"].startswith("1,4,1.5,")
    assert found["trackers/MOT17-train/mipf/data/east.txt"].startswith("1,4,7.0,")
    assert len(found) == 5


def test_nothing_is_replaced_unless_asked_for(tmp_path: Path) -> None:
    folder = tmp_path / "mot"
    write_layout(folder, "bmct", [sequence()])
    before = files(folder)
    with pytest.raises(OutputExistsError, match="another content"):
        write_layout(folder, "bmct", [sequence("north"), sequence(left=9.0)])
    assert files(folder) == before
    assert list(tmp_path.iterdir()) == [folder]
    write_layout(folder, "bmct", [sequence()])
    write_layout(folder, "bmct", [sequence(left=9.0)], overwrite=True)
    assert files(folder) != before


def test_what_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="name a folder"):
        write_layout(tmp_path / "file", "bmct", [sequence()])
    with pytest.raises(OutputError, match="make it first"):
        write_layout(tmp_path / "no" / "mot", "bmct", [sequence()])
    with pytest.raises(InputError, match="cannot be the name"):
        write_layout(tmp_path / "mot", "../up", [sequence()])
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
