"""Checks of sound: microphones that are silent, clipped, delayed, inverted, exchanged, or unrelated."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from itertools import combinations
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.records.verdicts import Check, finding, outcome

from .stage import DoaTally

TOGETHER = "common start of the channels"
RELATED, SIGNS, ORDER = "common sound of the channels", "signs of the channels", "order of the channels"
SOUND, SCALE, APART, HEARD = "microphone levels", "clipping", "distinct microphones", "directions"
SPAN = "size of the array"
"""Names of checks."""
SILENT = 0.01
"""A microphone with less than this share of the usual level of its array has none: 40 dB below."""
LEVEL_S, RATE, MIN_SILENCE, LOUD = 0.1, 16000.0, 0.1, 0.1
"""Length of the pieces of which levels are compared [s], rate where none is given [Hz], share of those with sound in
which a microphone must have none to be named, and share of the usual level from which a piece has sound."""
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


MIN_BLOCK = 1 << 12
"""Samples of a recording that is correlated although it is shorter than a block."""
FRAME, MAX_FRAMES = 1 << 13, 24
"""Samples of a piece of which the delays are compared with those of a plane wave, and number of them."""
MIN_MISFIT, MIN_GAIN, SIMILAR, ERROR, MIN_FRAMES = 0.15, 1.6, 1.3, 0.05, 3
"""A fault explains the difference of delays from those of a plane wave (RMS over pairs, median over frames [samples])
if it reduces it by at least this and by this factor; the ratio of differences from which one fault explains it better
than another, after an error of each is added; and the least number of frames."""
MAX_MISFIT_SAMPLES, MAX_MISFIT_EXTENTS = 0.6, 0.25
"""Difference that no fault explains from which delays are not those of one sound: at least so many samples, and this
share of the travel time across the array."""
MIN_DRIFT_FRAMES, MAX_DRIFT_RESIDUAL = 8, 0.5
"""Frames from which the clock of a channel is judged, and median difference of its delays from a line [samples]."""
MAX_SLOWNESS = 1.15
"""Largest slowness of a wave relative to that of sound: errors of delays."""
UNEQUAL = 10.0
"""Ratio of a microphone's level to the usual one [dB], or the inverse, from which it is stated."""
MIN_SHARE = 0.75
"""Least share of the frames with delays of a plane wave for a statement on their size."""
LEAST_SLOWNESS, MOST_SLOWNESS, MIN_EXCESS = 0.05, 1.3, 0.5
"""Bounds of the share of the longest delays that positions and rate permit, and delay beyond it [samples] to be stated.
A share below the first is that of sound from straight above an array of 3 degrees."""
MAX_ABOVE, MIN_TURN_RAD, MAX_CHANGE = 0.7, 0.5, 0.1
"""Slowness in the plane of an array below which sound comes from above, or the rate is wrong: a source that moves by
this angle above an array changes it by more than this share of it."""
SEARCHED = 4.0
"""Multiple of the longest possible delays within which those of another rate or unit are sought."""


class ChannelLags:
    """Cross-correlation of each pair of M channels (GCC-PHAT, Knapp & Carter 1976), averaged over blocks of samples.

    Finds channels that are unrelated, inverted, delayed or exchanged. Up to `MAX_BLOCKS` blocks are used.
    """

    def __init__(self) -> None:
        """Start without sound."""
        self._parts: list[Floats] = []
        self._held = self._blocks = 0
        self._sums: Floats | None = None  # (M, M, BLOCK)
        self._frames: list[Floats] = []  # (M, M, FRAME) correlations

    def add(self, block: Floats) -> None:
        """Add samples `block` (n, M) of M channels; ignored once there are enough."""
        if self._blocks >= MAX_BLOCKS:
            return
        self._parts.append(block)
        self._held += len(block)
        while self._held >= BLOCK and self._blocks < MAX_BLOCKS:
            whole = np.concatenate(self._parts)
            self._correlate(whole[:BLOCK])
            self._parts, self._held = [whole[BLOCK:]], len(whole) - BLOCK

    def finish(self) -> None:
        """Use the samples of a recording shorter than one block, if they are at least `MIN_BLOCK`."""
        if not self._blocks and self._held >= MIN_BLOCK:
            whole = np.concatenate(self._parts)
            self._correlate(np.pad(whole, ((0, BLOCK - len(whole)), (0, 0))), len(whole))

    def _correlate(self, samples: Floats, sound: int = BLOCK) -> None:
        """Add the cross-correlations with phase transform (GCC-PHAT) of one block of samples (`BLOCK`, M), in place.

        Only the first `sound` samples of the block are no padding.
        """
        found = _phat(samples)
        self._sums = found if self._sums is None else self._sums + found
        self._blocks += 1
        for start in range(0, sound - FRAME + 1, FRAME):
            if len(self._frames) < MAX_FRAMES:
                self._frames.append(_phat(samples[start : start + FRAME]))

    def unrelated(self) -> list[int]:
        """Channels, from 0, without sound in common with any other channel; empty unless most of the others have."""
        if self._sums is None:
            return []
        count, limit = len(self._sums), MIN_PEAK_SIGMAS / np.sqrt(self._blocks * BLOCK)
        related = np.eye(count, dtype=bool)
        for i, j in combinations(range(count), 2):
            related[i, j] = related[j, i] = np.abs(self._sums[i, j]).max() / self._blocks > limit
        largest = max(map(len, _connected(related)))
        alone = np.flatnonzero(related.sum(axis=1) == 1).tolist()
        return alone if largest > count / 2 else []

    def inverted(self, microphones: Floats, rate: float) -> list[int]:
        """Channels, from 0, with inverted sign relative to the majority; empty if that is not clear.

        Args:
            microphones: (M, 3) positions, in seconds of the travel of sound.
            rate: samples per second.
        """
        if self._sums is None:
            return []
        count = len(self._sums)
        same = np.eye(count, dtype=bool)
        for i, j in combinations(range(count), 2):
            near = self._within(i, j, microphones, rate)
            found = self._sums[i, j][near] / self._blocks
            if max(found.max(), -found.min()) < MIN_PEAK_SIGMAS / np.sqrt(self._blocks * BLOCK):
                return []
            same[i, j] = same[j, i] = found.max() > -found.min()
        groups = sorted(_connected(same), key=len)
        # Two groups with a sign each; of equal ones neither is known to be right
        similar = all(same[np.ix_(group, group)].all() for group in groups)
        return groups[0] if len(groups) == 2 and similar and len(groups[0]) < len(groups[1]) else []

    def misfit(self, microphones: Floats, rate: float) -> Misfit | None:
        """Compare the delays between channels with those of a plane wave, and find a fault that explains a difference.

        Delays of microphones in a plane wave are linear in their positions (Smith & Abel 1987). More microphones than
        unknowns of the wave are needed, and an exchange that mirrors or turns the array fits another plane wave.

        Args:
            microphones: (M, 3) positions, in seconds of the travel of sound.
            rate: samples per second.

        Returns:
            None if delays are consistent, or too few of them are known.
        """
        count = len(microphones)
        pairs = list(combinations(range(count), 2))
        apart: Floats = np.array([microphones[i] - microphones[j] for i, j in pairs]).reshape(-1, 3)
        if count - 1 <= np.linalg.matrix_rank(apart, tol=1e-3 * np.abs(apart).max(initial=1e-30)):
            return None
        extent = float(np.linalg.norm(apart, axis=1).max()) * rate
        # A channel that is later than that is beyond what the distance from each other one permits
        near = np.abs(np.fft.fftfreq(FRAME, 1.0 / FRAME)) <= 3.0 * extent + SLACK_SAMPLES
        lags = np.array([[_delay(frame[i, j], near) for i, j in pairs] for frame in self._frames])
        lags = lags.reshape(-1, len(pairs))
        lags = lags[np.isfinite(lags).all(axis=1)]
        if len(lags) < MIN_FRAMES:
            return None
        own, _ = _plane_wave_misfit(lags, apart, rate)
        exchanged: dict[tuple[int, int], float] = {}
        for i, j in pairs:
            order = _swapped(count, i, j)
            moved: Floats = np.array([microphones[order[k]] - microphones[order[m]] for k, m in pairs])
            exchanged[i, j] = _plane_wave_misfit(lags, moved, rate)[0]
        late: dict[int, tuple[float, float]] = {}  # misfit, delay [samples]
        for channel in range(count):
            with_it = np.array([float(i == channel) - float(j == channel) for i, j in pairs])
            left = with_it - apart @ (np.linalg.pinv(apart, rcond=1e-3) @ with_it)
            delay = float(np.median(lags @ left / (left @ left)))
            rest, slowness = _plane_wave_misfit(lags - delay * with_it, apart, rate)
            if slowness <= MAX_SLOWNESS:
                late[channel] = rest, -delay
        least = {"exchanged": min(exchanged.values()), "late": min((rest for rest, _ in late.values()), default=np.inf)}
        # A delay has one more unknown than an exchange
        kind = "late" if SIMILAR * (least["late"] + ERROR) < least["exchanged"] + ERROR else "exchanged"
        if own - least[kind] > MIN_MISFIT and own > MIN_GAIN * least[kind]:
            limit = SIMILAR * (least[kind] + ERROR) - ERROR
            if kind == "exchanged":
                return Misfit(own, tuple(pair for pair, rest in exchanged.items() if rest <= limit), {})
            return Misfit(own, (), {channel: round(lag) for channel, (rest, lag) in late.items() if rest <= limit})
        return Misfit(own, (), {}) if own > max(MAX_MISFIT_SAMPLES, MAX_MISFIT_EXTENTS * extent) else None

    def drift(self, microphones: Floats, rate: float) -> dict[int, float]:
        """Drift [ppm] of a channel with a clock of its own, by number from 0; positive: its clock is slow.

        Its delays to all others grow linearly with time, beyond what a source that moves can cause, and those between
        the others do not. Empty if no channel or several are such.

        Args:
            microphones: (M, 3) positions, in seconds of the travel of sound.
            rate: samples per second.
        """
        count, frames = len(microphones), len(self._frames)
        if count < 3 or frames < MIN_DRIFT_FRAMES:
            return {}
        near = np.abs(np.fft.fftfreq(FRAME, 1.0 / FRAME)) <= FRAME / 8
        t = np.arange(frames, dtype=np.float64)
        rates, drifts = np.zeros((count, count)), np.zeros((count, count), dtype=np.bool_)
        for i, j in combinations(range(count), 2):
            lags = np.array([_delay(frame[i, j], near) for frame in self._frames])
            known = np.isfinite(lags)
            if known.sum() < MIN_SHARE * frames:
                return {}
            first, second = np.triu_indices(int(known.sum()), 1)
            y, x = lags[known], t[known]
            rates[i, j] = np.median((y[second] - y[first]) / (x[second] - x[first]))  # Theil-Sen
            rates[j, i] = -rates[i, j]
            left = y - rates[i, j] * x
            rest = np.median(np.abs(left - np.median(left)))
            moved = 2.0 * float(np.linalg.norm(microphones[i] - microphones[j])) * rate + SLACK_SAMPLES
            drifts[i, j] = drifts[j, i] = abs(rates[i, j]) * frames > moved and rest < MAX_DRIFT_RESIDUAL
        own = np.flatnonzero(drifts.sum(axis=1) == count - 1)
        if len(own) != 1 or drifts.sum() != 2 * (count - 1):
            return {}
        return {int(own[0]): float(1e6 * np.median(np.delete(rates[:, own[0]], own[0])) / FRAME)}

    def slowness(self, microphones: Floats, rate: float) -> float | None:
        """Slowness of the fitted plane waves relative to that of sound, if it is implausible; None otherwise.

        Median over the frames; above 1 the delays are longer than the array permits. None also if the delays of
        many frames are not those of a plane wave.

        Args:
            microphones: (M, 3) positions, in seconds of the travel of sound.
            rate: samples per second.
        """
        pairs = list(combinations(range(len(microphones)), 2))
        apart: Floats = np.array([microphones[i] - microphones[j] for i, j in pairs]).reshape(-1, 3)
        rank = np.linalg.matrix_rank(apart, tol=1e-3 * np.abs(apart).max(initial=1e-30))
        if rank < 2:
            return None
        longest, found = float(np.linalg.norm(apart, axis=1).max()) * rate, []
        near = np.abs(np.fft.fftfreq(FRAME, 1.0 / FRAME)) <= SEARCHED * longest + SLACK_SAMPLES
        for frame in self._frames:
            lags = np.array([_delay(frame[i, j], near) for i, j in pairs])
            waves, misfit = _plane_waves(lags[None], apart)
            if misfit[0] <= max(MIN_MISFIT, 0.1 * float(np.sqrt(np.mean(lags**2)))):
                found.append(waves[0] / rate)
        if len(found) < max(MIN_FRAMES, MIN_SHARE * len(self._frames)):
            return None
        waves = np.array(found)
        shares = np.linalg.norm(waves, axis=1)
        low, usual = float(np.quantile(shares, 1.0 - MIN_SHARE)), float(np.median(shares))
        large = low > MOST_SLOWNESS and (low - 1.0) * longest > MIN_EXCESS
        # In space the size of a slowness is that of sound; in a plane it is smaller for sound from above
        small = shares.max() < (1.0 / MOST_SLOWNESS if rank == 3 else LEAST_SLOWNESS)
        if rank == 2 and usual < MAX_ABOVE:
            axes = np.linalg.svd(apart, full_matrices=False)[2][:2]
            towards = (waves @ axes.T) @ np.array([1.0, 1.0j])
            turned = np.ptp(np.unwrap(np.angle(towards)))
            small |= bool(turned > MIN_TURN_RAD and np.ptp(np.quantile(shares, [0.1, 0.9])) < MAX_CHANGE * usual)
        return usual if large or small else None

    def _within(self, i: int, j: int, microphones: Floats, rate: float) -> Bools:
        """(BLOCK,) mask of lags, in the order of an FFT, that are possible for the distance of two microphones.

        Args:
            i: index of a microphone.
            j: index of the other one.
            microphones: (M, 3) positions, in seconds of the travel of sound.
            rate: samples per second.
        """
        limit = float(np.linalg.norm(microphones[i] - microphones[j])) * rate + SLACK_SAMPLES
        return np.asarray(np.abs(np.fft.fftfreq(BLOCK, 1.0 / BLOCK)) <= limit)

    def late(self, microphones: Floats, rate: float) -> dict[int, int]:
        """Delays [samples] of delayed channels, by number from 0; negative: early. Channels in step are omitted.

        Channels with lags that the distances of their microphones allow form a group; the largest group (on ties,
        that of the first channel) is the reference.

        Args:
            microphones: (M, 3) positions, in seconds of the travel of sound.
            rate: samples per second.
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
        # The plane wave of the others, of which the part between their microphones and its own is no delay
        first, second = np.array([*combinations(right, 2)], dtype=int).reshape(-1, 2).T
        travel = rate * (microphones[first] - microphones[second])
        wave = np.linalg.lstsq(travel, lags[first, second], rcond=1e-6)[0]
        out: dict[int, int] = {}
        for channel in sorted(set(range(count)) - set(right)):
            own = lags[right, channel] - rate * (microphones[right] - microphones[channel]) @ wave
            if known[right, channel].all() and np.ptp(own) <= spread:
                out[channel] = round(float(np.median(own)))
        return out

    def _peak(self, i: int, j: int, limit: float) -> tuple[float, bool, bool]:
        """Lag of channel j relative to i [samples] (positive: j is later) at the highest correlation.

        Also whether it is within +-`limit` [samples], and whether it is a distinct peak clearly beyond.
        """
        found = np.zeros(0) if self._sums is None else self._sums[i, j] / max(self._blocks, 1)
        lags = np.fft.fftfreq(BLOCK, 1.0 / BLOCK)
        near = np.abs(lags) <= limit
        best = int(np.argmax(found))
        clear = found[best] > MIN_PEAK_SIGMAS / np.sqrt(self._blocks * BLOCK)
        clear = bool(clear and not near[best] and found[best] > MIN_PEAK_RATIO * found[near].max())
        return float(lags[best]), bool(near[best]), clear


class Misfit(NamedTuple):
    """Delays that are not those of a plane wave.

    Attributes:
        samples: RMS difference of the delays [samples], median over frames.
        exchanged: pairs of channels, from 0, of which an exchange explains it.
        late: delay [samples] by channel, from 0; the delay of any one of them explains it.
    """

    samples: float
    exchanged: tuple[tuple[int, int], ...]
    late: dict[int, int]


def _phat(samples: Floats) -> Floats:
    """(M, M, n) phase transform correlations by lag, in the order of an FFT, of samples (n, M).

    Entry [i, j] is filled for channels i < j, others are 0. Its peak is at the delay of j relative to i.
    """
    spectra = np.fft.rfft(samples, axis=0).T
    with np.errstate(invalid="ignore", divide="ignore"):
        phases = np.nan_to_num(spectra / np.abs(spectra))
    count = len(phases)
    out = np.zeros((count, count, len(samples)))
    for i, j in combinations(range(count), 2):
        out[i, j] = np.fft.irfft(phases[j] * phases[i].conj(), len(samples))
    return out


def _delay(found: Floats, near: Bools) -> float:
    """Lag [samples, fractional] of the peak of a phase transform correlation; NaN if the peak is not distinct.

    For broadband sound the peak is a sinc; its position follows from its neighbours (Foroosh et al. 2002).

    Args:
        found: (n,) correlation by lag, in the order of an FFT.
        near: (n,) mask of possible lags.
    """
    values = np.where(near, found, -np.inf)
    top = int(np.argmax(values))
    if not found[top] > MIN_PEAK_SIGMAS / np.sqrt(len(found)):
        return math.nan
    before, after = found[top - 1], found[(top + 1) % len(found)]
    side = max(before, after, 0.0)
    lag = top if top < len(found) // 2 else top - len(found)
    return lag + float(np.copysign(side / (side + found[top]), after - before))


def _swapped(count: int, i: int, j: int) -> Ints:
    """(count,) channel numbers with i and j exchanged."""
    out = np.arange(count)
    out[[i, j]] = j, i
    return out


def _plane_wave_misfit(lags: Floats, apart: Floats, rate: float) -> tuple[float, float]:
    """RMS difference of delays from those of the best plane wave [samples], and its slowness relative to sound.

    Both are medians over n frames.

    Args:
        lags: (n, P) delays of P pairs of channels [samples].
        apart: (P, 3) differences of the microphones' positions of the pairs, in seconds of the travel of sound.
        rate: samples per second.
    """
    waves, rest = _plane_waves(lags, apart)
    return float(np.median(rest)), float(np.median(np.linalg.norm(waves, axis=1))) / rate


def _plane_waves(lags: Floats, apart: Floats) -> tuple[Floats, Floats]:
    """Slowness vectors (n, 3) [samples per second of travel] of the plane waves that fit delays best (least squares).

    Also the RMS differences (n,) of the delays from theirs [samples]; arguments as of `_plane_wave_misfit`.
    """
    waves = lags @ np.linalg.pinv(apart, rcond=1e-3).T
    return waves, np.sqrt(np.mean((lags - waves @ apart.T) ** 2, axis=1))


def _connected(fits: Bools) -> list[list[int]]:
    """Groups of channels that are connected, directly or over others, by the mask of pairs `fits` (M, M)."""
    groups: list[list[int]] = []
    for channel in range(len(fits)):
        joined = [group for group in groups if fits[channel, group].any()]
        groups = [group for group in groups if group not in joined]
        groups.append(sorted([channel, *(each for group in joined for each in group)]))
    return groups


MIN_COPY = 1.0 - 0.5e-5
"""Correlation of two channels, without delay, above which one is a copy: they differ by less than -50 dB."""


class Channels:
    """Checks of the M microphones of one array, from statistics accumulated over a stream of samples."""

    def __init__(self, microphones: Floats | None = None, rate: float = 0.0) -> None:
        """Start without samples.

        Args:
            microphones: (M, 3) positions, in seconds of the travel of sound; None: no checks of delays.
            rate: samples per second; 0: unknown.
        """
        self.count = 0
        self._microphones, self._rate, self._lags = microphones, rate, ChannelLags()
        self._squares = self._full = np.zeros(0)
        self._totals, self._products = np.zeros(0), np.zeros((0, 0))
        self._piece = max(round(LEVEL_S * (rate or RATE)), 1)
        self._levels: list[Floats] = []  # (M,) mean squares of each piece

    def watch(self, blocks: Iterable[Floats]) -> Iterator[Floats]:
        """Generate the blocks of samples (n, M), full scale 1, unchanged, and accumulate their statistics."""
        for block in blocks:
            if not self.count:
                self._squares, self._full = np.zeros((2, block.shape[1]))
                self._totals, self._products = np.zeros(block.shape[1]), np.zeros((block.shape[1],) * 2)
            self.count += len(block)
            if self._microphones is not None:
                self._lags.add(block)
            self._squares = self._squares + np.sum(block**2, axis=0)
            # A rest of a block, shorter than half of a piece, has no level
            begins = range(0, len(block) - self._piece // 2, self._piece)
            self._levels += [np.mean(block[k : k + self._piece] ** 2, axis=0) for k in begins]
            loud = np.abs(block)
            self._full = self._full + np.count_nonzero((loud >= FULL) & (loud <= 1.0), axis=0)
            self._totals, self._products = self._totals + block.sum(axis=0), self._products + block.T @ block
            yield block

    def unrelated(self) -> list[int]:
        """Numbers, from 1, of microphones with sound unrelated to all others (silent ones are excluded)."""
        self._lags.finish()
        silent = self.silent()
        return [n + 1 for n in self._lags.unrelated() if n + 1 not in silent]

    def inverted(self) -> list[int]:
        """Numbers, from 1, of microphones with inverted sign relative to the majority."""
        if self._microphones is None:
            return []
        self._lags.finish()
        return [n + 1 for n in self._lags.inverted(self._microphones, self._rate)]

    @cached_property
    def misfit(self) -> Misfit | None:
        """Delays that differ from those of a plane wave, and what explains it; None if they do not.

        None also without positions, or if another fault of the samples is found.
        """
        if self._microphones is None or self.silent() or self.similar() or self.late() or self.inverted():
            return None
        if self.drift():
            return None
        return None if self.unrelated() else self._lags.misfit(self._microphones, self._rate)

    @cached_property
    def _drift(self) -> dict[int, float]:
        self._lags.finish()
        return {} if self._microphones is None else self._lags.drift(self._microphones, self._rate)

    def drift(self) -> dict[int, float]:
        """Drift [ppm] of a microphone with a clock of its own, by number from 1; positive: its clock is slow."""
        return {} if self.silent() or self.similar() else {n + 1: ppm for n, ppm in self._drift.items()}

    def slowness(self) -> float | None:
        """Slowness of the fitted plane waves relative to that of sound, if it is implausible; None otherwise."""
        if self._microphones is None or self.silent() or self.similar() or self.drift():
            return None
        self._lags.finish()
        return self._lags.slowness(self._microphones, self._rate)

    def late(self) -> dict[int, int]:
        """Delays [samples] of microphones out of step, by number from 1; negative: early. Empty without positions."""
        if self._microphones is None:
            return {}
        self._lags.finish()
        return {n + 1: lag for n, lag in self._lags.late(self._microphones, self._rate).items()}

    def silent(self) -> list[int]:
        """Numbers, from 1, of microphones that are nearly silent while others are not."""
        level = np.sqrt(self._squares)
        return (np.flatnonzero(level < SILENT * np.median(level)) + 1).tolist()

    def unequal(self) -> dict[int, float]:
        """Level [dB] relative to the median, by number from 1, of microphones that differ by more than `UNEQUAL`.

        Silent ones are excluded.
        """
        level = np.sqrt(self._squares)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = 20.0 * np.log10(level / np.median(level))
        silent = self.silent()
        return {n + 1: float(ratio[n]) for n in np.flatnonzero(np.abs(ratio) > UNEQUAL).tolist() if n + 1 not in silent}

    def interrupted(self) -> dict[int, float]:
        """Share of the intervals with sound in which a microphone has none, by number from 1.

        Only shares of at least `MIN_SILENCE`, and no microphones that are silent throughout.
        """
        levels = np.sqrt(np.array(self._levels).reshape(len(self._levels), -1))
        if not levels.size:
            return {}
        usual = np.median(levels, axis=1)
        sound = levels[usual > LOUD * np.median(usual)]
        gone = (sound < SILENT * np.median(sound, axis=1)[:, None]).mean(axis=0) if len(sound) else np.zeros(0)
        silent = self.silent()
        return {n + 1: float(gone[n]) for n in np.flatnonzero(gone >= MIN_SILENCE).tolist() if n + 1 not in silent}

    def clipped(self) -> dict[int, float]:
        """Share of clipped samples by microphone number from 1, for shares above `CLIPPED`."""
        shares = self._full / max(self.count, 1)
        return {n + 1: float(shares[n]) for n in np.flatnonzero(shares > CLIPPED).tolist()}

    def similar(self) -> list[int]:
        """Numbers, from 1, of microphones with the samples of another one, but for a gain and an offset.

        Silent ones are excluded.
        """
        covariance = self._products - np.outer(self._totals, self._totals) / max(self.count, 1)
        scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            correlation = covariance / np.outer(scale, scale)
        np.fill_diagonal(correlation, 0.0)
        return (np.flatnonzero((correlation > MIN_COPY).any(axis=1)) + 1).tolist()


def checks(
    channels: Mapping[str, Channels], tallies: Mapping[str, DoaTally], rows: Mapping[str, int]
) -> tuple[Check, ...]:
    """Checks of each array's sound, with their findings.

    Args:
        channels: statistics of the microphones, by the name of the array.
        tallies: counts of the frames, by the name of the array.
        rows: number of directions found, by the name of the array.
    """
    return (
        *outcome(SOUND, _silent(channels)),
        *outcome(SCALE, _clipped(channels)),
        *outcome(APART, _similar(channels)),
        *outcome(TOGETHER, _late(channels)),
        *outcome(RELATED, _unrelated(channels)),
        *outcome(SIGNS, _inverted(channels)),
        *outcome(ORDER, _exchanged(channels)),
        *outcome(SPAN, _sizes(channels)),
        *outcome(HEARD, _nothing(tallies, rows)),
    )


def _silent(channels: Mapping[str, Channels]) -> Iterator[Check]:
    for name, own in channels.items():
        if dead := own.silent():
            yield finding(SOUND, "microphone-silent", sensors=[name], microphones=_listed(dead), allowed=SILENT)
        if gone := own.interrupted():
            yield finding(
                SOUND, "microphone-interrupted", sensors=[name], microphones=_listed(gone), share=max(gone.values())
            )
        for number, level in own.unequal().items():
            side = "quieter" if level < 0.0 else "louder"
            yield finding(
                SOUND,
                "microphone-gain",
                sensors=[name],
                microphones=str(number),
                level=abs(level),
                side=side,
                allowed=UNEQUAL,
            )


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


def _similar(channels: Mapping[str, Channels]) -> Iterator[Check]:
    for name, own in channels.items():
        if same := own.similar():
            yield finding(APART, "microphones-identical", sensors=[name], microphones=_listed(same))


def _late(channels: Mapping[str, Channels]) -> Iterator[Check]:
    for name, own in channels.items():
        drifts = own.drift()
        for number, ppm in drifts.items():
            side = "slow" if ppm > 0 else "fast"
            yield finding(
                TOGETHER, "microphone-drifts", sensors=[name], microphones=str(number), ppm=abs(ppm), side=side
            )
        if drifts:
            continue
        lags = own.late()
        if own.misfit is not None and len(own.misfit.late) == 1:
            lags = {channel + 1: lag for channel, lag in own.misfit.late.items()}
        for number, lag in lags.items():
            yield finding(
                TOGETHER,
                "microphone-late",
                sensors=[name],
                microphones=str(number),
                samples=abs(lag),
                side="late" if lag > 0 else "early",
            )


def _unrelated(channels: Mapping[str, Channels]) -> Iterator[Check]:
    for name, own in channels.items():
        if alone := own.unrelated():
            yield finding(RELATED, "microphone-unrelated", sensors=[name], microphones=_listed(alone))


def _inverted(channels: Mapping[str, Channels]) -> Iterator[Check]:
    for name, own in channels.items():
        if turned := own.inverted():
            yield finding(SIGNS, "microphone-inverted", sensors=[name], microphones=_listed(turned))


def _exchanged(channels: Mapping[str, Channels]) -> Iterator[Check]:
    for name, own in channels.items():
        found = own.misfit
        if found is None or len(found.late) == 1:
            continue
        if found.exchanged:
            pairs = " or ".join(f"{i + 1} and {j + 1}" for i, j in found.exchanged)
            yield finding(ORDER, "microphones-exchanged", sensors=[name], microphones=pairs, misfit=found.samples)
        else:
            cause = f"; microphone {' or '.join(str(c + 1) for c in found.late)} may be late" if found.late else ""
            yield finding(ORDER, "microphones-inconsistent", sensors=[name], misfit=found.samples, cause=cause)


def _sizes(channels: Mapping[str, Channels]) -> Iterator[Check]:
    for name, own in channels.items():
        if (share := own.slowness()) is not None:
            yield finding(SPAN, "array-size-implausible", sensors=[name], share=share)


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
