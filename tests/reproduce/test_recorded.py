"""Virtual occluders over recorded detections: who is hidden, what is dropped, the experiments on real data."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tracker_scenes import SECOND, observe, room100, walk

from occlog.cli.main import run
from occlog.errors import ExitCode, InputError
from occlog.io.parquet import write_table
from occlog.io.provenance import Provenance
from occlog.io.scene_file import scene_to_yaml
from occlog.records import UNLABELLED, Bearings, Tracks, Truth
from occlog.reproduce.model import Size
from occlog.reproduce.recorded import Recorded, assign, hidden, occluders_of, recorded_target, trial, unseen
from occlog.reproduce.recorded_figures import ITEMS

SCENE = room100(pillar=False, cameras=4)  # at (0, 0), (50, 0), (100, 0), (100, 50)


def truth(xy, role="target", first=0):
    """Objects at (T, n, 2) places, a second apart."""
    xy = np.asarray(xy, dtype=float)
    T, n = xy.shape[:2]
    return Truth.of(
        t_ns=np.repeat(np.arange(T) * SECOND, n), target_id=np.tile(np.arange(first, first + n), T),
        role=[role] * (T * n), x=xy[..., 0].ravel(), y=xy[..., 1].ravel(), z=np.full(T * n, np.nan),
    )  # fmt: skip


def rows(places, sensor="cam1"):
    """A camera's bearings of one place a second, without noise."""
    camera = next(c for c in SCENE.cameras if c.name == sensor)
    places = np.asarray(places, dtype=float)
    bearing = np.arctan2(*(places - camera.ground).T[::-1])
    n = len(places)
    return Bearings.of(
        t_ns=np.arange(n) * SECOND, sensor=[sensor] * n, target_id=np.full(n, UNLABELLED), seen=np.ones(n, dtype=bool),
        bearing=bearing, sigma=np.full(n, 0.02), u_px=-70 * np.tan(bearing - camera.yaw), sigma_px=np.full(n, 2.0),
        score=np.full(n, np.nan),
    )  # fmt: skip


def track_at(places, deviation=0.1):
    n = len(places)
    x, y = np.asarray(places, dtype=float).T
    flat, var = np.zeros(n), np.full(n, deviation**2)
    return Tracks.of(
        t_ns=np.arange(n) * SECOND, target_id=np.zeros(n, int), x=x, y=y, vx=flat, vy=flat,
        cov_xx=var, cov_xy=flat, cov_yy=var,
    )  # fmt: skip


def test_who_stands_in_the_sight_line_hides_the_target() -> None:
    """Target at (40, 0) seen from (0, 0): hidden within half a diameter of the line, and between the two."""
    people = truth(
        [[[20, 0.9], [70, 70]], [[20, 1.1], [70, 70]], [[41, 0], [70, 70]], [[-1, 0], [3, -0.5]]], "occluder", 1
    )
    target = [(40, 0)] * 4
    recorded = Recorded(SCENE, rows(target), truth([[p] for p in target]), np.array([40.0, 0.0]))
    np.testing.assert_array_equal(hidden(recorded, people, 2.0), [True, False, False, True])


def test_a_dropped_detection_says_that_the_camera_looked() -> None:
    table = rows([(40, 0), (41, 0)])
    left = unseen(table, np.array([False, True]))
    np.testing.assert_array_equal(left.seen, [True, False])
    assert left.bearing[0] == table.bearing[0]
    assert np.isnan([left.bearing[1], left.sigma[1], left.u_px[1], left.sigma_px[1]]).all()


def test_of_several_detections_the_nearest_is_the_targets() -> None:
    near, far, wild = rows([(40, 10), (40, 12)]), rows([(40, 40), (40, 44)]), rows([(10, 40), (10, 41)])
    both = Bearings.merge([near, far])
    mine = assign(SCENE, both, track_at([(40, 10), (40, 12)]))
    np.testing.assert_array_equal(mine.bearing, near.bearing)
    assert set(mine.target_id.tolist()) == {0}
    none = assign(SCENE, wild, track_at([(40, 10), (40, 12)]))
    np.testing.assert_array_equal(none.seen, False)


def walked(steps=30, unit="m"):
    rng = np.random.default_rng(4)
    scene = replace(SCENE, length_unit=unit)
    table = observe(scene, walk(steps, rng), rng)
    return scene, replace(table, target_id=np.full(len(table), UNLABELLED, dtype=np.int32))


def test_a_recording_in_other_units_or_with_one_camera_is_refused() -> None:
    scene, table = walked(8, "unit")
    with pytest.raises(InputError, match="wants metres"):
        recorded_target(scene, table)
    scene, table = walked(20)
    with pytest.raises(InputError, match="1 cameras saw the target, want at least 2"):
        recorded_target(scene, table.take(table.sensor == "cam1"))
    with pytest.raises(InputError, match="8 times with detections, want more than 11"):
        recorded_target(scene, table.take(table.t_ns < 8 * SECOND))


def test_an_experiment_needs_its_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["reproduce", "ercan", ITEMS[0]]) == ExitCode.USAGE
    assert "give --bearings and --scene" in capsys.readouterr().err
    assert run(["reproduce", "ercan", "fig17", "--scene", str(tmp_path / "s.yaml")]) == ExitCode.USAGE
    assert "goes with --bearings" in capsys.readouterr().err
    scene, table = walked(8, "unit")
    (tmp_path / "s.yaml").write_text(scene_to_yaml(scene))
    write_table(tmp_path / "b.parquet", table, Provenance("detect"))
    args = [
        "reproduce",
        "ercan",
        ITEMS[0],
        "--bearings",
        str(tmp_path / "b.parquet"),
        "--scene",
        str(tmp_path / "s.yaml"),
    ]
    assert run(args) == ExitCode.BAD_INPUT
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "b.parquet" in error
    assert "metres" in error


@pytest.mark.jit
def test_recorded_detections_with_virtual_occluders(
    shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """CMC1 through the command line: tables with the share of hidden detections, plots and verdicts."""
    data = shared_data / "cmc_detections"
    made = [str(tmp_path / "cmc.mcap"), str(tmp_path / "b.parquet")]
    ingest = ["--boxes", str(data / "CMC1_detections.csv"), "--calibration", str(data / "calibration")]
    assert run(["ingest", "-o", made[0], *ingest, "--image-size", "1920x1024", "--fps", "20", "-q"]) == ExitCode.DONE
    assert run(["detect", made[0], "-o", made[1], "-q"]) == ExitCode.DONE
    out = tmp_path / "out"
    args = ["--bearings", made[1], "--scene", made[0], "--quick", "--json", "-q", "-o", str(out)]
    capsys.readouterr()
    assert run(["reproduce", "ercan", *ITEMS, *args]) == ExitCode.DONE
    items = json.loads(capsys.readouterr().out)["items"]
    assert [i["item"] for i in items] == list(ITEMS)
    assert all(i["full"]["steps"] == 261 for i in items)
    page = (out / "reproduce.html").read_text()
    assert all(v["id"] in page for i in items for v in i["verdicts"])
    lines = (out / f"{ITEMS[0]}.csv").read_text().splitlines()
    head = lines[0].split(",")
    shares = [float(line.split(",")[head.index("hidden")]) for line in lines[1:]]
    assert all(0.1 < share < 0.9 for share in shares)
    assert len(lines) == 1 + 3 * 3


@pytest.mark.jit
def test_the_error_is_that_of_the_occlusions(shared_data: Path) -> None:
    """Without anything hidden the labelled detections give the stand-in for the truth again."""
    from occlog.stages.track import track
    from occlog.trackers.apf_config import apf_defaults

    scene, table = walked(60)
    recorded = recorded_target(scene, table)
    assert recorded.cameras == ("cam1", "cam2", "cam3", "cam4")
    tracks = Tracks.concat(p.tracks for p in track([recorded.bearings], scene, apf_defaults("m"), 1))
    away = np.hypot(tracks.x - recorded.places.x, tracks.y - recorded.places.y)[10:]
    assert np.sqrt(np.mean(away**2)) < 3.0  # two filters of one target, in a room of 100 by 100
    people = occluders_of(recorded, 0)
    assert len(np.unique(people.target_id)) == 20
    assert set(people.role.tolist()) == {"occluder"}
    found = trial(recorded, 0, "known", recorded.cameras, Size(2, 40))
    assert found == trial(recorded, 0, "known", recorded.cameras, Size(2, 40))
    assert found["rmse_occ"] == 0.0
