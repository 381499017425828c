"""Checks of sound: microphones without sound, at full scale, or with the samples of another one."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from occlog.array_types import Floats
from occlog.records.verdicts import Check, finding, outcome

from .stage import DoaTally

SOUND, SCALE, APART, HEARD = "microphone levels", "clipping", "distinct microphones", "directions"
"""Names of checks."""
SILENT = 0.01
"""A microphone with less than this share of the usual level of its array has none: 40 dB below."""
FULL, CLIPPED = 0.999, 1e-3
"""Samples from so much of full scale on are clipped; the share of them that a user must know."""


class Channels:
    """Levels of the microphones of one array, accumulated over a stream of samples."""

    def __init__(self) -> None:
        """Create empty statistics of channels."""
        self.count = 0
        self._squares = self._full = np.zeros(0)
        self._sums: list[int] = []  # check sums of the samples

    def watch(self, blocks: Iterable[Floats]) -> Iterator[Floats]:
        """The (n, M) blocks as they are."""
        for block in blocks:
            if not self.count:
                self._squares, self._full = np.zeros((2, block.shape[1]))
                self._sums = [0] * block.shape[1]
            self.count += len(block)
            self._squares = self._squares + np.sum(block**2, axis=0)
            loud = np.abs(block)
            self._full = self._full + np.count_nonzero((loud >= FULL) & (loud <= 1.0), axis=0)
            columns = np.ascontiguousarray(block.T)
            self._sums = [zlib.crc32(own, before) for own, before in zip(columns, self._sums, strict=True)]
            yield block

    def silent(self) -> list[int]:
        """Numbers, from 1, of microphones that have next to no sound where the others have."""
        level = np.sqrt(self._squares)
        return (np.flatnonzero(level < SILENT * np.median(level)) + 1).tolist()

    def clipped(self) -> dict[int, float]:
        """By number the share of samples at full scale, of microphones that have many."""
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
