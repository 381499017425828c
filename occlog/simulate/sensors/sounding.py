"""When sources sound, and which of them a microphone array cannot tell apart."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.seeds import Stage, generator

BLOCK = 1_000_000
"""Pairs of sources that are compared at a time."""
PAIRS = 32
"""Durations of sound and silence drawn at a time for each source."""


class Sounding:
    """Which sources sound at which times; it remembers what it drew, so that all arrays hear the same."""

    def __init__(self, silent: Mapping[int, Ints], means: tuple[float, float] | None, start_ns: int, seed: int) -> None:
        """`silent` has (k, 2) times from and to [ns] of scripted silence; `means` as `SoundConfig.silence`."""
        self._silent, self._means, self._start, self._seed = dict(silent), means, start_ns, seed
        self._changes: dict[int, SoundChanges] = {}

    def at(self, t_ns: Ints, ids: Ints) -> Bools:
        """(T, n) bool: whether each source sounds at each time."""
        out = np.ones((len(t_ns), len(ids)), dtype=np.bool_)
        for column, number in enumerate(ids.tolist()):
            for low, high in self._silent.get(number, ()):
                out[:, column] &= (t_ns < low) | (t_ns >= high)
            if self._means is not None and len(t_ns):
                if number not in self._changes:
                    rng = generator(self._seed, Stage.SILENCE, number)
                    self._changes[number] = SoundChanges(self._means, self._start, rng)
                out[:, column] &= self._changes[number].sounding(t_ns)
        return out


class SoundChanges:
    """Times at which one source starts and stops, drawn as far as they are asked for."""

    def __init__(self, means: tuple[float, float], start_ns: int, rng: np.random.Generator) -> None:
        sounds = rng.random() * sum(means) < means[0]
        self._first = bool(sounds)
        self._means = np.array(means if sounds else means[::-1])
        self._rng = rng
        self._times = np.zeros(1)  # of the start, and of the changes [s]
        self._start = start_ns

    def sounding(self, t_ns: Ints) -> Bools:
        """(T,) whether the source sounds at rising times [ns]."""
        seconds = (t_ns - self._start) * 1e-9
        while self._times[-1] <= seconds[-1]:
            lengths = (self._rng.standard_exponential((PAIRS, 2)) * self._means).ravel()
            self._times = np.concatenate([self._times, self._times[-1] + np.cumsum(lengths)])
        passed = np.searchsorted(self._times[1:], seconds, side="right")
        return np.asarray((passed % 2 == 0) == self._first)


def merge_near(to: Floats, known: Bools, heard: Bools, resolution: float, planar: bool) -> tuple[Floats, Bools, Bools]:
    """Sources that an array hears as one, put together.

    Sources nearer to each other than the resolution are one, and so are all that hang together
    by such pairs (single linkage).  Their direction is the mean of their unit vectors: they are taken
    to be of equal power.  "Nearer" is along the arc, or in azimuth where the array is planar or
    the height of one of the two is not known.  The first of them stands for all.

    Args:
        to: (T, n, 3) from the array to each source, z 0 where it is not known.
        known: (T, n) whether the height is.
        heard: (T, n) whether it is heard at all.
        resolution: [rad], > 0.
        planar: whether the array tells azimuths only.

    Returns:
        to, known and heard after that; where several became one, `to` is a unit vector.
    """
    size = max(1, BLOCK // to.shape[1] ** 2)
    blocks = [slice(k, k + size) for k in range(0, len(to), size)]
    merged = [_merge(to[b], known[b], heard[b], resolution, planar) for b in blocks]
    if not merged:
        return to, known, heard
    places, heights, stands = zip(*merged, strict=True)
    return np.concatenate(places), np.concatenate(heights), np.concatenate(stands)


def _merge(to: Floats, known: Bools, heard: Bools, resolution: float, planar: bool) -> tuple[Floats, Bools, Bools]:
    """`merge_near` of one block of times."""
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
    clear = np.linalg.norm(total, axis=-1) > 1e-9  # opposite directions have no mean: the first stands
    return np.where((several & clear)[..., None], _unit(total), to), all_known, stands


def _unit(vectors: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    out: Floats = vectors / np.where(length > 0, length, 1.0)
    return out


def _distances(units: Floats) -> Floats:
    """(T, n, n) chords between unit vectors; NaN where one of them is."""
    return np.asarray(np.linalg.norm(units[:, :, None] - units[:, None, :], axis=-1))
