"""Checks of texts: scenes, calibrations, boxes, time stamps, external tables, JSON, XML, TOML and YAML."""

from __future__ import annotations

from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from occlog.array_types import Ints, Uints
from occlog.errors import InputError, UsageError
from occlog.io.external.source import find_source
from occlog.io.external.table import ExternalTable, best_fit
from occlog.io.files.limits import bounded_text
from occlog.io.files.texts.csv_rows import CsvRows, report_bad_lines_to
from occlog.io.files.texts.documents import MAX_JSON_BYTES, parse_json, parse_xml, toml_values
from occlog.io.files.texts.formats import Probe, recognise
from occlog.io.files.texts.yaml import yaml_documents
from occlog.io.files.timing.times import iter_times, looks_like_times, parse_times
from occlog.io.formats.boxes.columns import BoxSource
from occlog.io.formats.boxes.reader import box_rows, box_source, is_json, note_times
from occlog.io.formats.boxes.rows import FileBoxRows, fingerprints
from occlog.io.formats.calibration.common import CalibrationOptions
from occlog.io.formats.calibration.reader import read_calibration
from occlog.io.formats.scenes.scene import read_scene
from occlog.io.formats.scenes.stations import read_stations
from occlog.io.formats.sound.csv_log import FORMAT, WHAT, DoaOptions
from occlog.io.formats.sound.directions import FORMATS
from occlog.records.losses import Loss

from .clock import SensorTimes, check_clocks
from .findings import Findings
from .tables import bisect_bad_rows, check_external, note_losses

MAX_ROWS = 8_000_000
"""Rows among which copies are searched for: 16 bytes of each are kept."""


def check_boxes(source: BoxSource, findings: Findings) -> None:
    """Add findings about a box file: invalid rows, duplicates, and the frame times."""
    copies, cameras = _Copies(), list[str]()
    stamps: dict[str, dict[int, int]] = {}
    with report_bad_lines_to(partial(findings.refused, "row")):
        try:
            for rows in source.chunks:
                _check(rows, cameras, source.first_number or 0, copies, stamps, findings)
        except InputError as error:
            findings.refused("unreadable", error)
    copies.judge(findings)
    check_clocks([_clock(camera, stamps[camera]) for camera in sorted(stamps)], findings)


def _check(
    rows: CsvRows,
    cameras: list[str],
    first_number: int,
    copies: _Copies,
    stamps: dict[str, dict[int, int]],
    findings: Findings,
) -> None:
    def make(start: int, stop: int) -> tuple[Ints, FileBoxRows]:
        part = rows.pick(np.arange(start, stop))
        boxes = box_rows(part, cameras, first_number)
        note_times(part, boxes, cameras, stamps)
        return part.lines, boxes

    good: list[tuple[Ints, FileBoxRows]] = []
    for _, error in bisect_bad_rows(len(rows), make, good):
        findings.refused("row", error)
    for lines, boxes in good:
        copies.add(lines, boxes)


def _clock(camera: str, stamps: dict[int, int]) -> SensorTimes:
    """Return the statistics of the times of a camera's frames.

    `stamps`: time [ns] by frame number; frames without detections may be missing.
    """
    frames = np.array(sorted(stamps), dtype=np.int64)
    clock = SensorTimes(f"camera {camera}" if camera else "times", unique=True, sporadic=True)
    clock.add(np.array([stamps[frame] for frame in frames.tolist()], dtype=np.int64), frames)
    return clock


class _Copies:
    """Fingerprints of the rows of a file (up to `MAX_ROWS`), by which duplicates anywhere in it are found."""

    def __init__(self) -> None:
        self._marks: list[Uints] = []
        self._lines: list[Ints] = []
        self._rows = 0

    def add(self, lines: Ints, boxes: FileBoxRows) -> None:
        """Add rows, with their line numbers (n,)."""
        if self._rows < MAX_ROWS:
            self._marks.append(fingerprints(boxes))
            self._lines.append(lines)
            self._rows += len(lines)

    def judge(self, findings: Findings) -> None:
        """Add a finding with the number of duplicate rows, and the lines of the first."""
        if not self._rows:
            return
        marks, lines = np.concatenate(self._marks), np.concatenate(self._lines)
        _, first, index = np.unique(marks, return_index=True, return_inverse=True)
        copies = np.flatnonzero(first[index.reshape(-1)] != np.arange(len(marks)))
        if len(copies):
            row = int(copies[0])
            value = f"as in line {lines[first[index.reshape(-1)[row]]]}"
            findings.add("duplicate-row", f"line {lines[row]}", value, count=len(copies))


ANY_SIZE = (1920, 1080)
OURS = "occlog_"
"""Begins the key that states what a file of ours is."""
SCENE = "occlog_scene"
TEXTS = (".csv", ".tsv", ".txt", ".gz", ".tum", ".trc", ".geojson", "")
"""Endings of names of text tables."""


def check_text_file(path: Path, findings: Findings) -> bool:
    """Add findings about a text file, by its ending and content; return whether its kind is known."""
    kind = path.suffix.lower()
    if kind in (".yaml", ".yml"):
        return _yaml(path, findings)
    if kind in (".toml", ".xml"):
        return _structured(path, kind, findings)
    if kind in (".npz", ".npy", ".mat"):
        return _calibration(path, findings)
    if kind == ".json" or (kind in TEXTS and is_json(Probe(path, "a text")) and kind != ".geojson"):
        return _json(path, findings)
    return kind in TEXTS and _table(path, findings)


def _directions(path: Path, findings: Findings) -> bool:
    """Check a log of directions of arrival, and add its findings; return whether the file is such a log."""
    probe = Probe(path, WHAT)
    log = recognise(FORMATS, probe)
    if log is None or (log == "odas" and b"timeStamp" not in probe.start):
        return False
    # What the file does not state makes no difference here: counts of hops are taken for seconds
    named = log == "csv" and not {cell.lower() for cell in probe.cells}.isdisjoint(FORMAT.names["sensor"])
    options = DoaOptions(sensor=None if named else "", unit="deg", hop=Fraction(1))
    clocks: dict[str, SensorTimes] = {}
    losses: list[Loss] = []
    try:
        for rows in FORMATS[log].read(path, options, losses):
            for name in np.unique(rows.sensor).tolist():
                times = "counts of hops" if log == "odas" else f"array {name}" if name else "times"
                clock = clocks.setdefault(name, SensorTimes(times, sporadic=True))
                clock.add(rows.t_ns[rows.sensor == name])
    except InputError as error:
        findings.refused("unreadable", error)
    except UsageError:
        return True
    note_losses(losses, findings)
    check_clocks([*clocks.values()], findings)
    return True


def _yaml(path: Path, findings: Findings) -> bool:
    try:
        documents = yaml_documents(bounded_text(path, "YAML"), path, "YAML")
    except InputError as error:
        findings.refused("unreadable", error)
        return True
    keys: Any = documents[0] if documents and isinstance(documents[0], dict) else {}
    marks = [key for key in keys if str(key).startswith(OURS)]
    if SCENE in keys or (not marks and {"cameras", "room", "microphone_arrays"} & set(keys)):
        try:
            read_scene(path)
        except InputError as error:
            findings.refused("unreadable", error)
        return True
    # Settings of runs, sweeps and networks are read by their commands
    return not marks and _calibration(path, findings)


def _calibration(path: Path, findings: Findings) -> bool:
    """Add findings about a calibration; return whether the file is one of a known format."""
    try:
        # Some formats require the size of the images: any will do for a check
        calibration = read_calibration([path], options=CalibrationOptions(image_size=ANY_SIZE))
    except (InputError, UsageError) as error:
        if "not a calibration of a known format" in str(error):
            return False
        findings.refused("unreadable", error)
        return True
    for check in calibration.checks:
        if check.found:
            findings.add("suspect", "", check.text)
    return True


def _structured(path: Path, kind: str, findings: Findings) -> bool:
    """Add findings about an XML or TOML file: its syntax, and its calibration.

    Return False only for a well-formed file that is no calibration of a known format. `kind`: ending of its name.
    """
    try:
        text = bounded_text(path, kind[1:].upper(), limit=MAX_JSON_BYTES)
        parse_xml(text, path) if kind == ".xml" else toml_values(text, path, "TOML")
    except InputError as error:
        findings.refused("unreadable", error)
        return True
    return _calibration(path, findings)


def _json(path: Path, findings: Findings) -> bool:
    try:
        source = box_source(path)
    except InputError as of_boxes:
        try:
            value = parse_json(bounded_text(path, "JSON", limit=MAX_JSON_BYTES), path, "JSON")
        except InputError as error:
            if not _directions(path, findings):
                findings.refused("unreadable", error)
            return True
        if isinstance(value, list) and value and path.suffix.lower() == ".json":
            findings.refused("unreadable", of_boxes)
            return True
        return True
    check_boxes(source, findings)
    return True


def _table(path: Path, findings: Findings) -> bool:
    """Add findings about a text table: external table, boxes, stations, time stamps, calibration or directions.

    Return whether the file is one of these.
    """
    fault: InputError | None = None
    if looks_like_times(path):
        _times(path, findings)
        return True
    try:
        source = find_source(path)
        if source is not None:
            check_external(ExternalTable(source, best_fit(source)), findings)
            return True
    except InputError as error:
        fault = error
    try:
        own = Findings(str(path))
        with report_bad_lines_to(partial(own.refused, "row")):
            boxes = box_source(path)
        findings.join(own)
        check_boxes(boxes, findings)
        return True
    except InputError:
        if _is_scene(path) or _calibration(path, findings) or _directions(path, findings):
            return True
    if fault is not None:
        findings.refused("no-table", fault)
    return False


def _is_scene(path: Path) -> bool:
    """Return whether a file is a valid table of stations (positions of sensors)."""
    try:
        read_stations(path)
    except InputError:
        return False
    return True


def _times(path: Path, findings: Findings) -> None:
    """Add findings about a table of time stamps."""
    clocks: dict[str, SensorTimes] = {}
    try:
        with report_bad_lines_to(partial(findings.refused, "row")):
            for rows, unit in iter_times(path):
                _take_times(rows, unit, clocks, findings)
    except InputError as error:
        findings.refused("unreadable", error)
    check_clocks(list(clocks.values()), findings)


def _take_times(rows: CsvRows, unit: str, clocks: dict[str, SensorTimes], findings: Findings) -> None:
    def make(start: int, stop: int) -> tuple[CsvRows, Ints]:
        part = rows.pick(np.arange(start, stop))
        return part, parse_times(part, unit, unit)

    good: list[tuple[CsvRows, Ints]] = []
    for _, error in bisect_bad_rows(len(rows), make, good):
        findings.refused("row", error)
    for part, t_ns in good:
        labels = part.cells["camera"] if part.has("camera") else np.full(len(part), "")
        for label in np.unique(labels).tolist():
            clock = clocks.setdefault(label, SensorTimes(f"camera {label}" if label else "times", unique=True))
            clock.add(t_ns[labels == label])
