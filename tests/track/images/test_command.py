"""`occlog track` in the images of a recording: views that do not keep step, damage, bad input, births, geometry."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from view_videos import SMALL, STEP_NS, record_balls, small_balls, small_scene

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_provenance, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.io.recording.reader import open_recording
from occlog.measure.epipolar.geometry import view_geometry
from occlog.measure.epipolar.views import TrackedView
from occlog.records.declared.views import ViewTracks
from occlog.records.losses import Loss
from occlog.records.messages import VERDICT
from occlog.records.tables import Bearings, Boxes, Tracks, TruthBoxes
from occlog.track.catalogue import METHODS
from occlog.track.methods.images.methods.config import CONFIGS
from occlog.track.methods.images.run.inputs import first_free

pytestmark = pytest.mark.jit

IN_IMAGES = tuple(name for name, entry in METHODS.items() if entry.images)

FRAMES = SMALL.frames
HEADER = "sensor,target_id,x_px,y_px,a_px,b_px,rho_deg"


@pytest.fixture(scope="module")
def balls(tmp_path_factory):
    return record_balls(tmp_path_factory.mktemp("views") / "balls.mcap", detector=True)


def track(source: Path, folder: Path, *args: str, method: str = "bmct", initial: Path | str | None = "same") -> int:
    start = [] if initial is None else ["--initial-ellipses", str(source if initial == "same" else initial)]
    return run(
        ["track", str(source), "--method", method, "-o", str(folder / "t.parquet"), "--overwrite", *start, *args]
    )


def result(folder: Path) -> ViewTracks:
    return read_table(folder / "t.parquet", ViewTracks)


def misses(table: ViewTracks, seed: int = 3) -> np.ndarray:
    """Distances of the estimates from the true centres, in radii."""
    truth = np.array([frame.ellipses[:, :, :2] for frame in small_balls(seed)])
    view = np.array([int(name[4:]) - 1 for name in table.sensor])
    true = truth[table.frame, view, table.target_id]
    return np.hypot(table.x_px - true[:, 0], table.y_px - true[:, 1]) / SMALL.radius


def refused(capsys, code: ExitCode, wanted: ExitCode = ExitCode.BAD_INPUT) -> str:
    """The one line of an error."""
    assert code == wanted
    stderr = capsys.readouterr().err.strip()
    assert stderr.count("\n") == 0
    assert "Traceback" not in stderr
    return stderr


def test_names_are_those_of_the_methods():
    assert tuple(CONFIGS) == IN_IMAGES
    assert all(METHODS[name].images for name in CONFIGS)


@pytest.mark.parametrize("method", IN_IMAGES)
def test_every_method_follows_the_balls(balls, tmp_path, capsys, method):
    assert track(balls, tmp_path, "--json", "--seed", "1", method=method) == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    table = result(tmp_path)
    assert summary["frames"] == {"view1": FRAMES, "view2": FRAMES}
    assert (summary["targets"], summary["initiated"], summary["rows"]) == (3, 6, len(table))
    assert len(table) == 2 * 3 * FRAMES
    assert (table.lifecycle[table.frame == 0] == "start").all()
    assert np.mean(misses(table) < 1.0) > 0.9
    made = read_provenance(tmp_path / "t.parquet")
    assert made.parameters["method"] == method
    assert made.parameters["births"] == "initial"
    assert (made.seed, [name for name, _ in made.inputs]) == (1, ["balls.mcap"])


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(balls, tmp_path):
    files = []
    for seed in ("5", "5", "6"):
        assert track(balls, tmp_path, "-q", "--seed", seed) == ExitCode.DONE
        files.append((tmp_path / "t.parquet").read_bytes())
    assert files[0] == files[1]
    assert files[0] != files[2]


def test_settings_and_particles(balls, tmp_path, capsys):
    assert track(balls, tmp_path, "-q", "--particles", "7", "--set", "sigma_px=2.5") == ExitCode.DONE
    made = read_provenance(tmp_path / "t.parquet").parameters
    assert (made["particles"], made["sigma_px"], made["confirmation_frames"]) == (7, 2.5, 3)
    assert result(tmp_path).ess[-1] <= 7
    capsys.readouterr()
    assert "has no setting 'birth_frame'" in refused(
        capsys, track(balls, tmp_path, "--set", "birth_frame=2"), ExitCode.USAGE
    )
    assert "confirmation_frames=-1: must be at least 0" in refused(
        capsys, track(balls, tmp_path, "--set", "confirmation_frames=-1"), ExitCode.USAGE
    )


def test_grey_video(tmp_path):
    path = record_balls(
        tmp_path / "grey.mcap", change=lambda view, frame, image: cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    )
    assert track(path, tmp_path, "-q") == ExitCode.DONE
    assert len(result(tmp_path)) == 2 * 3 * FRAMES


def test_a_view_that_ends_early_is_reported_and_the_other_goes_on(tmp_path, capsys):
    path = record_balls(tmp_path / "early.mcap", keep=lambda view, frame: view == "view1" or frame < 7)
    assert track(path, tmp_path) == ExitCode.DONE
    captured = capsys.readouterr()
    assert "note: view view2 ends 0.36 s before the others, after 7 frames" in captured.err
    table = result(tmp_path)
    assert table.frame[table.sensor == "view1"].max() == FRAMES - 1
    assert table.frame[table.sensor == "view2"].max() == 6


def test_a_view_that_starts_late_joins(tmp_path, capsys):
    path = record_balls(tmp_path / "late.mcap", keep=lambda view, frame: view == "view1" or frame > 5)
    assert track(path, tmp_path) == ExitCode.DONE
    table = result(tmp_path)
    start = table.take((table.sensor == "view2") & (table.lifecycle == "start"))
    assert set(start.frame.tolist()) == {0}
    assert set((start.t_ns - table.t_ns[0]).tolist()) == {6 * STEP_NS}


def test_views_of_unequal_rate_whose_clocks_are_apart(tmp_path):
    path = record_balls(
        tmp_path / "rates.mcap",
        keep=lambda view, frame: view == "view1" or frame % 2 == 0,
        late_ns={"view2": 11_000_000},
    )
    assert track(path, tmp_path, "-q") == ExitCode.DONE
    table = result(tmp_path)
    second = table.take(table.sensor == "view2")
    assert len(second) == 3 * FRAMES // 2
    assert set(np.unique((second.t_ns - table.t_ns[0]) % STEP_NS).tolist()) == {11_000_000}
    assert (np.diff(table.t_ns) >= 0).all()
    assert read_provenance(tmp_path / "t.parquet").parameters["window_ns"] == STEP_NS // 2 - 1
    first = table.take(table.sensor == "view1")
    assert np.mean(misses(first) < 1.0) > 0.9


def test_frames_that_are_lost_are_listed(tmp_path, capsys):
    def change(view, frame, image):
        return b"broken" if view == "view2" and frame in (0, 4, 5) else image

    path = record_balls(tmp_path / "lost.mcap", change=change)
    assert track(path, tmp_path, "--json") == ExitCode.LOSSY
    captured = capsys.readouterr()
    assert "occlog: lost: view2: frames 4 to 5: " in captured.err
    summary = json.loads(captured.out)
    assert summary["frames"] == {"view1": FRAMES, "view2": FRAMES - 3}
    assert [loss["count"] for loss in summary["losses"]] == [1, 2]
    assert len(read_provenance(tmp_path / "t.parquet").losses) == 2
    table = result(tmp_path)
    # Starts wait for the first frame that there is
    assert set(table.frame[(table.sensor == "view2") & (table.lifecycle == "start")].tolist()) == {1}


def test_ellipses_that_cannot_be_are_refused_and_nothing_is_written(balls, tmp_path, capsys):
    path = tmp_path / "e.csv"
    for line, message in (
        ("view1,0,400,60,11,11,0", "e.csv: line 2: x_px is 400, outside the image of camera view1"),
        ("view1,0,40,60,0,11,0", "line 2: a_px is 0;"),
        ("door,0,40,60,11,11,0", "line 2: camera 'door' is none of view1, view2"),
        ("view1,0,40,60,11,11,0\nview1,0,50,60,11,11,0", "line 3: target 0 is in camera view1 already (line 2)"),
    ):
        path.write_text(f"{HEADER}\n{line}\n")
        assert message in refused(capsys, track(balls, tmp_path, initial=path))
    path.write_text(f"{HEADER},frame\nview1,0,40,60,11,11,0,99\n")
    message = refused(capsys, track(balls, tmp_path, initial=path))
    assert "line 2: frame 99 of target 0: camera view1 has no such frame; it has 0 to 15; correct it" in message
    assert not (tmp_path / "t.parquet").exists()


def test_a_start_in_a_later_frame(balls, tmp_path):
    x, y = small_balls()[5].ellipses[0, 1, :2]
    path = tmp_path / "e.csv"
    path.write_text(f"{HEADER},frame\nview1,1,{x},{y},11,11,0,5\n")
    assert track(balls, tmp_path, "-q", initial=path) == ExitCode.DONE
    table = result(tmp_path)
    assert table.frame.tolist() == list(range(5, FRAMES))


def test_inputs_without_images(balls, tmp_path, capsys):
    bearings = tmp_path / "b.parquet"
    write_table(bearings, Bearings.empty(), Provenance("test"))
    assert "is not a recording (.mcap); method bmct tracks in images" in refused(
        capsys, track(bearings, tmp_path, initial=None)
    )
    plain = record_balls(tmp_path / "plain.mcap", keep=lambda view, frame: False)
    message = refused(capsys, track(plain, tmp_path, initial=None))
    assert "plain.mcap: holds no images; method bmct tracks in images" in message
    assert "no images of camera 'view9'; did you mean" in refused(
        capsys, track(balls, tmp_path, "--cameras", "view9"), ExitCode.USAGE
    )
    assert "no camera is left" in refused(capsys, track(balls, tmp_path, "--without", "view1,view2"), ExitCode.USAGE)


@pytest.mark.parametrize(
    "args", [["--lag", "1"], ["--diagnostics", "d.parquet"], ["--start", "1,2"], ["--doa", "d.csv"], ["--target", "1"]]
)
def test_options_that_mean_nothing_are_refused(balls, tmp_path, capsys, args):
    assert track(balls, tmp_path, *args) == ExitCode.USAGE
    assert "not of --method bmct" in capsys.readouterr().err


def test_options_of_tracking_in_images_go_with_no_other_method(balls, tmp_path, capsys):
    assert track(balls, tmp_path, method="apf") == ExitCode.USAGE
    assert (
        "--initial-ellipses is an option of --method mipf, idmot, cmct, bmct, mcmc, not of --method "
        in capsys.readouterr().err
    )


def test_one_view_has_no_help_and_is_reported(balls, tmp_path, capsys):
    assert track(balls, tmp_path, "--cameras", "view2") == ExitCode.DONE
    stderr = capsys.readouterr().err
    assert "there is one view only, so other views cannot assist it: --method bmct does what idmot does" in stderr
    table = result(tmp_path)
    assert set(table.sensor.tolist()) == {"view2"}
    assert not set(table.likelihood_mode.tolist()) & {"bmct", "cmct"}


def test_views_of_which_nothing_is_known_track_alone(tmp_path, capsys):
    path = record_balls(tmp_path / "bare.mcap", posed=False)
    assert track(path, tmp_path) == ExitCode.DONE
    assert "no geometry links the views" in capsys.readouterr().err
    assert len(result(tmp_path)) == 2 * 3 * FRAMES
    message = refused(capsys, track(path, tmp_path, "--ground-tracks", str(tmp_path / "w.parquet")))
    assert "no camera has a pose, so there are no ground positions" in message


def matrices(path: Path, shift_px: float) -> Path:
    """The fundamental matrix of the two views, its lines in the second moved down."""
    views = [TrackedView(f"view{k}", SMALL.width, SMALL.height) for k in (1, 2)]
    move = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, shift_px], [0.0, 0.0, 1.0]])
    wrong = move.T @ view_geometry(views, small_scene()).fundamental[0, 1]
    path.write_text(json.dumps({"pairs": [{"a": "view1", "b": "view2", "matrix": wrong.tolist()}]}))
    return path


def test_a_wrong_fundamental_matrix_is_noticed_stated_and_not_used(balls, tmp_path, capsys):
    good, bad = matrices(tmp_path / "good.json", 0.0), matrices(tmp_path / "bad.json", 30.0)
    assert track(balls, tmp_path, "--fundamental", str(good), "--json") == ExitCode.DONE
    captured = capsys.readouterr()
    assert "does not fit" not in captured.err
    checks = json.loads(captured.out)["loop_checks"]["view1-view2"]
    assert checks["failed"] < 0.2 * checks["checks"]
    assert track(balls, tmp_path, "--fundamental", str(bad), "--json") == ExitCode.DONE
    captured = capsys.readouterr()
    assert "warning: views view1, view2: the fundamental matrix does not fit: in 100% of" in captured.err
    assert "; give another (--fundamental)" in captured.err
    table = result(tmp_path)
    assert not set(table.likelihood_mode.tolist()) & {"bmct", "cmct"}
    assert np.mean(misses(table) < 1.0) > 0.9
    assert read_provenance(tmp_path / "t.parquet").parameters["geometry"] == {"view1-view2": "bad.json"}


def test_matrices_of_other_views_are_reported_or_refused(balls, tmp_path, capsys):
    good = json.loads(matrices(tmp_path / "good.json", 0.0).read_text())["pairs"][0]
    path = tmp_path / "f.json"
    path.write_text(json.dumps({"pairs": [{**good, "a": "door"}, {**good, "a": "door", "b": "hall"}]}))
    message = refused(capsys, track(balls, tmp_path, "--fundamental", str(path)))
    assert "f.json: none of its pairs (door-view2, door-hall) is of two of the views used (view1, view2)" in message
    assert not (tmp_path / "t.parquet").exists()
    assert track(balls, tmp_path, "-q") == ExitCode.DONE
    video = ["report", str(tmp_path / "t.parquet"), "--recording", str(balls), "--frame", "1", "--png"]
    code = run([*video, str(tmp_path / "o.png"), "--fundamental", str(path)])
    assert "none of its pairs (door-view2, door-hall)" in refused(capsys, code)
    path.write_text(json.dumps({"pairs": [{**good, "a": "door"}, good]}))
    assert track(balls, tmp_path, "--fundamental", str(path)) == ExitCode.DONE
    assert "f.json: not used: door-view2; the views are view1, view2" in capsys.readouterr().err
    assert read_provenance(tmp_path / "t.parquet").parameters["geometry"] == {"view1-view2": "f.json"}


def test_a_scene_that_is_given_comes_before_matrices_in_the_recording(balls, tmp_path, capsys):
    held, scene = tmp_path / "held.mcap", tmp_path / "scene.yaml"
    bad = matrices(tmp_path / "bad.json", 30.0)
    assert run(["epipolar", str(balls), "--fundamental", str(bad), "-o", str(held), "-q"]) == ExitCode.DONE
    scene.write_text(scene_to_yaml(small_scene()))
    parameters = {}
    for args in ((), ("--scene", str(scene))):
        capsys.readouterr()
        assert track(held, tmp_path, *args, method="mipf") == ExitCode.DONE
        parameters[len(args)] = read_provenance(tmp_path / "t.parquet").parameters["geometry"]["view1-view2"]
        assert ("does not fit" in capsys.readouterr().err) == (not args)
    assert parameters == {0: "recording", 2: "poses"}


def test_a_view_without_first_ellipses_and_a_run_without_any_are_reported(balls, tmp_path, capsys):
    path = tmp_path / "e.csv"
    path.write_text(f"{HEADER}\nview1,0,60,60,11,11,0\n")
    assert track(balls, tmp_path, initial=path) == ExitCode.DONE
    assert "no initial ellipse began a tracker in view2: nothing is tracked there" in capsys.readouterr().err
    assert track(balls, tmp_path, initial=None) == ExitCode.DONE
    assert "no --initial-ellipses and no --detections: trackers begin from the boxes in" in capsys.readouterr().err


def test_new_targets_have_numbers_that_are_free():
    assert [first_free(ids) for ids in ([], [4, 2], [2**31 - 1], [0, 2**31 - 1], [2**30 + 5, 2**31 - 9])] == [
        0,
        5,
        0,
        1,
        0,
    ]


def test_the_largest_identity_leaves_room_for_others(balls, tmp_path):
    x, y = small_balls()[0].ellipses[0, 1, :2]
    path, boxes = tmp_path / "e.csv", tmp_path / "boxes.parquet"
    path.write_text(f"{HEADER}\nview1,{2**31 - 1},{x},{y},11,11,0\n")
    write_table(boxes, read_boxes(balls), Provenance("test"))
    assert track(balls, tmp_path, "-q", "--detections", str(boxes), initial=path) == ExitCode.DONE
    ids = sorted(set(result(tmp_path).target_id.tolist()))
    assert ids[0] == 0
    assert ids[-1] == 2**31 - 1
    assert len(ids) >= 3


def test_nothing_could_begin_a_tracker(balls, tmp_path, capsys):
    message = refused(capsys, track(balls, tmp_path, "--set", "confirmation_frames=0", initial=None), ExitCode.USAGE)
    assert "confirmation_frames is 0, so detections initiate no tracker; give --initial-ellipses, or set" in message


@pytest.mark.parametrize("how", ["late", pytest.param("apart", marks=pytest.mark.statistics)])
def test_a_wrong_matrix_is_noticed_where_views_begin_one_after_the_other(tmp_path, capsys, how):
    keep = {"late": lambda view, frame: view == "view1" or frame > 5, "apart": lambda view, frame: True}[how]
    late_ns = {"late": {}, "apart": {"view2": STEP_NS // 2}}[how]
    path = record_balls(tmp_path / "x.mcap", keep=keep, late_ns=late_ns)
    good, bad = matrices(tmp_path / "good.json", 0.0), matrices(tmp_path / "bad.json", 30.0)
    assert track(path, tmp_path, "--fundamental", str(good)) == ExitCode.DONE
    assert "does not fit" not in capsys.readouterr().err
    assert "bmct" in result(tmp_path).likelihood_mode.tolist()
    assert track(path, tmp_path, "--fundamental", str(bad)) == ExitCode.DONE
    assert "does not fit: in 100% of" in capsys.readouterr().err
    assert set(result(tmp_path).likelihood_mode.tolist()) <= {"", "mipf", "idmot"}


def test_a_fundamental_matrix_that_is_none_is_refused(balls, tmp_path, capsys):
    path = tmp_path / "f.json"
    path.write_text(json.dumps({"pairs": [{"a": "view1", "b": "view2", "matrix": [[0, 0, 0]] * 3}]}))
    assert "f.json: pairs[0]" in refused(capsys, track(balls, tmp_path, "--fundamental", str(path)))


def test_trackers_begin_from_the_boxes_in_the_recording(balls, tmp_path):
    assert track(balls, tmp_path, "-q", initial=None) == ExitCode.DONE
    table = result(tmp_path)
    started = table.take(table.lifecycle == "start")
    assert read_provenance(tmp_path / "t.parquet").parameters["births"] == "detections"
    assert (started.frame == 2).sum() >= 4
    # The same ball has the same identity in both views
    truth = small_balls()[2].ellipses[:, :, :2]
    named = {}
    for row in np.flatnonzero(started.frame == 2).tolist():
        view = int(started.sensor[row][4:]) - 1
        near = np.hypot(*(truth[view] - [started.x_px[row], started.y_px[row]]).T)
        assert near.min() < 0.3 * SMALL.radius
        named.setdefault(int(near.argmin()), []).append((view, int(started.target_id[row])))
    both = [ids for ids in named.values() if len(ids) == 2]
    assert both
    assert all(a[1] == b[1] for a, b in both)


def test_detections_of_a_file(balls, tmp_path, capsys):
    path = tmp_path / "boxes.parquet"
    truth = read_boxes(balls)
    write_table(path, truth, Provenance("test"))
    assert track(balls, tmp_path, "-q", "--detections", str(path), initial=None) == ExitCode.DONE
    assert (result(tmp_path).lifecycle == "start").sum() >= 4
    # With initial ellipses too, the identities are theirs
    assert track(balls, tmp_path, "-q", "--detections", str(path)) == ExitCode.DONE
    table = result(tmp_path)
    assert set(table.target_id[table.frame == 0].tolist()) == {0, 1, 2}
    assert read_provenance(tmp_path / "t.parquet").parameters["births"] == "both"
    later = {c.name: getattr(truth, c.name) for c in Boxes.columns()} | {"t_ns": truth.t_ns + 7}
    write_table(path, Boxes.of(**later), Provenance("test"), overwrite=True)
    message = refused(capsys, track(balls, tmp_path, "--detections", str(path), initial=None))
    assert "regions is of the time of a frame of view1, view2" in message
    write_table(path, Bearings.empty(), Provenance("test"), overwrite=True)
    assert "holds bearings; expected boxes or views" in refused(
        capsys, track(balls, tmp_path, "--detections", str(path), initial=None)
    )


def read_boxes(path: Path) -> Boxes:
    from occlog.io.recording.reader import open_recording

    return open_recording(path).read(Boxes)


def test_trackers_begin_from_what_moves(tmp_path):
    path = record_balls(tmp_path / "plain.mcap", boxes=False)
    assert track(path, tmp_path, "-q", initial=None) == ExitCode.DONE
    table = result(tmp_path)
    assert (table.lifecycle == "start").sum() >= 2


def test_world_tracks(balls, tmp_path, capsys):
    out = tmp_path / "w.parquet"
    assert track(balls, tmp_path, "--ground-tracks", str(out), "--json") == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    table = read_table(out, Tracks)
    assert summary["ground_tracks"] == str(out)
    assert summary["triangulation"]["times"] == 3 * FRAMES
    assert len(table) > 2.5 * FRAMES
    assert np.isfinite(table.z).all()


def test_outputs_are_not_overwritten_nor_inputs(balls, tmp_path, capsys):
    assert track(balls, tmp_path, "-q") == ExitCode.DONE
    again = [
        "track",
        str(balls),
        "--method",
        "mipf",
        "--initial-ellipses",
        str(balls),
        "-o",
        str(tmp_path / "t.parquet"),
    ]
    capsys.readouterr()
    assert "t.parquet" in refused(capsys, run(again), ExitCode.EXISTS)
    assert run([*again[:-1], str(balls)]) == ExitCode.USAGE
    assert run([*again, "--overwrite", "--ground-tracks", str(tmp_path / "t.parquet")]) == ExitCode.USAGE


def test_truth_boxes_of_the_same_frames_as_initial_table(balls, tmp_path):
    from occlog.io.recording.reader import open_recording

    path = tmp_path / "truth.parquet"
    write_table(path, open_recording(balls).read(TruthBoxes), Provenance("test"))
    assert track(balls, tmp_path, "-q", method="mipf", initial=path) == ExitCode.DONE
    assert set(result(tmp_path).target_id.tolist()) == {0, 1, 2}


@pytest.mark.parametrize(
    "method", ["mcmc", *(pytest.param(m, marks=pytest.mark.statistics) for m in IN_IMAGES if m != "mcmc")]
)
def test_every_method_ends_trackers_that_nothing_supports(balls, tmp_path, method):
    boxes = read_boxes(balls)
    seen = boxes.take(boxes.frame < 6)
    frames = boxes.take((boxes.frame >= 6) & (boxes.box == 0))
    nan = np.full(len(frames), np.nan)
    empty = {c.name: getattr(frames, c.name) for c in Boxes.columns()} | {
        "box": np.full(len(frames), -1, np.int32),
        "left_px": nan,
        "top_px": nan,
        "width_px": nan,
        "height_px": nan,
    }
    path = tmp_path / "boxes.parquet"
    write_table(path, Boxes.concat([seen, Boxes.of(**empty)]), Provenance("test"))
    args = ("-q", "--detections", str(path), "--set", "max_coasting_frames=3")
    assert track(balls, tmp_path, *args, method=method, initial=None) == ExitCode.DONE
    table = result(tmp_path)
    last = table.take(table.lifecycle == "terminated")
    assert len(last) == (table.lifecycle == "start").sum() >= 4
    assert set(last.frame.tolist()) == {8}
    assert table.frame.max() == 8


def test_colours_of_the_background_may_be_left_out(balls, tmp_path):
    assert track(balls, tmp_path, "-q", "--set", "background=true") == ExitCode.DONE
    assert read_provenance(tmp_path / "t.parquet").parameters["background"] is True
    table = result(tmp_path)
    assert len(table) == 2 * 3 * FRAMES
    assert np.mean(misses(table) < 1.0) > 0.8


def test_tables_may_be_of_a_longer_recording(tmp_path, capsys):
    path = record_balls(tmp_path / "short.mcap", keep=lambda view, frame: frame < 5)
    long = {
        "t_ns": np.array([0]),
        "sensor": ["view1"],
        "frame": np.array([9]),
        "box": np.zeros(1, np.int32),
        "target_id": np.array([8], np.int32),
        "left_px": [40.0],
        "top_px": [40.0],
        "width_px": [20.0],
        "height_px": [20.0],
        "confidence": [np.nan],
        "visible": [1.0],
    }
    table = tmp_path / "truth.parquet"
    write_table(table, TruthBoxes.of(**long), Provenance("test"))
    assert track(path, tmp_path, method="mipf", initial=table) == ExitCode.DONE
    stderr = capsys.readouterr().err
    assert VERDICT["initial-ellipses-unused"].text.format(count=1, given=1) in stderr
    assert VERDICT["no-view-tracks"].text in stderr


def test_what_was_lost_of_first_ellipses_and_of_matrices_is_listed(balls, tmp_path):
    first, matrices = tmp_path / "first.parquet", tmp_path / "f.json"
    lost = [Loss("a.mp4", "frame 7", "is cut", 1), Loss("b.mp4", "frame 9", "is cut", 2)]
    boxes = open_recording(balls).read(TruthBoxes)
    write_table(first, boxes, Provenance("detect", losses=(lost[0],)))
    assert run(["epipolar", "--scene", str(balls), "-o", str(matrices), "-q"]) == ExitCode.DONE
    values = json.loads(matrices.read_text())
    values["_provenance"]["losses"] = [lost[1].as_dict()]
    matrices.write_text(json.dumps(values))
    assert track(balls, tmp_path, "--fundamental", str(matrices), "-q", initial=first) == ExitCode.DONE
    assert list(read_provenance(tmp_path / "t.parquet").losses) == lost
