"""WILDTRACK's annotations: a folder with one JSON file a frame, of people with a place and a box in each view.

    [{"personID": 122, "positionID": 456826,
      "views": [{"viewNum": 0, "xmin": 1510, "ymin": 139, "xmax": 1561, "ymax": 288}]}]

The number in a file's name is that of the frame (00000000, 00000005, ...).  View 0 is camera C1; -1 stands for a view
in which the person is not.  A position p is a point of a grid: x = -3 m + 2.5 cm (p mod 480), y = -9 m + 2.5 cm (p div
480), on the floor.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.files.names.last_number import last_number
from occlog.io.files.names.sensors import match_sensor, natural_sorted
from occlog.io.files.texts.csv_rows import Rows
from occlog.io.files.texts.json_file import parse_json
from occlog.io.files.texts.registry import Probe, is_folder
from occlog.io.files.untrusted.inputs import check_input

from .columns import BoxSource, Wanted, rows_of

ACROSS, ALONG = 480, 1440
"""Points of the grid."""
ORIGIN, STEP = (-3.0, -9.0), 0.025
"""First point and spacing of the grid [m]."""
EDGES = {"xmin": "left", "ymin": "top", "xmax": "right", "ymax": "bottom"}
MAX_BYTES = 16 * 2**20
FRAMES_PER_CHUNK = 256


class Person(NamedTuple):
    """A person in one frame: number in the file, identity, position on the grid, and edges by view."""

    entry: int
    identity: int
    position: int
    views: dict[int, dict[str, str]]


def frame_files(folder: Path) -> dict[int, Path]:
    """The file of each frame, by rising number; empty where the folder holds none."""
    names = [p.name for p in folder.iterdir() if p.suffix.lower() == ".json" and last_number(p.stem)]
    found: dict[int, Path] = {}
    for name in natural_sorted(names):
        number = int(last_number(Path(name).stem) or 0)
        if number in found:
            raise InputError(f"{folder / name}: is frame {number}, as {found[number].name} is; keep one")
        found[number] = folder / name
    return dict(sorted(found.items()))


def is_annotations(probe: Probe) -> bool:
    """Whether a folder holds annotations."""
    return is_folder(probe) and bool(frame_files(probe.path))


def open_annotations(path: Path, wanted: Wanted) -> BoxSource:
    """The boxes of the views of known cameras, of all if none is known; identities are those of the people."""
    known = wanted.known
    files = frame_files(path)
    listed = np.array(list(files), dtype=np.int64)
    first = read_people(next(iter(files.values())))
    named = {view: f"C{view + 1}" for view in sorted({view for person in first for view in person.views})}
    cameras = {view: name for view, name in named.items() if not known or _is_known(name, known)}
    kind = "WILDTRACK's annotations"
    return BoxSource(_chunks(path, files, cameras), kind, listed, tuple(cameras.values()))


def _is_known(name: str, known: Sequence[str]) -> bool:
    try:
        match_sensor(name, known, "")
    except InputError:
        return False
    return True


def _chunks(path: Path, files: dict[int, Path], cameras: Mapping[int, str]) -> Iterator[Rows]:
    numbers = list(files)
    for start in range(0, len(numbers), FRAMES_PER_CHUNK):
        records, sources = [], []
        for frame in numbers[start : start + FRAMES_PER_CHUNK]:
            for person in read_people(files[frame]):
                for view, edges in person.views.items():
                    if edges and view in cameras:
                        cells = {"frame": str(frame), "camera": cameras[view], "id": str(person.identity), **edges}
                        records.append((person.entry, cells))
                        sources.append(files[frame])
        if records:
            yield rows_of(path, records, "person", sources)


def read_people(file: Path) -> list[Person]:
    """The people of a frame; a view in which a person is not has no edges.

    Raises:
        InputError: the file is not of this form.
    """
    check_input(file, "annotations of a frame")
    if file.stat().st_size > MAX_BYTES:
        raise InputError(f"{file}: {file.stat().st_size} bytes; annotations of at most {MAX_BYTES} were expected")
    value = parse_json(file.read_bytes(), file, "annotations of a frame")
    if not isinstance(value, list):
        raise InputError(f"{file}: a list of people was expected, with personID, positionID and views")
    return [_person(file, n, person) for n, person in enumerate(value, start=1)]


def _person(file: Path, n: int, person: Any) -> Person:
    where = f"{file}: person {n}"
    try:
        identity, position, views = person["personID"], person["positionID"], person["views"]
        found = {view["viewNum"]: [view[edge] for edge in EDGES] for view in views}
    except (TypeError, KeyError) as error:
        raise InputError(
            f"{where}: has no {error}; want personID, positionID and views with {', '.join(EDGES)}"
        ) from None
    numbers = [identity, position, *found, *(edge for edges in found.values() for edge in edges)]
    if not all(isinstance(v, int | float) and not isinstance(v, bool) for v in numbers):
        raise InputError(f"{where}: personID, positionID, viewNum and edges must be numbers")
    for name, number in (("personID", identity), *(("viewNum", view) for view in found)):
        if not isinstance(number, int) or not 0 <= number < 2**31:
            raise InputError(f"{where}: {name} is {str(number)[:40]}; a whole number from 0 was expected")
    if not isinstance(position, int) or not 0 <= position < ACROSS * ALONG:
        raise InputError(f"{where}: positionID {position}; WILDTRACK's grid has {ACROSS} x {ALONG} points, from 0")
    edges = {
        int(view): {} if all(v == -1 for v in values) else dict(zip(EDGES.values(), map(repr, values), strict=True))
        for view, values in found.items()
    }
    return Person(n, int(identity), position, edges)


def grid_places(position: Floats) -> tuple[Floats, Floats]:
    """Places (x, y) [m] of points of the grid."""
    return ORIGIN[0] + STEP * (position % ACROSS), ORIGIN[1] + STEP * (position // ACROSS)
