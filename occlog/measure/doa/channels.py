"""Checks of sound: microphones without sound, at full scale, late, or with the samples of another one."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator, Mapping
from itertools import combinations

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.records.verdicts import Check, finding, outcome

from .stage import DoaTally

TOGETHER = "common start of the channels"
SOUND, SCALE, APART, HEARD = "microphone levels", "clipping", "distinct microphones", "directions"
"""Names of checks."""
SILENT = 0.01
"""A microphone with less than this share of the usual level of its array has none: 40 dB below."""
FULL, CLIPPED = 0.999, 1e-3
"""Samples from so much of full scale on are clipped; the share of them that a user must know."""


BLOCK, MAX_BLOCKS = 1 << 15, 24
"""Samples of a correlation, and number of them, from the begin of the sound on."""
MIN_PEAK_SIGMAS = 8.0
"""Height of a peak of the correlation, in standard deviations of that of independent noise; the highest one of 32,768
is above 6.5 with a probability of 1e-6."""
MIN_PEAK_RATIO = 2.0
"""Least ratio of a peak beyond what the distance of two microphones permits to the highest one within."""
SLACK_SAMPLES = 2.0
"""Lag beyond that distance that is not stated: of the interpolation, and of the speed of sound."""


class ChannelLags:
    """Correlation of each pair of channels (GCC-PHAT, Knapp & Carter 1976), as a mean over blocks of samples."""

    def __init__(self) -> None:
        """Start without samples."""
        self._parts: list[Floats] = []
        self._held = self._blocks = 0
        self._sums: Floats | None = None  # (M, M, BLOCK)

    def add(self, block: Floats) -> None:
        """Take (n, M) samples."""
        if self._blocks >= MAX_BLOCKS:
            return
        self._parts.append(block)
        self._held += len(block)
        while self._held >= BLOCK and self._blocks < MAX_BLOCKS:
            whole = np.concatenate(self._parts)
            self._correlate(whole[:BLOCK])
            self._parts, self._held = [whole[BLOCK:]], len(whole) - BLOCK

    def _correlate(self, samples: Floats) -> None:
        """Add the correlations of one block."""
        spectra = np.fft.rfft(samples, axis=0).T
        with np.errstate(invalid="ignore"):
            phases = np.nan_to_num(spectra / np.abs(spectra))
        count = len(phases)
        if self._sums is None:
            self._sums = np.zeros((count, count, BLOCK))
        for i, j in combinations(range(count), 2):
            self._sums[i, j] += np.fft.irfft(phases[j] * phases[i].conj(), BLOCK)
        self._blocks += 1

    def late(self, microphones: Floats, rate: float) -> dict[int, int]:
        """By how many samples channels are late, by their numbers from 0; negative: early.

        Channels that agree with each other, with lags that the distances of their microphones permit, are a group; the
        largest group (of equal ones that of the first channel) is right.

        Args:
            microphones: (M, 3) positions, in seconds of sound.
            rate: of the samples [Hz].
        """
        count = len(microphones)
        if self._sums is None:
            return {}
        lags, fits = np.zeros((count, count)), np.eye(count, dtype=bool)
        known = np.eye(count, dtype=bool)
        for i, j in combinations(range(count), 2):
            limit = float(np.linalg.norm(microphones[i] - microphones[j])) * rate + SLACK_SAMPLES
            lag, within, clear = self._peak(i, j, limit)
            fits[i, j] = fits[j, i] = within
            known[i, j] = known[j, i] = clear
            lags[i, j], lags[j, i] = lag, -lag
        groups = _connected(fits)
        right = max(groups, key=lambda group: (len(group), -group[0]))
        if len(right) == count:
            return {}
        spread = 2.0 * float(np.ptp(microphones, axis=0).max()) * rate + 2.0 * SLACK_SAMPLES
        out: dict[int, int] = {}
        for channel in sorted(set(range(count)) - set(right)):
            own = lags[right, channel]
            if known[right, channel].all() and np.ptp(own) <= spread:
                out[channel] = round(float(np.median(own)))
        return out

    def _peak(self, i: int, j: int, limit: float) -> tuple[float, bool, bool]:
        """Lag of channel j behind i [samples]; whether it is within the limit, and whether it is clearly beyond."""
        found = np.zeros(0) if self._sums is None else self._sums[i, j] / max(self._blocks, 1)
        lags = np.fft.fftfreq(BLOCK, 1.0 / BLOCK)
        near = np.abs(lags) <= limit
        best = int(np.argmax(found))
        clear = found[best] > MIN_PEAK_SIGMAS / np.sqrt(self._blocks * BLOCK)
        clear = bool(clear and not near[best] and found[best] > MIN_PEAK_RATIO * found[near].max())
        return float(lags[best]), bool(near[best]), clear


def _connected(fits: Bools) -> list[list[int]]:
    """Groups of channels that are connected by pairs that fit."""
    groups: list[list[int]] = []
    for channel in range(len(fits)):
        joined = [group for group in groups if fits[channel, group].any()]
        groups = [group for group in groups if group not in joined]
        groups.append(sorted([channel, *(each for group in joined for each in group)]))
    return groups


class Channels:
    """Levels of the microphones of one array, accumulated over a stream of samples."""

    def __init__(self, microphones: Floats | None = None, rate: float = 0.0) -> None:
        """Create empty statistics of channels; for lags positions (M, 3) in seconds of sound, and the rate [Hz]."""
        self.count = 0
        self._microphones, self._rate, self._lags = microphones, rate, ChannelLags()
        self._squares = self._full = np.zeros(0)
        self._sums: list[int] = []  # check sums of the samples

    def watch(self, blocks: Iterable[Floats]) -> Iterator[Floats]:
        """The (n, M) blocks as they are."""
        for block in blocks:
            if not self.count:
                self._squares, self._full = np.zeros((2, block.shape[1]))
                self._sums = [0] * block.shape[1]
            self.count += len(block)
            if self._microphones is not None:
                self._lags.add(block)
            self._squares = self._squares + np.sum(block**2, axis=0)
            loud = np.abs(block)
            self._full = self._full + np.count_nonzero((loud >= FULL) & (loud <= 1.0), axis=0)
            columns = np.ascontiguousarray(block.T)
            self._sums = [zlib.crc32(own, before) for own, before in zip(columns, self._sums, strict=True)]
            yield block

    def late(self) -> dict[int, int]:
        """Samples by which microphones are late, by their numbers from 1."""
        if self._microphones is None:
            return {}
        return {n + 1: lag for n, lag in self._lags.late(self._microphones, self._rate).items()}

    def silent(self) -> list[int]:
        """Numbers, from 1, of microphones that have next to no sound where the others have."""
        level = np.sqrt(self._squares)
        return (np.flatnonzero(level < SILENT * np.median(level)) + 1).tolist()

    def clipped(self) -> dict[int, float]:
        """Share of samples at full scale by microphone number, for microphones with many."""
        shares = self._full / max(self.count, 1)
        return {n + 1: float(shares[n]) for n in np.flatnonzero(shares > CLIPPED).tolist()}

    def alike(self) -> list[int]:
        """Numbers of microphones with the very samples of another one; silence is none."""
        own = [a if q > 0.0 else None for a, q in zip(self._sums, self._squares.tolist(), strict=True)]
        return [n + 1 for n, each in enumerate(own) if each is not None and own.count(each) > 1]


def checks(
    channels: Mapping[str, Channels], tallies: Mapping[str, DoaTally], rows: Mapping[str, int]
) -> tuple[Check, ...]:
    """Checks of each array's sound with their findings.

    Args:
        channels: by the name of the array.
        tallies: of its frames.
        rows: number of its directions.
    """
    return (
        *outcome(SOUND, _silent(channels)),
        *outcome(SCALE, _clipped(channels)),
        *outcome(APART, _alike(channels)),
        *outcome(TOGETHER, _late(channels)),
        *outcome(HEARD, _nothing(tallies, rows)),
    )


def _silent(channels: Mapping[str, Channels]) -> Iterator[Check]:
    for name, own in channels.items():
        if dead := own.silent():
            yield finding(SOUND, "microphone-silent", sensors=[name], microphones=_listed(dead), allowed=SILENT)


def _clipped(channels: Mapping[str, Channels]) -> Iterator[Check]:
    for name, own in channels.items():
        if loud := own.clipped():
            yield finding(
                SCALE,
                "clipped",
                sensors=[name],
                microphones=_listed(loud),
                share=max(loud.values()),
                allowed=CLIPPED,
            )


def _alike(channels: Mapping[str, Channels]) -> Iterator[Check]:
    for name, own in channels.items():
        if same := own.alike():
            yield finding(APART, "microphones-identical", sensors=[name], microphones=_listed(same))


def _late(channels: Mapping[str, Channels]) -> Iterator[Check]:
    for name, own in channels.items():
        for number, lag in own.late().items():
            yield finding(
                TOGETHER,
                "microphone-late",
                sensors=[name],
                microphones=str(number),
                samples=abs(lag),
                side="late" if lag > 0 else "early",
            )


def _nothing(tallies: Mapping[str, DoaTally], rows: Mapping[str, int]) -> Iterator[Check]:
    for name, tally in tallies.items():
        if not rows[name]:
            yield finding(
                HEARD,
                "no-directions",
                sensors=[name],
                frames=tally.frames,
                silent=tally.silent,
                unsure=tally.unsure,
            )


def _listed(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, numbers))
