"""`occlog start` on folders as people have them: what it takes each file for, and the result against the truth."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import folders as make
import numpy as np
import pytest
import yaml
from people_boxes import SIZE, hall
from places import ROOT

from occlog.cli.main import run
from occlog.errors import ExitCode, UsageError
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.recognition import contents_of
from occlog.io.recording.reader import open_recording
from occlog.pipeline.start.run import read_settings
from occlog.records.tables import Doa, Tracks, Truth, ViewTracks

CAMERAS = ("a", "b", "c")
FPS = ("--set", f"ingest.fps={make.RATE}")
PAGE = {"report.html", "tracks.parquet", "run.yaml", "run.json"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with blanks in its name."""
    path = tmp_path / "my recordings" / "hall 1"
    path.mkdir(parents=True)
    return path


Start = Callable[..., tuple[int, str]]


@pytest.fixture
def start(folder: Path, capsys: pytest.CaptureFixture[str]) -> Start:
    """Start on the folder; the exit code and what was stated."""

    def call(*options: str, source: Path | None = None, out: str = "out") -> tuple[int, str]:
        capsys.readouterr()
        code = run(["start", str(source or folder), "-o", str(folder.parent / out), *options])
        return code, capsys.readouterr().err

    return call


def metrics(folder: Path, out: str = "out") -> dict[str, float]:
    values: dict[str, float] = json.loads((folder.parent / out / "metrics.json").read_text())
    return values


def all_found(folder: Path, out: str = "out") -> None:
    """Every person has one identity throughout, and errors are those of the boxes (1.5 px at some 7 m)."""
    found = metrics(folder, out)
    assert (found["mota"], found["idf1"], found["id_switches"]) == (1.0, 1.0, 0)
    assert found["matched_rmse_m"] < 0.06


# The commented number is that of the list in docs/how-to/start.md.


@pytest.mark.jit
def test_yolo_text_with_opencv_and_a_truth_that_counts_from_another_frame(folder: Path, start: Start) -> None:  # 1
    for camera in CAMERAS:
        make.yolo(folder / "yolo" / camera / "labels", camera, classes=True)
    make.opencv(folder / "calib", hall("abc"))
    make.truth_csv(folder / "truth.csv", framed=True)
    make.litter(folder)
    code, output = start()
    assert code == ExitCode.BAD_INPUT
    assert output.splitlines()[-1].endswith("no file states their rate or times; give it: --set ingest.fps=RATE")
    assert not (folder.parent / "out").exists()
    code, output = start(*FPS)
    assert code == ExitCode.DONE
    assert "boxes of class 0, person in COCO, of 0 (407), 56 (150)  [--set ingest.class=...]" in output
    assert "boxes count frames from 1, the truth from 0  [--set ingest.first_number=...]" in output
    assert "not used: README.txt, costs.csv, notes.md and 1 more: no format that is known" in output
    assert "not used: thumbnails: pictures that by their name are no camera's" in output
    assert ".git" not in output
    all_found(folder)
    assert {file.name for file in (folder.parent / "out").iterdir()} >= PAGE
    # The configuration has the choices as comments, and runs as it is, from any folder
    text = (folder.parent / "out" / "run.yaml").read_text()
    assert "# boxes of class 0, person in COCO" in text
    assert "../hall 1/calib/a.yaml" in text
    # The same command goes on with what is there; another choice needs a word
    assert start(*FPS, source=folder / ".." / folder.name)[0] == ExitCode.DONE
    assert start(*FPS, "--set", "report.title=Hall")[0] == ExitCode.EXISTS
    assert start(*FPS, "--set", "report.title=Hall", "--overwrite")[0] == ExitCode.DONE


@pytest.mark.jit
def test_a_motchallenge_sequence_is_tracked_in_the_image(folder: Path, start: Start) -> None:  # 2
    make.mot(folder, "a", "HALL-01")
    code, output = start()
    assert code == ExitCode.DONE, output
    assert "frame rate: 10 fps, of seqinfo.ini  [--set ingest.fps=...]" in output
    assert "ground truth: HALL-01/gt/gt.txt (boxes, mot) of camera HALL-01" in output
    assert "method sort: people in the image of each camera, since no pose is known" in output
    found = metrics(folder)
    assert found["mota"] > 0.9
    assert found["idf1"] > 0.9


@pytest.mark.statistics
def test_a_video_alone_gives_its_people(folder: Path, start: Start) -> None:  # 7
    """A woman goes away in the first seconds, and a man comes in the last ones."""
    shutil.copy(ROOT / "sample_data" / "people" / "one-by-one.mp4", folder / "one by one.mp4")
    short = ("--set", "ingest.frames=20:110", "--set", "overlay.frames=20:24")
    code, output = start(*short, source=folder / "one by one.mp4")
    assert code == ExitCode.DONE, output
    assert "camera one_by_one" in output
    rows = read_table(folder.parent / "out" / "view_tracks.parquet", ViewTracks)
    spans = [rows.frame[rows.target_id == k] for k in np.unique(rows.target_id).tolist()]
    assert [(int(s.min()) <= 22, int(s.max()) >= 108) for s in spans] == [(True, False), (False, True)]
    assert all(len(s) >= 10 for s in spans)
    assert (folder.parent / "out" / "overlay.webm").stat().st_size > 10_000
    assert "replay-image-0" in (folder.parent / "out" / "report.html").read_text(encoding="utf-8")


@pytest.mark.jit
def test_a_bag_of_boxes_without_images(folder: Path, start: Start) -> None:  # 3
    pytest.importorskip("rosbags")
    make.bag(folder / "walk.mcap", hall("abc"))
    lines = ["t_ns,id,x,y"]
    for frame in range(round(make.SECONDS * make.RATE)):
        for person in range(make.PEOPLE):
            x, y = make.place(person, frame / make.RATE)
            lines.append(f"{make.START + frame * make.STEP_NS},{person},{x:.4f},{y:.4f}")
    (folder / "truth.csv").write_text("\n".join(lines) + "\n")
    code, output = start()
    assert code == ExitCode.DONE, output
    assert "camera cam_a: boxes /cam_a/yolo/detections, calibration /cam_a/camera_info" in output
    all_found(folder)


@pytest.mark.jit
def test_kalibr_and_videos_want_the_height_of_the_ground(folder: Path, start: Start, tmp_path: Path) -> None:  # 4
    source = make.rendered(tmp_path / "room.mcap", 4)
    names = {"view1": "cam0.mp4", "view2": "cam1.mp4", "view3": "cam2.mp4"}
    scene = make.videos(folder, source, names)
    make.kalibr(folder / "camchain.yaml", scene)
    cv2.imwrite(str(folder / "plan_2.png"), np.zeros((24, 32, 3), np.uint8))
    code, output = start()
    assert code == ExitCode.BAD_INPUT
    assert "the height of the ground is unknown" in output
    assert "--set ingest.ground_height=-2.5" in output
    height = f"ingest.ground_height={-scene.cameras[0].position[2]:g}"
    code, output = start("--set", height, "--write-only")
    assert code == ExitCode.DONE, output
    assert "the calibration's world is not upright: turned by the cameras' horizons  [--set ingest.up=...]" in output
    # COLMAP has no unit of lengths, images no rate: each is asked for in one line
    shutil.rmtree(folder)
    folder.mkdir()
    make.videos(folder, source, {name: f"{name}.mp4" for name in names})  # 6
    make.colmap(folder / "sparse" / "0", scene)
    code, output = start(out="colmap")
    assert (code, "--set ingest.calibration_unit=m" in output) == (ExitCode.BAD_INPUT, True)
    code, output = start("--set", "ingest.calibration_unit=m", "--write-only", out="colmap")
    assert code == ExitCode.DONE
    assert "times of view1.mp4: container time stamps" in output
    shutil.rmtree(folder)
    make.pictures(folder / "images", source)  # 8
    make.opencv(folder / "calib", scene)
    code, output = start(out="pictures")
    assert (code, "--set ingest.fps=RATE" in output) == (ExitCode.BAD_INPUT, True)
    code, output = start(*FPS, "--dry-run", out="pictures")
    assert code == ExitCode.DONE
    assert not (folder.parent / "pictures").exists()
    code, output = start(*FPS, "--write-only", out="pictures")
    assert code == ExitCode.DONE, output
    written = yaml.safe_load((folder.parent / "pictures" / "run.yaml").read_text())
    assert written["ingest"]["images"] == {name: f"../{folder.name}/images/{name}" for name in names}
    assert written["track"] == {"method": "jipda", "smooth": True}
    assert start(*FPS, "--set", "track.lag=2", "--write-only", out="online")[0] == ExitCode.DONE
    assert yaml.safe_load((folder.parent / "online" / "run.yaml").read_text())["track"] == {"lag": 2, "method": "jipda"}


@pytest.mark.jit
def test_coco_of_scaled_images(folder: Path, start: Start) -> None:  # 5
    for camera in CAMERAS:
        make.coco(folder / f"{camera}.json", camera, (SIZE[0] // 2, SIZE[1] // 2))
    make.opencv(folder / "calib", hall("abc"))
    make.kalibr(folder / "old.yaml", hall("abc"))
    make.truth_csv(folder / "gt.csv")
    code, output = start(*FPS)
    assert code == ExitCode.DONE, output
    assert "camera a: frames of 320 x 240 px, calibrated for 640 x 480: assumed to be scaled by 0.5" in output
    assert "calib/c.yaml, not old.yaml: it has 3 of 3 cameras, the other 0  [--as old.yaml=calibration]" in output
    all_found(folder)
    # Homographies of the ground in the place of the calibrations: the size of the images is that of COCO
    shutil.rmtree(folder / "calib")
    (folder / "old.yaml").unlink()
    for camera in CAMERAS:
        make.coco(folder / f"{camera}.json", camera)
    make.homographies(folder / "homographies", hall("abc"))
    code, output = start(*FPS, out="homographies")
    assert code == ExitCode.DONE, output
    assert "calibration: of images of 640 x 480 px, as the boxes are  [--set ingest.image_size=...]" in output
    assert "of a homography (image to ground), with square pixels, the principal point in the middle" in output
    all_found(folder, "homographies")


@pytest.mark.jit
def test_annotations_of_wildtrack_are_boxes_and_truth(folder: Path, start: Start) -> None:  # 9
    make.wildtrack(folder / "annotations", hall("abc"))
    make.pairs(folder / "calibrations", hall("abc"))
    code, output = start("--set", "ingest.fps=10")
    assert code == ExitCode.DONE, output
    assert "annotated boxes stand for those of a detector, without errors of one" in output
    all_found(folder)


@pytest.mark.jit
def test_cvat_with_a_camera_that_has_no_calibration(folder: Path, start: Start) -> None:  # 10
    for camera in CAMERAS:
        make.cvat(folder / f"{camera}.xml", camera)
    make.cvat(folder / "stairs.xml", "a")
    make.opencv(folder / "calib", hall("abc"))
    make.truth_csv(folder / "truth.csv")
    code, output = start(*FPS)
    assert code == ExitCode.DONE, output
    assert (
        "camera stairs: not used, it has no calibration (calibrated: a, b, c)  [--as 'stairs.xml=boxes:NAME']" in output
    )
    assert "boxes of class person, of person (407), chair (150)  [--set ingest.class=...]" in output
    all_found(folder)


@pytest.mark.jit
def test_bearings_and_ranges_with_stations(folder: Path, start: Start) -> None:  # 11, 14
    rng = np.random.default_rng(5)
    make.stations(folder / "stations.csv")
    make.walk_csv(folder / "truth.csv")

    def azimuth(x: float, y: float) -> str:
        return f"{np.degrees(np.arctan2(y, x)) + 1.5 * rng.standard_normal():.3f}"

    make.measured(folder / "bearings.csv", "time,station,azimuth_deg", azimuth)
    assert start()[0] == ExitCode.DONE
    assert metrics(folder)["rmse_m"] < 0.25
    (folder / "bearings.csv").unlink()
    make.stations(folder / "stations.csv", "anchor")
    make.measured(
        folder / "ranges.csv", "time,anchor,range_m", lambda x, y: f"{np.hypot(x, y) + 0.1 * rng.standard_normal():.3f}"
    )
    code, output = start(out="ranges")
    assert code == ExitCode.BAD_INPUT
    assert "--set track.sigma_range=NUMBER" in output
    assert start("--set", "track.sigma_range=0.1", out="ranges")[0] == ExitCode.DONE
    assert metrics(folder, "ranges")["rmse_m"] < 0.2


@pytest.mark.jit
def test_odas_and_signal_strengths(folder: Path, start: Start) -> None:  # 12, 14
    make.stations(folder / "arrays.csv", "array")
    make.walk_csv(folder / "truth.csv")
    make.odas(folder)
    code, output = start()
    assert (code, "--set ingest.odas_hop=0.008" in output) == (ExitCode.BAD_INPUT, True)
    assert start("--set", "ingest.odas_hop=0.008")[0] == ExitCode.DONE
    assert metrics(folder)["rmse_m"] < 0.25
    shutil.rmtree(folder)
    folder.mkdir()
    rng = np.random.default_rng(6)
    make.stations(folder / "anchors.csv", "anchor")
    make.walk_csv(folder / "truth.csv")

    def strength(x: float, y: float) -> str:
        return f"0,{-50 - 20 * np.log10(np.hypot(x, y)) + rng.standard_normal():.2f}"

    make.measured(folder / "rssi.csv", "time,anchor,tag,rssi", strength)
    code, output = start(out="rssi")
    assert code == ExitCode.DONE, output
    assert "method rssi: tags by signal strengths, since the ranges of readers are unknown" in output
    assert metrics(folder, "rssi")["rmse_m"] < 2.0


@pytest.mark.jit
def test_sound_gives_directions(folder: Path, start: Start) -> None:  # 13
    pytest.importorskip("pyroomacoustics")
    make.sound(folder)
    code, output = start()
    assert code == ExitCode.DONE, output
    assert "the result is directions (doa.parquet), no tracks" in output
    found = read_table(folder.parent / "out" / "doa.parquet", Doa)
    assert np.degrees(np.median(found.azimuth)) == pytest.approx(60.0, abs=2.0)


@pytest.mark.jit
def test_a_recording_with_a_truth(folder: Path, start: Start) -> None:  # 15
    make.recording(folder / "walk.mcap")
    make.truth_parquet(folder / "truth.parquet")
    code, output = start()
    assert code == ExitCode.DONE, output
    assert "recording walk.mcap: boxes" in output
    assert "ground truth: truth.parquet (true positions, table of occlog)  [--set evaluate.truth=...]" in output
    all_found(folder)


@pytest.mark.jit
def test_results_of_an_earlier_run_are_no_truth(folder: Path, start: Start) -> None:
    make.recording(folder / "walk.mcap")
    make.truth_parquet(folder / "truth.parquet")
    write_table(folder / "tracks.parquet", Tracks.empty(), Provenance("track", {}))
    for name, begin in (("metrics", {"_provenance": {}}), ("earlier", {"program": "occlog"})):
        (folder / f"{name}.json").write_text(json.dumps({**begin, "packages": {"opencv-python-headless": "4.10"}}))
    assert not any(contents_of(folder / name) for name in ("tracks.parquet", "metrics.json", "earlier.json"))
    code, output = start()
    assert code == ExitCode.DONE, output
    assert "ground truth: truth.parquet" in output


def test_what_cannot_be_used_is_one_line(folder: Path, start: Start) -> None:
    code, output = start()
    assert (code, output.count("\n")) == (ExitCode.BAD_INPUT, 1)
    assert "nothing to track: empty" in output
    make.litter(folder)
    code, output = start()
    assert code == ExitCode.BAD_INPUT
    assert "nothing to track: 6 files or folders of no known format; give videos" in output
    assert start(source=folder / "nothing")[0] == ExitCode.BAD_INPUT
    assert start("--set", "fps=25")[0] == ExitCode.USAGE
    assert start("--as", "README.txt=movie")[0] == ExitCode.USAGE
    assert start("--as", "other.txt=boxes")[0] == ExitCode.USAGE


def test_cameras_of_other_names_are_not_guessed(folder: Path, start: Start) -> None:
    for camera in CAMERAS:
        make.coco(folder / f"{camera}.json", camera)
    make.opencv(folder / "calib", hall("abc"), names={"a": "left", "b": "right", "c": "middle"})
    code, output = start(*FPS)
    assert code == ExitCode.BAD_INPUT
    assert "cameras a, b, c are none of the calibration's (left, middle, right); name each" in output
    named = [f"{camera}.json=boxes:{name}" for camera, name in zip(CAMERAS, ("left", "right", "middle"), strict=True)]
    code, output = start(*FPS, *(word for each in named for word in ("--as", each)), "--write-only")
    assert code == ExitCode.DONE, output
    assert "boxes: b.json (COCO), 134 of right" in output
    code, output = start(*FPS, "--as", "a.json=boxes:left", "--as", "b.json=unused", "--write-only", "--overwrite")
    assert code == ExitCode.DONE, output
    assert "camera c: not used, it has no calibration" in output
    assert "not used: b.json: as stated" in output


def test_of_several_recordings_one_is_asked_for_and_nothing_is_left_behind(folder: Path, start: Start) -> None:
    make.opencv(folder / "calib", hall("abc"))
    for recording in ("walk1", "walk2"):
        (folder / recording).mkdir()
        for camera in CAMERAS:
            make.coco(folder / recording / f"{camera}.json", camera)
    code, output = start(*FPS)
    assert code == ExitCode.BAD_INPUT
    assert "1/walk1'; " in output
    code, output = start("--set", "ingest.truth=[nothing.csv]", *FPS, "--as", "walk2=unused")
    assert code == ExitCode.BAD_INPUT, output
    assert not (folder.parent / "out").exists()
    assert start(*FPS, "--as", "walk2=unused", "--write-only")[0] == ExitCode.DONE


def test_ingest_notes_frames_that_count_from_another_number(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make.yolo(tmp_path / "yolo" / "a", "a")
    make.opencv(tmp_path / "calib", hall("a"))
    make.truth_csv(tmp_path / "truth.csv", framed=True)
    given = ["--boxes", str(tmp_path / "yolo"), "--calibration", str(tmp_path / "calib" / "a.yaml"), "--fps", "10"]
    given += ["--truth", str(tmp_path / "truth.csv"), "--overwrite", "-o", str(tmp_path / "walk.mcap")]
    text = "boxes begin at frame 1, true positions (truth.csv) at frame 0; where both mean the first frame, state it: "
    assert run(["ingest", *given]) == ExitCode.DONE
    assert f"{text}--first-number 1, --truth-first-number 0" in capsys.readouterr().err
    assert run(["ingest", *given, "--first-number", "1", "--truth-first-number", "0"]) == ExitCode.DONE
    assert "boxes begin at" not in capsys.readouterr().err
    assert int(open_recording(tmp_path / "walk.mcap").read(Truth).t_ns.min()) == 0


def test_a_sequence_of_another_size_than_the_calibration_is_refused(folder: Path, start: Start) -> None:
    make.mot(folder, "a", "a")
    make.opencv(folder / "calib", hall("a"), scale=2.0)
    code, output = start()
    assert code == ExitCode.BAD_INPUT
    assert "images of 640 x 480 px, but camera a is calibrated for 1280 x 960" in output


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ("ingest.fp=10", "--set ingest.fp: unknown key; did you mean 'fps'?"),
        ("ingst.fps=10", "did you mean 'ingest'?"),
        ("sed=3", "did you mean 'seed'?"),
        ("track.metod=jipda", "--set track.metod: unknown key; did you mean 'method'?"),
        ("overlay.vido=a.webm", "--set overlay.vido: unknown key; did you mean 'video'?"),
    ],
)
def test_a_misspelt_key_is_reported_before_anything_is_inspected(setting: str, expected: str) -> None:
    with pytest.raises(UsageError, match=re.escape(expected)):
        read_settings([setting])


def test_keys_of_a_plug_in_are_left_to_it() -> None:
    given = read_settings(["track.method=own", "track.strength=3", "ingest.reader=lab", "ingest.depth=2"])
    assert given == {"track": {"method": "own", "strength": 3}, "ingest": {"reader": "lab", "depth": 2}}


def test_a_configuration_that_is_no_text_is_another_one(folder: Path, start: Start) -> None:
    make.stations(folder / "stations.csv")
    make.measured(folder / "bearings.csv", "time,station,azimuth_deg", lambda x, y: "1.5")
    (folder.parent / "out").mkdir()
    (folder.parent / "out/run.yaml").write_bytes(b"occlog_run: 1 # \xff\n")
    assert start("--write-only")[0] == ExitCode.EXISTS
    assert start("--write-only", "--overwrite")[0] == ExitCode.DONE
