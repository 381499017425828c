"""Tracks in recorded scenes without a room."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from places import ROOT

from occlog.cli.main import run
from occlog.consistency.estimates import covariances
from occlog.errors import ExitCode
from occlog.io.files.tables.parquet import read_table
from occlog.io.open import open_input
from occlog.measure.detect.from_boxes import detect_boxes
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Boxes, Diagnostics, Tracks, TruthBoxes
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.apf.config import ApfConfig


@pytest.mark.statistics
def test_two_of_the_shipped_cameras_find_the_man_where_their_sight_lines_meet(tmp_path, capsys):
    data, names = ROOT / "sample_data" / "pose2sim", ("walk.mcap", "b.parquet", "t.parquet", "d.parquet")
    walk, bearings, tracks, diagnostics = (str(tmp_path / name) for name in names)
    videos = [part for cam in ("cam01", "cam02") for part in ("--video", f"{cam}={data / cam}.mp4")]
    assert run(["ingest", "-o", walk, *videos, "--calibration", str(data / "Calib.qca.txt"), "-q"]) == ExitCode.DONE
    assert run(["detect", walk, "--method", "background", "-o", bearings, "-q"]) == ExitCode.DONE
    assert run(["track", bearings, "--scene", walk, "-o", tracks, "--diagnostics", diagnostics]) == ExitCode.DONE
    assert "warning" not in capsys.readouterr().err
    assert set(read_table(Path(diagnostics), Diagnostics).quality_flags.tolist()) == {""}
    assert run(["evaluate", tracks, "--bearings", bearings, "--scene", walk, "--json"]) == ExitCode.DONE
    # 0.05 to 0.06 m over seeds; 1.5 m where targets were confined to the box around the cameras
    assert json.loads(capsys.readouterr().out)["triangulation_distance_median_m"] < 0.1


def labelled(boxes: Boxes, scene: Scene) -> Bearings:
    """Bearings of boxes, with the identities of the boxes."""
    parts = []
    for k in np.unique(boxes.target_id[boxes.box >= 0]):
        own = boxes.take((boxes.target_id == k) & (boxes.box >= 0))
        found = Bearings.concat(d.bearings for d in detect_boxes([own], scene))
        parts.append(dataclasses.replace(found, target_id=np.full(len(found), k, np.int32)))
    return Bearings.merge(parts)


@pytest.mark.statistics
def test_one_camera_states_covariances_that_hold_the_truth(shared_data, tmp_path, capsys):
    """PETS 2009 S2.L1, View_001: true boxes as bearings of ten people, 17 to 38 m from the camera."""
    data, pets = shared_data / "pets2009_s2l1_view1", tmp_path / "pets.mcap"
    source = ["--video", f"View_001={data / 'vtest.avi'}", "--calibration", str(data / "calibration" / "View_001.xml")]
    truth = ["--truth", f"View_001={data / 'annotations' / 'PETS2009-S2L1_frames_000-399.xml'}"]
    frames = ["--frames", "0:400", "--fps", "7", "--store", "link", "-q"]
    assert run(["ingest", "-o", str(pets), *source, *truth, *frames]) == ExitCode.DONE
    capsys.readouterr()
    opened = open_input(pets, TruthBoxes)
    true, scene = opened.read(TruthBoxes), opened.scene
    assert scene is not None
    boxes = Boxes(**{c.name: getattr(true, c.name) for c in Boxes.columns()})
    config = dataclasses.replace(ApfConfig.in_unit("m"), particles=300)
    parts = list(track([labelled(boxes, scene)], scene, TrackingTask(config, 1)))
    tracks, diagnostics = (
        Tracks.concat(p.tracks for p in parts),
        Diagnostics.concat(p.diagnostics for p in parts),
    )
    # The truth: feet on the ground
    camera, rows = scene.cameras[0], boxes.box >= 0
    rays = camera.rays(np.column_stack([boxes.left_px + 0.5 * boxes.width_px, boxes.top_px + boxes.height_px])[rows])
    feet = (camera.position - (camera.position[2] / rays[:, 2])[:, None] * rays)[:, :2]
    at = dict(zip(zip(boxes.t_ns[rows].tolist(), boxes.target_id[rows].tolist(), strict=True), feet, strict=True))
    keys = list(zip(tracks.t_ns.tolist(), tracks.target_id.tolist(), strict=True))
    error = np.column_stack([tracks.x, tracks.y]) - np.array([at[key] for key in keys])
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariances(tracks)), error)
    assert len(nees) == 2396
    assert np.mean(nees < 4.0) > 0.9
    # All but the first second of each person
    assert np.mean(diagnostics.quality_flags == "single_sensor") > 0.95
