"""Choices from the available files to a run configuration, each with its reason and how to change it.

Nothing ambiguous is chosen silently: each choice is a line with the key or option for another one. What cannot be
chosen, such as a frame rate that no file states, is an error that asks for it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from shlex import quote
from typing import NamedTuple

import numpy as np

from occlog.console.text import counted
from occlog.core.geometry.camera import is_upright, looks_away, other_up_axis
from occlog.errors import InputError, OcclogError, abridged
from occlog.ingest.plan import ANNOTATIONS, IMAGES
from occlog.ingest.scene import Turn
from occlog.io.files.names import match_sensor
from occlog.io.files.texts.csv_rows import first_line
from occlog.io.files.timing.times import TIME_COLUMNS
from occlog.io.formats.boxes.columns import COLUMNS
from occlog.io.formats.boxes.reader import BoxFile, BoxOptions, BoxSurvey, classes_in, survey_boxes
from occlog.io.formats.calibration.common import CalibrationOptions, mirror_matrix
from occlog.io.formats.calibration.reader import CalibrationFile, read_calibration
from occlog.io.formats.scenes.stations import NAMES
from occlog.io.formats.sound.formats import read_arrays
from occlog.io.formats.tags import columns_of_reads, read_readers
from occlog.io.formats.truth import frames_of_positions
from occlog.io.frames.streams import are_times, list_images, video_times
from occlog.io.open import open_if_ours, scene_in
from occlog.io.recognition import FileKind, read_sequence_info
from occlog.records.declared.sensors import VALUES
from occlog.records.scene import HEIGHT_SLACK
from occlog.records.tables import Bearings, Boxes, Doa, Reads, Truth, TruthBoxes
from occlog.settings import read_pair

from .survey import THUMBNAILS, Item, Survey, shown

PEOPLE = ("person", "pedestrian", "people", "human", "0")
"""Classes of boxes that are people, the likeliest first; 0 is that of COCO for networks that write numbers."""
WITHOUT_SIZE = ("homography", "projection", "arrays", "opencv-pairs")
"""Formats of calibrations that need not state the size of the images."""
ONE_FILE = ("kalibr", "colmap", "qualisys", "opencv-toml")
"""Formats of calibrations of which one file has all cameras: two files are two calibrations."""


ASKED = {
    "unit of the calibration": "ingest.calibration_unit=m",
    "size of the images": "ingest.image_size=WIDTHxHEIGHT",
    "of a fisheye lens or": "ingest.lens_model=fisheye",
    "world is left-handed": "ingest.mirror=y",
}
"""Words of errors of calibrations that lack something, and the key that gives it."""


class ChoiceLine(NamedTuple):
    """A line about a choice of `occlog start`.

    Attributes:
        text: what was chosen, and why.
        change: the option that changes it; empty: none.
    """

    text: str
    change: str = ""

    def __str__(self) -> str:
        """Return the line as it is printed: the choice, and in brackets the option that changes it."""
        return f"{self.text}  [{self.change}]" if self.change else self.text


@dataclass
class Choices:
    """A run configuration under construction by `occlog start`.

    Attributes:
        found: the files, with what they are; those that are not used are moved to its list of unused ones.
        sources: files and folders as the user gave them.
        given: keys and values that the user sets, by stage.
        values: chosen keys and values by stage; a key of the whole configuration has the stage "".
        lines: a line for each choice.
    """

    found: Survey
    sources: Sequence[Path]
    given: Mapping[str, Mapping[str, object]]
    values: dict[str, dict[str, object]] = field(default_factory=dict)
    lines: list[ChoiceLine] = field(default_factory=list)

    def say(self, text: str, change: str = "") -> None:
        """Add a line about a choice; `change`: option that changes it, empty: none."""
        self.lines.append(ChoiceLine(text, change))

    def has(self, stage: str, key: str) -> bool:
        """Return whether the user sets this key of the stage."""
        return key in self.given.get(stage, {})

    def put(self, stage: str, key: str, value: object) -> None:
        """Set the key of the stage to `value`, without a line about it."""
        self.values.setdefault(stage, {})[key] = value

    def guess(self, stage: str, key: str, value: object, text: str) -> None:
        """Set a key of a stage to `value` unless the user sets it.

        Add the line `text` with the option that changes it.
        """
        if not self.has(stage, key):
            self.put(stage, key, value)
            self.say(text, f"--set {stage}{'.' if stage else ''}{key}=...")

    def value(self, stage: str, key: str) -> object:
        """Return the value of the key of the stage (of the user, or chosen); None if not set."""
        return self.given.get(stage, {}).get(key, self.values.get(stage, {}).get(key))

    def shown(self, path: Path) -> str:
        """Return a path as the user knows it: relative to a source folder, else as given."""
        return shown(path, self.sources)

    def only(self, items: Sequence[Item], what: str) -> Item:
        """Return one of several items, preferably one of a kind that the user states.

        The others are dropped, each with a line. `what`: noun for the items in the line.
        """
        first, *others = sorted(items, key=lambda item: not item.stated)
        for other in others:
            self.found.drop(other, f"a second {what}")
        if others:
            names = ", ".join(self.shown(other.path) for other in others)
            self.say(f"{what}: {self.shown(first.path)} of several ({names})", f"--as {self.shown(first.path)}=unused")
        return first


def choose(made: Choices) -> None:
    """Choose source, inputs and method of the configuration by the kinds of files; unused files are marked.

    `made` is changed in place.

    Raises:
        InputError: no file can be used, or something is needed that no file states; the message names the option.
    """
    found, sources = made.found, made.sources
    for item in found.of(FileKind.CONFIGURATION):
        found.drop(item, "a configuration; do it by `occlog run`")
    _drop_thumbnails(made)
    if found.of(FileKind.RECORDING):
        _of_recording(made)
    elif found.of(FileKind.BAG, FileKind.DATASET):
        _of_bag(made)
    elif found.of(FileKind.VIDEO, FileKind.IMAGES, FileKind.BOXES, FileKind.POSITIONS) or _annotated(made):
        _of_cameras(made)
    elif found.of(FileKind.DIRECTIONS, FileKind.READS):
        _of_logs(made)
    elif found.of(FileKind.SOUND):
        _of_sound(made)
    elif found.of(FileKind.TABLE):
        _of_table(made)
    else:
        raise InputError(f"{', '.join(map(str, sources))}: {_nothing(found)}", id="wrong-content")
    _rest(made)


def _nothing(found: Survey) -> str:
    held = Counter(item.kind.value for item in found.items)
    there = ", ".join(f"{count} x {kind}" for kind, count in held.items())
    held_unused = counted(len(found.unused), "file or folder", "files or folders")
    what = f"there is {there}" if there else f"{held_unused} of no known format" if found.unused else "empty"
    return f"nothing to track: {what}; give videos, images, boxes, a bag, a recording, or logs of sensors"


def _drop_thumbnails(made: Choices) -> None:
    """Drop folders of pictures that are no camera's, by their name or since they are next to videos."""
    videos = {item.path.parent for item in made.found.of(FileKind.VIDEO)}
    for item in made.found.of(FileKind.IMAGES):
        if item.stated:
            continue
        if THUMBNAILS.search(item.path.name):
            made.found.drop(item, "pictures that by their name are no camera's (--as PATH=images)")
        elif item.path in videos:
            made.found.drop(item, "pictures next to videos (--as PATH=images)")


def _annotated(made: Choices) -> bool:
    """Use annotated boxes as detector boxes if there are no other measurements; return whether that was done."""
    both = [item for item in made.found.of(FileKind.TRUTH) if FileKind.BOXES in item.others]
    if not both or made.found.of(FileKind.DIRECTIONS, FileKind.READS, FileKind.TABLE):
        return False
    for item in both:
        made.found.items.append(item._replace(kind=FileKind.BOXES, others=(FileKind.TRUTH,)))
        made.say(
            f"{made.shown(item.path)}: annotated boxes stand for those of a detector, without errors of one: figures "
            "state what association and motion can do, no more",
            f"--as {made.shown(item.path)}=boxes",
        )
    return True


def _of_recording(made: Choices) -> None:
    from occlog.io.recording.reader import open_recording

    item = made.only(made.found.of(FileKind.RECORDING), "recording")
    made.put("", "recording", item.path)
    opened = open_recording(item.path)
    reported = [counted(len(opened.cameras), "camera with images", "cameras with images")] if opened.cameras else []
    named = {"boxes": Boxes, "bearings": Bearings, "directions": Doa, "reads of tags": Reads, "true positions": Truth}
    reported += [word for word, table in {**named, "true boxes": TruthBoxes}.items() if opened.has(table)]
    made.say(f"recording {made.shown(item.path)}: {', '.join(reported) or 'no measurements'}")
    _truth_of_evaluation(made, opened.has(Truth))
    scene = opened.scene
    if (scenes := made.found.of(FileKind.SCENE)) and not made.has("", "scene"):
        scene = scene_in(made.only(scenes, "scene").path)
        made.guess(
            "", "scene", made.only(scenes, "scene").path, f"scene {made.shown(scenes[0].path)}, not the recording's"
        )
    placed = scene is not None and any(camera.placed for camera in scene.cameras)
    if opened.has(Reads) and not opened.cameras and not opened.has(Boxes):
        _method(made, "reads")
    elif opened.cameras or opened.has(Boxes):
        _method(made, "boxes" if placed else "views")
    else:
        _method(made, "bearings")


def _of_bag(made: Choices) -> None:
    bags = made.found.of(FileKind.BAG, FileKind.DATASET)
    folders = {item.path.parent for item in bags}
    if len(bags) > 1 and (len(folders) > 1 or any(item.kind is FileKind.DATASET for item in bags)):
        bags = [made.only(bags, "bag")]
    made.put("ingest", "bags", [item.path for item in bags])
    for item in bags:
        made.say(f"{item.words}: {made.shown(item.path)}", f"--as {made.shown(item.path)}=unused")
    if bags[0].kind is FileKind.DATASET:
        _of_dataset(made, bags[0].path)
        return
    _put_scene(made, "ingest")
    if calibration := _calibration_items(made):
        made.put("ingest", "calibration", [item.path for item in calibration])
        made.say(f"calibration: {', '.join(made.shown(item.path) for item in calibration)}, not the bag's")
    _put_truth(made, None, framed=False)
    _method(made, "boxes")


def _of_dataset(made: Choices, folder: Path) -> None:
    if not (folder / IMAGES).is_dir() and not made.has("ingest", "boxes"):
        if not made.found.of(FileKind.BOXES):
            made.put("ingest", "boxes", [folder / ANNOTATIONS])
            made.say(
                f"{made.shown(folder / ANNOTATIONS)}: there are no images; annotated boxes stand for those of a "
                "detector, without errors of one",
                "--set ingest.boxes=FILE",
            )
        else:
            made.put("ingest", "boxes", [item.path for item in made.found.of(FileKind.BOXES)])
    made.say("frames count tenths of a second, as in WILDTRACK", "--set ingest.fps=...")
    _method(made, "boxes")


def _of_cameras(made: Choices) -> None:
    """Choose videos, images and boxes, with their calibration."""
    found = made.found
    boxes, opened = _opened_boxes(made)
    _guess_size(made, opened)
    groups = _calibrations(made)
    names = list(dict.fromkeys([*(i.name for i in found.of(FileKind.VIDEO, FileKind.IMAGES)), *opened.cameras]))
    _check_doubles(made, opened)
    calibration = _choose_calibration(made, groups, names)
    scene = _put_scene(made, "ingest")
    renamed = _match(made, calibration, names, scene)
    for kind in (FileKind.VIDEO, FileKind.IMAGES):
        own = {renamed[item.name]: item.path for item in found.of(kind) if item.name in renamed}
        if own:
            made.put("ingest", kind.value, own)
            for name, path in own.items():
                made.say(
                    f"{kind.value}: {made.shown(path)}, camera {name}", f"--as '{made.shown(path)}={kind.value}:NAME'"
                )
    _put_boxes(made, boxes, opened, renamed)
    positions = _put_positions(made)
    keys = made.values.get("ingest", {}).keys() | made.given.get("ingest", {}).keys()
    if not keys & {"video", "images", "boxes", "positions"}:
        raise InputError(
            f"{', '.join(map(str, made.sources))}: no camera is left that can be used; the reasons are above",
            id="too-few-sensors",
        )
    if calibration is not None:
        _put_calibration(made, calibration)
    _rates(made, opened, renamed)
    _put_truth(made, opened, framed=True, cameras=tuple(renamed.values()))
    _put_sound(made)
    placed = calibration is not None or scene or (positions and not names)
    if not placed:
        made.put("ingest", "allow_uncalibrated", True)
    _method(made, "boxes" if placed else "views")


def _put_positions(made: Choices) -> bool:
    """Choose files of positions on the ground as inputs of `ingest`; return whether there are any."""
    items = made.found.of(FileKind.POSITIONS)
    for item in items:
        made.say(f"positions on the ground: {made.shown(item.path)}", f"--as {made.shown(item.path)}=truth")
        if (
            not {c.lower() for c in first_line(item.path, "positions")} & _times()
            and made.value("ingest", "fps") is None
        ):
            _need_rate(made.shown(item.path))
    if items:
        made.put("ingest", "positions", [f"{item.name}={item.path}" for item in items])
    return bool(items)


def _times() -> set[str]:
    return {name for names in TIME_COLUMNS.values() for name in names}


def _guess_size(made: Choices, opened: OpenedBoxes) -> None:
    """Set the image size, for calibrations that do not state it, if all boxes and sequences have the same."""
    if made.has("ingest", "image_size") or not any(
        item.words.removeprefix("calibration, ") in WITHOUT_SIZE for item in made.found.of(FileKind.CALIBRATION)
    ):
        return
    sizes = {size for survey in opened.files.values() for size in survey.sizes.values()}
    infos = (read_sequence_info(item.path) for item in made.found.of(FileKind.SEQUENCE))
    sizes |= {info.size for info in infos if info.size is not None}
    if len(sizes) == 1:
        width, height = sizes.pop()
        text = f"calibration: of images of {width} x {height} px, as the boxes are"
        made.guess("ingest", "image_size", f"{width}x{height}", text)


class OpenedBoxes(NamedTuple):
    """Readable box files, with a survey of the content of each."""

    files: dict[Item, BoxSurvey]

    @property
    def cameras(self) -> list[str]:
        """Names of the cameras of all files, in order."""
        return list(dict.fromkeys(name for each in self.files.values() for name in each.cameras))


def _opened_boxes(made: Choices) -> tuple[list[Item], OpenedBoxes]:
    """Return the box files that can be read, and the content of each; others are dropped.

    InputError if the user states that such a file has boxes.
    """
    opened: dict[Item, BoxSurvey] = {}
    options = _box_options(made)
    for item in made.found.of(FileKind.BOXES):
        tried = [item.name] if item.named else [None, item.name]
        problem = ""
        for camera in tried:
            try:
                opened[item] = survey_boxes([BoxFile(item.path, camera)], (), options)
                break
            except OcclogError as error:
                problem = str(error).removeprefix(f"{item.path}: ")
        if item not in opened:
            made.found.drop(item, f"taken for boxes: {problem}")
            if item.stated:
                raise InputError(f"{item.path}: {problem}")
    return list(opened), OpenedBoxes(opened)


def _box_options(made: Choices) -> BoxOptions:
    classes = _texts(made.value("ingest", "class"))
    scale = made.value("ingest", "confidence_scale")
    return BoxOptions(
        classes=classes or None,
        confidence_scale=1.0 if scale is None else float(str(scale)),
        scores=str(made.value("ingest", "score_type") or "probability"),
        ignore_extra=True,
        first_number=int(str(made.value("ingest", "first_number") or 0)),
    )


def _texts(value: object) -> tuple[str, ...]:
    return () if value is None else tuple(map(str, value)) if isinstance(value, list | tuple) else (str(value),)


def _check_doubles(made: Choices, opened: OpenedBoxes) -> None:
    """Raise InputError for two inputs of one kind with one camera, which may be of several recordings, or copies.

    Image folders of a camera with a video are dropped unless the user states them.
    """
    for kind in (FileKind.VIDEO, FileKind.IMAGES, FileKind.BOXES):
        owners: dict[str, list[Item]] = {}
        for item in made.found.of(kind):
            for name in opened.files[item].cameras if kind is FileKind.BOXES else (item.name,):
                owners.setdefault(name, []).append(item)
        for name, items in owners.items():
            if len(items) > 1:
                remedies = _one_of(made, items, alone=name == items[1].name)
                raise InputError(
                    f"{items[1].path}: is of camera {name}, as {made.shown(items[0].path)} is; {remedies}",
                    id="ambiguous-input",
                )
    both = {i.name for i in made.found.of(FileKind.VIDEO)} & {i.name for i in made.found.of(FileKind.IMAGES)}
    for item in made.found.of(FileKind.IMAGES):
        if item.name in both and not item.stated:
            made.found.drop(item, f"camera {item.name} has a video (--as PATH=images:NAME)")


def _one_of(made: Choices, items: Sequence[Item], *, alone: bool) -> str:
    """Return the remedies for several inputs of one camera, as text: to use one recording, or to name the camera.

    `alone`: whether the second input is of this camera only, so that it can be named.
    """
    first, second, *_ = items
    both = first.path.parts, second.path.parts
    apart = next(n for n, (one, two) in enumerate(zip(*both, strict=False)) if one != two)
    if apart < min(map(len, both)) - 1:
        out = f"for one recording: occlog start {quote(str(Path(*both[0][: apart + 1])))}"
    else:
        out = "for one recording: " + " ".join(f"--as {quote(made.shown(item.path))}=unused" for item in items[1:])
    name = f"--as '{made.shown(second.path)}={second.kind.value}:NAME'"
    return f"{out}; for another camera: {name}" if alone else out


Group = tuple[Item, ...]


class OpenedCalibration(NamedTuple):
    """A calibration that was read from input files.

    Attributes:
        items: the files that it consists of: one, or one a camera.
        file: the cameras read from them, with format, unit and notes.
    """

    items: Group
    file: CalibrationFile


def _calibration_items(made: Choices) -> list[Item]:
    """Return the files that together are the calibration of a bag's cameras; empty without one."""
    groups = _calibrations(made)
    chosen = _choose_calibration(made, groups, [])
    return [] if chosen is None else list(chosen.items)


def _calibrations(made: Choices) -> list[OpenedCalibration]:
    """Return the calibrations that can be read; unreadable files are dropped.

    Files of one folder and format are combined to one calibration if the format has one camera per file. InputError if
    the only calibration, or a stated one, cannot be read.
    """
    groups: dict[tuple[object, ...], list[Item]] = {}
    for item in made.found.of(FileKind.CALIBRATION):
        alone = item.path.is_dir() or item.words.removeprefix("calibration, ") in ONE_FILE
        key = (item.path,) if alone else (item.path.parent, item.words)
        groups.setdefault(key, []).append(item)
    out: list[OpenedCalibration] = []
    unit, size = made.value("ingest", "calibration_unit"), made.value("ingest", "image_size")
    lens, mirror = made.value("ingest", "lens_model"), made.value("ingest", "mirror")
    for items in groups.values():
        options = CalibrationOptions(
            None if unit is None else str(unit),
            _size(size),
            None if lens is None else str(lens),
            None if mirror is None else str(mirror),
        )
        try:
            out.append(OpenedCalibration(tuple(items), read_calibration([i.path for i in items], "auto", options)))
        except OcclogError as error:
            text = str(error)
            for words, option in ASKED.items():
                if words in text:
                    raise InputError(f"{text}: --set {option}") from None
            if len(groups) == 1 or any(item.stated for item in items):
                raise InputError(text) from None
            for item in items:
                made.found.drop(item, f"taken for a calibration: {text.removeprefix(f'{item.path}: ')}")
    return out


def _size(value: object) -> tuple[int, int] | None:
    return None if value is None else read_pair("x".join(_texts(value)), True)


def _choose_calibration(
    made: Choices, groups: Sequence[OpenedCalibration], names: Sequence[str]
) -> OpenedCalibration | None:
    """Return a calibration that the user states, or the one with most of the cameras `names`; the others are dropped.

    None if there is none, or if the configuration of the user sets it.
    """
    if made.has("ingest", "calibration") or not groups:
        return None
    ranked = sorted(groups, key=lambda g: (not any(i.stated for i in g.items), -_common(names, g.file)))
    first, *others = ranked
    for other in others:
        for item in other.items:
            made.found.drop(item, "a second calibration")
    if others:
        taken = ", ".join(made.shown(item.path) for item in first.items)
        left = ", ".join(made.shown(item.path) for other in others for item in other.items)
        has = f"it has {_common(names, first.file)} of {counted(len(names), 'camera')}, " if names else ""
        made.say(
            f"calibration: {taken}, not {left}: {has}the other {_common(names, others[0].file)}",
            f"--as {made.shown(others[0].items[0].path)}=calibration",
        )
    return first


def _common(names: Sequence[str], file: CalibrationFile) -> int:
    """Return how many of the cameras `names` a calibration has, names matched loosely."""
    known = [camera.name for camera in file.cameras]
    return sum(_same(name, known) is not None for name in names)


def _same(name: str, known: Sequence[str]) -> str | None:
    try:
        return match_sensor(name, known, "")
    except InputError:
        return None


def _match(made: Choices, calibration: OpenedCalibration | None, names: Sequence[str], scene: bool) -> dict[str, str]:
    """Return the name to use for each camera, by its name in the data; cameras without a calibration are omitted.

    InputError if no camera is in the calibration.

    Args:
        made: choices, which get lines, and lose the files of cameras that are omitted.
        calibration: names the calibrated cameras; None: all cameras keep their names.
        names: names of the cameras with data.
        scene: whether a scene file has cameras, so that those without a calibration stay.
    """
    if calibration is None:
        return {name: name for name in names}
    known = [camera.name for camera in calibration.file.cameras]
    meant = {name: _same(name, known) for name in names}
    lost = [name for name, found in meant.items() if found is None]
    if len(names) == len(known) == len(lost) == 1:
        made.say(
            f"camera {names[0]} is {known[0]} of the calibration, the only one",
            f"--as '{_path_of(made, names[0])}:NAME'",
        )
        return {names[0]: known[0]}
    if lost == list(names) and not scene:
        raise InputError(
            f"cameras {abridged(names)} are none of the calibration's ({abridged(known)}); name each: "
            f"--as '{_path_of(made, names[0])}:{known[0]}'",
            id="unknown-sensor",
        )
    for name in lost if not scene else ():
        why = f"it has no calibration (calibrated: {', '.join(known)})"
        made.say(f"camera {name}: not used, {why}", f"--as '{_path_of(made, name)}:NAME'")
        for item in made.found.of(FileKind.VIDEO, FileKind.IMAGES, FileKind.BOXES):
            if item.name == name:
                made.found.drop(item, f"camera {name} has no calibration")
    for name, same in meant.items():
        if same is not None and same != name:
            made.say(
                f"camera {name} is {same} of the calibration, by its number", f"--as '{_path_of(made, name)}:NAME'"
            )
    spare = [name for name in known if name not in meant.values()]
    if spare:
        made.say(f"calibrated cameras without data: {', '.join(spare)}")
    # The recording has the names of the data; ingest matches them with the calibration's
    return {name: name for name, found in meant.items() if found is not None or scene}


def _path_of(made: Choices, name: str) -> str:
    kinds = (FileKind.VIDEO, FileKind.IMAGES, FileKind.BOXES)
    return next((f"{made.shown(i.path)}={i.kind.value}" for i in made.found.of(*kinds) if i.name == name), "PATH=KIND")


def _put_boxes(made: Choices, boxes: Sequence[Item], opened: OpenedBoxes, renamed: Mapping[str, str]) -> None:
    """Set the box files of `ingest`, with the class of people, and add a line for each.

    Args:
        made: the choices.
        boxes: items with boxes.
        opened: their content.
        renamed: name to use by name in the data; other cameras are omitted.
    """
    own: list[object] = []
    used = [item for item in boxes if item in made.found.items and set(opened.files[item].cameras) & set(renamed)]
    for item in used:
        survey, path = opened.files[item], made.shown(item.path)
        names = [renamed.get(name, name) for name in survey.cameras]
        alone = survey.cameras == (item.name,)
        own.append(f"{names[0]}={item.path}" if alone else item.path)
        frames = f"frames {survey.first} to {survey.stop - 1}"
        text = f"boxes: {path} ({' and '.join(survey.kinds)}), {survey.rows} of {', '.join(names)}, {frames}"
        made.say(text, f"--as '{path}=boxes:NAME'" if alone else f"--as {path}=unused")
        others = [name for name in survey.cameras if name not in renamed]
        if others:
            made.put("ingest", "allow_uncalibrated", True)
    if not own:
        return
    made.put("ingest", "boxes", own)
    _choose_class(made, used, opened)


def _choose_class(made: Choices, used: Sequence[Item], opened: OpenedBoxes) -> None:
    """Set the class of people if boxes have several classes; InputError if none of them is known to be people.

    `used`: items with boxes; `opened`: their content.
    """
    if made.has("ingest", "class"):
        return
    found: Counter[tuple[str, ...]] = Counter()
    for item in used:
        camera = item.name if opened.files[item].cameras == (item.name,) else None
        found.update(classes_in(BoxFile(item.path, camera)))
    if len(found) < 2:
        return
    words = ", ".join(f"{'/'.join(label) or 'none'} ({count})" for label, count in found.most_common(8))
    named = {name for label in found for name in label}
    best = next((name for name in PEOPLE if name in named), None)
    if best is None:
        raise InputError(
            f"boxes are of several classes: {words}; choose that of people: --set ingest.class=NAME",
            id="ambiguous-input",
        )
    note = ", person in COCO" if best == "0" else ""
    made.guess("ingest", "class", [best], f"boxes of class {best}{note}, of {words}")


def _put_calibration(made: Choices, calibration: OpenedCalibration) -> None:
    """Set the calibration files of `ingest`, and if needed the up axis and mirroring of its world.

    InputError if the height of the ground is unknown.
    """
    paths = [item.path for item in calibration.items]
    made.put("ingest", "calibration", paths)
    cameras = calibration.file.cameras
    names = ", ".join(made.shown(path) for path in paths)
    made.say(
        f"calibration: {names} ({calibration.file.format}), {counted(len(cameras), 'camera')}, lengths in "
        f"{calibration.file.unit}",
        "--set ingest.calibration_unit=...",
    )
    positions, rotations = np.array([c.position for c in cameras]), np.array([c.rotation for c in cameras])
    mirror = made.value("ingest", "mirror")
    if mirror is None and looks_away(positions, rotations):
        mirror = "y"
        made.guess("ingest", "mirror", mirror, "all that the cameras see is behind them: a left-handed world, mirrored")
    if mirror is not None:
        cameras = tuple(Turn(mirror_matrix(str(mirror)), 0.0).camera(c) for c in cameras)
    rotations = np.array([c.rotation for c in cameras]).reshape(-1, 3, 3)
    upright = is_upright(rotations)
    if not upright and not made.has("ingest", "up"):
        up = other_up_axis(rotations) or "auto"
        if mirror is not None and up[-1] == mirror:  # the vertical is that of the calibration's own world
            up = up[1:] if up.startswith("-") else f"-{up}"
        made.guess("ingest", "up", up, "the calibration's world is not upright: turned by the cameras' horizons")
    low = [c.name for c in cameras if abs(float(c.position[2])) <= HEIGHT_SLACK]
    if (not upright or low) and made.value("ingest", "ground_height") is None:
        why = "its world is not upright" if not upright else f"camera {low[0]} is at height 0"
        raise InputError(
            f"{names}: the height of the ground is unknown, since {why}; state it along up, in the calibration's "
            "world: --set ingest.ground_height=-2.5 where its origin is a camera 2.5 m above the ground",
            id="missing-value",
        )


def _put_scene(made: Choices, stage: str) -> bool:
    """Set the scene file of the stage, if there is one; return whether it has cameras (True if the user sets it)."""
    scenes = made.found.of(FileKind.SCENE)
    if not scenes or made.has(stage, "scene"):
        return made.has(stage, "scene")
    item = made.only(scenes, "scene")
    made.guess(stage, "scene", item.path, f"scene: {made.shown(item.path)}")
    scene = scene_in(item.path)
    return scene is not None and bool(scene.cameras)


def _rates(made: Choices, opened: OpenedBoxes, renamed: Mapping[str, str]) -> None:
    """Set times or frame rates for files that do not state them; InputError if these are missing or ambiguous.

    Args:
        made: the choices.
        opened: box files.
        renamed: name to use of each camera, by name in the data.
    """
    if times := made.found.of(FileKind.TIMES):
        made.put("ingest", "timestamps", [item.path for item in times])
        for item in times:
            made.say(f"times of frames: {made.shown(item.path)}", f"--as {made.shown(item.path)}=unused")
    infos = [read_sequence_info(item.path) for item in made.found.of(FileKind.SEQUENCE)]
    rates = list(dict.fromkeys(info.rate for info in infos if info.rate))
    if len(rates) > 1:
        raise InputError(
            f"sequences have the frame rates {', '.join(rates)}; give one sequence, or --set ingest.fps=RATE",
            id="ambiguous-input",
        )
    if rates and not times:
        made.guess("ingest", "fps", rates[0], f"frame rate: {rates[0]} fps, of seqinfo.ini")
    sizes = list(dict.fromkeys(info.size for info in infos if info.size))
    if len(sizes) == 1 and made.found.of(FileKind.CALIBRATION):
        _check_size(made, sizes[0])
    elif len(sizes) == 1 and not made.found.of(FileKind.VIDEO, FileKind.IMAGES):
        made.guess(
            "ingest", "image_size", f"{sizes[0][0]}x{sizes[0][1]}", f"images of {sizes[0][0]} x {sizes[0][1]} px"
        )
    if made.value("ingest", "fps") is not None or times:
        return
    videos = {item.name: item for item in made.found.of(FileKind.VIDEO)}
    for item in videos.values():
        found = video_times(item.path)
        made.say(f"times of {made.shown(item.path)}: {found.source}", "--set ingest.fps=...")
    for item in made.found.of(FileKind.IMAGES):
        if not are_times(list_images(item.path)):
            _need_rate(made.shown(item.path))
    for item, survey in opened.files.items():
        cameras = [
            name for name in survey.cameras if name in renamed and name not in videos and name not in survey.times
        ]
        if cameras and item in made.found.items and not made.found.of(FileKind.IMAGES):
            _need_rate(made.shown(item.path))


def _need_rate(what: str) -> None:
    raise InputError(
        f"{what}: counts frames, and no file states their rate or times; give it: --set ingest.fps=RATE",
        id="missing-times",
    )


def _check_size(made: Choices, size: tuple[int, int]) -> None:
    """Raise InputError if images of the size (width, height) [px] of boxes are not those of a calibration."""
    for group in _calibrations(made):
        for camera in group.file.cameras:
            if camera.image_size not in (None, size):
                raise InputError(
                    f"seqinfo.ini: images of {size[0]} x {size[1]} px, but camera {camera.name} is calibrated for "
                    f"{camera.image_size[0]} x {camera.image_size[1]}; give the calibration of these images",
                    id="image-size-mismatch",
                )


OURS = (".parquet", ".arrow", ".feather")


def _put_truth(made: Choices, opened: OpenedBoxes | None, *, framed: bool, cameras: tuple[str, ...] = ()) -> None:
    """Set the ground truth, for `ingest` or, if its files can be compared directly, for `evaluate`.

    Args:
        made: the choices.
        opened: box files; None: there are none.
        framed: whether frames are counted, so that first frame numbers of truth and boxes are compared.
        cameras: names in use; true boxes of others are dropped.
    """
    items = made.found.of(FileKind.TRUTH)
    direct = [item for item in items if item.path.suffix.lower() in OURS or "TUM" in item.words or "Geo" in item.words]
    own: list[object] = []
    for item in items:
        if item in direct:
            continue
        of_camera = item.words.startswith("boxes") and not _names_cameras(item.path)
        name = _same(item.name, cameras) or (cameras[0] if len(cameras) == 1 else None)
        if of_camera and name is None:
            made.found.drop(item, f"true boxes of a camera that is none of {', '.join(cameras) or 'those in use'}")
            continue
        own.append(f"{name}={item.path}" if of_camera else item.path)
        text = f"ground truth: {made.shown(item.path)} ({item.words})" + (f" of camera {name}" if of_camera else "")
        made.say(text, f"--as {made.shown(item.path)}=unused")
    if own and not made.has("ingest", "truth"):
        made.put("ingest", "truth", own)
        if framed and opened is not None:
            _first_numbers(made, opened, [item.path for item in items if item not in direct])
    if direct and not own:
        _truth_of_evaluation(made, False)


def _names_cameras(path: Path) -> bool:
    """Return whether a path is a folder, or a table with a column of cameras."""
    try:
        return path.is_dir() or bool({c.lower() for c in first_line(path, "a table")} & set(COLUMNS["camera"]))
    except InputError:
        return False


def _first_numbers(made: Choices, opened: OpenedBoxes, truths: Iterable[Path]) -> None:
    """Set first frame numbers if boxes count frames from 1 and true positions from 0, or vice versa.

    `opened`: box files; `truths`: files of the truth.
    """
    if made.has("ingest", "first_number") or made.has("ingest", "truth_first_number"):
        return
    free = [s for s in opened.files.values() if not any("MOT" in kind or "CVAT" in kind for kind in s.kinds)]
    first = min((survey.first for survey in free), default=None)
    true = [found for path in truths if path.is_file() and (found := frames_of_positions(path)) is not None]
    lowest = min((span[0] for span in true), default=None)
    timed = not true
    if first == 1 and (lowest == 0 or (timed and any("YOLO" in kind for s in free for kind in s.kinds))):
        made.guess("ingest", "first_number", 1, "boxes count frames from 1" + ("" if timed else ", the truth from 0"))
        if not timed:
            made.guess("ingest", "truth_first_number", 0, "frame 0 of the truth is frame 1 of the boxes")
    elif lowest == 1 and first == 0:
        made.guess("ingest", "truth_first_number", 1, "the truth counts frames from 1, boxes from 0")


def _truth_of_evaluation(made: Choices, held: bool) -> None:
    """Set a table of true positions for `evaluate`.

    `held`: whether the recording has a truth, which is then not used.
    """
    items = made.found.of(FileKind.TRUTH)
    if items and not made.has("evaluate", "truth"):
        item = made.only(items, "ground truth")
        also = ", not the recording's own" if held else ""
        made.guess("evaluate", "truth", item.path, f"ground truth: {made.shown(item.path)} ({item.words}){also}")


def _of_logs(made: Choices) -> None:
    """Set inputs and method for logs of directions with their arrays, or of tag reads with their readers."""
    found = made.found
    reads = found.of(FileKind.READS)
    what = "reads" if reads else "bearings"
    if reads:
        made.put("ingest", "reads", [item.path for item in reads])
        for item in reads:
            made.say(f"reads of tags: {made.shown(item.path)}", f"--as {made.shown(item.path)}=unused")
        stations = found.of(FileKind.STATIONS)
        if not stations and not found.of(FileKind.SCENE) and not made.has("ingest", "readers"):
            raise InputError(
                f"{reads[0].path}: reads of tags without the positions of the readers; give a table reader,x,y",
                id="missing-pose",
            )
        if stations:
            item = made.only(stations, "table of readers")
            made.guess("ingest", "readers", item.path, f"readers: {made.shown(item.path)}")
            strengths = any("rssi" in columns_of_reads(each.path) for each in reads)
            if strengths and any(math.isinf(reader.range) for reader in read_readers(item.path)):
                what = "rssi"
    _put_scene(made, "ingest")
    _put_sound(made)
    _put_truth(made, None, framed=False)
    _method(made, what)


def _put_sound(made: Choices) -> None:
    """Set logs of directions, each with the name of its array, and the tables of the arrays, as inputs of `ingest`."""
    logs = made.found.of(FileKind.DIRECTIONS)
    if not logs:
        return
    tables = made.found.of(FileKind.STATIONS, FileKind.MICROPHONES)
    if not tables and not made.found.of(FileKind.SCENE) and not made.has("ingest", "arrays"):
        raise InputError(
            f"{logs[0].path}: directions without the positions of their arrays; give a table name,x,y[,z] or a scene",
            id="missing-pose",
        )
    if tables and not made.has("ingest", "arrays"):
        made.put("ingest", "arrays", [item.path for item in tables])
        for item in tables:
            made.say(f"arrays: {made.shown(item.path)}", f"--as {made.shown(item.path)}=unused")
    arrays = _array_names(made, tables)
    own: list[object] = []
    for item in logs:
        name = None
        if not _has_sensors(item):
            name = _same(item.name, arrays) or (arrays[0] if len(arrays) == len(logs) == 1 else None)
            if name is None:
                raise InputError(
                    f"{item.path}: directions of which array? ({', '.join(arrays)}): "
                    f"--as '{made.shown(item.path)}=doa:NAME'",
                    id="camera-not-named",
                )
        own.append(item.path if name is None else f"{name}={item.path}")
        of = "" if name is None else f" of array {name}"
        change = "" if name is None else f"--as '{made.shown(item.path)}=doa:NAME'"
        made.say(f"directions: {made.shown(item.path)} ({item.words}){of}", change)
    made.put("ingest", "doa", own)
    if any("odas" in item.words for item in logs) and made.value("ingest", "odas_hop") is None:
        raise InputError(
            f"{logs[0].path}: ODAS counts hops, and only its configuration states their length, hopSize / fS: "
            "--set ingest.odas_hop=0.008",
            id="missing-times",
        )


def _has_sensors(item: Item) -> bool:
    """Return whether a log of directions names the sensor of each row."""
    if "odas" in item.words or "frida" in item.words:
        return False
    if "telemetr" in item.words:
        return True
    return bool({cell.lower() for cell in first_line(item.path, "a log")} & {*NAMES, "mic", "microphone"})


def _array_names(made: Choices, tables: Sequence[Item]) -> list[str]:
    """Return the names of the microphone arrays in the tables and in the scene, without duplicates."""
    names = [array.name for item in tables for array in read_arrays(item.path, None)]
    for item in made.found.of(FileKind.SCENE):
        scene = scene_in(item.path)
        names += [] if scene is None else [array.name for array in scene.arrays]
    return list(dict.fromkeys(names))


def _of_sound(made: Choices) -> None:
    """Set the inputs of a run on sound files of microphone arrays; InputError without positions of the microphones."""
    found = made.found
    sounds, tables, scenes = found.of(FileKind.SOUND), found.of(FileKind.MICROPHONES), found.of(FileKind.SCENE)
    if not tables and not scenes and not made.given.get("listen"):
        raise InputError(
            f"{sounds[0].path}: sound without the positions of the microphones; give a table x,y,z or a scene",
            id="missing-pose",
        )
    names = [item.name for item in tables]
    if scenes:
        from occlog.io.open import scene_in

        item = made.only(scenes, "scene")
        scene = scene_in(item.path)
        names = [] if scene is None else [array.name for array in scene.arrays if len(array.microphones)]
        where = "" if len(names) > 1 else "listen"
        made.guess(where, "scene", item.path, f"scene: {made.shown(item.path)}")
    elif tables:
        made.put("listen", "arrays", [f"{item.name}={item.path}" for item in tables])
        for item in tables:
            made.say(
                f"microphones of array {item.name}: {made.shown(item.path)}", f"--as {made.shown(item.path)}=unused"
            )
    own = []
    for item in sounds:
        name = _same(item.name, names) or (names[0] if len(names) == len(sounds) == 1 else None)
        if name is None:
            raise InputError(
                f"{item.path}: sound of which array? ({abridged(names)}): --as '{made.shown(item.path)}=sound:NAME'",
                id="camera-not-named",
            )
        own.append(f"{name}={item.path}")
        made.say(f"sound: {made.shown(item.path)} of array {name}", f"--as '{made.shown(item.path)}=sound:NAME'")
    made.put("listen", "sounds", own)
    azimuths = [i for i in found.of(FileKind.DIRECTIONS) if i in found.items]
    if not scenes or len(names) < 2:
        why = "one array gives no positions" if scenes else "positions of arrays are unknown without a scene"
        made.say(f"{why}: the result is directions (doa.parquet), no tracks")
        truth = azimuths or found.of(FileKind.TRUTH)
        if truth and "doa" in truth[0].words:
            made.put("evaluate", "truth_azimuths", truth[0].path)
        return
    _truth_of_evaluation(made, False)
    _method(made, "bearings")


def _of_table(made: Choices) -> None:
    """Set a table of bearings, ranges, signal strengths, boxes or views as the source, with its scene and method."""
    item = made.only(made.found.of(FileKind.TABLE), "table of measurements")
    made.put("", "table", item.path)
    made.say(f"measurements: {made.shown(item.path)} ({item.words})", f"--as {made.shown(item.path)}=unused")
    _need_deviations(made, item)
    scenes = made.found.of(FileKind.SCENE) or made.found.of(FileKind.STATIONS)
    if not scenes and not made.has("", "scene"):
        raise InputError(
            f"{item.path}: measurements without the positions of the sensors; give a scene or a table name,x,y",
            id="missing-pose",
        )
    if scenes:
        scene = made.only(scenes, "scene")
        made.guess("", "scene", scene.path, f"sensors: {made.shown(scene.path)} ({scene.words})")
    _truth_of_evaluation(made, False)
    _method(made, "boxes" if item.words.startswith(("boxes", "views")) else "bearings")


def _need_deviations(made: Choices, item: Item) -> None:
    """Raise InputError for a column of an external table of measurements without a standard deviation."""
    opened = open_if_ours(item.path)
    if opened is None or opened.external_table is None or opened.table != "measurements":
        return
    names = {spelled.column.name for spelled in opened.external_table.layout.columns}
    for value in VALUES:
        if value in names and f"sigma_{value}" not in names and not made.has("track", f"sigma_{value}"):
            raise InputError(
                f"{item.path}: {value} has no standard deviation (no column sigma_{value}); give it: "
                f"--set track.sigma_{value}=NUMBER",
                id="missing-value",
            )


METHODS = {
    "boxes": ("jipda", "all people on the ground, from the boxes of calibrated cameras"),
    "views": ("sort", "people in the image of each camera, since no pose is known"),
    "reads": ("virtual", "tags by the reads of readers"),
    "rssi": ("rssi", "tags by signal strengths, since the ranges of readers are unknown"),
    "bearings": ("apf", "one target from directions or ranges"),
}


def _method(made: Choices, what: str) -> None:
    method, words = METHODS[what]
    made.guess("track", "method", method, f"method {method}: {words}")
    if made.value("track", "method") == "jipda" and not made.has("track", "lag"):
        made.guess("track", "smooth", True, "smoothed: later boxes count, too, as the recording is complete")


def _rest(made: Choices) -> None:
    """Drop the files that no choice uses, with a reason."""
    text = " ".join(map(str, _flat(made.values))) + " ".join(map(str, _flat(made.given)))
    for item in list(made.found.items):
        if str(item.path) not in text and item.kind is not FileKind.SEQUENCE:
            made.found.drop(item, f"{item.words}: nothing here takes it")


def _flat(values: object) -> Iterable[object]:
    if isinstance(values, Mapping):
        return [each for value in values.values() for each in _flat(value)]
    if isinstance(values, list | tuple):
        return [each for value in values for each in _flat(value)]
    return [values]
