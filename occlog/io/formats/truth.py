"""Ground truth in the formats of data sets.

Triangulated corners of a calibration board (caliscope's xyz_*.csv) as the truth of one point.

Ground truth: positions on the ground, and boxes in the views.

Formats (`FORMATS`), found out from the content:

    csv        a header line with x, y and perhaps z, id, role, and a column of times or
               frame; or with left, top, ... as for detector boxes
    mot        MOTChallenge text: boxes, and positions where the last three columns are not -1
    kitti      KITTI's text of tracks: boxes of one view
    cvat       XML of the annotation tool CVAT: boxes of one view
    xml        frames with objects and their boxes (xc, yc, w, h), as for the PETS data sets
    wildtrack  a folder with one JSON file a frame: positions of people, and their boxes in each view
    vatic      text of the annotation tool VATIC, as of CAMPUS: boxes of one view
    caliscope  triangulated board corners (xyz_*.csv): the mean of the corners seen throughout
    locata     positions of one source of the LOCATA challenge (position_source_*.txt)

Boxes in XML: <frame number> <object id> <box xc yc w h>, as for the PETS and CAVIAR data sets.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from occlog.array_types import Floats, Ints, Strings
from occlog.errors import InputError, UsageError, option
from occlog.io.files.limits import check_input, folder_hint, naming
from occlog.io.files.texts.csv_rows import CsvRows, first_line, is_header, name_with_unit, read_plain
from occlog.io.files.texts.documents import number, required, xml_events
from occlog.io.files.texts.formats import (
    IDENTITY,
    LENGTH,
    RAW,
    TEXT,
    WHOLE,
    FileFormat,
    FormatColumn,
    Probe,
    TextFormat,
    TextPart,
    by_cells,
    read_format,
    recognise,
)
from occlog.io.files.timing.frame_times import FrameTimes, no_frame_times
from occlog.io.files.timing.times import TIME_COLUMNS, note_clock_set, time_column
from occlog.io.files.timing.utc import time_words
from occlog.records.tables import Truth, TruthBoxes
from occlog.settings import METRES

from .boxes.annotations import is_cvat
from .boxes.columns import ACROSS
from .boxes.columns import COLUMNS as BOX_COLUMNS
from .boxes.datasets import frame_files, grid_places, is_annotations, is_kitti, is_vatic, read_people
from .boxes.reader import BoxFile, BoxOptions, read_boxes, survey_boxes
from .boxes.rows import FRAMES_PER_CHUNK, FileBoxRows, fill_frames
from .sound.formats import looks_like_locata, read_source

CORNERS = TextFormat(
    "board corners",
    {
        "sync": FormatColumn(("sync_index",), WHOLE),
        "object": FormatColumn(("object_id",), WHOLE, default=0, blank=False),
        "corner": FormatColumn(("keypoint_id", "point_id"), WHOLE),
        "x": FormatColumn(("x_coord", "x")),
        "y": FormatColumn(("y_coord", "y")),
        "z": FormatColumn(("z_coord", "z")),
        "time": FormatColumn(("frame_time",), RAW, default=""),
    },
)
SYNC_TIMES = TextFormat(
    "time stamps with a column sync_index", {"sync": FormatColumn(("sync_index",), WHOLE)}, True, others=True
)
MIN_CORNERS = 3


def read_board(path: Path, sync_ns: Mapping[int, int] | None) -> Truth:
    """Read the centre of a calibration board over time (caliscope), as the truth of target 0.

    The mean of a varying set of corners would jump; it is computed from the corners present at every time or, if these
    are fewer than three, from all corners at the times when all are present.

    Args:
        path: the file of triangulated corners.
        sync_ns: time [ns] of each synchronisation index, from `read_sync_times`; None: not given.

    Raises:
        UsageError: the times are not given.
        InputError: a corner is repeated, too few are present, or an index has no time.
    """
    if sync_ns is None:
        raise UsageError(
            f"{path}: states sync_index, not times; give the file with their times ({option('timestamps')} "
            "timestamps.csv)",
            id="missing-times",
        )
    sync, corner, xyz = _read(path)
    names, column = np.unique(corner, return_inverse=True)
    times, row = np.unique(sync, return_inverse=True)
    grid = np.full((len(times), len(names), 3), np.nan)
    if len(np.unique(row * len(names) + column)) < len(row):
        first = np.unique(row * len(names) + column, return_index=True)[1]
        double = int(np.setdiff1d(np.arange(len(row)), first)[0])
        raise InputError(
            f"{path}: corner {corner[double] % 1_000_000} is there twice at sync_index {sync[double]}; remove the "
            "copies, or make a file of each recording",
            id="duplicate-row",
        )
    grid[row, column] = xyz
    there = np.isfinite(grid[:, :, 0])
    always = there.all(axis=0)
    if int(always.sum()) >= MIN_CORNERS:
        middle, kept = grid[:, always].mean(axis=1), times
    else:
        whole = there.all(axis=1)
        middle, kept = grid[whole].mean(axis=1), times[whole]
    if not len(kept):
        raise InputError(
            f"{path}: the board's centre is undefined: no time has all corners, and fewer than {MIN_CORNERS} are there "
            "at all times; omit corners or times that are often missing",
            id="insufficient-data",
        )
    missing = [int(s) for s in kept if int(s) not in sync_ns]
    if missing:
        raise InputError(
            f"{path}: sync_index {missing[0]} has no time in the file of {option('timestamps')}; give that of the same "
            "recording",
            id="missing-times",
        )
    t_ns = np.array([sync_ns[int(s)] for s in kept], dtype=np.int64)
    n = len(kept)
    with naming(path):
        return Truth.of(
            t_ns=t_ns,
            target_id=np.zeros(n, dtype=np.int32),
            role=np.full(n, "target"),
            x=middle[:, 0],
            y=middle[:, 1],
            z=middle[:, 2],
        )


def _read(path: Path) -> tuple[Ints, Ints, Floats]:
    sync, corner, xyz = [], [], []
    for part in read_format(path, CORNERS):
        sync.append(part["sync"])
        corner.append(part["corner"] + 1_000_000 * part["object"])  # of several boards
        xyz.append(np.column_stack([part[axis] for axis in "xyz"]))
    if not sync:
        raise InputError(f"{path}: holds a header and no row; {CORNERS.what} were expected", id="empty-input")
    return np.concatenate(sync), np.concatenate(corner), np.concatenate(xyz)


def read_sync_times(path: Path) -> dict[int, int]:
    """Time [ns] of each synchronisation index in caliscope's timestamps.csv: the mean over its cameras."""
    found: dict[int, list[int]] = {}
    for part in read_format(path, SYNC_TIMES):
        for sync, t in zip(part["sync"].tolist(), part.times().tolist(), strict=True):
            found.setdefault(sync, []).append(t)
    return {sync: _mean(times) for sync, times in found.items()}


def _mean(times: list[int]) -> int:
    """Mean of integer times [ns], rounded; sums are relative to the earliest one, so that no digits are lost."""
    first = min(times)
    return first + round(sum(t - first for t in times) / len(times))


Row = tuple[int, int, float, float, float, float]


def read_xml_boxes(
    path: Path, camera: str, times: Mapping[str, FrameTimes], options: BoxOptions
) -> Iterator[TruthBoxes]:
    """Yield tables of true boxes of a camera from XML (PETS, CAVIAR).

    A frame that is listed without an object gets a row with `box` = -1; frames that are not listed have not been
    annotated, and get no row.

    Args:
        path: the file.
        camera: its name.
        times: frame times by camera.
        options: first frame number, and selection of frames.
    """
    first, stop = options.frames.of(camera) or (0, 2**62)
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
    unlabelled, unknown = np.zeros(len(rows), dtype=np.int64), np.full(len(rows), np.nan)
    boxes = FileBoxRows(
        frame=frame,
        camera=unlabelled,
        target_id=identity,
        left=xc - w / 2,
        top=yc - h / 2,
        width=w,
        height=h,
        confidence=unknown,
    )
    try:
        yield from fill_frames(
            iter([boxes] if len(rows) else []), TruthBoxes, [camera], [range(run[0], run[-1] + 1)], times
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _frames(path: Path, first_number: int) -> Iterator[tuple[int, list[Row]]]:
    """Yield number (from 0) and boxes of each `<frame>` of an XML file.

    `first_number` is the number that the file gives to frame 0. InputError if numbers do not increase or no frame
    exists.
    """
    last = -1
    found = False
    for _, element in xml_events(path, "ground truth (XML)"):
        if element.tag != "frame":
            continue
        frame = _whole(element, "number", str(path)) - first_number
        if frame < 0:
            raise InputError(
                f"{path}: frame {frame + first_number} is before the first number, {first_number}; give a smaller "
                f"{option('first_number')}"
            )
        if frame <= last:
            raise InputError(
                f"{path}: frame {frame + first_number} does not come after the <frame> before it; sort them by number",
                id="unsorted-times",
            )
        yield frame, _objects(element, frame, f"{path}: frame {frame + first_number}")
        last, found = frame, True
        element.clear()
    if not found:
        raise InputError(f"{path}: has no <frame>; frames with objects and boxes were expected", id="empty-input")


def _objects(frame: Element, number_of_frame: int, where: str) -> list[Row]:
    rows: list[Row] = []
    for thing in frame.iter("object"):
        identity = _whole(thing, "id", where)
        location = f"{where}: object {identity}"
        box = required(thing, "box", location)
        xc, yc, w, h = (number(box, name, location) for name in ("xc", "yc", "w", "h"))
        if not (w > 0 and h > 0):
            raise InputError(f"{location}: box of {w:g} x {h:g} px; width and height must be above 0")
        rows.append((number_of_frame, identity, xc, yc, w, h))
    return rows


def _whole(element: Element, name: str, where: str) -> int:
    value = number(element, name, where)
    if value != int(value) or abs(value) >= 2**31:
        raise InputError(f"{where}: {name} of <{element.tag}> is {element.get(name)!r}; a whole number was expected")
    return int(value)


WHAT = "ground truth"
POSITIONS = TextFormat(
    WHAT,
    {
        "frame": FormatColumn(("frame", "frame_id", "frame_number", "frame_index"), WHOLE, default=-1, blank=False),
        "id": FormatColumn(("id", "target_id", "track_id", "object_id", "person_id"), IDENTITY, default=0),
        "x": FormatColumn(("x", "x_m", "pos_x"), LENGTH),
        "y": FormatColumn(("y", "y_m", "pos_y"), LENGTH),
        "z": FormatColumn(("z", "z_m", "pos_z"), LENGTH, default=np.nan),
        "role": FormatColumn(("role",), TEXT, choices=("target", "occluder"), default="target"),
    },
    times=True,
)


def _in_unit(unit: str) -> TextFormat:
    """Format of position tables with a length unit in the names of the coordinate columns (`x_mm`)."""
    lengths = {axis: replace(POSITIONS.columns[axis], names=(f"{axis}_{unit}",)) for axis in "xyz"}
    return replace(POSITIONS, columns={**POSITIONS.columns, **lengths})


IN_UNITS = {unit: _in_unit(unit) for unit in METRES if unit != "m"}
"""Positions by the unit of length that the names of their columns end in."""


def frames_of_positions(path: Path) -> tuple[int, int] | None:
    """First and last frame number of a position table that has frame numbers instead of times.

    None for other files, also those that cannot be read.
    """
    try:
        head = {name_with_unit(cell.lower()) for cell in first_line(path, WHAT)}
        times = {name for names in TIME_COLUMNS.values() for name in names}
        if head & times or not head & set(POSITIONS.columns["frame"].names):
            return None
        form = next((f for f in (POSITIONS, *IN_UNITS.values()) if head & set(f.columns["x"].names)), None)
        if form is None:
            return None
        spans = [part["frame"] for part in read_format(path, form, ignore_extra=True) if len(part)]
    except InputError:
        return None
    return (min(int(s.min()) for s in spans), max(int(s.max()) for s in spans)) if spans else None


@dataclass(frozen=True, eq=False)
class TruthOptions:
    """Options for reading truth files.

    Attributes:
        format: a key of `FORMATS`, or `auto`.
        camera: camera of the boxes of a file that does not state it; None: not given.
        cameras: names of the cameras in use.
        times: frame times by camera; those of the empty name hold for positions without cameras.
        sync_ns: time [ns] of each synchronisation index (caliscope); None: not given.
        length_unit: of the positions that are returned, and of tables that state none.
        boxes: how boxes are to be read.
    """

    format: str = "auto"
    camera: str | None = None
    cameras: Sequence[str] = ()
    times: Mapping[str, FrameTimes] = field(default_factory=dict)
    sync_ns: Mapping[int, int] | None = None
    length_unit: str = "m"
    boxes: BoxOptions = BoxOptions()

    def frame_times(self, where: str) -> FrameTimes:
        """Frame times of the file's camera, else those that all cameras have in common; `where` names the file.

        UsageError if they are unknown, or differ between cameras.
        """
        if self.camera is not None and self.camera in self.times:
            return self.times[self.camera]
        if not self.times:
            raise no_frame_times(where)
        first, *others = self.times.values()
        if not all(times.same_as(first) for times in others):
            raise UsageError(
                f"{where}: counts frames, which have other times in each camera; state its camera: CAMERA={where}",
                id="missing-option",
            )
        return first


class TruePositions(NamedTuple):
    """n true positions in columns: time [ns], identity, role, x, y, z, and line number in the file."""

    t_ns: Ints
    target_id: Ints
    role: Strings
    x: Floats
    y: Floats
    z: Floats
    line: Ints


def _csv_positions(part: TextPart, options: TruthOptions) -> TruePositions:
    """True positions in some rows of a table with a header; times from their column, or from frame numbers."""
    t_ns = _row_times(part, options)
    return TruePositions(t_ns, part["id"], part["role"], part["x"], part["y"], part["z"], part.rows.lines)


def _row_times(part: TextPart, options: TruthOptions) -> Ints:
    if time_column(part.rows) is not None:
        return part.times()
    path = part.rows.path
    if not part.rows.has("frame"):
        raise InputError(f"{path}: has neither a column of times (time, t_ns) nor frame; add one", id="missing-column")
    try:
        return options.frame_times(path.name).at(part["frame"] - options.boxes.first_number)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _gather(path: Path, parts: list[TruePositions]) -> Truth:
    """Table of the true positions in all parts, sorted by time and target.

    InputError if there is none, or a target has two positions at one time.
    """
    if not parts:
        raise InputError(f"{path}: holds a header and no row; true positions were expected", id="empty-input")
    p = TruePositions._make(np.concatenate(column) for column in zip(*parts, strict=True))
    note_clock_set(path, "line", p.line, p.t_ns, [p.target_id])
    order = np.lexsort((p.target_id, p.t_ns))
    p = TruePositions._make(column[order] for column in p)
    double = np.flatnonzero((np.diff(p.t_ns) == 0) & (np.diff(p.target_id) == 0))
    if len(double):
        k = int(double[0])
        raise InputError(
            f"{path}: lines {min(p.line[k : k + 2])} and {max(p.line[k : k + 2])}: target {p.target_id[k]} is twice at "
            f"{time_words(p.t_ns[k])}; remove one",
            id="duplicate-row",
        )
    with naming(path):
        return Truth.of(t_ns=p.t_ns, target_id=p.target_id, role=p.role, x=p.x, y=p.y, z=p.z)


def _mot_positions(rows: CsvRows, options: TruthOptions) -> TruePositions | None:
    """True world positions in rows of MOTChallenge text; None if there are none.

    They are the last three columns of rows where these are not all -1 and the flag (column 7) is not 0.
    """
    if len(rows.cells) < 10:
        return None
    x, y, z = rows.floats("7"), rows.floats("8"), rows.floats("9")
    known = np.flatnonzero(~((x == -1) & (y == -1) & (z == -1)) & (rows.floats("6") != 0))
    if not len(known):
        return None
    try:
        t_ns = options.frame_times(rows.path.name).at(rows.ints("0")[known] - 1)
    except InputError as error:
        raise InputError(f"{rows.path}: {error}") from error
    role = np.full(len(known), "target")
    return TruePositions(
        t_ns=t_ns,
        target_id=rows.identities("1")[known],
        role=role,
        x=x[known],
        y=y[known],
        z=z[known],
        line=rows.lines[known],
    )


TruthFormat = FileFormat[Callable[[Path, TruthOptions], Iterator[Truth | TruthBoxes]]]


def read_truth(path: Path, options: TruthOptions) -> Iterator[Truth | TruthBoxes]:
    """Yield tables of true positions, true boxes or both from a file or folder, in the stated or recognised format.

    Raises:
        InputError: the format is unknown, or the content is invalid.
        UsageError: the camera, or times of frames, are not stated.
    """
    probe = Probe(path, WHAT)
    if path.is_dir():
        if options.format not in ("auto", "wildtrack") or not FORMATS["wildtrack"].sniff(probe):
            if hint := folder_hint(path):
                raise InputError(f"{path}: is a folder{hint}", id="not-a-file")
            raise InputError(
                f"{path}: is a folder; only WILDTRACK's annotations (JSON, format wildtrack) are read from one; give "
                "these, or a file",
                id="unknown-format",
            )
        return _read_wildtrack(path, options)
    check_input(path, WHAT)
    return FORMATS[_format(probe, options.format)].read(path, options)


def _format(probe: Probe, stated: str) -> str:
    """Name of a file's format: the one stated, or for `auto` the first that recognises it; InputError if none does."""
    name = recognise(FORMATS, probe, stated, "truth")
    if name is None:
        remedy, head = "name its columns in a header line", probe.cells
        if is_header(head):
            remedy = f"its header is {', '.join(head)[:120]}; time (or t_ns, frame), x and y were expected, perhaps id"
        raise InputError(
            f"{probe.path}: not ground truth of a known format ({', '.join(FORMATS)}); {remedy}", id="unknown-format"
        )
    return name


def _one_camera(path: Path, options: TruthOptions) -> str:
    """Name of the camera of a file with boxes: the one stated, or the only one in use; UsageError if it is unclear."""
    if options.camera is not None:
        return options.camera
    if len(options.cameras) == 1:
        return options.cameras[0]
    raise UsageError(
        f"{path}: holds boxes of one camera and does not name it; give it as CAMERA={path.name}", id="camera-not-named"
    )


def _read_boxes(path: Path, options: TruthOptions, camera: str | None) -> Iterator[TruthBoxes]:
    files = [BoxFile(path, camera)]
    # In ground truth a confidence of 0 marks boxes that do not count.
    how = replace(options.boxes, drop_zero=True)
    survey = survey_boxes(files, options.cameras, how)
    times = {**survey.times, **options.times}
    yield from read_boxes(files, survey, times, options.cameras, how, TruthBoxes)


def _read_csv(path: Path, options: TruthOptions) -> Iterator[Truth | TruthBoxes]:
    header = [name_with_unit(cell.lower()) for cell in first_line(path, WHAT)]
    if any(name in header for name in ACROSS):
        named = any(name in header for name in BOX_COLUMNS["camera"])
        yield from _read_boxes(path, options, None if named else _one_camera(path, options))
        return
    unit = next((name for name, each in IN_UNITS.items() if any(x in header for x in each.columns["x"].names)), "")
    rows = read_format(path, IN_UNITS[unit] if unit else POSITIONS, ignore_extra=options.boxes.ignore_extra)
    parts = [_csv_positions(part, options) for part in rows]
    if unit and unit != options.length_unit:
        if options.length_unit not in METRES:
            raise InputError(
                f"{path}: lengths are in {unit}, which cannot be converted to {options.length_unit} of the scene; "
                "convert them",
                id="unit-mismatch",
            )
        scale = METRES[unit] / METRES[options.length_unit]
        parts = [p._replace(x=scale * p.x, y=scale * p.y, z=scale * p.z) for p in parts]
    yield _gather(path, parts)


def _read_mot(path: Path, options: TruthOptions) -> Iterator[Truth | TruthBoxes]:
    if _has_places_alone(path):
        yield _gather(path, _all_mot_positions(path, options))
        return
    camera = _one_camera(path, options)
    options = replace(options, camera=camera)
    parts = _all_mot_positions(path, options)
    if parts:
        yield _gather(path, parts)
    yield from _read_boxes(path, options, camera)


def _all_mot_positions(path: Path, options: TruthOptions) -> list[TruePositions]:
    return [p for rows in read_plain(path, WHAT) if (p := _mot_positions(rows, options)) is not None]


def _has_places_alone(path: Path) -> bool:
    """Whether MOTChallenge text has ten columns, and -1 for all box edges, so that it has world positions only."""
    for rows in read_plain(path, WHAT):
        if len(rows.cells) < 10 or any((rows.floats(edge) != -1).any() for edge in "2345"):
            return False
    return True


def _read_xml(path: Path, options: TruthOptions) -> Iterator[Truth | TruthBoxes]:
    camera = _one_camera(path, options)
    if camera not in options.times:
        raise no_frame_times(path)
    return read_xml_boxes(path, camera, options.times, options.boxes)


def _read_boxes_of_one(path: Path, options: TruthOptions) -> Iterator[Truth | TruthBoxes]:
    yield from _read_boxes(path, options, _one_camera(path, options))


def _read_wildtrack(path: Path, options: TruthOptions) -> Iterator[Truth | TruthBoxes]:
    """Yield positions of the people in WILDTRACK's annotations and, if cameras are in use, their boxes in these."""
    first, stop = options.boxes.frames.common or (0, 2**62)
    rows = [
        (frame - options.boxes.first_number, person.identity, person.position, person.entry)
        for frame, file in frame_files(path).items()
        for person in read_people(file)
        if first <= frame - options.boxes.first_number < stop
    ]
    frame, identity, position, entry = np.array(rows, dtype=np.int64).reshape(-1, 4).T
    x, y = grid_places(position.astype(np.float64))
    try:
        t_ns = options.frame_times(path.name).at(frame)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    role, nothing = np.full(len(x), "target"), np.full(len(x), np.nan)
    yield _gather(path, [TruePositions(t_ns=t_ns, target_id=identity, role=role, x=x, y=y, z=nothing, line=entry)])
    if options.cameras:
        yield from _read_boxes(path, options, None)


def _read_caliscope(path: Path, options: TruthOptions) -> Iterator[Truth | TruthBoxes]:
    yield read_board(path, options.sync_ns)


def _is_table(head: list[str]) -> bool:
    across = (*(name for each in IN_UNITS.values() for name in each.columns["x"].names), *POSITIONS.names["x"], *ACROSS)
    return is_header(head) and any(name_with_unit(name) in across for name in head)


def _is_xml(head: list[str]) -> bool:
    return bool(head) and head[0].startswith("<")


def _read_locata(path: Path, _options: TruthOptions) -> Iterator[Truth | TruthBoxes]:
    yield read_source(path)


FORMATS: dict[str, TruthFormat] = {
    "wildtrack": TruthFormat(
        _read_wildtrack,
        "a folder of WILDTRACK's annotations",
        is_annotations,
    ),
    "locata": TruthFormat(_read_locata, "a source of LOCATA", by_cells(looks_like_locata)),
    "vatic": TruthFormat(_read_boxes_of_one, "VATIC text (CAMPUS)", by_cells(is_vatic)),
    "kitti": TruthFormat(_read_boxes_of_one, "KITTI's text of tracks", by_cells(is_kitti)),
    "cvat": TruthFormat(_read_boxes_of_one, "XML of CVAT", is_cvat),
    "xml": TruthFormat(_read_xml, "frames of boxes (PETS)", by_cells(_is_xml)),
    "caliscope": TruthFormat(
        _read_caliscope, "board corners", by_cells(lambda head: {"sync_index", "x_coord"} <= set(head))
    ),
    "csv": TruthFormat(_read_csv, "CSV with a header", by_cells(_is_table)),
    "mot": TruthFormat(_read_mot, "MOTChallenge", by_cells(lambda head: not is_header(head) and 7 <= len(head) <= 10)),
}
"""Every format of ground truth."""
