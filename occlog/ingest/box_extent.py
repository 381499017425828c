"""Signs of another size of the images in boxes: where detectors cut them off, rows and columns pile up.

A detector that ends boxes at the border of its images leaves many of them with the same right or lower edge. Where
cameras agree that this edge is not that of the stated images, the calibration is of images of another size.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.errors import option
from occlog.records.tables import Boxes

MIN_PILE = 5
"""Boxes with one edge at the same pixel from which it is taken for a border."""
PILE_RATIO = 3.0
"""Least ratio of the boxes at that pixel to those at any of the `NEIGHBOURS` before it."""
NEIGHBOURS = 8
MIN_BORDERS = 2
"""Borders, of any cameras, that must agree on a scale."""
SAME_SCALE = 0.005
"""Relative difference of scales that agree."""
BEYOND_PX, MIN_BEYOND = 16, 0.3
"""Boxes that end so far beyond the image, and the share of them from which the image is larger: detectors complete
people whom the border cuts, but of a third of them."""
MAX_PX = 2**16


class _Border(NamedTuple):
    """A border of the images by the boxes of a camera: rows or columns, and how many the stated images have of them."""

    found: int
    stated: int

    @property
    def scale(self) -> float:
        return self.found / self.stated


class BoxExtents:
    """Farthest right and lower edges of boxes, counted by pixels."""

    def __init__(self, sizes: Mapping[str, tuple[int, int]]) -> None:
        """Begin with the widths and heights [px] of the images of the cameras."""
        self._sizes = sizes
        self._counts: dict[tuple[str, int], Ints] = {}

    def add(self, table: Boxes) -> None:
        """Count the boxes of a table."""
        far = np.column_stack([table.left_px + table.width_px, table.top_px + table.height_px])
        for name in np.unique(table.sensor[table.box >= 0]).tolist():
            own = far[(table.sensor == name) & (table.box >= 0)]
            for axis in (0, 1):
                pixels = np.clip(np.round(own[:, axis]), 0, MAX_PX - 1).astype(np.int64)
                before = self._counts.setdefault((name, axis), np.zeros(MAX_PX, dtype=np.int64))
                before += np.bincount(pixels, minlength=MAX_PX)

    def warning(self, known: Collection[str], *, given: bool = False) -> str | None:
        """A warning where the images seem to have another size than stated; None: they do not.

        Args:
            known: cameras with images of which the size is known by the images or by the file of boxes.
            given: the user gives the size.
        """
        borders = [self._border(name, axis) for name, axis in self._counts if name in self._sizes]
        piles = [border for border in borders if border is not None]
        if len(piles) < MIN_BORDERS:
            return self._beyond()
        scale = float(np.median([border.scale for border in piles]))
        if abs(scale - 1.0) < 0.02 or any(abs(border.scale / scale - 1.0) > SAME_SCALE for border in piles):
            return self._beyond()
        if any(self._farthest(name, axis) > scale * self._sizes[name][axis] + 1.0 for name, axis in self._counts):
            return None
        name = next(iter(self._counts))[0]
        stated = self._sizes[name]
        width, height = (round(side * scale) for side in stated)
        remedy = f"if images had that size, give {option('image_size')} {width}x{height}, which scales the calibration"
        if name in known or given:
            remedy = f"check {option('image_size')}" if given else "give boxes in pixels of these images"
        return (
            f"warning: boxes of every camera end at {width} x {height} px, not at {stated[0]} x {stated[1]} (factor "
            f"{max(scale, 1.0 / scale):.4g}): {remedy}"
        )

    def _beyond(self) -> str | None:
        """A warning where many boxes end beyond the images; None: they do not."""
        ends = [(count, self._sizes[name][axis]) for (name, axis), count in self._counts.items() if name in self._sizes]
        beyond = [float(count[min(size + BEYOND_PX, MAX_PX) :].sum() / count.sum()) for count, size in ends]
        if not beyond or max(beyond) < MIN_BEYOND:
            return None
        far = [max(self._farthest(*key) for key in self._counts if key[1] == axis) for axis in (0, 1)]
        return (
            f"warning: {max(beyond):.0%} of a camera's boxes end beyond its images, at up to {far[0]} x {far[1]} px; "
            f"the images are larger than stated, or boxes are of others ({option('image_size')})"
        )

    def _farthest(self, name: str, axis: int) -> int:
        return int(np.flatnonzero(self._counts[name, axis])[-1])

    def _border(self, name: str, axis: int) -> _Border | None:
        """The border that boxes of a camera pile up at; None where they do not."""
        count, last = self._counts[name, axis], self._farthest(name, axis)
        pile = int(count[last])
        before = count[max(last - NEIGHBOURS, 0) : last]
        if pile < MIN_PILE or pile < PILE_RATIO * float(before.max(initial=0)):
            return None
        # Boxes end at the last pixel or at the edge behind it: at that which gives whole pixels on the other side
        stated, other = self._sizes[name][axis], self._sizes[name][1 - axis]
        odd: Floats = np.array([abs(other * n / stated - round(other * n / stated)) for n in (last, last + 1)])
        return _Border(last + int(odd[1] <= odd[0]), stated)
