"""Compressed images: size and damage from their bytes, encoding, decoding with limits.

Also detects images with several pictures (animations, TIFF pages, MPO views), of which decoders return one; the
brightness range of PNM images; and the size of each frame in a video's compressed data, since OpenCV scales every frame
to the size of the first one (motion JPEG, PNG, VP8, H.264).
"""

from __future__ import annotations

import math
import re
import struct
import zlib
from bisect import bisect_right
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np

from occlog.errors import InputError
from occlog.io.video.nal import SEQUENCE_PARAMETERS, sequence_parameters, units
from occlog.records.frames import Image

from ..files.names import utf8_name
from ..files.programs import START, describe_program
from .limits import MAX_PIXELS

SEVERAL = (
    "several pictures (an animation, pages or views), of which decoders give one; write each as an image, or give "
    "them as a video"
)
_ANIMATED_WEBP = 0x02
"""Bit of the first part of a WebP image that states that it has several pictures."""
_GIF_IMAGE, _GIF_EXTENSION = 0x2C, 0x21
"""First bytes of GIF blocks: a picture, and all other kinds."""
_SEQUENCE, _SAMPLES = b"avis", b"stsz"
"""Brand of AVIF with a sequence of pictures, and the box of MP4 that states about each track how many it has."""
_ORDERS = {b"II": "<", b"MM": ">"}
_KIND_OF_PAGE, _NO_PAGE = 254, 0b101
"""Tag of TIFF that states what a picture is, and its bits for smaller copies and masks of other pictures."""
_LIST_OF_VIEWS, _VIEW_BYTES = 0xB002, 16
_VIEW = 0x020000
"""Kind of the pictures of a panorama, of two eyes, or of several positions; previews are of another one."""
_UNDEFINED = 0x000000
_LIGHT = (b"hdrgm:", b"hdrgainmap")
"""Words by which a picture of undefined kind is recognised as a map of brightness for the first one."""
_MPO_BYTES = 1 << 17
"""Bytes of a JPEG image among which its list of views begins."""


def is_multi_image(data: bytes) -> bool:
    """Whether an image file (WebP, GIF, AVIF, TIFF, JPEG) holds several different pictures; `data` are its bytes.

    Damaged files count as single.
    """
    if data[:4] == b"RIFF":
        return data[8:16] == b"WEBPVP8X" and bool(data[20:21]) and bool(data[20] & _ANIMATED_WEBP)
    try:
        if data[:6] in (b"GIF87a", b"GIF89a"):
            return _blocks(data) > 1
        if data[4:8] == b"ftyp":
            return _sequence(data) > 1
        if data[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
            return _pages(data) > 1
        return data[:3] == b"\xff\xd8\xff" and _views(data) > 1
    except struct.error:  # damage is reported by the decoder
        return False


def _blocks(data: bytes) -> int:
    """Number of pictures in a GIF file (bytes), at most 2."""
    at, pictures = 13 + _colours(data, 10), 0
    while pictures < 2 and at < len(data):
        if data[at] == _GIF_IMAGE:
            pictures += 1
            at += 11 + _colours(data, at + 9)
        elif data[at] == _GIF_EXTENSION:
            at += 2
        else:  # the end, or damage
            break
        while at < len(data) and data[at]:
            at += 1 + data[at]
        at += 1
    return pictures


def _colours(data: bytes, at: int) -> int:
    """Size [bytes] of the colour table that the GIF flag byte at index `at` declares; 0: there is none."""
    (flags,) = struct.unpack_from("B", data, at)
    return 3 << (flags & 7) + 1 if flags & 0x80 else 0


def _sequence(data: bytes) -> int:
    """Number of pictures in the longest track of an AVIF file (bytes); 1 for a single image."""
    (size,) = struct.unpack_from(">I", data)
    pictures, at = 1, size
    if _SEQUENCE in data[8:size]:
        while (at := data.find(_SAMPLES, at)) >= 0:
            pictures = max(pictures, struct.unpack_from(">I", data, at + 12)[0])
            at += 16
    return pictures


def _pages(data: bytes) -> int:
    """Number of pages of a TIFF file (bytes), at most 2, without thumbnails and masks."""
    order, large = _ORDERS[data[:2]], b"+" in data[:4]
    count, entry, offset_format = ("Q", 20, "Q") if large else ("H", 12, "I")
    (at,) = struct.unpack_from(order + offset_format, data, 8 if large else 4)
    seen, pages = set[int](), 0
    while at and at not in seen and pages < 2:
        seen.add(at)
        (n,) = struct.unpack_from(order + count, data, at)
        begin = at + struct.calcsize(order + count)
        (at,) = struct.unpack_from(order + offset_format, data, begin + n * entry)
        pages += not _is_copy(data, order, begin, n, entry)
    return pages


def _is_copy(data: bytes, order: str, begin: int, count: int, entry: int) -> bool:
    """Whether the entries of a TIFF page mark it as a thumbnail or mask of another page.

    Args:
        data: TIFF file.
        order: byte order, `<` or `>`.
        begin: first byte of the entries.
        count: their number.
        entry: bytes of one.
    """
    for at in range(begin, begin + count * entry, entry):
        (tag,) = struct.unpack_from(order + "H", data, at)
        if tag == _KIND_OF_PAGE:
            (kind,) = struct.unpack_from(order + "I", data, at + entry - (8 if entry == 20 else 4))
            return bool(kind & _NO_PAGE)
        if tag > _KIND_OF_PAGE:
            break
    return False


def _views(data: bytes) -> int:
    """Number of pictures in a JPEG file (multi-picture format, CIPA DC-007), without previews and gain maps."""
    base = data.find(b"MPF\0", 0, _MPO_BYTES) + 4
    order = _ORDERS.get(data[base : base + 2]) if base > 3 else None
    if order is None:
        return 1
    begin = base + struct.unpack_from(order + "I", data, base + 4)[0]
    for each in range(struct.unpack_from(order + "H", data, begin)[0]):
        tag, _, size, at = struct.unpack_from(order + "HHII", data, begin + 2 + 12 * each)
        if tag == _LIST_OF_VIEWS:
            size = min(size, len(data) - base - at)
            offsets = range(base + at, base + at + size - _VIEW_BYTES + 1, _VIEW_BYTES)
            kinds = [struct.unpack_from(order + "I", data, offset)[0] & 0xFFFFFF for offset in offsets]
            others = [kind for kind in kinds[1:] if kind & 0xFF0000 == _VIEW or kind == _UNDEFINED]
            light = all(kind == _UNDEFINED for kind in others) and any(word in data for word in _LIGHT)
            return 1 + (0 if light else len(others))
    return 1


_HEAD = re.compile(rb"P([2356])" + rb"(?:\s|#[^\r\n]*[\r\n])+(\d{1,9})" * 3)
FULL, FULL_16 = 255, 65535


def stated_white(data: bytes) -> int | None:
    """Maximum value (white) that the header of a PNM file declares; None for other files."""
    found = _HEAD.match(data)
    return None if found is None else int(found[4])


def is_scaled(data: bytes, most: int) -> bool:
    """Whether OpenCV scales the declared maximum `most` of a PNM file (`data`) to 255.

    It does for text with a maximum up to 255, and for the full range of 8 or 16 bits.
    """
    return most in (FULL, FULL_16) or (most < FULL and data[1:2] in (b"2", b"3"))


def scaled(image: np.ndarray, most: int) -> Image:
    """Image of 8 bits in which the declared maximum `most` of a decoded image is 255, rounded down as OpenCV does."""
    shades = (np.arange(most + 1) * FULL // most).astype(np.uint8)
    out = np.empty(image.shape, np.uint8)
    for row, values in zip(out, image, strict=True):  # all at once would take eight bytes for each value
        row[...] = shades[np.minimum(values, most)]
    return out


MAX_SCANS = 200
"""Scans of a JPEG image at most: progressive ones have some ten, and each passes over all pixels again."""
PNG_MARK = b"\x89PNG\r\n\x1a\n"
ORIENTATION = (0x0112, 3, 1)
"""Tag, type and count of the entry of Exif data that states how an image has to be turned."""
SIDEWAYS = (5, 6, 7, 8)
"""Values of it by which width and height are exchanged."""
EXIF_BYTES = 1 << 16
"""Bytes of a JPEG image among which its Exif data begin."""
DEEP_MARKS = (b"II*\0", b"MM\0*", b"P2", b"P3", b"P5", b"P6")
"""First bytes of TIFF, PGM and PPM files with values that may have 16 bits; of PNG a byte states it."""
DARK_16, DIM_16 = 4095, 16383
"""Largest of values of 16 bits up to which they are taken for values of 12 bits or fewer, which state it nowhere, and
up to which they may be values of 14 bits."""
DARK = (
    "values of 16 bits up to {most} of 65535, which as 8 bits would be nearly black; scale them to the whole range, or "
    "write 8 bits"
)
"""Fault of pictures of which `is_dark` holds."""
Facts = list[tuple[str, dict[str, str | float]]]
"""Ids of findings (`occlog.records.messages.VERDICT`) of what a file states of its pictures, with their values."""
BLACK, MIN_SAME = 24, 10
"""Mean of the brightest channel up to which a row or column is a black bar, as codecs leave some noise in it, also the
largest value of a black image; and number of identical images from which they are stated."""


def image_kind(data: bytes) -> str | None:
    """`png` or `jpeg` by the first bytes of an image file; None for other files."""
    if data.startswith(PNG_MARK):
        return "png"
    return "jpeg" if data.startswith(b"\xff\xd8\xff") else None


def image_size(data: bytes) -> tuple[int, int] | None:
    """Width and height [px] of a PNG or JPEG file by its header, before rotation.

    None if not stated, or for other files.
    """
    if image_kind(data) == "png" and len(data) >= 24:
        width, height = struct.unpack_from(">II", data, 16)
        return int(width), int(height)
    return _jpeg_size(data) if image_kind(data) == "jpeg" else None


def shown_size(data: bytes) -> tuple[int, int] | None:
    """Width and height [px] of a PNG or JPEG file as decoded, after the rotation by its Exif data; None if unknown."""
    size = image_size(data)
    return size if size is None or _orientation(data) not in SIDEWAYS else size[::-1]


def _orientation(data: bytes) -> int:
    """Exif orientation of a PNG or JPEG file, 1 to 8; 1 (no rotation) if missing."""
    png = image_kind(data) == "png"
    at = data.find(b"eXIf", 0, data.find(b"IDAT")) + 4 if png else data.find(b"Exif\0\0", 0, EXIF_BYTES) + 6
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(data[at : at + 4])
    if order is None:
        return 1
    with suppress(struct.error):
        begin = at + struct.unpack_from(f"{order}I", data, at + 4)[0]
        for entry in range(struct.unpack_from(f"{order}H", data, begin)[0]):
            tag, kind, count, value = struct.unpack_from(f"{order}HHIH", data, begin + 2 + 12 * entry)
            if (tag, kind, count) == ORIENTATION:
                return int(value)
    return 1


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    at = 2
    # As decoders do, from mark to mark, regardless of the data between
    while 0 <= (at := data.find(b"\xff", at)) <= len(data) - 9:
        mark, length = data[at + 1], struct.unpack_from(">H", data, at + 2)[0]
        # The frame header is one of SOF0..SOF15 without DHT (c4), JPG (c8) and DAC (cc).
        if 0xC0 <= mark <= 0xCF and mark not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", data, at + 5)
            return int(width), int(height)
        alone = mark in (0x00, 0x01) or 0xD0 <= mark <= 0xD9  # of these no length follows
        at += 1 if mark == 0xFF else 2 if alone else 2 + length
    return None


def image_damage(data: bytes) -> str | None:
    """Description of damage that markers and check sums of a PNG or JPEG file reveal, or of several pictures in it.

    None if the file is intact.
    """
    kind = image_kind(data)
    if kind == "png":
        return _png_damage(data)
    if kind == "jpeg" and b"\xff\xd9" not in data[-1024:]:
        return "cut short: the end mark of a JPEG image is missing"
    if kind == "jpeg" and (scans := _scans(data)) > MAX_SCANS:
        return f"{scans} scans; a JPEG image of at most {MAX_SCANS} was expected"
    return SEVERAL if is_multi_image(data) else None


def _scans(data: bytes) -> int:
    """Number of scans of a JPEG file (bytes), by their markers."""
    values = np.frombuffer(data, np.uint8)
    return int(np.count_nonzero((values[:-1] == 0xFF) & (values[1:] == 0xDA)))


def _png_damage(data: bytes) -> str | None:
    at = len(PNG_MARK)
    while at + 12 <= len(data):
        length, name = struct.unpack_from(">I4s", data, at)
        end = at + 12 + length
        if end > len(data):
            break
        if zlib.crc32(data[at + 4 : end - 4]) != struct.unpack_from(">I", data, end - 4)[0]:
            return f"wrong check sum of PNG part {name.decode('ascii', 'backslashreplace')} at byte {at}"
        if name == b"acTL" and int.from_bytes(data[at + 8 : at + 12], "big") > 1:
            return SEVERAL
        if name == b"IEND":
            return None
        at = end
    return "cut short: the end mark of a PNG image is missing"


def check_image(data: bytes, where: str) -> None:
    """InputError for an image file that is too large, damaged by its markers and check sums, or holds several pictures.

    `where` names the image, for messages.
    """
    size = image_size(data)
    if size is not None and size[0] * size[1] > MAX_PIXELS:
        raise InputError(
            f"{where}: {size[0]} x {size[1]} px; the limit is {MAX_PIXELS} pixels; scale it down", id="input-too-large"
        )
    damage = image_damage(data)
    if damage:
        raise InputError(f"{where}: {damage}")


def decode_image(data: bytes, where: str) -> Image:
    """Decode an image file: (h, w, 3) BGR or (h, w) grey, 8 bits; rotated by its Exif data.

    For use in the decoding process, which parses untrusted bytes in place of the command. `where` names the image in
    messages.

    Raises:
        InputError: the image is damaged, too large, of an unknown format, or nearly black in 8 bits.
    """
    check_image(data, where)
    most = stated_white(data)
    unscaled = most is not None and 0 < most < FULL_16 and not is_scaled(data, most)
    how = cv2.IMREAD_ANYCOLOR | (cv2.IMREAD_ANYDEPTH if unscaled else 0)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), how) if data else None
    except cv2.error as error:
        if error.func == "validateInputImageSize":
            raise InputError(
                f"{where}: has more pixels than the limit, {MAX_PIXELS}; scale it down", id="input-too-large"
            ) from None
        raise InputError(
            f"{where}: cannot be decoded ({' '.join(str(error.err).split())}); copy or repair it", id="damaged-file"
        ) from None
    if image is None and data.startswith(DEEP_MARKS[:2]) and _is_float(data):
        raise InputError(f"{where}: its values are no whole numbers; write 8 bits, 0 to 255", id="unsupported-format")
    if image is None and (program := describe_program(data[:START])) is not None:
        raise InputError(f"{where}: {program}", id="unsupported-format")
    if image is None:
        raise InputError(
            f"{where}: not an image, or a damaged one ({len(data)} bytes); copy or convert it", id="damaged-file"
        )
    if unscaled and most is not None:
        return scaled(image, most)
    _check_depth(data, where)
    return image  # type: ignore[no-any-return]


def _is_float(data: bytes) -> bool:
    """Whether the values of an image file, whatever they are, are floating-point numbers."""
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    return image is not None and image.dtype.kind == "f"


def _check_depth(data: bytes, where: str) -> None:
    """InputError for 16-bit images that use their lowest 12 bits only, since only the upper 8 bits are decoded.

    `data` is the file, `where` names it in messages.
    """
    if not _is_deep(data):
        return
    deep = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)
    if deep is not None and deep.dtype == np.uint16 and is_dark(int(deep.max()), FULL_16):
        raise InputError(f"{where}: {DARK.format(most=int(deep.max()))}")


def is_dark(most: int, full: int) -> bool:
    """Whether an image of 16 bits uses its lowest 12 bits only, so that it would be nearly black in 8 bits.

    Args:
        most: largest value in the image.
        full: value of white: `FULL_16` for values of 16 bits, `FULL` for those reduced to 8.
    """
    return 0 < most <= math.ceil(DARK_16 * full / FULL_16)


def dim_values(most: int, full: int) -> Facts:
    """Fact `values-dim` if an image of 16 bits uses its lowest 13 or 14 bits; else empty.

    Args:
        most: largest value in the image.
        full: value of white: `FULL_16` for values of 16 bits, `FULL` for those reduced to 8.
    """
    value = most * FULL_16 // full
    return [("values-dim", {"most": value})] if DARK_16 < value <= math.ceil(DIM_16 / 257) * 257 else []


EXIF = {
    2: "mirrored",
    3: "rotated by 180 deg",
    4: "flipped upside down",
    5: "transposed",
    6: "rotated by 90 deg",
    7: "transposed about the other diagonal",
    8: "rotated by 270 deg",
}
"""What decoders do to an image by its Exif orientation."""


def image_facts(data: bytes, image: Image) -> Facts:
    """Facts, as ids of findings with values, on an image file: rotation by Exif data, and use of 14 of 16 bits only.

    `data` is the file, `image` the decoded image.
    """
    facts: Facts = [("pictures-turned", {"how": EXIF[turn]})] if (turn := _orientation(data)) in EXIF else []
    return [*facts, *(dim_values(int(image.max()), FULL) if _is_deep(data) else ())]


def _is_deep(data: bytes) -> bool:
    """Whether values of an image file may have 16 bits, by its header."""
    return data[24:25] == b"\x10" if image_kind(data) == "png" else data.startswith(DEEP_MARKS)


def dark_bars(image: Image) -> tuple[int, int, int, int]:
    """Widths [px] of black bars at the left, top, right and bottom edge of an image; 0 for one that is all black."""
    grey = image if image.ndim == 2 else image.max(axis=2)
    columns, rows = grey.mean(axis=0) > BLACK, grey.mean(axis=1) > BLACK
    if not columns.any() or not rows.any():
        return 0, 0, 0, 0
    return int(columns.argmax()), int(rows.argmax()), int(columns[::-1].argmax()), int(rows[::-1].argmax())


MAX_RUNS, PIXEL_STEP = 100, 8
"""Runs of black images that are stated, and step of the rows and columns that are tried first for a bright pixel."""


class Contents:
    """Whether images of a camera are black, all or in a row, or all the same; they are compared until one is not."""

    def __init__(self) -> None:
        """Start without images."""
        self._count, self._brightest, self._first = 0, 0, np.zeros(0, np.uint8)
        self._is_same = True
        self._runs: list[tuple[int, int]] = []  # first and last number of black images in a row
        self._in_run = False

    def add(self, image: Image, index: int) -> None:
        """Add an image of the frame `index`, after which it may be overwritten."""
        if not self._count:
            self._first = image.copy()
        elif self._is_same:
            self._is_same = np.array_equal(self._first, image)
        sampled = int(image[::PIXEL_STEP, ::PIXEL_STEP].max())
        brightest = sampled if sampled > BLACK else int(image.max())
        self._brightest = max(self._brightest, brightest)
        if brightest > BLACK:
            self._in_run = False
        elif self._in_run:
            self._runs[-1] = (self._runs[-1][0], index)
        elif len(self._runs) < MAX_RUNS:
            self._runs.append((index, index))
            self._in_run = True
        self._count += 1

    def facts(self) -> Facts:
        """Facts on the images so far: `pictures-black`, `pictures-identical`, or `pictures-black-run` for each row."""
        if self._count and self._brightest <= BLACK:
            return [("pictures-black", {"count": self._count, "most": self._brightest})]
        if self._is_same and self._count >= MIN_SAME:
            return [("pictures-identical", {"count": self._count})]
        return [("pictures-black-run", {"first": a, "last": b}) for a, b in self._runs if b > a]


def encode_image(image: Image, kind: str, quality: int) -> bytes:
    """Encode an image as PNG (lossless) or JPEG; the result is the same on every machine.

    Args:
        image: (h, w, 3) BGR or (h, w) grey.
        kind: `png` or `jpeg`.
        quality: of JPEG, 0 to 100.
    """
    if kind == "png":
        # A third faster than the default, and smaller on photographs.
        ok, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_FILTERED])
    else:
        ok, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not ok:
        raise ValueError(
            f"an image of shape {image.shape} and {image.dtype} cannot be encoded as {kind}; (h, w) or (h, w, 3) was "
            "expected"
        )
    return data.tobytes()


Size = tuple[int, int]
Changes = list[tuple[float, Size]]
"""(time after the start of the file [ns], size from then on)."""

START_CODE = b"\x00\x00\x01"
MAX_SEARCH = 4096
"""Bytes of a packet that are searched for the sequence parameters of H.264, which come first."""


def size_changes(path: Path) -> Changes:
    """Frame sizes over a video: (time [ns after the start], (width, height) from then on), the first size first.

    Read from the compressed packets; empty for codecs other than motion JPEG, PNG, VP8 and H.264.
    """
    with utf8_name(path.resolve()) as name:
        capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1, cv2.CAP_PROP_N_THREADS, 1])
    changes: Changes = []
    try:
        while capture.grab():
            ok, packet = capture.retrieve()
            size = packet_size(packet.tobytes()) if ok and packet is not None and packet.size else None
            if size is not None and (not changes or changes[-1][1] != size):
                changes.append((capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6, size))
    finally:
        capture.release()
    return sorted(changes)


def size_at(changes: Changes, pos_ns: float) -> Size | None:
    """Frame size (width, height) at a time [ns] in a video; None if it is unknown.

    `changes` are times [ns] and the sizes from then on, in order (`size_changes`).
    """
    k = bisect_right([at for at, _ in changes], pos_ns + 1e3) - 1
    return changes[k][1] if k >= 0 else None


def packet_size(data: bytes) -> Size | None:
    """Width and height that a packet of compressed video (JPEG, PNG, VP8, H.264) states; None if it states none."""
    if data[:2] == b"\xff\xd8" or data[:4] == b"\x89PNG":
        return image_size(data)
    # A key frame of VP8: RFC 6386 sec. 9.1.
    if len(data) >= 10 and data[3:6] == b"\x9d\x01\x2a" and not data[0] & 1:
        width, height = (int.from_bytes(data[k : k + 2], "little") & 0x3FFF for k in (6, 8))
        return width, height
    if data[:3] == START_CODE or data[:4] == b"\0" + START_CODE:
        return _h264_size(data)
    return None


def _h264_size(data: bytes) -> Size | None:
    """Width and height in the first sequence parameter set of an H.264 packet (Annex B); None without one."""
    at = data.find(START_CODE, 0, MAX_SEARCH)
    # Packets of MPEG-1, 2 and 4 begin with other codes, and later ones of theirs (slice 7) resemble parameters
    if not b"\0" < data[at + 3 : at + 4] < b"\x80":
        return None
    for unit in units(data[:MAX_SEARCH]):
        if unit[0] & 0x9F == SEQUENCE_PARAMETERS:
            try:
                return sequence_parameters(unit).size
            except IndexError:
                return None
    return None
