"""Small videos whose frames carry their own number, whole and damaged."""

from __future__ import annotations

import os
import struct
from functools import cache
from pathlib import Path

import cv2
import numpy as np

WIDTH, HEIGHT, BITS, CELL = 160, 120, 8, 20
FRAMES = 40
FPS = 20.0
KINDS = {
    "ffv1.mkv": "FFV1",
    "ffv1.avi": "FFV1",
    "ffv1.mp4": "FFV1",
    "mjpg.avi": "MJPG",
    "mjpg.mkv": "MJPG",
    "mjpg.mp4": "MJPG",
    "mp4v.mp4": "mp4v",
    "mp4v.avi": "mp4v",
    "mp4v.mkv": "mp4v",
    "vp8.webm": "VP80",
}


@cache
def _texture() -> np.ndarray:
    rng = np.random.default_rng(0)
    return cv2.GaussianBlur(rng.integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8), (0, 0), 2)


def numbered(index: int, size: tuple[int, int] = (WIDTH, HEIGHT)) -> np.ndarray:
    """An image that shows its number as a row of light and dark squares above a texture."""
    image = _texture().copy()
    for bit in range(BITS):
        level = 230 if index >> bit & 1 else 20
        cv2.rectangle(image, (bit * CELL, 0), (bit * CELL + CELL - 1, 59), (level,) * 3, -1)
    return image if size == (WIDTH, HEIGHT) else cv2.resize(image, size)


def number_shown(image: np.ndarray) -> int:
    """The number that an image shows; only its upper part is looked at."""
    return sum(1 << bit for bit in range(BITS) if image[20:40, bit * CELL + 6 : bit * CELL + 14].mean() > 128)


def write_video(path: Path, frames: int = FRAMES, fourcc: str | None = None) -> Path:
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    code = cv2.VideoWriter_fourcc(*(fourcc or KINDS[path.name]))
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, FPS, (WIDTH, HEIGHT))
    assert writer.isOpened()
    for index in range(frames):
        writer.write(numbered(index))
    writer.release()
    return path


def jpeg(index: int, size: tuple[int, int] = (WIDTH, HEIGHT)) -> bytes:
    return cv2.imencode(".jpg", numbered(index, size))[1].tobytes()


def avi(
    chunks: list[bytes], rate: int = 20, announced: int | None = None, start: int = 0, codec: bytes = b"MJPG"
) -> bytes:
    """An AVI file of given chunks (an empty one is a frame that the recorder dropped), motion JPEG if not stated."""
    strh = struct.pack(
        "<4s4sIHHIIIIIIII8s",
        b"vids",
        codec,
        0,
        0,
        0,
        0,
        1,
        rate,
        start,
        len(chunks) if announced is None else announced,
        0,
        0xFFFFFFFF,
        0,
        b"\0" * 8,
    )
    strf = struct.pack("<IiiHH4sIiiII", 40, WIDTH, HEIGHT, 1, 24, codec, WIDTH * HEIGHT * 3, 0, 0, 0, 0)
    avih = struct.pack("<14I", 1000000 // rate, 0, 0, 0x10, len(chunks), 0, 1, 0, WIDTH, HEIGHT, 0, 0, 0, 0)
    hdrl = _list(b"hdrl", _chunk(b"avih", avih) + _list(b"strl", _chunk(b"strh", strh) + _chunk(b"strf", strf)))
    body, index = b"", b""
    for data in chunks:
        index += struct.pack("<4sIII", b"00dc", 0x10, 4 + len(body), len(data))
        body += _chunk(b"00dc", data)
    return _chunk(b"RIFF", b"AVI " + hdrl + _list(b"movi", body) + _chunk(b"idx1", index))


def _chunk(name: bytes, data: bytes) -> bytes:
    return name + struct.pack("<I", len(data)) + data + b"\0" * (len(data) & 1)


def _list(name: bytes, data: bytes) -> bytes:
    return _chunk(b"LIST", name + data)


def box(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I4s", len(data) + 8, name) + data


def top_boxes(data: bytes) -> dict[bytes, bytes]:
    """Content of the boxes at the top of an MP4 file."""
    out, at = {}, 0
    while at < len(data):
        size, name = struct.unpack_from(">I4s", data, at)
        out[name] = data[at + 8 : at + size]
        at += size
    return out


def faststart(data: bytes) -> bytes:
    """The MP4 file with its index before the pictures, as for streaming."""
    parts = top_boxes(data)
    moov = bytearray(parts[b"moov"])
    at = moov.index(b"stco") + 4
    (count,) = struct.unpack_from(">I", moov, at + 4)
    old = data.index(b"mdat") + 4
    new = len(box(b"ftyp", parts[b"ftyp"])) + len(moov) + 8 + 8
    for k in range(count):
        place = at + 8 + 4 * k
        struct.pack_into(">I", moov, place, struct.unpack_from(">I", moov, place)[0] - old + new)
    return box(b"ftyp", parts[b"ftyp"]) + box(b"moov", bytes(moov)) + box(b"mdat", parts[b"mdat"])


def fragmented(data: bytes, per_fragment: int = 10) -> bytes:
    """The MP4 file (intra-coded, one chunk) with its samples in movie fragments and an empty index."""
    parts = top_boxes(data)
    moov = parts[b"moov"]
    at = moov.index(b"stsz") + 4
    (count,) = struct.unpack_from(">I", moov, at + 8)
    sizes = struct.unpack_from(f">{count}I", moov, at + 12)
    (duration,) = struct.unpack_from(">I", moov, moov.index(b"stts") + 16)
    samples, offset = [], 0
    for size in sizes:
        samples.append(parts[b"mdat"][offset : offset + size])
        offset += size
    out = box(b"ftyp", parts[b"ftyp"]) + box(b"moov", _emptied(moov))
    for first in range(0, count, per_fragment):
        out += _fragment(first, samples[first : first + per_fragment], duration)
    return out


def _emptied(moov: bytes) -> bytes:
    """The index without samples and edit list, with the box that says that fragments follow."""
    start = moov.index(b"stbl") - 4
    (stbl_size,) = struct.unpack_from(">I", moov, start)
    stsd = moov[start + 8 : start + 8 + struct.unpack_from(">I", moov, start + 8)[0]]
    none = b"\0" * 8
    stbl = box(
        b"stbl", stsd + box(b"stts", none) + box(b"stsc", none) + box(b"stsz", none + b"\0" * 4) + box(b"stco", none)
    )
    changed = moov[:start] + stbl + moov[start + stbl_size :]
    edts = changed.index(b"edts") - 4
    (edts_size,) = struct.unpack_from(">I", changed, edts)
    shrunk = changed[:edts] + changed[edts + edts_size :]
    shift = len(stbl) - stbl_size
    fixed = bytearray(shrunk)
    for name, change in ((b"trak", shift - edts_size), (b"mdia", shift), (b"minf", shift)):
        place = fixed.index(name) - 4
        struct.pack_into(">I", fixed, place, struct.unpack_from(">I", fixed, place)[0] + change)
    return bytes(fixed) + box(b"mvex", box(b"trex", struct.pack(">6I", 0, 1, 1, 0, 0, 0)))


def _fragment(first: int, samples: list[bytes], duration: int) -> bytes:
    rows = b"".join(struct.pack(">II", duration, len(s)) for s in samples)

    def moof(offset: int) -> bytes:
        tfhd = box(b"tfhd", struct.pack(">II", 0x020000, 1))
        tfdt = box(b"tfdt", struct.pack(">IQ", 0x01000000, first * duration))
        trun = box(b"trun", struct.pack(">IIi", 0x000301, len(samples), offset) + rows)
        return box(b"moof", box(b"mfhd", struct.pack(">II", 0, first + 1)) + box(b"traf", tfhd + tfdt + trun))

    return moof(len(moof(0)) + 8) + box(b"mdat", b"".join(samples))
