"""True paths to the directions of arrival that microphone arrays report.

When sources sound, and which of them a microphone array cannot distinguish.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.camera import wrap_angle
from occlog.core.numerics.interpolate import SensorFrames, TimeGrid, frames_at
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.errors import InputError
from occlog.records.scene import MicrophoneArray, Scene
from occlog.records.tables import UNLABELLED, Doa, Truth
from occlog.simulate.config import ObserveConfig, SoundConfig
from occlog.simulate.world.scripted_paths import truth_grid

BLOCK = 1_000_000
"""Pairs of sources that are compared at a time."""
PAIRS = 32
"""Durations of sound and silence drawn at a time for each source."""


class Sounding:
    """Intervals in which sound sources are active, scripted and random; the same for all arrays."""

    def __init__(self, silent: Mapping[int, Ints], means: tuple[float, float] | None, start_ns: int, seed: int) -> None:
        """Set the scripted and the random silence of sources.

        Args:
            silent: by object number, (k, 2) scripted silent intervals, from and to [ns].
            means: mean durations of sound and silence [s]; None: no random silence.
            start_ns: start of the simulation [ns].
            seed: seed of the random silence.
        """
        self._silent, self._means, self._start, self._seed = dict(silent), means, start_ns, seed
        self._changes: dict[int, SoundChanges] = {}

    def at(self, t_ns: Ints, ids: Ints) -> Bools:
        """(T, n) mask of the sources `ids` (n,) that sound at each of the increasing times `t_ns` (T,) [ns]."""
        out = np.ones((len(t_ns), len(ids)), dtype=np.bool_)
        for column, number in enumerate(ids.tolist()):
            for low, high in self._silent.get(number, ()):
                out[:, column] &= (t_ns < low) | (t_ns >= high)
            if self._means is not None and len(t_ns):
                if number not in self._changes:
                    rng = generator(self._seed, RandomStream.SILENCE, number)
                    self._changes[number] = SoundChanges(self._means, self._start, rng)
                out[:, column] &= self._changes[number].sounding(t_ns)
        return out


class SoundChanges:
    """Random on/off switching times of one source, drawn on demand; durations are exponential, in turn."""

    def __init__(self, means: tuple[float, float], start_ns: int, rng: np.random.Generator) -> None:
        sounds = rng.random() * sum(means) < means[0]
        self._first = bool(sounds)
        self._means = np.array(means if sounds else means[::-1])
        self._rng = rng
        self._times = np.zeros(1)  # of the start, and of the changes [s]
        self._start = start_ns

    def sounding(self, t_ns: Ints) -> Bools:
        """(T,) mask of the increasing times `t_ns` (T,) [ns] at which the source sounds."""
        seconds = (t_ns - self._start) * 1e-9
        while self._times[-1] <= seconds[-1]:
            lengths = (self._rng.standard_exponential((PAIRS, 2)) * self._means).ravel()
            self._times = np.concatenate([self._times, self._times[-1] + np.cumsum(lengths)])
        passed = np.searchsorted(self._times[1:], seconds, side="right")
        return np.asarray((passed % 2 == 0) == self._first)


def merge_near(to: Floats, known: Bools, heard: Bools, resolution: float, planar: bool) -> tuple[Floats, Bools, Bools]:
    """Merge sources that an array cannot resolve.

    Sources nearer to each other than the resolution are one, and so are all that are linked by such pairs (single
    linkage). Their direction is the mean of their unit vectors: they are taken to be of equal power. "Nearer" is
    along the arc, or in azimuth where the array is planar or the height of one of the two is unknown. The first of
    them represents all.

    Args:
        to: (T, n, 3) vectors from the array to n sources at T times, z 0 where unknown.
        known: (T, n) mask of sources with a known height.
        heard: (T, n) mask of sources that are heard at all.
        resolution: angle [rad], > 0.
        planar: whether the array measures azimuths only.

    Returns:
        (T, n, 3) vectors, a unit vector where several sources are merged; (T, n) whether all heights of merged
        sources are known; (T, n) mask of the sources that are heard and represent their group.
    """
    size = max(1, BLOCK // to.shape[1] ** 2)
    blocks = [slice(k, k + size) for k in range(0, len(to), size)]
    merged = [_merge(to[b], known[b], heard[b], resolution, planar) for b in blocks]
    if not merged:
        return to, known, heard
    positions, heights, stands = zip(*merged, strict=True)
    return np.concatenate(positions), np.concatenate(heights), np.concatenate(stands)


def _merge(to: Floats, known: Bools, heard: Bools, resolution: float, planar: bool) -> tuple[Floats, Bools, Bools]:
    """Merge sources that an array cannot resolve, at T times in one block: those linked by pairs that are too near.

    Args:
        to: (T, n, 3) vectors from the array to n sources.
        known: (T, n) mask of sources with a known height.
        heard: (T, n) mask of sources that are heard.
        resolution: angle below which two sources are merged [rad]; in azimuth unless both heights are known.
        planar: whether the array measures azimuths only.

    Returns:
        (T, n, 3) vectors, the mean direction for merged sources; (T, n) whether all heights of the merged sources are
        known; (T, n) mask of the first of each group, which represents it.
    """
    flat = planar | ~(known[:, :, None] & known[:, None, :])
    ground = _unit(np.concatenate([to[..., :2], np.zeros_like(to[..., :1])], axis=-1))
    units = ground if planar else _unit(to)
    chord = np.where(flat, _distances(ground), _distances(units))
    near = (chord < 2.0 * np.sin(0.5 * min(resolution, np.pi))) & heard[:, :, None] & heard[:, None, :]
    linked = near | np.eye(to.shape[1], dtype=np.bool_)
    for _ in range(max(1, math.ceil(math.log2(max(to.shape[1], 2))))):
        linked = np.matmul(linked.astype(np.float32), linked.astype(np.float32)) > 0.5
    stands = heard & (linked.argmax(axis=-1) == np.arange(to.shape[1]))
    several = stands & (linked.sum(axis=-1) > 1)
    all_known = ~(linked & ~known[:, None, :]).any(axis=-1)
    flat_total, total = (
        np.einsum("tij,tjk->tik", linked.astype(np.float64), np.where(heard[..., None], u, 0.0))
        for u in (ground, units)
    )
    total = np.where(all_known[..., None], total, flat_total)
    clear = np.linalg.norm(total, axis=-1) > 1e-9  # opposite directions have no mean: the first is kept
    return np.where((several & clear)[..., None], _unit(total), to), all_known, stands


def _unit(vectors: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    out: Floats = vectors / np.where(length > 0, length, 1.0)
    return out


def _distances(units: Floats) -> Floats:
    """Return (T, n, n) chord distances between unit vectors (T, n, 3); NaN where a vector is NaN."""
    return np.asarray(np.linalg.norm(units[:, :, None] - units[:, None, :], axis=-1))


PLAIN = SoundConfig()


class SimulatedArray(NamedTuple):
    """A microphone array with its own random generators.

    `noise` is that of the directions, `chance` of misses, `false_numbers` and `false_positions` of false directions.
    """

    array: MicrophoneArray
    noise: np.random.Generator  # of the directions
    chance: np.random.Generator  # of misses
    false_numbers: np.random.Generator  # how many false directions there are
    false_positions: np.random.Generator  # where they are


def observe_arrays(
    scene: Scene,
    truth_chunks: Iterable[Truth | TimeGrid],
    config: ObserveConfig,
    seed: int,
    sound: SoundConfig = PLAIN,
    silent: Mapping[int, Ints] | None = None,
) -> Iterator[Doa]:
    """Simulate the directions of arrival from every target that each microphone array hears.

    Sounding targets are of equal strength; sound needs no time and goes past occluders and walls; the moving
    occluders are silent. Azimuth and elevation about the array's own axes carry independent Gaussian noise and are
    converted to angles in the world. A planar array measures no elevation, nor does any of a target of unknown
    height (z NaN). Targets nearer to each other than the array's resolution are heard as one (`merge_near`): its
    noise, and whether it is missed, are those of the first of them. A target that is out of range (in space),
    silent or missed has no row.

    Args:
        scene: scene with the arrays.
        truth_chunks: true paths, in the order of time, as tables or grids.
        config: its probability of a miss is used.
        seed: seed of all random numbers; each array has its own.
        sound: random silence, false directions, labels.
        silent: scripted silence of targets: (k, 2) times from and to [ns]; None: none.

    Returns:
        Generator of one table per chunk; InputError for a tilted array that is planar or hears a target of unknown
        height, since its angles do not determine those of the world.
    """
    listening = [_simulated_array(a, i, seed) for i, a in enumerate(scene.arrays)]
    sounding: Sounding | None = None
    for grid, found in frames_at(map(truth_grid, truth_chunks), [s.array.rate_hz for s in listening]):
        columns = np.flatnonzero(grid.target)
        sounding = sounding or Sounding(silent or {}, sound.sound_and_silence_s, int(grid.t_ns[0]), seed)
        parts = []
        for sensor, frames in zip(listening, found, strict=True):
            sounds = sounding.at(frames.t_ns, grid.ids[columns])
            parts.append(
                _report(sensor, frames, columns, ids=grid.ids, sounds=sounds, miss=config.miss_probability, sound=sound)
            )
        yield Doa.merge(parts)


def _simulated_array(array: MicrophoneArray, number: int, seed: int) -> SimulatedArray:
    """Microphone array with its own random generators; InputError if it is planar and tilted.

    `number` is its index in the scene.
    """
    if array.planar and not _vertical(array):
        raise InputError(
            f"microphone array {array.name} is planar and tilted, so that it measures no azimuth in the world; "
            "set pitch_deg and roll_deg to 0 or planar to false",
            id="not-applicable",
        )
    return SimulatedArray(
        array=array,
        noise=generator(seed, RandomStream.ARRAY_NOISE, number),
        chance=generator(seed, RandomStream.ARRAY_CHANCE, number),
        false_numbers=generator(seed, RandomStream.ARRAY_FALSE, number, 0),
        false_positions=generator(seed, RandomStream.ARRAY_FALSE, number, 1),
    )


def _vertical(array: MicrophoneArray) -> bool:
    """Whether the array's z axis is vertical, so that noise in its own angles equals noise in world angles."""
    return abs(abs(float(array.rotation[2, 2])) - 1.0) < 1e-12


def _report(
    sensor: SimulatedArray,
    frames: SensorFrames,
    columns: NDArray[np.intp],
    ids: Ints,
    sounds: Bools,
    miss: float,
    sound: SoundConfig,
) -> Doa:
    """Simulate the rows of one array for a block of T times.

    Args:
        sensor: array with its random generators.
        frames: T times with the positions of all objects.
        columns: (n,) indices of the targets among the objects.
        ids: numbers of all objects.
        sounds: (T, n) mask of targets that make a sound.
        miss: probability that a direction is not reported.
        sound: settings of false directions, and whether rows have the number of their target.
    """
    array = sensor.array
    shape = (len(frames.t_ns), len(columns))
    noise = sensor.noise.standard_normal((*shape, 2))
    chance = sensor.chance.random(shape)
    to = frames.xyz[:, columns] - array.position
    # Range, in space where the height is known
    known = ~np.isnan(to[..., 2])
    to[..., 2] = np.where(known, to[..., 2], 0.0)
    with np.errstate(invalid="ignore"):
        heard = sounds & (np.hypot(np.hypot(to[..., 0], to[..., 1]), to[..., 2]) <= array.range)
    _check_heights(array, known, heard)
    # Resolution: sources that are near each other are heard as one
    if array.resolution > 0 and len(columns) > 1:
        to, known, heard = merge_near(to=to, known=known, heard=heard, resolution=array.resolution, planar=array.planar)
    # Miss
    heard &= chance >= miss
    # Measure: azimuth and polar angle about the array's own axes, each with its noise
    azimuth, elevation = _noisy(array, to[heard], noise[heard])
    elevation[~known[heard] | array.planar] = np.nan
    t_ns, source = np.repeat(frames.t_ns, len(columns)), np.tile(ids[columns], len(frames.t_ns))
    if not sound.label_doa:
        source = np.full(len(source), UNLABELLED)
    # Add directions without a source
    real = (t_ns[heard.ravel()], source[heard.ravel()], azimuth, elevation)
    false = _false(sensor, frames.t_ns, sound)
    return _rows(array, *(np.concatenate(pair) for pair in zip(real, false, strict=True)))


def _check_heights(array: MicrophoneArray, known: Bools, heard: Bools) -> None:
    """InputError if a tilted array hears a target of unknown height.

    `known` and `heard` are masks (T, n) of times and targets.
    """
    if (heard & ~known).any() and not _vertical(array):
        raise InputError(
            f"microphone array {array.name} is tilted and hears a target of unknown height; give "
            "targets a z, or set pitch_deg and roll_deg to 0",
            id="missing-value",
        )


def _noisy(array: MicrophoneArray, to: Floats, noise: Floats) -> tuple[Floats, Floats]:
    """World azimuths and elevations (m,) [rad] of directions, with noise on the array's own two angles.

    Directions that the noise moves beyond a pole continue on its other side.

    Args:
        array: array with its standard deviations.
        to: (m, 3) vectors to the sources in the world, of any length.
        noise: (m, 2) standard normal numbers.
    """
    sigma_elevation = array.sigma if array.sigma_elevation is None else array.sigma_elevation
    vertical = _vertical(array)
    own = to if vertical else to @ array.rotation
    azimuth = np.arctan2(own[:, 1], own[:, 0]) + array.sigma * noise[:, 0]
    elevation = np.arctan2(own[:, 2], np.hypot(own[:, 0], own[:, 1])) + sigma_elevation * noise[:, 1]
    over = np.abs(elevation) > 0.5 * np.pi
    azimuth[over & (np.cos(elevation) < 0)] += np.pi
    elevation[over] = np.arcsin(np.sin(elevation[over]))
    if vertical:
        return azimuth, elevation
    flat = np.cos(elevation)
    world = np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)]) @ array.rotation.T
    return np.arctan2(world[:, 1], world[:, 0]), np.arctan2(world[:, 2], np.hypot(world[:, 0], world[:, 1]))


def _false(sensor: SimulatedArray, t_ns: Ints, sound: SoundConfig) -> tuple[Ints, Ints, Floats, Floats]:
    """Draw false directions of an array: Poisson distributed in number, uniform over all directions.

    Args:
        sensor: array with its random generators.
        t_ns: (m,) times of the measurements [ns].
        sound: gives the rate of false directions.

    Returns:
        (n,) columns: times [ns], labels `UNLABELLED`, azimuths and elevations [rad]; elevations are NaN for a planar
        array, and where heights are unknown.
    """
    period_s = 1.0 / sensor.array.rate_hz if sensor.array.rate_hz else sound.step_s
    numbers = sensor.false_numbers.poisson(sound.false_alarm_rate * period_s, len(t_ns))
    positions = sensor.false_positions.random((int(numbers.sum()), 2))
    elevation = np.arcsin(2.0 * positions[:, 1] - 1.0)
    if sensor.array.planar or not sound.known_heights:
        elevation = np.full(len(positions), np.nan)
    return (
        np.repeat(t_ns, numbers),
        np.full(len(positions), UNLABELLED),
        np.pi * (2.0 * positions[:, 0] - 1.0),
        elevation,
    )


def _rows(array: MicrophoneArray, t_ns: Ints, source: Ints, azimuth: Floats, elevation: Floats) -> Doa:
    """Create the table of an array's measurements, sorted by time and azimuth.

    Args:
        array: array with name and standard deviations.
        t_ns: (n,) times [ns].
        source: (n,) labels of the sources, `UNLABELLED` for none.
        azimuth: (n,) azimuths in the world [rad].
        elevation: (n,) elevations in the world [rad]; NaN: not measured.
    """
    n = len(t_ns)
    azimuth = wrap_angle(azimuth)
    order = np.lexsort((azimuth, t_ns))  # by direction, so that the order does not give targets away
    t_ns, source, azimuth, elevation = t_ns[order], source[order], azimuth[order], elevation[order]
    sigma_elevation = array.sigma if array.sigma_elevation is None else array.sigma_elevation
    return Doa.of(
        t_ns=t_ns,
        sensor=np.full(n, array.name),
        source_id=source.astype(np.int32),
        azimuth=azimuth,
        elevation=elevation,
        sigma_azimuth=np.full(n, array.sigma),
        sigma_elevation=np.where(np.isnan(elevation), np.nan, sigma_elevation),
        confidence=np.full(n, np.nan),
    )
