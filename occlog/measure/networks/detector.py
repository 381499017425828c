"""Boxes of the wanted classes in images, by a network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Floats32, Ints
from occlog.errors import InputError
from occlog.records.frames import Image

from .classes import Names, names_in, names_of, wanted_classes
from .config import NetworkConfig
from .heads import HEADS, Found, Reading, read, recognise
from .images import Placement, fill, laid, place
from .network import Network, ready, size_of
from .suppression import suppress


class Prepared(NamedTuple):
    """An image as the network wants it."""

    numbers: Floats32  # (3, H, W)
    where: Placement


class Boxed(NamedTuple):
    """Boxes in an image by falling area, cut at its edges; edges count from the centre of the first pixel."""

    boxes: Floats  # (n, 4) left, top, right, bottom [px]
    score: Floats  # (n,)


@dataclass(frozen=True)
class Detector:
    """A network that detects; `prepare` may be called by other threads than `find`.

    Attributes:
        network: what is run.
        reading: what is read of its outputs.
        names: of its classes.
        wanted: numbers of the classes that are looked for.
        fit: how images are brought to its size.
        pixels: how colours become numbers.
        least: confidence of a box.
        overlap: see `NetworkConfig`.
    """

    network: Network
    reading: Reading
    names: Names
    wanted: Ints
    fit: str
    pixels: str
    least: float
    overlap: float

    def prepare(self, image: Image) -> Prepared:
        """What the network wants of an image (height, width, 3) in BGR."""
        size = self.network.size
        where = place((image.shape[1], image.shape[0]), size, self.fit)
        numbers = np.empty((3, size[1], size[0]), dtype=np.float32)
        fill(numbers, laid(image, size, where, HEADS[self.reading.head].smooth), self.pixels)
        return Prepared(numbers, where)

    def find(self, images: Sequence[Prepared]) -> list[Boxed | None]:
        """Boxes in each of at most `network.batch` images; None where the network gives numbers that are not finite.

        The network is always given as many images as it takes, so that results do not depend on how many there are.
        """
        numbers = [images[min(n, len(images) - 1)].numbers for n in range(self.network.batch)]
        outputs = self.network.run(np.stack(numbers) if len(numbers) > 1 else numbers[0][None])
        found: list[Boxed | None] = []
        for n, image in enumerate(images):
            try:
                raw = read(self.reading, outputs, n, self.network.size, self.wanted, self.least)
            except FloatingPointError:
                found.append(None)
                continue
            except InputError as error:
                raise InputError(f"{self.network.file.path}: {error}") from None
            if HEADS[self.reading.head].repeats:
                kept = suppress(raw.boxes, raw.score, raw.label, self.overlap)
                raw = Found(raw.boxes[kept], raw.score[kept], raw.label[kept])
            boxes = image.where.to_image(raw.boxes)
            sides = boxes[:, 2:] - boxes[:, :2]
            order = np.argsort(-sides.prod(axis=1), kind="stable")
            order = order[(sides[order] > 0).all(axis=1)]
            found.append(Boxed(boxes[order], np.clip(raw.score[order], 0.0, 1.0)))
        return found

    def parameters(self) -> dict[str, object]:
        """What the boxes depend on, for the provenance."""
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
            **({"overlap": self.overlap} if HEADS[self.reading.head].repeats else {}),
        }


def open_detector(
    path: Path, config: NetworkConfig, classes: Sequence[str], names: Path | None, least: float, threads: int
) -> Detector:
    """Load a network that detects.

    Args:
        path: its file.
        config: options.
        classes: names or numbers; empty: people, or the only class.
        names: file with names of classes; None: see `classes`.
        least: confidence of a box.
        threads: that the network may use.

    Raises:
        InputError: the file is none of a network that detects, or it cannot be run.
        UsageError: a class that it does not have, or a setting that is not for it.
    """
    network = ready(path, config.runtime, threads, size_of(config.size), config.batch)
    metadata = network.file.metadata
    width, height = network.size
    try:
        told = names_in(metadata)
        outputs = network.run(np.full((network.batch, 3, height, width), 0.5, dtype=np.float32))
        count = None if told is None else len(told)
        reading = recognise(outputs, network.size, count, config.head, metadata)
        of_classes = names_of(reading.classes, told, names)
    except InputError as error:
        raise error if str(names) in str(error) else InputError(f"{path}: {error}") from None
    return Detector(
        network=network,
        reading=reading,
        names=of_classes,
        wanted=wanted_classes(classes, of_classes, reading.classes),
        fit=config.fit or HEADS[reading.head].fit,
        pixels=config.pixels or HEADS[reading.head].pixels,
        least=least,
        overlap=config.overlap,
    )
