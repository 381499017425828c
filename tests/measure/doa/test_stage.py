"""Directions from sound: made-up plane waves in any pose, simulated rooms, silence, several sources."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from occlog.errors import InputError, UsageError
from occlog.measure.doa.config import ALGORITHMS, DoaConfig
from occlog.measure.doa.locate import direction
from occlog.measure.doa.stage import DoaTally, estimate_directions, frames
from occlog.records.scene import MicrophoneArray
from occlog.records.tables import Doa
from occlog.settings import SettingError

pytest.importorskip("pyroomacoustics")
RATE, C = 16000, 343.0
SQUARE = 0.04 * np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
SOLID = 0.06 * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
COARSE = DoaConfig(window_s=0.016, grid_deg=8.0)


def wave(rng: np.random.Generator, microphones: np.ndarray, u: np.ndarray, n: int, noise: float = 0.1) -> np.ndarray:
    """(n, M) white sound from a far source in direction u of the array's frame, delays exact in the spectrum."""
    spectrum = np.fft.rfft(rng.standard_normal(n))
    omega = 2 * np.pi * np.fft.rfftfreq(n, 1 / RATE)
    early = np.exp(1j * omega[:, None] * (microphones @ u) / C)
    clean = np.fft.irfft(spectrum[:, None] * early, n, axis=0)
    return 0.1 * (clean + noise * rng.standard_normal(clean.shape))


def heard(samples: np.ndarray, array: MicrophoneArray, config: DoaConfig = COARSE, start_ns: int = 0) -> Doa:
    found = list(estimate_directions([samples], RATE, array, "m", config, start_ns, DoaTally()))
    return Doa.concat(found) if found else Doa.empty()


def off(a: np.ndarray, b: float) -> np.ndarray:
    return (a - b + np.pi) % (2 * np.pi) - np.pi


@pytest.mark.parametrize(("yaw", "pitch", "roll"), [(0.0, 0.0, 0.0), (-2.5, -0.5, 0.7)])
def test_world_angles_of_an_array_in_any_pose(yaw: float, pitch: float, roll: float) -> None:
    """Far sources, white noise 20 dB down: azimuth and elevation within 1.5 degrees of the truth."""
    rng = np.random.default_rng(3)
    array = MicrophoneArray("mic", np.zeros(3), yaw=yaw, microphones=SOLID, pitch=pitch, roll=roll)
    for azimuth, elevation in ((0.4, 0.2), (-2.8, -0.3), (3.1, 0.8)):
        u = direction(np.array(azimuth), np.array(elevation)) @ array.rotation
        found = heard(wave(rng, SOLID, u, RATE), array)
        assert len(found) == 2
        assert np.degrees(np.abs(off(found.azimuth, azimuth))).max() < 1.5
        assert np.degrees(np.abs(found.elevation - elevation)).max() < 1.5
        assert (found.confidence > 0.8).all()
        assert (found.source_id == -1).all()


def test_a_flat_array_gives_the_direction_above_and_a_planar_one_no_elevation() -> None:
    rng = np.random.default_rng(4)
    array = MicrophoneArray("mic", np.zeros(3), microphones=SQUARE)
    sound = wave(rng, SQUARE, direction(np.array(1.0), np.array(-0.7)), RATE)
    found = heard(sound, array)
    assert np.allclose(found.elevation, 0.7, atol=0.05)
    assert np.allclose(found.azimuth, 1.0, atol=0.03)
    assert (found.sigma_elevation > found.sigma_azimuth).all()
    only = heard(wave(rng, SQUARE, direction(np.array(1.0), np.array(0.0)), RATE), replace(array, planar=True))
    assert np.isnan(only.elevation).all()
    assert np.isnan(only.sigma_elevation).all()
    assert np.allclose(only.azimuth, 1.0, atol=0.03)


@pytest.mark.parametrize("algorithm", sorted(ALGORITHMS))
def test_every_algorithm_finds_a_source(algorithm: str) -> None:
    rng = np.random.default_rng(5)
    array = MicrophoneArray("mic", np.zeros(3), microphones=SOLID, planar=True)
    config = replace(COARSE, algorithm=algorithm, low_hz=500.0, high_hz=2500.0)
    found = heard(wave(rng, SOLID, direction(np.array(-1.2), np.array(0.0)), RATE // 2), array, config)
    assert len(found) == 1
    assert abs(np.degrees(off(found.azimuth, -1.2))).max() < 3.0


def test_several_sources_at_once_and_their_number() -> None:
    rng = np.random.default_rng(6)
    big = 3.0 * SOLID
    array = MicrophoneArray("mic", np.zeros(3), microphones=big, planar=True)
    sound = sum(wave(rng, big, direction(np.array(a), np.array(0.0)), RATE) for a in (-1.5, 1.0))
    for sources, expected in ((1, 1), (2, 2), (0, 2)):
        found = heard(sound, array, replace(COARSE, max_sources=sources, grid_deg=3.0))
        assert len(found) == 2 * expected
        if expected == 2:
            near = np.minimum(np.abs(off(found.azimuth, -1.5)), np.abs(off(found.azimuth, 1.0)))
            assert np.degrees(near).max() < 3.0
            assert (np.diff(found.azimuth[:2]) != 0).all()


def test_silence_and_noise_give_no_rows() -> None:
    rng = np.random.default_rng(7)
    array = MicrophoneArray("mic", np.zeros(3), microphones=SQUARE)
    tally = DoaTally()
    noise = rng.standard_normal((RATE, 4))
    sound = np.concatenate([np.zeros((RATE, 4)), 0.1 * noise, 1e-6 * noise])
    assert not list(estimate_directions([sound], RATE, array, "m", COARSE, 0, tally))
    assert (tally.frames, tally.silent, tally.unsure) == (6, 4, 2)


def test_speech_in_noise_above_its_level_only() -> None:
    """Half a second of sound in four: with --min-snr only its frames are heard, at their times."""
    rng = np.random.default_rng(8)
    array = MicrophoneArray("mic", np.zeros(3), microphones=SQUARE, planar=True)
    u = direction(np.array(0.5), np.array(0.0))
    hum = wave(rng, SQUARE, direction(np.array(-2.0), np.array(0.0)), 2 * RATE) * 0.03
    hum[RATE : RATE + RATE // 2] += wave(rng, SQUARE, u, RATE // 2)
    start = 1_700_000_000_123_456_789
    found = heard(hum, array, replace(COARSE, min_snr_db=10.0), start)
    assert (found.t_ns - start).tolist() == [1_250_000_000]
    assert len(heard(hum, array, COARSE)) == 4


def test_where_blocks_are_cut_does_not_matter_and_frames_may_overlap_or_leave_gaps() -> None:
    x = np.arange(100.0)[:, None]
    for size, hop in ((10, 10), (10, 4), (10, 23)):
        expected = [(a, x[a : a + size, 0].tolist()) for a in range(0, 100 - size + 1, hop)]
        for cuts in ([100], [1] * 100, [7, 50, 43], [99, 1]):
            blocks = np.split(x, np.cumsum(cuts)[:-1])
            assert [(a, f[:, 0].tolist()) for a, f in frames(blocks, size, hop)] == expected


def test_a_moving_source_in_a_simulated_room() -> None:
    """Reverberation time 0.25 s, noise 20 dB down, 10 places on a path: RMSE of azimuth below 4 degrees.

    Errors in units of the stated standard deviation have an RMS between 0.3 and 2.
    """
    import pyroomacoustics as pra

    rng, centre = np.random.default_rng(9), np.array([2.9, 2.2, 1.3])
    material, order = pra.inverse_sabine(0.25, [6.0, 5.0, 3.0])
    parts, true = [], []
    for k in range(10):
        place = centre + np.array([1.8 * np.cos(0.5 * k), 1.5 * np.sin(0.5 * k), 0.2])
        room = pra.ShoeBox([6.0, 5.0, 3.0], fs=RATE, materials=pra.Material(material), max_order=min(order, 8))
        room.add_source(place, signal=rng.standard_normal(RATE))
        room.add_microphone_array((centre + SOLID).T)
        room.simulate()
        parts.append(room.mic_array.signals.T[RATE // 4 : RATE // 4 + RATE // 2])
        true.append(np.arctan2(place[1] - centre[1], place[0] - centre[0]))
    sound = np.concatenate(parts)
    sound = 0.1 * sound / sound.std() + 0.01 * rng.standard_normal(sound.shape)
    found = heard(sound, MicrophoneArray("mic", centre, microphones=SOLID), replace(COARSE, window_s=0.032))
    assert len(found) == 10
    errors = off(found.azimuth, 0.0) - np.array(true)
    errors = off(errors, 0.0)
    assert np.degrees(np.sqrt((errors**2).mean())) < 4.0
    assert 0.3 < np.sqrt(((errors / found.sigma_azimuth) ** 2).mean()) < 2.0


def test_arrays_and_settings_that_cannot_be() -> None:
    sound = np.zeros((RATE, 4))
    line = MicrophoneArray("mic", np.zeros(3), microphones=np.outer(np.arange(4.0), [0.1, 0.0, 0.0]))
    with pytest.raises(InputError, match="all in one line"):
        heard(sound, line)
    with pytest.raises(InputError, match="has 0 microphones"):
        heard(sound, MicrophoneArray("mic", np.zeros(3)))
    array = MicrophoneArray("mic", np.zeros(3), microphones=SQUARE)
    with pytest.raises(UsageError, match="give a wider"):
        heard(sound, array, replace(COARSE, low_hz=9000.0, high_hz=9500.0))
    with pytest.raises(UsageError, match="finds fewer sources than microphones"):
        heard(sound, array, replace(COARSE, algorithm="music", max_sources=4))
    with pytest.raises(UsageError, match=r"give .*speed.of.sound"):
        list(estimate_directions([sound], RATE, array, "unit", COARSE, 0, DoaTally()))
    for wrong in ({"low_hz": 5000.0}, {"frame_s": 0.01}, {"max_sources": 0, "algorithm": "music"}, {"grid_deg": 0.01}):
        with pytest.raises(SettingError):
            DoaConfig(**wrong)
