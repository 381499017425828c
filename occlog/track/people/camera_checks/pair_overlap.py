"""Agreement of the boxes of cameras: people located by one camera alone, projected into another one.

Feet at the lower edge and head at the upper edge of a box locate a person on the ground. Projected into another
camera's image, there should be a box. The overlap expected by chance is that with boxes of other times. Nothing is
tracked, so that cameras are comparable even if their tracks are wrong.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.records.scene import Camera

MIN_OVERLAP = 0.3
"""Intersection over union of a box with a projected person, from which it fits."""
BORDER_PX = 3.0
"""Boxes as near to the border of the image may be cut off, and locate no one."""
MIN_BOXES = 10
"""Boxes of a camera from which the height of people follows."""
MAX_INTERVALS, MIN_IN_INTERVAL = 16, 5
"""Intervals of a recording of which mean overlaps are compared, and people expected in each of them."""
MIN_SIGMAS, MIN_GAIN = 6.0, 0.05
"""Gain of mean overlap that is clear, in standard errors over intervals, and that matters."""
MIN_HEIGHT, MAX_HEIGHT = 0.6, 1.3
"""Heights of bodies, relative to the expected one."""
FEET_HEIGHTS = 0.07
"""Distance of the axis of a body from the point at the lower edge of its box, in heights."""
BODY_HEADS = 7.0
"""Height of people in heights of the boxes that detectors of heads give, which have some hair and chin around."""
MAX_DISTANCE_HEIGHTS = 30.0
"""Distance of a person from a camera, in heights, beyond which a box does not locate the person."""


class BoxesOfCamera(NamedTuple):
    """A camera with its boxes and their time steps.

    Attributes:
        camera: camera, which has a pose.
        boxes: (n, 4) left, top, right, bottom [px].
        steps: (n,) index of the time step of each box.
    """

    camera: Camera
    boxes: Floats
    steps: Ints

    @property
    def size(self) -> Floats:
        """(2,) width and height of the image [px]; if unknown, the largest coordinates of the boxes."""
        if self.camera.image_size is not None:
            return np.array(self.camera.image_size, dtype=np.float64)
        return np.asarray(self.boxes[:, 2:].max(axis=0, initial=1.0) + 1.0)

    def with_boxes_of(self, other: BoxesOfCamera) -> BoxesOfCamera:
        """Return this camera's geometry with the boxes of another camera."""
        return BoxesOfCamera(self.camera, other.boxes, other.steps)

    def during(self, first: int, last: int) -> BoxesOfCamera:
        """Return the camera with the boxes of the time steps first to last (inclusive) only."""
        own = (self.steps >= first) & (self.steps <= last)
        return BoxesOfCamera(self.camera, self.boxes[own], self.steps[own])

    def every(self, count: int) -> BoxesOfCamera:
        """Return the camera with the boxes of every `count`-th time step only."""
        if count == 1:
            return self
        own = self.steps % count == 0
        return BoxesOfCamera(self.camera, self.boxes[own], self.steps[own])


class Overlap(NamedTuple):
    """Overlaps (intersection over union) of n projected people with the boxes of the image they are projected into.

    Attributes:
        steps: (n,) time step of each person who is expected in an image.
        met: (n,) largest intersection over union with a box there.
        chance: (n,) largest intersection over union with the boxes of another time.
    """

    steps: Ints
    met: Floats
    chance: Floats

    @property
    def share(self) -> float:
        """Share of the people expected in an image that overlap a box by at least `MIN_OVERLAP`.

        NaN if none is expected.
        """
        return float(np.mean(self.met >= MIN_OVERLAP)) if len(self.met) else float("nan")

    @property
    def excess(self) -> float:
        """Share of overlapping people beyond chance, like Cohen's kappa.

        1 if all overlap, 0 if as many as by chance.
        """
        by_chance = float(np.mean(self.chance >= MIN_OVERLAP)) if len(self.met) else 0.0
        return (self.share - by_chance) / max(1.0 - by_chance, 1e-9)

    @property
    def mean(self) -> float:
        """Mean overlap (intersection over union) minus the mean overlap by chance; NaN if no person is expected."""
        return float(np.mean(self.met) - np.mean(self.chance)) if len(self.met) else float("nan")


def clearly_larger(a: Overlap, b: Overlap) -> bool:
    """Return whether the mean overlap in `a` is clearly larger than in `b`.

    By `MIN_GAIN`, and by `MIN_SIGMAS` standard errors over intervals of time.
    """
    steps = 1 + max(int(each.steps.max(initial=0)) for each in (a, b))
    sums = []
    for each in (a, b):
        part = each.steps * MAX_INTERVALS // steps
        counts = np.bincount(part, minlength=MAX_INTERVALS)
        mean = np.bincount(part, each.met, MAX_INTERVALS) / np.maximum(counts, 1)
        sums.append(np.where(counts >= MIN_IN_INTERVAL, mean, np.nan))
    gain = sums[0] - sums[1]
    gain = gain[np.isfinite(gain)]
    if len(gain) < MAX_INTERVALS // 2 or gain.mean() < MIN_GAIN:
        return False
    return bool(gain.mean() > MIN_SIGMAS * gain.std(ddof=1) / np.sqrt(len(gain)))


def located(view: BoxesOfCamera, person_height: float) -> Floats:
    """Return (n, 4) x, y, height and width of the person in each box, located by this camera alone; NaN if not located.

    Not located are boxes at the image border, too far away, or with a height unlike `person_height`, the mean height of
    people [scene unit].
    """
    boxes, camera, size = view.boxes, view.camera, view.size
    out = np.full((len(boxes), 4), np.nan)
    if not len(boxes):
        return out
    with np.errstate(all="ignore"):
        feet, head = upright(camera, boxes)
        people = located_by_ends(camera, feet, head, FEET_HEIGHTS * person_height)
        height, distance = people[:, 2], np.linalg.norm(people[:, :2] - camera.position[:2], axis=1)
        width = height * (boxes[:, 2] - boxes[:, 0]) / (boxes[:, 3] - boxes[:, 1])
        good = distance < MAX_DISTANCE_HEIGHTS * person_height
        good &= (height > MIN_HEIGHT * person_height) & (height < MAX_HEIGHT * person_height)
        good &= (boxes[:, :2] > BORDER_PX).all(axis=1) & (boxes[:, 2:] < size - 1.0 - BORDER_PX).all(axis=1)
    out[good] = np.column_stack([people, width])[good]
    return out


def person_heights(boxes: Sequence[Floats], cameras: Sequence[Camera]) -> Floats:
    """Return the median height (C,) of people by the boxes (n, 4) of each camera [scene unit]; NaN: too few boxes.

    The feet are at the middle of the lower edge, on the ground; the head is above them, in the row of the upper edge.
    """
    out = np.full(len(cameras), np.nan)
    for c, (own, camera) in enumerate(zip(boxes, cameras, strict=True)):
        heights = _heights(own, camera)
        if len(heights) >= MIN_BOXES:
            out[c] = np.median(heights)
    return out


def _heights(boxes: Floats, camera: Camera) -> Floats:
    """Return heights (k,) of the k boxes with feet on the ground that neither the upper nor the lower border cuts.

    `boxes` (n, 4) are left, top, right, bottom [px]; heights are in the scene's unit.
    """
    left, top, right, bottom = boxes.T
    if camera.image_size is not None:
        whole = (bottom < camera.image_size[1] - 1 - BORDER_PX) & (top > BORDER_PX)
        left, top, right, bottom = (edge[whole] for edge in (left, top, right, bottom))
    middle = 0.5 * (left + right)
    feet, head = camera.rays(np.column_stack([middle, bottom])), camera.rays(np.column_stack([middle, top]))
    with np.errstate(divide="ignore", invalid="ignore"):
        away = -camera.position[2] / feet[:, 2] * np.hypot(feet[:, 0], feet[:, 1])
        heights = camera.position[2] + away * head[:, 2] / np.hypot(head[:, 0], head[:, 1])
    good: Floats = heights[(feet[:, 2] < 0) & np.isfinite(heights) & (heights > 0)]
    return good


def ideal(camera: Camera, pixels: Floats) -> Floats:
    """Return the undistorted points (n, 2) in the normalised image of pixels (n, 2).

    NaN if not in front of the camera.
    """
    rays = camera.rays(pixels) @ camera.rotation
    with np.errstate(all="ignore"):
        return np.asarray(np.where(rays[:, 2:] > 0.0, rays[:, :2] / rays[:, 2:], np.nan))


def upright(camera: Camera, boxes: Floats) -> Floats:
    """Return feet and heads (2, n, 2), in the normalised image, of upright people that fill boxes (n, 4).

    The ends of a vertical line at the lower and upper edges, with their midpoint in the middle of the box; off the
    image centre the head is not directly above the feet.
    """
    middle = 0.5 * (boxes[:, 0] + boxes[:, 2])
    ends = np.concatenate([np.column_stack([middle, boxes[:, edge]]) for edge in (3, 1)])
    out = ideal(camera, ends).reshape(2, -1, 2)
    up = camera.rotation[2]
    across, (feet, head) = out[..., 0].mean(axis=0), out[..., 1]
    with np.errstate(all="ignore"):
        tall = (feet - head) / (head * up[2] - up[1])  # where the depth of the feet is 1
        nearer = 1.0 / (1.0 + tall * up[2])
        x = (2.0 * across - tall * up[0] * nearer) / (1.0 + nearer)
        out[..., 0] = x, (x + tall * up[0]) * nearer
    return out


def located_by_ends(
    camera: Camera, feet: Floats, head: Floats, beyond: Floats | float, raised: Floats | float = 0.0
) -> Floats:
    """Return (..., n, 3) x, y and height of people by feet and head (..., n, 2) in the normalised image.

    NaN if the feet are not on the ground.

    Args:
        camera: camera, which has a pose.
        feet: lowest points of the people.
        head: highest points of the people.
        beyond: horizontal distance of the body's axis behind its lowest point [scene unit].
        raised: height of the camera above that of its pose [scene unit].
    """
    z = camera.position[2] + raised
    with np.errstate(all="ignore"):
        below, above = (xy @ camera.rotation[:, :2].T + camera.rotation[:, 2] for xy in (feet, head))
        along, away = np.hypot(below[..., 0], below[..., 1]), -z / below[..., 2]
        distance = np.where(away > 0.0, away * along + beyond, np.nan)
        ground = camera.position[:2] + (distance / along)[..., None] * below[..., :2]
        height = z + distance * above[..., 2] / np.hypot(above[..., 0], above[..., 1])
    return np.concatenate([ground, height[..., None]], axis=-1)


def projected_people(camera: Camera, people: Floats) -> Floats:
    """Return boxes (n, 4) [px] of upright people, projected from feet and head.

    NaN if behind the camera or upside down.

    Args:
        camera: camera, which has a pose.
        people: (n, 4) x, y, height and width.
    """
    ground = np.column_stack([people[:, :2], np.zeros(len(people))])
    with np.errstate(all="ignore"):
        toward = camera.position[:2] - people[:, :2]
        toward = FEET_HEIGHTS * people[:, 2:3] * toward / np.linalg.norm(toward, axis=1, keepdims=True)
    lowest = ground + np.column_stack([toward, np.zeros(len(people))])
    feet, head = camera.project(lowest), camera.project(ground + people[:, 2:3] * [0.0, 0.0, 1.0])
    tall = feet[:, 1] - head[:, 1]
    middle, half = 0.5 * (feet[:, 0] + head[:, 0]), 0.5 * tall * people[:, 3] / np.maximum(people[:, 2], 1e-9)
    boxes = np.column_stack([middle - half, head[:, 1], middle + half, feet[:, 1]])
    return np.where((tall > 0.0)[:, None], boxes, np.nan)


def in_image(boxes: Floats, size: Floats) -> Bools:
    """Return a mask (n,): the centre of each of the `boxes` (n, 4) is in an image of `size` (2,) width, height [px]."""
    with np.errstate(invalid="ignore"):
        middle = 0.5 * (boxes[:, :2] + boxes[:, 2:])
        return np.asarray(((middle > 0.0) & (middle < size)).all(axis=1))


def merged(parts: Sequence[Overlap]) -> Overlap:
    """Return several overlaps concatenated to one, in their order."""
    nothing = Overlap(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))
    return Overlap(*(np.concatenate(column) for column in zip(nothing, *parts, strict=True)))


class PairOverlaps:
    """Overlaps of people located by one camera with the boxes of another, for cameras as given and as changed.

    What does not depend on a change is computed once.
    """

    def __init__(self, views: Sequence[BoxesOfCamera], steps: int, person_height: float) -> None:
        """Keep the boxes of all cameras, for `steps` time steps; `person_height` in the scene's unit."""
        self._steps, self._height = steps, person_height
        self._cameras = [_ComparedCamera(view, steps, person_height) for view in views]
        self._projected: dict[tuple[int, int], tuple[Floats, Ints]] = {}

    def overlap(
        self, cameras: Iterable[int], changed: Mapping[int, BoxesOfCamera], of: Sequence[int] | None = None
    ) -> Overlap:
        """Overlaps of all pairs of cameras with at least one of some cameras.

        Args:
            cameras: indices of these cameras.
            changed: changed ones of them, by the index of the camera that each replaces.
            of: indices of the cameras that they are compared with; None: all.
        """
        others = sorted({*(range(len(self._cameras)) if of is None else of), *cameras})
        pairs = [(a, b) for a in others for b in others if a != b and {a, b} & set(cameras)]
        return merged(list(self._of_pairs(pairs, changed).values()))

    def of_each(self) -> list[Overlap]:
        """Overlaps of each camera with all others, in both directions."""
        count = range(len(self._cameras))
        found = self._of_pairs([(a, b) for a in count for b in count if a != b], {})
        return [merged([part for pair, part in found.items() if c in pair]) for c in count]

    def _of_pairs(
        self, pairs: Sequence[tuple[int, int]], changed: Mapping[int, BoxesOfCamera]
    ) -> dict[tuple[int, int], Overlap]:
        """Return, by pair (a, b), the overlaps of people located by camera a with the boxes of camera b.

        `changed`: changed cameras, by the index of the camera that each replaces.
        """
        now = dict(enumerate(self._cameras))
        now.update({c: _ComparedCamera(view, self._steps, self._height) for c, view in changed.items()})
        out: dict[tuple[int, int], Overlap] = {}
        for a, b in pairs:
            if a in changed or now[b].view.camera is not self._cameras[b].view.camera:
                boxes, when = now[a].projected(now[b].view.camera)
            else:
                if (a, b) not in self._projected:
                    self._projected[a, b] = now[a].projected(now[b].view.camera)
                boxes, when = self._projected[a, b]
            out[a, b] = now[b].overlap(boxes, when)
        return out


class _ComparedCamera:
    """A camera with its boxes by time step, and the people whom it locates."""

    def __init__(self, view: BoxesOfCamera, steps: int, person_height: float) -> None:
        """Keep a camera, for `steps` time steps; `person_height` in the scene's unit."""
        self.view, self._steps, self._height = view, steps, person_height

    @cached_property
    def _people(self) -> Floats:
        """(n, 4) x, y, height and width of the person in each box; NaN if not located."""
        return located(self.view, self._height)

    @cached_property
    def _by_step(self) -> Floats:
        """(5, T, most boxes) edges and areas of the boxes by time step, as of `_by_step`."""
        return _by_step(self.view, self._steps)

    def projected(self, camera: Camera) -> tuple[Floats, Ints]:
        """(n, 4) boxes expected in the image of another camera, of the people located here; (n,) their time steps."""
        known = np.flatnonzero(np.isfinite(self._people).all(axis=1))
        return projected_people(camera, self._people[known]), self.view.steps[known]

    def overlap(self, boxes: Floats, when: Ints) -> Overlap:
        """Overlaps of expected boxes (n, 4) that are in the image, of the time steps `when` (n,), with the boxes here.

        The overlap by chance is that with boxes half the recording later.
        """
        seen = in_image(boxes, self.view.size)
        boxes, when = boxes[seen], when[seen]
        # A camera without any box at a time may have no frame of it
        frames = np.bincount(self.view.steps, minlength=self._steps) > 0
        # Boxes by chance: those of half the time later, at steps that have any
        filled = np.flatnonzero(frames)
        at = np.searchsorted(filled, when)
        other = filled[(at + len(filled) // 2) % max(len(filled), 1)] if len(filled) else when
        compared = frames[when]
        boxes, when, other = boxes[compared], when[compared], other[compared]
        return Overlap(when, _largest(boxes, self._by_step[:, when]), _largest(boxes, self._by_step[:, other]))


def _by_step(view: BoxesOfCamera, steps: int) -> Floats:
    """(5, T, most boxes) left, top, right, bottom and area of a camera's boxes by time step, T = `steps`.

    Time steps with fewer boxes are padded with boxes of no size at (0, 0).
    """
    counts = np.bincount(view.steps, minlength=steps)
    out = np.zeros((5, steps, max(int(counts.max(initial=0)), 1)))
    order = np.argsort(view.steps, kind="stable")
    when = view.steps[order]
    first = np.cumsum(counts) - counts
    own = view.boxes[order].T
    out[:, when, np.arange(len(order)) - first[when]] = *own, _areas(*own)
    return out


def overlaps_at(boxes: Floats, when: Ints, view: BoxesOfCamera, steps: int) -> Floats:
    """(n,) largest intersection over union of boxes (n, 4) with those of a camera at the time steps `when` (n,).

    It is 0 at a time step without boxes; `steps` is the number of time steps.
    """
    return _largest(boxes, _by_step(view, steps)[:, when])


def _areas(left: Floats, top: Floats, right: Floats, bottom: Floats) -> Floats:
    """Areas of boxes, of any shape; 0 where an edge is beyond the opposite one."""
    return np.asarray(np.maximum(right - left, 0.0) * np.maximum(bottom - top, 0.0))


def _largest(boxes: Floats, others: Floats) -> Floats:
    """(n,) largest intersection over union of each box (n, 4) with the m boxes of its time step; 0 without overlap.

    `others`: (5, n, m) edges and areas as of `_by_step`.
    """
    if not len(boxes):
        return np.zeros(0)
    left, top, right, bottom = boxes.T[..., None]
    near, far = (
        (np.maximum(left, others[0]), np.maximum(top, others[1])),
        (np.minimum(right, others[2]), np.minimum(bottom, others[3])),
    )
    common = _areas(*near, *far)
    union = _areas(left, top, right, bottom) + others[4] - common
    return np.asarray((common / np.where(union > 0.0, union, 1.0)).max(axis=1))


def paired_rows(first: Ints, second: Ints) -> tuple[Ints, Ints]:
    """Return indices (i, j), each (k,), of all pairs of rows with equal time steps.

    `first` (n,) and `second` (m,) are the time steps of two sets of rows; i is of the first, j of the second.
    """
    order = np.argsort(second, kind="stable")
    when = second[order]
    low, high = np.searchsorted(when, first, "left"), np.searchsorted(when, first, "right")
    counts = high - low
    rows = np.repeat(np.arange(len(first)), counts)
    return rows, order[np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts - low, counts)]
