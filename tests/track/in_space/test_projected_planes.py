"""Projected planes selection: planes chosen, estimates combined, and a still source found."""

from __future__ import annotations

import math

import numpy as np
import pytest
from space_scenes import PLACES, SOURCE, place, room, scan

from occlog.core.bounds.in_space import plane_axes
from occlog.core.geometry.projected_planes import XY, YZ, ZX, select_as_printed
from occlog.errors import InputError
from occlog.records.scene import Camera, Scene
from occlog.scans.grouping import Scan
from occlog.track.methods.in_space import projected_planes
from occlog.track.methods.in_space.config import PpsConfig
from occlog.track.methods.in_space.planes import (
    PLANE_ROWS,
    PlanePosterior,
    choose_pair,
    combine,
    initial_errors,
    plane_angles,
    shared_axis,
)
from occlog.track.methods.in_space.sensing import pack_directions, pack_ears

pytestmark = pytest.mark.jit

NONE = np.full(3, np.nan)
THESIS = {"selection": "printed", "running": "selected", "per_plane": "best", "combining": "planes-weighted"}


def run(scene: Scene, scans, seed=0, **settings):
    rng = np.random.default_rng(seed)
    state = projected_planes.init(scene, PpsConfig(**settings), rng)
    for one in scans:
        state, estimate = projected_planes.step(state, one, rng)
    return state, estimate


def flat(rng, evidence=0.0) -> PlanePosterior:
    root = rng.standard_normal((4, 4))
    return PlanePosterior(rng.standard_normal(4), root @ root.T, evidence, 10.0)


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"combining": "equal"},
        {"combining": "planes-weighted"},
        {"running": "selected"},
        {"per_plane": "best"},
        THESIS,
    ],
)
def test_exact_directions_lead_to_the_source_without_a_start(settings) -> None:
    scene = room()
    scans = [scan(scene, 0.1 * k, [0, 1, 2]) for k in range(20)]
    _, estimate = run(scene, scans, particles=1000, initial_particle_factor=5, **settings)
    np.testing.assert_allclose(place(estimate), SOURCE, atol=0.1)
    assert (
        np.linalg.eigvalsh(
            [
                [*estimate.covariance[0], estimate.height.covariance[0]],
                [*estimate.covariance[1], estimate.height.covariance[1]],
                estimate.height.covariance,
            ]
        )[0]
        >= -1e-12
    )


def test_arrays_that_speak_in_turn_at_uneven_times_lead_there_too() -> None:
    scene = room()
    times = np.cumsum(np.random.default_rng(3).exponential(0.07, 90))
    scans = [scan(scene, t, [k % 3], labelled=False) for k, t in enumerate(times)]
    _, estimate = run(scene, scans, particles=1000, initial_particle_factor=5)
    np.testing.assert_allclose(place(estimate), SOURCE, atol=0.15)


@pytest.mark.parametrize("p", range(3))
@pytest.mark.parametrize("q", range(3))
def test_planes_are_combined_by_hand_worked_weights(p: int, q: int) -> None:
    if p == q:
        return
    rng, k = np.random.default_rng([p, q]), shared_axis(p, q)
    one, two = flat(rng, math.log(3.0)), flat(rng)
    i, j = ((0, 1), (1, 2), (2, 0))[p].index(k), ((0, 1), (1, 2), (2, 0))[q].index(k)
    both = one.mean[[i, i + 2]], two.mean[[j, j + 2]]
    precision = [1.0 / np.diag(f.covariance)[[r, r + 2]] for f, r in ((one, i), (two, j))]
    expected = {
        "equal": 0.5 * both[0] + 0.5 * both[1],
        "planes-weighted": 0.75 * both[0] + 0.25 * both[1],
        "inverse": (precision[0] * both[0] + precision[1] * both[1]) / (precision[0] + precision[1]),
    }
    errors = np.zeros((12, 12))  # of planes that have nothing in common
    errors[PLANE_ROWS[p], PLANE_ROWS[p]], errors[PLANE_ROWS[q], PLANE_ROWS[q]] = one.covariance, two.covariance
    for rule, value in expected.items():
        joined = combine((p, q), (one, two), rule, errors)
        np.testing.assert_allclose(joined.mean[[k, k + 3]], value, rtol=1e-12)
        assert np.linalg.eigvalsh(joined.covariance)[0] > -1e-12
        for n, f in ((p, one), (q, two)):
            a, b = ((0, 1), (1, 2), (2, 0))[n]
            other, row = (a, 0) if b == k else (b, 1)
            np.testing.assert_allclose(joined.mean[[other, other + 3]], f.mean[[row, row + 2]])
            assert joined.covariance[other, other] == pytest.approx(f.covariance[row, row])


def test_planes_that_know_the_same_have_the_covariance_of_that_and_not_a_smaller_one() -> None:
    rng = np.random.default_rng(0)
    root = rng.standard_normal((6, 6))
    covariance, mean = root @ root.T, rng.standard_normal(6)
    flats = [
        PlanePosterior(mean[plane_axes(p)], covariance[np.ix_(plane_axes(p), plane_axes(p))], 0.0, 10.0)
        for p in (XY, YZ, ZX)
    ]
    for p, q in ((XY, YZ), (YZ, ZX), (ZX, XY)):
        joined = combine((p, q), (flats[p], flats[q]), "inverse", initial_errors(covariance))
        np.testing.assert_allclose(joined.mean, mean, rtol=1e-12)
        np.testing.assert_allclose(joined.covariance, covariance, atol=1e-12)


def heard_at(scene: Scene, xyz):
    heard = pack_directions(
        scan(scene, 0.0, range(len(scene.arrays)), xyz=np.array(xyz)), pack_ears(scene), np.zeros(2), use_score=True
    )
    return heard, plane_angles(heard)


def test_the_planes_of_least_variance_are_chosen() -> None:
    scene = room([(0.0, 0.0, 0.0)])
    heard, angles = heard_at(scene, [3.0, 0.5, 3.0])  # nearly in the zx plane, midway between x and z
    pair = choose_pair("variance", heard, angles, NONE, projected_planes.NOTHING)
    order = np.argsort(np.where(angles.blind[0], np.inf, angles.sigma[0]))
    assert [p for _, p in pair] == order[:2].tolist()


@pytest.mark.parametrize("xyz", [[3, 3, 1], [1, 1, 3], [2, 5, -4], [0.5, 0.2, -3]])
def test_the_printed_rule_is_that_of_the_thesis(xyz) -> None:
    scene = room([(0.0, 0.0, 0.0), (8.0, 6.0, 3.0)])
    heard, angles = heard_at(scene, xyz)
    expected = select_as_printed(heard.sights.phi)
    assert choose_pair("printed", heard, angles, NONE, projected_planes.NOTHING) == tuple(map(tuple, expected.tolist()))


def test_a_plane_that_looks_along_its_normal_is_not_used() -> None:
    scene = room([(0.0, 0.0, 0.0)])
    for xyz, blind in (([0.01, 0.0, 3.0], XY), ([3.0, 0.01, 0.0], YZ), ([0.0, 3.0, 0.01], ZX)):
        heard, angles = heard_at(scene, xyz)
        assert blind not in [p for _, p in choose_pair("variance", heard, angles, NONE, projected_planes.NOTHING)]


def test_cameras_tell_of_the_xy_plane_only_and_leave_the_height() -> None:
    arrays = room(PLACES)
    cameras = tuple(
        Camera(f"c{i}", a.position, np.eye(3), np.ones(2), np.zeros(2)) for i, a in enumerate(arrays.arrays)
    )
    scene = Scene(cameras=cameras, room=arrays.room, room_height=3.0)
    scans = [scan(arrays, 0.1 * k, [0, 1, 2], elevation=False) for k in range(10)]
    state, estimate = run(scene, scans, particles=2000)
    np.testing.assert_allclose(estimate.xy, SOURCE[:2], atol=0.1)
    assert state.pair[0][1] == XY
    assert math.sqrt(estimate.height.covariance[2]) > 0.4


def test_not_seen_changes_nothing_but_time() -> None:
    scene = room()
    scans = [scan(scene, 0.1 * k, [0, 1, 2]) for k in range(10)]
    blank = scans[-1]._replace(t_ns=scans[-1].t_ns, seen=np.zeros(3, dtype=bool))
    rng = np.random.default_rng(0)
    state = projected_planes.init(scene, PpsConfig(particles=500, resampling_threshold=0.0), rng)
    for one in scans:
        state, before = projected_planes.step(state, one, rng)
    _, after = projected_planes.step(state, blank, rng)
    np.testing.assert_allclose(after.xy, before.xy, rtol=1e-9)
    assert (after.n_observing, after.n_detected, after.fallback) == (3, 0, "")


def test_scans_do_not_go_back_in_time() -> None:
    scene = room()
    with pytest.raises(ValueError, match="earlier"):
        run(scene, [scan(scene, 1.0, [0]), scan(scene, 0.5, [1])], particles=50)


@pytest.mark.parametrize(
    "wrong", [{"selection": "best"}, {"combining": "mean"}, {"turn_plane": "xz"}, {"process_noise_density": -1.0}]
)
def test_settings_of_no_meaning_are_refused(wrong) -> None:
    with pytest.raises(InputError, match=f"pps: {next(iter(wrong))} is"):
        PpsConfig(**wrong)


def test_the_same_seed_gives_the_same_track() -> None:
    scene = room()
    scans: list[Scan] = [scan(scene, 0.1 * k, [k % 3]) for k in range(12)]
    one, two = (run(scene, scans, seed=4, particles=300)[1] for _ in range(2))
    np.testing.assert_array_equal(place(one), place(two))
