"""`occlog epipolar` on files: poses, matches, recordings, checks, one-line errors; recorded matches in pixels."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from epipolar_rigs import looking, matches, room_points
from view_scenes import view_tracks, walks

from occlog.cli.main import run
from occlog.core.geometry.fundamental import epipolar_distances
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.calibration.reader import read_calibration
from occlog.io.formats.models.fundamental_matrices import read_epipolar
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.io.recording.reader import open_recording
from occlog.io.recording.writer import RecordingWriter
from occlog.measure.epipolar.from_scene import ideal_pixels
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import TruthBoxes

HEADER = "sensor_a,sensor_b,xa_px,ya_px,xb_px,yb_px"
BROWN = np.array([-0.2, 0.05, 0.001, -0.001, 0.0])
PLACES = {"a": (7.0, 0, 2.5), "b": (0, 7.0, 2.5), "c": (-5.0, -5, 3)}
MADE = Provenance("simulate", {"steps": 3}, 7, losses=(Loss("a", "frame 7", "cut", 1),))


def scene(**more):
    return Scene(cameras=tuple(looking(n, np.array(p), (0, 0, 1), 500.0, **more) for n, p in PLACES.items()))


def rows(scene, n=60, noise=0.4, points=None, seed=0):
    """Lines of matches of a and b, then of c and a."""
    rng = np.random.default_rng(seed)
    points = room_points(rng, n) if points is None else points
    lines = []
    for a, b in (("a", "b"), ("c", "a")):
        pair = matches(rng, [scene.camera(a), scene.camera(b)], points, noise)
        lines += [f"{a},{b},{','.join(f'{v:.6f}' for v in line)}" for line in np.hstack(pair).tolist()]
    return lines


@pytest.fixture
def folder(tmp_path):
    for name, made in (("scene", scene()), ("lens", scene(distortion=BROWN))):
        (tmp_path / f"{name}.yaml").write_text(scene_to_yaml(made))
        (tmp_path / f"{name}.csv").write_text("\n".join([HEADER, *rows(made)]) + "\n")
    return tmp_path


def epipolar(folder, *args):
    return run(["epipolar", *(str(folder / a) if "." in a and not a.startswith("-") else a for a in args)])


def right(folder, name, lens, limit):
    """Root mean square distance [px] of points from their lines is below a limit, in all pairs."""
    made = scene(distortion=BROWN) if lens else scene()
    pairs = read_epipolar(folder / name)
    rng = np.random.default_rng(9)
    for pair in pairs.pairs:
        both = [made.camera(pair.a), made.camera(pair.b)]
        a, b = matches(rng, both, room_points(rng, 200), 0.0)
        if pair.undistorted:
            a, b = ideal_pixels(both[0], a), ideal_pixels(both[1], b)
        assert np.sqrt((epipolar_distances(pair.matrix, a, b) ** 2).mean()) < limit
    return pairs


@pytest.mark.parametrize("lens", [False, True])
def test_matrices_from_poses_and_from_matches(folder, capsys, lens):
    name = "lens" if lens else "scene"
    assert epipolar(folder, "--scene", f"{name}.yaml", "-o", "poses.json", "--json") == ExitCode.DONE
    result = json.loads(capsys.readouterr().out)
    assert result["pairs"]["a-b"] == {"source": "calibration", "undistorted": lens}
    assert len(right(folder, "poses.json", lens, 1e-6).pairs) == 3

    args = ["--matches", f"{name}.csv", "-o", "matches.json", "--json", "-q"]
    assert epipolar(folder, *args, "--scene", f"{name}.yaml") == ExitCode.DONE
    result = json.loads(capsys.readouterr().out)["pairs"]
    assert list(result) == ["a-b", "c-a"]
    assert result["a-b"]["matches"] == 60
    assert result["a-b"]["inliers"] >= 55
    assert 0.2 < result["a-b"]["noise_px"] < 0.6
    assert result["a-b"]["undistorted"] is lens
    right(folder, "matches.json", lens, 2.0)

    for known in ("poses.json", "matches.json"):
        args = ["--check", "--matches", f"{name}.csv", "--fundamental", known, "--scene", f"{name}.yaml", "--json"]
        assert epipolar(folder, *args) == ExitCode.DONE
        result = json.loads(capsys.readouterr().out)
        assert result["agree"] is True
        assert result["pairs"]["c-a"]["median_px"] < 0.6 < result["pairs"]["c-a"]["most_px"] + 0.3
        assert result["pairs"]["a-b"]["share"] > 0.98 > 0.2 > result["pairs"]["a-b"]["chance"]


def test_a_person_is_reported_a_line_for_each_pair(folder, capsys):
    assert epipolar(folder, "--matches", "scene.csv", "-o", "m.json") == ExitCode.DONE
    out = capsys.readouterr().out
    assert "a-b: source matches" in out
    assert "c-a: source matches" in out


def test_wrong_matrices_are_noticed(folder, capsys):
    assert epipolar(folder, "--scene", "scene.yaml", "-o", "poses.json") == ExitCode.DONE
    values = json.loads((folder / "poses.json").read_text())
    for pair in values["pairs"]:
        move = np.array([[1.0, 0, 0], [0, 1, 0], [0, -40, 1]])  # lines 40 px lower
        pair["matrix"] = (move @ np.array(pair["matrix"])).tolist()
    (folder / "moved.json").write_text(json.dumps(values))
    capsys.readouterr()
    args = ["--check", "--matches", "scene.csv", "--fundamental", "moved.json", "--json"]
    assert epipolar(folder, *args) == ExitCode.THRESHOLD
    result = json.loads(capsys.readouterr().out)
    assert result["agree"] is False
    assert result["pairs"]["a-b"]["median_px"] > 10
    args = ["--check", "--matches", "scene.csv", "--scene", "scene.yaml", "--cameras", "a,c", "--json"]
    assert epipolar(folder, *args) == ExitCode.DONE
    assert list(json.loads(capsys.readouterr().out)["pairs"]) == ["c-a"]


def test_either_order_of_a_pair_is_one(folder):
    lines = (folder / "scene.csv").read_text().splitlines()
    turned = [",".join([b, a, *v[2:], *v[:2]]) for a, b, *v in (line.split(",") for line in lines[1:31])]
    (folder / "mixed.csv").write_text("\n".join([HEADER, *lines[31:61], *turned, ""]))
    (folder / "plain.csv").write_text("\n".join([HEADER, *lines[31:61], *lines[1:31], ""]))
    for name in ("mixed", "plain"):
        assert epipolar(folder, "--matches", f"{name}.csv", "-o", f"{name}.json") == ExitCode.DONE
    assert np.array_equal(*(read_epipolar(folder / f"{n}.json").pairs[0].matrix for n in ("mixed", "plain")))


def recording(folder, **more):
    """Three frames of two cameras, linked to a video, with true boxes of 30 targets each."""
    world = scene(**more)
    points = room_points(np.random.default_rng(3), 30)
    (folder / "videos").mkdir()
    with RecordingWriter(folder / "walk.mcap", world, MADE) as writer:
        writer.attach("notes.txt", "text/plain", b"hello")
        writer.video("a", "videos/a.mp4", "0" * 64)
        for t in range(3):
            writer.video_frame("a", t * 1000, t + 5)
            writer.image("b", t * 1000, t, b"no image", "png")
        for k, camera in enumerate(world.cameras):
            p = camera.project(points)
            n, rest = len(p), np.full(len(p), np.nan)
            visible = np.where(np.arange(n) % 10 == 9, 0.1, 1.0)
            writer.table(
                TruthBoxes.of(
                    t_ns=np.zeros(n, dtype=np.int64),
                    sensor=np.full(n, camera.name),
                    frame=np.zeros(n, dtype=np.int64),
                    box=np.arange(n, dtype=np.int32),
                    target_id=np.arange(n, dtype=np.int32),
                    left_px=p[:, 0] - 6,
                    top_px=p[:, 1] - 9 - 50 * k * (visible < 1),
                    width_px=np.full(n, 12.0),
                    height_px=np.full(n, 18.0),
                    confidence=rest,
                    visible=visible,
                )
            )
    return folder / "walk.mcap"


def test_a_copy_of_a_recording_holds_them(folder, capsys):
    source = recording(folder)
    (folder / "sub").mkdir()
    code = epipolar(folder, "walk.mcap", "--matches", "scene.csv", "-o", "sub/copy.mcap", "--json", "-q")
    assert code == ExitCode.DONE  # what had been lost before is stated
    assert json.loads(capsys.readouterr().out)["lost_earlier"][0]["source"] == "a"
    old, new = open_recording(source), open_recording(folder / "sub/copy.mcap")
    assert read_epipolar(new.path).find("a", "b").inliers > 50
    assert new.attachment("notes.txt") == b"hello"
    assert new.videos["a"] == {"path": "../videos/a.mp4", "sha256": "0" * 64}
    assert (new.topics, new.time_ns, new.ours, new.losses) == (old.topics, old.time_ns, True, old.losses)
    assert [(f.t_ns, f.index) for f in new.frames(["b"])] == [(f.t_ns, f.index) for f in old.frames(["b"])]
    assert new.provenance.command == "epipolar"
    assert np.array_equal(new.read(TruthBoxes).left_px, old.read(TruthBoxes).left_px)

    # They can be checked, replaced, and stated.
    assert epipolar(folder, "sub/copy.mcap", "--check", "--matches", "scene.csv") == ExitCode.DONE
    assert epipolar(folder, "sub/copy.mcap", "-o", "again.mcap", "-q") == ExitCode.DONE
    assert {p.source for p in read_epipolar(folder / "again.mcap").pairs} == {"calibration"}
    capsys.readouterr()
    assert run(["info", str(folder / "sub/copy.mcap")]) == ExitCode.DONE
    assert "epipolar  a, b: from matches, lines to" in capsys.readouterr().out


def test_targets_are_matches(folder, capsys):
    recording(folder)
    assert epipolar(folder, "--from-tracks", "walk.mcap", "-o", "boxes.json", "--json") == ExitCode.DONE
    result = json.loads(capsys.readouterr().out)["pairs"]
    assert {name: pair["matches"] for name, pair in result.items()} == {
        "a-b": 27,
        "a-c": 27,
        "b-c": 27,
    }  # those visible
    right(folder, "boxes.json", False, 1e-6)
    table = view_tracks(scene().cameras, walks(200), np.random.default_rng(0), sigma=0.5)
    write_table(folder / "tracks.parquet", table, Provenance("track"))
    args = ["--check", "--from-tracks", "tracks.parquet", "--fundamental", "boxes.json", "--json"]
    assert epipolar(folder, *args) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["pairs"]["a-b"]["matches"] == 400
    late = view_tracks(scene().cameras, walks(200), np.random.default_rng(0), sigma=0.5, delay_ns=5_000_000)
    made = Provenance("track", {"window_ns": 10_000_000})  # cameras that do not keep step
    write_table(folder / "tracks.parquet", late, made, overwrite=True)
    assert epipolar(folder, *args) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["pairs"]["a-b"]["matches"] == 400


FLOOR = room_points(np.random.default_rng(5), 60) * [1, 1, 0]


@pytest.mark.parametrize(
    ("args", "code", "says"),
    [
        (["-o", "x.json"], ExitCode.USAGE, "the geometry of the views is unknown"),
        (["--scene", "scene.yaml"], ExitCode.USAGE, "name the output with -o"),
        (["--scene", "scene.yaml", "--check"], ExitCode.USAGE, "--check requires matches"),
        (["--check", "--matches", "scene.csv"], ExitCode.USAGE, "--check requires something to check"),
        (
            ["--check", "--matches", "scene.csv", "--scene", "scene.yaml", "-o", "x.json"],
            ExitCode.USAGE,
            "writes nothing",
        ),
        (["--matches", "scene.csv", "--from-tracks", "scene.csv", "-o", "x.json"], ExitCode.USAGE, "give one"),
        (["--matches", "scene.csv", "--fundamental", "scene.csv", "-o", "x.json"], ExitCode.USAGE, "leave one out"),
        (["--scene", "scene.yaml", "-o", "x.mcap"], ExitCode.USAGE, "give RECORDING"),
        (["--scene", "scene.yaml", "-o", "x.json", "--cameras", "a,z"], ExitCode.USAGE, "no matrix is of two of these"),
        (
            ["--matches", "scene.csv", "-o", "x.json", "--inlier-threshold", "inf"],
            ExitCode.USAGE,
            "'--inlier-threshold': inf is not",
        ),
        (["--matches", "none.csv", "-o", "x.json"], ExitCode.BAD_INPUT, "none.csv"),
        (["--matches", "scene.yaml", "-o", "x.json"], ExitCode.BAD_INPUT, "scene.yaml: line"),
        (
            ["--matches", "few.csv", "-o", "x.json"],
            ExitCode.BAD_INPUT,
            "few.csv: lines 2 to 13: a and b: 12 matches; a fundamental matrix needs at least 20",
        ),
        (
            ["--matches", "floor.csv", "-o", "x.json"],
            ExitCode.BAD_INPUT,
            "floor.csv: lines 2 to 61: a and b: the matches fit one plane",
        ),
        (["--matches", "word.csv", "-o", "x.json"], ExitCode.BAD_INPUT, "word.csv: line 3: xa_px is 'left'"),
        (["--matches", "same.csv", "-o", "x.json"], ExitCode.BAD_INPUT, "same.csv: line 2: sensor_a 'a'"),
        (["--matches", "short.csv", "-o", "x.json"], ExitCode.BAD_INPUT, "short.csv: has no column yb_px"),
        (
            ["--matches", "other.csv", "--scene", "scene.yaml", "-o", "x.json"],
            ExitCode.BAD_INPUT,
            "no camera named 'z'",
        ),
        (
            ["--matches", "scene.csv", "--cameras", "b,c", "-o", "x.json"],
            ExitCode.BAD_INPUT,
            "pairs in the file: a-b, c-a",
        ),
        (
            ["--check", "--matches", "scene.csv", "--fundamental", "bad.json"],
            ExitCode.BAD_INPUT,
            "bad.json: is not epipolar geometry",
        ),
        (
            ["--check", "--matches", "lens.csv", "--fundamental", "poses.json", "--scene", "lens.yaml"],
            ExitCode.BAD_INPUT,
            "is for pixels as recorded",
        ),
        (
            ["--check", "--matches", "other.csv", "--fundamental", "poses.json"],
            ExitCode.BAD_INPUT,
            "no fundamental matrix of these views",
        ),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(folder, capsys, args, code, says):
    good = (folder / "scene.csv").read_text().splitlines()
    files = {
        "few.csv": good[:13],
        "floor.csv": [HEADER, *rows(scene(), points=FLOOR)[:60]],
        "word.csv": [*good[:2], "a,b,left,1,2,3"],
        "same.csv": [HEADER, "a,a,1,2,3,4"],
        "short.csv": [line.rpartition(",")[0] for line in good],
        "other.csv": [HEADER, *(line.replace("b,", "z,", 1) for line in good[1:61])],
        "bad.json": ["{}"],
    }
    for name, lines in files.items():
        (folder / name).write_text("\n".join([*lines, ""]))
    assert epipolar(folder, "--scene", "scene.yaml", "-o", "poses.json") == ExitCode.DONE
    capsys.readouterr()
    assert epipolar(folder, *args) == code
    error = capsys.readouterr().err.strip()
    assert says in error
    assert "\n" not in error
    assert not list(folder.glob("x.*"))


def test_a_recording_that_knows_nothing_of_a_camera_is_not_copied(folder, capsys):
    recording(folder)
    text = (folder / "scene.csv").read_text().replace("b,", "z,")
    (folder / "other.csv").write_text(text.replace("sensor_z,", "sensor_b,"))
    assert epipolar(folder, "--matches", "other.csv", "-o", "other.json", "--cameras", "a,z") == ExitCode.DONE
    capsys.readouterr()
    assert epipolar(folder, "walk.mcap", "--fundamental", "other.json", "-o", "x.mcap") == ExitCode.BAD_INPUT
    assert "has no camera 'z'" in capsys.readouterr().err
    assert not (folder / "x.mcap").exists()
    args = ["walk.mcap", "--scene", "scene.yaml", "-o", "walk.mcap", "--overwrite"]
    assert epipolar(folder, *args) == ExitCode.USAGE


def board_matches(folder):
    """Images of the corners of a board in each pair of recorded cameras, by hand of the recording's own detector."""
    places = {}
    with (folder / "calibration/extrinsic/CHARUCO/xy_CHARUCO.csv").open() as file:
        for row in csv.DictReader(file):
            key = (row["sync_index"], row["object_id"], row["keypoint_id"])
            places.setdefault(int(row["cam_id"]), {})[key] = (row["img_loc_x"], row["img_loc_y"])
    for a in sorted(places):
        for b in range(a + 1, 4):
            for key in sorted(places[a].keys() & places[b].keys()):
                yield ",".join([f"cam_{a}", f"cam_{b}", *places[a][key], *places[b][key]])


def test_recorded_corners_agree_with_the_calibration_and_tell_it(tmp_path, shared_data, capsys):
    """Four real cameras with lens distortion: half of all corners are within 2 px of the lines of the calibration.

    The webcams are not synchronous (2 ms in the middle, 20 ms at most) and the board is waved:
    that, not the corner detector, makes the distances.
    """
    session = shared_data / "caliscope_4cam/session_a"
    lines = list(board_matches(session))
    (tmp_path / "corners.csv").write_text("\n".join([HEADER, *lines, ""]))
    found = read_calibration([session / "camera_array.toml"]).cameras
    (tmp_path / "scene.yaml").write_text(scene_to_yaml(Scene(cameras=found)))
    args = ["--check", "--matches", "corners.csv", "--scene", "scene.yaml", "--json"]
    assert epipolar(tmp_path, *args) == ExitCode.DONE
    calibrated = [pair["median_px"] for pair in json.loads(capsys.readouterr().out)["pairs"].values()]
    assert len(calibrated) == 6
    assert max(calibrated) < 2.0
    assert np.median(calibrated) < 1.1

    assert epipolar(tmp_path, "--matches", "corners.csv", "--scene", "scene.yaml", "-o", "m.json", "--json") == 0
    result = json.loads(capsys.readouterr().out)["pairs"]
    assert all(pair["error_px"] < 1.0 and pair["inliers"] > 0.9 * pair["matches"] for pair in result.values())
    assert all(pair["parallax_px"] > 15 for pair in result.values())
    # The estimated lines are nearer to the corners than those of the calibration, which also has to suit all cameras.
    args = ["--check", "--matches", "corners.csv", "--scene", "scene.yaml", "--fundamental", "m.json", "--json"]
    assert epipolar(tmp_path, *args) == ExitCode.DONE
    estimated = [pair["median_px"] for pair in json.loads(capsys.readouterr().out)["pairs"].values()]
    assert np.mean(estimated) < np.mean(calibrated)


def test_what_was_lost_of_the_matches_is_lost_for_matrices_that_are_read_again(folder):
    assert epipolar(folder, "--scene", "scene.yaml", "-o", "f.json") == ExitCode.DONE
    values = json.loads((folder / "f.json").read_text())
    values["_provenance"]["losses"] = [loss.as_dict() for loss in MADE.losses]
    (folder / "f.json").write_text(json.dumps(values))
    assert epipolar(folder, "--fundamental", "f.json", "-o", "g.json") == ExitCode.DONE
    assert json.loads((folder / "g.json").read_text())["_provenance"]["losses"] == values["_provenance"]["losses"]
