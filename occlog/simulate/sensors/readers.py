"""True paths to the reads that readers of radio tags report."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.core.numerics.seeds import Stage, generator
from occlog.core.numerics.time_grid import Grid, SensorFrames, looks
from occlog.core.sight.path_loss import received_power
from occlog.records.scene import Reader, Scene
from occlog.records.tables import Reads, Truth
from occlog.settings import METRES
from occlog.simulate.config import ReadConfig
from occlog.simulate.world.truth_grid import truth_grid


@dataclass
class SimulatedReader:
    """A reader with its own random numbers, and the shadowing of each tag at its last look."""

    reader: Reader
    noise: np.random.Generator  # of the strengths
    chance: np.random.Generator  # of which tags are read
    shadow: np.random.Generator  # of the shadowing
    levels: dict[int, float] = field(default_factory=dict)  # by tag [dB]
    last_ns: int = 0

    def shadowing(self, t_ns: Ints, ids: Ints, config: ReadConfig) -> Floats:
        """Draw the (T, n) shadowing [dB] of n tags at T times: stationary Ornstein-Uhlenbeck processes."""
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
    scene: Scene, truth_chunks: Iterable[Truth | Grid], config: ReadConfig, seed: int
) -> Iterator[Reads]:
    """Simulate what the readers of a scene read of the targets, each of which carries a tag of its number.

    A reader looks at its own rate, or at every step.  It reads a tag within its `range` on the floor with the
    probability `detection` and others with `stray`; where the scene says no range, any tag with `detection`.
    Signals below `weakest` are not read.  The strength is that of the distance in space; a target whose height is
    not known is taken to carry its tag on the floor.  Walls and people do not weaken it but by the shadowing, which
    is of each reader and tag.

    Args:
        scene: the readers.
        truth_chunks: true paths, in time order, as tables or grids.
        config: path loss and probabilities.
        seed: of all random numbers; each reader has its own.

    Returns:
        One table for every chunk.
    """
    reading = [
        SimulatedReader(
            reader,
            noise=generator(seed, Stage.READER_NOISE, i),
            chance=generator(seed, Stage.READER_CHANCE, i),
            shadow=generator(seed, Stage.READER_SHADOW, i),
        )
        for i, reader in enumerate(scene.readers)
    ]
    metre = 1.0 / METRES.get(scene.length_unit, 1.0)
    for grid, found in looks(map(truth_grid, truth_chunks), [r.reader.rate_hz for r in reading]):
        columns = np.flatnonzero(grid.target)
        yield Reads.merge(
            [
                _read(own, look, look.xyz[:, columns], grid.ids[columns], metre, config)
                for own, look in zip(reading, found, strict=True)
            ]
        )


def _read(own: SimulatedReader, look: SensorFrames, xyz: Floats, ids: Ints, metre: float, config: ReadConfig) -> Reads:
    """One reader's rows.

    Args:
        own: the reader.
        look: its T times.
        xyz: (T, n, 3) places of the targets at these times; NaN: not there.
        ids: (n,) their numbers.
        metre: in units of length.
        config: path loss and probabilities.
    """
    reader, shape = own.reader, xyz.shape[:2]
    noise, chance = own.noise.standard_normal(shape), own.chance.random(shape)
    shadow = own.shadowing(look.t_ns, ids, config)
    to = xyz - reader.position
    # Range, on the floor
    floor = np.hypot(to[..., 0], to[..., 1])
    there = np.isfinite(floor)
    likely = np.where(np.where(there, floor, np.inf) <= reader.range, config.detection, config.stray)
    read: Bools = there & (chance < likely)
    # Strength: path loss with the distance in space, shadowing, noise
    up = np.where(np.isnan(xyz[..., 2]), 0.0, xyz[..., 2]) - reader.position[2]
    power = config.power if reader.power is None else reader.power
    distance = np.where(there, np.hypot(floor, up), 1.0) / metre
    rssi = received_power(power, config.exponent, distance) + shadow + config.noise_db * noise
    if config.weakest is not None:
        read &= rssi >= config.weakest
    step, column = np.nonzero(read)
    return Reads.of(
        t_ns=look.t_ns[step],
        sensor=np.full(len(step), reader.name),
        tag=ids[column].astype(str),
        target_id=ids[column].astype(np.int32),
        rssi=rssi[read],
    )
