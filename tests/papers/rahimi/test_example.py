"""The example of [Rahimi]: its world, the figures of a problem, the verdicts."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

from occlog.core.geometry.camera import planar_offsets
from occlog.core.geometry.visibility import in_view
from occlog.papers import catalogue
from occlog.papers import verdicts as v
from occlog.papers.rahimi import example as sparse
from occlog.papers.rahimi import results, search
from occlog.papers.rahimi import robustness as trust
from occlog.papers.rahimi import trial as sparse_trial
from occlog.papers.rahimi.example import HALF, STEP_S, example, identified, reflected_path, sparse_scene
from occlog.papers.rahimi.trial import Solved, consistency, errors, sightings, solve_problem, sparse_spec
from occlog.papers.verdicts import PaperRow, Size
from occlog.pipeline.sweep.engine import run_all
from occlog.records.tables import Diagnostics, Tracks
from occlog.settings import configure
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.map.config import MapConfig

SMALL = Size(3, 80, quick=True)


def test_fields_of_view_do_not_overlap_and_are_in_the_room() -> None:
    scene = sparse_scene(known_range=True)
    side = np.linspace(-HALF - 1.0, HALF + 1.0, 241)
    xy = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    views = np.array([in_view(*planar_offsets(xy, c.ground, c.yaw), c.fov, c.range) for c in scene.cameras])
    assert views.sum(axis=0).max() == 1
    assert (np.abs(xy[views.any(axis=0)]) <= HALF).all()
    # A sector of 40 degrees and 3.5 m each
    assert views.mean() * (2.0 * HALF + 2.0) ** 2 == pytest.approx(math.radians(20.0) * 3.5**2, rel=0.02)


def test_without_smoothing_the_path_is_that_of_a_ball_on_a_table() -> None:
    for seed in range(5):
        path = reflected_path(120, np.random.default_rng(seed), smoothing=1e-6)
        rng = np.random.default_rng(seed)
        at, angle = rng.uniform(-HALF, HALF, 2), rng.uniform(-math.pi, math.pi)
        step = 0.25 * np.array([math.cos(angle), math.sin(angle)])
        walked = []
        for _ in range(121):
            walked.append(at.copy())
            at = at + step
            for axis in range(2):
                if abs(at[axis]) > HALF:
                    at[axis] = math.copysign(2.0 * HALF, at[axis]) - at[axis]
                    step[axis] = -step[axis]
        np.testing.assert_allclose(path, np.array(walked)[1:], atol=1e-9)  # the first place is cut off


def test_smoothed_path_keeps_speed_but_at_the_walls() -> None:
    path = reflected_path(400, np.random.default_rng(3), smoothing=1.0)
    speed = np.hypot(*np.diff(path, axis=0).T) / STEP_S
    assert speed.max() <= 0.5 + 1e-9
    assert np.median(speed) == pytest.approx(0.5, abs=1e-3)
    assert (np.abs(path) < HALF).all()
    assert (np.abs(reflected_path(400, np.random.default_rng(3))) < HALF).all()
    assert speed.min() < 0.45


def test_measurements_have_the_stated_noise() -> None:
    residuals = []
    for n in range(10):
        problem = example(0, n, 200)
        at = sightings(problem.bearings, problem.truth.t_ns)
        away = np.column_stack([problem.truth.x, problem.truth.y])[at.state] - at.position
        d, h = np.sum(away * at.axis, axis=1), at.axis[:, 0] * away[:, 1] - at.axis[:, 1] * away[:, 0]
        assert (np.hypot(d, h) <= 3.5).all()
        residuals.append(at.reading - h / d)
    found = np.concatenate(residuals)
    n = len(found)
    assert abs(found.mean()) < 4.0 * 0.01 / math.sqrt(n)
    assert found.std() == pytest.approx(0.01, rel=4.0 / math.sqrt(2.0 * n))


def test_false_bearings_are_added_to_the_same_problem() -> None:
    clean, few, more = (example(0, 1, 200, false=f).bearings for f in (0.0, 0.1, 0.3))
    assert (clean.seen == few.seen).all()
    changed = [clean.seen & (b.u_px != clean.u_px) for b in (few, more)]
    seen = int(clean.seen.sum())
    for share, which in zip((0.1, 0.3), changed, strict=True):
        assert which.sum() / seen == pytest.approx(share, abs=4.0 * math.sqrt(share * (1 - share) / seen))
    assert changed[1][changed[0]].all()
    np.testing.assert_array_equal(few.u_px[changed[0]], more.u_px[changed[0]])
    assert np.abs(more.u_px[changed[1]]).max() <= 100.0 * math.tan(math.radians(20.0))
    for camera in sparse_scene(known_range=True).cameras:
        rows = changed[1] & (more.sensor == camera.name)
        np.testing.assert_allclose(camera.u_px(more.bearing[rows]), more.u_px[rows], atol=1e-9)


def test_longer_steps_see_more_of_a_turn() -> None:
    """Within a turn the disturbances of single steps go together, so that more is gathered in a longer step."""
    short, long = identified(0, 4.0)[0], identified(0, 8.0)[0]
    assert 1.15 * short < long < 0.3
    assert identified(1, 8.0)[0] == pytest.approx(long, rel=0.25)


def test_problems_are_solved_as_the_command_does() -> None:
    spec = sparse_spec(SMALL, 1, fit_step_s=8.0)
    solved = solve_problem(spec)
    config = configure(MapConfig.in_unit("m"), spec["track"])
    found = list(
        track([solved.problem.bearings], sparse_scene(known_range=False), TrackingTask(config, 0, method="map"))
    )
    tracks = Tracks.concat(p.tracks for p in found)
    np.testing.assert_array_equal(tracks.x, solved.tracks.x)
    np.testing.assert_array_equal(tracks.cov_xy, solved.tracks.cov_xy)
    assert len(solved.iterates) == found[0].solves[0].iterations + 1
    np.testing.assert_array_equal(solved.iterates[-1], solved.xy)


def made_up(T: int, rng: np.random.Generator, scale: float = 1.0) -> Solved:
    """A problem whose estimate is off by Gaussian errors of a covariance that is right for scale 1."""
    problem = example(0, 0, T)
    factor = np.array([[0.1, 0.0], [0.06, 0.05]])
    P = factor @ factor.T
    xy = np.column_stack([problem.truth.x, problem.truth.y]) + scale * rng.standard_normal((T, 2)) @ factor.T
    full = np.full(T, 1.0)
    tracks = Tracks.of(
        t_ns=problem.truth.t_ns,
        target_id=problem.truth.target_id,
        x=xy[:, 0],
        y=xy[:, 1],
        vx=full,
        vy=full,
        cov_xx=P[0, 0] * full,
        cov_xy=P[0, 1] * full,
        cov_yy=P[1, 1] * full,
    )
    diagnostics = Diagnostics.empty()
    columns = {c.name: getattr(diagnostics, c.name) for c in Diagnostics.columns()}
    del columns["fallback"]
    flags = np.where(np.arange(T) < T // 4, "unobservable", "")
    reported = functools.partial(Diagnostics.of, t_ns=tracks.t_ns, target_id=tracks.target_id, fallback=flags)
    count, nothing = np.ones(T, dtype=np.int32), np.full(T, np.nan)
    diagnostics = reported(
        ess=nothing,
        log_likelihood=nothing,
        n_observing=count,
        n_detected=count,
        cameras=np.full(T, ""),
        n_available=count,
        selected=np.full(T, ""),
        predicted_mse=nothing,
    )
    return Solved(problem, tracks, diagnostics, (xy,), 0, converged=True)


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_consistency_of_right_and_wrong_covariances(scale: float) -> None:
    solved = made_up(4000, np.random.default_rng(8), scale)
    found = consistency(solved, sightings(solved.problem.bearings, solved.tracks.t_ns))
    # chi-square with 2 degrees of freedom: standard deviation 2; 3000 unflagged times
    assert found["unflagged"] == 0.75
    assert found["nees"] == pytest.approx(2.0 * scale**2, abs=4.0 * 2.0 * scale**2 / math.sqrt(3000))
    assert 0.7 < found["known"] <= 0.75


def test_errors_of_parts() -> None:
    solved = made_up(200, np.random.default_rng(1))
    at = sightings(solved.problem.bearings, solved.tracks.t_ns)
    found = errors(solved, at)
    e2 = np.sum((solved.xy - solved.true_xy) ** 2, axis=1)
    seen = {int(s) for s in at.state}
    between = [t for t in range(min(seen), max(seen)) if t not in seen]
    beyond = [t for t in range(200) if t < min(seen) or t > max(seen)]
    assert found["rmse"] == pytest.approx(math.sqrt(e2.mean()))
    assert found["seen"] == pytest.approx(math.sqrt(e2[sorted(seen)].mean()))
    assert found["between"] == pytest.approx(math.sqrt(e2[between].mean()))
    assert math.isnan(found["beyond"]) if not beyond else found["beyond"] == pytest.approx(math.sqrt(e2[beyond].mean()))
    assert found["ends"] == pytest.approx(math.sqrt(np.r_[e2[:20], e2[180:]].mean()))
    assert found["part_3"] == pytest.approx(math.sqrt(e2[60:80].mean()))


def test_settled_and_median() -> None:
    assert search.settled([1.0, 0.5, 0.05, 0.2, 0.02, 0.0]) == 4
    assert search.settled([1.0, 1.0]) == 0
    assert results.median_of([3.0, 1.0, 2.0])[0] == 2.0
    # 68 % interval of the median of 10,000 normal variables: 1.2533 / 100 to each side
    values = np.random.default_rng(0).standard_normal(10_000).tolist()
    assert results.median_of(values)[1] == pytest.approx(0.0125, rel=0.1)


def test_constraints_hold() -> None:
    table = results.fig5(SMALL, lambda specs: run_all(specs, run=sparse_trial.sparse_trial))
    held = v.series(table, results.WITH)
    assert len(held) == 3
    assert all(r.extra["behind"] == 0.0 and r.extra["converged"] == 1.0 for r in held)
    verdicts = {x.id: x for x in results.judge5(table)}
    assert verdicts["fig5-front"].verdict == v.REPRODUCED
    behind = sum(r.extra["behind"] > 0 for r in v.series(table, results.WITHOUT))
    assert verdicts["fig5-behind"].measured == behind / 3


@pytest.mark.statistics
def test_small_refinement() -> None:
    table = search.fig3(SMALL, lambda specs: run_all(specs, run=sparse_trial.sparse_trial))
    verdicts = {x.id: x for x in search.judge3(table)}
    assert verdicts["fig3-start"].verdict == v.REPRODUCED
    assert verdicts["fig3-converges"].measured == 1.0
    assert all(r.mean == 1.0 for r in table if r.x == 0)
    ray = [r.mean for r in v.series(table, search.RAY)]
    assert ray[-1] < 0.1
    counts = [solve_problem(sparse_spec(SMALL, n)).iterates for n in range(3)]
    assert verdicts["fig3-iterations"].measured == pytest.approx(sum(len(c) - 1 for c in counts) / 3)


def test_false_bearings_are_judged_by_what_they_add() -> None:
    clean = PaperRow(trust.SQUARE, 0.0, (1.0, 2.0, 3.0))
    worse = PaperRow(trust.SQUARE, 10.0, (1.5, 3.0, 4.5))
    robust = PaperRow(trust.CAUCHY, 10.0, (1.1, 2.2, 3.3))
    linear = PaperRow(trust.LINEAR, 10.0, (2.1, 3.2, 4.4))
    found = {x.id: x for x in trust.judge_false([clean, worse, robust, linear])}
    assert found["false-square"].verdict == v.NOT
    assert found["false-square"].measured == pytest.approx(0.5)
    assert found["false-cauchy"].verdict == v.REPRODUCED
    assert found["false-cauchy"].error_bar == pytest.approx(0.0, abs=1e-12)
    assert found["false-start"].verdict == v.REPRODUCED


def test_a_covariance_with_a_large_error_bar_is_not_decided() -> None:
    good = PaperRow(trust.KNOWN, 8.0, tuple(np.linspace(1.0, 3.0, 50).tolist()))
    tail = PaperRow(trust.HESSIAN, math.nan, (*[2.0] * 49, 500.0))
    found = {x.id: x for x in trust.judge_covariance([good, tail])}
    assert found["covariance-mode-hessian-distances-known-8s"].verdict == v.REPRODUCED
    assert found["covariance-mode-hessian-8s"].verdict == v.UNDECIDED


def test_experiments_are_listed_in_order_with_their_pictures() -> None:
    chosen = catalogue.choose("rahimi", [], everything=True)
    assert [e.item for e in chosen] == ["equations", "fig3", "fig4", "fig5", "fig7", "false", "covariance"]
    assert all((e.runs, e.steps) == (50, 200) for e in chosen if e.item not in ("equations", "fig7"))
    assert [list(e.plans) for e in chosen] == [[], ["iterations"], ["problems"], ["constraints"], [], [], []]


def test_pictures_show_the_refinement() -> None:
    plan = search.iterations_plan(SMALL)
    assert plan.panels[0].title == "iteration 0"
    assert plan.panels[-1].title.endswith("the last one")
    assert len(plan.panels) <= 6
    off = [np.hypot(*(p.estimates[0].xy - p.truth).T).mean() for p in plan.panels]
    assert off[-1] < 0.5 * off[0]
    assert plan.scene is sparse.sparse_scene(known_range=True)
