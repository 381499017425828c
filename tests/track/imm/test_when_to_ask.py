from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from heard_scenes import NS, room

from occlog.errors import InputError
from occlog.scans.grouping import Scan, concat, empty_scan
from occlog.track.methods.imm import kernel as imm
from occlog.track.methods.imm.camera_requests import (
    CameraAnswer,
    RequestMemory,
    apply_answer,
    other_targets,
    requests_after_scan,
)
from occlog.track.methods.imm.config import ImmConfig
from occlog.track.methods.imm.filter import Count, ImmState, ImmStepResult, TrackPosterior
from occlog.track.methods.imm.tracks import TENTATIVE, confirmed_track, make_world, new_track

SCENE = room()
RNG = np.random.default_rng
FRESH = RequestMemory()
NOBODY = np.empty(0, dtype=np.int64)


def at(policy, *places, t_s=0.0, config=None, counts=(), observations=(), predicted=None, sigma=0.2):
    """A state of targets that stand at places, and the report of a scan."""
    config = replace(config or ImmConfig.in_unit("m"), cooperate=policy)
    world = make_world(SCENE, config)
    tracks = tuple(confirmed_track(config, k, (x, y, sigma, 0, 0, 0.1), 0, RNG(k)) for k, (x, y) in enumerate(places))
    state = ImmState(world, tracks, round(t_s * NS), len(tracks))
    beliefs = []
    for track in tracks:
        moved = new_track(world, track)
        shown = moved if predicted is None else moved._replace(predicted=moved.predicted + predicted)
        beliefs.append(TrackPosterior(track.number, shown, imm.moments(moved.predicted, moved.weights), 100.0))
    return state, ImmStepResult(tuple(beliefs), tuple(counts), concat([Scan.of(0, []), *observations]), 0.0)


def asked(state, report, memory=FRESH):
    found, memory = requests_after_scan(state, report, memory, RNG(0))
    return [(a.number, a.causes) for a in found], memory


def observation(*degrees, array=0, sigma=2.0):
    sensor, n = len(SCENE.cameras) + array, len(degrees)
    if not n:
        return empty_scan(0, [sensor])
    return Scan.of(0, [sensor] * n, bearing=np.radians(degrees), sigma=np.full(n, math.radians(sigma)))


def test_none_never_asks():
    found, _ = asked(*at("none", (5, 5), sigma=50.0, counts=[Count(0, 3, 1, NOBODY)]))
    assert found == []


@pytest.mark.jit
def test_periodic_asks_for_all_at_every_period():
    memory, times = RequestMemory(), []
    for n in range(41):
        state, report = at("periodic", (5, 5), (9, 9), t_s=0.7 * n)
        found, memory = asked(state, report, memory)
        if found:
            assert found == [(0, ("periodic",)), (1, ("periodic",))]
            times.append(0.7 * n)
    # Due at 10 and 20, met by the next scan; the clock does not drift.
    np.testing.assert_allclose(times, [10.5, 20.3])


def test_spread_asks_for_who_is_spread():
    wide, report = at("spread", (5, 5), (9, 9), sigma=0.6)
    assert asked(wide, report)[0] == []  # 0.85 m
    wide, report = at("spread", (5, 5), sigma=0.8)
    assert asked(wide, report)[0] == [(0, ("spread",))]  # 1.13 m


@pytest.mark.parametrize(("bearings", "expected"), [(2, []), (1, [0, 1]), (0, [0, 1])])
def test_equation_3_14_asks_each_time_for_those_in_range(bearings, expected):
    state, report = at("printed", (5, 5), (9, 9), counts=[Count(0, bearings, 2, NOBODY)])
    state = state._replace(world=state.world._replace(config=replace(state.world.config, triggers="count")))
    for _ in range(2):
        found, _ = asked(state, report)
        assert [n for n, _ in found] == expected
        assert all(c == ("count",) for _, c in found)


def test_more_bearings_than_targets_ask_who_is_there():
    free = np.array([1])
    state, report = at("printed", (5, 5), counts=[Count(0, 2, 1, free)], observations=[observation(45.0, 10.0)])
    state = state._replace(world=state.world._replace(config=replace(state.world.config, triggers="count")))
    found, _ = requests_after_scan(state, report, RequestMemory(), RNG(0))
    assert [a.number for a in found] == [0, TENTATIVE]
    away = found[1].position - SCENE.arrays[0].position[:2]
    assert math.degrees(math.atan2(away[1], away[0])) == pytest.approx(10.0, abs=3.0)


def test_change_of_count_asks_at_its_edges_only():
    memory, times = RequestMemory(), []
    for n, bearings in enumerate([1, 1, 2, 2, 2, 1, 1]):
        state, report = at(
            "count",
            (5, 5),
            t_s=n,
            counts=[Count(0, bearings, 1, np.arange(bearings - 1))],
            observations=[observation(45.0, 10.0)],
        )
        found, memory = asked(state, report, memory)
        times += [n] if found else []
    assert times == [2, 5]


@pytest.mark.parametrize(
    ("degrees", "expected"),
    [((45.0,), []), ((48.5,), []), ((50.0,), [(0, ("bearing",))]), ((50.0, 44.0), []), ((), [(0, ("bearing",))])],
)
def test_equation_3_15_asks_where_no_bearing_is_near(degrees, expected):
    """The target is at 45 degrees from the array; 2 sigma are 4 degrees."""
    state, report = at("printed", (6, 6), observations=[observation(*degrees)], sigma=1e-6)
    assert asked(state, report)[0] == expected


def test_equation_3_15_wraps():
    config = ImmConfig.in_unit("m")
    state, report = at("printed", (-5, 2.05), observations=[observation(-179.0)], sigma=1e-6, config=config)
    assert asked(state, report)[0] == []


def test_equation_3_15_is_not_asked_of_an_array_out_of_range():
    state, report = at("printed", (6, 6), observations=[observation(170.0)], sigma=1e-6)
    near = state.world._replace(reach=np.array([3.0, np.inf]))
    assert asked(state._replace(world=near), report)[0] == []


def test_equation_3_16_asks_where_the_estimate_is_in_no_ellipse():
    inside, report = at("printed", (6, 6), observations=[observation(45.0)], predicted=np.array([0.1, 0, 0.1, 0]))
    assert asked(inside, report)[0] == []
    outside, report = at("printed", (6, 6), observations=[observation(45.0)], predicted=np.array([1.0, 0, 1.0, 0]))
    assert asked(outside, report)[0] == [(0, ("ellipse",))]


def test_several_policies_and_causes_make_one_request():
    state, report = at("spread,printed", (6, 6), observations=[observation(90.0)], sigma=2.0)
    assert asked(state, report)[0] == [(0, ("bearing", "spread"))]


def test_a_request_in_vain_is_not_made_again_at_once():
    state, report = at("spread", (6, 6), sigma=2.0, t_s=1.0)
    question = requests_after_scan(state, report, RequestMemory(), RNG(0))[0]
    _, _, memory = apply_answer(state, report, [CameraAnswer(question[0], None, None, -1)], RequestMemory(), RNG(0))
    for t_s, expected in ((1.2, 0), (1.5, 1)):
        later, report = at("spread", (6, 6), sigma=2.0, t_s=t_s)
        assert len(asked(later, report, memory)[0]) == expected


@pytest.mark.parametrize(("fix", "tolerance"), [("replace", 0.05), ("update", 0.05)])
def test_an_answer_moves_the_cloud_and_gives_its_label(fix, tolerance):
    config = replace(ImmConfig.in_unit("m"), camera_fix=fix)
    state, report = at("spread", (6, 6), (9, 9), sigma=2.0, config=config)
    question = requests_after_scan(state, report, RequestMemory(), RNG(0))[0][0]
    answer = CameraAnswer(question, np.array([7.0, 5.0]), 1e-4 * np.eye(2), 4)
    new, reported, _ = apply_answer(state, report, [answer], RequestMemory(), RNG(0))
    track = new.tracks[0]
    assert np.hypot(*(track.cloud.states[:, ::2].mean(axis=0) - [7.0, 5.0])) < tolerance
    assert track.label == 4
    assert track.exists == 1.0
    np.testing.assert_allclose(reported.beliefs[0].estimate.mean[::2], [7.0, 5.0], atol=tolerance)
    assert new.tracks[1] is state.tracks[1]


def test_who_is_found_and_not_known_gets_a_number():
    state, report = at("count", (6, 6))
    question = requests_after_scan(state, report, RequestMemory(), RNG(0))[0]
    assert question == []
    lead = other_targets(state, report, [])
    assert lead == []
    unknown = requests_after_scan(
        *at("count", (6, 6), counts=[Count(0, 2, 1, np.array([0]))], observations=[observation(10.0)]),
        RequestMemory(),
        RNG(0),
    )
    answer = CameraAnswer(unknown[0][1], np.array([12.0, 3.0]), 1e-4 * np.eye(2), -1)
    new, _, _ = apply_answer(state, report, [answer], RequestMemory(), RNG(0))
    assert [t.number for t in new.tracks] == [0, 1]
    assert new.free == 2
    labelled, _, _ = apply_answer(state, report, [answer._replace(label=5)], RequestMemory(), RNG(0))
    assert [t.number for t in labelled.tracks] == [0, 5]
    taken, _, _ = apply_answer(state, report, [answer._replace(label=0)], RequestMemory(), RNG(0))
    assert [t.number for t in taken.tracks] == [0, 1]


def test_frames_are_shared_unless_stated_otherwise():
    state, report = at("spread", (6, 6), (9, 9), sigma=2.0)
    question = requests_after_scan(state, report, RequestMemory(), RNG(0))[0][:1]
    assert [(a.number, a.causes) for a in other_targets(state, report, question)] == [(1, ("shared",))]
    assert other_targets(state, report, []) == []
    alone = state._replace(world=state.world._replace(config=replace(state.world.config, update_other_targets=False)))
    assert other_targets(alone, report, question) == []


@pytest.mark.parametrize(
    "wrong",
    [
        {"cooperate": "often"},
        {"triggers": "bell"},
        {"triggers": ""},
        {"camera_fix": "guess"},
        {"association": "all"},
        {"start": (1.0, 2.0, 3.0)},
        {"detection_probability": 0.0},
        {"request_sigma": -1.0},
        {"period_s": 0.0},
        {"birth_probability": 1.0},
    ],
)
def test_settings_that_cannot_be_are_refused(wrong):
    with pytest.raises(InputError, match=f"imm: {next(iter(wrong))} is"):
        ImmConfig(**wrong)
