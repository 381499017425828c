"""`occlog track --method jipda`: from boxes to tables, and what is stated of bad input."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from people_boxes import CORNERS, PEOPLE, STEP_NS, box, boxes, camera, hall, table, truth, written

import occlog
from occlog.cli.main import run
from occlog.core.geometry.camera import rotation_from_angles
from occlog.errors import ExitCode, UsageError
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_provenance, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.recording.writer import RecordingWriter
from occlog.records.declared.views import ViewTracks
from occlog.records.losses import OUTSIDE_IMAGE, Loss
from occlog.records.messages import VERDICT
from occlog.records.scene import Camera, MicrophoneArray, Scene
from occlog.records.tables import Associations, Boxes, Doa, Events, PeopleTracks, PeopleViews, Tracks, TruthBoxes
from occlog.track.catalogue import smooths

pytestmark = pytest.mark.jit
SECONDS = 3.0
SCENE = hall("abcd")


def track(folder: Path, found: Boxes, scene: Scene, *args: str) -> int:
    boxes_path, scene_path = written(folder, found, scene)
    return follow(folder, boxes_path, "--scene", scene_path, *args)


def follow(folder: Path, source: str, *args: str) -> int:
    out = [
        part
        for name in ("associations", "events", "view-tracks")
        for part in (f"--{name}", str(folder / f"{name}.parquet"))
    ]
    tracks = ["-o", str(folder / "t.parquet"), "--overwrite", "--json"]
    return run(["track", source, "--method", "jipda", *tracks, *out, *args])


def tracks(folder: Path) -> PeopleTracks:
    return read_table(folder / "t.parquet", PeopleTracks)


def reported(capsys: pytest.CaptureFixture[str]) -> tuple[dict, str]:
    """The summary, and what was stated next to it."""
    found = capsys.readouterr()
    return json.loads(found.out), found.err


@pytest.fixture(scope="module")
def walk() -> Boxes:
    return boxes(SCENE, SECONDS)


@pytest.fixture(scope="module")
def tracked(walk: Boxes, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the boxes of the walk, their scene, and the tables of their tracks."""
    folder = tmp_path_factory.mktemp("tracked")
    assert track(folder, walk, SCENE, "-q") == ExitCode.DONE
    return folder


def test_everybody_is_followed_and_the_tables_agree(walk, tmp_path, capsys):
    assert track(tmp_path, walk, SCENE) == ExitCode.DONE
    summary, noted = reported(capsys)
    assert noted == ""
    assert (summary["people"], summary["initiated"], summary["plausible"]) == (PEOPLE, PEOPLE, True)
    rows = tracks(tmp_path)
    assert summary["rows"] == len(rows)
    # Everybody is where somebody is, within 0.2 m
    true = truth(SECONDS)
    for t_ns in np.unique(rows.t_ns).tolist():
        now, then = rows.take(rows.t_ns == t_ns), true.take(true.t_ns == t_ns)
        apart = np.hypot(now.x[:, None] - then.x, now.y[:, None] - then.y)
        assert (apart.min(axis=1) < 0.2).all()
    support = read_table(tmp_path / "associations.parquet", Associations)
    keys = set(zip(rows.t_ns.tolist(), rows.target_id.tolist(), strict=True))
    assert set(zip(support.t_ns.tolist(), support.target_id.tolist(), strict=True)) <= keys
    whose = {
        key: person
        for *place, person in zip(
            walk.t_ns.tolist(), walk.sensor.tolist(), walk.box.tolist(), walk.target_id.tolist(), strict=True
        )
        for key in [tuple(place)]
    }
    sure = support.take(support.probability > 0.9)
    pairs = {
        (target, whose[t_ns, sensor, number])
        for target, t_ns, sensor, number in zip(
            sure.target_id.tolist(), sure.t_ns.tolist(), sure.sensor.tolist(), sure.box.tolist(), strict=True
        )
    }
    assert len(pairs) == PEOPLE
    events = read_table(tmp_path / "events.parquet", Events)
    assert events.kind.tolist().count("initiated") == PEOPLE
    views = read_table(tmp_path / "view-tracks.parquet", PeopleViews)
    assert set(views.target_id.tolist()) == set(rows.target_id.tolist())
    assert ((views.visibility >= 0) & (views.visibility <= 1)).all()
    made = read_provenance(tmp_path / "t.parquet")
    assert made.parameters["cameras"] == ["a", "b", "c", "d"]
    assert made.parameters["window_ns"] == STEP_NS // 2 - 1


def test_frames_that_were_lost_are_no_looks_at_no_one(walk, tmp_path, capsys):
    kept = walk.take(~np.isin(walk.frame, range(10, 18)))
    with RecordingWriter(tmp_path / "r.mcap", SCENE, Provenance("test")) as out:
        out.table(kept)
    views, scene = tmp_path / "v.parquet", ["--scene", str(tmp_path / "r.mcap")]
    args = ["-o", str(tmp_path / "b.parquet"), "--views", str(views), "-q"]
    assert run(["detect", str(tmp_path / "r.mcap"), *args]) == ExitCode.DONE
    fused = [str(tmp_path / "b.parquet"), "--views", str(views), "--fused-views", str(tmp_path / "f.parquet"), *scene]
    assert run(["fuse", *fused, "-o", str(tmp_path / "fb.parquet"), "-q"]) == ExitCode.DONE
    for name in ("v.parquet", "f.parquet"):
        stated = read_provenance(tmp_path / name).parameters["frames_left_out"]
        assert stated == {key: [[10, 17]] for key in "abcd"}
    capsys.readouterr()
    assert follow(tmp_path, str(views), *scene) == ExitCode.DONE
    summary, _ = reported(capsys)
    assert (summary["initiated"], summary["terminated"]) == (PEOPLE, 0)
    assert summary["frames"] == dict.fromkeys("abcd", 22)


def test_the_same_boxes_give_the_same_bytes(walk, tracked, tmp_path):
    assert track(tmp_path, walk, SCENE, "-q") == ExitCode.DONE
    one, two = ({path.name: path.read_bytes() for path in made.glob("*.parquet")} for made in (tracked, tmp_path))
    assert one == two


def test_a_recording_with_boxes_and_views_made_of_it_give_the_same_tracks(walk, tmp_path, capsys):
    # A camera detects no one for some frames in the middle: views have no rows there
    gone = np.isin(walk.frame, range(12, 15)) & (walk.sensor == "b")
    first = gone & np.append(True, (np.diff(walk.t_ns) != 0) | (walk.sensor[1:] != walk.sensor[:-1]))
    empty = replace(
        walk,
        box=np.where(gone, np.int32(-1), walk.box),
        confidence=np.full(len(walk), np.nan),
        **{n: np.where(gone, np.nan, getattr(walk, n)) for n in ("left_px", "top_px", "width_px", "height_px")},
    ).take(~gone | first)
    with RecordingWriter(tmp_path / "r.mcap", SCENE, Provenance("test"), overwrite=True) as out:
        out.table(empty)
    assert follow(tmp_path, str(tmp_path / "r.mcap"), "-q") == ExitCode.DONE
    rows = tracks(tmp_path)
    views = ["--views", str(tmp_path / "v.parquet")]
    assert run(["detect", str(tmp_path / "r.mcap"), "-o", str(tmp_path / "b.parquet"), *views, "-q"]) == ExitCode.DONE
    scene = ["--scene", str(tmp_path / "r.mcap")]
    assert follow(tmp_path, str(tmp_path / "v.parquet"), *scene, "-q") == ExitCode.DONE
    other = tracks(tmp_path)
    assert "frames_left_out" not in read_provenance(tmp_path / "v.parquet").parameters
    np.testing.assert_array_equal(other.t_ns, rows.t_ns)
    # Boxes stand in another order there
    np.testing.assert_allclose(other.x, rows.x, atol=0.02)
    # They have no scores, as regions of video, of which it is stated that covariances are too small with the future
    capsys.readouterr()
    output = ["-o", str(tmp_path / "smoothed.parquet"), "--smooth", "--strict"]
    assert run(["track", str(tmp_path / "v.parquet"), *scene, "--method", "jipda", *output]) == ExitCode.DONE
    assert VERDICT["correlated-region-errors"].text in capsys.readouterr().err


def test_cameras_of_different_frame_rates_are_moments_of_the_quickest(walk, tmp_path):
    slow = walk.take((walk.sensor != "b") | (walk.frame % 3 == 0))
    third = slow.take(slow.sensor == "c")
    late = Boxes.merge([slow.take(slow.sensor != "c"), replace(third, t_ns=third.t_ns + 30_000_000)])
    assert track(tmp_path, late, SCENE, "-q") == ExitCode.DONE
    assert len(np.unique(tracks(tmp_path).target_id)) == PEOPLE
    views = read_table(tmp_path / "view-tracks.parquet", ViewTracks)
    assert set((views.t_ns[views.sensor == "c"] % STEP_NS).tolist()) == {30_000_000}
    assert set(views.frame[views.sensor == "b"].tolist()) <= set(range(0, 30, 3))


def test_what_is_in_the_images_is_evaluated_and_exported(tracked, tmp_path, capsys):
    whole = boxes(SCENE, SECONDS, miss=0.0, px=0.0)
    values = {c.name: getattr(whole, c.name) for c in Boxes.columns()}
    true = TruthBoxes(**values, visible=np.where(whole.box >= 0, 1.0, np.nan))
    write_table(tmp_path / "true.parquet", true, Provenance("test"))
    capsys.readouterr()
    args = ["--truth", str(tmp_path / "true.parquet"), "--mot", str(tmp_path / "mot"), "--json"]
    assert run(["evaluate", str(tracked / "view-tracks.parquet"), *args]) == ExitCode.DONE
    figures, _ = reported(capsys)
    # People whose middle is outside the image have no true box
    assert figures["idf1"] > 0.85
    assert figures["recall"] > 0.95
    assert list((tmp_path / "mot").rglob("*.txt"))


def test_a_camera_that_is_turned_is_named(tmp_path, capsys):
    found = boxes(SCENE, 6.0, px=2.0)
    moved = replace(found, left_px=found.left_px - 25.0 * (found.sensor == "b"))
    assert track(tmp_path, moved, SCENE, "--smooth") == ExitCode.DONE
    summary, noted = reported(capsys)
    # A shift of the image is not quite a rotation: another camera may seem to be rotated a little
    found = {warning["id"]: warning for warning in summary["warnings"]}
    assert found.keys() in [{"camera-rotated"}, {"camera-rotated", "camera-fits-if"}]
    # From the cells of a search: to half a degree
    assert "camera-fits-if" not in found or re.search(r"b is rotated by -[23]\.\d", found["camera-fits-if"]["message"])
    rotated = [warning for warning in summary["warnings"] if warning["id"] == "camera-rotated"]
    assert max(rotated, key=lambda each: abs(each["figures"]["yaw_deg"]))["sensors"] == ["b"]
    assert re.search(r"camera b is rotated from its calibration by -2\.\d deg about the vertical", noted)


@pytest.mark.statistics
@pytest.mark.parametrize(("degrees", "seed"), [(-6.0, 10), (0.0, 11), (6.0, 11)])
def test_a_camera_that_is_turned_is_named_after_10_s_with_rough_boxes(tmp_path, capsys, degrees, seed):
    """Two people, edges with 4 px: standard errors of 0.1 deg, and the other cameras take a part of the rotation."""
    turned = rotation_from_angles(np.radians(CORNERS["b"][2] + degrees), np.radians(-20.0), 0.0)
    scene = hall("abc")
    stood = tuple(replace(c, rotation=turned) if c.name == "b" else c for c in scene.cameras)
    found = boxes(replace(scene, cameras=stood), 10.0, px=4.0, people=2, seed=seed)
    assert track(tmp_path, found, scene) == ExitCode.DONE
    summary, _ = reported(capsys)
    found = {warning["id"] for warning in summary["warnings"]}
    # A camera that is turned by 6 degrees may also make exchanges of the two people likely
    allowed = {"identity-switches-likely", "camera-fits-if"} if degrees else set()
    assert found - allowed == ({"camera-rotated"} if degrees else set())
    (rotated,) = [each for each in summary["warnings"] if each["id"] == "camera-rotated"] or [None]
    assert not degrees or rotated["figures"]["yaw_deg"] == pytest.approx(degrees, abs=0.6)


def test_a_camera_that_is_late_is_named(tmp_path, capsys):
    found = boxes(SCENE, 6.0, late={"b": 30.0})
    assert track(tmp_path, found, SCENE, "--strict") == ExitCode.THRESHOLD
    summary, noted = reported(capsys)
    assert "occlog: warning: camera b detects " in noted
    assert "check its clock, pose, boxes and video" in noted
    assert not summary["plausible"]
    assert [warning["id"] for warning in summary["warnings"]] == ["camera-inconsistent"]


@pytest.mark.parametrize(("late", "near"), [(1.2, 0.11), pytest.param(-0.8, 0.25, marks=pytest.mark.statistics)])
def test_by_how_much_a_camera_is_late_or_ahead_is_stated(late, near, tmp_path, capsys):
    """By a frame; of a smaller offset less is known, since the tracks follow that camera, too."""
    scene = hall("abcd")
    assert track(tmp_path, boxes(scene, 8.0, late={"b": late}), scene) == ExitCode.DONE
    summary, _ = reported(capsys)
    (found,) = (each for each in summary["warnings"] if each["id"] == "camera-clock-offset")
    assert found["sensors"] == ["b"]
    assert found["figures"]["late_s"] == pytest.approx(late, abs=near)


def test_a_late_clock_is_stated_before_its_consequences(tmp_path, capsys):
    scene = hall("abcd")
    assert track(tmp_path, boxes(scene, 12.0, late={"b": -4.0}), scene) == ExitCode.DONE
    summary, _ = reported(capsys)
    ids = [each["id"] for each in summary["warnings"] if each["sensors"] == ["b"]]
    assert ids == ["camera-clock-offset", "camera-unassociated"]


@pytest.mark.statistics
@pytest.mark.parametrize("late", [-0.3, 0.0, 0.2])
def test_a_camera_that_is_late_by_less_than_a_gate_is_corrected(late, tmp_path, capsys):
    """20 s of four people; standard errors are about 0.01 s, and what velocities lag is left over."""
    scene = hall("abcd")
    assert track(tmp_path, boxes(scene, 20.0, late={"b": late}), scene, "--smooth") == ExitCode.DONE
    summary, _ = reported(capsys)
    warnings = [each for each in summary["warnings"] if each["id"] == "camera-late"]
    assert [each["sensors"] for each in warnings] == ([["b"]] if late else [])
    assert summary.get("clock_offsets", {}) == ({"b": pytest.approx(late, abs=0.04)} if late else {})


def test_a_camera_that_reports_everything_twice_is_named_and_counts_once(walk, tracked, tmp_path, capsys):
    again = walk.take((walk.sensor == "b") & (walk.box >= 0))
    twice = Boxes.merge([walk, replace(again, box=again.box + np.int32(50))])
    assert track(tmp_path, twice, SCENE) == ExitCode.DONE
    summary, noted = reported(capsys)
    assert f"camera b: {len(again)} of {2 * len(again)} boxes duplicate another one of the frame" in noted
    assert summary["boxes"]["b"]["duplicates"] == len(again)
    np.testing.assert_array_equal(tracks(tmp_path).x, tracks(tracked).x)


def test_boxes_outside_the_image_are_left_out_and_stated(walk, tmp_path, capsys):
    shifted = replace(walk, left_px=np.where(walk.sensor == "c", walk.left_px + 2000.0, walk.left_px))
    assert track(tmp_path, shifted, SCENE) == ExitCode.DONE
    summary, noted = reported(capsys)
    assert "camera c: " in noted
    assert "outside the image" in noted
    assert summary["boxes"]["c"]["boxes"] == 0
    assert summary["people"] == PEOPLE


def test_boxes_that_the_recording_has_lost_to_a_wrong_image_size_speak_against_the_tracks(walk, tmp_path, capsys):
    kept = int(np.count_nonzero((walk.sensor == "c") & (walk.box >= 0)))
    for lost, found in ((kept // 4, []), (kept, ["boxes-skipped"])):
        losses = (
            Loss("c", "boxes", f"{OUTSIDE_IMAGE} of 640 x 480 px", lost),
            Loss("c.mp4", "frame 3", "damaged", 9999),
        )
        with RecordingWriter(tmp_path / "r.mcap", SCENE, Provenance("test", losses=losses), overwrite=True) as out:
            out.table(walk)
        assert follow(tmp_path, str(tmp_path / "r.mcap")) == ExitCode.DONE
        summary, noted = reported(capsys)
        assert [warning["id"] for warning in summary["warnings"]] == found
        assert summary["plausible"] is not bool(found)
        assert (f"camera c: ingest skipped {lost} of {lost + kept} boxes outside the image" in noted) is bool(found)


def test_a_scene_in_centimetres_gives_the_same_tracks_in_centimetres(tracked, tmp_path, capsys):
    metres = tracks(tracked)
    scene = hall("abcd", 100.0, "unit")
    assert track(tmp_path, boxes(scene, SECONDS, metre=100.0), scene) == ExitCode.DONE
    _, noted = reported(capsys)
    assert "lengths are in a scene-specific unit; by boxes people are 17" in noted
    found = tracks(tmp_path)
    assert np.median(np.abs(found.x / 100.0 - metres.x)) < 0.02
    assert np.median(found.height) == pytest.approx(100.0 * np.median(metres.height), rel=0.05)


def test_centimetres_that_are_stated_to_be_metres_are_refused(tmp_path, capsys):
    scene = hall("abcd", 100.0, "m")
    assert track(tmp_path, boxes(scene, SECONDS, metre=100.0), scene) == ExitCode.BAD_INPUT
    noted = capsys.readouterr().err
    assert "the boxes imply that people are 17" in noted
    assert "so the lengths of the scene are not in m" in noted
    assert noted.count("\n") == 1
    assert "setting height" not in noted


def test_a_stated_height_that_no_one_has_is_refused(tmp_path, capsys):
    scene = hall("abcd", 100.0, "m")
    found = boxes(scene, SECONDS, metre=100.0)
    assert track(tmp_path, found, scene, "--set", "person_height=170") == ExitCode.BAD_INPUT
    noted = capsys.readouterr().err
    assert "no person is 170 m tall (setting person_height), so the lengths of the scene are not in m" in noted
    assert "state the unit of the calibration" in noted
    assert noted.count("\n") == 1


@pytest.mark.parametrize("found", [boxes(SCENE, 1.0, people=0), Boxes.empty()], ids=["frames without boxes", "no rows"])
def test_no_one_at_all_is_a_result(found, tmp_path, capsys):
    assert track(tmp_path, found, SCENE) == ExitCode.DONE
    summary, noted = reported(capsys)
    assert noted.startswith("occlog: note: no target was found, and the tracks are empty; ")
    assert noted.count("\n") == 1
    assert (summary["people"], summary["rows"]) == (0, 0)
    assert len(tracks(tmp_path)) == 0
    assert len(read_table(tmp_path / "view-tracks.parquet", ViewTracks)) == 0


def test_a_world_upside_down_in_which_no_one_is_found_is_not_plausible(walk, tmp_path, capsys):
    over = tuple(replace(c, position=c.position * [1, 1, -1]) for c in SCENE.cameras)
    scene = replace(SCENE, cameras=over)
    assert track(tmp_path, walk, scene, "--strict") == ExitCode.THRESHOLD
    summary, _ = reported(capsys)
    assert (summary["people"], summary["plausible"]) == (0, False)
    found = {warning["id"]: warning.get("sensors") for warning in summary["warnings"]}
    assert found["boxes-unassociated"] is None
    assert found["camera-below-ground"] == ["a", "b", "c", "d"]


def test_cameras_without_a_pose_are_named_and_the_others_used(walk, tmp_path, capsys):
    cameras = [replace(SCENE.cameras[0], placed=False), *SCENE.cameras[1:]]
    assert track(tmp_path, walk, replace(SCENE, cameras=tuple(cameras))) == ExitCode.DONE
    summary, noted = reported(capsys)
    assert noted == "occlog: warning: without a pose in space, and not used: a; calibrate it\n"
    assert list(summary["frames"]) == ["b", "c", "d"]
    assert summary["people"] == PEOPLE
    none = tuple(replace(c, placed=False) for c in SCENE.cameras)
    assert track(tmp_path, walk, replace(SCENE, cameras=none)) == ExitCode.BAD_INPUT
    assert "of a, b, c, d none has a pose in space" in capsys.readouterr().err


@pytest.mark.parametrize("rounding", [0.0, -4e-10])
def test_a_calibrated_camera_on_the_floor_is_stated_from_one_without_a_pose(rounding, walk, tmp_path, capsys):
    def lowered(camera: Camera) -> Camera:
        return replace(camera, position=np.array([*camera.position[:2], rounding]))

    cameras = [lowered(SCENE.cameras[0]), replace(SCENE.cameras[1], placed=False), *SCENE.cameras[2:]]
    assert track(tmp_path, walk, replace(SCENE, cameras=tuple(cameras))) == ExitCode.DONE
    summary, noted = reported(capsys)
    assert "without a pose in space, and not used: b; calibrate it\n" in noted
    assert "on the floor (z = 0), from where no position on it can be seen, and not used: a; say how high" in noted
    assert list(summary["frames"]) == ["c", "d"]
    assert track(tmp_path, walk, replace(SCENE, cameras=tuple(map(lowered, SCENE.cameras)))) == ExitCode.BAD_INPUT
    noted = capsys.readouterr().err
    assert "a, b, c, d are on the floor (z = 0), so no position on the floor can be found" in noted
    assert "say how high the cameras are" in noted


def test_a_camera_whose_calibration_contradicts_is_named(walk, tmp_path, capsys):
    low = replace(SCENE.cameras[1], position=np.array([10.0, 0.0, 1.5]))
    cameras = (SCENE.cameras[0], low, *SCENE.cameras[2:])
    assert track(tmp_path, walk, replace(SCENE, cameras=cameras)) == ExitCode.DONE
    summary, _ = reported(capsys)
    assert {"calibration-inconsistent", "camera-inconsistent"} & {each["id"] for each in summary["warnings"]}


def test_a_recording_without_boxes_is_refused_with_the_remedy(tmp_path, capsys):
    with RecordingWriter(tmp_path / "r.mcap", SCENE, Provenance("test"), overwrite=True) as out:
        out.table(truth(SECONDS))
    assert follow(tmp_path, str(tmp_path / "r.mcap")) == ExitCode.BAD_INPUT
    assert "give a recording with boxes of a detector" in capsys.readouterr().err


def test_cameras_are_chosen(walk, tmp_path, capsys):
    assert track(tmp_path, walk, SCENE, "--cameras", "a,b,c", "--without", "b") == ExitCode.DONE
    summary, _ = reported(capsys)
    assert list(summary["frames"]) == ["a", "c"]
    assert track(tmp_path, walk, SCENE, "--cameras", "z") == ExitCode.USAGE
    assert "no camera 'z' in the scene" in capsys.readouterr().err


def test_other_commands_read_the_tracks_as_tracks(walk, tracked, tmp_path):
    assert len(read_table(tracked / "t.parquet", Tracks)) == len(tracks(tracked))
    scene = ["--scene", str(tracked / "hall.yaml")]
    priors = ["priors", "kalman", str(tracked / "t.parquet"), "--measured", "-o", str(tmp_path / "p.parquet")]
    assert run([*priors, "-q"]) == ExitCode.DONE
    with RecordingWriter(tmp_path / "r.mcap", SCENE, Provenance("test"), overwrite=True) as out:
        out.table(walk)
    assert run(["detect", str(tmp_path / "r.mcap"), "-o", str(tmp_path / "b.parquet"), "-q"]) == ExitCode.DONE
    label = ["label", str(tmp_path / "b.parquet"), "--tracks", str(tracked / "t.parquet"), *scene]
    assert run([*label, "-o", str(tmp_path / "l.parquet"), "-q"]) == ExitCode.DONE


def test_who_speaks_keeps_the_identity_where_no_camera_shows_them(tmp_path, capsys):
    # Cameras see 7 m far; somebody walks out of their sight and back, and two arrays hear them
    cameras = tuple(camera(name, range=7.0) for name in "ab")
    arrays = tuple(MicrophoneArray(n, np.array([x, 10.0, 1.5])) for n, x in (("left", 0.0), ("right", 10.0)))
    scene = replace(hall("ab"), cameras=cameras, arrays=arrays)
    rng, rows, names, heard = np.random.default_rng(1), [], [], []
    for k in range(130):
        x, y = 5.0, 2.0 + min(0.1 * k, 14.0 - 0.1 * k)
        for cam in cameras:
            edges = box(cam, x, y) + rng.standard_normal(4)
            near = np.hypot(x - cam.position[0], y - cam.position[1]) < 7.0
            size = (edges[0], edges[1], edges[2] - edges[0], edges[3] - edges[1], 0.9) if near else (np.nan,) * 5
            rows.append((k * STEP_NS, k, 0 if near else -1, -1, *size))
            names.append(cam.name)
        heard += [(a.name, k * STEP_NS, np.arctan2(y - 10.0, x - a.position[0]) + rng.normal(0, 0.05)) for a in arrays]
    sensor, t_ns, azimuth = zip(*heard, strict=True)
    unknown = np.full(len(heard), np.nan)
    doa = Doa.of(
        t_ns=t_ns, sensor=sensor, source_id=np.full(len(heard), -1, np.int32), azimuth=azimuth, elevation=unknown,
        sigma_azimuth=np.full(len(heard), 0.05), sigma_elevation=unknown, confidence=unknown,
    )  # fmt: skip
    write_table(tmp_path / "doa.parquet", doa, Provenance("test"))
    found = table(names, np.array(rows))
    assert track(tmp_path, found, scene) == ExitCode.DONE
    assert reported(capsys)[0]["people"] == 2
    assert track(tmp_path, found, scene, "--doa", str(tmp_path / "doa.parquet")) == ExitCode.DONE
    assert reported(capsys)[0]["people"] == 1
    assert [name for name, _ in read_provenance(tmp_path / "t.parquet").inputs][-1] == "doa.parquet"


def test_the_future_is_used_where_it_is_wanted(tmp_path, capsys):
    found, true = boxes(SCENE, SECONDS, px=6.0, miss=0.4), truth(SECONDS)

    def off() -> float:
        rows = tracks(tmp_path)
        apart = [
            np.hypot(now.x[:, None] - then.x, now.y[:, None] - then.y).min(axis=1)
            for t_ns in np.unique(rows.t_ns).tolist()
            for now, then in [(rows.take(rows.t_ns == t_ns), true.take(true.t_ns == t_ns))]
        ]
        return float(np.sqrt(np.mean(np.concatenate(apart) ** 2)))

    assert track(tmp_path, found, SCENE, "-q") == ExitCode.DONE
    plain = off()
    for how in (["--smooth"], ["--lag", "0.5"]):
        assert track(tmp_path, found, SCENE, *how, "-q") == ExitCode.DONE
        assert off() < 0.8 * plain
        support = read_table(tmp_path / "associations.parquet", Associations)
        assert len(support) > 0.8 * np.count_nonzero(found.box >= 0)
        made = read_provenance(tmp_path / "t.parquet").parameters
        assert smooths("track", made)


def test_boxes_of_another_program_give_the_same_tracks(walk, tmp_path):
    """Frames without a box are numbers that are left out between two others of the camera."""
    dark = (walk.sensor == walk.sensor[0]) & (walk.frame > 5) & (walk.frame < 9)
    blind = walk.take(dark & (walk.box == 0))
    nothing = {
        name: np.full(len(blind), np.nan) for name in ("left_px", "top_px", "width_px", "height_px", "confidence")
    }
    empty = replace(
        blind, box=np.full(len(blind), -1, np.int32), target_id=np.full(len(blind), -1, np.int32), **nothing
    )
    found = Boxes.merge([walk.take(~dark), empty])
    assert len(empty) == 3
    assert track(tmp_path, found, SCENE) == ExitCode.DONE
    ours = tracks(tmp_path)
    lines = ["camera,frame,t_ns,x1,y1,x2,y2,score"]
    for row in np.flatnonzero(found.box >= 0).tolist():
        left, top = float(found.left_px[row]), float(found.top_px[row])
        right, bottom = left + float(found.width_px[row]), top + float(found.height_px[row])
        place = f"{found.sensor[row]},{found.frame[row]},{found.t_ns[row]}"
        lines.append(f"{place},{left!r},{top!r},{right!r},{bottom!r},{float(found.confidence[row])!r}")
    (tmp_path / "own.csv").write_text("\n".join(lines) + "\n")
    assert follow(tmp_path, str(tmp_path / "own.csv"), "--scene", str(tmp_path / "hall.yaml")) == ExitCode.DONE
    theirs = tracks(tmp_path)
    assert (theirs.t_ns.tolist(), theirs.target_id.tolist()) == (ours.t_ns.tolist(), ours.target_id.tolist())
    np.testing.assert_allclose(theirs.x, ours.x, atol=1e-6)


def test_boxes_without_a_method_are_tracked_by_jipda(walk, tmp_path, capsys):
    with RecordingWriter(tmp_path / "r.mcap", SCENE, Provenance("test"), overwrite=True) as out:
        out.table(walk)
    found = []
    # An option of the method is taken, and the method is stored as if it had been named
    for name, more in (("by_input", []), ("named", ["--method", "jipda"])):
        path = tmp_path / f"{name}.parquet"
        args = ["track", str(tmp_path / "r.mcap"), "-o", str(path), "--set", "termination_threshold=0.02", *more]
        assert run(args) == ExitCode.DONE
        assert ("method jipda" in capsys.readouterr().err) is (name == "by_input")
        assert read_provenance(path).parameters["method"] == "jipda"
        found.append(path.read_bytes())
    assert found[0] == found[1]


def test_the_function_takes_the_method_that_fits(walk, tmp_path):
    boxes_path, scene = written(tmp_path, walk, SCENE)
    source = occlog.read(boxes_path)
    assert occlog.track(source, scene).provenance["parameters"]["method"] == "jipda"
    with pytest.raises(UsageError, match="apf"):
        occlog.track(source, scene, method="kalman")
