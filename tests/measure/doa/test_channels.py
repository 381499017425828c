"""What is checked of sound: each check on clean samples, and on samples with the fault that it is for."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from occlog.measure.doa.channels import Channels, checks
from occlog.measure.doa.stage import DoaTally


def found(samples: NDArray[np.float64], rows: int = 1) -> set[str]:
    """Ids of what is found, in blocks of uneven size."""
    channels = Channels()
    for _ in channels.watch(np.array_split(samples, 7)):
        pass
    made = checks({"mic": channels}, {"mic": DoaTally(10, 4, 6)}, {"mic": rows})
    assert all(check.sensors == ("mic",) for check in made if check.found)
    return {check.id for check in made if check.found}


def sound(seed: int) -> NDArray[np.float64]:
    """(n, 4) samples of a talker with pauses, gains within 6 dB, and each microphone's own noise."""
    rng = np.random.default_rng(seed)
    talk = rng.standard_normal(16000) * (np.sin(np.arange(16000) / 1500.0) > 0.3)
    gains = 10.0 ** (rng.uniform(-6.0, 6.0, 4) / 20.0)
    return 0.1 * gains * (talk[:, None] + 0.02 * rng.standard_normal((16000, 4)))


@pytest.mark.parametrize("seed", range(10))
def test_nothing_is_found_in_clean_sound(seed: int) -> None:
    assert found(np.clip(sound(seed), -1.0, 1.0)) == set()


@pytest.mark.parametrize("seed", range(3))
def test_each_fault_is_found(seed: int) -> None:
    clean = sound(seed)
    dead = clean.copy()
    dead[:, 2] = 1e-4 * np.random.default_rng(seed).standard_normal(len(dead))
    assert found(dead) == {"microphone-silent"}
    dead[:, 2] = 0.0
    assert found(dead) == {"microphone-silent"}
    dying = clean.copy()
    dying[10_000:, 1] = 0.0
    assert found(dying) == {"microphone-interrupted"}
    similar = clean.copy()
    similar[:, 3] = similar[:, 0]
    assert found(similar) == {"microphones-identical"}
    similar[:, 3] = np.round(32768.0 * (0.8 * clean[:, 0] + 0.01)) / 32768.0
    assert found(similar) == {"microphones-identical"}
    assert found(np.clip(8.0 * clean, -1.0, 1.0)) == {"clipped"}
    assert found(clean, rows=0) == {"no-directions"}


def one_source(late: dict[int, int], seed: int = 0, noise: float = 0.05) -> np.ndarray:
    """(n, 4) samples of one source in four channels, some of them late."""
    rng = np.random.default_rng(seed)
    n = 70_000
    dry = rng.normal(size=n + 2000) * np.repeat(rng.uniform(0.05, 1.0, 36), 2000)
    own = [dry[1000 - late.get(c, 0) - c % 2 : 1000 - late.get(c, 0) - c % 2 + n] for c in range(4)]
    return np.array(own).T + rng.normal(0.0, noise, (n, 4))


def lags_of(samples: np.ndarray) -> dict[int, int]:
    square = np.array([[0.032, 0.0, 0.0], [0.0, 0.032, 0.0], [-0.032, 0.0, 0.0], [0.0, -0.032, 0.0]]) / 343.0
    channels = Channels(square, 16_000)
    for part in np.array_split(samples, 7):
        list(channels.watch([part]))
    return channels.late()


def test_late_microphones_are_named_with_their_samples() -> None:
    assert lags_of(one_source({})) == {}
    (late,) = lags_of(one_source({2: 256})).items()
    assert late[0] == 3
    assert abs(late[1] - 256) <= 2  # the sound of these channels is no plane wave
    both = lags_of(one_source({2: 300, 3: 300}))
    assert both.keys() == {3, 4}
    (early,) = lags_of(one_source({1: -100})).items()
    assert early[0] == 2
    assert abs(early[1] + 100) <= 2


def test_independent_noise_and_silence_are_not_late() -> None:
    assert lags_of(np.random.default_rng(1).normal(size=(70_000, 4))) == {}
    assert lags_of(np.zeros((70_000, 4))) == {}
    mute = one_source({})
    mute[:, 1] = 0.0
    assert lags_of(mute) == {}


SQUARE = np.array([[0.032, 0.0, 0.0], [0.0, 0.032, 0.0], [-0.032, 0.0, 0.0], [0.0, -0.032, 0.0]]) / 343.0
"""Positions in seconds of sound."""


def wave(
    azimuth_deg: float, seed: int, n: int = 40_000, positions: NDArray[np.float64] = SQUARE
) -> NDArray[np.float64]:
    """(n, M) samples of noise from one direction at 16 kHz, with noise of each microphone 26 dB below."""
    rng = np.random.default_rng(seed)
    angle = np.radians(azimuth_deg)
    delay = -positions @ [np.cos(angle), np.sin(angle), 0.0]
    spectrum, f = np.fft.rfft(rng.normal(size=n)), np.fft.rfftfreq(n, 1.0 / 16_000.0)
    own = np.array([np.fft.irfft(spectrum * np.exp(-2j * np.pi * f * tau), n) for tau in delay]).T
    return np.asarray(own + 0.05 * rng.normal(size=own.shape))


def watched(samples: NDArray[np.float64], positions: NDArray[np.float64] = SQUARE) -> Channels:
    channels = Channels(positions, 16_000)
    for part in np.array_split(samples, 5):
        list(channels.watch([part]))
    return channels


def ids_of(channels: Channels) -> list[str]:
    return [c.id for c in checks({"mic": channels}, {"mic": DoaTally(1, 0, 0)}, {"mic": 1}) if c.found]


@pytest.mark.parametrize("seed", range(4))
def test_exchanged_microphones_are_named_where_no_plane_wave_fits(seed: int) -> None:
    """Of a square, neighbours: the exchange of the other two gives the mirrored wave.  Opposite ones give a wave."""
    sound_of_one = wave(60.0 + 7.0 * seed, seed)
    assert watched(sound_of_one).misfit is None
    swapped = watched(sound_of_one[:, [1, 0, 2, 3]])
    assert swapped.misfit is not None
    assert swapped.misfit.exchanged == ((0, 1), (2, 3))
    assert swapped.misfit.samples > 0.2
    assert ids_of(swapped) == ["microphones-exchanged"]
    assert watched(sound_of_one[:, [2, 1, 0, 3]]).misfit is None


def test_exchanged_microphones_are_named_though_reflections_disturb_the_delays() -> None:
    """A reflection of half the amplitude from another direction: the delays are of no plane wave in any order."""
    disturbed = wave(60.0, 1) + 0.5 * np.roll(wave(-160.0, 1), 40, axis=0)
    assert watched(disturbed).misfit is None
    swapped = watched(disturbed[:, [1, 0, 2, 3]]).misfit
    assert swapped is not None
    assert swapped.exchanged == ((0, 1), (2, 3))


RING = 0.05 * np.array([[np.cos(a), np.sin(a), 0.0] for a in np.arange(6) * np.pi / 3.0]) / 343.0


@pytest.mark.parametrize("late", [8, -8, 11, 40])
def test_a_microphone_late_by_few_samples_is_named(late: int) -> None:
    """So few are within what the distances to some of the others permit."""
    samples = wave(20.0, 2, positions=RING)
    assert ids_of(watched(samples, RING)) == []
    samples[:, 4] = np.roll(samples[:, 4], late)
    found = watched(samples, RING)
    lags = found.late() or {n + 1: lag for n, lag in (found.misfit.late if found.misfit else {}).items()}
    assert ids_of(found) == ["microphone-late"]
    assert lags.keys() == {5}
    assert abs(lags[5] - late) <= 1


def test_a_late_microphone_of_a_square_is_one_of_those_that_explain_it() -> None:
    """A square has one equation more than unknowns, and a wave that is no slower than sound excludes some."""
    for azimuth, ids in ((60.0, ["microphone-late"]), (135.0, ["microphones-inconsistent"])):
        late = wave(azimuth, 3)
        late[:, 2] = np.roll(late[:, 2], 2)
        found = watched(late)
        assert found.misfit is not None
        assert found.misfit.late[2] == 2
        assert ids_of(found) == ids


def test_a_microphone_of_another_gain_is_noted() -> None:
    clean = wave(60.0, 3, 20_000)
    for gain in (0.2, 5.0):
        other = watched(clean * [1.0, gain, 1.0, 1.0])
        assert ids_of(other) == ["microphone-gain"]
        assert other.unequal().keys() == {2}


@pytest.mark.parametrize("seed", range(2))
def test_inverted_and_unrelated_microphones_are_named(seed: int) -> None:
    clean = wave(-130.0, seed, 30_000)  # shorter than a block
    own = watched(clean)
    assert (own.inverted(), own.unrelated()) == ([], [])
    inverted = watched(clean * [1.0, 1.0, -1.0, 1.0])
    assert (inverted.inverted(), inverted.unrelated(), inverted.misfit) == ([3], [], None)
    for other in (np.random.default_rng(9).normal(size=len(clean)), np.full(len(clean), 0.2)):
        alone = watched(np.column_stack([clean[:, :3], other]))
        assert (alone.inverted(), alone.unrelated(), alone.misfit) == ([], [4], None)


def test_a_late_microphone_of_a_short_recording_is_named() -> None:
    late = wave(60.0, 3, 20_000)
    late[:, 3] = np.roll(late[:, 3], 256)
    ((number, samples),) = watched(late).late().items()
    assert number == 4
    assert abs(samples - 256) <= 3


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("scale", "share"), [(0.5, 2.0), (1.0, None), (1.2, None), (100.0, 0.01)])
def test_delays_that_positions_and_rate_do_not_permit_are_named(seed: int, scale: float, share: float | None) -> None:
    """A file with half its sampling rate in the header gave a direction 90 degrees off, without a word."""
    channels = Channels(scale * SQUARE, 16_000)
    list(channels.watch([wave(60.0 + 7.0 * seed, seed)]))
    found = channels.slowness()
    assert found == (None if share is None else pytest.approx(share, rel=0.1))


TETRAHEDRON = 0.1 / 343.0 * np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])


def moving(
    positions: NDArray[np.float64], azimuths: NDArray[np.float64], elevations: NDArray[np.float64]
) -> np.ndarray:
    """Samples at 16 kHz of a plane wave in microphones at `positions` (M, 3) [s], from another direction each 8,192."""
    rng, parts = np.random.default_rng(0), []
    frequencies = np.fft.rfftfreq(16_384, 1.0 / 16_000)
    for azimuth, elevation in zip(azimuths, elevations, strict=True):
        along = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)])
        phase = np.exp(2j * np.pi * frequencies[:, None] * (positions @ along))
        dry = np.fft.rfft(rng.standard_normal(16_384))
        parts.append(np.fft.irfft(dry[:, None] * phase, axis=0)[4096:12_288])
    return 0.1 * np.concatenate(parts)


@pytest.mark.parametrize("microphones", [SQUARE, TETRAHEDRON], ids=["plane", "space"])
@pytest.mark.parametrize(
    ("scale", "elevations", "named"),
    [
        (2.0, np.full(24, 0.1), True),  # twice its sampling rate in the header
        (1.0, np.full(24, 0.1), False),
        (1.0, np.linspace(0.8, 1.2, 24), False),  # past an array at a ceiling
    ],
)
def test_delays_too_short_for_the_array_are_named(
    microphones: NDArray[np.float64], scale: float, elevations: NDArray[np.float64], named: bool
) -> None:
    samples = moving(microphones, np.linspace(0.3, 1.5, 24), elevations)
    channels = Channels(scale * microphones, 16_000)
    list(channels.watch([samples]))
    found = channels.slowness()
    assert found == (pytest.approx(1.0 / scale, rel=0.1) if named else None)


@pytest.mark.parametrize("ppm", [-300.0, 0.0, 150.0])
@pytest.mark.parametrize("microphones", [SQUARE, TETRAHEDRON], ids=["plane", "space"])
def test_a_channel_with_a_clock_of_its_own_is_named(microphones: NDArray[np.float64], ppm: float) -> None:
    samples = moving(microphones, np.full(24, 0.7) if ppm else np.linspace(0.3, 1.5, 24), np.full(24, 0.1))
    n = np.arange(len(samples))
    samples[:, 1] = np.interp(n * (1.0 - 1e-6 * ppm), n, samples[:, 1])
    channels = watched(samples, microphones)
    assert channels.drift() == ({2: pytest.approx(ppm, rel=0.05)} if ppm else {})
    assert ids_of(channels) == (["microphone-drifts"] if ppm else [])
