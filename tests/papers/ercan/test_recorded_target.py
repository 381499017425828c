"""The target of a recording without truth: its own detections, and where their lines of sight say that it was."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recorded_scenes import SCENE, rows, track_at, walked
from tracker_scenes import SECOND

from occlog.cli.main import run
from occlog.errors import ExitCode, InputError
from occlog.io.files.tables.parquet import read_table
from occlog.papers.ercan.recorded import MEETINGS, RATE, assign, read_cmc, recorded_target, smoothed, stand_in, unseen
from occlog.records.tables import Bearings


def test_of_several_detections_the_nearest_is_the_targets() -> None:
    near, far, wild = rows([(40, 10), (40, 12)]), rows([(40, 40), (40, 44)]), rows([(10, 40), (10, 41)])
    both = Bearings.merge([near, far])
    mine = assign(SCENE, both, track_at([(40, 10), (40, 12)]))
    np.testing.assert_array_equal(mine.bearing, near.bearing)
    assert set(mine.target_id.tolist()) == {0}
    none = assign(SCENE, wild, track_at([(40, 10), (40, 12)]))
    np.testing.assert_array_equal(none.seen, False)


def test_a_dropped_detection_says_that_the_camera_looked() -> None:
    table = rows([(40, 0), (41, 0)])
    left = unseen(table, np.array([False, True]))
    np.testing.assert_array_equal(left.seen, [True, False])
    assert left.bearing[0] == table.bearing[0]
    assert np.isnan([left.bearing[1], left.sigma[1], left.u_px[1], left.sigma_px[1]]).all()


def test_smoothing_is_a_parabola_through_the_nearest_points() -> None:
    """Against a polynomial fit of the reference library, at times on and between the points."""
    rng = np.random.default_rng(8)
    at = np.cumsum(rng.integers(1, 4, 12)) * SECOND
    xy, weight = rng.normal(size=(12, 2)), rng.uniform(0.5, 2, 12)
    times = np.sort(np.concatenate([at, at[:-1] + SECOND // 3]))
    found = smoothed(at, xy, weight, times)
    for t, place in zip(times, found, strict=True):
        near = sorted(range(12), key=lambda i: (abs(at[i] - t), i))[:MEETINGS]
        fit = np.polyfit((at[near] - t) / SECOND, xy[near], 2, w=weight[near])
        np.testing.assert_allclose(place, fit[-1], atol=1e-9)


def test_smoothing_keeps_an_accelerated_walk() -> None:
    t = np.arange(20.0)
    walk = np.column_stack([3 + t - 0.1 * t**2, 0.05 * t**2])
    found = smoothed((t * SECOND).astype(np.int64), walk, np.ones(20), (t * SECOND).astype(np.int64))
    np.testing.assert_allclose(found, walk, atol=1e-9)


def test_sight_lines_say_where_the_target_was() -> None:
    """Four cameras without noise, some of them blind at times: true places, from the first meeting to the last."""
    t = np.arange(16.0)
    walk = np.column_stack([40 + t, 30 + 0.1 * t**2])
    tables = [rows(walk, c.name, 0) for c in SCENE.cameras]
    blind = [t < 2, (t == 7) | (t > 13), (t == 7) | (t > 13), np.zeros(16, dtype=bool)]
    mine = Bearings.merge([unseen(table, off) for table, off in zip(tables, blind, strict=True)])
    found = stand_in(SCENE, mine, 3)
    np.testing.assert_array_equal(found.t_ns, np.arange(14) * SECOND)  # at 14 and 15 two lines only
    np.testing.assert_allclose(np.column_stack([found.x, found.y]), walk[:14], atol=1e-6)
    with pytest.raises(InputError, match="3 lines of sight met at 5 times, expected at least 7"):
        stand_in(SCENE, mine.take(mine.t_ns < 5 * SECOND), 3)


def test_a_recording_in_other_units_or_with_one_camera_is_refused() -> None:
    scene, table = walked(8, "unit")
    with pytest.raises(InputError, match="requires metres"):
        recorded_target(scene, table)
    scene, table = walked(20)
    with pytest.raises(InputError, match="1 cameras saw the target, expected at least 2"):
        recorded_target(scene, table.take(table.sensor == "cam1"))
    with pytest.raises(InputError, match="8 times with detections, expected more than 11"):
        recorded_target(scene, table.take(table.t_ns < 8 * SECOND))


def test_the_shipped_folder_is_read_as_by_the_commands(shared_data: Path, tmp_path: Path) -> None:
    data = shared_data / "cmc_detections"
    scene, bearings = read_cmc(data)
    mcap, table = str(tmp_path / "cmc.mcap"), str(tmp_path / "b.parquet")
    ingest = ["--boxes", str(data / "CMC1_detections.csv"), "--calibration", str(data / "calibration")]
    assert run(["ingest", "-o", mcap, *ingest, "--image-size", "1920x1024", "--fps", RATE, "-q"]) == ExitCode.DONE
    assert run(["detect", mcap, "-o", table, "-q"]) == ExitCode.DONE
    reported = read_table(Path(table), Bearings).sorted()
    for name in ("t_ns", "sensor", "seen", "bearing", "sigma", "u_px", "sigma_px", "score"):
        np.testing.assert_array_equal(getattr(bearings.sorted(), name), getattr(reported, name), err_msg=name)
    assert scene.room is not None
    assert [c.name for c in scene.cameras] == ["cam1", "cam2", "cam3", "cam4"]


@pytest.mark.statistics
def test_the_stand_in_is_where_a_camera_left_out_sees_somebody(shared_data: Path) -> None:
    """Cameras 1 to 3 alone: half of camera 4's nearest detections point at the place within 0.1 m (measured 0.06)."""
    scene, bearings = read_cmc(shared_data / "cmc_detections")
    bearings = bearings.take(bearings.t_ns < np.median(bearings.t_ns))
    places = recorded_target(scene, bearings.take(bearings.sensor != "cam4")).positions
    held = bearings.take((bearings.sensor == "cam4") & bearings.seen & np.isin(bearings.t_ns, places.t_ns))
    row = np.searchsorted(places.t_ns, held.t_ns)
    x, y = np.array([places.x[row], places.y[row]]) - scene.cameras[3].ground[:, None]
    miss = np.abs(np.hypot(x, y) * np.sin(held.bearing - np.arctan2(y, x)))
    nearest = [miss[held.t_ns == t].min() for t in np.unique(held.t_ns)]
    assert len(nearest) > 90
    assert np.median(nearest) < 0.1
    speed = np.hypot(places.x[5:] - places.x[:-5], places.y[5:] - places.y[:-5]) / (
        (places.t_ns[5:] - places.t_ns[:-5]) * 1e-9
    )
    assert 1.0 < np.median(speed) < 1.4  # somebody walks
