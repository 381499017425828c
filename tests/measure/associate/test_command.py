"""`occlog label` on files: inputs of every kind, summary, one-line errors."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from tracker_scenes import SECOND, observe, room100, walk, with_array

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import describe, read_provenance, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.io.recording.writer import RecordingWriter
from occlog.records.losses import Loss
from occlog.records.tables import UNLABELLED, Bearings, Doa, Tracks

SCENE = with_array(room100(pillar=False), (50.0, 50.0), sigma=0.05)
MADE = Provenance("detect", losses=(Loss("cam1", "frame 7", "cut", 1),))
STEPS = 12
PATH = walk(STEPS, np.random.default_rng([1, 0]))


def boxes():
    """Candidates of one target: seen rows without a label, and the frames in which no one is seen."""
    rows = observe(room100(pillar=False), PATH, np.random.default_rng(3))
    return replace(rows, target_id=np.full(len(rows), UNLABELLED, dtype=np.int32))


def doa(source=UNLABELLED):
    return Doa.of(
        t_ns=np.arange(STEPS) * SECOND,
        sensor=["array"] * STEPS,
        source_id=np.full(STEPS, source, dtype=np.int32),
        azimuth=np.arctan2(PATH[:, 1] - 50, PATH[:, 0] - 50),
        elevation=np.full(STEPS, np.nan),
        sigma_azimuth=np.full(STEPS, np.nan),
        sigma_elevation=np.full(STEPS, np.nan),
        confidence=np.full(STEPS, np.nan),
    )


def tracks(target=2, first_s=0, deviation=3.0):
    flat, variance = np.zeros(STEPS), np.full(STEPS, deviation**2)
    return Tracks.of(
        t_ns=(np.arange(STEPS) + first_s) * SECOND,
        target_id=np.full(STEPS, target),
        x=PATH[:, 0],
        y=PATH[:, 1],
        vx=flat,
        vy=flat,
        cov_xx=variance,
        cov_xy=flat,
        cov_yy=variance,
    )


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "scene.yaml").write_text(scene_to_yaml(SCENE))
    write_table(tmp_path / "boxes.parquet", boxes(), MADE, length_unit="unit")
    write_table(tmp_path / "tracks.parquet", tracks(), Provenance("track"), length_unit="unit")
    with RecordingWriter(tmp_path / "room.mcap", SCENE, MADE) as writer:
        writer.table(boxes())
        writer.table(doa())
    return tmp_path


def label(folder, *args, source="boxes.parquet", paths="tracks.parquet", scene=True):
    """Exit code of the command; the output is `labelled.parquet`."""
    scene = ["--scene", str(folder / "scene.yaml")] if scene else []
    files = [str(folder / source), "--tracks", str(folder / paths), "-o", str(folder / "labelled.parquet")]
    return run(["label", *files, *scene, "-q", *args])


def test_candidates_become_labelled_bearings(folder, capsys):
    assert label(folder, "--json") == ExitCode.DONE  # the detector had lost a frame
    summary = json.loads(capsys.readouterr().out)
    found, seen = read_table(folder / "labelled.parquet", Bearings), boxes().seen.sum()
    assert len(found) == 8 * STEPS  # one row for every camera and frame
    assert set(found.target_id.tolist()) == {2}
    assert (summary["labelled"]["2"], summary["unassigned_candidates"]) == (found.seen.sum(), seen - found.seen.sum())
    assert summary["missed_detections"]["2"] == (~found.seen).sum()
    assert (summary["rows"], summary["frames_of_tracks"]) == (8 * STEPS, 8 * STEPS)
    assert found.seen.sum() >= 0.97 * seen  # within three sigmas
    made = read_provenance(folder / "labelled.parquet")
    assert (made.command, made.seed, made.losses) == ("label", None, MADE.losses)
    assert [name for name, _ in made.inputs] == ["boxes.parquet", "tracks.parquet", "scene.yaml"]
    assert {k: made.parameters[k] for k in ("gate", "max_gap_s", "keep_unassigned", "doa_labels")} == {
        "gate": 3.0,
        "max_gap_s": 1.0,
        "keep_unassigned": False,
        "doa_labels": False,
    }
    assert describe(folder / "labelled.parquet")["length_unit"] == "unit"
    labelled = (folder / "labelled.parquet").read_bytes()
    assert label(folder, "--overwrite") == ExitCode.DONE
    assert (folder / "labelled.parquet").read_bytes() == labelled


def test_a_filter_that_wants_labels_can_use_the_result(folder):
    assert label(folder) == ExitCode.DONE
    out = ["-o", str(folder / "again.parquet"), "--scene", str(folder / "scene.yaml"), "-q", "--particles", "100"]
    assert run(["track", str(folder / "labelled.parquet"), *out, "--labelled-only"]) == ExitCode.DONE
    assert set(read_table(folder / "again.parquet", Tracks).target_id.tolist()) == {2}


def test_a_recording_brings_its_scene_and_its_directions_of_arrival(folder, capsys):
    assert label(folder, "--json", source="room.mcap", scene=False) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["rows"] == 9 * STEPS
    found = read_table(folder / "labelled.parquet", Bearings)
    heard = found.take(found.sensor == "array")
    assert len(heard) == STEPS
    assert heard.seen.all()
    assert label(folder, "--cameras", "cam1,array", "--without", "cam1", "--overwrite", source="room.mcap") == 0
    assert set(read_table(folder / "labelled.parquet", Bearings).sensor.tolist()) == {"array"}


def test_directions_of_another_file_may_have_labels_of_their_own(folder):
    write_table(folder / "doa.parquet", doa(5), Provenance("ingest"))
    assert label(folder, "--doa", str(folder / "doa.parquet"), "--doa-labels") == ExitCode.DONE
    found = read_table(folder / "labelled.parquet", Bearings)
    heard = found.take(found.sensor == "array")
    assert heard.target_id.tolist() == [2, 5] * STEPS  # target 2 was not heard
    assert heard.seen.tolist() == [False, True] * STEPS


def test_the_rest_is_left_out_or_kept(folder):
    write_table(folder / "late.parquet", tracks(first_s=6), Provenance("track"))
    assert label(folder, paths="late.parquet") == ExitCode.DONE
    assert read_table(folder / "labelled.parquet", Bearings).t_ns[0] == 6 * SECOND
    assert label(folder, "--keep-unassigned", "--overwrite", paths="late.parquet") == ExitCode.DONE
    found = read_table(folder / "labelled.parquet", Bearings)
    assert found.t_ns[0] == 0
    assert set(found.target_id[found.t_ns < 6 * SECOND].tolist()) == {UNLABELLED}


@pytest.mark.parametrize(
    ("args", "code", "message"),
    [
        (["--gate", "0"], ExitCode.USAGE, "--gate"),
        (["--gate", "nan"], ExitCode.USAGE, "'--gate': nan is not"),
        (["--max-gap", "nan"], ExitCode.USAGE, "'--max-gap': nan is not"),
        (["--max-gap", "inf"], ExitCode.USAGE, "'--max-gap': inf is not"),
        (["--cameras", "cam0"], ExitCode.USAGE, "no sensor 'cam0' in the scene"),
        (["--doa-labels"], ExitCode.USAGE, "--doa-labels requires directions of arrival"),
    ],
)
def test_options_that_make_no_sense_are_one_line(folder, capsys, args, code, message):
    assert label(folder, *args) == code
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (folder / "labelled.parquet").exists()


def test_files_that_do_not_fit_are_refused(folder, capsys):
    write_table(folder / "other.parquet", tracks(first_s=100), Provenance("track"))
    write_table(folder / "feet.parquet", tracks(), Provenance("track", inputs=(("a", "b"),)), length_unit="ft")
    write_table(folder / "nobody.parquet", tracks(target=-1), Provenance("track"))
    messages = {
        "other.parquet": "no track is there at the time of any frame",
        "feet.parquet": "lengths are in ft, but in unit in the scene",
        "nobody.parquet": "target_id is -1 at 0 s",
        "boxes2.parquet": "boxes2.parquet",
        "missing.parquet": "missing.parquet",
        "room.mcap": "holds no tracks",
    }
    write_table(folder / "boxes2.parquet", boxes(), Provenance("detect"))
    for name, message in messages.items():
        assert label(folder, paths=name) in (ExitCode.BAD_INPUT, ExitCode.USAGE)
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1
        assert not (folder / "labelled.parquet").exists()


def test_outputs_that_exist_are_kept_and_inputs_are_not_written_to(folder, capsys):
    (folder / "labelled.parquet").write_text("precious")
    assert label(folder) == ExitCode.EXISTS
    assert (folder / "labelled.parquet").read_text() == "precious"
    (folder / "labelled.parquet").unlink()
    assert label(folder, "-o", str(folder / "tracks.parquet"), "--overwrite") == ExitCode.USAGE
    assert "is an input too" in capsys.readouterr().err


@pytest.mark.statistics
@pytest.mark.jit
def test_boxes_of_one_person_among_others_get_the_label_of_its_track(shared_data, tmp_path, capsys):
    """CMC1: a track by cameras 1 to 3 alone; camera 4's boxes get its label all the same, in most frames."""
    data = shared_data / "cmc_detections"
    (tmp_path / "room.yaml").write_text("occlog_scene: 1\nroom: [[0, 0], [7.67, 0], [7.67, 3.41], [0, 3.41]]\n")
    names = ("hall.mcap", "boxes.parquet", "tracks.parquet", "labelled.parquet", "again.parquet")
    hall, found, tracks, labelled, again = (str(tmp_path / name) for name in names)
    ingest = ["--calibration", str(data / "calibration"), "--image-size", "1920x1024", "--fps", "20"]
    source = ["--boxes", str(data / "CMC1_detections.csv"), "--scene", str(tmp_path / "room.yaml")]
    assert run(["ingest", "-o", hall, *ingest, *source, "-q"]) == ExitCode.DONE
    assert run(["detect", hall, "-o", found, "-q"]) == ExitCode.DONE
    options = ["--scene", hall, "-q"]
    start = ["--without", "cam4", "--start", "2.85,0.45,0.3"]
    assert run(["track", found, "-o", tracks, *options, *start]) == ExitCode.DONE
    capsys.readouterr()
    assert run(["label", found, "--tracks", tracks, "-o", labelled, *options, "--json"]) == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    rows = read_table(tmp_path / "labelled.parquet", Bearings)
    assert summary["rows"] == len(rows) == summary["frames_of_tracks"]
    assert len(np.unique(np.column_stack([rows.t_ns, np.unique(rows.sensor, return_inverse=True)[1]]), axis=0)) == len(
        rows
    )
    assert summary["labelled"]["0"] + summary["unassigned_candidates"] == 3080
    for name in ("cam1", "cam2", "cam3"):
        assert rows.seen[rows.sensor == name].mean() > 0.95
    assert rows.seen[rows.sensor == "cam4"].mean() > 0.85
    # Tracked again from labels alone, the person is where it was.
    assert run(["track", labelled, "-o", again, *options, *start, "--labelled-only"]) == ExitCode.DONE
    first, second = (read_table(tmp_path / name, Tracks) for name in ("tracks.parquet", "again.parquet"))
    np.testing.assert_array_equal(first.t_ns, second.t_ns)
    assert np.median(np.hypot(first.x - second.x, first.y - second.y)) < 0.1
