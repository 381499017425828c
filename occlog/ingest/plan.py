"""Plan of `occlog ingest`: its options split and checked against each other.

Folders of data sets as they ship: which of their parts are what.

WILDTRACK has `calibrations`, `annotations_positions` and `Image_subsets/C1` to `C7`; the numbers of its frames (0, 5,
10, ...) count tenths of a second.

Clock offsets are added to the times of sensors, by clocks of their own in the scene.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from occlog.errors import UsageError, did_you_mean, option
from occlog.io.files.timing.frame_choice import FrameChoice
from occlog.records.names import first_double
from occlog.settings import Settings, declared, kind_of, option_setting, read_pair, read_value, setting

if TYPE_CHECKING:
    from occlog.io.formats.calibration.common import CalibrationOptions
    from occlog.records.scene import Scene


CALIBRATION_FOLDER, ANNOTATIONS, IMAGES = "calibrations", "annotations_positions", "Image_subsets"
RATE = "10"
"""Numbers of frames in a second: one in five is there, 2 a second."""


def expand_dataset(values: Mapping[str, Any]) -> dict[str, Any]:
    """Copy of the options of `occlog ingest` with a WILDTRACK folder among the bags replaced by options for its parts.

    Its calibrations, annotations and images become `calibration`, `truth` and `images`, at 10 frame numbers per second.
    Options given by the user have priority; if boxes, images or videos are given, the images of the folder are skipped.

    Raises:
        UsageError: there are two such folders, or one without images, and there are no boxes.
    """
    found = [path for path in values["bags"] if is_wildtrack(path)]
    if not found:
        return dict(values)
    if len(found) > 1:
        raise UsageError(
            f"{found[1]}: a second WILDTRACK folder; run occlog ingest for each, with its own output",
            id="ambiguous-input",
        )
    folder, out = found[0], dict(values)
    out["bags"] = tuple(path for path in values["bags"] if path != folder)
    if not values["calibration"] and not values["scene"]:
        out["calibration"] = (folder / CALIBRATION_FOLDER,)
    if not values["truth"] and (folder / ANNOTATIONS).is_dir():
        out["truth"] = (str(folder / ANNOTATIONS),)
    if not (values["boxes"] or values["images"] or values["video"] or values["mot"]):
        views = sorted(p for p in (folder / IMAGES).glob("C*") if p.is_dir()) if (folder / IMAGES).is_dir() else []
        if not views:
            raise UsageError(
                f"{folder}: has no images ({IMAGES}/C1, ...); give {option('boxes')}, those of a detector, or the "
                f"annotated ones ({folder / ANNOTATIONS})",
                id="wrong-content",
            )
        out["images"] = tuple(f"{view.name}={view}" for view in views)
    if not values["fps"] and not values["timestamps"]:
        out["fps"] = (RATE,)
    if values.get("first_number") is None:
        out["first_number"] = 0
    return out


def is_wildtrack(path: Path) -> bool:
    """Whether a folder has the layout of the WILDTRACK data set: calibrations, and annotations or images."""
    return (path / CALIBRATION_FOLDER).is_dir() and any((path / part).is_dir() for part in (ANNOTATIONS, IMAGES))


UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "": 1.0}
MAX_S = 1e9
"""Largest offset [s]."""
_OFFSET = re.compile(r"([+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?)\s*(s|ms|us|)")


def offsets_of(texts: Iterable[str]) -> dict[str, float]:
    """Parse clock offsets `SENSOR=SECONDS`, also with a unit (`cam2=-0.4s`, `mic=250ms`), into seconds by sensor.

    Raises:
        UsageError: a text is no such pair, the offset exceeds `MAX_S`, or a sensor is named twice.
    """
    out: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        found = _OFFSET.fullmatch(value.strip())
        seconds = float(found[1]) * UNITS[found[2]] if found else math.inf
        if not name or not abs(seconds) <= MAX_S:
            raise UsageError(
                f"{option('clock_offset')} {text}: expected SENSOR=SECONDS, within {MAX_S:g} s, as in cam2=-0.4s"
            )
        if name in out:
            raise UsageError(
                f"{option('clock_offset')}: sensor {name} is given twice; give every sensor one offset",
                id="duplicate-name",
            )
        out[name] = seconds
    return out


def with_offsets(scene: Scene, offsets: Mapping[str, float]) -> Scene:
    """Copy of the scene in which the given offsets [s] are added to the times of sensors, by new clocks of their own.

    Existing clocks and their drifts stay; the new ones are named after the sensor (`cam2-offset`).

    Raises:
        UsageError: the scene lacks a sensor.
    """
    from occlog.array_types import NS
    from occlog.records.scene import Clock

    names = [s.name for s in scene.sensors]
    for name in offsets:
        if name not in names:
            raise UsageError(
                f"{option('clock_offset')}: no sensor {name!r}; {did_you_mean(name, names)}", id="unknown-sensor"
            )
    clocks = {clock.name: clock for clock in scene.clocks}
    own, taken = {}, set(clocks)
    for sensor in scene.sensors:
        if sensor.name in offsets:
            before = clocks.get(sensor.clock or "", Clock(""))
            offset_ns = before.offset_ns - round(offsets[sensor.name] * NS)
            name = _free_name(f"{sensor.name}-offset", taken)
            taken.add(name)
            own[sensor.name] = replace(before, name=name, offset_ns=offset_ns)
    return replace(
        scene,
        cameras=tuple(replace(c, clock=own[c.name].name) if c.name in own else c for c in scene.cameras),
        arrays=tuple(replace(a, clock=own[a.name].name) if a.name in own else a for a in scene.arrays),
        readers=tuple(replace(r, clock=own[r.name].name) if r.name in own else r for r in scene.readers),
        clocks=(*scene.clocks, *own.values()),
    )


def _free_name(name: str, taken: Collection[str]) -> str:
    """The name itself, or the first of `NAME-2`, `NAME-3`, ... that is not among `taken`."""
    return next(each for each in (name, *(f"{name}-{n}" for n in range(2, len(taken) + 3))) if each not in taken)


T = TypeVar("T")
_NAME = re.compile(r"^[^\s,/=:]{1,64}$")


CALIBRATIONS = (
    "auto",
    "qualisys",
    "tsai",
    "projection",
    "homography",
    "opencv-toml",
    "opencv-storage",
    "opencv-pairs",
    "kalibr",
    "ros",
    "colmap",
    "arrays",
)
TRUTHS = ("auto", "csv", "mot", "cvat", "xml", "caliscope", "locata", "wildtrack", "vatic", "kitti")
DOAS = ("auto", "csv", "frida", "telemetr", "odas")


@dataclass(frozen=True, kw_only=True)
class IngestPlan(Settings):
    """Inputs and settings of `occlog ingest`, parsed from a request.

    Values that can be for one sensor are pairs (name of the camera or array, value); the name is None if not given.
    """

    OWNER: ClassVar[str] = "ingest"

    output: Path
    bags: tuple[Path, ...]
    topic: tuple[tuple[str | None, str], ...]
    topics: tuple[Path, ...]
    video: dict[str, Path]
    images: dict[str, Path]
    boxes: tuple[tuple[str | None, Path], ...]
    positions: tuple[tuple[str | None, Path], ...]
    grid: str | None
    doa: tuple[tuple[str | None, Path], ...]
    truth: tuple[tuple[str | None, Path], ...]
    timestamps: tuple[tuple[str | None, Path], ...]
    calibration: tuple[Path, ...]
    image_size: tuple[int, int] | None
    scene: Path | None
    arrays: tuple[tuple[str | None, Path], ...]
    readers: Path | None
    reads: tuple[Path, ...]
    start_time: tuple[tuple[str | None, str], ...]
    fps: tuple[tuple[str | None, str], ...]
    clock_offset: dict[str, float]  # s
    frames: FrameChoice

    timestamp_source: str = option_setting(
        "header",
        "Times of the messages of a bag: `header`, set by the sensors, or `log`, the time of recording.",
        choices=("header", "log"),
    )
    world_frame: str | None = option_setting(
        None,
        "Coordinate frame (tf) of a bag that is the world: z up, the ground at 0.",
        metavar="FRAME",
        nothing="the highest one in which the cameras are static",
    )
    camera_axes: str | None = option_setting(
        None,
        "Axes of the camera frames of a bag: optical (x right, y down, z forward) or of a body (x forward, z up).",
        choices=("optical", "body"),
        nothing="optical, unless z then points up",
    )
    calibration_format: str = option_setting("auto", "Format of the calibration.", choices=CALIBRATIONS)
    calibration_unit: str | None = option_setting(
        None,
        "Length unit of the calibration.",
        choices=("m", "cm", "mm"),
        nothing="the format's own, or m",
    )
    up: str | None = option_setting(
        None,
        "Vertical of the calibration's world; world and true positions are rotated to make it the z axis: `auto` (by "
        "the horizons of the cameras), a signed axis (`-y`), or X,Y,Z.",
        metavar="DIRECTION",
        nothing="z; a warning if it seems wrong",
    )
    mirror: str | None = option_setting(
        None,
        "Axis that is negated in the calibration's world and the true positions, to convert a left-handed world, "
        "as of Unity and MultiviewX. The vertical (`up`) and the ground height are those of the calibration's own "
        "world.",
        choices=("x", "y", "z"),
        nothing="the world is right-handed",
    )
    lens_model: str | None = option_setting(
        None,
        "Lens model of calibrations with four distortion coefficients that do not state it: fisheye (k1 to k4, of "
        "cv2.fisheye) or brown (k1, k2, p1, p2).",
        choices=("brown", "fisheye"),
        nothing="brown in TOML; other files are refused",
    )
    ground_height: float | None = option_setting(
        None,
        "Height of the ground along `up`, in the calibration's world [m]; it becomes z = 0. A wrong value shifts all "
        "positions of feet.",
        unit="m",
        metavar="HEIGHT",
        nothing="0",
    )
    allow_uncalibrated: bool = option_setting(
        False,
        "Accept cameras without calibration too; they give no bearings.",
        shown="refused",
    )
    first_number: int | None = option_setting(
        None,
        "Number that the first frame of a video has in names of images and in tables; it is subtracted from "
        "all frame numbers.",
        at_least=0,
        nothing="lowest image; 0 in tables",
    )
    truth_first_number: int | None = option_setting(
        None,
        "Number that the first frame of a video has in the ground truth, if it is another "
        "than in tables of boxes; it is subtracted.",
        at_least=0,
        nothing="as in tables of boxes",
    )
    store: str | None = option_setting(
        None,
        "Storage of frames in the recording: converted to jpeg or png; or link: only their times, and a link to the "
        "video file.",
        choices=("jpeg", "png", "link"),
        nothing="PNG and JPEG files as they are, all else as jpeg",
    )
    jpeg_quality: int = option_setting(
        95, "Quality of frames stored as JPEG: 1 (smallest files) to 100 (best).", at_least=1, at_most=100
    )
    confidence_scale: float = option_setting(
        1.0, "Divide the detector's confidences by this: 100 for percentages.", above=0
    )
    score_type: str = option_setting(
        "probability",
        "Confidences of a detector: a probability, after division by the scale; a logit, converted by the logistic "
        "function; or unknown.",
        choices=("probability", "logit", "unknown"),
    )
    classes: tuple[str, ...] = setting(
        (),
        "Class of boxes to read, by number or name; boxes of other classes are skipped. May be repeated.",
        repeat=True,
        option="--class",
        metavar="NAME",
        shown="the only one",
    )
    ignore_extra_columns: bool = option_setting(False, "Skip unknown columns of tables.", shown="refused")
    truth_format: str = option_setting(
        "auto",
        "Format of --truth: csv, MOTChallenge (mot), CVAT, PETS (xml), caliscope, LOCATA, "
        "WILDTRACK, VATIC or KITTI; `auto` recognises it.",
        choices=TRUTHS,
    )
    doa_format: str = option_setting("auto", "Format of the DOA logs.", choices=DOAS)
    doa_unit: str | None = option_setting(
        None,
        "Unit of angles in columns of DOA logs without a unit in their name.",
        choices=("deg", "rad"),
        nothing="the format's own",
    )
    doa_convention: str | None = option_setting(
        None,
        "Azimuths in DOA logs: math, from +x towards +y; compass, clockwise from north (+y); array, from the array's "
        "own x axis.",
        choices=("math", "compass", "array"),
        nothing="the format's own, or math",
    )
    odas_hop_s: str | None = setting(
        None,
        "Time [s] from one hop of ODAS to the next, hopSize / fS of its configuration; such as 0.008 or 128/16000.",
        unit="s",
        option="--odas-hop",
        nothing="needed for logs of ODAS, which count hops",
    )
    doa_algorithm: str | None = option_setting(
        None,
        "Algorithm to read, if a log has the estimates of several.",
        nothing="a log must have one",
    )

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> IngestPlan:
        """Create the plan from the values of a request by name of the field or setting, and check it.

        Raises:
            UsageError: values are invalid or contradict each other.
        """
        values = expand_dataset(values)
        mot = _named("mot", values["mot"])
        own = {f.name: values[f.name] for f in declared(cls) if f.name in values}
        plain = ("output", "bags", "topics", "calibration", "image_size", "scene", "readers", "reads", "grid")
        taken: dict[str, Any] = {
            **{key: values[key] for key in plain},
            "video": _named("video", values["video"]),
            "images": _named("images", values["images"]),
            "boxes": (*pairs(values["boxes"], Path), *mot.items()),
            **{key: pairs(values[key], Path) for key in ("doa", "truth", "timestamps", "arrays", "positions")},
            **{key: pairs(values[key], str) for key in ("start_time", "fps", "topic")},
            "clock_offset": offsets_of(values["clock_offset"]),
            "frames": frames_of(values["frames"]),
            **{n: read_value(v, kind_of(cls, n), n) if isinstance(v, str) else v for n, v in own.items()},
        }
        plan = cls(**taken)
        plan.check()
        return plan

    def check(self) -> None:
        """Raise UsageError for options that contradict each other."""
        both = next((name for name in self.video if name in self.images), None)
        if both is not None:
            raise UsageError(f"camera {both}: has both video and images; give one", id="conflicting-options")
        measured = self.boxes or self.positions or self.doa or self.reads or self.truth
        if not (self.bags or self.video or self.images or measured):
            raise UsageError(
                "nothing to ingest; give a bag, video, images, boxes, positions, directions (doa), reads of tags or "
                "truth",
                id="missing-option",
            )
        if self.grid is not None and not self.positions:
            raise UsageError(
                f"{option('grid')} is the grid of positions; give {option('positions')}, or leave it out",
                id="not-applicable",
            )
        turned = self.up is not None or self.ground_height is not None or self.mirror is not None
        if self.positions and turned:
            raise UsageError(
                "positions are in world coordinates already and cannot be turned; leave "
                f"{option('up')}, {option('ground_height')} and {option('mirror')} out",
                id="not-applicable",
            )
        if not self.bags and (self.topic or self.topics or self.world_frame or self.camera_axes):
            raise UsageError(
                f"{option('topic')}, {option('topics')}, {option('world_frame')} and {option('camera_axes')} apply to "
                "a bag; give a bag",
                id="not-applicable",
            )
        if not self.calibration and not self.bags and turned:
            raise UsageError(
                f"{option('up')}, {option('ground_height')} and {option('mirror')} turn the world of a calibration; "
                f"give {option('calibration')} or a bag",
                id="not-applicable",
            )
        if not self.calibration and not self.bags and self.lens_model is not None:
            raise UsageError(
                f"{option('lens_model')} applies to a calibration; give {option('calibration')} or a bag",
                id="not-applicable",
            )
        for key, value in (("start_time", self.start_time), ("fps", self.fps)):
            names = [name or "" for name, _ in value]
            if (double := first_double(names)) is not None:
                raise UsageError(
                    f"{option(key)} is given twice{f' for {double}' if double else ''}; keep one", id="duplicate-name"
                )
        if self.store == "link" and self.images:
            raise UsageError(
                f"{option('store')} link: only videos can be linked to; give png or jpeg for images",
                id="not-applicable",
            )

    def calibration_options(self) -> CalibrationOptions:
        """What the user gives to complete a calibration: length unit, image size, lens model, mirrored axis."""
        from occlog.io.formats.calibration.common import CalibrationOptions

        return CalibrationOptions(self.calibration_unit, self.image_size, self.lens_model, self.mirror)

    def check_names(self, cameras: Sequence[str]) -> None:
        """UsageError for a start time, frame rate or frame range of a sensor that is unknown or cannot have one.

        Args:
            cameras: names of all cameras of the recording.
        """
        arrays = [name for name, _ in self.doa if name is not None]
        sources = [name for name, _ in self.positions if name is not None]
        for key, names, known in (
            ("start_time", self.start_time, (*cameras, *arrays, *sources)),
            ("fps", self.fps, (*cameras, *sources)),
            ("frames", [(name, f"{a}:{b}") for name, (a, b) in self.frames.own.items()], (*cameras, *sources)),
        ):
            for name, value in names:
                if name is not None and name not in known:
                    near = did_you_mean(name, known) if known else "give it without a name"
                    raise UsageError(
                        f"{option(key)} {name}={value}: no camera, array or source of positions has this name; {near}",
                        id="unknown-sensor",
                    )

    def files(self) -> list[tuple[Path, str]]:
        """(path, description for messages) of all inputs that are files.

        Those of boxes and truth may also be folders.
        """
        tables = {
            "boxes": "a table of boxes",
            "positions": "a table of positions",
            "doa": "a log of directions",
            "truth": "ground truth",
            "timestamps": "a table of time stamps",
            "arrays": "a table of positions",
        }
        found = [(path, "a video file") for path in self.video.values()]
        for key, what in tables.items():
            found += [(path, what) for _, path in getattr(self, key)]
        found += [(path, "a log of reads") for path in self.reads]
        found += [(self.readers, "a table of readers")] if self.readers else []
        return found + ([(self.scene, "a scene file")] if self.scene else [])

    def paths(self) -> list[Path]:
        """All files and folders that are read, in a fixed order, which decides on their order in the provenance."""
        return [*self.bags, *self.topics, *self.images.values(), *(path for path, _ in self.files()), *self.calibration]

    def inputs(self) -> list[Path]:
        """All files that are read; folders are replaced by the files in them."""
        from occlog.io.files.provenance import files_in

        return [file for path in self.paths() for file in (files_in(path) if path.is_dir() else [path])]

    def folders(self) -> list[Path]:
        """Paths of boxes and truth, which may be folders as well as files."""
        return [path for _, path in (*self.boxes, *self.truth)]

    def parameters(self) -> dict[str, object]:
        """Options that change the result, by name, as JSON-compatible values for provenance.

        Of paths only the file names. Values that are None, empty or False are omitted.
        """
        shown: dict[str, object] = {}
        for key, value in self.__dict__.items():
            if key == "output" or value in (None, (), {}, False):
                continue
            shown[key] = _plain(value)
        if not self.frames:
            del shown["frames"]
        return shown


def _plain(value: object) -> object:
    if isinstance(value, Path):
        return value.name
    if isinstance(value, FrameChoice):
        own = {name: list(each) for name, each in value.own.items()}
        common = [] if value.common is None else list(value.common)
        return {**({"": common} if common else {}), **own} if own else common
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, tuple) else value


def is_name(text: str) -> bool:
    """Whether a text before `=` can be a sensor name: 1 to 64 characters without spaces, commas, slashes and colons."""
    return _NAME.match(text) is not None


def pairs(values: Iterable[str], kind: Callable[[str], T]) -> tuple[tuple[str | None, T], ...]:
    """Parse texts `NAME=VALUE` or `VALUE` into (name, value); the name is None in the second case.

    `kind` converts the text of the value. A text that is an existing file is a value even if it contains `=`.
    """
    out: list[tuple[str | None, T]] = []
    for text in values:
        name, mark, value = text.partition("=")
        if mark and value and is_name(name) and not Path(text).exists():
            out.append((name, kind(value)))
        else:
            out.append((None, kind(text)))
    return tuple(out)


def frames_of(values: Iterable[str]) -> FrameChoice:
    """Parse frame ranges `A:B` (all cameras) and `NAME=A:B` (one camera), or a list of the two numbers.

    Raises:
        UsageError: a text is neither, or a camera is given twice.
    """
    common, own = None, {}
    texts = tuple(values)
    if len(texts) == 2 and all(text.isdecimal() for text in texts):  # a list in YAML
        texts = (":".join(texts),)
    for name, text in pairs(texts, str):
        try:
            chosen = read_pair(text, size=False)
        except UsageError as error:
            raise UsageError(f"{option('frames')}: {error}") from error
        if name in own or (name is None and common is not None):
            raise UsageError(
                f"{option('frames')} is given twice{f' for {name}' if name else ''}; keep one", id="conflicting-options"
            )
        if name is None:
            common = chosen
        else:
            own[name] = chosen
    return FrameChoice(common, own)


def _named(setting: str, values: Iterable[str]) -> dict[str, Path]:
    """Parse texts `NAME=PATH` into paths by name of the camera.

    Args:
        setting: name of the option, for messages.
        values: texts.

    Raises:
        UsageError: a name is missing or repeated.
    """
    out: dict[str, Path] = {}
    for name, path in pairs(values, Path):
        if name is None:
            raise UsageError(
                f"{option(setting)} {path}: lacks the name of its camera; give CAMERA={path}", id="camera-not-named"
            )
        if name in out:
            raise UsageError(
                f"{option(setting)}: camera {name} is given twice; give every camera its own name", id="duplicate-name"
            )
        out[name] = path
    return out


def for_sensor(pairs: Iterable[tuple[str | None, T]], name: str) -> T | None:
    """Value for the sensor `name` among pairs (name or None, value): its own, else the one for all (None).

    The last one has priority if there are several; None without either.
    """
    own = [value for key, value in pairs if key == name]
    common = [value for key, value in pairs if key is None]
    return own[-1] if own else (common[-1] if common else None)
