"""Detection of the requested classes by a network, and embeddings by a re-identification network.

Non-maximum suppression keeps the most confident of overlapping boxes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Floats32, Ints
from occlog.errors import InputError
from occlog.records.frames import Image

from .config import CUT_PX, LONGEST_VECTOR, MAX_CROPS, NetworkConfig
from .heads import (
    HEADS,
    ClassNames,
    NetworkDetections,
    Reading,
    names_in,
    names_of,
    read,
    recognise,
    shapes,
    wanted_classes,
)
from .network import (
    ImageNetwork,
    ImagePlacement,
    crop,
    fill,
    image_placement,
    laid,
    ready,
    size_of,
    tile_edges,
    tiles_of,
)


@dataclass(frozen=True)
class Embedder:
    """Re-identification network, which gives an appearance vector for the image of a person.

    Attributes:
        network: network to run.
        pixels: name of the scaling of colours, see `network.PIXELS`.
        output: name of the network's output that is used.
        length: number of elements of a vector.
    """

    network: ImageNetwork
    pixels: str
    output: str
    length: int

    def vectors(self, image: Image, boxes: Floats) -> Floats32:
        """Embeddings of boxes in an image: vectors of unit length, by which people are recognised.

        Args:
            image: (height, width, 3) BGR.
            boxes: (n, 4) left, top, right, bottom [px].

        Returns:
            (n, `length`) vectors; NaN where the network returns none that can be normalised.
        """
        width, height = self.network.size
        out = np.empty((len(boxes), self.length), dtype=np.float32)
        step = MAX_CROPS if self.network.open_batch else self.network.batch
        for start in range(0, len(boxes), step):
            some = boxes[start : start + step]
            # Few sizes of batches: runtimes plan again for each.
            count = 1 << (len(some) - 1).bit_length() if self.network.open_batch else step
            numbers = np.zeros((count, 3, height, width), dtype=np.float32)
            for n, box in enumerate(some):
                fill(numbers[n], crop(image, box, (width, height)), self.pixels)
            found = self.network.run(numbers)[self.output].reshape(count, -1)[: len(some)].astype(np.float64)
            with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
                unit = found / np.linalg.norm(found, axis=1, keepdims=True)
            unit[~np.isfinite(unit).all(axis=1)] = np.nan
            out[start : start + step] = unit
        return out

    def parameters(self) -> dict[str, object]:
        """Parameters of the embeddings, for provenance."""
        width, height = self.network.size
        return {
            "embed_runtime": self.network.runtime.called,
            "embed_output": self.output,
            "embed_length": self.length,
            "embed_size": f"{width}x{height}",
            "embed_pixels": self.pixels,
        }


def open_embedder(path: Path, config: NetworkConfig, threads: int) -> Embedder:
    """Load a re-identification network; it may use `threads` threads.

    Raises:
        InputError: the file is not such a network, or cannot be run.
        UsageError: a setting does not apply to it.
    """
    network = ready(path, config.runtime, threads, size_of(config.embed_size, "embed_size"), batch=1)
    width, height = network.size
    outputs = network.run(np.full((network.batch, 3, height, width), 0.5, dtype=np.float32))
    # A vector: no extent but one, as (B, D) or (B, D, 1, 1)
    flat = [name for name, each in outputs.items() if each.size == len(each) * max(each.shape[1:], default=0)]
    if len(flat) != 1 or not 2 <= outputs[flat[0]][0].size <= LONGEST_VECTOR:
        raise InputError(
            f"{path}: its outputs are {shapes(outputs)}; one vector of 2 to {LONGEST_VECTOR} numbers for each "
            "image was expected: give a re-identification network",
            id="unsupported-network",
        )
    return Embedder(network, config.embed_pixel_scaling, flat[0], outputs[flat[0]][0].size)


def suppress(boxes: Floats, score: Floats, label: Ints, overlap: float) -> Ints:
    """Non-maximum suppression: indices of the kept boxes, by decreasing score.

    Greedy, within each class: a box is removed if its IoU with a kept box exceeds `overlap`. On equal scores the
    earlier box has priority.

    Args:
        boxes: (n, 4) left, top, right, bottom.
        score: (n,) confidences.
        label: (n,) classes.
        overlap: IoU threshold, 0 to 1.
    """
    left, top, right, bottom = boxes.T
    area = (right - left) * (bottom - top)
    rest = np.argsort(-score, kind="stable")
    kept = []
    while len(rest):
        best, rest = rest[0], rest[1:]
        kept.append(best)
        width = np.minimum(right[best], right[rest]) - np.maximum(left[best], left[rest])
        height = np.minimum(bottom[best], bottom[rest]) - np.maximum(top[best], top[rest])
        shared = np.maximum(width, 0.0) * np.maximum(height, 0.0)
        # shared / union > overlap, without a division by an area of 0
        covered = shared > overlap * (area[best] + area[rest] - shared)
        rest = rest[~(covered & (label[rest] == label[best]))]
    return np.array(kept, dtype=np.int64)


class PreparedTile(NamedTuple):
    """A part of an image, resized and normalised as input (3, H, W) of the network.

    `where` maps it to the network's input; `left` and `top` are its first pixel in the image; `inner` states
    whether the image continues at its left, top, right and bottom.
    """

    numbers: Floats32  # (3, H, W)
    where: ImagePlacement
    left: int  # of its first pixel in the image
    top: int
    inner: tuple[bool, bool, bool, bool]  # whether the image continues at the left, top, right, bottom


class Prepared(NamedTuple):
    """An image prepared as input of the network: the whole, then its tiles."""

    tiles: tuple[PreparedTile, ...]


class Boxed(NamedTuple):
    """n boxes in an image by decreasing area, clipped to the image, with confidences.

    Edges left, top, right, bottom [px] are relative to the centre of the first pixel.
    """

    boxes: Floats  # (n, 4) left, top, right, bottom [px]
    score: Floats  # (n,)


def _select(found: NetworkDetections, rows: Ints) -> NetworkDetections:
    """Select detections by indices `rows`."""
    return NetworkDetections(found.boxes[rows], found.score[rows], found.label[rows])


def _cut(tile: PreparedTile, boxes: Floats) -> Bools:
    """(n,) mask of boxes that end within `CUT_PX` of an inner edge of a tile: the object continues in the next tile.

    Boxes (n, 4) are left, top, right, bottom in the whole image [px].
    """
    w = tile.where
    edges = np.array([tile.left, tile.top, tile.left + w.width, tile.top + w.height]) - 0.5
    near = np.abs(boxes - edges) <= CUT_PX / np.array([w.x_scale, w.y_scale] * 2)
    cut: Bools = (near & np.array(tile.inner)).any(axis=1)
    return cut


@dataclass(frozen=True)
class NetworkDetector:
    """A detection network with the interpretation of its outputs; other threads may call `prepare` during `find`.

    Attributes:
        network: network to run.
        reading: interpretation of its outputs.
        names: names of its classes.
        wanted: numbers of the requested classes.
        fit: how images are resized to its input: `LETTERBOX`, `CORNER` or `STRETCH`.
        pixels: name of the scaling of colours, see `network.PIXELS`.
        least: minimum confidence of a box.
        overlap: IoU threshold of non-maximum suppression.
        tiles: columns and rows of tiles that are searched in addition to the whole image; 1, 1: none.
    """

    network: ImageNetwork
    reading: Reading
    names: ClassNames
    wanted: Ints
    fit: str
    pixels: str
    least: float
    overlap: float
    tiles: tuple[int, int] = (1, 1)

    def prepare(self, image: Image) -> Prepared:
        """Convert a BGR image (height, width, 3), and its tiles if any, to inputs of the network."""
        height, width = image.shape[:2]
        parts = [((0, width), (0, height))]
        if self.tiles != (1, 1):
            columns, rows = tile_edges(width, self.tiles[0]), tile_edges(height, self.tiles[1])
            parts += [(column, row) for row in rows for column in columns]
        return Prepared(tuple(self._prepare_tile(image, xs, ys) for xs, ys in parts))

    def _prepare_tile(self, image: Image, xs: tuple[int, int], ys: tuple[int, int]) -> PreparedTile:
        size = self.network.size
        part = image[ys[0] : ys[1], xs[0] : xs[1]]
        where = image_placement((part.shape[1], part.shape[0]), size, self.fit)
        numbers = np.empty((3, size[1], size[0]), dtype=np.float32)
        fill(numbers, laid(part, size, where, HEADS[self.reading.head].smooth), self.pixels)
        inner = (xs[0] > 0, ys[0] > 0, xs[1] < image.shape[1], ys[1] < image.shape[0])
        return PreparedTile(numbers, where, xs[0], ys[0], inner)

    def find(self, images: Sequence[Prepared]) -> list[Boxed | None]:
        """Boxes in each of some images; None for an image for which the network returns non-finite numbers.

        The network is always run with a full batch, so that results do not depend on the number of images.
        InputError if scores or coordinates are not in the range of the network's output format.
        """
        tiles = [tile for image in images for tile in image.tiles]
        step = self.network.batch
        found = iter([raw for n in range(0, len(tiles), step) for raw in self._run(tiles[n : n + step])])
        return [self._merged(image, [next(found) for _ in image.tiles]) for image in images]

    def _run(self, tiles: Sequence[PreparedTile]) -> list[NetworkDetections | None]:
        """Raw boxes in at most `network.batch` tiles, in pixels of the network's input; None where not finite."""
        numbers = [tiles[min(n, len(tiles) - 1)].numbers for n in range(self.network.batch)]
        outputs = self.network.run(np.stack(numbers) if len(numbers) > 1 else numbers[0][None])
        found: list[NetworkDetections | None] = []
        for n in range(len(tiles)):
            try:
                found.append(read(self.reading, outputs, n, self.network.size, self.wanted, self.least))
            except FloatingPointError:
                found.append(None)
            except InputError as error:
                raise InputError(f"{self.network.file.path}: {error}") from error
        return found

    def _merged(self, image: Prepared, found: Sequence[NetworkDetections | None]) -> Boxed | None:
        """Merge the boxes found in the whole image and its tiles, each object once; None if that of a tile is None.

        Boxes cut by an inner edge of a tile are removed, then duplicates by non-maximum suppression.
        """
        if any(raw is None for raw in found):
            return None
        repeats = HEADS[self.reading.head].repeats
        kept: list[NetworkDetections] = []
        for tile, raw in zip(image.tiles, found, strict=True):
            assert raw is not None
            if repeats:
                raw = _select(raw, suppress(raw.boxes, raw.score, raw.label, self.overlap))
            boxes = tile.where.to_image(raw.boxes) + np.tile([tile.left, tile.top], 2)
            kept.append(NetworkDetections(boxes, raw.score, raw.label))
            if any(tile.inner):
                kept[-1] = _select(kept[-1], np.flatnonzero(~_cut(tile, boxes)))
        if len(kept) > 1:
            every = NetworkDetections(*(np.concatenate(values) for values in zip(*kept, strict=True)))
            every = _select(every, suppress(every.boxes, every.score, every.label, self.overlap))
        else:
            (every,) = kept
        sides = every.boxes[:, 2:] - every.boxes[:, :2]
        order = np.argsort(-sides.prod(axis=1), kind="stable")
        order = order[(sides[order] > 0).all(axis=1)]
        return Boxed(every.boxes[order], np.clip(every.score[order], 0.0, 1.0))

    def parameters(self) -> dict[str, object]:
        """Parameters of the boxes, for provenance."""
        width, height = self.network.size
        return {
            "runtime": self.network.runtime.called,
            "head": self.reading.head,
            "size": f"{width}x{height}",
            "fit": self.fit,
            "pixels": self.pixels,
            "classes": {str(k): self.names.names.get(k, "") for k in self.wanted.tolist()},
            "names": self.names.source,
            "min_confidence": self.least,
            **({"overlap": self.overlap} if HEADS[self.reading.head].repeats or self.tiles != (1, 1) else {}),
            **({"tiles": "{}x{}".format(*self.tiles)} if self.tiles != (1, 1) else {}),
        }


def open_detector(
    path: Path, config: NetworkConfig, classes: Sequence[str], names: Path | None, least: float, threads: int
) -> NetworkDetector:
    """Load a detection network.

    Args:
        path: ONNX file of the network.
        config: settings of networks.
        classes: names or numbers of the requested classes; empty: person, or the only class.
        names: file with the names of its classes; None: those in the network, or COCO's.
        least: minimum confidence of a box.
        threads: number of threads that the network may use.

    Raises:
        InputError: the file is no detection network, or cannot be run.
        UsageError: a class that the network does not have, or a setting that does not apply to it.
    """
    network = ready(path, config.runtime, threads, size_of(config.size, "size"), config.batch)
    metadata = network.file.metadata
    width, height = network.size
    try:
        declared = names_in(metadata)
        outputs = network.run(np.full((network.batch, 3, height, width), 0.5, dtype=np.float32))
        count = None if declared is None else len(declared)
        reading = recognise(outputs, network.size, count, config.head, metadata)
        of_classes = names_of(reading.classes, declared, names)
    except InputError as error:
        raise error if str(names) in str(error) else InputError(f"{path}: {error}", id=error.id) from None
    return NetworkDetector(
        network=network,
        reading=reading,
        names=of_classes,
        wanted=wanted_classes(classes, of_classes, reading.classes),
        fit=config.resize_mode or HEADS[reading.head].fit,
        pixels=config.pixel_scaling or HEADS[reading.head].pixels,
        least=least,
        overlap=config.nms_iou,
        tiles=tiles_of(config.tiles),
    )
