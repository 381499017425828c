"""Images of which decoders give one picture of several, without a word: animations, pages (TIFF), views (MPO)."""

from __future__ import annotations

import struct

SEVERAL = (
    "several pictures (an animation, pages or views), of which decoders give one; write each as an image, or give "
    "them as a video"
)
_ANIMATED_WEBP = 0x02
"""Bit of the first part of a WebP image that says that it has several pictures."""
_GIF_IMAGE, _GIF_EXTENSION = 0x2C, 0x21
"""What the blocks of a GIF image begin with: a picture, and all else that it may hold."""
_SEQUENCE, _SAMPLES = b"avis", b"stsz"
"""Brand of AVIF with a sequence of pictures, and the box of MP4 that says of each track how many it has."""
_ORDERS = {b"II": "<", b"MM": ">"}
_KIND_OF_PAGE, _NO_PAGE = 254, 0b101
"""Tag of TIFF that says what a picture is, and its bits for smaller copies and masks of others."""
_LIST_OF_VIEWS, _VIEW_BYTES = 0xB002, 16
_VIEW = 0x020000
"""Kind of the pictures of a panorama, of two eyes, or of several places; previews are of another one."""
_UNDEFINED = 0x000000
_LIGHT = (b"hdrgm:", b"hdrgainmap")
"""Words by which a picture of undefined kind is told to be a map of brightness for the first one."""
_MPO_BYTES = 1 << 17
"""Bytes of a JPEG image among which its list of views begins."""


def holds_several(data: bytes) -> bool:
    """Whether an image (WebP, GIF, AVIF, TIFF, JPEG) holds several pictures that differ; of PNG see `codec`."""
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
    except struct.error:  # what is damaged is told by the decoder
        return False


def _blocks(data: bytes) -> int:
    """How many pictures a GIF image has; counting stops at two."""
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
    """Bytes of the table of colours that a byte of GIF tells of."""
    (flags,) = struct.unpack_from("B", data, at)
    return 3 << (flags & 7) + 1 if flags & 0x80 else 0


def _sequence(data: bytes) -> int:
    """How many pictures the longest track of an AVIF image has; 1 for one that is no sequence."""
    (size,) = struct.unpack_from(">I", data)
    pictures, at = 1, size
    if _SEQUENCE in data[8:size]:
        while (at := data.find(_SAMPLES, at)) >= 0:
            pictures = max(pictures, struct.unpack_from(">I", data, at + 12)[0])
            at += 16
    return pictures


def _pages(data: bytes) -> int:
    """How many pages a TIFF image has, smaller copies and masks left out; counting stops at two."""
    order, large = _ORDERS[data[:2]], b"+" in data[:4]
    count, entry, place = ("Q", 20, "Q") if large else ("H", 12, "I")
    (at,) = struct.unpack_from(order + place, data, 8 if large else 4)
    seen, pages = set[int](), 0
    while at and at not in seen and pages < 2:
        seen.add(at)
        (n,) = struct.unpack_from(order + count, data, at)
        begin = at + struct.calcsize(order + count)
        (at,) = struct.unpack_from(order + place, data, begin + n * entry)
        pages += not _is_copy(data, order, begin, n, entry)
    return pages


def _is_copy(data: bytes, order: str, begin: int, count: int, entry: int) -> bool:
    """Whether the entries of a page, which are sorted by tag, say that it is a smaller copy or a mask of another."""
    for at in range(begin, begin + count * entry, entry):
        (tag,) = struct.unpack_from(order + "H", data, at)
        if tag == _KIND_OF_PAGE:
            (kind,) = struct.unpack_from(order + "I", data, at + entry - (8 if entry == 20 else 4))
            return bool(kind & _NO_PAGE)
        if tag > _KIND_OF_PAGE:
            break
    return False


def _views(data: bytes) -> int:
    """How many pictures a JPEG image has (CIPA DC-007); previews and maps of brightness do not count."""
    base = data.find(b"MPF\0", 0, _MPO_BYTES) + 4
    order = _ORDERS.get(data[base : base + 2]) if base > 3 else None
    if order is None:
        return 1
    begin = base + struct.unpack_from(order + "I", data, base + 4)[0]
    for each in range(struct.unpack_from(order + "H", data, begin)[0]):
        tag, _, size, at = struct.unpack_from(order + "HHII", data, begin + 2 + 12 * each)
        if tag == _LIST_OF_VIEWS:
            size = min(size, len(data) - base - at)
            places = range(base + at, base + at + size - _VIEW_BYTES + 1, _VIEW_BYTES)
            kinds = [struct.unpack_from(order + "I", data, place)[0] & 0xFFFFFF for place in places]
            others = [kind for kind in kinds[1:] if kind & 0xFF0000 == _VIEW or kind == _UNDEFINED]
            light = all(kind == _UNDEFINED for kind in others) and any(word in data for word in _LIGHT)
            return 1 + (0 if light else len(others))
    return 1
