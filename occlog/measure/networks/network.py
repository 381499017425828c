"""Image networks: loading in a separate process, image preparation and conversion of boxes.

Images are resized and their colours normalised. Box edges in a network's image are relative to the image corner (0 is
the left edge of the first pixel); occlog's are relative to the centre of the first pixel, i.e. smaller by half a pixel.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from occlog.array_types import Floats, Floats32
from occlog.errors import InputError, UsageError, option
from occlog.io.formats.models.onnx_file import OnnxFile, Port, read_onnx
from occlog.records.frames import Image

from .config import (
    CORNER,
    IMAGENET,
    IMAGENET_BGR,
    LARGEST_SIDE,
    LETTERBOX,
    MAX_TILES,
    PAD,
    RAW,
    TILE_OVERLAP,
    UNIT,
)
from .running.messages import Feeds
from .running.runtimes import Runtime
from .running.subprocess_runtime import SubprocessRuntime


@dataclass(frozen=True)
class ImageNetwork:
    """A loaded network with images as input.

    Attributes:
        file: description of the ONNX file.
        runtime: loaded network in its runtime.
        image: input for images, (B, 3, H, W).
        extent: name of the input for the size of the images; empty: it has none.
        size: width and height of the images [px].
        batch: number of images per call; exactly that many, unless `open_batch`.
        open_batch: whether it accepts any number of images.
    """

    file: OnnxFile
    runtime: Runtime
    image: Port
    extent: str
    size: tuple[int, int]
    batch: int
    open_batch: bool

    def run(self, images: Floats32) -> dict[str, Floats32]:
        """Outputs (float32) for images (B, 3, H, W).

        RT-DETR gets the size of the network's input, so that its boxes are in input pixels.
        """
        feeds: dict[str, np.ndarray[tuple[int, ...], np.dtype[np.generic]]] = {
            self.image.name: images.astype(np.float16) if self.image.kind == "float16" else images
        }
        if self.extent:
            feeds[self.extent] = np.tile(np.array([self.size], dtype=np.int64), (len(images), 1))
        return self._plain(self.runtime.run(feeds), len(images))

    def _plain(self, outputs: Feeds, images: int) -> dict[str, Floats32]:
        for name, values in outputs.items():
            if values.dtype.kind not in "fiu" or values.shape[:1] != (images,):
                raise InputError(
                    f"{self.file.path}: output {name} is {values.dtype} {values.shape} for {images} images; numbers "
                    "for each image were expected: export it so",
                    id="unsupported-network",
                )
        return {name: values.astype(np.float32) for name, values in outputs.items()}


def ready(path: Path, runtime: str, threads: int, size: tuple[int, int] | None, batch: int) -> ImageNetwork:
    """Read and load a network of images in a separate process, and test it with grey images.

    Args:
        path: ONNX file of the network.
        runtime: name of the runtime.
        threads: number of threads that it may use.
        size: width and height of its images [px], where the network leaves them open; None: as it states.
        batch: number of images per call, where the network leaves that open.

    Raises:
        InputError: the file is no network of images, or cannot be run.
        UsageError: size or batch differs from the network's, or has to be given; or the runtime is not installed.
    """
    file = read_onnx(path)
    image, extent = _inputs(file)
    count, _, high, wide = image.shape or (None, 3, None, None)
    of_file = _whole_size(file, wide, high, size)
    if count is not None and batch not in (1, count):
        raise UsageError(
            f"{path}: takes {count} images at a time, not {batch}; leave {option('batch')} out", id="not-applicable"
        )
    found = ImageNetwork(
        file, SubprocessRuntime(file, runtime, threads), image, extent, of_file, count or batch, count is None
    )
    found.run(np.full((found.batch, 3, of_file[1], of_file[0]), 0.5, dtype=np.float32))
    return found


def _inputs(file: OnnxFile) -> tuple[Port, str]:
    """The image input, and the name of the image size input, empty if there is none; InputError for other inputs."""
    images = [p for p in file.inputs if p.shape is None or len(p.shape) == 4]
    others = [p for p in file.inputs if p not in images]
    sizes = [p.name for p in others if p.kind == "int64" and p.shape is not None and p.shape[-1:] == (2,)]
    if len(images) != 1 or len(others) > 1 or len(sizes) != len(others):
        raise InputError(
            f"{file.path}: its inputs are {_ports(file.inputs)}; one for images (B x 3 x H x W) was expected: export "
            "it so",
            id="unsupported-network",
        )
    (image,) = images
    if image.kind not in ("float32", "float16", "") or (image.shape is not None and image.shape[1] not in (3, None)):
        raise InputError(
            f"{file.path}: its input is {_ports(images)}; images of fractional numbers with three channels first "
            "(B x 3 x H x W) were expected; export it so",
            id="unsupported-network",
        )
    return image, sizes[0] if sizes else ""


def _ports(ports: tuple[Port, ...] | list[Port]) -> str:
    """Names, types and shapes of inputs, for messages."""
    return ", ".join(f"{p.name} {p.kind} {' x '.join(str(n or '?') for n in p.shape or ())}".strip() for p in ports)


def _whole_size(file: OnnxFile, wide: int | None, high: int | None, asked: tuple[int, int] | None) -> tuple[int, int]:
    """Input width and height of a network [px]: fixed, else requested, else from its metadata.

    UsageError if the size is open, or another one was requested; InputError if it is too large.

    Args:
        file: description of the network's file.
        wide: fixed width; None: open.
        high: fixed height; None: open.
        asked: width and height that the user requests; None: not requested.
    """
    requested = asked
    if requested is None and (wide is None or high is None):
        try:
            h, w = ast.literal_eval(file.metadata["imgsz"])
            requested = int(w), int(h)
        except (KeyError, ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
            raise UsageError(
                f"{file.path}: leaves the size of its images open; give {option('size')} in pixels (of the network of "
                f"{option('embed')}: {option('embed_size')})",
                id="missing-image-size",
            ) from None
    size = (wide or (requested or (0, 0))[0], high or (requested or (0, 0))[1])
    if asked is not None and asked != size:
        raise UsageError(
            f"{file.path}: the network takes images of {size[0]} x {size[1]} px only, not {asked[0]} x {asked[1]}; "
            "leave the size out",
            id="not-applicable",
        )
    if not all(1 <= side <= LARGEST_SIDE for side in size):
        raise InputError(
            f"{file.path}: the network takes images of {size[0]} x {size[1]} px; sides of 1 to {LARGEST_SIDE} px are "
            "supported: export it for a smaller size, or correct the size",
            id="unsupported-network",
        )
    return size


def size_of(text: str | None, named: str) -> tuple[int, int] | None:
    """Parse width and height [px] from `640` (a square) or `960x544`; None for None, UsageError for another text.

    `named` is the name of the setting, for messages.
    """
    if text is None:
        return None
    try:
        sides = [int(part) for part in text.lower().split("x")]
        width, height = sides * 2 if len(sides) == 1 else sides
    except ValueError:
        raise UsageError(
            f"{option(named)} {text!r}: expected the side of a square in px (640), or width x height (960x544)"
        ) from None
    if not all(1 <= side <= LARGEST_SIDE for side in (width, height)):
        raise UsageError(f"{option(named)} {text!r}: expected sides of 1 to {LARGEST_SIDE} px")
    return width, height


def tiles_of(text: str | None) -> tuple[int, int]:
    """Parse columns and rows of tiles from `3x2`; None: 1, 1; UsageError for another text."""
    if text is None:
        return 1, 1
    try:
        columns, rows = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise UsageError(f"tiles {text!r}: expected 3x2 (columns x rows)") from None
    if not (1 <= columns <= MAX_TILES and 1 <= rows <= MAX_TILES):
        raise UsageError(f"tiles {text!r}: expected 1 to {MAX_TILES} columns and rows")
    return columns, rows


def tile_edges(length: int, count: int) -> list[tuple[int, int]]:
    """First pixel, and pixel after the last, of equal tiles that cover an image side and overlap by `TILE_OVERLAP`.

    `length` is that of the side [px], `count` the number of tiles along it.
    """
    side = min(length, math.ceil(length / (count - (count - 1) * TILE_OVERLAP)))
    starts = [round(n * (length - side) / (count - 1)) for n in range(count)] if count > 1 else [0]
    return [(start, start + side) for start in starts]


def _table(mean: Sequence[float], deviation: Sequence[float], scale: float) -> Floats32:
    """(3, 256) lookup table of normalised colours: (value / scale - mean) / deviation, rounded as float32."""
    values = np.arange(256, dtype=np.float32) / np.float32(scale)
    column = (3, 1)
    means, deviations = (np.array(each, dtype=np.float32).reshape(column) for each in (mean, deviation))
    return np.asarray((values - means) / deviations)


PIXELS: dict[str, tuple[bool, Floats32]] = {
    UNIT: (True, _table((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 255.0)),
    IMAGENET: (True, _table((0.485, 0.456, 0.406), (0.229, 0.224, 0.225), 255.0)),
    IMAGENET_BGR: (False, _table((103.53, 116.28, 123.675), (57.375, 57.12, 58.395), 1.0)),
    RAW: (True, _table((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1.0)),
}
"""Pixel conversions by name: whether red comes first, and the table of values per channel."""


@dataclass(frozen=True)
class ImagePlacement:
    """Placement of an image in the network's input, for coordinates relative to corners.

    x_network = x_scale * x + left, y_network = y_scale * y + top [px]. `width`, `height`: size of the image [px].
    """

    x_scale: float
    y_scale: float
    left: float
    top: float
    width: int  # of the image [px]
    height: int

    def to_image(self, boxes: Floats) -> Floats:
        """Convert boxes (n, 4: left, top, right, bottom) [px] from the network's input to the image, clipped to it.

        Input edges are relative to the corner, returned ones to the centre of the first pixel.
        """
        xs = (boxes[:, 0::2] - self.left) / self.x_scale
        ys = (boxes[:, 1::2] - self.top) / self.y_scale
        out = np.empty_like(boxes, dtype=np.float64)
        out[:, 0::2] = np.clip(xs, 0.0, self.width) - 0.5
        out[:, 1::2] = np.clip(ys, 0.0, self.height) - 0.5
        return out


def image_placement(size: tuple[int, int], wanted: tuple[int, int], fit: str) -> ImagePlacement:
    """Compute the placement of an image in the network's input.

    `LETTERBOX` is that of ultralytics (`LetterBox`, `scaleup`, centred): one scale for both axes, the size rounded,
    the border halved and the odd pixel at the right and below.  `CORNER` is that of MMDetection (`Resize`, `Pad`).

    Args:
        size: width and height of the image [px].
        wanted: width and height of the network's input [px].
        fit: `LETTERBOX`, `CORNER` or `STRETCH`.
    """
    (w, h), (W, H) = size, wanted
    if fit not in (LETTERBOX, CORNER):
        return ImagePlacement(W / w, H / h, 0.0, 0.0, w, h)
    scale = min(H / h, W / w)
    if fit == CORNER:
        new_w, new_h, left, top = int(w * scale + 0.5), int(h * scale + 0.5), 0, 0
    else:
        new_w, new_h = round(w * scale), round(h * scale)
        left, top = round((W - new_w) / 2 - 0.1), round((H - new_h) / 2 - 0.1)
    # What the rounded size states about each axis is where things truly are.
    new_w, new_h = min(max(new_w, 1), W), min(max(new_h, 1), H)
    return ImagePlacement(new_w / w, new_h / h, left, top, w, h)


def laid(image: Image, wanted: tuple[int, int], where: ImagePlacement, smooth: bool) -> Image:
    """Resize a BGR image, and pad it with grey, to the network's input (H, W, 3).

    Args:
        image: (h, w, 3) BGR, 8 bits.
        wanted: W and H of the input [px].
        where: scales and offset of the image in the input.
        smooth: average pixels when reducing.
    """
    W, H = wanted
    new = (round(where.x_scale * where.width), round(where.y_scale * where.height))
    if new != (where.width, where.height):
        smaller = new[0] <= where.width and new[1] <= where.height
        image = np.asarray(
            cv2.resize(image, new, interpolation=cv2.INTER_AREA if smooth and smaller else cv2.INTER_LINEAR),
            dtype=np.uint8,
        )
    if new == (W, H):
        return image
    out = np.full((H, W, 3), PAD, dtype=np.uint8)
    left, top = int(where.left), int(where.top)
    out[top : top + new[1], left : left + new[0]] = image
    return out


def fill(out: Floats32, image: Image, pixels: str) -> None:
    """Write the normalised values of a BGR image (H, W, 3) to `out` (3, H, W).

    `pixels` is the name of the scaling in `PIXELS`.
    """
    red_first, table = PIXELS[pixels]
    planes = cv2.split(image)
    for c in range(3):
        out[c] = cv2.LUT(planes[2 - c if red_first else c], table[c])


def crop(image: Image, box: Floats, wanted: tuple[int, int]) -> Image:
    """Crop a box (4,: left, top, right, bottom) [px] from an image and resize it to `wanted` (width, height).

    All pixels that the box touches are included, at least one.
    """
    h, w = image.shape[:2]
    left, top = (int(np.clip(np.floor(edge + 0.5), 0, end - 1)) for edge, end in zip(box[:2], (w, h), strict=True))
    right, bottom = (int(np.clip(np.ceil(edge + 0.5), 1, end)) for edge, end in zip(box[2:], (w, h), strict=True))
    part = image[top : max(bottom, top + 1), left : max(right, left + 1)]
    return np.asarray(cv2.resize(part, wanted, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
