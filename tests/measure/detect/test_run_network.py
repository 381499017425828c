"""`occlog detect --onnx`: from images to views, bearings and embeddings, and what is stated of bad input."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from detect_scenes import BLUE, RED, STEP_NS, camera, picture, scene
from numpy.testing import assert_allclose, assert_array_equal
from places import EXAMPLES
from small_networks import constant_network, mean_network, people_network

from occlog.cli.main import run
from occlog.core.geometry.camera import wrap_angle
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance, hash_file
from occlog.io.files.tables.parquet import read_provenance, read_table
from occlog.io.recording.writer import RecordingWriter
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Tracks, Views
from occlog.track.people.frame_detections import rows_of_views

STEPS = 12
ROOM = scene(camera("a", 0.0, 0.0, 45.0), camera("b", 8.0, 0.0, 135.0))
NAMES = {"names": "{0: 'person', 1: 'dog', 2: 'cat'}", "task": "detect"}


def where(k: int) -> list[tuple[float, float, tuple[int, int, int]]]:
    """Somebody in red and somebody in blue, who is not there in the steps 4 to 6."""
    red = (2.5 + 0.1 * k, 4.0, RED)
    return [red] if 4 <= k < 7 else [red, (5.5, 5.0 - 0.1 * k, BLUE)]


def record(path: Path, room: Scene = ROOM, change: Callable[[str, int, bytes], bytes] | None = None) -> Path:
    with RecordingWriter(path, room, Provenance("test"), overwrite=True) as out:
        for k in range(STEPS):
            for n, cam in enumerate(ROOM.cameras):
                data = cv2.imencode(".png", picture(cam, where(k), 100 * n + k))[1].tobytes()
                out.image(cam.name, k * STEP_NS, k, change(cam.name, k, data) if change else data, "png")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("networks")
    record(made / "room.mcap")
    people_network(made / "people.onnx", metadata=NAMES)
    mean_network(made / "reid.onnx")
    return made


def detect(folder: Path, output: Path, *args: str, source: str = "room.mcap", model: str = "people.onnx") -> int:
    command = ["detect", str(folder / source), "--onnx", str(folder / model), "-o", str(output / "v.parquet")]
    return run([*command, "-q", "--overwrite", *args])


def embed(folder: Path) -> list[str]:
    return ["--embed", str(folder / "reid.onnx"), "--embed-pixel-scaling", "unit"]


def test_people_are_found_where_they_are(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert detect(folder, tmp_path, "--json", "--bearings", str(tmp_path / "b.parquet")) == ExitCode.DONE
    views, rows = read_table(tmp_path / "v.parquet", Views), read_table(tmp_path / "b.parquet", Bearings)
    summary = json.loads(capsys.readouterr().out)
    assert summary["frames"] == 2 * STEPS
    assert summary["boxes"] == len(views) == len(rows) == 2 * (2 * STEPS - 3)
    assert (summary["head"], summary["classes"]) == ("end2end", ["person"])
    assert views.embedding.shape == (len(views), 0)
    for i in range(len(rows)):
        cam = ROOM.camera(str(rows.sensor[i]))
        off = [
            wrap_angle(rows.bearing[i] - np.arctan2(y - cam.position[1], x - cam.position[0])) / rows.sigma[i]
            for x, y, _ in where(int(rows.t_ns[i] // STEP_NS))
        ]
        assert np.abs(off).min() < 1.0
    made = read_provenance(tmp_path / "b.parquet")
    assert dict(made.inputs) == {n: hash_file(folder / n) for n in ("room.mcap", "people.onnx")}
    wanted = {"head": "end2end", "size": "160x120", "fit": "letterbox", "classes": {"0": "person"}}
    assert {name: made.parameters[name] for name in wanted} == wanted
    assert str(made.parameters["runtime"]) == f"opencv {cv2.__version__}"


def test_images_of_a_camera_that_the_scene_does_not_have_name_the_recording(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert detect(folder, tmp_path, "--scene", str(EXAMPLES / "room.yaml")) == ExitCode.BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert str(folder / "room.mcap") in line
    assert "--scene" in line
    assert list(tmp_path.iterdir()) == []


def test_boxes_are_those_around_the_pixels_of_people(folder: Path, tmp_path: Path) -> None:
    assert detect(folder, tmp_path) == ExitCode.DONE
    views = read_table(tmp_path / "v.parquet", Views)
    for i in range(0, len(views), 5):
        cam = ROOM.camera(str(views.sensor[i]))
        n = [c.name for c in ROOM.cameras].index(cam.name)
        k = int(views.frame[i])
        image = picture(cam, where(k), 100 * n + k).astype(float) / 255
        boxes = []
        for c in (2, 0):
            rows, columns = np.nonzero(2 * image[:, :, c] - image.sum(axis=2) > 0.35)
            if len(rows):
                boxes.append((columns.min() - 0.5, rows.min() - 0.5, np.ptp(columns) + 1.0, np.ptp(rows) + 1.0))
        found = (views.left_px[i], views.top_px[i], views.width_px[i], views.height_px[i])
        assert np.abs(np.array(boxes) - found).max(axis=1).min() < 1e-4


def test_the_bytes_depend_neither_on_the_batch_nor_on_the_workers(folder: Path, tmp_path: Path) -> None:
    for name, more in (("one", ("--workers", "1")), ("other", ("--workers", "2", "--batch", "5"))):
        (tmp_path / name).mkdir()
        given = [*embed(folder), *more, "--bearings", str(tmp_path / name / "b.parquet")]
        assert detect(folder, tmp_path / name, *given) == ExitCode.DONE
    for name in ("v.parquet", "b.parquet"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "other" / name).read_bytes()


def test_frames_that_cannot_be_used_are_lost_and_the_rest_is_as_it_was(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def damaged(name: str, k: int, data: bytes) -> bytes:
        small = cv2.imencode(".png", np.zeros((20, 20, 3), np.uint8))[1].tobytes()
        return data[:200] if (name, k) in (("a", 2), ("a", 3)) else small if (name, k) == ("b", 7) else data

    record(tmp_path / "bad.mcap", change=damaged)
    assert detect(folder, tmp_path) == ExitCode.DONE
    whole = read_table(tmp_path / "v.parquet", Views)
    command = ["detect", str(tmp_path / "bad.mcap"), "--onnx", str(folder / "people.onnx"), "-q"]
    assert run([*command, "-o", str(tmp_path / "w.parquet")]) == ExitCode.LOSSY
    stderr = capsys.readouterr().err
    assert "frames 2 to 3" in stderr
    assert "image is 20 x 20 px in colour, the camera's first was 160 x 120 px in colour" in stderr
    rest = read_table(tmp_path / "w.parquet", Views)
    gone = ((whole.sensor == "a") & np.isin(whole.frame, [2, 3])) | ((whole.sensor == "b") & (whole.frame == 7))
    assert_array_equal(rest.left_px, whole.left_px[~gone])
    assert sum(loss.count for loss in read_provenance(tmp_path / "w.parquet").losses) == 3


def test_cameras_without_a_pose_give_views_alone(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    nowhere = replace(ROOM, cameras=tuple(replace(c, placed=False) for c in ROOM.cameras))
    record(tmp_path / "n.mcap", nowhere)
    command = ["detect", str(tmp_path / "n.mcap"), "--onnx", str(folder / "people.onnx"), "-q"]
    assert run([*command, "-o", str(tmp_path / "v.parquet"), *embed(folder)]) == ExitCode.DONE
    views = read_table(tmp_path / "v.parquet", Views)
    assert len(views) == 2 * (2 * STEPS - 3)
    assert np.isnan(views.bearing).all()
    more = ["--bearings", str(tmp_path / "b.parquet")]
    assert run([*command, "-o", str(tmp_path / "w.parquet"), *more]) == ExitCode.USAGE
    assert "no camera has a pose" in capsys.readouterr().err


def test_frames_with_no_one_have_a_bearing_that_is_not_seen(folder: Path, tmp_path: Path) -> None:
    more = ["--class", "dog", "--bearings", str(tmp_path / "b.parquet")]
    assert detect(folder, tmp_path, *more) == ExitCode.DONE
    rows = read_table(tmp_path / "b.parquet", Bearings)
    assert len(rows) == 2 * STEPS
    assert not rows.seen.any()
    assert not len(read_table(tmp_path / "v.parquet", Views))


def test_embeddings_tell_people_apart_and_jipda_takes_them(folder: Path, tmp_path: Path) -> None:
    assert detect(folder, tmp_path, *embed(folder)) == ExitCode.DONE
    views = read_table(tmp_path / "v.parquet", Views)
    assert views.embedding.shape == (len(views), 12)
    assert_allclose(np.linalg.norm(views.embedding, axis=1), 1.0, rtol=1e-6)
    similar = views.embedding @ views.embedding.T
    red = views.embedding[:, 0] > 0  # the boxes' middle is red
    assert similar[np.ix_(red, red)].min() > 0.7
    assert similar[np.ix_(red, ~red)].max() < 0.2
    (rows,) = rows_of_views([views])
    assert_array_equal(rows.appearance, views.embedding.astype(np.float64))
    (rows,) = rows_of_views([replace(views, embedding=np.zeros((len(views), 0), np.float32))])
    assert_allclose(rows.appearance.sum(axis=1), 1.0, rtol=1e-5)  # colours


@pytest.mark.jit
def test_views_of_a_network_become_tracks_of_everybody(folder: Path, tmp_path: Path) -> None:
    assert detect(folder, tmp_path, *embed(folder)) == ExitCode.DONE
    source = ["track", str(tmp_path / "v.parquet"), "--scene", str(folder / "room.mcap"), "-q"]
    assert run([*source, "--method", "jipda", "-o", str(tmp_path / "t.parquet")]) == ExitCode.DONE
    tracks = read_table(tmp_path / "t.parquet", Tracks)
    for k in (2, 10):
        now = tracks.take(tracks.t_ns == k * STEP_NS)
        true = np.array([(x, y) for x, y, _ in where(k)])
        off = np.hypot(now.x[:, None] - true[:, 0], now.y[:, None] - true[:, 1])
        assert off.shape == (2, 2)
        assert off.min(axis=0).max() < 0.3


@pytest.mark.parametrize(
    ("args", "fault"),
    [
        (
            ["--views", "x.parquet"],
            "--views is an option of --method auto, network, background, outlines, components, not of --onnx MODEL; "
            "leave it out",
        ),
        (["--fuse"], "--fuse is an option of --method auto, network, background, outlines, components, not of --onnx"),
        (
            ["--method", "auto"],
            "--method is an option of --method auto, network, background, outlines, comp",
        ),
        (
            ["--fuse-sigma-prediction", "0.1"],
            "--fuse-sigma-prediction is an option of --method auto, network, background, outlines, components, not of",
        ),
        (
            ["--no-learn-background"],
            "--no-learn-background is an option of --method auto, background, outlines, components, not of",
        ),
        (["--class", "persn"], "did you mean 'person'"),
        (["--cameras", "c"], "no images of camera 'c'"),
        (["--embed-size", "64"], "go with --embed; add it"),
        (["--size", "640"], "images of 160 x 120 px only, not 640 x 640"),
        (["--min-confidence", "1.5"], "--min-confidence"),
    ],
)
def test_what_does_not_fit_is_a_usage_error(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], args: list[str], fault: str
) -> None:
    assert detect(folder, tmp_path, *args) == ExitCode.USAGE
    stderr = capsys.readouterr().err
    assert fault in stderr
    assert not (tmp_path / "v.parquet").exists()


def test_options_of_networks_want_a_network(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for args in (["--class", "person"], ["--head", "yolo"], ["--bearings", "x.parquet"]):
        command = ["detect", str(folder / "room.mcap"), "-o", str(tmp_path / "b.parquet"), *args]
        assert run(command) == ExitCode.USAGE
        assert f"{args[0]} is an option of --onnx MODEL, not of --method auto" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("data", "fault"),
    [(None, "no such file; a network"), (b"", "is empty"), (b"\x89PNG" * 99, "not an ONNX model, or damaged")],
)
def test_a_file_that_is_no_network_is_bad_input_in_one_line(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], data: bytes | None, fault: str
) -> None:
    if data is not None:
        (tmp_path / "x.onnx").write_bytes(data)
    assert detect(folder, tmp_path, model=str(tmp_path / "x.onnx")) == ExitCode.BAD_INPUT
    stderr = capsys.readouterr().err
    assert fault in stderr
    assert stderr.count("\n") == 1


def test_a_network_that_gives_no_numbers_loses_the_frames(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = constant_network(tmp_path / "nan.onnx", {"output0": np.full((1, 9, 6), np.nan)}, metadata=NAMES)
    assert detect(folder, tmp_path, model=str(bad)) == ExitCode.LOSSY
    assert "frames 0 to 11: the network gives numbers that are not finite" in capsys.readouterr().err


def test_classes_that_are_assumed_are_reported(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    people_network(tmp_path / "p.onnx")
    command = ["detect", str(folder / "room.mcap"), "--onnx", str(tmp_path / "p.onnx")]
    assert run([*command, "-o", str(tmp_path / "v.parquet")]) == ExitCode.DONE
    assert "those of COCO are assumed: 0 is person (--names states otherwise)" in capsys.readouterr().err
    (tmp_path / "names.txt").write_text("dog\nperson\ncat\n")
    names = ["--names", str(tmp_path / "names.txt"), "-o", str(tmp_path / "w.parquet")]
    assert run([*command, *names, "-q"]) == ExitCode.DONE
    assert not len(read_table(tmp_path / "w.parquet", Views))
