"""Drawing of tracks and truth over the frames of several views, as in [Qu] Fig. 7."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Bytes, Floats
from occlog.colours import target_rgb

Colour = tuple[int, int, int]
Box = tuple[int, int, int, int]
"""Left, top, right, bottom of a label, half-open."""

WHITE, BLACK, ALARM = (255, 255, 255), (16, 16, 16), (60, 20, 255)
HIDDEN = 0.3
"""A target of which less than this share is visible counts as hidden."""
SUB = 4
"""Bits of a pixel's parts in coordinates that OpenCV is given."""
BAR = 26
"""Height of the bar with the title [px]."""


class Outline(NamedTuple):
    """Estimate of a target, drawn in a frame as an ellipse.

    Attributes:
        ellipse: (5,) x and y of the centre, half axes a and b [px], and angle of a from x towards y [rad].
        target_id: identity of the target.
        dashed: only neighbours act on the estimate, or its view has no box of it.
        strong: other views help.
        wrong: text for a failure; empty: none.
    """

    ellipse: Floats  # (5,) see `occlog.core.image`
    target_id: int
    dashed: bool = False  # its neighbours repel it, and no other view helps
    strong: bool = False  # other views help
    wrong: str = ""  # its fault


class TruePosition(NamedTuple):
    """True box of a target, drawn in a frame.

    Attributes:
        box: (4,) left, top, width and height [px].
        target_id: identity of the target.
        visible: visible share, 0 to 1; NaN: unknown.
        missed: no tracker is on the target.
        coloured: drawn in the colour of the target's number; otherwise white.
    """

    box: Floats  # (4,) left, top, width, height [px]
    target_id: int
    visible: float = math.nan  # share; NaN: not known
    missed: bool = False  # no tracker is on it
    coloured: bool = True  # in the colour of its number; else white


class LineDrawing(NamedTuple):
    """A polyline of a target, such as its trail or its projected outline.

    Attributes:
        points: (k, 2) points [px].
        target_id: identity of the target.
        width: width of the line [px].
        dashed: whether it is dashed.
        words: text above its highest point; empty: none.
    """

    points: Floats  # (k, 2)
    target_id: int
    width: int = 2
    dashed: bool = False
    words: str = ""  # above its highest point


class FrameDrawing(NamedTuple):
    """All that is drawn over one frame of one view, in pixels of the frame (pixel centres at integers).

    Attributes:
        title: text of the title bar.
        outlines: estimates.
        links: lines between the centres of two targets that touch, (2, 2) each.
        lines: identity of the target and points (k, 2) of each epipolar line.
        positions: true boxes.
        boxed: true boxes are drawn as boxes; otherwise as crosses.
        notes: texts at the bottom.
        ways: trails and projected outlines.
        ranks: index of the colour of each target, by identity; targets that are missing have that of their number.
    """

    title: str
    outlines: Sequence[Outline] = ()
    links: Sequence[Floats] = ()  # each (2, 2): centres of two that touch
    lines: Sequence[tuple[int, Floats]] = ()  # target and (k, 2) points of an epipolar line
    positions: Sequence[TruePosition] = ()
    boxed: bool = False  # true boxes instead of crosses
    notes: Sequence[str] = ()  # written at the bottom
    ways: Sequence[LineDrawing] = ()
    ranks: Mapping[
        int, int
    ] = {}  # position of a target among all by identity, which states its colour; else its number

    def colour(self, target_id: int) -> Colour:
        """Return the BGR colour of the target `target_id`."""
        return colour_of(self.ranks.get(target_id, target_id))


def colour_of(index: int) -> Colour:
    """Return the BGR colour of the target with this index (rank of its identity), as in the dark report."""
    r, g, b = target_rgb(index, dark=True)
    return b, g, r


def draw_shot(image: Bytes, shot: FrameDrawing, scale: float) -> Bytes:
    """Draw the scaled frame under a title bar, with all estimates, lines and true positions.

    Args:
        image: (H, W, 3) BGR or (H, W) grey.
        shot: estimates, lines, true positions and texts to draw, in pixels of the frame.
        scale: pixels of the result per pixel of the frame, > 0.

    Returns:
        BGR picture (BAR + round(scale H), round(scale W), 3).
    """
    colour = image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    size = (max(1, round(scale * image.shape[1])), max(1, round(scale * image.shape[0])))
    picture = np.ascontiguousarray(cv2.resize(colour, size, interpolation=_interpolation(scale)), dtype=np.uint8)
    for target, points in shot.lines:
        _path(picture, points, scale, shot.colour(target), 1)
    for way in shot.ways:
        draw_way(picture, way, scale, shot.colour(way.target_id))
    for link in shot.links:
        _path(picture, link, scale, WHITE, 2)
    for outline in shot.outlines:
        _estimate(picture, outline, scale, shot.colour(outline.target_id))
    for position in shot.positions:
        (_true_box if shot.boxed else _true_cross)(picture, position, scale, shot.colour(position.target_id))
    taken: list[Box] = []  # numbers are drawn on top
    for outline in shot.outlines:
        _tag(picture, outline, scale, taken, shot.colour(outline.target_id))
    for way in shot.ways:
        if way.words:
            top = scale * (way.points[way.points[:, 1].argmin()] + 0.5) - 0.5
            label(picture, way.words, (float(top[0]), float(top[1]) - 2), shot.colour(way.target_id), taken)
    for position in shot.positions if shot.boxed else ():
        x, y = (scale * (position.box[:2] + [0.5 * position.box[2], 0.0] + 0.5) - 0.5).tolist()
        label(picture, str(position.target_id), (x, y - 2), shot.colour(position.target_id), taken)
    for n, note in enumerate(reversed(shot.notes)):
        _note(picture, note, n)
    return np.vstack([bar(shot.title, size[0]), picture])


def tile(pictures: Sequence[Bytes], columns: int) -> Bytes:
    """Return BGR pictures arranged in rows of `columns` on a dark background.

    Width and height of the result are even, as codecs require.
    """
    height, width = (max(p.shape[k] for p in pictures) for k in (0, 1))
    gap, rows = 4, math.ceil(len(pictures) / columns)
    whole = (rows * height + (rows - 1) * gap, columns * width + (columns - 1) * gap)
    out = np.full((whole[0] + whole[0] % 2, whole[1] + whole[1] % 2, 3), 24, dtype=np.uint8)
    for n, picture in enumerate(pictures):
        top, left = n // columns * (height + gap), n % columns * (width + gap)
        out[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
    return out


def _interpolation(scale: float) -> int:
    return cv2.INTER_LINEAR if scale >= 1.0 else cv2.INTER_AREA


def _points(points: Floats, scale: float) -> NDArray[np.int32]:
    """Return points (k, 2) [px of the frame] as fixed-point integers (k, 1, 2) for OpenCV, with `SUB` fractional bits.

    Distant points are clipped against overflow. `scale`: pixels of the picture per pixel of the frame.
    """
    moved = np.clip(scale * (np.asarray(points) + 0.5) - 0.5, -30_000, 30_000)
    return np.rint(moved * (1 << SUB)).astype(np.int32).reshape(-1, 1, 2)


def _path(picture: Bytes, points: Floats, scale: float, colour: Colour, width: int, *, halo: bool = False) -> None:
    line = [_points(points, scale)]
    if halo:
        cv2.polylines(picture, line, False, BLACK, width + 2, cv2.LINE_AA, SUB)
    cv2.polylines(picture, line, False, colour, width, cv2.LINE_AA, SUB)


def _rim(ellipse: Floats) -> Floats:
    """Return the points (73, 2) [px] of a closed ellipse given as x, y, half axes a, b [px], and angle [rad]."""
    x, y, a, b, rho = ellipse.tolist()
    t = np.linspace(0.0, 2.0 * np.pi, 73)
    u, v = a * np.cos(t), b * np.sin(t)
    return np.column_stack([x + u * math.cos(rho) - v * math.sin(rho), y + u * math.sin(rho) + v * math.cos(rho)])


def _dashes(points: Floats, scale: float) -> list[Floats]:
    """Return the dashes of the polyline `points` (k, 2), as polylines (7, 2) that cover half of its length.

    `scale`: pixels of the picture per pixel of the points, for the number of dashes.
    """
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    count = max(3, round(scale * float(way[-1]) / 22.0))
    parts = (np.arange(count)[:, None] + np.linspace(0.0, 0.5, 7)) / count * way[-1]
    return [np.column_stack([np.interp(part, way, points[:, k]) for k in (0, 1)]) for part in parts]


def draw_way(picture: Bytes, way: LineDrawing, scale: float, colour: Colour) -> None:
    """Draw a polyline, dashed or solid, on the picture in place.

    `scale`: pixels of the picture per pixel of its points.
    """
    for part in _dashes(way.points, scale) if way.dashed else [way.points]:
        _path(picture, part, scale, colour, way.width, halo=way.width > 1)


def _estimate(picture: Bytes, outline: Outline, scale: float, colour: Colour) -> None:
    rim, width = _rim(outline.ellipse), 3 if outline.strong else 2
    for part in _dashes(rim, scale) if outline.dashed else [rim]:
        _path(picture, part, scale, colour, width, halo=True)
    if outline.wrong:
        _path(picture, _rim(outline.ellipse * [1, 1, 1.18, 1.18, 1]), scale, ALARM, 2, halo=True)


def _tag(picture: Bytes, outline: Outline, scale: float, taken: list[Box], colour: Colour) -> None:
    """Draw a target's number, with a text for its failure, above its ellipse.

    Args:
        picture: drawn on, in place.
        outline: outline of the target.
        scale: pixels of the picture per pixel of the frame.
        taken: boxes of earlier labels, which the new one avoids; it is added.
        colour: BGR; failures are red.
    """
    rim = _rim(outline.ellipse)
    x, y = (scale * (rim[rim[:, 1].argmin()] + 0.5) - 0.5).tolist()
    words = str(outline.target_id) + (f" {outline.wrong}" if outline.wrong else "")
    label(picture, words, (x, y - 2), ALARM if outline.wrong else colour, taken)


def label(picture: Bytes, words: str, bottom: tuple[float, float], colour: Colour, taken: list[Box]) -> None:
    """Draw a text on a coloured background on the picture, in place, centred above a point.

    It is moved inside the picture and away from earlier labels.

    Args:
        picture: drawn on.
        words: the text.
        bottom: x and y of the point [px].
        colour: BGR, of the background.
        taken: boxes of earlier labels; the new one is added.
    """
    (width, height), _ = cv2.getTextSize(words, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)
    wide, high = width + 8, height + 8
    top = round(min(max(bottom[1] - high, 0), max(picture.shape[0] - high, 0)))
    middle, most = bottom[0] - 0.5 * wide, max(picture.shape[1] - wide, 0)
    aside = (min(max(middle + step * (wide + 1), 0), most) for step in (0, 1, -1, 2, -2, 3, -3, 4, -4))
    spots = [(round(left), top, round(left) + wide, top + high) for left in aside]
    spot = next((s for s in spots if not any(_overlap(s, t) for t in taken)), spots[0])
    taken.append(spot)
    cv2.rectangle(picture, spot[:2], (spot[2] - 1, spot[3] - 1), colour, cv2.FILLED)
    light = 0.114 * colour[0] + 0.587 * colour[1] + 0.299 * colour[2] > 110.0
    at = (spot[0] + 4, top + height + 3)
    cv2.putText(picture, words, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, BLACK if light else WHITE, 1, cv2.LINE_AA)


def _overlap(a: Box, b: Box) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _corners(box: Floats) -> Floats:
    left, top, width, height = box.tolist()
    right, bottom = left + width, top + height
    return np.array([[left, top], [right, top], [right, bottom], [left, bottom], [left, top]])


def _true_box(picture: Bytes, position: TruePosition, scale: float, colour: Colour) -> None:
    """Draw a true box on the picture in place, dashed if occluded.

    `scale`: pixels of the picture per pixel of the frame.
    """
    corners, hidden = _corners(position.box), position.visible < HIDDEN
    for part in _dashes(corners, scale) if hidden else [corners]:
        _path(picture, part, scale, colour, 2, halo=True)


def _true_cross(picture: Bytes, position: TruePosition, scale: float, own: Colour) -> None:
    """Draw a cross at the centre of a true box, with a ring if it is occluded, and a red cross if it has no tracker.

    Args:
        picture: drawn on, in place.
        position: true box.
        scale: pixels of the picture per pixel of the frame.
        own: BGR colour of the target.
    """
    middle, colour = position.box[:2] + 0.5 * position.box[2:], own if position.coloured else WHITE
    arms = [np.array([middle - arm, middle + arm]) for arm in 5.0 / scale * np.eye(2)]
    for paint, width in ((BLACK, 4), (colour, 2)):
        for arm in arms:
            _path(picture, arm, scale, paint, width)
    if position.visible < HIDDEN:
        _path(picture, _rim(np.array([*middle, 8 / scale, 8 / scale, 0.0])), scale, colour, 1, halo=True)
    if position.missed:
        ring = np.array([*middle, 0.5 * position.box[2], 0.5 * position.box[3], 0.0])
        _path(picture, _rim(ring), scale, ALARM, 2, halo=True)
        d = 0.7071 * 0.5 * position.box[2:]
        for sign in (1.0, -1.0):
            cross = np.array([middle - d * [sign, 1.0], middle + d * [sign, 1.0]])
            _path(picture, cross, scale, ALARM, 2, halo=True)


def _note(picture: Bytes, words: str, line: int) -> None:
    """Draw the text `words` on a dark background in the lower left corner of the picture, `line` lines up."""
    (width, _), _ = cv2.getTextSize(words, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)
    bottom = picture.shape[0] - 22 * line
    cv2.rectangle(picture, (0, max(bottom - 22, 0)), (width + 12, bottom - 1), BLACK, cv2.FILLED)
    cv2.putText(picture, words, (6, bottom - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.5, ALARM, 1, cv2.LINE_AA)


def bar(title: str, width: int) -> Bytes:
    """Return a title bar (BAR, width, 3), BGR, with the title as light text on a dark background."""
    strip = np.full((BAR, width, 3), 24, dtype=np.uint8)
    cv2.putText(strip, title, (6, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (230, 230, 230), 1, cv2.LINE_AA)
    return strip
