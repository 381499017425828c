"""True paths to what stations measure of them: ranges, differences of ranges, strengths of signals.

True paths to the reads that readers of radio tags report.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.core.geometry.path_loss import received_power
from occlog.core.numerics.interpolate import SensorFrames, TimeGrid, frames_at
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.records.declared.sensors import Measurements
from occlog.records.scene import Scene, TagReader
from occlog.records.tables import Reads, Truth
from occlog.settings import METRES
from occlog.simulate.config import MeasureConfig, ReadConfig
from occlog.simulate.world.scripted_paths import truth_grid


@dataclass
class SimulatedReader:
    """A tag reader with its own random generators, and the shadowing of each tag at its last read.

    `noise` is the generator of strengths, `chance` of which tags are read, `shadow` of the shadowing; `levels` [dB]
    by tag at the time `last_ns` [ns].
    """

    reader: TagReader
    noise: np.random.Generator  # of the strengths
    chance: np.random.Generator  # of which tags are read
    shadow: np.random.Generator  # of the shadowing
    levels: dict[int, float] = field(default_factory=dict)  # by tag [dB]
    last_ns: int = 0

    def shadowing(self, t_ns: Ints, ids: Ints, config: ReadConfig) -> Floats:
        """Draw the shadowing (T, n) [dB] of n tags at T times, and keep the last for the next chunk.

        Stationary Ornstein-Uhlenbeck processes; a new tag begins with the stationary distribution.

        Args:
            t_ns: (T,) increasing times [ns].
            ids: (n,) numbers of the tags.
            config: standard deviation and correlation time.
        """
        normals = self.shadow.standard_normal((len(t_ns), len(ids)))
        level = np.array([self.levels.get(i, np.nan) for i in ids.tolist()])
        out = np.empty(normals.shape)
        for k, now in enumerate(t_ns.tolist()):
            decay = np.exp(-(now - self.last_ns) / NS / config.shadow_s)
            carried = decay * level + config.shadow_db * np.sqrt(1.0 - decay**2) * normals[k]
            # A tag that is new begins with the stationary distribution
            level = np.where(np.isnan(level), config.shadow_db * normals[k], carried)
            out[k], self.last_ns = level, now
        self.levels = dict(zip(ids.tolist(), level.tolist(), strict=True))
        return out


def observe_readers(
    scene: Scene, truth_chunks: Iterable[Truth | TimeGrid], config: ReadConfig, seed: int
) -> Iterator[Reads]:
    """Simulate the reads of the targets' tags by the readers of a scene; a tag has the number of its target.

    A reader reads at its own rate, or at every step. It reads a tag within its `range` on the floor with the
    probability `read_detection_probability` and others with `read_false_alarm_probability`; where the scene states
    no range, any tag with `read_detection_probability`. Signals below `min_rssi_dbm` are not read. The strength
    follows from the distance in space; a target of unknown height carries its tag on the floor. Walls and people
    have no effect but the shadowing, which is independent for each reader and tag.

    Args:
        scene: scene with the readers.
        truth_chunks: true paths, in the order of time, as tables or grids.
        config: path loss and probabilities.
        seed: seed of all random numbers; each reader has its own.

    Returns:
        Generator of one table per chunk.
    """
    reading = [
        SimulatedReader(
            reader,
            noise=generator(seed, RandomStream.READER_NOISE, i),
            chance=generator(seed, RandomStream.READER_CHANCE, i),
            shadow=generator(seed, RandomStream.READER_SHADOW, i),
        )
        for i, reader in enumerate(scene.readers)
    ]
    metre = 1.0 / METRES.get(scene.length_unit, 1.0)
    for grid, found in frames_at(map(truth_grid, truth_chunks), [r.reader.rate_hz for r in reading]):
        columns = np.flatnonzero(grid.target)
        yield Reads.merge(
            [
                _read(own, frames, frames.xyz[:, columns], grid.ids[columns], metre, config)
                for own, frames in zip(reading, found, strict=True)
            ]
        )


def _read(
    own: SimulatedReader, frames: SensorFrames, xyz: Floats, ids: Ints, metre: float, config: ReadConfig
) -> Reads:
    """Simulate one reader's rows for a block of T times.

    Args:
        own: reader with its random generators.
        frames: its T times.
        xyz: (T, n, 3) positions of the targets at these times; NaN: absent.
        ids: (n,) their numbers.
        metre: length of a metre in scene units.
        config: path loss and probabilities.
    """
    reader, shape = own.reader, xyz.shape[:2]
    noise, chance = own.noise.standard_normal(shape), own.chance.random(shape)
    shadow = own.shadowing(frames.t_ns, ids, config)
    to = xyz - reader.position
    # Range, on the floor
    floor = np.hypot(to[..., 0], to[..., 1])
    there = np.isfinite(floor)
    likely = np.where(
        np.where(there, floor, np.inf) <= reader.range,
        config.read_detection_probability,
        config.read_false_alarm_probability,
    )
    read: Bools = there & (chance < likely)
    # Strength: path loss with the distance in space, shadowing, noise
    up = np.where(np.isnan(xyz[..., 2]), 0.0, xyz[..., 2]) - reader.position[2]
    power = config.power if reader.power is None else reader.power
    distance = np.where(there, np.hypot(floor, up), 1.0) / metre
    rssi = received_power(power, config.path_loss_exponent, distance) + shadow + config.noise_db * noise
    if config.min_rssi_dbm is not None:
        read &= rssi >= config.min_rssi_dbm
    step, column = np.nonzero(read)
    return Reads.of(
        t_ns=frames.t_ns[step],
        sensor=np.full(len(step), reader.name),
        tag=ids[column].astype(str),
        target_id=ids[column].astype(np.int32),
        rssi=rssi[read],
    )


class Station(NamedTuple):
    """A sensor at a known position (3,) that measures ranges, range differences or signal strengths, with generators.

    `noise` is that of the measurements, `chance` of misses, outliers and non-line-of-sight signals; `signal` has
    the shadowing of each target.
    """

    name: str
    position: Floats  # (3,)
    noise: np.random.Generator  # of ranges, differences, strengths
    chance: np.random.Generator  # of misses, false readings and detours
    signal: SimulatedReader  # the shadowing of each target


def stations_of(scene: Scene, seed: int) -> list[Station]:
    """Stations of a scene: cameras with a pose, then arrays, in scene order, with their random generators.

    Tag readers are simulated by `observe_readers`.
    """
    named = [(c.name, c.position) for c in scene.cameras if c.placed] + [(a.name, a.position) for a in scene.arrays]
    return [
        Station(
            name,
            np.asarray(position, dtype=np.float64),
            noise=generator(seed, RandomStream.STATION_NOISE, i),
            chance=generator(seed, RandomStream.STATION_CHANCE, i),
            signal=SimulatedReader(
                TagReader(name, position),
                noise=generator(seed, RandomStream.STATION_NOISE, i, 1),
                chance=generator(seed, RandomStream.STATION_CHANCE, i, 1),
                shadow=generator(seed, RandomStream.STATION_SHADOW, i),
            ),
        )
        for i, (name, position) in enumerate(named)
    ]


def observe_stations(
    scene: Scene, truth_chunks: Iterable[Truth | TimeGrid], config: MeasureConfig, radio: ReadConfig, seed: int
) -> Iterator[Measurements]:
    """Simulate ranges, range differences and signal strengths between the stations of a scene and the targets.

    Distances are in space; a target of unknown height is on the floor. A difference is that of each station but the
    first to the first. Walls and people have no effect; non-line-of-sight signals have the probability
    `nlos_probability`.

    Args:
        scene: cameras and arrays are the stations.
        truth_chunks: true paths, in the order of time, as tables or grids.
        config: measured quantities and their noise.
        radio: path loss and shadowing of strengths.
        seed: seed of all random numbers; each station has its own.

    Returns:
        Generator of one table per chunk.
    """
    stations = stations_of(scene, seed)
    metre = 1.0 / METRES.get(scene.length_unit, 1.0)
    positions = np.array([s.position for s in stations])
    corners = np.concatenate([scene.surroundings, positions[:, :2]])
    reach = float(np.hypot(*np.ptp(corners, axis=0)))
    for grid, (frames,) in frames_at(map(truth_grid, truth_chunks), [config.measure_rate_hz]):
        columns = np.flatnonzero(grid.target)
        xyz = frames.xyz[:, columns]
        ids = grid.ids[columns]
        parts = []
        for n, own in enumerate(stations):
            reference = (stations[0].name, positions[0] if "difference" in config.kinds and n else None)
            parts.append(_measured(own, reference, frames, xyz, ids, reach, metre, config, radio))
        yield Measurements.merge(parts)


def _measured(
    own: Station,
    reference: tuple[str, Floats | None],
    frames: SensorFrames,
    xyz: Floats,
    ids: Ints,
    reach: float,
    metre: float,
    config: MeasureConfig,
    radio: ReadConfig,
) -> Measurements:
    """Simulate one station's rows for a block of T times.

    Args:
        own: station with its random generators.
        reference: name of the first station, and its position (3,); None: no difference to it is measured.
        frames: T times.
        xyz: (T, n, 3) positions of the targets at these times; NaN: absent.
        ids: (n,) their numbers.
        reach: largest distance in the scene, up to which outliers of ranges are drawn.
        metre: length of a metre in scene units.
        config: measured quantities and their noise.
        radio: path loss and shadowing.
    """
    shape = xyz.shape[:2]
    there: Bools = np.isfinite(xyz[..., 0])
    distance = _distance(xyz, own.position)
    # The same random numbers are drawn whatever is measured, so that a kind more changes no other
    noise, chance = own.noise.standard_normal((*shape, 3)), own.chance.random((*shape, 10))
    shadow = own.signal.shadowing(frames.t_ns, ids, radio)
    detours = -config.nlos_bias * np.log1p(-chance[..., 6:8]) * (chance[..., 8:10] < config.nlos_probability)
    missing = np.full(shape, np.nan)
    range_, difference, rssi = missing, missing, missing
    first, position = reference
    if "range" in config.kinds:
        true = distance + config.range_noise * noise[..., 0] + detours[..., 0]
        range_ = np.where(
            chance[..., 0] < config.measure_outlier_probability, reach * chance[..., 1], np.maximum(true, 0.0)
        )
    if position is not None:
        longer = detours[..., 0] - detours[..., 1]
        true = distance - _distance(xyz, position) + config.range_difference_noise * noise[..., 1] + longer
        base = float(np.linalg.norm(own.position - position))
        difference = np.where(
            chance[..., 2] < config.measure_outlier_probability, base * (2.0 * chance[..., 3] - 1.0), true
        )
    if "strength" in config.kinds:
        true = received_power(radio.power, radio.path_loss_exponent, np.where(there, distance, 1.0) / metre) + shadow
        near, far = received_power(
            radio.power, radio.path_loss_exponent, np.array([1.0, max(reach / metre, 1.0)])
        ).tolist()
        rssi = np.where(
            chance[..., 4] < config.measure_outlier_probability,
            far + (near - far) * chance[..., 5],
            true + radio.noise_db * noise[..., 2],
        )
    values = np.stack([range_, difference, rssi])
    lost = own.chance.random((3, *shape)) < config.measure_miss_probability
    values[lost | ~there] = np.nan
    step, column = np.nonzero(np.isfinite(values).any(axis=0))
    ranged, differs, strength = values[:, step, column]
    return Measurements.of(
        t_ns=frames.t_ns[step],
        sensor=np.full(len(step), own.name),
        target_id=ids[column].astype(np.int32),
        range=ranged,
        sigma_range=np.where(np.isfinite(ranged), config.range_noise, np.nan),
        rssi=strength,
        sigma_rssi=np.full(len(step), np.nan),
        reference=np.where(np.isfinite(differs), first, ""),
        range_difference=differs,
        sigma_range_difference=np.where(np.isfinite(differs), config.range_difference_noise, np.nan),
    )


def _distance(xyz: Floats, position: Floats) -> Floats:
    """(T, n) distances in space of positions `xyz` (T, n, 3) from a station at `position` (3,).

    Targets without a height (NaN) are on the floor.
    """
    up = np.where(np.isnan(xyz[..., 2]), 0.0, xyz[..., 2]) - position[2]
    return np.asarray(np.sqrt((xyz[..., 0] - position[0]) ** 2 + (xyz[..., 1] - position[1]) ** 2 + up**2))
