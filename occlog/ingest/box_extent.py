"""Detection of a wrong image size, or of exchanged columns, from box edges.

A detector that clips boxes at the image border leaves many of them with the same right or lower edge. If cameras agree
that this edge is not that of the stated images, the calibration is for another image size. If most boxes are wider than
high, their columns are in another order, or the images were rotated.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import chain, combinations
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.errors import option
from occlog.io.formats.boxes.rows import fingerprints
from occlog.records.tables import Boxes
from occlog.records.verdicts import Check, finding, outcome

EXTENTS = "image size of boxes"
"""Name of the check."""
MIN_PILE = 5
"""Boxes with one edge at the same pixel from which it is taken for a border."""
PILE_RATIO = 3.0
"""Least ratio of the boxes at that pixel to those at any of the `NEIGHBOURS` before it."""
NEIGHBOURS = 8
MIN_SPREAD = 0.02
"""Least spread of the boxes along a border, in sides of the image; those of an object that does not move have none."""
MIN_BORDERS = 2
"""Borders, of any cameras, that must agree on a scale."""
SAME_SCALE = 0.005
"""Relative difference of scales that agree."""
BEYOND_PX, MIN_BEYOND = 16, 0.3
"""Boxes that end so far beyond the image, and the share of them from which the image is larger: detectors complete
people whom the border cuts, but of a third of them."""
MIN_CORNERS = 0.98
"""Share of these boxes with sizes that end inside the images as right and lower edges, from which they are such."""
WIDE, MIN_WIDE, MIN_SHAPES = 1.3, 0.5, 20
"""Ratio of width to height from which a box is not that of a person who stands or walks, share of such boxes of a
camera from which they are reported, and number of boxes at least: near people are cut by the lower border."""
MIN_IDENTICAL, MAX_HASHED = 0.5, 20_000
"""Share of boxes at the same pixels of the same frames from which two cameras are reported as one, and number of the
boxes of a camera that are compared, about."""
MAX_PX = 2**16
MIN_NEIGHBOURS, MIN_OVERLAP = 0.5, 0.5
"""Share of the pairs of boxes with successive identities in a frame that overlap, from which identities may be frame
numbers, and intersection over union from which they do."""
WHOLES = (100, 1000)
"""Right and lower border of images in percents, and in the coordinates of detectors that are language models."""


class _Border(NamedTuple):
    """Image border as found by a pile of box edges, and as stated: columns or rows [px]."""

    found: int
    stated: int

    @property
    def scale(self) -> float:
        """Factor from the stated to the found image size along this axis."""
        return self.found / self.stated


class BoxExtents:
    """Histograms by pixel of the right and lower edges of boxes of each camera, and counts of boxes by their shape."""

    def __init__(self, sizes: Mapping[str, tuple[int, int]], upright: Collection[str] = ()) -> None:
        """Start without boxes.

        Args:
            sizes: width and height [px] of the images by camera.
            upright: cameras with images in which standing people are higher than wide, if the boxes are of people.
        """
        self._sizes, self._upright = sizes, upright
        self._wide: dict[str, int] = {}  # boxes that are wider than high by `WIDE`
        self._hashes: dict[str, set[int]] = {}  # of each of the first `MAX_HASHED` boxes with its frame
        self._counts: dict[tuple[str, int], Ints] = {}
        self._along: dict[tuple[str, int], Floats] = {}  # (MAX_PX, 2) least and greatest middle of the boxes along it
        self._neighbours: dict[str, Ints] = {}  # boxes of identities n and n + 1 in a frame, and those that overlap
        self._corners: dict[str, int] = {}  # boxes with a size that can be the right and lower edges

    def add(self, table: Boxes) -> None:
        """Add the right and lower edges of the boxes of a table to the histograms; frames without boxes are ignored."""
        size = np.column_stack([table.width_px, table.height_px])
        far = np.column_stack([table.left_px, table.top_px]) + size
        middle = far - 0.5 * size
        for name in np.unique(table.sensor[table.box >= 0]).tolist():
            mine = (table.sensor == name) & (table.box >= 0)
            own = far[mine]
            edges, sizes = own - size[mine], size[mine]
            corners = (sizes > edges) & (sizes <= np.array(self._sizes.get(name, (0, 0))) + BEYOND_PX)
            self._corners[name] = self._corners.get(name, 0) + int(np.count_nonzero(corners.all(axis=1)))
            self._neighbours[name] = self._neighbours.get(name, np.zeros(2, np.int64)) + _neighbours(table.take(mine))
            hashes = self._hashes.setdefault(name, set())
            if len(hashes) < MAX_HASHED:
                hashes.update(fingerprints([table.frame[mine], *own.T, *sizes.T]).tolist())
            wide = sizes[:, 0] > WIDE * sizes[:, 1]
            self._wide[name] = self._wide.get(name, 0) + int(np.count_nonzero(wide))
            for axis in (0, 1):
                pixels = np.clip(np.round(own[:, axis]), 0, MAX_PX - 1).astype(np.int64)
                before = self._counts.setdefault((name, axis), np.zeros(MAX_PX, dtype=np.int64))
                before += np.bincount(pixels, minlength=MAX_PX)
                along = self._along.setdefault((name, axis), np.tile([np.inf, -np.inf], (MAX_PX, 1)))
                np.minimum.at(along[:, 0], pixels, middle[mine, 1 - axis])
                np.maximum.at(along[:, 1], pixels, middle[mine, 1 - axis])

    def checks(self, known: Collection[str], *, given: bool = False) -> tuple[Check, ...]:
        """Outcome of the check of image sizes and of the meaning of the boxes' four numbers, as added so far.

        Args:
            known: cameras with an image size that is known from images or box files, not only from the calibration.
            given: the user gives the size.
        """
        known_size = any(name in self._sizes for name, _ in self._counts)
        none = "" if known_size or self._counts else "no boxes of images of a stated size"
        found = [*self._found(known, given)] if known_size else []
        # Corners for sizes make boxes wide, too
        explained = {name for each in found if each.id == "boxes-corners" for name in each.sensors}
        others = chain(self._found_exchanged(), self._found_wide(explained), self._found_identical())
        return outcome(EXTENTS, chain(others, found), unless=none)

    def _found_exchanged(self) -> Iterator[Check]:
        """Yield a finding on the cameras with successive identities that overlap in a frame, as frames of one do."""
        shares = {n: overlap / max(count, 1) for n, (count, overlap) in self._neighbours.items() if count >= MIN_SHAPES}
        names = [name for name, share in shares.items() if share >= MIN_NEIGHBOURS]
        if names:
            yield finding(EXTENTS, "boxes-frame-id-exchanged", sensors=names, share=max(shares[n] for n in names))

    def _found_wide(self, explained: Collection[str]) -> Iterator[Check]:
        """Yield a finding on the cameras with boxes that are mostly wider than high, but for those in `explained`."""
        upright = set(self._upright) - set(explained)
        counts = {name: int(self._counts[name, 0].sum()) for name in self._wide if name in upright}
        shares = {name: self._wide[name] / count for name, count in counts.items() if count >= MIN_SHAPES}
        names = [name for name, share in shares.items() if share >= MIN_WIDE]
        if names:
            share = max(shares[name] for name in names)
            yield finding(EXTENTS, "boxes-wide", sensors=names, share=share, allowed=MIN_WIDE)

    def _found_identical(self) -> Iterator[Check]:
        """Yield a finding for each pair of cameras of which most boxes are at the same pixels of the same frames."""
        for (name, own), (other, others) in combinations(self._hashes.items(), 2):
            least = min(len(own), len(others))
            share = len(own & others) / max(least, 1)
            if least >= MIN_SHAPES and share >= MIN_IDENTICAL:
                yield finding(EXTENTS, "boxes-identical", sensors=[name, other], share=share, allowed=MIN_IDENTICAL)

    def _found(self, known: Collection[str], given: bool) -> Iterator[Check]:
        """Yield a finding on another image size if box edges of all cameras agree on it.

        Otherwise, yield findings on boxes beyond the images, if any.

        Args:
            known: cameras with an image size that is known from images or box files, not only from the calibration.
            given: the user gives the size.
        """
        sized = [key for key in self._counts if key[0] in self._sizes]
        borders = [self._border(*key) for key in sized]
        piles = [border for border in borders if border is not None]
        scale = float(np.median([border.scale for border in piles])) if len(piles) >= MIN_BORDERS else 1.0
        if abs(scale - 1.0) < 0.02 or any(abs(border.scale / scale - 1.0) > SAME_SCALE for border in piles):
            yield from self._beyond(sized)
            return
        if any(self._farthest(name, axis) > scale * self._sizes[name][axis] + 1.0 for name, axis in sized):
            return
        name = sized[0][0]
        stated = self._sizes[name]
        width, height = (round(side * scale) for side in stated)
        remedy = f"if images had that size, give {option('image_size')} {width}x{height}, which scales the calibration"
        if name in known or given:
            remedy = f"check {option('image_size')}" if given else "give boxes in pixels of these images"
        found, own = f"{width} x {height}", f"{stated[0]} x {stated[1]}"
        factor = max(scale, 1.0 / scale)
        yield finding(EXTENTS, "boxes-end-inside", found=found, stated=own, factor=factor, hint=remedy)

    def _beyond(self, sized: Sequence[tuple[str, int]]) -> Iterator[Check]:
        """Yield findings on cameras with many boxes that extend beyond the stated image.

        If the sizes of nearly all these boxes could be right and lower edges, the finding says so: corners were written
        instead of sizes.

        Args:
            sized: (camera, axis) pairs to examine; axis 0: columns, 1: rows.
        """
        shares: dict[str, float] = {}
        for name, axis in sized:
            count, first = self._counts[name, axis], min(self._sizes[name][axis] + BEYOND_PX, MAX_PX)
            shares[name] = max(shares.get(name, 0.0), float(count[first:].sum() / count.sum()))
        parts = {name for whole in WHOLES for name in self._in_parts(whole, shares)}
        for whole in WHOLES:
            if names := self._in_parts(whole, shares):
                stated = " x ".join(map(str, self._sizes[names[0]]))
                yield finding(EXTENTS, "boxes-in-parts", sensors=names, stated=stated, whole=whole)
        names = [name for name, share in shares.items() if share >= MIN_BEYOND and name not in parts]
        corners = [name for name in names if self._corners[name] >= MIN_CORNERS * self._counts[name, 0].sum()]
        if corners:
            yield finding(EXTENTS, "boxes-corners", sensors=corners, share=max(shares[name] for name in corners))
        names = [name for name in names if name not in corners]
        if names:
            far = " x ".join(str(max(self._farthest(name, axis) for name in names)) for axis in (0, 1))
            share = max(shares[name] for name in names)
            yield finding(EXTENTS, "boxes-end-beyond", sensors=names, share=share, found=far, allowed=MIN_BEYOND)

    def _in_parts(self, whole: int, shares: Mapping[str, float]) -> list[str]:
        """Cameras with boxes that end at `whole` in x and y, whatever the size of the images: percents, thousandths.

        `shares`, by camera, of boxes that end beyond the image; without many of them, boxes have to be cut at `whole`,
        or the images are much larger.
        """
        found = []
        for name, share in shares.items():
            ends, sides = [self._farthest(name, axis) for axis in (0, 1)], self._sizes[name]
            other = any(abs(side / whole - 1.0) > 0.05 for side in sides)
            cut = min(sides) > 3 * whole or all(self._border(name, axis) is not None for axis in (0, 1))
            if other and all(0.97 * whole <= end <= whole for end in ends) and (share >= MIN_BEYOND or cut):
                found.append(name)
        return [name for name in found if self._counts[name, 0].sum() >= MIN_SHAPES]

    def _farthest(self, name: str, axis: int) -> int:
        return int(np.flatnonzero(self._counts[name, axis])[-1])

    def _border(self, name: str, axis: int) -> _Border | None:
        """Image border of a camera along an axis (0: right, 1: lower), if box edges pile up at the farthest pixel.

        None without a pile, or if its boxes are of one object that does not move.
        """
        count, last = self._counts[name, axis], self._farthest(name, axis)
        pile = int(count[last])
        before = count[max(last - NEIGHBOURS, 0) : last]
        if pile < MIN_PILE or pile < PILE_RATIO * float(before.max(initial=0)):
            return None
        if np.ptp(self._along[name, axis][last]) < MIN_SPREAD * self._sizes[name][1 - axis]:
            return None  # one object that does not move
        # Boxes end at the last pixel or at the edge behind it: at that which gives whole pixels on the other side
        stated, other = self._sizes[name][axis], self._sizes[name][1 - axis]
        odd: Floats = np.array([abs(other * n / stated - round(other * n / stated)) for n in (last, last + 1)])
        return _Border(last + int(odd[1] <= odd[0]), stated)


def _neighbours(table: Boxes) -> Ints:
    """(2,) number of pairs of boxes with identities n and n + 1 in a frame, and of those that overlap."""
    own = table.take(np.lexsort((table.target_id, table.frame)))
    first = np.flatnonzero((np.diff(own.frame) == 0) & (np.diff(own.target_id) == 1) & (own.target_id[:-1] >= 0))
    near = np.column_stack([own.left_px, own.top_px])
    size = np.column_stack([own.width_px, own.height_px])
    far, second, areas = near + size, first + 1, size.prod(axis=1)
    common = np.minimum(far[first], far[second]) - np.maximum(near[first], near[second])
    shared = np.maximum(common, 0.0).prod(axis=1)
    overlap = shared > MIN_OVERLAP * (areas[first] + areas[second] - shared)
    return np.array([len(first), np.count_nonzero(overlap)])
