import numpy as np
import pytest

from occlog.core.geometry.camera import wrap_angle
from occlog.records.scene import MicrophoneArray, Scene
from occlog.records.tables import Doa, Truth
from occlog.simulate.config import ObserveConfig
from occlog.simulate.sensors.arrays import observe_arrays

ARRAY = MicrophoneArray("mic", np.array([5.0, 5.0, 1.0]), sigma=0.05, range=20.0)


def truth_of(places, n_targets=1):
    t, n = places.shape[:2]
    return Truth.of(
        t_ns=np.repeat(np.arange(t) * 10**9, n),
        target_id=np.tile(np.arange(n, dtype=np.int32), t),
        role=np.tile(["target"] * n_targets + ["occluder"] * (n - n_targets), t),
        x=places[..., 0].ravel(),
        y=places[..., 1].ravel(),
        z=places[..., 2].ravel(),
    )


def heard(places, config=None, n_targets=1, arrays=(ARRAY,)):
    return Doa.concat(observe_arrays(Scene(arrays=arrays), [truth_of(places, n_targets)], config or ObserveConfig(), 3))


def test_noise_and_mean_of_both_angles():
    n, place = 10_000, np.array([-3.0, 5.01, 4.0])  # near the cut at +-pi
    got = heard(np.tile(place, (n, 1, 1)))
    to = place - ARRAY.position
    azimuth = wrap_angle(got.azimuth - np.arctan2(to[1], to[0]))
    elevation = got.elevation - np.arctan2(to[2], np.hypot(to[0], to[1]))
    for error in (azimuth, elevation):
        assert abs(error.mean()) < 4 * 0.05 / np.sqrt(n)
        assert abs(error.std() / 0.05 - 1) < 4 / np.sqrt(2 * n)
    assert abs(np.corrcoef(azimuth, elevation)[0, 1]) < 4 / np.sqrt(n)
    assert (got.sigma_azimuth == 0.05).all()
    assert (got.source_id == -1).all()


def test_range_height_unknown_and_silence_of_occluders():
    positions = np.array([[[24.0, 5.0, 1.0], [6.0, 6.0, 1.0]], [[26.0, 5.0, 1.0], [6.0, 6.0, 1.0]]])
    got = heard(positions)
    assert got.t_ns.tolist() == [0]
    flat = positions.copy()
    flat[..., 2] = np.nan
    got = heard(flat, n_targets=2)
    assert got.t_ns.tolist() == [0, 0, 10**9]
    assert np.isnan(got.elevation).all()
    assert np.isnan(got.sigma_elevation).all()


def test_misses_rates_and_order():
    positions = np.tile([[10.0, 5.0, 1.0], [0.0, 5.5, 1.0], [5.0, 0.0, 1.0]], (1001, 1, 1))
    got = heard(positions, ObserveConfig(miss_probability=0.25), n_targets=3)
    assert abs(len(got) / 3003 - 0.75) < 4 * np.sqrt(0.1875 / 3003)
    assert all((np.diff(got.azimuth[got.t_ns == t]) >= 0).all() for t in np.unique(got.t_ns)[:100])
    slow = MicrophoneArray("slow", ARRAY.position, rate_hz=0.25)
    got = heard(positions, arrays=(ARRAY, slow))
    assert got.t_ns[got.sensor == "slow"].tolist() == [k * 4 * 10**9 for k in range(251)]


@pytest.mark.parametrize("n", [0, 2])
def test_no_target_no_rows(n):
    assert len(heard(np.ones((4, n, 3)), n_targets=0)) == 0
