"""Recognition of files and folders by content, by the formats of all readers in a fixed order.

A file that several readers accept (boxes and true boxes have one format) has several kinds, the likeliest first; the
caller chooses.
"""

from __future__ import annotations

import configparser
import re
from collections.abc import Iterator, Mapping
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from occlog.errors import InputError, UsageError
from occlog.io.files.limits import BAG_MAGICS, RECORDING_MAGIC, UTF16_MARKS, guarded, is_odas
from occlog.io.files.names import is_hidden

if TYPE_CHECKING:
    from occlog.io.files.texts.formats import FileFormat, Probe

    Formats = Mapping[str, FileFormat[Any]]


class FileKind(Enum):
    """Kind of an input; the value is the word used in messages."""

    RECORDING = "recording"
    BAG = "bag"
    DATASET = "dataset"
    SCENE = "scene"
    CONFIGURATION = "configuration"
    VIDEO = "video"
    IMAGES = "images"
    SOUND = "sound"
    BOXES = "boxes"
    POSITIONS = "positions"
    CALIBRATION = "calibration"
    TRUTH = "truth"
    DIRECTIONS = "doa"
    READS = "reads"
    TABLE = "table"
    STATIONS = "stations"
    MICROPHONES = "microphones"
    TIMES = "timestamps"
    SEQUENCE = "sequence"


class FileContent(NamedTuple):
    """One possible kind of a file.

    Attributes:
        kind: kind of input.
        words: the format, in words.
    """

    kind: FileKind
    words: str


MIN_IMAGES = 3
"""Fewer images in a folder are no sequence."""
OTHER_VIDEO = (".ts", ".mts", ".m2ts", ".mpg", ".mpeg", ".wmv", ".flv", ".m4v", ".3gp", ".ogv")
"""Endings of videos in containers that only the decoder reads."""
SEQUENCE_INFO = "[sequence]"
"""First line of the description of a MOTChallenge sequence, in small letters."""
OF_POSITIONS = {"score", "confidence", "conf", "cov_xx", "sigma", "sd", "std"}
"""Columns that positions of a detector have, and true ones have not."""
TABLES = {
    "truth": (FileKind.TRUTH, "true positions"),
    "truth_boxes": (FileKind.TRUTH, "true boxes"),
    "tracks": (FileKind.TRUTH, "positions with identities"),
    "boxes": (FileKind.BOXES, "boxes"),
    "doa": (FileKind.DIRECTIONS, "directions"),
    "reads": (FileKind.READS, "reads of tags"),
    "bearings": (FileKind.TABLE, "bearings"),
    "views": (FileKind.TABLE, "views"),
    "measurements": (FileKind.TABLE, "ranges, signal strengths or time differences"),
}
"""Kinds of tables that have a header, by the table they are read as."""
OWN_RESULT = re.compile(rb'\{\s*"(_provenance"\s*:|program"\s*:\s*"occlog")')
"""Begin of JSON files that occlog writes."""


def contents_of(path: Path) -> list[FileContent]:
    """Possible kinds of a file or folder, the likeliest first; empty if no reader accepts it.

    Raises:
        InputError: the file is of a known kind, but cannot be read.
    """
    return list(dict.fromkeys(_of_folder(path) if path.is_dir() else _of_file(path)))


def _of_folder(path: Path) -> Iterator[FileContent]:
    from occlog.io.files.texts.formats import Probe
    from occlog.io.formats.boxes.datasets import is_annotations, is_labels

    from .formats.calibration.readers import colmap, pairs

    if is_one_bag(path):
        yield FileContent(FileKind.BAG, "bag of another program")
    elif colmap.folder_files(path) is not None:
        yield FileContent(FileKind.CALIBRATION, "calibration, colmap")
    elif pairs.folder_files(path) is not None:
        yield FileContent(FileKind.CALIBRATION, "calibration, opencv-pairs")
    elif is_annotations(Probe(path, "annotations")):
        yield FileContent(FileKind.TRUTH, "annotations of WILDTRACK")
        yield FileContent(FileKind.BOXES, "annotations of WILDTRACK")
    elif is_labels(path):
        yield FileContent(FileKind.BOXES, "YOLO text")
    elif is_sequence(path):
        yield FileContent(FileKind.IMAGES, "images")


def is_sequence(folder: Path) -> bool:
    """Whether a folder holds at least `MIN_IMAGES` images of one camera, numbered or named by times."""
    from occlog.io.frames.streams import are_times, list_images, numbers_of

    try:
        files = list_images(folder)
        return len(files) >= MIN_IMAGES and (are_times(files) or bool(numbers_of(files)))
    except InputError:
        return False


def _of_file(path: Path) -> Iterator[FileContent]:
    try:
        if path.stat().st_size == 0:
            return
        with path.open("rb") as file:
            head = file.read(512)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}", id="unreadable-file") from error
    if head.startswith((RECORDING_MAGIC, *BAG_MAGICS)):
        bag = is_ros_bag(path)
        yield FileContent(*((FileKind.BAG, "bag of another program") if bag else (FileKind.RECORDING, "recording")))
    elif head[8:12] == b"WAVE":
        yield FileContent(FileKind.SOUND, "sound (WAV)")
    elif _is_video(path):
        yield FileContent(FileKind.VIDEO, "video")
    elif b"\0" in head and not head.startswith(UTF16_MARKS):
        yield from _of_binary(path)
    else:
        yield from _of_text(path, head)


def _is_video(path: Path) -> bool:
    from occlog.io.video.reader import is_container

    return is_container(path) or path.suffix.lower() in OTHER_VIDEO


def _of_binary(path: Path) -> Iterator[FileContent]:
    from occlog.io.files.texts.formats import Probe
    from occlog.io.formats.calibration.reader import IMPORTERS

    if IMPORTERS["arrays"].sniff(Probe(path, "")):
        yield FileContent(FileKind.CALIBRATION, "calibration, arrays")
    else:
        yield from _of_table(path)


def _of_table(path: Path) -> Iterator[FileContent]:
    """Yield the kind of an occlog table, or of an external table recognised by its columns; nothing for other files."""
    from occlog.io.open import open_if_ours

    opened = open_if_ours(path)
    # Tracks of occlog are a result, as of an earlier run in this folder
    if (
        opened is not None
        and opened.table in TABLES
        and not (opened.external_table is None and opened.table == "tracks")
    ):
        kind, words = TABLES[opened.table]
        form = f", {opened.external_table.source.kind}" if opened.external_table is not None else ", table of occlog"
        ours = opened.external_table is None and kind not in (FileKind.TRUTH, FileKind.TABLE)
        yield FileContent(FileKind.TABLE if ours else kind, f"{words}{form}")


def _of_text(path: Path, head: bytes) -> Iterator[FileContent]:
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    if text.lower().startswith(SEQUENCE_INFO.encode()):
        yield FileContent(FileKind.SEQUENCE, "description of a MOTChallenge sequence")
    elif b"```" in head:
        return  # Markdown with a block of code
    elif re.search(rb"^occlog_scene\s*:", head, re.MULTILINE):
        yield FileContent(FileKind.SCENE, "scene")
    elif re.search(rb"^occlog_[a-z]+\s*:", head, re.MULTILINE):
        yield FileContent(FileKind.CONFIGURATION, "configuration of occlog")
    elif OWN_RESULT.match(text):
        return  # metrics or the record of a run: no input
    elif text.startswith(b"{") and is_odas(head):
        yield FileContent(FileKind.DIRECTIONS, "directions, odas")
    else:
        yield from _of_formats(path, text)


def _of_formats(path: Path, head: bytes) -> Iterator[FileContent]:
    from occlog.io.files.texts.csv_rows import is_header, is_prose
    from occlog.io.files.texts.formats import Probe
    from occlog.io.formats.boxes.reader import FORMATS as BOXES
    from occlog.io.formats.calibration.reader import IMPORTERS
    from occlog.io.formats.sound.directions import FORMATS as DIRECTIONS
    from occlog.io.formats.truth import FORMATS as TRUTHS

    probe = Probe(path, "an input")
    marked = head[:1] in b"<{[" or path.suffix.lower() in (".yaml", ".yml", ".toml", ".json", ".xml")
    name = _first(IMPORTERS, probe)
    positions = name == "homography" and re.search("mic|array|tower|station", path.stem.lower())
    if name is not None and not positions:
        yield FileContent(FileKind.CALIBRATION, f"calibration, {name}")
        return
    if marked:
        if head[:1] in b"{[" and _is(BOXES, "json", probe):
            yield FileContent(FileKind.BOXES, "boxes, JSON")
        elif head[:1] == b"<" and (xml := _xml_kind(probe)):
            yield from xml
        return
    cells = _cells(probe)
    if not is_header(cells):
        yield from _without_header(probe, cells, TRUTHS, DIRECTIONS)
        return
    try:
        prose = is_prose(path, "an input")
    except InputError:
        prose = False  # a table with a fault, which its reader describes
    if not prose:
        yield from _of_header(path, probe, set(cells), DIRECTIONS)


def _of_header(path: Path, probe: Probe, cells: set[str], directions: Formats) -> Iterator[FileContent]:
    """Yield the possible kinds of a text table with a header line, the likeliest first.

    Args:
        path: the file.
        probe: the file, for recognisers of formats.
        cells: names in the header, in lower case.
        directions: formats of directions of arrival.
    """
    from occlog.io.formats.boxes.columns import ACROSS, BOX, COLUMNS, IMAGE
    from occlog.io.formats.scenes.stations import holds_stations
    from occlog.io.formats.sound.formats import MICROPHONES, looks_like_locata

    timed = bool(cells & _times())
    framed = bool(cells & set(COLUMNS["frame"]))
    if looks_like_locata(list(cells)):
        array = any(cell.startswith("mic1") for cell in cells)
        yield FileContent(FileKind.MICROPHONES if array else FileKind.TRUTH, "positions, LOCATA")
    elif (framed or cells & set(IMAGE)) and (cells & set(ACROSS) or (framed and BOX in cells)):
        yield FileContent(FileKind.BOXES, "boxes, CSV")
        yield FileContent(FileKind.TRUTH, "boxes, CSV")
    elif {"sync_index", "x_coord"} <= cells:
        yield FileContent(FileKind.TRUTH, "corners of a board, caliscope")
    elif (name := _first(directions, probe)) is not None:
        yield FileContent(FileKind.DIRECTIONS, f"directions, {name}")
    elif (timed or framed) and {"x", "y"} & {cell.partition("_")[0] for cell in cells}:
        if cells & OF_POSITIONS and not cells & set(COLUMNS["id"]):
            yield FileContent(FileKind.POSITIONS, "positions of a detector, CSV")
        yield FileContent(FileKind.TRUTH, "positions, CSV")
    elif not timed and not framed and holds_stations(path):
        yield FileContent(FileKind.STATIONS, "positions of stations, CSV")
    elif not timed and cells <= {name for column in MICROPHONES.columns.values() for name in column.names}:
        yield FileContent(FileKind.MICROPHONES, "positions of microphones, CSV")
    elif timed and cells <= {*COLUMNS["frame"], *COLUMNS["camera"], "sync_index", *_times()}:
        yield FileContent(FileKind.TIMES, "time stamps, CSV")
    elif timed:
        yield from _of_table(path)


def _times() -> set[str]:
    """Accepted names of time columns, in all units."""
    from occlog.io.files.timing.times import TIME_COLUMNS

    return {name for names in TIME_COLUMNS.values() for name in names}


def _without_header(
    probe: Probe,
    cells: list[str],
    truths: Formats,
    directions: Formats,
) -> Iterator[FileContent]:
    """Yield the possible kinds of a text without a header line, the likeliest first.

    Args:
        probe: the file, for recognisers of formats.
        cells: of the first line.
        truths: formats of ground truth.
        directions: formats of directions of arrival.
    """
    name = next((each for each in ("vatic", "kitti", "mot") if _is(truths, each, probe)), None)
    if name == "mot" and not _is_mot(cells):
        name = None
    if _is(directions, "telemetr", probe):
        yield FileContent(FileKind.DIRECTIONS, "directions, telemetr")
    elif name is not None:
        yield FileContent(FileKind.BOXES, f"boxes, {name}")
        yield FileContent(FileKind.TRUTH, f"boxes, {name}")
    elif _numbers(cells) and len(cells) == 1 and re.search("time|stamp", probe.path.stem.lower()):
        yield FileContent(FileKind.TIMES, "time stamps, one a line")
    elif _numbers(cells) and len(cells) in (2, 3) and re.search("mic|tower|array|station", probe.path.stem.lower()):
        yield FileContent(FileKind.MICROPHONES, "positions of direction finders, without a header")
    elif not _is(truths, "mot", probe) or name is None:
        yield from _of_trajectories(probe)


def _of_trajectories(probe: Probe) -> Iterator[FileContent]:
    from occlog.io.formats.trajectories import find_trajectories

    try:
        found = find_trajectories(probe.path)
    except InputError:
        return
    if found is not None:
        yield FileContent(FileKind.TRUTH, f"positions, {found.kind}")


def _is_mot(cells: list[str]) -> bool:
    """Whether the cells of a line are numbers, the first one a whole number from 0 (a frame of MOTChallenge)."""
    return _numbers(cells) and float(cells[0]) == int(float(cells[0])) >= 0


def _numbers(cells: list[str]) -> bool:
    try:
        return all(abs(float(cell)) < 1e12 for cell in cells) and bool(cells)
    except ValueError:
        return False


def _xml_kind(probe: Probe) -> list[FileContent]:
    """Possible kinds of an XML text other than a calibration; empty if it is of no known format."""
    from occlog.io.formats.boxes.annotations import is_cvat

    if is_cvat(probe):
        return [FileContent(FileKind.BOXES, "boxes, CVAT"), FileContent(FileKind.TRUTH, "boxes, CVAT")]
    if re.search(r"<frame\s", probe.text) and "<object" in probe.text and "xc=" in probe.text:
        return [FileContent(FileKind.TRUTH, "true boxes, XML (PETS)")]
    return []


def _cells(probe: Probe) -> list[str]:
    try:
        return probe.cells
    except InputError:
        return []


def _first(formats: Formats, probe: Probe) -> str | None:
    """Name of the first of the formats that recognises a file; None if none does, or the file cannot be read."""
    from occlog.io.files.texts.formats import recognise

    try:
        with guarded(probe.path, "an input"):
            kept = {name: each for name, each in formats.items() if name not in ("arrays", "odas")}
            return recognise(kept, probe)
    except (InputError, UsageError):
        return None


def _is(formats: Formats, name: str, probe: Probe) -> bool:
    return _first({name: formats[name]}, probe) == name


CONTAINERS = (".mcap", ".db3", ".zstd")
PART = re.compile(r"_\d+$")
"""Endings of file names of a split bag."""


def is_one_bag(folder: Path) -> bool:
    """Whether a folder is one ROS 2 bag: it has bag metadata, or its bag files are parts with one name.

    False if one of the files is a recording of occlog.
    """
    from occlog.io.messages.bag import METADATA, is_bag
    from occlog.io.recording.reader import open_recording

    if (folder / METADATA).is_file():
        return True
    if not is_bag(folder):
        return False
    files = [path for path in folder.iterdir() if path.suffix in CONTAINERS and not is_hidden(path)]
    if len({PART.sub("", path.name.split(".")[0]) for path in files}) != 1:
        return False
    try:
        return not any(path.suffix == ".mcap" and open_recording(path).ours for path in files)
    except InputError:
        return True


def is_ros_bag(path: Path) -> bool:
    """Whether a path is a ROS bag or an MCAP file of another program, possibly truncated."""
    if path.is_dir():
        from occlog.io.messages.bag import is_bag

        return is_bag(path)
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(max(map(len, (RECORDING_MAGIC, *BAG_MAGICS))))
    if not head.startswith(RECORDING_MAGIC):
        return head.startswith(BAG_MAGICS)
    from occlog.io.recording.reader import open_recording

    try:
        return not open_recording(path).ours
    except InputError:
        with path.open("rb") as file:
            return b"occlog" not in file.read(64)


class SequenceInfo(NamedTuple):
    """Description of a MOTChallenge sequence (`seqinfo.ini`).

    Attributes:
        name: of the sequence; "": not stated.
        rate: frames per second; None: not stated.
        size: width and height of the images [px]; None: not stated.
    """

    name: str
    rate: str | None
    size: tuple[int, int] | None


def read_sequence_info(path: Path) -> SequenceInfo:
    """Read name, frame rate and image size from `seqinfo.ini` of a MOTChallenge sequence; InputError if invalid."""
    parser = configparser.ConfigParser(interpolation=None)
    with guarded(path, "the description of a sequence"):
        try:
            parser.read_string(path.read_text(encoding="utf-8-sig"))
        except configparser.Error as error:
            raise InputError(
                f"{path}: cannot be read: {' '.join(str(error).split())[:120]}", id="unreadable-file"
            ) from None
        values = {key.lower(): value for each in parser.sections() for key, value in parser[each].items()}
        size = (int(values.get("imwidth", 0)), int(values.get("imheight", 0)))
    return SequenceInfo(values.get("name", ""), values.get("framerate"), size if min(size) > 0 else None)
