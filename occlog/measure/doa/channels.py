"""Checks of sound: microphones without sound, at full scale, or with the samples of another one."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from occlog.array_types import Floats
from occlog.records.verdicts import Check, finding, outcome

from .stage import DoaTally

SOUND, SCALE, APART, HEARD = "sound of each microphone", "full scale", "their own microphones", "directions"
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
        *outcome(HEARD, _nothing(tallies, rows)),
    )


def _silent(channels: Mapping[str, Channels]) -> Iterator[Check]:
    for name, own in channels.items():
        if dead := own.silent():
            yield finding(
                SOUND,
                "warning",
                "microphone-silent",
                f"array {name}: microphone {_listed(dead)} has less than {SILENT:.0%} of the level of the others, so "
                "that directions are wrong; check cable and channel order, or remove it from array and channels",
                sensors=[name],
                allowed=SILENT,
            )


def _clipped(channels: Mapping[str, Channels]) -> Iterator[Check]:
    for name, own in channels.items():
        if loud := own.clipped():
            yield finding(
                SCALE,
                "note",
                "clipped",
                f"array {name}: microphone {_listed(loud)} is at full scale in up to {max(loud.values()):.1%} of the "
                f"samples (a note from {CLIPPED:.1%} on): directions of loud sounds may be off; record at a lower gain",
                sensors=[name],
                share=max(loud.values()),
                allowed=CLIPPED,
            )


def _alike(channels: Mapping[str, Channels]) -> Iterator[Check]:
    for name, own in channels.items():
        if same := own.alike():
            yield finding(
                APART,
                "warning",
                "microphones-alike",
                f"array {name}: microphones {_listed(same)} have the very same samples, so that directions are wrong: "
                "check how the channels were recorded and in which order they are given",
                sensors=[name],
            )


def _nothing(tallies: Mapping[str, DoaTally], rows: Mapping[str, int]) -> Iterator[Check]:
    for name, tally in tallies.items():
        if not rows[name]:
            yield finding(
                HEARD,
                "note",
                "no-directions",
                f"array {name} has no direction: of {tally.frames} frames {tally.silent} are silent, and in "
                f"{tally.unsure} no direction is sure enough",
                sensors=[name],
                frames=tally.frames,
            )


def _listed(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, numbers))
