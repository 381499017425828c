"""Vectors that say how somebody looks, by a network for re-identification, from the boxes of an image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from occlog.array_types import Floats, Floats32
from occlog.errors import InputError
from occlog.records.frames import Image

from .config import LONGEST_VECTOR, MOST_CROPS, NetworkConfig
from .heads import shapes
from .images import crop, fill
from .network import Network, ready, size_of


@dataclass(frozen=True)
class Embedder:
    """A network that gives a vector for the image of a person.

    Attributes:
        network: what is run.
        pixels: how colours become numbers.
        output: name of the output that is taken.
        length: of the vectors.
    """

    network: Network
    pixels: str
    output: str
    length: int

    def vectors(self, image: Image, boxes: Floats) -> Floats32:
        """(n, `length`) vectors of length 1 of what is in boxes (n, 4) of an image; NaN: the network gives none."""
        width, height = self.network.size
        out = np.empty((len(boxes), self.length), dtype=np.float32)
        step = MOST_CROPS if self.network.open_batch else self.network.batch
        for start in range(0, len(boxes), step):
            some = boxes[start : start + step]
            # Few sizes of batches: runtimes plan anew for each.
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
        """What the vectors depend on, for the provenance."""
        width, height = self.network.size
        return {
            "embed_runtime": self.network.runtime.called,
            "embed_output": self.output,
            "embed_length": self.length,
            "embed_size": f"{width}x{height}",
            "embed_pixels": self.pixels,
        }


def open_embedder(path: Path, config: NetworkConfig, threads: int) -> Embedder:
    """Load a network for re-identification.

    Raises:
        InputError: the file is none of such a network, or it cannot be run.
        UsageError: a setting that is not for it.
    """
    network = ready(path, config.runtime, threads, size_of(config.embed_size), batch=1)
    width, height = network.size
    outputs = network.run(np.full((network.batch, 3, height, width), 0.5, dtype=np.float32))
    # A vector: no extent but one, as (B, D) or (B, D, 1, 1)
    flat = [name for name, each in outputs.items() if each.size == len(each) * max(each.shape[1:], default=0)]
    if len(flat) != 1 or not 2 <= outputs[flat[0]][0].size <= LONGEST_VECTOR:
        raise InputError(
            f"{path}: its outputs are {shapes(outputs)}; one with a vector of 2 to {LONGEST_VECTOR} numbers for each "
            "image was expected"
        )
    return Embedder(network, config.embed_pixels, flat[0], outputs[flat[0]][0].size)
