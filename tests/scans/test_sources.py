from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tracker_scenes import SECOND, room100, with_array

from occlog.errors import InputError
from occlog.records.tables import UNLABELLED, Bearings, Doa
from occlog.scans.sources import bearings_of_doa, round_robin, within_times

SCENE = with_array(room100(), (5.0, 5.0), sigma=0.05)


def doa(times, sigma, name="array"):
    n = len(times)
    return Doa.of(
        t_ns=[t * SECOND for t in times],
        sensor=[name] * n,
        source_id=np.arange(n, dtype=np.int32),
        azimuth=np.linspace(-3, 3, n),
        elevation=np.full(n, 0.2),
        sigma_azimuth=sigma,
        sigma_elevation=np.full(n, np.nan),
        confidence=np.full(n, 0.5),
    )


def rows(times, sensor):
    n = len(times)
    nothing = np.full(n, np.nan)
    return Bearings.of(
        t_ns=[t * SECOND for t in times],
        sensor=[sensor] * n,
        target_id=np.zeros(n, dtype=np.int32),
        seen=np.zeros(n, dtype=bool),
        bearing=nothing,
        sigma=nothing,
        u_px=nothing,
        sigma_px=nothing,
        score=nothing,
    )


def test_directions_of_arrival_become_candidates():
    (found,) = bearings_of_doa([doa([0, 0, 1], [0.1, np.nan, 0.2])], SCENE)
    assert set(found.target_id.tolist()) == {UNLABELLED}
    np.testing.assert_array_equal(found.bearing, [-3.0, 0.0, 3.0])
    np.testing.assert_array_equal(found.sigma, [0.1, 0.05, 0.2])  # the array's own where none is given
    np.testing.assert_array_equal(found.score, 0.5)
    assert np.isnan(found.u_px).all()
    assert found.seen.all()


def test_an_array_that_the_scene_does_not_have_is_refused():
    chunks = [doa([0], [0.1]), doa([1, 2], [0.1, 0.1], name="other")]
    with pytest.raises(InputError, match="doa: row 1: the scene has no microphone array 'other'; it has: array"):
        list(bearings_of_doa(chunks, SCENE))


@pytest.mark.parametrize("seed", range(6))
def test_streams_are_merged_in_the_order_of_time_however_they_are_cut(seed):
    rng = np.random.default_rng(seed)
    streams, everything = [], []
    for name in ("cam1", "cam2", "array"):
        times = np.sort(rng.integers(0, 30, rng.integers(0, 40))).tolist()
        everything += [(t, name) for t in times]
        cuts = sorted(rng.integers(0, len(times) + 1, 3).tolist())
        bounds = list(zip([0, *cuts], [*cuts, len(times)], strict=True))
        streams.append([rows(times[a:b], name) for a, b in bounds])
    found = list(within_times(streams))
    merged = Bearings.concat(found)
    pairs = list(zip((merged.t_ns // SECOND).tolist(), merged.sensor.tolist(), strict=True))
    assert sorted(pairs) == sorted(everything)
    assert [t for t, _ in pairs] == sorted(t for t, _ in pairs)


def test_one_stream_is_passed_on_as_it_is():
    chunk = rows([3, 4], "cam1")
    assert list(within_times([[chunk]])) == [chunk]


def test_identities_of_the_log_are_those_of_targets_where_that_is_reported():
    log = doa([0, 0, 1], [0.1, np.nan, 0.2])
    log = replace(log, source_id=np.array([4, UNLABELLED, 7], dtype=np.int32))
    (found,) = bearings_of_doa([log], SCENE, labels=True)
    assert found.target_id.tolist() == [4, UNLABELLED, 7]  # who has no identity may be anybody
    (candidates,) = bearings_of_doa([log], SCENE)
    assert set(candidates.target_id.tolist()) == {UNLABELLED}
    np.testing.assert_array_equal(found.bearing, candidates.bearing)


def test_labels_of_a_log_without_identities_are_refused():
    log = replace(doa([0, 1], [0.1, 0.1]), source_id=np.full(2, UNLABELLED, dtype=np.int32))
    with pytest.raises(InputError, match="doa: none of 4 directions has an identity"):
        list(bearings_of_doa([log, log], SCENE, labels=True))


def of_three():
    """A row a second of cam1, cam2 and cam3, from 10 s to 21 s; cam2 alone speaks at 10 s."""
    parts = [rows([t for t in range(10, 22) if t > 10 or name == "cam2"], name) for name in ("cam1", "cam2", "cam3")]
    return Bearings.merge(parts)


def spoken(chunks):
    table = Bearings.concat(list(chunks))
    return list(zip((table.t_ns // SECOND).tolist(), table.sensor.tolist(), strict=True))


def test_sensors_have_turns_in_their_order_from_the_first_row_on():
    found = spoken(round_robin([of_three()], ["cam1", "cam2", "cam3"], 2.0))
    want = [
        (11, "cam1"),
        (12, "cam2"),
        (13, "cam2"),
        (14, "cam3"),
        (15, "cam3"),
        (16, "cam1"),
        (17, "cam1"),
        (18, "cam2"),
        (19, "cam2"),
        (20, "cam3"),
        (21, "cam3"),
    ]
    assert found == want  # the first turn, cam1's, is from 10 s to 12 s, whoever speaks first


def test_turns_begin_with_the_first_row_of_the_sensors_that_have_them():
    found = spoken(round_robin([of_three()], ["cam3", "cam1"], 3.0))
    assert found == [
        (11, "cam3"),
        (12, "cam3"),
        (13, "cam3"),
        (14, "cam1"),
        (15, "cam1"),
        (16, "cam1"),
        (17, "cam3"),
        (18, "cam3"),
        (19, "cam3"),
        (20, "cam1"),
        (21, "cam1"),
    ]
    assert spoken(round_robin([of_three()], ["cam2"], 3.0)) == [(t, "cam2") for t in range(10, 22)]
    assert spoken(round_robin([of_three()], ["cam9"], 3.0)) == []


@given(
    cuts=st.lists(st.integers(0, 34), max_size=5),
    seconds=st.floats(0.3, 15.0),
    names=st.permutations(["cam1", "cam2", "cam3"]),
)
def test_turns_do_not_depend_on_where_chunks_are_cut(cuts, seconds, names):
    whole = of_three()
    bounds = [0, *sorted(cuts), len(whole)]
    parts = [whole.take(slice(a, b)) for a, b in pairwise(bounds)]
    found = spoken(round_robin(parts, names, seconds))
    assert found == spoken(round_robin([whole], names, seconds))
    turn_ns = round(seconds * 1e9)
    want = [(t, s) for t, s in spoken([whole]) if names[(t - 10) * SECOND // turn_ns % 3] == s]  # one row at a time
    assert found == want
