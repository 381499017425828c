"""Boxes in XML: <frame number> <object id> <box xc yc w h>, as for the PETS and CAVIAR data sets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from occlog.errors import InputError
from occlog.io.boxes.reader import BoxOptions
from occlog.io.boxes.rows import FRAMES_PER_CHUNK, BoxRows, fill_frames
from occlog.io.files.texts.xml_file import number, required
from occlog.io.files.times.frame_times import FrameTimes
from occlog.io.files.untrusted.guard import guarded
from occlog.io.files.untrusted.inputs import check_input
from occlog.records.tables import TruthBoxes

Row = tuple[int, int, float, float, float, float]


def read_xml_boxes(
    path: Path, camera: str, times: Mapping[str, FrameTimes], options: BoxOptions
) -> Iterator[TruthBoxes]:
    """Tables of true boxes; a frame that is listed without an object gets a row with `box` = -1.

    Frames that are not listed have not been annotated: they get no row.
    """
    first, stop = options.frames or (0, 2**62)
    rows: list[Row] = []
    run: list[int] = []
    for frame, objects in _frames(path, options.first_number):
        if not first <= frame < stop:
            continue
        if run and (frame != run[-1] + 1 or len(run) >= FRAMES_PER_CHUNK):
            yield from _tables(path, rows, run, camera, times)
            rows, run = [], []
        run.append(frame)
        rows += objects
    if run:
        yield from _tables(path, rows, run, camera, times)


def _tables(
    path: Path, rows: list[Row], run: list[int], camera: str, times: Mapping[str, FrameTimes]
) -> Iterator[TruthBoxes]:
    values = np.array(rows, dtype=np.float64).reshape(-1, 6)
    frame, identity = values[:, 0].astype(np.int64), values[:, 1].astype(np.int64)
    xc, yc, w, h = values[:, 2:].T
    nobody, unknown = np.zeros(len(rows), dtype=np.int64), np.full(len(rows), np.nan)
    boxes = BoxRows(
        frame=frame,
        camera=nobody,
        target_id=identity,
        left=xc - w / 2,
        top=yc - h / 2,
        width=w,
        height=h,
        confidence=unknown,
    )
    try:
        yield from fill_frames(iter([boxes] if len(rows) else []), TruthBoxes, [camera], run[0], run[-1] + 1, times)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _frames(path: Path, first_number: int) -> Iterator[tuple[int, list[Row]]]:
    """Frame number (from 0) and rows of every frame, in rising order."""
    last = -1
    found = False
    for element in _elements(path):
        if element.tag != "frame":
            continue
        frame = _whole(element, "number", str(path)) - first_number
        if frame < 0:
            raise InputError(f"{path}: frame {frame + first_number} is before the first number, {first_number}")
        if frame <= last:
            raise InputError(f"{path}: frame {frame + first_number} does not come after the one before it; sort them")
        yield frame, _objects(element, frame, f"{path}: frame {frame + first_number}")
        last, found = frame, True
        element.clear()
    if not found:
        raise InputError(f"{path}: has no <frame>; frames with objects and boxes were expected")


def _elements(path: Path) -> Iterator[Element]:
    """Every element when it ends; InputError where the text is not XML."""
    with check_input(path, "ground truth (XML)").open("rb") as file:
        ends = iter(ElementTree.iterparse(file))
        while True:
            with guarded(path, "ground truth (XML)"):
                try:
                    end = next(ends, None)
                except ElementTree.ParseError as error:
                    raise InputError(
                        f"{path}: line {error.position[0]}: not XML ({error}); correct or export it again"
                    ) from None
            if end is None:
                return
            yield end[1]


def _objects(frame: Element, number_of_frame: int, where: str) -> list[Row]:
    rows: list[Row] = []
    for thing in frame.iter("object"):
        identity = _whole(thing, "id", where)
        place = f"{where}: object {identity}"
        box = required(thing, "box", place)
        xc, yc, w, h = (number(box, name, place) for name in ("xc", "yc", "w", "h"))
        if not (w > 0 and h > 0):
            raise InputError(f"{place}: box of {w:g} x {h:g} px; both must be above 0")
        rows.append((number_of_frame, identity, xc, yc, w, h))
    return rows


def _whole(element: Element, name: str, where: str) -> int:
    value = number(element, name, where)
    if value != int(value) or abs(value) >= 2**31:
        raise InputError(f"{where}: {name} of <{element.tag}> is {element.get(name)!r}; a whole number was expected")
    return int(value)
