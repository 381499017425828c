"""Streams of video in messages: H.264 and H.265, an access unit (picture) in each, as `foxglove.CompressedVideo`.

A decoder does not report a dropped picture, which would shift the times of later ones. So units are written to a
Matroska file with the message number as time stamp, which the decoder returns with each picture. Messages without
exactly one picture, reordered pictures, and missing pictures (`frame_num` of H.264) are detected in the stream headers
(ITU-T H.264 7.3, H.265 7.3). After a fault nothing is written until the next key frame, since pictures between depend
on a missing one.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from occlog.errors import InputError
from occlog.io.video.mkv import (
    BLOCK_HEAD,
    CLUSTER,
    CLUSTER_TIME,
    CODEC,
    EBML,
    ENTRY,
    FRAME_NS,
    INFO,
    NUMBER,
    SEGMENT,
    SIMPLE_BLOCK,
    TICK,
    TRACKS,
    TYPE,
    VIDEO,
)
from occlog.io.video.nal import SEQUENCE_PARAMETERS, HeaderBits, cropped, sequence_parameters, units

JPEG = b"\xff\xd8\xff"
OTHER_CODECS = ("av1", "vp8", "vp9")
"""Formats of video in messages that are not read."""
STEP_MS = 40
"""Time from one message to the next in the file that is decoded; the true times are those of the messages."""
AVC, HEVC = b"V_MPEG4/ISO/AVC", b"V_MPEGH/ISO/HEVC"
CODECS = {"h264": AVC, "avc": AVC, "h265": HEVC, "hevc": HEVC}
"""Names of formats in messages, and those of Matroska."""
WIDTH, HEIGHT, LACING, TRACK_ID = 0xB0, 0xBA, 0x9C, 0x73C5
ORDER = "{name} with B frames, which are stored in another order than shown: not read; record it without B frames"
_BEGIN = re.compile(rb"\x00{2,}\x01")


def is_video(encoding: str) -> bool:
    """Whether `encoding`, the format that a compressed image states, is a video stream (H.264 or H.265)."""
    return encoding.lower() in CODECS


class StreamOrderError(InputError):
    """Pictures of a stream are stored in another order than displayed, so that message times do not apply."""


class AccessUnit(NamedTuple):
    """Properties of an access unit (picture) of a video stream.

    Attributes:
        key: it is a key frame, which needs no other picture.
        follows: no reference picture before it is missing, by `frame_num`; always True for H.265, for which the decoder
            reports missing pictures.
    """

    key: bool
    follows: bool


class StreamReader:
    """Parser of the headers of the messages of one H.264 or H.265 stream, in order.

    `size` is known after a key frame.
    """

    def __init__(self, encoding: str) -> None:
        """Start before the first message of a stream with an encoding, a key of `CODECS` in any case of letters."""
        self.encoding = encoding.lower()
        self.size: tuple[int, int] | None = None
        self._avc = CODECS[self.encoding] == AVC
        self._number_bits = 0  # of frame_num (H.264), or of the order of pictures (H.265)
        self._planes = False
        self._fields = False
        self._extra_bits, self._output_flag = 0, False
        self._last: int | None = None  # frame_num or order of the last picture that others may be built on

    def read(self, data: bytes) -> AccessUnit:
        """Parse the headers of the next message, and return the properties of its picture.

        Raises:
            InputError: the message is not an Annex B stream, has no picture or several, or pictures are stored in
                another order than shown.
        """
        pictures: list[AccessUnit] = []
        try:
            for unit in units(data):
                found = self._avc_unit(unit) if self._avc else self._hevc_unit(unit)
                if found is not None:
                    pictures.append(found)
        except IndexError:
            raise InputError(
                f"a header of {self.encoding} video ends early; the message is damaged", id="damaged-file"
            ) from None
        if len(pictures) != 1:
            if not _BEGIN.match(data):
                what = "are JPEG; record it as jpeg" if data.startswith(JPEG) else "have no start codes (Annex B)"
                raise InputError(f"video is stated to be {self.encoding}, and its data {what}", id="damaged-file")
            raise InputError(
                f"a message of {self.encoding} video has {len(pictures)} pictures; exactly one was expected",
                id="damaged-file",
            )
        return pictures[0]

    def _avc_unit(self, unit: bytes) -> AccessUnit | None:
        kind, reference = unit[0] & 31, bool(unit[0] & 0x60)
        if kind == SEQUENCE_PARAMETERS:
            self.size, self._number_bits, self._planes, self._fields = sequence_parameters(unit)
            return None
        if kind not in (1, 5):
            return None
        bits = HeaderBits(unit[1:])
        first, slice_kind, _ = bits.golomb(), bits.golomb() % 5, bits.golomb()
        if slice_kind == 1:
            raise StreamOrderError(ORDER.format(name="H.264"))
        if first != 0:
            return None
        if not self._number_bits:
            return AccessUnit(False, False)
        if self._planes:
            bits.number(2)
        number = bits.number(self._number_bits)
        if self._fields and bits.number(1):
            raise InputError("interlaced H.264 is not read; record progressive video", id="unsupported-format")
        last, most = self._last, 1 << self._number_bits
        key = kind == 5
        follows = key or (last is not None and number in (last, (last + 1) % most))
        if reference or key:
            self._last = number
        return AccessUnit(key, follows)

    def _hevc_unit(self, unit: bytes) -> AccessUnit | None:
        kind = unit[0] >> 1 & 63
        if kind == 33:
            self._hevc_parameters(HeaderBits(unit[2:]))
        elif kind == 34:
            bits = HeaderBits(unit[2:])
            bits.golomb()
            bits.golomb()
            bits.number(1)
            self._output_flag, self._extra_bits = bool(bits.number(1)), bits.number(3)
        if kind > 31:
            return None
        bits = HeaderBits(unit[2:])
        if not bits.number(1):
            return None
        key = 16 <= kind <= 21
        if key:
            bits.number(1)
        bits.golomb()
        bits.number(self._extra_bits)
        bits.golomb()
        if not self._number_bits:
            return AccessUnit(False, False)
        bits.number(int(self._output_flag) + 2 * int(self._planes))
        order = 0 if kind in (19, 20) else bits.number(self._number_bits)
        most = 1 << self._number_bits
        if not key and self._last is not None and not 0 < (order - self._last) % most < most // 2:
            raise StreamOrderError(ORDER.format(name="H.265"))
        self._last = order
        return AccessUnit(key, True)

    def _hevc_parameters(self, bits: HeaderBits) -> None:
        bits.number(4)
        layers = bits.number(3)
        bits.number(1)
        bits.number(88)
        bits.number(8)
        there = [(bits.number(1), bits.number(1)) for _ in range(layers)]
        if layers:
            bits.number(2 * (8 - layers))
        for profile, level in there:
            bits.number(88 * profile + 8 * level)
        bits.golomb()
        chroma = bits.golomb()
        self._planes = chroma == 3 and bool(bits.number(1))
        width, height = bits.golomb(), bits.golomb()
        self.size = cropped(bits, width, height, chroma)
        bits.golomb()
        bits.golomb()
        self._number_bits = bits.golomb() + 4


def stream_size(data: bytes, encoding: str) -> tuple[int, int] | None:
    """Width and height [px] that a message of a video stream states; None if it states none.

    Args:
        data: the message.
        encoding: of the stream, a key of `CODECS` such as `h264`.

    Raises:
        InputError: the message is damaged.
    """
    reader = StreamReader(encoding)
    reader.read(data)
    return reader.size


class StreamFile:
    """Writer of a Matroska file with the pictures of one stream; the time stamp of each is its number times `STEP_MS`.

    Attributes:
        path: the file.
        count: number of pictures.
        keys: numbers of the key frames.
    """

    def __init__(self, path: Path, encoding: str, size: tuple[int, int]) -> None:
        """Create the file `path` for a stream with an encoding (key of `CODECS`) and image size (width, height)."""
        self.path, self.count = path, 0
        self.keys: list[int] = []
        self._file = path.open("wb")
        video = _element(VIDEO, _number(WIDTH, size[0]) + _number(HEIGHT, size[1]))
        entry = (
            _number(NUMBER, 1)
            + _number(TRACK_ID, 1)
            + _number(TYPE, 1)
            + _number(LACING, 0)
            + _number(FRAME_NS, STEP_MS * 10**6)
            + _element(CODEC, CODECS[encoding])
            + video
        )
        head = _element(EBML, _element(0x4282, b"matroska") + _number(0x4287, 4) + _number(0x4285, 2))
        info = _element(INFO, _number(TICK, 10**6) + _element(0x4D80, b"occlog") + _element(0x5741, b"occlog"))
        unknown = b"\x01" + b"\xff" * 7
        self._file.write(head + SEGMENT.to_bytes(4, "big") + unknown + info + _element(TRACKS, _element(ENTRY, entry)))

    def add(self, data: bytes, *, key: bool) -> None:
        """Append the next picture, `data`; `key`: it is a key frame."""
        if key:
            self.keys.append(self.count)
        block = _element(SIMPLE_BLOCK, BLOCK_HEAD + (b"\x80" if key else b"\0") + data)
        self._file.write(_element(CLUSTER, _number(CLUSTER_TIME, self.count * STEP_MS) + block))
        self.count += 1

    def close(self) -> None:
        """Close the file, which is complete then."""
        self._file.close()


def _element(name: int, data: bytes) -> bytes:
    length = next(n for n in range(1, 9) if len(data) < (1 << 7 * n) - 1)
    size = (len(data) | 1 << 7 * length).to_bytes(length, "big")
    return name.to_bytes((name.bit_length() + 7) // 8, "big") + size + data


def _number(name: int, value: int) -> bytes:
    return _element(name, value.to_bytes(max((value.bit_length() + 7) // 8, 1), "big"))
