"""Priors of moving occluders from directions of arrival: locate speakers, and track each by a Kalman filter."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.geometry.triangulate import SourceDirections, distance2, localise
from occlog.core.numerics.assignment import assign
from occlog.errors import InputError, UsageError, abridged
from occlog.filtering.motion.white_acceleration import Walkers, concat, initiate, predict, select, update
from occlog.io.files.timing.utc import time_words
from occlog.records.scene import Scene
from occlog.records.tables import Doa, Occluders
from occlog.scans.occluder_priors import none_at

from .config import AcousticConfig

STEPS_PER_CHUNK = 256


class _Sources(NamedTuple):
    """N tracked sound sources.

    Attributes:
        identity: (N,) identities.
        first_ns, last_ns: (N,) times at which each was heard first and last [ns].
        walkers: Kalman filters of their positions and velocities.
    """

    identity: Ints
    first_ns: Ints
    last_ns: Ints
    walkers: Walkers


def acoustic_priors(chunks: Iterable[Doa], scene: Scene, config: AcousticConfig) -> Iterator[Occluders]:
    """Generate Gaussian priors of sound sources located by at least two microphone arrays, chunk by chunk.

    Args:
        chunks: directions in the order of time; their identities are not used.
        scene: scene with two or more microphone arrays.
        config: settings.

    Raises:
        InputError: an array that the scene does not have, or times that go back.
        UsageError: the scene has fewer than two arrays.
    """
    if len(scene.arrays) < 2:
        raise UsageError(
            f"the scene has {len(scene.arrays)} microphone arrays; locating sources requires at least 2: add some",
            id="too-few-sensors",
        )
    nothing = np.empty(0, dtype=np.int64)
    followed = _Sources(nothing, nothing, nothing, initiate(np.empty((0, 2)), np.empty((0, 2, 2)), 1.0))
    before, fresh = 0, 0
    held: list[Occluders] = []
    for t_ns, rows in _time_steps(chunks, round(config.window_s * 1e9)):
        # Predict; drop sources that fell silent
        followed = _aged(followed, t_ns, (t_ns - before) * 1e-9, config)
        # Locate: positions where directions of two arrays or more meet
        d = _directions(rows, scene)
        found = localise(
            d,
            followed.walkers.xy,
            followed.walkers.cov,
            scene.region,
            config.gate,
            max(config.min_triangulation_angle, 1e-6),
        )
        # Associate, update, begin
        followed, fresh = _heard(followed, t_ns, found.xy, found.covariance, fresh, config)
        before = t_ns
        held.append(_table(followed, t_ns, config))
        if len(held) >= STEPS_PER_CHUNK:
            yield Occluders.concat(held)
            held = []
    if held:
        yield Occluders.concat(held)


def _time_steps(chunks: Iterable[Doa], window_ns: int) -> Iterator[tuple[int, Doa]]:
    """Group directions to time steps of at most `window_ns` [ns]; generate the time of the last of each, and its rows.

    InputError if times go back.
    """
    rest: Doa | None = None
    for chunk in chunks:
        if not len(chunk):
            continue
        if rest is not None and chunk.t_ns[0] < rest.t_ns[-1]:
            raise InputError(
                f"doa: time {time_words(chunk.t_ns[0])} is earlier than the preceding "
                f"{time_words(rest.t_ns[-1])}; sort the rows by t_ns",
                id="unsorted-times",
            )
        table = chunk if rest is None else Doa.concat([rest, chunk])
        while len(table) and table.t_ns[-1] - table.t_ns[0] > window_ns:
            cut = int(np.searchsorted(table.t_ns, table.t_ns[0] + window_ns, side="right"))
            yield int(table.t_ns[cut - 1]), table.take(slice(0, cut))
            table = table.take(slice(cut, None))
        # The last time step may go on in the next chunk.
        rest = table
    if rest is not None:
        yield int(rest.t_ns[-1]), rest


def _directions(rows: Doa, scene: Scene) -> SourceDirections:
    index_of = {a.name: i for i, a in enumerate(scene.arrays)}
    for name in np.unique(rows.sensor).tolist():
        if name not in index_of:
            raise InputError(f"doa: the scene has no array {name!r}; it has: {abridged(index_of)}", id="unknown-sensor")
    array = np.array([index_of[name] for name in rows.sensor.tolist()], dtype=np.int64)
    positions = np.array([a.position[:2] for a in scene.arrays])
    sigmas = np.array([a.sigma for a in scene.arrays], dtype=np.float64)
    own = np.where(np.isnan(rows.sigma_azimuth), sigmas[array], rows.sigma_azimuth)
    return SourceDirections(array, positions[array], rows.azimuth, own)


def _aged(s: _Sources, t_ns: int, dt: float, config: AcousticConfig) -> _Sources:
    """Predict the sources by `dt` [s] to `t_ns` [ns]; those silent for more than `max_coasting_s` are dropped."""
    if not len(s.identity):
        return s
    keep = t_ns - s.last_ns <= config.max_coasting_s * 1e9
    walkers = predict(select(s.walkers, keep), dt, config.process_noise_velocity)
    return _Sources(s.identity[keep], s.first_ns[keep], s.last_ns[keep], walkers)


def _heard(s: _Sources, t_ns: int, xy: Floats, cov: Floats, fresh: int, config: AcousticConfig) -> tuple[_Sources, int]:
    """Update sources by located positions: each is assigned to a nearby known source, or begins a new one.

    Known sources silent now at the position of another one are removed.

    Args:
        s: sources predicted to this time.
        t_ns: time [ns].
        xy: (n, 2) located positions.
        cov: (n, 2, 2) their covariances.
        fresh: next new identity.
        config: gate and process noise.

    Returns:
        Updated sources, and the next new identity.
    """
    rows, columns = assign(distance2(s.walkers.xy, s.walkers.cov, xy, cov), config.gate**2)
    last, walkers = s.last_ns.copy(), Walkers(*(c.copy() for c in s.walkers))
    if len(rows):
        last[rows] = t_ns
        for column, new in zip(walkers, update(select(walkers, rows), xy[columns], cov[columns]), strict=True):
            column[rows] = new
    s = _single(_Sources(s.identity, s.first_ns, last, walkers), t_ns, config)
    new = np.setdiff1d(np.arange(len(xy)), columns)
    if not len(new):
        return s, fresh
    now = np.full(len(new), t_ns, dtype=np.int64)
    identity = np.concatenate([s.identity, fresh + np.arange(len(new), dtype=np.int64)])
    walkers = concat(s.walkers, initiate(xy[new], cov[new], config.process_noise_velocity))
    return _Sources(identity, np.append(s.first_ns, now), np.append(s.last_ns, now), walkers), fresh + len(new)


def _single(s: _Sources, t_ns: int, config: AcousticConfig) -> _Sources:
    """Remove sources that are silent at `t_ns` [ns] while another one is heard at their position, within the gate."""
    now = s.last_ns == t_ns
    if now.all() or not now.any():
        return s
    heard, others = select(s.walkers, now), select(s.walkers, ~now)
    keep = now.copy()
    keep[~now] = (distance2(others.xy, others.cov, heard.xy, heard.cov) > config.gate**2).all(axis=1)
    return _Sources(s.identity[keep], s.first_ns[keep], s.last_ns[keep], select(s.walkers, keep))


def _table(s: _Sources, t_ns: int, config: AcousticConfig) -> Occluders:
    """Rows of priors, at `t_ns` [ns], of the sources heard for at least `confirmation_time_s`.

    Without any, one row that states that there is no occluder.
    """
    sure = np.flatnonzero(s.last_ns - s.first_ns >= config.confirmation_time_s * 1e9)
    if not len(sure):
        return none_at(np.array([t_ns], dtype=np.int64))
    xy, cov = s.walkers.xy[sure], s.walkers.cov[sure]
    return Occluders(
        t_ns=np.full(len(sure), t_ns, dtype=np.int64),
        occluder_id=s.identity[sure].astype(np.int32),
        x=xy[:, 0],
        y=xy[:, 1],
        cov_xx=cov[:, 0, 0],
        cov_xy=cov[:, 0, 1],
        cov_yy=cov[:, 1, 1],
    )
