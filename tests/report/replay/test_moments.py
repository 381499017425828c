"""What the page's script is given: the same numbers as the tables, for the times that are kept."""

from __future__ import annotations

import base64
import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from made_up import STEP_NS, ring_scene, run

from occlog.core.geometry.camera import rotation_from_angles
from occlog.records.declared.people import PeopleTracks
from occlog.records.tables import Diagnostics, Hulls, Occluders, Tracks, Truth
from occlog.report.content import downsampled as thinned
from occlog.report.content.model import ReportInput
from occlog.report.replay import steps as rule
from occlog.report.replay.build import replay
from occlog.report.replay.steps import MISSING, Words, packed, placed


def unpacked(packed: list[Any]) -> np.ndarray:
    if packed[0] == "=":
        return np.full(packed[1], float(packed[2]))
    kind, text = packed
    return np.frombuffer(base64.b64decode(text), "<" + kind).astype(float)


def report_of(data: ReportInput) -> dict[str, Any]:
    found = replay(data)
    assert found is not None
    values: dict[str, Any] = json.loads(found.json)
    return values


def columns(values: dict[str, Any], name: str) -> dict[str, np.ndarray]:
    return {key: unpacked(value) for key, value in values[name].items()}


def places(values: dict[str, Any], name: str) -> np.ndarray:
    table, centre = columns(values, name), np.mean(values["limits"], axis=0)
    return np.asarray(np.column_stack([table["x"], table["y"]]) * values["step"] + centre)


def test_places_spreads_times_and_identities_are_those_of_the_tables() -> None:
    data = run(steps=50, targets=3, cameras=4, start_ns=1_700_000_000_000_000_000)
    values, tracks = report_of(data), data.tracks
    assert tracks is not None
    np.testing.assert_allclose(unpacked(values["times"]), np.arange(50) * STEP_NS / 1e9)
    table = columns(values, "tracks")
    np.testing.assert_array_equal(table["first"], np.arange(51) * 3)
    np.testing.assert_array_equal(np.array(values["targets"])[table["target"].astype(int)], tracks.target_id)
    np.testing.assert_allclose(places(values, "tracks"), np.column_stack([tracks.x, tracks.y]), atol=values["step"])
    np.testing.assert_allclose(table["sx"] * values["sigma"], np.sqrt(tracks.cov_xx), atol=values["sigma"])
    rho = tracks.cov_xy / np.sqrt(tracks.cov_xx * tracks.cov_yy)
    np.testing.assert_allclose(table["rho"] / 127, rho, atol=0.005)
    assert data.truth is not None
    np.testing.assert_allclose(
        places(values, "truth"), np.column_stack([data.truth.x, data.truth.y]), atol=values["step"]
    )
    assert set(columns(values, "truth")["target"]) == {0, 1, 2}


def test_sight_lines_are_the_bearings_of_the_moment() -> None:
    data = run(steps=20, targets=2, cameras=3)
    values, bearings = report_of(data), data.bearings
    assert bearings is not None
    table, names = columns(values, "sight"), [s["name"] for s in values["sensors"]]
    seen = bearings.take(bearings.seen)
    assert len(table["angle"]) == len(seen)
    moment = np.searchsorted(table["first"], np.arange(len(seen)), side="right") - 1
    got = {
        (int(m), names[int(s)], int(t)): a
        for m, s, t, a in zip(moment, table["sensor"], table["target"], table["angle"], strict=True)
    }
    for k in range(len(seen)):
        angle = got[int(seen.t_ns[k]) // STEP_NS, str(seen.sensor[k]), int(seen.target_id[k])] * 2 * np.pi / 65536
        assert abs(np.angle(np.exp(1j * (angle - seen.bearing[k])))) < 1e-4


def test_sensors_that_look_at_other_times_are_shown_at_the_next_moment() -> None:
    data = run(steps=20, targets=1, cameras=2)
    bearings = data.bearings
    assert bearings is not None
    late = replace(bearings, t_ns=bearings.t_ns - STEP_NS // 3)
    assert report_of(replace(data, bearings=late))["sight"]["angle"] == report_of(data)["sight"]["angle"]


@pytest.mark.parametrize(("most", "every"), [(400, 1), (399, 2), (200, 2), (199, 3)])
def test_moments_are_thinned_by_the_rule(monkeypatch: pytest.MonkeyPatch, most: int, every: int) -> None:
    monkeypatch.setattr(thinned, "MAX_SHOWN", most)
    data = run(steps=200, targets=2, cameras=1)
    found = replay(data)
    assert found is not None
    values = json.loads(found.json)
    np.testing.assert_allclose(unpacked(values["times"]), np.arange(0, 200, every) * STEP_NS / 1e9)
    assert ("every 2-th" in found.words) == (every == 2)
    assert len(columns(values, "tracks")["x"]) == 2 * len(range(0, 200, every))


def test_sight_lines_are_thinned_by_moments_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    data = run(steps=30, targets=1, cameras=4)
    whole = report_of(data)
    rows = np.diff(columns(whole, "sight")["first"])
    monkeypatch.setattr(rule, "MAX_OBSERVATIONS", int(rows.sum()) // 3 + 1)
    values = report_of(data)
    assert values["sightEvery"] == 3
    kept = np.diff(columns(values, "sight")["first"])
    np.testing.assert_array_equal(kept, np.where(np.arange(30) % 3 == 0, rows, 0))


def test_who_saw_a_target_and_what_is_doubtful_come_from_tracks_of_everybody_or_from_the_filter() -> None:
    data = run(steps=10, targets=1, cameras=2)
    diagnostics = data.diagnostics
    assert diagnostics is not None
    reported = [c.name for c in Diagnostics.columns()]
    more = {name: getattr(diagnostics, name) for name in reported}
    more["seen_by"] = np.array(["camera 1"] * 5 + [""] * 5)
    more["n_detected"] = np.array([1] * 5 + [0] * 4 + [2])
    more["fallback"] = np.array([""] * 9 + ["restart"])
    values = report_of(replace(data, diagnostics=Diagnostics.of(**more)))
    table = columns(values, "tracks")
    seen = [values["words"]["seen"][int(k)] for k in table["seen"]]
    assert seen == ["camera 1"] * 5 + [""] * 4 + [None]
    assert [values["words"]["doubt"][int(k)] for k in table["doubt"]] == [""] * 9 + ["restart"]
    tracks = data.tracks
    assert tracks is not None
    plain = {c.name: getattr(tracks, c.name) for c in Tracks.columns()}
    people = PeopleTracks.of(
        **plain, existence_probability=np.linspace(0.1, 1, 10), seen_by=["a,b"] * 10, quality_flags=["coasting"] * 10
    )
    values = report_of(replace(data, tracks=people, errors=None))
    table = columns(values, "tracks")
    assert values["words"] == {"seen": ["a,b"], "doubt": ["coasting"]}
    np.testing.assert_allclose(table["existence"] / 254, np.linspace(0.1, 1, 10), atol=0.002)
    assert not values["compared"]
    assert min(columns(values, "truth")["target"]) >= rule.TRUE_FROM
    assert set(columns(values, "sight")["target"]) == {MISSING}


def test_true_places_are_those_of_the_tracks_that_errors_pair_them_with() -> None:
    data = run(steps=10, targets=3, cameras=2)
    tracks, errors = data.tracks, data.errors
    assert tracks is not None
    assert errors is not None
    errors = replace(errors, x=tracks.x.copy(), y=tracks.y.copy())
    own = np.array([12, 10, 11], dtype=np.int32)[tracks.target_id]
    values = report_of(replace(data, tracks=replace(tracks, target_id=own), errors=errors, diagnostics=None))
    assert values["targets"] == [10, 11, 12]
    assert values["compared"]
    # True targets 0, 1, 2 are followed by the tracks 12, 10, 11, which are the numbers 2, 0, 1
    assert columns(values, "truth")["target"].tolist() == [2, 0, 1] * 10
    assert columns(values, "tracks")["target"].tolist() == [2, 0, 1] * 10
    several = own.copy()
    several[tracks.t_ns == tracks.t_ns.max()] = [10, 12, 11]  # two exchange their names at the end
    values = report_of(replace(data, tracks=replace(tracks, target_id=several), errors=errors, diagnostics=None))
    assert not values["compared"]
    assert min(columns(values, "truth")["target"]) >= rule.TRUE_FROM


def test_moving_occluders_are_polygons_of_95_percent() -> None:
    t_ns = np.arange(10) * STEP_NS
    priors = Occluders.of(
        t_ns=t_ns,
        occluder_id=[0] * 10,
        x=[50.0] * 10,
        y=[40.0] * 10,
        cov_xx=[4.0] * 10,
        cov_xy=[1.0] * 10,
        cov_yy=[1.0] * 10,
    )
    values = report_of(run(steps=10, cameras=1, occluders=priors))
    corners = places(values, "hulls")[: rule.CORNERS] - [50, 40]
    inverse = np.linalg.inv([[4.0, 1.0], [1.0, 1.0]])
    np.testing.assert_allclose(np.einsum("ki,ij,kj->k", corners, inverse, corners), 5.991, rtol=0.02)
    empty = Hulls.of(t_ns=[0], occluder_id=[-1], corner=[0], x=[np.nan], y=[np.nan])
    assert len(columns(report_of(run(steps=10, cameras=1, occluders=empty)), "hulls")["x"]) == 0


def test_what_lies_far_outside_of_the_plan_is_marked_and_does_not_coarsen_the_rest() -> None:
    data = run(steps=300, targets=1, cameras=1)
    tracks = data.tracks
    assert tracks is not None
    x = np.where(np.arange(300) == 7, 1e9, tracks.x)
    values = report_of(replace(data, tracks=replace(tracks, x=x)))
    assert values["step"] < 0.01
    assert columns(values, "tracks")["x"][7] == 32767


def test_true_places_come_from_errors_where_there_is_no_truth() -> None:
    data = run(steps=30, targets=2, cameras=1)
    assert report_of(replace(data, truth=None))["truth"] == report_of(data)["truth"]


def test_the_largest_errors_are_named_once_each() -> None:
    data = run(steps=300, targets=1, cameras=1)
    found = replay(data)
    assert found is not None
    assert data.errors is not None
    assert found.peaks[0].error == data.errors.error.max()
    times = sorted(peak.seconds for peak in found.peaks)
    assert len(times) == 5
    assert min(np.diff(times)) > 0.05 * 29.9


def test_nothing_is_shown_of_what_does_not_move() -> None:
    assert replay(ReportInput(scene=ring_scene(2))) is None
    one = run(steps=30).truth
    assert one is not None
    assert replay(ReportInput(truth=one.take(one.t_ns == 0), scene=ring_scene(2))) is None
    assert replay(ReportInput(truth=one, scene=ring_scene(2))) is not None


def test_truth_of_many_moving_objects_is_left_to_targets() -> None:
    count = thinned.MAX_MOVING
    for others, rows in ((count, count + 1), (count + 1, 1)):
        roles = ["target"] + ["occluder"] * others
        size = len(roles)
        truth = Truth.of(
            t_ns=np.repeat([0, STEP_NS], size),
            target_id=np.tile(np.arange(size), 2),
            role=roles * 2,
            x=np.ones(2 * size),
            y=np.ones(2 * size),
            z=np.ones(2 * size),
        )
        table = columns(report_of(ReportInput(truth=truth, scene=ring_scene(1))), "truth")
        np.testing.assert_array_equal(np.diff(table["first"]), [rows, rows])


def test_numbers_that_do_not_fit_are_an_error_and_small_ones_take_little() -> None:
    for kind, values, taken in (
        ("u2", [0, 255], "u1"), ("u2", [0, 256], "u2"), ("i2", [-128, 127], "i1"), ("i2", [-129, 0], "i2"),
        ("u4", [0, 9], "u1"), ("u4", [0, 65536], "u4"), ("u2", [7, 7], "="), ("f8", [0.5, 0.25], "f8"),
    ):  # fmt: skip
        assert packed(kind, values)[0] == taken
        np.testing.assert_array_equal(unpacked(packed(kind, values)), values)
    np.testing.assert_array_equal(unpacked(packed("u2", [0, 65535])), [0, 65535])
    for kind, value in (("u2", 65536), ("u1", -1), ("i2", 0.5)):
        with pytest.raises(ValueError, match="do not fit"):
            packed(kind, [value])
    np.testing.assert_array_equal(placed(np.array([-1e9, 0.0, 1e9]), 0.0, 0.1), [-32767, 0, 32767])
    words = Words()
    assert words.all == [""]
    np.testing.assert_array_equal(words.numbers(["a", "b", "a"], np.array([True, True, False])), [0, 1, 2])
    assert words.all == ["a", "b", None]


def test_a_camera_outside_of_the_room_looks_in_through_its_walls() -> None:
    data = run(steps=20, cameras=2)
    scene = data.scene
    assert scene is not None
    inside, camera = scene.cameras
    outside = replace(camera, position=np.array([130.0, 50.0, 1.5]), rotation=rotation_from_angles(np.pi, 0.0, 0.0))
    views = [
        np.array(s["view"])
        for s in report_of(replace(data, scene=replace(scene, cameras=(inside, outside))))["sensors"]
    ]
    assert views[1][:, 0].min() < 50.0  # past the wall at 100
    assert views[0].max() <= 100.0 + 1e-6  # one inside sees no farther than its walls
