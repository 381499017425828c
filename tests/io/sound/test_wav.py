"""WAV files of all kinds, read block by block; damaged ones as far as they go."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile

from occlog.errors import InputError
from occlog.io.formats.sound.wav import open_sound


def wav(
    path: Path,
    data: bytes,
    tag: int = 1,
    channels: int = 2,
    rate: int = 8000,
    bits: int = 16,
    length: int | None = None,
    extra: bytes = b"",
    kind: bytes = b"RIFF",
    form: bytes = b"",
) -> Path:
    fmt = struct.pack("<HHIIHH", tag, channels, rate, rate * channels * bits // 8, channels * bits // 8, bits) + form
    head = kind + struct.pack("<I", 0) + b"WAVE" + extra + b"fmt " + struct.pack("<I", len(fmt)) + fmt
    path.write_bytes(head + b"data" + struct.pack("<I", len(data) if length is None else length) + data)
    return path


def samples(path: Path, size: int = 7) -> np.ndarray:
    return np.concatenate(list(open_sound(path).blocks(size)))


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.int32, np.float32, np.float64])
def test_same_as_another_reader(tmp_path: Path, dtype: type) -> None:
    rng = np.random.default_rng(0)
    info = None if np.issubdtype(dtype, np.floating) else np.iinfo(dtype)
    x = rng.uniform(-1, 1, (50, 3)).astype(dtype) if info is None else rng.integers(info.min, info.max, (50, 3), dtype)
    wavfile.write(tmp_path / "a.wav", 16000, x)
    full = 1.0 if info is None else {1: 128.0, 2: 2.0**15, 4: 2.0**31}[x.itemsize]
    shift = 128.0 if dtype is np.uint8 else 0.0
    sound = open_sound(tmp_path / "a.wav")
    assert (sound.rate, sound.channels, sound.frames) == (16000, 3, 50)
    assert np.array_equal(samples(tmp_path / "a.wav"), (x.astype(float) - shift) / full)
    assert list(sound.blocks())
    assert not sound.losses


def test_24_bits_and_extensible_headers(tmp_path: Path) -> None:
    values = [0, 1, -1, 8388607, -8388608, 4194304]
    data = b"".join(struct.pack("<i", v)[:3] for v in values)
    expected = np.array(values, dtype=float).reshape(-1, 2) / 8388608
    assert np.array_equal(samples(wav(tmp_path / "a.wav", data, bits=24)), expected)
    form = struct.pack("<HHIH14s", 22, 24, 3, 1, bytes(14))
    assert np.array_equal(samples(wav(tmp_path / "b.wav", data, tag=0xFFFE, bits=24, form=form)), expected)
    assert np.array_equal(
        samples(wav(tmp_path / "c.wav", data, bits=24, extra=b"LIST\x03\x00\x00\x00abc\x00")), expected
    )


def test_files_above_4_gigabytes_state_their_length_elsewhere(tmp_path: Path) -> None:
    data = np.arange(8, dtype="<i2").tobytes()
    ds64 = b"ds64" + struct.pack("<IQQQI", 28, 0, len(data), 0, 0)
    path = wav(tmp_path / "a.wav", data + b"more", extra=ds64, kind=b"RF64", length=0xFFFFFFFF)
    assert open_sound(path).frames == 4


@pytest.mark.parametrize("length", [0, 0xFFFFFFFF])
def test_a_recording_that_was_not_finished_is_read_to_its_end(tmp_path: Path, length: int) -> None:
    sound = open_sound(wav(tmp_path / "a.wav", np.arange(10, dtype="<i2").tobytes(), length=length))
    assert sum(len(b) for b in sound.blocks()) == 5
    assert [loss.what for loss in sound.losses] == ["does not state the length; read to the end of the file"]


def test_what_is_cut_off_is_counted(tmp_path: Path) -> None:
    sound = open_sound(wav(tmp_path / "a.wav", np.arange(11, dtype="<i2").tobytes(), length=80))
    assert sum(len(b) for b in sound.blocks()) == 5
    assert [(loss.place, loss.count) for loss in sound.losses] == [("frame 5", 15)]


@pytest.mark.parametrize(
    ("behind", "lost"),
    [
        (b"", False),
        (bytes(8), False),
        (b"LIST" + struct.pack("<I", 3) + b"abc\0" + b"id3 " + struct.pack("<I", 9), False),
        (b"LIST" + struct.pack("<I", 3) + b"abc" + b"id3 " + struct.pack("<I", 5) + b"abcde", False),  # not padded
        (np.arange(9, dtype="<i2").tobytes(), True),
        (bytes(100), True),
        (b"LIST" + struct.pack("<I", 4) + b"abcd" + b"data" + struct.pack("<I", 4) + b"abcd", True),
        (b"LIST\0\0\0\0" * 2000, True),
    ],
)
def test_samples_behind_those_of_the_header_are_reported(tmp_path: Path, behind: bytes, lost: bool) -> None:
    """A header has room for 4 GiB alone: of 5 GiB it says one, and a recorder may not say what it added."""
    data = np.arange(10, dtype="<i2").tobytes()
    path = wav(tmp_path / "a.wav", data + behind, length=len(data))
    sound = open_sound(path)
    assert sum(len(b) for b in sound.blocks()) == 5
    begin = path.stat().st_size - len(behind)
    assert [(loss.place, loss.what[:20]) for loss in sound.losses] == (
        [(f"byte {begin}", f"{len(behind)} bytes from there on"[:20])] if lost else []
    )


def test_a_format_of_an_odd_length_is_padded(tmp_path: Path) -> None:
    data = np.arange(10, dtype="<i2").tobytes()
    path = wav(tmp_path / "a.wav", data, form=b"\0")
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b"\0data", b"\0\0data"))
    assert open_sound(path).frames == 5


@pytest.mark.parametrize("wrong", [np.nan, 1e31, -3e38])
def test_samples_that_are_no_numbers_are_counted(tmp_path: Path, wrong: float) -> None:
    """Of large ones the squares were infinite, and frames of sound were left out without a word."""
    x = np.ones((9, 2), dtype="<f4")
    x[4, 1], x[7] = wrong, np.inf
    sound = open_sound(wav(tmp_path / "a.wav", x.tobytes(), tag=3, bits=32))
    read = np.concatenate(list(sound.blocks(4)))
    assert read.sum() == 15
    assert [(loss.place, loss.count) for loss in sound.losses] == [("frame 4 and later", 2)]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p.write_bytes(b""), "is empty"),
        (lambda p: p.write_bytes(b"RIFF"), "is not a WAV file"),
        (lambda p: p.write_bytes(b"fLaC" + bytes(100)), "is not a WAV file"),
        (lambda p: p.write_bytes(p.read_bytes()[:30]), "no samples"),
        (lambda p: wav(p, b""), "holds no sound"),
        (lambda p: wav(p, b"abc"), "holds no sound"),
        (lambda p: wav(p, bytes(100), tag=7), "format 7 with 16 bits"),
        (lambda p: wav(p, bytes(100), bits=12), "with 12 bits"),
        (lambda p: wav(p, bytes(100), channels=0), "0 channels"),
        (lambda p: wav(p, bytes(100), rate=0), "at 0 Hz"),
    ],
)
def test_faults_are_one_line(tmp_path: Path, change, message: str) -> None:
    path = wav(tmp_path / "a.wav", bytes(100))
    change(path)
    with pytest.raises(InputError, match=message) as caught:
        open_sound(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_most_channels_and_the_highest_rate_are_read_and_no_more(tmp_path: Path) -> None:
    path = tmp_path / "a.wav"
    assert open_sound(wav(path, bytes(2 * 4096), channels=4096)).channels == 4096
    assert open_sound(wav(path, bytes(100), rate=10_000_000)).rate == 10_000_000
    with pytest.raises(InputError, match="4097 channels"):
        open_sound(wav(path, bytes(2 * 4097), channels=4097))
    with pytest.raises(InputError, match="at 10000001 Hz"):
        open_sound(wav(path, bytes(100), rate=10_000_001))


def test_samples_that_are_padded_are_refused(tmp_path: Path) -> None:
    """24 bits in 4 bytes were read as 24 bits in 3: noise."""
    path = wav(tmp_path / "a.wav", bytes(64), bits=24, channels=1)
    content = bytearray(path.read_bytes())
    content[32:34] = struct.pack("<H", 4)  # bytes of a sample of all channels
    path.write_bytes(content)
    with pytest.raises(InputError, match="4 bytes for 1 samples of 24 bits; they are padded"):
        open_sound(path)
