"""A network that is ready: its file is read, a process of its own has loaded it, and it has been tried once."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from occlog.array_types import Floats32
from occlog.errors import InputError, UsageError
from occlog.io.models.onnx_file import OnnxFile, Port, read_onnx

from .config import LARGEST_SIDE
from .running.apart import Apart
from .running.messages import Feeds
from .running.runtimes import Runtime


@dataclass(frozen=True)
class Network:
    """A network of images.

    Attributes:
        file: what its file says of itself.
        runtime: what runs it.
        image: its input for images, (B, 3, H, W).
        extent: its input for the size of the images; empty: there is none.
        size: width and height of its images.
        batch: images that it takes at a time; exactly that many, unless `open_batch`.
        open_batch: whether it takes any number of images.
    """

    file: OnnxFile
    runtime: Runtime
    image: Port
    extent: str
    size: tuple[int, int]
    batch: int
    open_batch: bool

    def run(self, images: Floats32) -> dict[str, Floats32]:
        """Outputs for (B, 3, H, W) images, as 32-bit numbers.

        The size that RT-DETR is told is that of the network's images: its boxes are then in their pixels.
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
                    "for each image were expected"
                )
        return {name: values.astype(np.float32) for name, values in outputs.items()}


def ready(path: Path, runtime: str, threads: int, size: tuple[int, int] | None, batch: int) -> Network:
    """Read, load and try a network.

    Args:
        path: its file.
        runtime: what is to run it.
        threads: that it may use.
        size: width and height of its images, where it leaves them open; None: as it says.
        batch: images at a time, where it leaves that open.

    Raises:
        InputError: the file is none of a network of images, or it cannot be run.
        UsageError: size or batch is not that of the network, or has to be given; or the runtime is not installed.
    """
    file = read_onnx(path)
    image, extent = _inputs(file)
    count, _, high, wide = image.shape or (None, 3, None, None)
    of_file = _whole_size(file, wide, high, size)
    if count is not None and batch not in (1, count):
        raise UsageError(f"{path}: takes {count} images at a time, not {batch}; leave the batch out")
    found = Network(file, Apart(file, runtime, threads), image, extent, of_file, count or batch, count is None)
    found.run(np.full((found.batch, 3, of_file[1], of_file[0]), 0.5, dtype=np.float32))
    return found


def _inputs(file: OnnxFile) -> tuple[Port, str]:
    """The input for images, and the name of that for their size, if there is one."""
    images = [p for p in file.inputs if p.shape is None or len(p.shape) == 4]
    others = [p for p in file.inputs if p not in images]
    sizes = [p.name for p in others if p.kind == "int64" and p.shape is not None and p.shape[-1:] == (2,)]
    if len(images) != 1 or len(others) > 1 or len(sizes) != len(others):
        raise InputError(
            f"{file.path}: its inputs are {_ports(file.inputs)}; one for images (B x 3 x H x W) was expected"
        )
    (image,) = images
    if image.kind not in ("float32", "float16", "") or (image.shape is not None and image.shape[1] not in (3, None)):
        raise InputError(
            f"{file.path}: its input is {_ports(images)}; images of fractional numbers with three channels first "
            "(B x 3 x H x W) were expected; export it so"
        )
    return image, sizes[0] if sizes else ""


def _ports(ports: tuple[Port, ...] | list[Port]) -> str:
    """Inputs for a person."""
    return ", ".join(f"{p.name} {p.kind} {' x '.join(str(n or '?') for n in p.shape or ())}".strip() for p in ports)


def _whole_size(file: OnnxFile, wide: int | None, high: int | None, asked: tuple[int, int] | None) -> tuple[int, int]:
    """Width and height of a network's images: its own, else what was asked for, else what its metadata says."""
    told = asked
    if told is None and (wide is None or high is None):
        try:
            h, w = ast.literal_eval(file.metadata["imgsz"])
            told = int(w), int(h)
        except (KeyError, ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
            raise UsageError(f"{file.path}: leaves the size of its images open; give it (size, in pixels)") from None
    size = (wide or (told or (0, 0))[0], high or (told or (0, 0))[1])
    if asked is not None and asked != size:
        raise UsageError(
            f"{file.path}: its images are {size[0]} x {size[1]} px, not {asked[0]} x {asked[1]}; leave the size out"
        )
    if not all(1 <= side <= LARGEST_SIDE for side in size):
        raise InputError(f"{file.path}: images of {size[0]} x {size[1]} px; sides of 1 to {LARGEST_SIDE} px are taken")
    return size


def size_of(text: str | None) -> tuple[int, int] | None:
    """Width and height from `640` or `960x544`; UsageError for another text."""
    if text is None:
        return None
    try:
        sides = [int(part) for part in text.lower().split("x")]
        width, height = sides * 2 if len(sides) == 1 else sides
    except ValueError:
        raise UsageError(f"size {text!r}: want 640, or 960x544 (width x height)") from None
    if not all(1 <= side <= LARGEST_SIDE for side in (width, height)):
        raise UsageError(f"size {text!r}: want sides of 1 to {LARGEST_SIDE} px")
    return width, height
