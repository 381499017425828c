from __future__ import annotations

import numpy as np
import pytest
from tracker_scenes import SECOND, room100, with_array

from occlog.errors import InputError
from occlog.records import UNLABELLED, Bearings, Doa
from occlog.stages.sources import bearings_of_doa, in_time

SCENE = with_array(room100(), (5.0, 5.0), sigma=0.05)


def doa(times, sigma, name="array"):
    n = len(times)
    return Doa.of(
        t_ns=[t * SECOND for t in times], sensor=[name] * n, source_id=np.arange(n, dtype=np.int32),
        azimuth=np.linspace(-3, 3, n), elevation=np.full(n, 0.2), sigma_azimuth=sigma,
        sigma_elevation=np.full(n, np.nan), confidence=np.full(n, 0.5),
    )  # fmt: skip


def rows(times, sensor):
    n = len(times)
    nothing = np.full(n, np.nan)
    return Bearings.of(
        t_ns=[t * SECOND for t in times], sensor=[sensor] * n, target_id=np.zeros(n, dtype=np.int32),
        seen=np.zeros(n, dtype=bool), bearing=nothing, sigma=nothing, u_px=nothing, sigma_px=nothing, score=nothing,
    )  # fmt: skip


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
    with pytest.raises(InputError, match="doa: row 1: the scene has no array 'other'; it has: array"):
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
    found = list(in_time(streams))
    merged = Bearings.concat(found)
    pairs = list(zip((merged.t_ns // SECOND).tolist(), merged.sensor.tolist(), strict=True))
    assert sorted(pairs) == sorted(everything)
    assert [t for t, _ in pairs] == sorted(t for t, _ in pairs)


def test_one_stream_is_passed_on_as_it_is():
    chunk = rows([3, 4], "cam1")
    assert list(in_time([[chunk]])) == [chunk]
