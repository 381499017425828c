"""`occlog track` of boxes without a calibration: from files to tracks in the images, and what is stated of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.tables.parquet import read_table
from occlog.records.tables import Events, PeopleViews
from occlog.track.catalogue import method_for

pytestmark = pytest.mark.jit


def walkers(frames: int = 60) -> list[str]:
    """MOTChallenge text of two people who cross, the farther one hidden in the middle; frames from 1."""
    rows = []
    for k in range(frames):
        near, far = 200 + 8 * k, 680 - 8 * k
        rows.append(f"{k + 1},-1,{near - 36},270,72,180,0.9,-1,-1,-1")
        if abs(near - far) > 45:
            rows.append(f"{k + 1},-1,{far - 30},270,60,150,0.9,-1,-1,-1")
    return rows


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of boxes of a camera without a calibration, from MOTChallenge text."""
    folder = tmp_path_factory.mktemp("walk")
    (folder / "det.txt").write_text("\n".join(walkers()) + "\n")
    out = folder / "walk.mcap"
    boxes = ["--boxes", f"hall={folder / 'det.txt'}", "--fps", "10", "--allow-uncalibrated"]
    assert run(["ingest", "-o", str(out), *boxes, "-q"]) == ExitCode.DONE
    return out


@pytest.mark.parametrize("smooth", ["--smooth", "--no-smooth"])
def test_boxes_without_a_calibration_become_tracks_in_the_image(
    recording: Path, tmp_path: Path, smooth: str, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    tracks, events = tmp_path / "t.parquet", tmp_path / "e.parquet"
    done = run(["track", str(recording), "-o", str(tracks), "--events", str(events), smooth, "--json"])
    reported = capsys.readouterr()
    assert done == ExitCode.DONE
    assert "method sort, by the input" in reported.err
    summary = json.loads(reported.out)
    assert summary["method"] == "sort"
    assert summary["identities"] == 2
    assert summary["frames"] == {"hall": 60}
    found = read_table(tracks, PeopleViews)
    assert set(np.unique(found.target_id)) == {0, 1}
    assert set(np.unique(found.likelihood_mode)) == {"box", "predicted"}
    # Who was on the left ends on the right
    first, last = found.take(found.frame == 10), found.take(found.frame == 55)
    assert first.target_id[np.argsort(first.x_px)].tolist() == last.target_id[np.argsort(last.x_px)].tolist()[::-1]
    kinds = read_table(events, Events).kind.tolist()
    assert kinds.count("initiated") == 2
    text = tmp_path / "t.txt"
    assert run(["export", str(tracks), "--to", "mot", "-o", str(text), "-q"]) == ExitCode.DONE
    assert len(text.read_text().splitlines()) == len(found)


def test_smoothing_says_so_and_each_camera_has_identities_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "det.txt").write_text("\n".join(walkers(30)) + "\n")
    walk, tracks = tmp_path / "w.mcap", tmp_path / "t.parquet"
    boxes = [part for name in "ab" for part in ("--boxes", f"{name}={tmp_path / 'det.txt'}")]
    assert run(["ingest", "-o", str(walk), *boxes, "--fps", "10", "--allow-uncalibrated", "-q"]) == ExitCode.DONE
    assert run(["track", str(walk), "-o", str(tracks), "-q"]) == ExitCode.DONE
    found = read_table(tracks, PeopleViews)
    own = {name: set(found.target_id[found.sensor == name].tolist()) for name in "ab"}
    assert len(own["a"]) == len(own["b"]) == 2
    assert not own["a"] & own["b"]


def test_boxes_of_no_person_are_stated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "det.txt").write_text("1,-1,10,10,40,90,0.9,-1,-1,-1\n30,-1,400,10,40,90,0.9,-1,-1,-1\n")
    walk = tmp_path / "w.mcap"
    boxes = ["--boxes", f"hall={tmp_path / 'det.txt'}", "--fps", "10", "--allow-uncalibrated", "-q"]
    assert run(["ingest", "-o", str(walk), *boxes]) == ExitCode.DONE
    capsys.readouterr()
    assert run(["track", str(walk), "-o", str(tmp_path / "t.parquet")]) == ExitCode.DONE
    reported = capsys.readouterr()
    assert "no target was found" in reported.err


def test_the_window_is_refused(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    done = run(["track", str(recording), "--method", "sort", "--window", "1", "-o", str(tmp_path / "t.parquet")])
    assert done == ExitCode.USAGE
    assert "--window" in capsys.readouterr().err


def test_the_method_follows_from_the_calibration(recording: Path, tmp_path: Path) -> None:
    assert method_for(recording) == "sort"
    scene = tmp_path / "scene.yaml"
    scene.write_text(
        "occlog_scene: 1\ncameras:\n  - {name: hall, position: [0, 0, 3], yaw_deg: 0, pitch_deg: -20, "
        "image_size: [1000, 600], fov_deg: 60}\n"
    )
    assert method_for(recording, scene) == "jipda"


@pytest.mark.statistics
def test_people_of_a_real_video_without_a_calibration(shared_data: Path, tmp_path: Path) -> None:
    """PETS 2009 S2.L1, View_001, frames 260 to 299, by the network of occlog: video to identities in three commands."""
    data, pets = shared_data / "pets2009_s2l1_view1", tmp_path / "pets.mcap"
    truth = ["--truth", f"View_001={data / 'annotations' / 'PETS2009-S2L1_frames_000-399.xml'}"]
    source = ["--video", f"View_001={data / 'vtest.avi'}", "--frames", "260:300", "--fps", "7", "--allow-uncalibrated"]
    views, tracks, metrics = (str(tmp_path / name) for name in ("v.parquet", "t.parquet", "m.json"))
    assert run(["ingest", "-o", str(pets), *source, *truth, "-q"]) == ExitCode.DONE
    assert run(["detect", str(pets), "-o", str(tmp_path / "b.parquet"), "--views", views, "-q"]) == ExitCode.DONE
    assert run(["track", views, "-o", tracks, "-q"]) == ExitCode.DONE
    assert run(["evaluate", tracks, "--truth", str(pets), "-o", metrics, "-q"]) == ExitCode.DONE
    found = json.loads(Path(metrics).read_text())
    assert found["idf1"] > 0.85
    assert found["mota"] > 0.75
