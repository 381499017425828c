"""`occlog evaluate` on tracks of many targets: files, options, one-line errors."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mot_published import PUBLISHED

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.inputs import hash_inputs
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_provenance, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.io.frames.codec import encode_image
from occlog.io.recording.writer import RecordingWriter
from occlog.records.declared.views import Failures, ViewTracks
from occlog.records.tables import Boxes, Tracks, Truth, TruthBoxes

NS = 40_000_000
FRAMES = 10
MADE = Provenance("test")
SCENE = """
occlog_scene: 1
room: [[0, 0], [20, 0], [20, 20], [0, 20]]
cameras:
  - {name: east, position: [0, 10], yaw_deg: 0, focal_px: 100, fov_deg: 90, image_size_px: [320, 240]}
  - {name: north, position: [10, 0], yaw_deg: 90, focal_px: 100, fov_deg: 90, image_size_px: [320, 240]}
"""


def base(cameras: tuple[str, ...], targets: int) -> dict[str, Any]:
    n = FRAMES * len(cameras) * targets
    frame = np.repeat(np.arange(FRAMES), n // FRAMES)
    return {
        "t_ns": frame * NS,
        "sensor": np.tile(np.repeat(cameras, targets), FRAMES),
        "frame": frame,
        "target_id": np.tile(np.arange(targets, dtype=np.int32), FRAMES * len(cameras)),
    }


def true_boxes() -> TruthBoxes:
    """Three targets in two cameras, each 30 x 20 px, 60 px apart."""
    made = base(("east", "north"), 3)
    n = len(made["frame"])
    return TruthBoxes.of(
        **made,
        box=made["target_id"],
        left_px=60.0 * made["target_id"] + made["frame"],
        top_px=np.full(n, 50.0),
        width_px=np.full(n, 30.0),
        height_px=np.full(n, 20.0),
        confidence=np.full(n, np.nan),
        visible=np.full(n, 0.7),
    )


def view_tracks() -> ViewTracks:
    """Trackers on their targets; in `east` those of 0 and 1 swap in the last four frames."""
    made = base(("east", "north"), 3)
    n = len(made["frame"])
    x = 60.0 * made["target_id"] + made["frame"] + 15.0
    swapped = (made["frame"] >= 6) & (made["sensor"] == "east") & (made["target_id"] < 2)
    made["target_id"] = np.where(swapped, 1 - made["target_id"], made["target_id"]).astype(np.int32)
    zero, none = np.zeros(n), np.full(n, "")
    return ViewTracks.of(
        **made,
        x_px=x,
        y_px=np.full(n, 60.0),
        a_px=np.full(n, 15.0),
        b_px=np.full(n, 10.0),
        rho=zero,
        cov_xx_px=zero + 1,
        cov_xy_px=zero,
        cov_yy_px=zero + 1,
        similarity=zero + 1,
        ess=zero + 9,
        likelihood_mode=none,
        counterpart=none,
        neighbours=none,
        assisting_views=none,
        lifecycle=none,
    )


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder with view tracks, a recording with the truth, and tables."""
    write_table(tmp_path / "view_tracks.parquet", view_tracks(), MADE)
    write_table(tmp_path / "truth.parquet", true_boxes(), MADE)
    with RecordingWriter(tmp_path / "recording.mcap", scene_from_yaml(SCENE, "scene"), MADE) as writer:
        writer.table(true_boxes())
    monkeypatch.chdir(tmp_path)
    return tmp_path


EVALUATE = ["evaluate", "view_tracks.parquet", "--truth", "recording.mcap"]
XML = ["evaluate", "view_tracks.parquet", "--truth", "boxes.xml", "--camera", "east"]


def figures(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> dict[str, float]:
    assert run([*arguments, "--json"]) == ExitCode.DONE
    return json.loads(capsys.readouterr().out)  # type: ignore[no-any-return]


def error(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit code and the one line of an error."""
    capsys.readouterr()
    code = run(arguments)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    return code, lines[0]


def test_outputs_and_figures(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([*EVALUATE, "-o", "m.json", "--failures", "f.parquet", "--mot", "mot"]) == ExitCode.DONE
    captured = capsys.readouterr()
    # Where no kernels are kept yet, a line before these says that they are compiled
    assert captured.err.splitlines()[-3:] == ["occlog: wrote m.json", "occlog: wrote f.parquet", "occlog: wrote mot"]
    assert "FR_p" in captured.out
    table, verdict = captured.out.strip().split("\n\n")[-2:]
    assert [line.split()[0] for line in table.splitlines()[-3:]] == ["sensor", "east", "north"]
    assert "plausible" in verdict
    metrics = json.loads((folder / "m.json").read_text())
    wanted = {"fr_l": 8 / 60, "fr_l_sensor_east": 8 / 30, "fr_l_sensor_north": 0.0, "fr_p": 0.0, "id_switches": 2}
    assert {name: metrics[name] for name in wanted} == pytest.approx(wanted)
    assert metrics["_provenance"]["parameters"]["assigned_target"] == "id"
    failures = read_table(folder / "f.parquet", Failures)
    assert (len(failures), set(failures.kind), set(failures.visible)) == (8, {"label"}, {0.7})
    assert [name for name, _ in read_provenance(folder / "f.parquet").inputs] == [
        "view_tracks.parquet",
        "recording.mcap",
    ]
    ini = (folder / "mot/gt/MOT17-train/east/seqinfo.ini").read_text()
    for line in ("name=east", "frameRate=25", "seqLength=10", "imWidth=320"):
        assert f"{line}\n" in ini
    assert (folder / "mot/trackers/MOT17-train/view_tracks/data/north.txt").is_file()
    assert run([*EVALUATE, "--mot", "mot"]) == ExitCode.DONE  # the same content


def test_files_of_other_programs_give_the_same_figures(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([*EVALUATE, "--mot", "mot", "-q"]) == ExitCode.DONE
    capsys.readouterr()
    own = figures([*EVALUATE, "--camera", "east"], capsys)
    text, true = "mot/trackers/MOT17-train/view_tracks/data/east.txt", "mot/gt/MOT17-train/east/gt/gt.txt"
    one = ["--camera", "east", "--assigned-target", "id"]
    similar = {**own, "objects_ignored": 0.0, "tracks_on_distractors": 0.0}  # every true box is a pedestrian
    assert figures(["evaluate", text, "--truth", true, "--assigned-target", "id"], capsys) == similar
    assert figures(["evaluate", text, "--truth", "recording.mcap", *one], capsys) == own
    assert figures(["evaluate", "view_tracks.parquet", "--truth", true, *one], capsys) == similar
    tracks = read_table(folder / "truth.parquet", TruthBoxes)
    write_table(folder / "boxes.parquet", Boxes.of(**{c.name: getattr(tracks, c.name) for c in Boxes.columns()}), MADE)
    got = figures(["evaluate", "boxes.parquet", "--truth", "truth.parquet"], capsys)
    assert (got["mota"], got["fr_l"], got["hota"]) == (1.0, 0.0, 1.0)
    # Names of another program are of no target: each track belongs to the first that it is on.
    got = figures(["evaluate", text, "--truth", true], capsys)
    assert got["label_failures"] == own["label_failures"]


def annotated(folder: Path, first: int = 0) -> dict[str, Path]:
    """True boxes of `east` as annotation tools write them; XML counts frames from `first`."""
    boxes = true_boxes()
    boxes = boxes.take(boxes.sensor == "east")
    xml, vatic, kitti = ["<dataset>"], [], []
    for number in range(FRAMES):
        xml.append(f'<frame number="{number + first}"><objectlist>')
        for k in np.flatnonzero(boxes.frame == number).tolist():
            who, left, top = int(boxes.target_id[k]), float(boxes.left_px[k]), float(boxes.top_px[k])
            xml.append(f'<object id="{who}"><box xc="{left + 15}" yc="{top + 10}" w="30" h="20"/></object>')
            edges = f"{left:g} {top:g} {left + 30:g} {top + 20:g}"
            vatic.append(f'{who} {edges} {number} 0 0 0 "PERSON"')
            kitti.append(f"{number} {who} Pedestrian 0 0 -10 {edges} -1 -1 -1 -1000 -1000 -1000 -10")
        xml.append("</objectlist></frame>")
    made = {"boxes.xml": [*xml, "</dataset>"], "vatic.txt": vatic, "kitti.txt": kitti}
    for name, lines in made.items():
        (folder / name).write_text("\n".join(lines) + "\n")
    return {name: folder / name for name in made}


@pytest.mark.parametrize("name", ["boxes.xml", "vatic.txt", "kitti.txt"])
def test_truth_of_annotation_tools_gives_the_figures_of_a_recording(
    folder: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    annotated(folder)
    one = ["--camera", "east"]
    own = figures([*EVALUATE, *one, "--failures", "of_recording.parquet"], capsys)
    assert own["id_switches"] == 2
    asked = ["evaluate", "view_tracks.parquet", "--truth", name, *one]
    assert figures([*asked, "--fps", "25", "--failures", "f.parquet"], capsys) == own
    found, wanted = (read_table(folder / f, Failures) for f in ("f.parquet", "of_recording.parquet"))
    assert np.array_equal(found.t_ns, wanted.t_ns)
    assert np.array_equal(found.target_id, wanted.target_id)
    assert run([*EVALUATE, "--mot", "mot", "-q"]) == ExitCode.DONE
    capsys.readouterr()
    text = [
        "evaluate",
        "mot/trackers/MOT17-train/view_tracks/data/east.txt",
        "--truth",
        name,
        "--assigned-target",
        "id",
    ]
    assert figures([*text, "--fps", "7", "--mot", "of_text"], capsys) == own
    assert "frameRate=7" in (folder / "of_text/gt/MOT17-train/view/seqinfo.ini").read_text()
    part = ["--frames", "0:6"]
    assert figures([*asked, *part], capsys) == figures([*EVALUATE, *one, *part], capsys)


def test_the_first_number_of_xml(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = figures([*EVALUATE, "--camera", "east"], capsys)
    annotated(folder, first=1)
    asked = ["evaluate", "view_tracks.parquet", "--truth", "boxes.xml", "--camera", "east"]
    assert figures([*asked, "--first-number", "1"], capsys) == own
    assert figures(asked, capsys) != own


def test_text_with_any_confidence_and_truth_that_does_not_count(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "gt.txt").write_text("1,1,10,10,20,20,1,1,1\n1,2,50,10,20,20,0,1,1\n2,1,10,10,20,20,1,1,1\n")
    (folder / "t.txt").write_text("1,1,10,10,20,20,-3.5\n2,1,10,10,20,20,77\n4,1,10,10,20,20,0\n")
    got = figures(["evaluate", "t.txt", "--truth", "gt.txt"], capsys)
    assert (got["objects"], got["tp"], got["fp"], got["frames"]) == (2, 2, 1, 4)


def test_thresholds_and_frames(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([*EVALUATE, "--fail-if", "fr_l>0.1", "--fail-if", "mota<0.5"]) == ExitCode.THRESHOLD
    assert "fr_l is 0.133333" in capsys.readouterr().err
    assert run([*EVALUATE, "--frames", "0:6", "--fail-if", "fr_l>0"]) == ExitCode.DONE
    assert run([*EVALUATE, "--fail-if", "fr_x>0"]) == ExitCode.USAGE
    assert "did you mean" in capsys.readouterr().err


def test_what_the_tracker_says_of_itself(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Cameras in which nothing was ever found count; numbers given at births from detections are reported."""
    tracks = view_tracks()
    east = tracks.take(tracks.sensor == "east")
    write_table(folder / "one.parquet", east, MADE)
    assert run(["evaluate", "one.parquet", "--truth", "recording.mcap"]) == ExitCode.DONE
    assert "skipped: north" in capsys.readouterr().err
    made = Provenance("track", {"cameras": ["east", "north"], "births": "detections"})
    write_table(folder / "both.parquet", east, made)
    both = ["evaluate", "both.parquet", "--truth", "recording.mcap"]
    assert run(both) == ExitCode.DONE
    assert "so that their numbers are not those of targets; --assigned-target start" in _notes(capsys)
    assert run([*both, "--assigned-target", "id"]) == ExitCode.DONE
    assert "FR needs --assigned-target start" in _notes(capsys)
    assert figures([*both, "--assigned-target", "start"], capsys)["fr_p_sensor_north"] == 1.0
    assert "born" not in _notes(capsys)
    assert figures(both, capsys) == figures([*both, "--assigned-target", "start"], capsys)
    own = {c.name: getattr(east, c.name) for c in ViewTracks.columns()}
    write_table(folder / "own.parquet", ViewTracks.of(**{**own, "target_id": east.target_id + np.int32(7)}), made)
    renamed = ["evaluate", "own.parquet", "--truth", "recording.mcap"]
    assert figures(renamed, capsys) == figures(both, capsys)
    assert figures([*renamed, "--assigned-target", "id"], capsys)["fr_l"] > figures(renamed, capsys)["fr_l"] > 0
    assert figures([*both, "--camera", "north"], capsys)["fr_p"] == 1.0


def _notes(capsys: pytest.CaptureFixture[str]) -> str:
    return capsys.readouterr().err


def test_a_recording_that_is_not_that_of_the_tracks_is_reported(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Times and cameras are the same in all three recordings; one has no video, so that nothing can be stated of it."""
    for name, level in (("own", 10), ("other", 20)):
        with RecordingWriter(folder / f"{name}.mcap", scene_from_yaml(SCENE, "scene"), MADE) as writer:
            writer.table(true_boxes())
            writer.image("east", 0, 0, encode_image(np.full((8, 8, 3), level, dtype=np.uint8), "png", 0), "png")
    made = Provenance("track", {"births": "initial"}, 0, hash_inputs([folder / "own.mcap"]))
    write_table(folder / "v.parquet", view_tracks(), made)
    for name, reported in (("own", False), ("recording", False), ("other", True)):
        assert run(["evaluate", "v.parquet", "--truth", f"{name}.mcap"]) == ExitCode.DONE
        line = "other.mcap: v.parquet was made from another file (own.mcap)"
        assert (line in _notes(capsys)) == reported
    write_table(folder / "old.parquet", view_tracks(), Provenance("track", {"births": "initial"}))
    assert run(["evaluate", "old.parquet", "--truth", "other.mcap"]) == ExitCode.DONE
    assert "another file" not in _notes(capsys)


def test_world_tracks_born_from_detections(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Numbers of their own, on the ground too: failures are swaps only, unless numbers are stated to be of targets."""
    truth, tracks = world(3, 0.1)
    with RecordingWriter(folder / "w.mcap", scene_from_yaml(SCENE, "scene"), MADE) as writer:
        writer.table(truth)
    turned = {c.name: getattr(tracks, c.name) for c in Tracks.columns()}
    turned["target_id"] = (turned["target_id"] + 1) % 3
    order = np.lexsort((turned["target_id"], turned["t_ns"]))
    initiated = Tracks.of(**{name: column[order] for name, column in turned.items()})
    write_table(folder / "w.parquet", initiated, Provenance("track", {"births": "detections"}))
    asked = ["evaluate", "w.parquet", "--truth", "w.mcap"]
    assert figures(asked, capsys)["label_failures"] == 10  # two of three swap in half of ten frames
    assert run(asked) == ExitCode.DONE
    assert "--assigned-target start is used" in _notes(capsys)
    assert figures([*asked, "--match", "optimal"], capsys) == figures(asked, capsys)
    assert figures([*asked, "--assigned-target", "id"], capsys)["label_failures"] == 25


def test_tables_are_shown_and_compared(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([*EVALUATE, "--failures", "f.parquet", "-q"]) == ExitCode.DONE
    assert run([*EVALUATE, "--failures", "g.parquet", "--distance-gate", "0.5", "-q"]) == ExitCode.DONE
    for name in ("f.parquet", "view_tracks.parquet"):
        assert run(["info", name]) == ExitCode.DONE
        assert run(["diff", name, name]) == ExitCode.DONE
    assert "tracker on target 1" in capsys.readouterr().out
    assert run(["diff", "f.parquet", "g.parquet"]) == ExitCode.DONE
    assert run(["diff", "f.parquet", "view_tracks.parquet"]) == ExitCode.USAGE
    for name in ("failures", "view_tracks"):
        assert run(["schema", name]) == ExitCode.DONE


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        ([*EVALUATE, "--distance-gate", "0"], 2, "--distance-gate"),
        ([*EVALUATE, "--distance-gate", "nan"], 2, "nan is not a finite number"),
        ([*EVALUATE, "--distance-gate", "inf"], 2, "inf is not a finite number"),
        ([*EVALUATE, "--gospa-px", "nan"], 2, "nan is not a finite number"),
        ([*EVALUATE, "--gospa-p", "inf"], 2, "inf is not in the range"),
        ([*EVALUATE, "--iou-threshold", "nan"], 2, "nan is not a finite number"),
        ([*EVALUATE, "--bearings", "truth.parquet"], 2, "--bearings is for TRACKS on the ground"),
        ([*EVALUATE, "--match-distance", "1"], 2, "--match-distance is for TRACKS on the ground"),
        ([*EVALUATE, "--gospa-cutoff", "3"], 2, "1 - IoU, at most 1"),
        ([*EVALUATE, "--camera", "west"], 4, "no rows of camera west; choose with --camera: east, north"),
        (
            [*EVALUATE, "--frames", "90:99"],
            4,
            "recording.mcap: no row in frames 90:99 of --frames; its frames are 0 to 9",
        ),
        ([*EVALUATE, "--mot", "truth.parquet"], 4, "name a folder"),
        ([*EVALUATE, "--failures", "truth.parquet"], 7, "truth.parquet: exists"),
        (EVALUATE[:2], 2, "need --truth"),
        (["evaluate", "view_tracks.parquet", "--truth", "view_tracks.parquet"], 4, "expected truth_boxes"),
        (["evaluate", "broken.txt", "--truth", "recording.mcap", "--camera", "east"], 4, "broken.txt: line 2"),
        (["evaluate", "short.txt", "--truth", "recording.mcap", "--camera", "east"], 4, "3 columns"),
        (["evaluate", "header.txt", "--truth", "recording.mcap", "--camera", "east"], 4, "begins with a header"),
        (["evaluate", "kitti.txt", "--truth", "recording.mcap", "--camera", "east"], 4, "is KITTI text"),
        ([*EVALUATE, "--fps", "25"], 2, "--fps is for a truth that counts frames"),
        ([*EVALUATE, "--first-number", "1"], 2, "--first-number is for true boxes in XML"),
        ([*XML, "--fps", "7"], 2, "--fps 7: contradicts the times of the tracks (25 frames a second)"),
        ([*XML, "--first-number", "4"], 4, "boxes.xml: frame 3 is before the first number, 4"),
        ([*XML, "--frames", "90:99"], 4, "boxes.xml: has no true box in frames 90:99"),
        (XML[:-2], 2, "has cameras east, north; state with --camera"),
        (["evaluate", "twice.txt", "--truth", "far.xml"], 4, "twice.txt: none of their frame numbers (2 to 2)"),
        ([*XML[:3], "far.xml", *XML[4:]], 4, "far.xml: frame number 90000000 is beyond the limit of 2000000"),
        ([*XML[:3], "cut.xml", *XML[4:]], 4, "cut.xml: line 1: not XML"),
        (["evaluate", "twice.txt", "--truth", "recording.mcap", "--camera", "east"], 4, "frame 2: target 1 twice"),
        (["evaluate", "twice.txt", "--truth", "recording.mcap"], 2, "--camera"),
        (["evaluate", "late.txt", "--truth", "recording.mcap", "--camera", "east"], 4, "frame numbers (99 to 99)"),
        (["evaluate", "far.txt", "--truth", "recording.mcap", "--camera", "east"], 4, "far.txt: frame number 90000000"),
        (["evaluate", "other.parquet", "--truth", "recording.mcap"], 4, "other.parquet: their cameras (west)"),
        (["evaluate", "away.parquet", "--truth", "recording.mcap"], 4, "away.parquet: none of their times"),
        (
            ["evaluate", "--failures", "f.parquet", "--truth", "recording.mcap"],
            2,
            "or TRACKS on the ground with --truth",
        ),
    ],
)
def test_bad_input(
    folder: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], code: int, words: str
) -> None:
    frame = '<frame number="{}"><object id="1"><box xc="9" yc="9" w="4" h="4"/></object></frame>'
    (folder / "boxes.xml").write_text(f"<dataset>{frame.format(3)}</dataset>")
    (folder / "far.xml").write_text(f"<dataset>{frame.format(90000000)}</dataset>")
    (folder / "cut.xml").write_text(f"<dataset>{frame.format(3)}")
    (folder / "broken.txt").write_text("1,1,10,10,20,20,1\n2,1,ten,10,20,20,1\n")
    (folder / "short.txt").write_text("1,1,10\n")
    (folder / "kitti.txt").write_text("0 1 Pedestrian 0 0 -10 10 10 20 20 -1 -1 -1 -1000 -1000 -1000 -10\n")
    (folder / "header.txt").write_text("frame,id,left,top,width,height,conf\n1,1,10,10,20,20,1\n")
    (folder / "twice.txt").write_text("3,1,10,10,20,20,1\n3,1,50,10,20,20,1\n")
    (folder / "far.txt").write_text("90000000,1,10,10,20,20,1\n")
    (folder / "late.txt").write_text("100,1,10,10,20,20,1\n")
    tracks = view_tracks()
    whole = {c.name: getattr(tracks, c.name) for c in ViewTracks.columns()}
    east = tracks.take(tracks.sensor == "east")
    west = replace(east, sensor=np.full(len(east), "west"))
    write_table(folder / "other.parquet", west, MADE)
    write_table(folder / "away.parquet", ViewTracks.of(**{**whole, "t_ns": tracks.t_ns + 5}), MADE)
    before = sorted(folder.rglob("*"))
    got, line = error(arguments, capsys)
    assert (got, words in line) == (code, True), line
    assert sorted(folder.rglob("*")) == before


def world(targets: int, shift: float, unit: str = "m") -> tuple[Truth, Tracks]:
    made = base(("",), targets)
    t_ns, target, n = made["t_ns"], made["target_id"], len(made["frame"])
    x, y, nan = 4.0 * target, 0.1 * made["frame"], np.full(n, np.nan)
    truth = Truth.of(t_ns=t_ns, target_id=target, role=np.full(n, "target"), x=x, y=y, z=nan)
    swapped = np.where((made["frame"] >= 5) & (target < 2), 1 - target, target) if targets > 1 else target
    return truth, Tracks.of(
        t_ns=t_ns,
        target_id=swapped.astype(np.int32),
        x=x + shift,
        y=y,
        vx=nan,
        vy=nan,
        cov_xx=np.ones(n),
        cov_xy=np.zeros(n),
        cov_yy=np.ones(n),
    )


@pytest.mark.parametrize("targets", [1, 3])
def test_tracks_on_the_ground(folder: Path, capsys: pytest.CaptureFixture[str], targets: int) -> None:
    truth, tracks = world(targets, 0.5)
    write_table(folder / "positions.parquet", truth, MADE)
    write_table(folder / "tracks.parquet", tracks, MADE)
    (folder / "scene.yaml").write_text(SCENE)
    ground = ["evaluate", "tracks.parquet", "--truth", "positions.parquet", "--scene", "scene.yaml"]
    got = figures(ground, capsys)
    assert ("mota" in got) == (targets > 1)  # a single target has no need of them
    got = figures([*ground, "--failures", "f.parquet", "--match-distance", "0.5"], capsys)
    assert got["motp_m"] == pytest.approx(0.5)
    wanted = {"fr_p": 0.0, "label_failures": 10.0 * (targets > 1), "objects": 10.0 * targets, "fp": 0.0}
    assert {name: got[name] for name in wanted} == wanted
    assert len(read_table(folder / "f.parquet", Failures)) == wanted["label_failures"]
    assert figures([*ground, "--match-distance", "0.4"], capsys)["fr_p"] == 1.0
    code, line = error([*ground, "--distance-gate", "2"], capsys)
    assert (code, "--distance-gate is for tracks in images" in line) == (2, True)


def test_units_without_a_length_need_a_distance(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth, tracks = world(3, 0.5)
    write_table(folder / "positions.parquet", truth, MADE, length_unit="unit")
    write_table(folder / "tracks.parquet", tracks, MADE, length_unit="unit")
    (folder / "scene.yaml").write_text(SCENE.replace("occlog_scene: 1", "occlog_scene: 1\nlength_unit: unit"))
    ground = ["evaluate", "tracks.parquet", "--truth", "positions.parquet", "--scene", "scene.yaml"]
    assert run(ground) == ExitCode.DONE
    captured = capsys.readouterr()
    assert "give --match-distance" in captured.err
    assert "MOTA" not in captured.out
    assert figures([*ground, "--match-distance", "1"], capsys)["motp_unit"] == pytest.approx(0.5)


@pytest.mark.parametrize("name", ["TUD-Campus", "TUD-Stadtmitte"])
@pytest.mark.parametrize("rule", ["classic", "challenge"])
def test_published_figures_come_out(
    shared_data: Path, name: str, rule: str, capsys: pytest.CaptureFixture[str]
) -> None:
    at = shared_data / "tud_mot" / name
    got = figures(["evaluate", f"{at}/test.txt", "--truth", f"{at}/gt.txt", "--clear-rule", rule], capsys)
    counts = {"GT": "targets", "MT": "mostly_tracked", "PT": "partly_tracked", "ML": "mostly_lost", "FP": "fp"}
    counts |= {"FN": "fn", "IDs": "id_switches", "FM": "fragmentations"}
    shares = {"IDF1": "idf1", "IDP": "idp", "IDR": "idr", "Rcll": "recall", "Prcn": "precision", "MOTA": "mota"}
    shares |= {"DETA": "deta", "ASSA": "assa", "HOTA": "hota"}
    texts = {printed: f"{got[ours]:.0f}" for printed, ours in counts.items()}
    texts |= {printed: f"{got[ours]:.1%}" for printed, ours in shares.items()} | {"MOTP": f"{got['motp']:.3f}"}
    assert texts == PUBLISHED[name]


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--match-distance", "1e300"),
        ("--match-distance", "1e-300"),
        ("--gospa-cutoff", "1e200"),
        ("--gospa-switch-penalty", "1e200"),
        ("--ospa-cutoff", "1e300"),
        ("--moda-distance", "1e-10"),
        ("--gospa-p", "1000"),
        ("--ospa-p", "11"),
        ("--max-gap", "1e300"),
        ("--track-gap", "1e300"),
        ("--settling-time", "1e300"),
    ],
)
def test_values_of_which_powers_and_times_cannot_be_reported_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, value: str
) -> None:
    assert run([*two_walkers(tmp_path), option, value]) == ExitCode.USAGE
    assert option in capsys.readouterr().err


@pytest.mark.parametrize(
    "given",
    [
        "--gate-sigma 3",
        "--gate-px 3",
        "--occluder-diameter 1",
        "--motion cv",
        "--process-noise 1",
        "--process-noise-density 2",
        "--sigma-initial-velocity 2",
        "--prior 1 0 1",
        "--prior-z 1",
        "--bound-dimension space",
        "--triangulation-min-sensors 3",
        "--triangulation-window 1",
        "--triangulation-loss gauss",
        "--triangulation-tolerance 1",
        "--triangulation-min-angle-deg 1",
        "--held-out-gate-mrad 3",
        "--held-out-gate-px 3",
        "--iou-threshold 0.3",
    ],
)
def test_options_of_inputs_that_are_not_given_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], given: str
) -> None:
    assert run([*two_walkers(tmp_path), *given.split()]) == ExitCode.USAGE
    assert f"{given.split()[0]} applies to" in capsys.readouterr().err


def two_walkers(folder: Path) -> list[str]:
    """The command for tracks that are 0.1 m next to their targets."""
    for name, off in (("tracks.csv", 0.1), ("truth.csv", 0.0)):
        lines = [f"{t * NS},{k},{3 * k + off},{t}" for t in range(4) for k in range(2)]
        (folder / name).write_text("\n".join(["t_ns,target_id,x_m,y_m", *lines, ""]))
    return ["evaluate", str(folder / "tracks.csv"), "--truth", str(folder / "truth.csv")]
