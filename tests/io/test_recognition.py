"""What files are recognised as by their content, with the samples that readers are tried on."""

from __future__ import annotations

from pathlib import Path

import folders as make
import pytest
from people_boxes import hall

from occlog.io.recognition import FileKind, contents_of, read_sequence_info

TEXTS = {
    "det.txt": ("1,-1,10,20,5,9,0.9,-1,-1,-1\n", [FileKind.BOXES, FileKind.TRUTH]),
    "b.csv": ("frame,camera,left,top,width,height\n0,a,1,2,3,4\n", [FileKind.BOXES, FileKind.TRUTH]),
    "t.csv": ("time,id,x,y\n0,1,2.0,3.0\n", [FileKind.TRUTH]),
    "p.csv": ("time,x,y,score\n0,2.0,3.0,0.9\n", [FileKind.POSITIONS, FileKind.TRUTH]),
    "d.csv": ("time,sensor,azimuth_deg\n0,a,30\n", [FileKind.DIRECTIONS]),
    "o.json": ('{"timeStamp": 3, "src": [{"id": 1, "x": 1.0, "y": 0.0, "z": 0.0}]}\n', [FileKind.DIRECTIONS]),
    "c.json": ('{"images": [], "annotations": [], "categories": []}', [FileKind.BOXES]),
    "s.csv": ("name,x,y\na,0,1\n", [FileKind.STATIONS]),
    "r.csv": ("anchor,x,y,z\na,0,1,2\n", [FileKind.STATIONS]),
    "m.csv": ("x,y,z\n0,0,1\n", [FileKind.MICROPHONES]),
    "k.csv": ("time,reader,tag,rssi\n0,a,7,-60\n", [FileKind.READS]),
    "l.csv": ("time,station,range_m\n0,a,3.5\n", [FileKind.TABLE]),
    "times.csv": ("frame,time\n0,0.0\n1,0.1\n", [FileKind.TIMES]),
    "timestamps.txt": ("0.0\n0.1\n", [FileKind.TIMES]),
    "h.yaml": ("occlog_scene: 1\n", [FileKind.SCENE]),
    "run.yaml": ("occlog_run: 1\n", [FileKind.CONFIGURATION]),
    "seqinfo.ini": ("[Sequence]\nframeRate=30\nimWidth=64\nimHeight=48\n", [FileKind.SEQUENCE]),
    "cam_H.txt": ("500 0 3\n0 500 2\n0.1 0.2 1\n", [FileKind.CALIBRATION]),
    "cam_P.txt": ("500 0 3 1\n0 500 2 1\n0.1 0.2 1 1\n", [FileKind.CALIBRATION]),
    "mics.txt": ("0 0 1\n0.1 0 1\n0 0.1 1\n", [FileKind.MICROPHONES]),
    "README.txt": ("Recorded in the hall on Monday.\n", []),
    "costs.csv": ("item,euro\ncamera,120\n", []),
    "empty.csv": ("", []),
    "page.html": ("<html><body>1</body></html>", []),
    "config.yaml": ("a: 1\nb: [2, 3]\n", []),
    "settings.json": ('{"a": 1}', [FileKind.BOXES]),
}
"""Names and texts of files, and their kinds; any JSON object may be a record of a box, until it is opened."""


@pytest.mark.parametrize("name", TEXTS)
def test_kinds_of_texts(tmp_path: Path, name: str) -> None:
    text, kinds = TEXTS[name]
    (tmp_path / name).write_text(text)
    assert [content.kind for content in contents_of(tmp_path / name)] == kinds


def test_kinds_of_folders_and_binary_files(tmp_path: Path) -> None:
    make.yolo(tmp_path / "yolo", "a")
    make.opencv(tmp_path / "calib", hall("a"))
    make.kalibr(tmp_path / "chain.yaml", hall("ab"))
    make.colmap(tmp_path / "sparse", hall("ab"))
    make.pairs(tmp_path / "pairs", hall("ab"))
    make.sound(tmp_path)
    make.litter(tmp_path)
    make.recording(tmp_path / "walk.mcap")
    make.truth_parquet(tmp_path / "truth.parquet")
    found = {path.name: [content.kind.value for content in contents_of(path)] for path in tmp_path.iterdir()}
    assert found == {
        "yolo": ["boxes"], "calib": [], "chain.yaml": ["calibration"], "sparse": ["calibration"],
        "pairs": ["calibration"], "talk.wav": ["sound"], "table_microphones.csv": ["microphones"], "README.txt": [],
        "notes.md": [], "scene.md": [], "thumbnails": ["images"], "plan.png": [], ".git": [], "costs.csv": [],
        "walk.mcap": ["recording"], "truth.parquet": ["truth"],
    }  # fmt: skip
    assert [c.words for c in contents_of(tmp_path / "calib" / "a.yaml")] == ["calibration, opencv-storage"]


def test_descriptions_of_sequences(tmp_path: Path) -> None:
    (tmp_path / "seqinfo.ini").write_text("[Sequence]\nname=A-01\nframeRate=29.97\nimWidth=1920\nimHeight=1080\n")
    assert read_sequence_info(tmp_path / "seqinfo.ini") == ("A-01", "29.97", (1920, 1080))
