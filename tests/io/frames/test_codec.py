"""Limits of images: size, end marks, black bars."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest

from occlog.errors import InputError
from occlog.io.frames.codec import (
    BLACK,
    DARK_16,
    PNG_MARK,
    SEVERAL,
    dark_bars,
    decode_image,
    image_damage,
    image_size,
    is_multi_image,
    shown_size,
)
from occlog.io.frames.limits import MAX_PIXELS


def png_head(width: int, height: int) -> bytes:
    """The beginning of a PNG image, up to its size."""
    head = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return PNG_MARK + struct.pack(">I", 13) + head + struct.pack(">I", zlib.crc32(head))


def jpeg() -> bytes:
    return cv2.imencode(".jpg", np.full((8, 8, 3), 90, np.uint8))[1].tobytes()


def test_an_image_of_the_most_pixels_is_decoded_and_a_larger_one_is_refused_first() -> None:
    side = int(MAX_PIXELS**0.5)
    assert side**2 == MAX_PIXELS
    with pytest.raises(InputError, match="cut short"):  # its size is accepted
        decode_image(png_head(side, side), "x")
    with pytest.raises(InputError, match=f"{side} x {side + 1} px; the limit is {MAX_PIXELS} pixels"):
        decode_image(png_head(side, side + 1), "x")


def test_a_size_needs_24_bytes_of_a_png_image() -> None:
    assert image_size(png_head(3, 4)[:24]) == (3, 4)
    assert image_size(png_head(3, 4)[:23]) is None
    assert image_size(jpeg()) == (8, 8)
    assert image_size(b"GIF89a" + bytes(30)) is None


def test_the_end_mark_of_a_jpeg_image_is_looked_for_in_its_last_kilobyte() -> None:
    assert jpeg().endswith(b"\xff\xd9")
    assert image_damage(jpeg() + bytes(1022)) is None
    assert "the end mark of a JPEG image is missing" in (image_damage(jpeg() + bytes(1023)) or "")


def test_a_png_image_ends_with_its_last_part_and_not_a_byte_before() -> None:
    whole = cv2.imencode(".png", np.zeros((4, 4, 3), np.uint8))[1].tobytes()
    assert image_damage(whole) is None
    assert "the end mark of a PNG image is missing" in (image_damage(whole[:-1]) or "")


@pytest.mark.parametrize(("level", "bars"), [(BLACK, (3, 2, 1, 4)), (BLACK + 1, (0, 0, 0, 0))])
def test_a_bar_is_black_up_to_a_mean(level: int, bars: tuple[int, int, int, int]) -> None:
    image = np.full((20, 30), level, np.uint8)
    image[2:16, 3:29] = 200
    assert dark_bars(image) == bars
    assert dark_bars(np.full((20, 30, 3), BLACK, np.uint8)) == (0, 0, 0, 0)


def png_part(name: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))


def exif(order: str, turn: int) -> bytes:
    """Exif data with two entries, of which the second says how the image is turned."""
    mark = b"II*\0" if order == "<" else b"MM\0*"
    entries = struct.pack(f"{order}HHIHHHHIHH", 0x0100, 3, 1, 9, 0, 0x0112, 3, 1, turn, 0)
    return mark + struct.pack(f"{order}IH", 8, 2) + entries + bytes(4)


@pytest.mark.parametrize("turn", range(10))
@pytest.mark.parametrize("order", "<>")
def test_a_size_is_that_of_the_image_turned_as_its_exif_data_say(order: str, turn: int) -> None:
    pixels = np.zeros((8, 24, 3), np.uint8)
    reported = b"Exif\0\0" + exif(order, turn)
    jpg, png = (cv2.imencode(kind, pixels)[1].tobytes() for kind in (".jpg", ".png"))
    jpg = jpg[:2] + b"\xff\xe1" + struct.pack(">H", len(reported) + 2) + reported + jpg[2:]
    png = png[:33] + png_part(b"eXIf", exif(order, turn)) + png[33:]
    for data in (jpg, png):
        image = decode_image(data, "x")
        assert shown_size(data) == (image.shape[1], image.shape[0])
        assert image_size(data) == (24, 8)


def test_exif_data_that_end_early_or_lead_nowhere_turn_nothing() -> None:
    whole = b"\xff\xd8\xff\xe1\0\x40Exif\0\0" + exif("<", 6)
    for stop in range(len(whole) - 8):
        cut = whole[:stop] + jpeg()[2:]
        assert shown_size(cut) == image_size(cut)
    loss_count = whole.replace(b"\x08\0\0\0", b"\xff\xff\xff\xff") + jpeg()[2:]
    assert shown_size(loss_count) == image_size(loss_count)


@pytest.mark.parametrize("kind", [".png", ".tiff", ".pgm"])
def test_values_of_16_bits_that_would_be_black_as_8_are_refused(kind: str) -> None:
    """Cameras of 12 bits write such images, and depth in mm: their upper eight bits are the brightness that is left."""

    def image(most: int) -> bytes:
        values = np.linspace(0, most, 64).astype(np.uint16).reshape(8, 8)
        return cv2.imencode(kind, values)[1].tobytes()

    assert decode_image(image(65535), "x").max() == 255
    assert decode_image(image(DARK_16 + 1), "x").max() == 16
    assert decode_image(image(0), "x").max() == 0
    with pytest.raises(InputError, match="x: values of 16 bits up to 4095 of 65535, which as 8 bits would be nearly"):
        decode_image(image(DARK_16), "x")


def test_animations_are_refused_whose_other_pictures_would_be_lost() -> None:
    png = cv2.imencode(".png", np.zeros((8, 8), np.uint8))[1].tobytes()
    one, two = (png[:33] + png_part(b"acTL", struct.pack(">II", n, 0)) + png[33:] for n in (1, 2))
    assert (image_damage(one), image_damage(two)) == (None, SEVERAL)
    webp = cv2.imencode(".webp", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
    head = b"RIFF" + struct.pack("<I", 100) + b"WEBPVP8X" + struct.pack("<I", 10)
    assert image_damage(webp) is None
    assert (image_damage(head + b"\0" * 10), image_damage(head + b"\x02" + bytes(9))) == (None, SEVERAL)


@pytest.mark.parametrize("ending", [".gif", ".avif", ".webp"])
@pytest.mark.parametrize(("pictures", "several"), [(1, False), (2, True), (3, True)])
def test_animations_are_known_by_their_pictures(ending: str, pictures: int, several: bool) -> None:
    made = cv2.Animation()
    made.frames = [np.full((32, 48, 3), 60 * n, np.uint8) for n in range(pictures)]
    made.durations = [100] * pictures
    data = cv2.imencodeanimation(ending, made)[1].tobytes()
    assert image_damage(data) == (SEVERAL if several else None)
    assert not any(is_multi_image(data[:end]) for end in range(20))


@pytest.mark.parametrize(("pages", "damage"), [(1, None), (2, SEVERAL)])
def test_pages_of_tiff_are_refused_as_animations_are(pages: int, damage: str | None) -> None:
    assert image_damage(cv2.imencodemulti(".tiff", [np.zeros((8, 8), np.uint8)] * pages)[1].tobytes()) == damage


def tiff(order: str, *kinds: int, large: bool = False) -> bytes:
    """Heads of pages, of which each says what it is."""
    mark, first = {"<": b"II", ">": b"MM"}[order], 16 if large else 8
    count, entry = ("Q", "HHQII") if large else ("H", "HHIHH")
    size = struct.calcsize(order + count + entry + ("Q" if large else "I"))
    head = struct.pack(order + "HHHQ", 43, 8, 0, first) if large else struct.pack(order + "HI", 42, first)
    pages = b""
    for n, kind in enumerate(kinds):
        low, high = (kind, 0) if order == "<" or large else (0, kind)
        values = (254, 4, 1, low, high)
        then = first + (n + 1) * size if n + 1 < len(kinds) else 0
        pages += struct.pack(order + count, 1) + struct.pack(order + entry, *values)
        pages += struct.pack(order + ("Q" if large else "I"), then)
    return mark + head + pages


@pytest.mark.parametrize("large", [False, True])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("kinds", "several"), [((0,), False), ((0, 2), True), ((0, 1), False), ((0, 4, 1), False)])
def test_smaller_copies_in_tiff_are_no_pages(order: str, kinds: tuple[int, ...], several: bool, large: bool) -> None:
    assert is_multi_image(tiff(order, *kinds, large=large)) == several


def test_pages_that_lead_to_each_other_end() -> None:
    data = tiff("<", 1, 1)
    assert not is_multi_image(data[:-4] + struct.pack("<I", 8))
    assert not is_multi_image(data[:20])


def mpo(order: str, *kinds: int, words: bytes = b"") -> bytes:
    """A JPEG image with a list of views of these kinds."""
    head = {"<": b"II*\0", ">": b"MM\0*"}[order] + struct.pack(order + "I", 8)
    views = b"".join(struct.pack(order + "IIIHH", kind, 100, 0, 0, 0) for kind in kinds)
    entry = struct.pack(order + "HHHII", 1, 0xB002, 7, len(views), 8 + 2 + 12 + 4)
    body = b"MPF\0" + head + entry + struct.pack(order + "I", 0) + views + words
    image = cv2.imencode(".jpg", np.zeros((8, 8), np.uint8))[1].tobytes()
    return image[:2] + b"\xff\xe2" + struct.pack(">H", 2 + len(body)) + body + image[2:]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("kinds", "words", "damage"),
    [
        ((0x030000,), b"", None),
        ((0x020002, 0x020002), b"", SEVERAL),
        ((0x030000, 0), b"", SEVERAL),
        ((0x030000, 0x010001), b"", None),
        ((0x030000, 0), b"hdrgm:Version", None),
    ],
    ids=["one", "two eyes", "of no kind", "a preview", "a map of brightness"],
)
def test_views_of_mpo_are_refused_but_previews_are_not(
    order: str, kinds: tuple[int, ...], words: bytes, damage: str | None
) -> None:
    data = mpo(order, *kinds, words=words)
    assert image_damage(data) == damage
    assert damage or decode_image(data, "x").shape == (8, 8)


@pytest.mark.parametrize("most", [1, 100, 254, 255, 256, 1023, 4095, 10000, 65534, 65535])
@pytest.mark.parametrize("kind", [2, 3, 5, 6])
def test_images_that_state_their_range_are_scaled_by_it(kind: int, most: int) -> None:
    """White is 255, whatever values it has, as OpenCV makes it of text up to 255, and of 65535."""
    values = [most, most // 2, 0] * 3
    text = " ".join(map(str, values)).encode() + b"\n"
    packed = np.array(values, ">u2" if most > 255 else np.uint8).tobytes()
    head = f"P{kind} # made by hand\n{1 if kind in (3, 6) else 3} #\n3\n{most}\n".encode()
    image = decode_image(head + (text if kind in (2, 3) else packed), "x")
    assert image.dtype == np.uint8
    assert sorted(set(image.ravel().tolist())) == sorted({0, (most // 2) * 255 // most, 255})


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", r"Git LFS.*git lfs pull"),
        (b"<html><title>Sign in</title></html>", "a web page"),
        (b"x" * 100, "not an image, or a damaged one"),
    ],
)
def test_other_files_in_place_of_an_image_are_named(data: bytes, message: str) -> None:
    with pytest.raises(InputError, match=f"a.png: .*{message}"):
        decode_image(data, "a.png")
