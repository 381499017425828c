"""Measurements of distances in a trajectory's cost: terms, the record that holds them, where a search begins."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.filtering.likelihood.distances import (
    DIFFERENCE,
    LOGARITHM,
    RANGE,
    RangeMeasurements,
    log_likelihood,
    no_measurements,
)
from occlog.records.scene import MicrophoneArray, Scene
from occlog.scans.grouping import Scan, ScanMeasurements
from occlog.track.methods.map import lines_and_distances as mixed
from occlog.track.methods.map.config import MapConfig
from occlog.track.methods.map.kernels.interior_point import covariance
from occlog.track.methods.map.kernels.problem import TrajectoryProblem
from occlog.track.methods.map.lines_and_distances import local, mixed_search, terms
from occlog.track.methods.map.method import METHOD
from occlog.track.methods.map.record import after, fill, join, record_of
from occlog.track.methods.map.search.problem_of_record import begin, problem_of
from occlog.track.methods.map.search.start import ConsensusPath
from occlog.track.methods.map.search.window_modes import ClimbScale, WindowMeasurements, _climbed, mode_starts

NS = 1_000_000_000
PLACES = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 8.0]])


def ranges(xy: np.ndarray, sigma: float = 0.05, kind: int = RANGE) -> RangeMeasurements:
    value = np.hypot(*(xy - PLACES).T)
    blank = np.zeros(3)
    return RangeMeasurements(
        np.full(3, kind), value, np.full(3, sigma), PLACES, blank, np.roll(PLACES, 1, axis=0), blank, np.arange(3)
    )


def scans(path: np.ndarray, step_ns: int = NS) -> list[Scan]:
    zero = np.zeros(3, dtype=np.int32)
    return [Scan.of(k * step_ns, [])._replace(measured=ScanMeasurements(zero, ranges(xy))) for k, xy in enumerate(path)]


@pytest.mark.parametrize("kind", [RANGE, LOGARITHM, DIFFERENCE])
def test_the_slope_of_a_term_is_that_of_the_negative_log_likelihood(kind: int) -> None:
    rows = ranges(np.array([4.0, 3.0]), 0.7, kind)
    X = np.array([[3.0, 0.0, 5.0, 0.0]])
    found = terms(rows, np.zeros(3, dtype=np.int64), X, square=False)
    step = 1e-6 * np.eye(2)
    slope = [(log_likelihood(rows, X[:, ::2] - d) - log_likelihood(rows, X[:, ::2] + d))[0] / 2e-6 for d in step]
    np.testing.assert_allclose(found.slope.sum(axis=0), slope, rtol=1e-5, atol=1e-7)
    assert (found.bend[:, 0] * found.bend[:, 2] - found.bend[:, 1] ** 2 >= -1e-12).all()


def test_a_record_is_joined_cut_and_filled_with_its_measurements() -> None:
    path = np.column_stack([np.arange(1.0, 7.0), np.full(6, 3.0)])
    whole = join(record_of(scans(path)[:2]), record_of(scans(path)[2:]))
    assert whole.measured_state.tolist() == np.repeat(np.arange(6), 3).tolist()
    later = after(whole, 4)
    assert later.measured_state.tolist() == [0, 0, 0, 1, 1, 1]
    np.testing.assert_allclose(later.measured.value[:3], np.hypot(*(path[4] - PLACES).T))
    filled = fill(whole, 0.5)
    assert len(filled.t_ns) == 11
    assert filled.measured_state.tolist() == np.repeat(np.arange(0, 11, 2), 3).tolist()


@pytest.mark.jit
def test_a_search_begins_near_the_path_although_ranges_fit_other_places_at_first() -> None:
    room = np.array([[-10.0, -10.0], [20.0, -10.0], [20.0, 20.0], [-10.0, 20.0]])
    scene = Scene(arrays=tuple(MicrophoneArray(f"s{i}", np.append(p, 0.0)) for i, p in enumerate(PLACES)), room=room)
    path = np.column_stack([np.linspace(2, 7, 30), np.linspace(5, 2, 30)])
    given = scans(path)
    # Two stations alone see it for the first ten times: two places fit, then the third one decides
    both, zero = np.arange(2), np.zeros(2, dtype=np.int32)
    blind = [s._replace(measured=ScanMeasurements(zero, s.measured.distances.take(both))) for s in given[:10]]
    record = record_of([*blind, *given[10:]])
    pending = begin(scene, MapConfig())
    found = local(record.measured, pending.origin)
    X = mode_starts(problem_of(pending, record), record, pending, found)[0].X
    assert np.hypot(*(X[:, ::2] + pending.origin - path).T).max() < 0.2


CORNERS = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0]])


def walk(seed: int, *, late: float, stated: float, n: int = 60) -> tuple[list[Scan], np.ndarray]:
    """Scans of ranges at 5 Hz, noise of 0.1 m, detours of 2 m, and the path; `stated`: what is stated of detours."""
    rng, zero = np.random.default_rng([seed, 5]), np.zeros(4, dtype=np.int32)
    turn = 0.25 * 0.2 * np.arange(n)[:, None] + rng.uniform(0.0, 6.0, 2)
    path = np.array([5.0, 4.0]) + [3.0, 2.0] * np.sin(turn)
    exact = np.hypot(*(path[:, None] - CORNERS).transpose(2, 0, 1))
    by = 0.1 * rng.standard_normal(exact.shape)
    by += np.where(rng.random(exact.shape) < late, rng.exponential(2.0, exact.shape), 0.0)
    blank, own = np.zeros(4), np.full(4, RANGE)
    rows = [
        RangeMeasurements(own, z, np.full(4, 0.1), CORNERS, blank, CORNERS, blank, np.arange(4), late=stated)
        for z in exact + by
    ]
    return [
        Scan.of(round(0.2 * k * NS), [])._replace(measured=ScanMeasurements(zero, row)) for k, row in enumerate(rows)
    ], path


def solved(given: list[Scan]) -> tuple[np.ndarray, np.ndarray]:
    """The trajectory (T, 2) and its covariances (T, 2, 2)."""
    arrays = tuple(MicrophoneArray(f"s{i}", np.append(p, 0.0)) for i, p in enumerate(CORNERS))
    room = np.array([[-5.0, -5.0], [15.0, -5.0], [15.0, 13.0], [-5.0, 13.0]])
    pending = begin(Scene(arrays=arrays, room=room), MapConfig(process_noise_velocity=0.3, sigma_initial_velocity=0.7))
    X = mixed_search(pending, record_of(given), (), None).mode
    return X.solution.X[:, ::2] + pending.origin, covariance(X.problem, X.solution.X)[:, ::2, ::2]


@pytest.mark.jit
@pytest.mark.parametrize(("late", "better"), [(0.5, 0.92), (0.0, 1.06)])
def test_late_signals_that_are_expected_do_less_harm_and_none_where_there_are_none(late: float, better: float) -> None:
    figures = []
    for reported in (0.0, 0.05):
        squares, nees = [], []
        for seed in range(3):
            given, path = walk(seed, late=late, stated=reported)
            xy, spread = solved(given)
            away = xy - path
            squares.append((away**2).sum(axis=1).mean())
            nees.append(np.einsum("ni,nij,nj->n", away, np.linalg.inv(spread), away).mean())
        figures.append((np.sqrt(np.mean(squares)), np.mean(nees)))
    (rmse, nees), (expected_rmse, expected_nees) = figures
    assert expected_rmse < better * rmse
    assert expected_nees < better * nees
    assert expected_nees < 3.0


@pytest.mark.jit
def test_a_path_that_the_filter_lost_is_found_again(monkeypatch: pytest.MonkeyPatch) -> None:
    given, path = walk(3, late=0.1, stated=0.05)

    def loss_count(problem: TrajectoryProblem, *_: object) -> list[ConsensusPath]:
        X = np.zeros((len(path), 4))
        X[:, ::2] = path - np.array([5.0, 4.0])
        X[35:, ::2] += np.linspace(0.0, 4.0, len(path) - 35)[:, None] * [0.8, -0.6]
        return [ConsensusPath(X, np.ones(0, dtype=np.bool_), 0.0)]

    monkeypatch.setattr(mixed, "mode_starts", loss_count)
    found, _ = solved(given)
    assert np.hypot(*(found - path).T).max() < 0.4


@pytest.mark.jit
def test_of_a_camera_and_a_range_station_the_room_tells_the_two_crossings_apart(tmp_path: Path) -> None:
    """Each line of sight crosses the circle of a range twice; the mirrored path leaves the room later on."""
    (tmp_path / "s.yaml").write_text(
        "occlog_scene: 1\nroom: [[-0.5, -0.5], [12.5, -0.5], [12.5, 11.5], [-0.5, 11.5]]\n"
        "cameras: [{name: cam, position: [0, 0], yaw_deg: 42, focal_px: 600, fov_deg: 100}]\n"
        "readers: [{name: st, position: [6, 10.5, 0]}]\n"
    )
    t = np.arange(0.0, 30.0, 0.2)
    squares, nees = [], []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        ends = rng.uniform([1.5, 1.5], [10.5, 9.5], (2, 2))
        while np.linalg.norm(ends[1] - ends[0]) < 4.0:
            ends[1] = rng.uniform([1.5, 1.5], [10.5, 9.5])
        xy = ends[0] + (ends[1] - ends[0]) * t[:, None] / 30.0
        bearing = np.arctan2(xy[:, 1], xy[:, 0]) + 0.005 * rng.standard_normal(len(t))
        distance = np.hypot(*(xy - [6.0, 10.5]).T) + 0.15 * rng.standard_normal(len(t))
        columns = {
            "b": ("time,sensor,target_id,bearing_rad,sigma_rad", "cam,0", bearing, 0.005),
            "r": ("time,sensor,range_m,sigma_range_m", "st", distance, 0.15),
        }
        for name, (head, sensor, values, sigma) in columns.items():
            kept = np.flatnonzero(rng.random(len(t)) > 0.3)
            rows = [f"{t[k]:.1f},{sensor},{values[k]},{sigma}" for k in kept]
            (tmp_path / f"{name}.csv").write_text("\n".join([head, *rows]) + "\n")
        truth = [f"{s:.1f},0,{x},{y}" for s, (x, y) in zip(t, xy, strict=True)]
        (tmp_path / "truth.csv").write_text("\n".join(["time,target_id,x,y", *truth]) + "\n")
        at = {name: str(tmp_path / name) for name in ("b.csv", "r.csv", "s.yaml", "truth.csv", "t.parquet", "e.json")}
        given = [at["b.csv"], "--measurements", at["r.csv"], "--scene", at["s.yaml"], "--method", "map"]
        assert run(["track", *given, "-o", at["t.parquet"], "--overwrite", "-q"]) == ExitCode.DONE
        made = [at["t.parquet"], "--truth", at["truth.csv"], "-o", at["e.json"], "--overwrite", "-q"]
        assert run(["evaluate", *made]) == ExitCode.DONE
        found = json.loads((tmp_path / "e.json").read_text())
        squares.append(found["rmse_m"] ** 2)
        nees.append(found["nees_mean"])
    # The mirrored path is 5 to 9 m off; crossings are nearly tangent for much of the time
    assert np.sqrt(np.mean(squares)) < 0.8
    assert np.mean(nees) < 3.5


@pytest.mark.jit
def test_states_without_any_measurement_that_are_left_of_a_lag_follow_the_motion() -> None:
    """Ranges end, and a camera goes on that does not see the target."""
    room = np.array([[-10.0, -10.0], [20.0, -10.0], [20.0, 20.0], [-10.0, 20.0]])
    scene = Scene(arrays=tuple(MicrophoneArray(f"s{i}", np.append(p, 0.0)) for i, p in enumerate(PLACES)), room=room)
    path = np.column_stack([np.linspace(2.0, 4.0, 12), np.linspace(5.0, 4.0, 12)])
    given = scans(path)
    none = [
        s._replace(measured=ScanMeasurements(np.zeros(0, dtype=np.int32), s.measured.distances.take(np.arange(0))))
        for s in given
    ]
    pending, first = METHOD.advance(METHOD.begin(scene, MapConfig(lag_s=1.0), False), given[:4], False)
    pending, second = METHOD.advance(pending, none[4:8], False)
    pending, third = METHOD.advance(pending, none[8:], True)
    xy = np.concatenate([first.xy, second.xy, third.xy])
    assert len(xy) == 12
    # At constant velocity, which is known to 0.1 m/s after 3 s
    assert np.hypot(*(xy - path).T).max() < 1.5


def test_modes_that_climb_into_a_camera_have_a_regular_hessian() -> None:
    """Lines of sight outweigh the prior beyond rounding there: without the ridge one of these starts is singular."""
    none, both = np.zeros(0, dtype=np.int64), np.zeros(2, dtype=np.int64)
    lines = np.array(
        [
            [0.0, 0.0, 0.8299268624598489, 0.557872210248504, 2.3e-5, 0.0],
            [0.0, 0.0, 0.8245220826911754, 0.5658297757759011, 2.3e-5, 0.0],
        ]
    )
    seconds = (np.array([-0.3, 0.3]), np.zeros(0))
    rows = WindowMeasurements(lines, no_measurements(3.7), (both, none), seconds, both[:1], 0.1)
    for k in range(1, 200):
        start = 10.0 ** (-k / 12) * np.array([[0.83, 0.56]])
        found = _climbed(rows, ClimbScale(0.3, 1.0, 10.0, None), both[:1], start)
        assert np.isfinite(found.cost).all()
