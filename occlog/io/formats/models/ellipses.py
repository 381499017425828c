"""Ellipses that trackers in images start with: a CSV file, or the first box of each target in each view.

A CSV file has the columns

    sensor         name or number of the camera
    target_id      identity of the target, the same in all views; from 0
    x_px, y_px     centre in the image
    a_px, b_px     half axes
    rho_deg        angle of axis a, from +x (to the right) towards +y (down)
    frame          number of the frame; skipped: the camera's first one

Of boxes the ellipse inside is taken, the first with centre in the image and of which half can be seen.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints, Strings
from occlog.errors import InputError, abridged, option
from occlog.io.files.names import match_sensor
from occlog.io.files.texts.formats import IDENTITY, RAW, WHOLE, FormatColumn, TextFormat, TextPart, read_format
from occlog.io.open import Opened, open_if_ours
from occlog.records.declared.views import ViewTracks
from occlog.records.tables import Boxes, TruthBoxes

WHAT = "a table of ellipses"
FIRST = -1
"""`GivenEllipse.frame` where the file does not state."""
FORMAT = TextFormat(
    WHAT,
    {
        "sensor": FormatColumn(("sensor", "camera", "view", "cam"), RAW),
        "target_id": FormatColumn(("target_id", "id", "target"), IDENTITY, least=0),
        "x_px": FormatColumn(("x_px", "x", "cx")),
        "y_px": FormatColumn(("y_px", "y", "cy")),
        "a_px": FormatColumn(("a_px", "a"), above=0.0, unit="px"),
        "b_px": FormatColumn(("b_px", "b"), above=0.0, unit="px"),
        "rho_deg": FormatColumn(("rho_deg",)),
        "frame": FormatColumn(("frame",), WHOLE, least=0, default=FIRST, blank=False),
    },
)
SEEN = 0.5
"""Share of a target that must be visible for a true box to be started from."""
Sizes = Mapping[str, tuple[int, int]]
"""Width and height [px] of the images of each camera."""


class GivenEllipse(NamedTuple):
    """Initial ellipse of a target in a view.

    Attributes:
        where: file and position in it, for messages.
        sensor: name of the camera.
        target_id: identity of the target.
        frame: number of the frame; `FIRST` (-1): the camera's first one.
        ellipse: (5,) centre x, y [px], half axes a, b [px], and angle rho of axis a [rad] from +x (right) to +y (down).
    """

    where: str  # file and position in it
    sensor: str
    target_id: int
    frame: int
    ellipse: Floats  # (5,) see `occlog.core.image`


def read_ellipses(path: Path, sizes: Sizes, cameras: Sequence[str]) -> tuple[GivenEllipse, ...]:
    """Read the initial ellipses of targets from a file; those of cameras without an image size are skipped.

    Args:
        path: CSV, a table (view_tracks, truth_boxes, or boxes with identities), or a recording with boxes.
        sizes: width and height [px] of the images of the cameras that are used.
        cameras: names of all cameras of the recording.

    Raises:
        InputError: an ellipse is impossible, or there is none.
    """
    opened = open_if_ours(path, WHAT)
    if opened is not None:
        found = _of_tables(opened, sizes)
    else:
        found = [e for e in _of_csv(path, cameras) if e.sensor in sizes]
        for each in found:
            _check_inside(each, *sizes[each.sensor])
    if not found:
        raise InputError(
            f"{path}: no ellipse of a target in {abridged(sizes)}; give one for each target and view",
            id="missing-value",
        )
    return tuple(found)


def _of_csv(path: Path, cameras: Sequence[str]) -> list[GivenEllipse]:
    found: list[GivenEllipse] = []
    lines: dict[tuple[str, int], int] = {}
    for part in read_format(path, FORMAT):
        rows = part.rows
        for row, each in enumerate(_csv_rows(part, cameras)):
            key = each.sensor, each.target_id
            if key in lines:
                raise rows.fail(
                    row,
                    f"target {each.target_id} is in camera {each.sensor} already (line {lines[key]}); keep one of them",
                )
            lines[key] = int(rows.lines[row])
            found.append(each)
    return found


def _csv_rows(part: TextPart, cameras: Sequence[str]) -> Iterator[GivenEllipse]:
    ellipse = np.column_stack([part[name] for name in ("x_px", "y_px", "a_px", "b_px", "rho_deg")])
    ellipse[:, 4] = np.radians(ellipse[:, 4])
    for row in range(len(part)):
        where = f"{part.rows.path}: line {int(part.rows.lines[row])}"
        sensor = match_sensor(str(part["sensor"][row]), cameras, where)
        yield GivenEllipse(where, sensor, int(part["target_id"][row]), int(part["frame"][row]), ellipse[row])


def _check_inside(given: GivenEllipse, width: int, height: int) -> None:
    """InputError if the centre of an ellipse is outside the image, or a half axis is longer than the image's diagonal.

    `width` and `height` are those of the camera's images [px].
    """
    for name, value, most in (("x_px", given.ellipse[0], width), ("y_px", given.ellipse[1], height)):
        if not -0.5 <= value <= most - 0.5:
            raise InputError(
                f"{given.where}: {name} is {value:g}, outside the image of camera {given.sensor}, which reaches from "
                f"-0.5 to {most - 0.5:g} px; correct it, or give a `frame` in which the target is inside",
                id="image-size-mismatch",
            )
    longest = math.hypot(width, height)
    for name, value in (("a_px", given.ellipse[2]), ("b_px", given.ellipse[3])):
        if value > longest:
            raise InputError(
                f"{given.where}: {name} is {value:g}, must be at most {longest:.0f} px, the diagonal of the images of "
                f"camera {given.sensor}; it is a half axis of a person's ellipse"
            )


def _of_tables(opened: Opened, sizes: Sizes) -> list[GivenEllipse]:
    """First ellipse of each target in each view, from tracks in images, true boxes, or boxes with identities.

    `sizes` are width and height of each camera's images [px]; other cameras are skipped.
    """
    opened.require(ViewTracks, TruthBoxes, Boxes, remedy="give a CSV file of ellipses, or begin from detections")
    if opened.has(ViewTracks):
        return _first_of(opened.path, (_tracks(c) for c in opened.rows(ViewTracks)), sizes)
    if opened.has(TruthBoxes):
        return _first_of(opened.path, (_true_boxes(c) for c in opened.rows(TruthBoxes)), sizes)
    return _first_of(opened.path, (_boxes(c) for c in opened.rows(Boxes)), sizes)


class _EllipseRows(NamedTuple):
    """N ellipses of several views and frames, in columns; ellipses are (x, y, a, b [px], rho [rad])."""

    sensor: Strings
    target_id: Ints
    frame: Ints
    ellipse: Floats  # (N, 5)
    good: Bools  # (N,) fit to start from


def _tracks(c: ViewTracks) -> _EllipseRows:
    ellipse = np.column_stack([c.x_px, c.y_px, c.a_px, c.b_px, c.rho])
    return _EllipseRows(c.sensor, c.target_id.astype(np.int64), c.frame, ellipse, np.ones(len(c), dtype=np.bool_))


def _true_boxes(c: TruthBoxes) -> _EllipseRows:
    rows = _boxes(c)
    return rows._replace(good=rows.good & ~(c.visible < SEEN))


def _boxes(c: Boxes) -> _EllipseRows:
    x, y = c.left_px + 0.5 * c.width_px, c.top_px + 0.5 * c.height_px
    ellipse = np.column_stack([x, y, 0.5 * c.width_px, 0.5 * c.height_px, np.zeros(len(c))])
    return _EllipseRows(c.sensor, c.target_id.astype(np.int64), c.frame, ellipse, (c.box >= 0) & (c.target_id >= 0))


def _first_of(path: Path, chunks: Iterable[_EllipseRows], sizes: Sizes) -> list[GivenEllipse]:
    """First usable ellipse of each target in each view with the centre in the image.

    Args:
        path: file that the rows are from, for messages and the result.
        chunks: rows in the order of the file; `good` marks usable ones (of true boxes: at least half visible).
        sizes: width and height of each camera's images [px]; rows of other cameras are skipped.

    Raises:
        InputError: no row has an identity.
    """
    found: dict[tuple[str, int], GivenEllipse] = {}
    anonymous = rows = 0
    for c in chunks:
        rows += len(c.sensor)
        anonymous += int((c.target_id < 0).sum())
        for row in np.flatnonzero(c.good).tolist():
            key = str(c.sensor[row]), int(c.target_id[row])
            if key in found or key[0] not in sizes:
                continue
            (x, y), (width, height) = c.ellipse[row, :2], sizes[key[0]]
            if -0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5:
                found[key] = GivenEllipse(f"{path}", *key, int(c.frame[row]), c.ellipse[row])
    if rows and anonymous == rows:
        raise InputError(
            f"{path}: its boxes have no identities, which {option('initial_ellipses')} requires; give these boxes to "
            f"{option('detections')} instead",
            id="wrong-content",
        )
    return list(found.values())
