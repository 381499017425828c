"""The folder of truth and tracks that TrackEval evaluates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from occlog.errors import InputError, OutputError, OutputExistsError
from occlog.io.boxes.mot_challenge import SequenceInfo
from occlog.io.boxes.trackeval_folder import MotSequence, write_layout
from occlog.records.tables import Boxes, TruthBoxes


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
    info = SequenceInfo(name, 2, 25.0, 320, 240)
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
