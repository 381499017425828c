"""`occlog run`: stages in order, skipped when up to date, checked like the commands."""

from __future__ import annotations

import json
import threading
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from people_boxes import boxes, hall, truth

from occlog.cli.main import run
from occlog.errors import ExitCode, InputError, option
from occlog.io.files.atomic import alone_with
from occlog.io.files.provenance import Provenance, hash_file
from occlog.io.files.tables.parquet import read_table
from occlog.io.files.texts.documents import write_json
from occlog.io.formats.models.onnx_file import OnnxFile
from occlog.io.recording.copy import copy_recording
from occlog.io.recording.reader import open_recording
from occlog.io.recording.writer import RecordingWriter
from occlog.pipeline.run import run as stages_in_order
from occlog.pipeline.run import stage as run_inputs
from occlog.pipeline.run.run import Digests, drop_empty, key_of, outcomes
from occlog.pipeline.run.stage import RunStage, files_of, name_of
from occlog.pipeline.run.stages import check_settings, plan, read_config, refused_in
from occlog.records.losses import Loss
from occlog.records.tables import Boxes, Particles, PeopleTracks, Tracks, TruthBoxes

SCENE = """
occlog_scene: 1
room: [[0, 0], [8, 0], [8, 6], [0, 6]]
cameras:
- {name: a, position: [0, 0], yaw_deg: 40, focal_px: 300, fov_deg: 100, noise: {measurement_noise_px: 2}}
- {name: b, position: [8, 0], yaw_deg: 140, focal_px: 300, fov_deg: 100, noise: {measurement_noise_px: 2}}
- {name: c, position: [4, 6], yaw_deg: 270, focal_px: 300, fov_deg: 140, noise: {measurement_noise_px: 2}}
"""
CONFIG = """
occlog_run: 1
seed: 3
simulate: {scene: room.yaml, steps: 8, occluders: 2}
track: {particles: 50}
"""
OUTPUTS = {
    "recording.mcap",
    "bearings.parquet",
    "views.parquet",
    "tracks.parquet",
    "diagnostics.parquet",
    "errors.parquet",
    "bound.parquet",
    "metrics.json",
    "report.html",
    "report.md",
    "report.png",
    "run.json",
}


@pytest.fixture
def config(tmp_path: Path) -> Path:
    (tmp_path / "room.yaml").write_text(SCENE)
    path = tmp_path / "run.yaml"
    path.write_text(CONFIG)
    return path


def stages(config: Path, capsys: pytest.CaptureFixture[str], *args: str) -> dict[str, str]:
    """What each stage did."""
    code = run(["run", str(config), "-o", str(config.parent / "out"), "--json", "-q", *args])
    out = capsys.readouterr()
    assert code == ExitCode.DONE, out.err
    return dict(json.loads(out.out)["stages"])


def test_all_stages_then_only_what_changed(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert set(stages(config, capsys, "--dry-run").values()) == {"would run"}
    assert not (config.parent / "out").exists()
    first = stages(config, capsys)
    assert set(first) == {"simulate", "detect", "track", "evaluate", "report"}
    assert set(first.values()) == {"done"}
    assert {p.name for p in (config.parent / "out").iterdir()} == OUTPUTS
    assert len(read_table(config.parent / "out" / "tracks.parquet", Tracks)) == 8

    assert set(stages(config, capsys).values()) == {"up to date"}

    config.write_text(CONFIG.replace("50", "60"))
    again = stages(config, capsys)
    assert [again[n] for n in ("simulate", "detect")] == ["up to date"] * 2
    assert again["track"] == "done"

    (config.parent / "out" / "metrics.json").write_text("{}]")  # an output that somebody changed is made again
    assert stages(config, capsys, "--dry-run")["evaluate"] == "would run"
    (config.parent / "out" / "metrics.json").write_text('{"rmse_m": 7}')
    assert run(["run", str(config), "-o", str(config.parent / "out"), "--dry-run"]) == ExitCode.DONE
    stdout = capsys.readouterr().out
    assert "rmse" not in stdout
    assert stages(config, capsys)["evaluate"] == "done"


def test_particles_are_among_the_outputs_where_they_are_asked_for(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = config.parent / "out"
    config.write_text(CONFIG.replace("{particles: 50}", "{particles: 50, particle_cloud: true}"))
    assert stages(config, capsys)["track"] == "done"
    particles = read_table(folder / "particles.parquet", Particles)
    tracks = read_table(folder / "tracks.parquet", Tracks)
    assert set(particles.t_ns.tolist()) == set(tracks.t_ns.tolist())
    first = particles.take(particles.t_ns == tracks.t_ns[0])
    assert len(first) == 50
    assert np.average(first.x, weights=first.weight) == pytest.approx(tracks.x[0], abs=1e-6)
    assert stages(config, capsys)["track"] == "up to date"
    assert "/particles" in shown_topics(folder)
    config.write_text(CONFIG.replace("{particles: 50}", "{particles: 50, particle_cloud: p.parquet}"))
    capsys.readouterr()
    assert run(["run", str(config), "-o", str(folder), "-q"]) == ExitCode.BAD_INPUT
    assert (
        "line 5: track.particle_cloud: expected true or false (outputs of a run are in its folder)"
        in capsys.readouterr().err
    )


def shown_topics(folder: Path) -> set[str]:
    """Topics of what viewers are given of a run."""
    path = folder.parent / "shown.mcap"
    assert run(["export", str(folder), "-o", str(path), "-q"]) == 0
    return {topic.name for topic in open_recording(path).topics}


def test_other_packages_are_named_where_they_are_why_stages_would_run(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stages(config, capsys)
    state = config.parent / "out" / "run.json"
    values = json.loads(state.read_text())
    assert values["versions"]["scipy"]
    values["versions"] |= {"scipy": "1.0", "gone": "2.0"}
    state.write_text(json.dumps(values))
    assert run(["run", str(config), "-o", str(state.parent), "--dry-run"]) == ExitCode.DONE
    stderr = capsys.readouterr().err
    assert "was made with other packages: gone 2.0, now none, scipy 1.0, now " in stderr


def test_a_change_that_leaves_outputs_the_same_stops_early(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stages(config, capsys)
    scene = config.parent / "room.yaml"
    scene.write_text("# a comment\n" + scene.read_text())
    again = stages(config, capsys)
    assert again["simulate"] == "done"
    # Its provenance names the changed scene file, so the recording differs; the bearings' rows do not.
    assert again["report"] in ("done", "up to date")


def test_missed_threshold_is_reported_after_all_was_made(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config.write_text(CONFIG + "evaluate: {fail_if: ['rmse>0.0001']}\n")
    assert run(["run", str(config), "-o", str(config.parent / "out"), "-q"]) == ExitCode.THRESHOLD
    assert "rmse" in capsys.readouterr().err
    assert {p.name for p in (config.parent / "out").iterdir()} == OUTPUTS


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("particles", "partciles", "run.yaml: line 5: track.partciles: unknown key; did you mean 'particles'?"),
        ("particles: 50", "particles: 0", "run.yaml: line 5: track.particles: 0: must be at least 1"),
        (
            "particles: 50",
            "set: {process_noise_position: -1}",
            "run.yaml: line 5: track.set.process_noise_position: -1: must be at least 0",
        ),
        (
            "particles: 50",
            "set: {sigma_v: 1}",
            "line 5: track.set.sigma_v: apf has no setting 'sigma_v'; did you mean",
        ),
        (
            "particles: 50",
            "process_noise_position: 1",
            "line 5: track.process_noise_position: unknown key; it is a setting; give it under set",
        ),
        (
            "particles: 50",
            "gallery: g.parquet",
            "line 5: track.gallery: unknown key; it is a key of method jipda; remove",
        ),
        ("track:", "trakc:", "unknown key 'trakc'; did you mean 'track'?"),
        ("occlog_run: 1", "occlog_run: 2", "expected `occlog_run: 1`"),
        ("simulate:", "recording: a.mcap\nsimulate:", "give exactly one of recording, simulate, ingest"),
        ("track: {particles: 50}", "track: 7", "track: expected keys and values"),
        ("particles: 50", "particles: many", "line 5: track.particles: expected a whole number, got 'many'"),
        ("particles: 50", "method: ekff", "line 5: track.method: no method 'ekff'; did you mean 'ekf'?"),
        ("particles: 50", "smooth: 1", "line 5: track.smooth: expected true or false, got 1"),
        ("particles: 50", "strict: true, set: [sigma_v]", "line 5: track.set: sigma_v: expected NAME=VALUE"),
        ("particles: 50", "output: x", "track.output: outputs of a run are in its folder"),
        ("room.yaml", "nowhere.yaml", "run.yaml: line 4: simulate: nowhere.yaml: no such file"),
        ("steps: 8", "render: 7", "simulate.render: expected true or false, got 7"),
    ],
)
def test_what_is_wrong_is_named(
    config: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, message: str
) -> None:
    config.write_text(CONFIG.replace(old, new))
    code = run(["run", str(config), "-o", str(config.parent / "out"), "-q"])
    error = capsys.readouterr().err
    assert code in (ExitCode.BAD_INPUT, ExitCode.USAGE)
    assert message in error
    assert error.count("\n") == 1


def test_errors_of_a_stage_name_the_configuration_and_its_keys_not_options(config: Path) -> None:
    with pytest.raises(InputError) as refused, refused_in(read_config(config), "track"):
        raise InputError(f"a.csv: no times; give {option('fps')}", id="missing-value")
    assert (str(refused.value), refused.value.id) == (
        f"{config}: line 5: track: a.csv: no times; give fps",
        "missing-value",
    )


def test_a_folder_with_other_things_is_left_alone(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = config.parent / "out"
    out.mkdir()
    (out / "thesis.tex").write_text("words")
    assert run(["run", str(config), "-o", str(out), "-q"]) == ExitCode.USAGE
    assert "not a run folder" in capsys.readouterr().err
    assert [p.name for p in out.iterdir()] == ["thesis.tex"]


@pytest.mark.jit
def test_everybody_is_followed_by_boxes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = hall("abc")
    with RecordingWriter(tmp_path / "hall.mcap", scene, Provenance("test")) as out:
        out.table(boxes(scene, 2.0))
        out.table(truth(2.0))
    config = tmp_path / "run.yaml"
    config.write_text(
        "occlog_run: 1\nrecording: hall.mcap\ntrack: {method: jipda, set: {confirmation_threshold: 0.9}}\n"
    )
    assert set(stages(config, capsys)) == {"detect", "track", "evaluate", "report"}
    made = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"associations.parquet", "events.parquet", "view_tracks.parquet", "metrics.json", "report.html"} <= made
    assert len(read_table(tmp_path / "out" / "tracks.parquet", PeopleTracks))
    assert json.loads((tmp_path / "out" / "metrics.json").read_text())["idf1"] > 0.9


@pytest.mark.jit
def test_a_truth_of_boxes_alone_is_compared_with_the_tracks_in_the_images(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, missing = hall("ab"), boxes(hall("ab"), 2.0)
    whole = boxes(scene, 2.0, miss=0.0, px=0.0)
    true = {c.name: getattr(whole, c.name) for c in Boxes.columns()}
    with RecordingWriter(tmp_path / "hall.mcap", scene, Provenance("test")) as out:
        out.table(missing)
        out.table(TruthBoxes(**true, visible=np.where(whole.box >= 0, 1.0, np.nan)))
    config = tmp_path / "run.yaml"
    config.write_text("occlog_run: 1\nrecording: hall.mcap\ntrack: {method: jipda}\nevaluate: {fail_if: [idf1<1.1]}\n")
    assert run(["run", str(config), "-o", str(tmp_path / "out"), "-q", "--json"]) == ExitCode.THRESHOLD
    assert json.loads(capsys.readouterr().out)["metrics"]["idf1"] > 0.9
    made = {path.name for path in (tmp_path / "out").iterdir()}
    assert "metrics_in_images.json" in made
    assert not made & {"metrics.json", "errors.parquet"}
    assert "IDF1" in (tmp_path / "out" / "report.md").read_text()
    tracks, page = str(tmp_path / "out" / "tracks.parquet"), tmp_path / "again.html"
    assert run(["evaluate", tracks, "--truth", str(tmp_path / "hall.mcap")]) == ExitCode.BAD_INPUT
    assert "view_tracks.parquet" in capsys.readouterr().err
    assert run(["report", str(tmp_path / "out"), "-o", str(page), "--markdown", str(tmp_path / "again.md")]) == 0
    assert "IDF1" in (tmp_path / "again.md").read_text()


def test_a_run_simulates_people_and_draws_them_over_the_video(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "run.yaml"
    config.write_text("occlog_run: 1\nsimulate: {scene: people, frames: 5}\ntrack: {method: jipda}\n")
    wanted = stages(config, capsys, "--dry-run")
    assert set(wanted) == {"simulate", "detect", "track", "evaluate", "evaluate-in-images", "report", "overlay"}


def test_a_target_is_drawn_over_the_video_where_that_is_asked_for(tmp_path: Path) -> None:
    config = tmp_path / "run.yaml"
    for overlay, last in (("", "report"), ("overlay: {trail: 1}\n", "overlay"), ("overlay: false\n", "report")):
        config.write_text(f"occlog_run: 1\nsimulate: {{scene: people, frames: 5}}\n{overlay}")
        made = list(plan(read_config(config), tmp_path / "out"))
        assert made[-1].name == last
        if last == "overlay":
            words = " ".join(made[-1].texts())
            assert f"diagnostics: {tmp_path}/out/diagnostics.parquet" in words
            assert f"{tmp_path}/out/tracks.parquet" in words


def test_keys_of_the_overlay_are_options_of_its_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    head = "occlog_run: 1\nsimulate: {scene: people, frames: 5}\ntrack: {method: jipda}\n"
    config = tmp_path / "run.yaml"
    config.write_text(head + "overlay: {camera: [cam1, cam2], frames: 0:3, fps: 5}\n")
    made = list(plan(read_config(config), tmp_path / "out"))
    assert made[-1].name == "overlay"
    made[-1].check()
    assert {"cam1", "cam2", "0:3", "5"} <= set(made[-1].texts())
    report = next(stage for stage in made if stage.name == "report")
    assert str(report.values["events"]).endswith("events.parquet")
    config.write_text(head + "overlay: false\n")
    assert "overlay" not in stages(config, capsys, "--dry-run")
    for overlay, words in (
        ("{video: o.mp4}", "overlay.video: outputs of a run"),
        ("{frame: x, fsp: 3}", "did you mean 'fps'"),
    ):
        config.write_text(head + f"overlay: {overlay}\n")
        assert run(["run", str(config), "-o", str(tmp_path / "out"), "--dry-run"]) == ExitCode.BAD_INPUT
        assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("simulate: {scene: room.yaml}\noverlay: {}\n", "the recording holds no video"),
        ("ingest: {boxes: b.csv}\ntrack: {method: jipda}\noverlay: {fps: 5}\n", "the recording holds no video"),
    ],
)
def test_an_overlay_of_nothing_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, words: str
) -> None:
    config = tmp_path / "run.yaml"
    config.write_text("occlog_run: 1\n" + text)
    assert run(["run", str(config), "-o", str(tmp_path / "out"), "--dry-run"]) == ExitCode.BAD_INPUT
    assert words in capsys.readouterr().err


def test_everybody_wants_no_priors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "run.yaml"
    config.write_text("occlog_run: 1\nsimulate: {scene: people}\npriors: {}\ntrack: {method: jipda}\n")
    assert run(["run", str(config), "-o", str(tmp_path / "out")]) == ExitCode.BAD_INPUT
    assert "priors: method jipda takes none" in capsys.readouterr().err


def test_reads_of_tags_need_no_detection(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "run.yaml"
    config.write_text("occlog_run: 1\nrecording: tags.mcap\ntrack: {method: rssi}\ndetect: {history: 50}\n")
    assert run(["run", str(config), "-o", str(tmp_path / "out"), "--dry-run"]) == ExitCode.BAD_INPUT
    assert "line 4: detect: there are no images and no boxes to detect in; remove this key" in capsys.readouterr().err


def test_a_table_needs_a_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "run.yaml"
    config.write_text("occlog_run: 1\ntable: ranges.csv\n")
    assert run(["run", str(config), "-o", str(tmp_path / "out"), "--dry-run"]) == ExitCode.BAD_INPUT
    assert "line 2: table: a file of measurements holds no scene; add the key `scene`" in capsys.readouterr().err


def recording_with_video(folder: Path) -> Path:
    """A recording that links to a video of no content next to it."""
    folder.mkdir()
    (folder / "a.avi").write_bytes(b"frames")
    with RecordingWriter(folder / "hall.mcap", hall("a"), Provenance("test")) as out:
        out.table(boxes(hall("a"), 0.2))
        out.video("a", "a.avi", "0" * 64)
    return folder / "hall.mcap"


@pytest.mark.parametrize(
    ("keys", "wanted"),
    [
        ("frames: '0:3', image_size: 64x48", None),
        ("frames: '3:3'", "line 2: ingest.frames: '3:3'"),
        ("image_size: 64x0", "line 2: ingest.image_size: '64x0'"),
        ("fsp: 3", "line 2: ingest.fsp: unknown key; did you mean 'fps'"),
    ],
)
def test_frames_and_sizes_of_an_ingest_are_read_as_on_the_command_line(
    tmp_path: Path, keys: str, wanted: str | None
) -> None:
    config = tmp_path / "run.yaml"
    config.write_text(f"occlog_run: 1\ningest: {{boxes: {{a: b.csv}}, {keys}}}\n", encoding="utf-8")
    with pytest.raises(InputError, match=wanted) if wanted else nullcontext():
        read = read_config(config)
        check_settings(read, next(plan(read, tmp_path / "out")))


def key_of_detect(recording: Path) -> str:
    config = recording.parent / "run.yaml"
    config.write_text("occlog_run: 1\nrecording: hall.mcap\n")
    stage = next(iter(plan(read_config(config), recording.parent / "out")))
    return key_of(stage, recording.parent / "out", Digests())


@pytest.mark.parametrize(
    ("more", "place"),
    [
        ("", "run.yaml: scene"),
        ("scene: r.mcap", "run.yaml: line 4: scene"),
        ("detect: {scene: r.mcap}", "run.yaml: line 4: detect.scene"),
    ],
)
def test_a_recording_without_a_scene_asks_for_the_key_not_the_option(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: str, place: str
) -> None:
    with RecordingWriter(tmp_path / "r.mcap", None, Provenance("test")) as out:
        out.table(boxes(hall("a"), 0.2))
    config = tmp_path / "run.yaml"
    config.write_text(f"occlog_run: 1\nrecording: r.mcap\ntrack: {{}}\n{more}\n")
    assert run(["run", str(config), "-o", str(tmp_path / "out")]) == ExitCode.BAD_INPUT
    stderr = capsys.readouterr().err.splitlines()[-1]
    assert stderr.startswith(f"occlog: error: {config.with_name(place)}: ")
    assert stderr.endswith("r.mcap holds no scene; name here a scene file or a recording with one")


def test_the_scene_of_a_run_is_that_of_every_stage(tmp_path: Path) -> None:
    config = tmp_path / "run.yaml"
    config.write_text("occlog_run: 1\nrecording: r.mcap\nscene: room.yaml\ntrack: {}\n")
    with RecordingWriter(tmp_path / "r.mcap", None, Provenance("test")):
        pass
    stages = list(plan(read_config(config), tmp_path / "out"))
    assert [s.name for s in stages if "room.yaml" not in s.texts()] == []


def test_a_stage_depends_on_linked_videos_and_not_on_where_its_inputs_lie(tmp_path: Path) -> None:
    one, two = recording_with_video(tmp_path / "one"), recording_with_video(tmp_path / "two")
    before = key_of_detect(one)
    assert key_of_detect(two) == before
    (tmp_path / "one" / "a.avi").write_bytes(b"framez")
    (tmp_path / "two" / "a.avi").unlink()
    assert len({before, key_of_detect(one), key_of_detect(two)}) == 3


def test_paths_with_an_equals_sign_are_inputs_like_others(tmp_path: Path) -> None:
    (tmp_path / "date=1").mkdir()
    one = recording_with_video(tmp_path / "date=1" / "k=2")
    before = key_of_detect(one)
    (one.parent / "a.avi").write_bytes(b"framez")
    assert key_of_detect(one) != before


def test_an_argument_may_be_a_path_as_it_is_and_behind_an_equals_sign(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a=b").mkdir()
    for name in ("a=b/c.mp4", "c.mp4"):
        (tmp_path / name).write_bytes(b"frames")
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "c.mp4").write_bytes(b"others")
    assert files_of("a=b/c.mp4") == [Path("a=b/c.mp4"), Path("b/c.mp4")]
    assert files_of("x=c.mp4") == [Path("c.mp4")]
    for text in ("", "title=", "t" * 300, "a\0b"):
        assert files_of(text) == []


def test_what_is_read_next_to_an_argument_is_an_input(tmp_path: Path) -> None:
    """Names of classes next to or above labels; a folder's files are known by the way to them."""
    labels = tmp_path / "labels" / "view1"
    labels.mkdir(parents=True)
    (labels / "000000.txt").write_text("0 0.5 0.5 0.1 0.2\n")
    (tmp_path / "labels" / "classes.txt").write_text("person\n")
    assert files_of(f"view1={labels}") == [labels / "000000.txt", tmp_path / "labels" / "classes.txt"]
    folder = str(tmp_path / "labels")
    assert [name_of(file, folder) for file in files_of(folder)] == ["classes.txt", "view1/000000.txt"]


def test_weights_next_to_a_network_are_inputs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model, weights = tmp_path / "net.onnx", tmp_path / "net.bin"
    model.write_bytes(b"network")
    weights.write_bytes(b"weights")
    reported = OnnxFile(model, (), (), {}, (weights,))
    monkeypatch.setattr(run_inputs, "read_onnx", {model: reported}.__getitem__)
    assert files_of(str(model)) == [model, weights]


@pytest.mark.jit
def test_what_a_stage_made_goes_with_the_stage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It would pass for the run's own: figures of a truth that is not there any more."""
    scene, folder, config = hall("abc"), tmp_path / "out", tmp_path / "run.yaml"
    config.write_text("occlog_run: 1\nrecording: hall.mcap\ntrack: {method: jipda}\n")

    def record(*, known: bool) -> None:
        with RecordingWriter(tmp_path / "hall.mcap", scene, Provenance("test"), overwrite=True) as out:
            out.table(boxes(scene, 2.0))
            if known:
                out.table(truth(2.0))

    record(known=True)
    assert "evaluate" in stages(config, capsys)
    (folder / "errors.parquet").write_bytes(b"of somebody else")
    record(known=False)
    assert run(["run", str(config), "-o", str(folder), "--json", "-q"]) == ExitCode.DONE
    result = json.loads(capsys.readouterr().out)
    assert "evaluate" not in result["stages"]
    assert result["metrics"] == {}
    assert "evaluate" not in outcomes(folder)
    assert not (folder / "metrics.json").exists()
    assert (folder / "errors.parquet").read_bytes() == b"of somebody else"
    assert (folder / "tracks.parquet").exists()


def test_a_run_that_was_interrupted_in_its_first_stage_goes_on(
    config: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = config.parent / "out"

    def interrupted(stage: RunStage) -> int:
        (Path(stage.output_paths[0]).parent / "bearings.parquet").write_bytes(b"whole")
        raise KeyboardInterrupt

    monkeypatch.setattr(stages_in_order, "_do", interrupted)
    assert run(["run", str(config), "-o", str(out), "-q"]) == ExitCode.INTERRUPTED
    capsys.readouterr()
    assert stages(config, capsys, "--dry-run")["simulate"] == "would run"


def test_a_run_folder_with_a_part_of_its_first_stage_is_gone_on_with(tmp_path: Path) -> None:
    write_json(tmp_path / "run.json", {"stages": {}})
    (tmp_path / "views.parquet").write_bytes(b"whole")
    drop_empty(tmp_path)
    assert outcomes(tmp_path) == {}
    (tmp_path / "views.parquet").unlink()
    drop_empty(tmp_path)
    assert not tmp_path.exists()


def test_two_commands_do_not_mix_their_stages_in_one_folder(
    config: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = config.parent / "out"
    out.mkdir()
    monkeypatch.setattr(stages_in_order, "PATIENCE", 0.0)
    with alone_with(out, "run"):
        assert run(["run", str(config), "-o", str(out)]) == ExitCode.USAGE
    line = f"occlog: error: {out}: is in use by another `occlog run`; wait until it ends, or name another one\n"
    assert capsys.readouterr().err == line
    assert list(out.iterdir()) == []


def test_a_command_waits_for_the_one_before_it(tmp_path: Path) -> None:
    held, free = threading.Event(), threading.Event()

    def hold() -> None:
        with alone_with(tmp_path, "run"):
            held.set()
            free.wait(10)

    other = threading.Thread(target=hold)
    other.start()
    held.wait(10)
    threading.Timer(0.3, free.set).start()
    with alone_with(tmp_path, "run", patience=10.0):
        assert free.is_set()
    other.join()


def test_what_was_lost_is_reported_of_stages_that_are_up_to_date_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The stages of the run lost nothing themselves."""
    (tmp_path / "room.yaml").write_text(SCENE)
    made = ["simulate", str(tmp_path / "room.yaml"), "-o", str(tmp_path / "w.mcap"), "--steps", "20", "-q"]
    assert run(made) == ExitCode.DONE
    whole = open_recording(tmp_path / "w.mcap")
    lost = Provenance("test", losses=(Loss("cam.avi", "frame 3", "gone", 1),))
    copy_recording(whole, tmp_path / "r.mcap", {}, lost)
    (tmp_path / "run.yaml").write_text("occlog_run: 1\nrecording: r.mcap\ntrack: {particles: 50}\n")
    for what in ("done", "up to date"):
        capsys.readouterr()
        words = ["run", str(tmp_path / "run.yaml"), "-o", str(tmp_path / "out"), "--json"]
        assert run(words) == ExitCode.DONE
        out = capsys.readouterr()
        assert "occlog: lost earlier: cam.avi: frame 3: gone" in out.err
        result = json.loads(out.out)
        assert set(result["stages"].values()) == {what}
        assert [loss["place"] for loss in result["losses"]] == ["frame 3"]


@pytest.mark.parametrize("name", ["run.json", "views.parquet", "tracks.parquet"])
def test_links_out_of_the_run_folder_are_not_followed(
    config: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """Whoever packed or sent the folder may have put them there."""
    folder, mine = config.parent / "out", config.parent / "mine"
    folder.mkdir()
    write_json(folder / "run.json", {"stages": {}})
    (folder / name).unlink(missing_ok=True)
    if name == "run.json":
        write_json(mine, {"stages": {}})
    else:
        mine.write_text("mine")
    before = mine.read_bytes()
    (folder / name).symlink_to(mine)
    assert run(["run", str(config), "-o", str(folder), "-q"]) == ExitCode.BAD_INPUT
    error = capsys.readouterr().err
    assert f"{name}: is a link to {mine}, outside of {folder}" in error
    assert mine.read_bytes() == before


def test_a_state_that_names_files_elsewhere_is_refused_and_removes_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The outputs of a stage that the configuration no longer has are removed: only where they are the run's own."""
    config, folder, elsewhere = tmp_path / "run.yaml", tmp_path / "out", tmp_path / "mine.txt"
    config.write_text("occlog_run: 1\nrecording: missing.mcap\ntrack: {}\n")
    elsewhere.write_text("mine")
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path)
    for name in ("../mine.txt", str(elsewhere), "link/mine.txt"):
        reported = {"key": "", "code": 0, "outputs": {name: hash_file(elsewhere)}}
        write_json(folder / "run.json", {"stages": {"listen": reported}}, overwrite=True)
        assert run(["run", str(config), "-o", str(folder)]) == ExitCode.BAD_INPUT
        assert "run.json: not the state of a run; remove it" in capsys.readouterr().err
        assert elsewhere.exists()


@pytest.mark.parametrize(
    "reported",
    [
        {"code": "abc"},
        {"code": None},
        {"code": True},
        {"code": 4},
        {"code": 10**30},
        {"outputs": []},
        {"outputs": None},
        {"outputs": {"a": 1}},
        {"key": 1},
        {"more": 1},
    ],
)
def test_a_state_of_other_kinds_is_refused(tmp_path: Path, reported: dict[str, object]) -> None:
    whole: dict[str, object] = {"key": "", "code": 3, "outputs": {"a/b": "c"}}
    write_json(tmp_path / "run.json", {"stages": {"track": whole}})
    assert outcomes(tmp_path)["track"].code == ExitCode.LOSSY
    write_json(tmp_path / "run.json", {"stages": {"track": whole | reported}}, overwrite=True)
    with pytest.raises(InputError, match="not the state of a run; remove it to do every stage again"):
        outcomes(tmp_path)
