"""Reading of WAV files block by block; damaged files are read up to the damage.

The standard library's reader supports no floats, and SciPy's no truncated files and no streaming. Supported: RIFF and
RF64, integers of 8, 16, 24 and 32 bits, floats of 32 and 64 bits, plain and extensible headers.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.files.limits import check_input
from occlog.records.losses import Loss

WHAT = "a WAV file"
PCM, FLOAT, EXTENSIBLE = 1, 3, 0xFFFE
OPEN = (0, 0xFFFFFFFF)
"""Lengths that a recorder writes first and corrects at the end."""
MAX_CHUNKS = 1000
"""Chunks behind the samples that are read."""
MAX_CHANNELS, MAX_RATE = 4096, 10_000_000
LOUDEST = 1e30
"""Full scale is 1; squares of much more leave the range of numbers."""


@dataclass
class Sound:
    """An opened WAV file: its format and length; `losses` is complete after all blocks have been read."""

    path: Path
    channels: int
    rate: int  # frames per second
    bits: int
    floats: bool
    start: int  # byte at which the samples begin
    frames: int  # that are there, one sample a channel
    promised: int | None  # frames by the header; None: it does not state
    losses: list[Loss] = field(default_factory=list)

    def blocks(self, size: int = 65536) -> Iterator[Floats]:
        """Yield samples (n, channels) with full scale 1, in blocks of `size` time steps.

        Samples that are no numbers or beyond 1e30 become 0; these, and missing ones at the end, are added to `losses`.
        """
        if self.promised is None:
            self.losses.append(Loss(self.path.name, "header", "does not state the length; read to the end of the file"))
        elif self.frames < self.promised:
            self.losses.append(
                Loss(self.path.name, f"frame {self.frames}", "the file ends too early", self.promised - self.frames)
            )
        bad, first = 0, 0
        with self.path.open("rb") as file:
            file.seek(self.start)
            for begin in range(0, self.frames, size):
                n = min(size, self.frames - begin)
                samples = self._samples(file.read(n * self.channels * self.bits // 8))
                wrong = ~(np.abs(samples) <= LOUDEST)
                if wrong.any():
                    rows = np.flatnonzero(wrong.any(axis=1))
                    first = first if bad else begin + int(rows[0])
                    bad += len(rows)
                    samples[wrong] = 0.0
                yield samples
        if bad:
            self.losses.append(
                Loss(
                    self.path.name,
                    f"frame {first} and later",
                    "samples that are no numbers, or beyond 1e30, were replaced by 0",
                    bad,
                )
            )

    def _samples(self, data: bytes) -> Floats:
        width = self.bits // 8
        usable = len(data) // (width * self.channels) * (width * self.channels)
        data = data[:usable]
        if self.floats:
            with np.errstate(invalid="ignore"):  # a NaN that signals is one like others
                flat = np.frombuffer(data, dtype=f"<f{width}").astype(np.float64)
        elif width == 1:
            flat = (np.frombuffer(data, dtype=np.uint8).astype(np.float64) - 128.0) / 128.0
        elif width == 3:
            octets = np.frombuffer(data, dtype=np.uint8).reshape(-1, 3).astype(np.int32)
            whole = octets[:, 0] | octets[:, 1] << 8 | octets[:, 2] << 16
            flat = (whole - ((whole & 0x800000) << 1)) / 8388608.0
        else:
            flat = np.frombuffer(data, dtype=f"<i{width}").astype(np.float64) / 2.0 ** (self.bits - 1)
        return np.asarray(flat.reshape(-1, self.channels), dtype=np.float64)


def open_sound(path: Path) -> Sound:
    """Parse the header of a WAV file; InputError if it is another file, has an unsupported format, or no samples."""
    check_input(path, WHAT)
    size = path.stat().st_size
    with path.open("rb") as file:
        kind = file.read(12)
        if len(kind) < 12 or kind[:4] not in (b"RIFF", b"RF64") or kind[8:] != b"WAVE":
            raise InputError(
                f"{path}: is not {WHAT} (RIFF/WAVE); convert it, e.g. with `ffmpeg -i IN out.wav`", id="unknown-format"
            )
        form, start, length = _chunks(path, file, kind[:4] == b"RF64")
    channels, rate, bits, floats = _format(path, form)
    frame = channels * bits // 8
    there = (size - start) // frame
    known = length not in OPEN
    frames = min(there, length // frame) if known else there
    if frames == 0:
        raise InputError(f"{path}: holds no sound (0 samples); make it again", id="empty-input")
    return Sound(
        path=path,
        channels=channels,
        rate=rate,
        bits=bits,
        floats=floats,
        start=start,
        frames=frames,
        promised=length // frame if known else None,
        losses=[_left(path, start + length)] if known and _is_more(path, start + length) else [],
    )


def _is_more(path: Path, at: int) -> bool:
    """Whether the bytes after the declared samples, from byte `at` on, are more samples or a second `data` chunk.

    False for chunks of other kinds.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        for _ in range(MAX_CHUNKS):
            if size - at < 9:
                return False
            file.seek(at)
            head = file.read(9)
            # Chunks begin at even bytes, though some programs do not see to that
            skipped = at % 2 if _is_name(head[at % 2 :][:4]) else 0
            name, length = struct.unpack_from("<4sI", head, skipped)
            if name == b"data" or not _is_name(name):
                return True
            at += skipped + 8 + length
    return True


def _is_name(name: bytes) -> bool:
    return all(0x20 <= byte < 0x7F for byte in name)


def _left(path: Path, at: int) -> Loss:
    rest = path.stat().st_size - at
    what = (
        f"{rest} bytes from there on were not read: the header states a length of the samples that is too short, as "
        "where it has room for 4 GiB alone; convert the file again"
    )
    return Loss(path.name, f"byte {at}", what)


def _chunks(path: Path, file: BinaryIO, large: bool) -> tuple[bytes, int, int]:
    """Content of the format chunk, first byte of the samples, and their declared size [bytes].

    Args:
        path: file, for messages.
        file: the open file, behind its first 12 bytes.
        large: it is RF64, with sizes of 64 bits.

    Raises:
        InputError: the format chunk or the samples are missing.
    """
    form: bytes | None = None
    long_length: int | None = None
    while len(head := file.read(8)) == 8:
        name, length = struct.unpack("<4sI", head)
        padding = length % 2
        if name == b"data":
            if form is None:
                raise InputError(
                    f"{path}: has no format (`fmt `) before its samples; convert it again", id="damaged-file"
                )
            return form, file.tell(), long_length if large and long_length is not None else length
        if name in (b"fmt ", b"ds64"):
            body = file.read(min(length, 4096))
            if name == b"fmt ":
                form = body
            elif len(body) >= 16:
                long_length = struct.unpack("<Q", body[8:16])[0]
            length -= len(body)
        file.seek(length + padding, os.SEEK_CUR)
    raise InputError(f"{path}: has no samples (no `data`); it is cut off or damaged, copy it again", id="empty-input")


def _format(path: Path, form: bytes) -> tuple[int, int, int, bool]:
    """Channels, sampling rate [Hz], bits per sample, and whether samples are floats.

    `form` are the bytes of the format chunk. InputError for unsupported or damaged formats.
    """
    if len(form) < 16:
        raise InputError(f"{path}: its format (`fmt `) is cut off; convert it again", id="damaged-file")
    tag, channels, rate, _, block, bits = struct.unpack("<HHIIHH", form[:16])
    if tag == EXTENSIBLE and len(form) >= 26:
        tag = struct.unpack("<H", form[24:26])[0]
    good = {PCM: (8, 16, 24, 32), FLOAT: (32, 64)}.get(tag, ())
    if bits not in good:
        raise InputError(
            f"{path}: samples of format {tag} with {bits} bits; expected 8 to 32 bit integers or 32 or 64 bit floats; "
            "convert it, e.g. with `ffmpeg -i IN -c:a pcm_s16le out.wav`",
            id="unsupported-format",
        )
    if block != channels * bits // 8:
        raise InputError(
            f"{path}: {block} bytes for {channels} samples of {bits} bits; they are padded, or the header is damaged; "
            "convert it, e.g. with `ffmpeg -i IN -c:a pcm_s16le out.wav`",
            id="damaged-file",
        )
    if not 1 <= channels <= MAX_CHANNELS or not 1 <= rate <= MAX_RATE:
        raise InputError(
            f"{path}: {channels} channels at {rate} Hz are impossible; the header is damaged, copy the file again",
            id="damaged-file",
        )
    return channels, rate, bits, tag == FLOAT
