"""Method `joint`: who hides whom, by hand and against the truth's own form; one object as a Kalman filter's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tracker_scenes import observe, room100, scan, true_u, walk

from benchmarks.track._metric_rooms import record
from occlog.cli.main import run
from occlog.consistency.estimates import covariances
from occlog.core.geometry.visibility import behind_objects
from occlog.core.metrics.errors import normalised_squared_errors
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.errors import ExitCode, UsageError
from occlog.filtering.likelihood.measurement_model import rows_of
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.records.scene import MicrophoneArray, Scene
from occlog.records.tables import UNLABELLED, Bearings, Diagnostics, Occluders, Tracks
from occlog.settings import configure
from occlog.track.catalogue import settings_of
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.apf.config import SelectConfig
from occlog.track.methods.joint import filter as joint
from occlog.track.methods.joint.config import JointConfig
from occlog.track.methods.kalman.config import EkfConfig

pytestmark = pytest.mark.jit
SCENE = room100(pillar=False)
PATHS = [walk(40, np.random.default_rng(k)) for k in range(3)]
SEEN = Bearings.merge([observe(SCENE, path, np.random.default_rng(9 + k), target=k) for k, path in enumerate(PATHS)])


def follow(method: str, config, targets: tuple[int, ...] | None = None, bearings: Bearings = SEEN):
    parts = list(track([bearings], SCENE, TrackingTask(config, 0, method=method, targets=targets)))
    return Tracks.concat(p.tracks for p in parts), Diagnostics.concat(p.diagnostics for p in parts)


def test_who_hides_whom_is_the_simulators() -> None:
    xy, camera = np.random.default_rng(0).uniform(0, 30, (50, 6, 2)), np.array([15.0, -3.0])
    found = joint.occlusion_by_others(xy, camera, 3.33)
    for j in range(6):
        np.testing.assert_array_equal(found[:, j], behind_objects(camera, xy[:, j], np.delete(xy, j, axis=1), 3.33))
    assert 0.1 < found.mean() < 0.9


def factors(xy, reports, state, config, unperceivable=1e-12):
    """(L, M) likelihoods, and probabilities that objects are not perceivable."""
    seen = joint.in_plain_view(xy, reports, state.world, config)
    before = np.full(xy.shape[:2], unperceivable)
    found, after = joint.log_factors(xy, reports, seen, before, state.world, state.chances)
    return np.exp(found), after


def test_factors_of_an_object_in_plain_view_and_behind_another() -> None:
    """Camera 2 at (50, 0) points up at an object at (50, 50): the other one is next to the sight line, or on it."""
    config = JointConfig(detection_probability=0.9, false_alarm_probability=0.01)
    state = joint.init(SCENE, config, generator(0, RandomStream.TRACK, 0))
    xy = np.array([[[50.0, 50.0], [70.0, 30.0]], [[50.0, 50.0], [50.0, 30.0]]])
    missed, seen = (
        joint.pack_scan(scan(0.0, [(1, u)]), state.read_px, False) for u in (None, true_u(SCENE, (50, 50))[1])
    )
    nothing = joint.ObjectReports(missed._replace(sensor=missed.sensor[:0], first=missed.first[:1]), rows_of(missed))
    plain, hidden = factors(xy, [joint.ObjectReports(missed, rows_of(missed)), nothing], state, config)[0].prod(axis=1)
    assert (plain, hidden) == (pytest.approx(0.1), pytest.approx(0.99))
    plain, hidden = factors(xy, [joint.ObjectReports(seen, rows_of(seen)), nothing], state, config)[0].prod(axis=1)
    sigma = np.sqrt(4900 * (1e-4 + 1 / 2500) + 4.0)  # [Ercan] Eq. 2 on the axis, 50 away
    floor = 0.01 / 140.0
    assert plain == pytest.approx(0.9 / (np.sqrt(2 * np.pi) * sigma) + 0.1 * floor)
    assert hidden == pytest.approx(floor)


def test_one_object_is_where_a_kalman_filter_of_the_same_motion_has_it() -> None:
    tracks, notes = follow("joint", JointConfig(particles=2000), (0,))
    peer, _ = follow("ekf", EkfConfig(), (0,))
    late = slice(5, None)
    away = np.hypot(tracks.x - peer.x, tracks.y - peer.y)[late]
    assert np.median(away) < 0.35 * np.median(np.sqrt(peer.cov_xx + peer.cov_yy))
    assert np.mean((tracks.cov_xx + tracks.cov_yy)[late]) == pytest.approx(
        np.mean((peer.cov_xx + peer.cov_yy)[late]), rel=0.25
    )
    assert notes.ess[5:].mean() > 400


def test_the_first_scan_of_an_object_counts_once() -> None:
    one = SEEN.take((SEEN.target_id == 0) & (SEEN.t_ns == SEEN.t_ns[0]))
    tracks, _ = follow("joint", JointConfig(particles=4000), bearings=one)
    peer, _ = follow("ekf", EkfConfig(), bearings=one)
    assert tracks.cov_xx == pytest.approx(peer.cov_xx, rel=0.25)
    assert tracks.cov_yy == pytest.approx(peer.cov_yy, rel=0.25)


def test_what_the_scene_says_of_a_camera_comes_before_the_settings() -> None:
    config = JointConfig(detection_probability=0.9, false_alarm_probability=0.01)
    own = replace(SCENE, cameras=(SCENE.cameras[0], replace(SCENE.cameras[1], detection=0.4, false_alarm=0.2)))
    chances = joint.chances_of(own, config)
    assert chances.detection.tolist() == [0.9, 0.4]
    assert chances.false.tolist() == [0.01, 0.2]
    sure = replace(SCENE, cameras=(replace(SCENE.cameras[1], detection=1.0, false_alarm=0.0),))
    state = joint.init(sure, config, generator(0, RandomStream.TRACK, 0))
    missed = joint.pack_scan(scan(0.0, [(0, None)]), state.read_px, False)
    observation = joint.ObjectReports(missed, rows_of(missed))
    found, _ = factors(np.array([[[50.0, 50.0]]]), [observation], state, config)
    assert found[0, 0] > 0.0


def test_misses_and_detections_are_those_of_a_hidden_markov_chain() -> None:
    """One object in plain view of one camera and hidden from it, by the forward algorithm of two states."""
    config = JointConfig(detection_probability=0.9, false_alarm_probability=0.01)
    state = joint.init(SCENE, config, generator(0, RandomStream.TRACK, 0))
    missed, seen = (
        joint.pack_scan(scan(0.0, [(1, u)]), state.read_px, False) for u in (None, true_u(SCENE, (50, 50))[1])
    )
    xy, dt = np.array([[[50.0, 50.0]], [[50.0, -20.0]]]), 0.4
    a, b = 1.0 / joint.MEAN_PERCEIVABLE_S, 1.0 / joint.MEAN_UNPERCEIVABLE_S
    # Transition probabilities by many short steps
    P = np.linalg.matrix_power(
        np.array([[1.0 - a * dt / 4096, a * dt / 4096], [b * dt / 4096, 1.0 - b * dt / 4096]]), 4096
    )
    prior = np.tile([1.0 - 1e-3, 1e-3], (2, 1))
    given = np.array([[0.1, 0.99], [0.99, 0.99]])  # (position, state) likelihood of a miss
    after = prior[:, 1:].copy()
    for report in (missed, missed, missed, missed, seen, missed):
        reports = [joint.ObjectReports(report, rows_of(report))]
        before = joint.unperceivable_after(after, dt)
        visible = joint.in_plain_view(xy, reports, state.world, config)
        found, after = joint.log_factors(xy, reports, visible, before, state.world, state.chances)
        predicted = prior @ P
        np.testing.assert_allclose(before[:, 0], predicted[:, 1], rtol=1e-4)
        both = predicted * given if report is missed else predicted * [1.0, 0.0]
        if report is missed:
            np.testing.assert_allclose(np.exp(found[:, 0]), both.sum(axis=1), rtol=1e-4)
        prior = both / both.sum(axis=1, keepdims=True)
        np.testing.assert_allclose(after[:, 0], prior[:, 1], rtol=1e-4, atol=1e-12)


def test_two_cameras_that_miss_more_than_stated_keep_the_object() -> None:
    """30 % missed, 1 % stated: where one camera detects the object and the other misses it, it is not out of view."""
    config = configure(settings_of("joint").in_unit("m"), {})
    for seed in range(2):
        made = record("walk", 2, seed=700 + seed)
        parts = list(track([made.bearings], made.scene, TrackingTask(config, seed, method="joint")))
        tracks = Tracks.concat(p.tracks for p in parts)
        away = np.column_stack([tracks.x, tracks.y]) - made.xy[np.searchsorted(made.t_ns, tracks.t_ns)]
        late = tracks.t_ns - tracks.t_ns[0] > 2_000_000_000
        nees = normalised_squared_errors(away, covariances(tracks))[late]
        assert np.sqrt(np.mean(np.sum(away[late] ** 2, axis=1))) < 0.4
        assert nees.mean() < 4.0


def test_no_one_hides_sounds_from_arrays() -> None:
    config = JointConfig(detection_probability=0.9, false_alarm_probability=0.01)
    scene = Scene(arrays=(MicrophoneArray("mic", np.array([50.0, 0.0, 1.0])),), room=SCENE.room, length_unit="unit")
    state = joint.init(scene, config, generator(0, RandomStream.TRACK, 0))
    silent = joint.pack_scan(scan(0.0, [(0, None)]), state.read_px, False)
    nothing = joint.ObjectReports(silent._replace(sensor=silent.sensor[:0], first=silent.first[:1]), rows_of(silent))
    behind = np.array([[[50.0, 50.0], [50.0, 30.0]]])
    found, _ = factors(behind, [joint.ObjectReports(silent, rows_of(silent)), nothing], state, config)
    assert found.prod(axis=1) == pytest.approx(0.1)


def test_several_objects_are_followed_and_candidates_left_out() -> None:
    more = replace(SEEN, target_id=np.where(SEEN.target_id == 2, UNLABELLED, SEEN.target_id).astype(np.int32))
    tracks, _ = follow("joint", JointConfig(particles=500), bearings=more)
    assert set(tracks.target_id.tolist()) == {0, 1}
    for k in (0, 1):
        own = tracks.take(tracks.target_id == k)
        away = np.hypot(own.x - PATHS[k][:, 0], own.y - PATHS[k][:, 1])
        assert np.sqrt(np.mean(away[5:] ** 2)) < 4.0


def test_the_command_tracks_and_refuses_what_others_have(tmp_path: Path, capsys) -> None:
    (tmp_path / "scene.yaml").write_text(scene_to_yaml(SCENE), encoding="utf-8")
    write_table(tmp_path / "seen.parquet", SEEN, Provenance("detect"))
    seen, scene, out = (str(tmp_path / name) for name in ("seen.parquet", "scene.yaml", "out.parquet"))
    command = ["track", seen, "--scene", scene, "--method", "joint", "-o", out, "-q"]
    assert run([*command, "--occluders", seen]) == ExitCode.USAGE
    assert "--occluders is an option of" in capsys.readouterr().err
    for option in (["--start", "1,1"], ["--select", "greedy"]):
        assert run([*command, *option]) == ExitCode.USAGE
        (line,) = capsys.readouterr().err.splitlines()
        assert f"{option[0]} is an option of" in line
        assert "not of --method joint; leave it out, or choose one that has it" in line
        assert not Path(out).exists()
    assert run([*command, "--particles", "100"]) == ExitCode.DONE
    assert len(read_table(Path(out), Tracks)) == 3 * 40


def test_priors_of_occluders_and_a_selection_are_refused() -> None:
    tracking = TrackingTask(JointConfig(), 0, method="joint")
    with pytest.raises(UsageError, match="occluders"):
        list(track([SEEN], SCENE, tracking, [Occluders.empty()]))
    with pytest.raises(UsageError, match="select"):
        list(track([SEEN], SCENE, replace(tracking, selection=SelectConfig(policy="greedy"))))


@pytest.mark.parametrize("recordings", [1, pytest.param(4, marks=pytest.mark.statistics)])
def test_smoothed_tracks_are_nearer_to_the_truth_and_their_covariances_hold(recordings: int) -> None:
    """Of one walking person: RMSE below 0.8 of the filter's, NEES 2 within 4 standard errors."""
    options = {"filter": {}, "smooth": {"smooth": True}, "lag": {"lag_s": 3.0}}
    squares, normalised = dict.fromkeys(options, 0.0), {name: [] for name in options}
    for seed in range(recordings):
        made = record("walk", 4, seed=830 + seed)
        for name, own in options.items():
            config = configure(settings_of("joint").in_unit("m"), own)
            parts = track([made.bearings], made.scene, TrackingTask(config, 0, method="joint"))
            tracks = Tracks.concat(p.tracks for p in parts)
            away = np.column_stack([tracks.x, tracks.y]) - made.xy[np.searchsorted(made.t_ns, tracks.t_ns)]
            squares[name] += float(np.mean(away**2))
            normalised[name].append(normalised_squared_errors(away, covariances(tracks)).mean())
    for name in ("smooth", "lag"):
        assert squares[name] < 0.64 * squares["filter"]
        # 200 rows a recording, correlated over about 5
        assert abs(float(np.mean(normalised[name])) - 2.0) < 4.0 * np.sqrt(4.0 * 5.0 / (200.0 * recordings))


def test_few_effective_particles_leave_the_proposal_open() -> None:
    states, weights = np.zeros((100, 4)), np.zeros(100)
    weights[0] = 1.0
    found = joint._moments(states, weights, 0.04 * np.eye(2))
    np.testing.assert_allclose(found.covariance[:2, :2], 0.04 * np.eye(2))
    states = np.random.default_rng(0).standard_normal((100, 4))
    even = np.full(100, 0.01)
    np.testing.assert_allclose(joint._moments(states, even, 0.04 * np.eye(2)).covariance, np.cov(states.T, bias=True))
