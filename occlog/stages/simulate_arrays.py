"""True paths to the directions of arrival that microphone arrays report."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..columns import Floats, Ints
from ..core.camera import wrap_angle
from ..core.grid import Look, looks
from ..core.seeds import Stage, generator
from ..records import UNLABELLED, Doa, Truth
from ..scene import MicrophoneArray, Scene
from ..truth_grid import truth_grid
from .simulate_cameras import ObserveConfig


class _Ear(NamedTuple):
    array: MicrophoneArray
    noise: np.random.Generator
    chance: np.random.Generator


def observe_arrays(scene: Scene, truth_chunks: Iterable[Truth], config: ObserveConfig, seed: int) -> Iterator[Doa]:
    """Directions from every microphone array to every target in its range, unlabelled.

    Targets sound all the time, with equal strength; sound goes past occluders and walls;
    the moving occluders are silent.  Azimuth and elevation carry independent Gaussian noise
    of the array's sigma; without a known height of the target (z NaN) there is no elevation.
    A target that is out of range or missed has no row.  Of the configuration only `miss` counts.

    Args:
        scene: the arrays.
        truth_chunks: true paths, in time order.
        config: the probability of a miss.
        seed: of all random numbers; each array has its own.

    Returns:
        One table for every chunk.
    """
    ears = [
        _Ear(a, generator(seed, Stage.ARRAY_NOISE, i), generator(seed, Stage.ARRAY_CHANCE, i))
        for i, a in enumerate(scene.arrays)
    ]
    rates = [e.array.rate_hz for e in ears]
    for grid, found in looks(map(truth_grid, truth_chunks), rates):
        columns = np.flatnonzero(grid.target)
        yield Doa.merge(_report(e, look, columns, config) for e, look in zip(ears, found, strict=True))


def _report(ear: _Ear, look: Look, columns: NDArray[np.intp], config: ObserveConfig) -> Doa:
    array = ear.array
    shape = (len(look.t_ns), len(columns))
    noise = array.sigma * ear.noise.standard_normal((*shape, 2))
    heard = ear.chance.random(shape) >= config.miss
    to = look.xyz[:, columns] - array.position
    flat = np.hypot(to[..., 0], to[..., 1])
    height = np.where(np.isnan(to[..., 2]), 0.0, to[..., 2])
    with np.errstate(invalid="ignore"):
        heard &= np.hypot(flat, height) <= array.range
    azimuth = np.arctan2(to[..., 1], to[..., 0]) + noise[..., 0]
    elevation = np.arctan2(to[..., 2], flat) + noise[..., 1]
    return _rows(array, np.repeat(look.t_ns, len(columns))[heard.ravel()], azimuth[heard], elevation[heard])


def _rows(array: MicrophoneArray, t_ns: Ints, azimuth: Floats, elevation: Floats) -> Doa:
    n = len(t_ns)
    azimuth = wrap_angle(azimuth)
    order = np.lexsort((azimuth, t_ns))  # by direction, so that the order does not give targets away
    t_ns, azimuth, elevation = t_ns[order], azimuth[order], elevation[order]
    return Doa.of(
        t_ns=t_ns,
        sensor=np.full(n, array.name),
        source_id=np.full(n, UNLABELLED, dtype=np.int32),
        azimuth=azimuth,
        elevation=np.clip(elevation, -0.5 * np.pi, 0.5 * np.pi),
        sigma_azimuth=np.full(n, array.sigma),
        sigma_elevation=np.where(np.isnan(elevation), np.nan, array.sigma),
        confidence=np.full(n, np.nan),
    )
