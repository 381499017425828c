"""Directions of arrival of sound, frame by frame, in bounded memory."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from occlog.array_types import NS, Bools, Floats
from occlog.core.geometry.camera import wrap_angle
from occlog.records.scene import MicrophoneArray
from occlog.records.tables import Doa

from .config import DoaConfig
from .locate import ArrayDirection, Locator, direction, levels, locate, locator, make_band, spectra

NOISE_S = 30.0
"""Time over which the quietest spectrum is the noise."""
MIN_SPECTRA = 3
"""A frame with fewer that are no silence gives no direction."""


@dataclass
class DoaTally:
    """Counts of the frames of one array's sound: all, silent ones, and those with sound but no confident direction."""

    frames: int = 0
    silent: int = 0  # frames without enough sound
    unsure: int = 0  # frames with sound, but no direction with enough confidence


def estimate_directions(
    blocks: Iterable[Floats],
    rate: int,
    array: MicrophoneArray,
    unit: str,
    config: DoaConfig,
    start_ns: int,
    tally: DoaTally,
) -> Iterator[Doa]:
    """Generate the directions of each frame that has some, sorted by time, with angles in the world frame.

    A frame's time is that of its centre; a remainder shorter than a frame is omitted.

    Args:
        blocks: (n, M) samples of the array's microphones, in their order.
        rate: samples per second.
        array: array with microphones in the scene's unit.
        unit: unit of the scene's lengths.
        config: settings.
        start_ns: time of the first sample [ns].
        tally: counts of frames, updated in place.
    """
    at = locator(array, rate, unit, config)
    frame = frame_size(rate, config)
    hop = frame if config.hop_s is None else max(round(config.hop_s * rate), 1)
    quiet: deque[float] = deque(maxlen=max(round(NOISE_S * rate / hop), 1))
    for first, samples in frames(blocks, frame, hop):
        heard = _heard(at, samples, quiet, tally)
        if heard:
            t_ns = start_ns + round((2 * first + frame) * NS / (2 * rate))
            yield _table(heard, array, t_ns)


def frames(blocks: Iterable[Floats], size: int, hop: int) -> Iterator[tuple[int, Floats]]:
    """Generate frames of audio: (index of the first sample, samples (size, M)); independent of block borders.

    Args:
        blocks: samples (n, M) in order.
        size: number of samples in a frame.
        hop: number of samples from one frame to the next.
    """
    held: list[Floats] = []
    have, first, skip = 0, 0, 0
    for block in blocks:
        rest = block[skip:]
        skip = max(skip - len(block), 0)
        if not len(rest):
            continue
        held.append(rest)
        have += len(rest)
        while have >= size:
            joined = held[0] if len(held) == 1 else np.concatenate(held)
            yield first, joined[:size]
            held = [joined[hop:]]
            have = len(held[0])
            skip = max(hop - len(joined), 0)
            first += hop


def frame_size(rate: int, config: DoaConfig) -> int:
    """Number of samples in a frame at `rate` samples per second; at least that of one window."""
    return max(round(config.frame_s * rate), make_band(rate, config).length)


def frames_of(samples: int, rate: int, config: DoaConfig) -> int:
    """Number of complete frames in a recording of `samples` samples, at `rate` per second."""
    size = frame_size(rate, config)
    hop = size if config.hop_s is None else max(round(config.hop_s * rate), 1)
    return max((samples - size) // hop + 1, 0)


def _heard(at: Locator, samples: Floats, quiet: deque[float], tally: DoaTally) -> list[ArrayDirection]:
    # Spectra, half overlapping; only those above silence count
    tally.frames += 1
    X = spectra(samples, at.band.length, at.band.length // 2)
    active = _active(at, X, quiet)
    if int(active.sum()) < min(MIN_SPECTRA, X.shape[2]):
        tally.silent += 1
        return []
    heard = locate(at, X[:, :, active])
    tally.unsure += not heard
    return heard


def _active(at: Locator, X: np.ndarray, quiet: deque[float]) -> Bools:
    """(S,) mask of spectra with sound.

    They are above `min_level_db`, and, if stated, `min_snr_db` above the quietest level of the last `NOISE_S`.

    Args:
        at: band and settings.
        X: (M, F, S) spectra of S windows.
        quiet: lowest level [dB] of each of the last frames; that of this frame is appended.
    """
    with np.errstate(divide="ignore"):
        level = 10.0 * np.log10(levels(X, at.band.bins))
    active = level > at.config.min_level_db
    if at.config.min_snr_db is not None:
        heard = level[np.isfinite(level)]
        quiet.append(float(heard.min()) if len(heard) else np.inf)
        active &= level > min(quiet) + at.config.min_snr_db
    return np.asarray(active, dtype=np.bool_)


def _table(heard: list[ArrayDirection], array: MicrophoneArray, t_ns: int) -> Doa:
    n = len(heard)
    own = np.array(heard, dtype=np.float64)
    located = ~np.isnan(own[:, 1])
    u = direction(own[:, 0], np.where(located, own[:, 1], 0.0)) @ array.rotation.T
    return Doa.of(
        t_ns=np.full(n, t_ns, dtype=np.int64),
        sensor=np.full(n, array.name),
        source_id=np.full(n, -1, dtype=np.int32),
        azimuth=wrap_angle(np.arctan2(u[:, 1], u[:, 0])),
        elevation=np.where(located, np.arcsin(np.clip(u[:, 2], -1.0, 1.0)), np.nan),
        sigma_azimuth=own[:, 2],
        sigma_elevation=own[:, 3],
        confidence=own[:, 4],
    )
