"""Request of `occlog ingest`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from occlog.request import Request, group, output_file, source
from occlog.settings import option_setting

from .plan import IngestPlan, frames_of


def _several(help_text: str, metavar: str) -> Any:
    """Declare a repeatable option with values `NAME=VALUE` or `VALUE`, where NAME is a sensor; default: none.

    `help_text` and `metavar` are its help and the placeholder of its value.
    """
    return option_setting((), help_text, metavar=metavar, repeat=True, whole=True, shown="")


@dataclass(frozen=True, kw_only=True)
class IngestRequest(Request):
    """Collect video, detections, directions of arrival and tag reads with the calibration into one recording.

    BAG is a bag of ROS 2 (a folder, .mcap or .db3) or ROS 1 (.bag), or an external MCAP file; several are parts of
    one recording. `occlog info BAG` lists what would be read from it. It may also be the folder of WILDTRACK as the
    data set ships it.

    The time of a frame comes from --timestamps, else from the time stamps of the video file, else from its frame
    rate; the source is printed and recorded. Frames missing from a damaged video are listed, and the exit code is 3.
    The intrinsics and extrinsics that were read from a calibration are printed: check them.

    \b
      occlog ingest -o walk.mcap --calibration Calib.qca.txt --video cam01=cam01.mp4 --video cam02=cam02.mp4
      occlog ingest -o hall.mcap --calibration calib/ --image-size 1920x1024 --boxes detections.csv --fps 20
      occlog ingest -o square.mcap --positions mvdet=test.txt --grid 0.025,-3,-9 --fps 10
      occlog ingest bag/ -o walk.mcap --topic front=/cam_front/image_raw/compressed
      occlog ingest -o tags.mcap --readers readers.csv --reads reads.csv --truth truth.csv
    """

    OWNER: ClassVar[str] = "ingest"
    RUN: ClassVar[str] = "occlog.ingest.run:run_ingest"
    JUDGED: ClassVar[bool] = True
    STRICT: ClassVar[str] = (
        "if a consistency check fails, and with code 3 if any box is faulty. The recording is written anyway."
    )

    bags: tuple[Path, ...] = source(
        "Bags of ROS 2 or ROS 1, external MCAP files, or the WILDTRACK folder.",
        argument=True,
        required=False,
        there=False,
        metavar="[BAG]...",
    )
    output: Path = output_file("Recording (MCAP).")
    topic: tuple[str, ...] = _several(
        "Topic of a bag to read as NAME: images, calibration or boxes of camera NAME, "
        "directions of array NAME, or true positions of target number NAME; may be repeated.",
        "NAME=TOPIC",
    )
    topics: tuple[Path, ...] = source(
        "YAML file with lines `NAME: TOPIC`, each as of --topic.", there=False, metavar="FILE"
    )
    video: tuple[str, ...] = _several("Video file of a camera, CAM=FILE; may be repeated.", "CAM=FILE")
    images: tuple[str, ...] = _several(
        "Folder with the images of a camera, read in natural order of their names: img2 before img10; may be repeated.",
        "CAM=FOLDER",
    )
    boxes: tuple[str, ...] = _several(
        "Boxes: CSV (frame, left, top, width, height [px]; camera, confidence), JSON (COCO, supervision, "
        "Ultralytics), MOTChallenge text, or a folder of YOLO text; may be repeated.",
        "[CAM=]PATH",
    )
    mot: tuple[str, ...] = _several(
        "MOTChallenge detections (det.txt) of a camera; same as --boxes CAM=FILE.", "CAM=FILE"
    )
    positions: tuple[str, ...] = _several(
        "Positions on the ground that a detector reports (network for the ground plane, "
        "lidar, radar): CSV or Parquet (time or frame, x, y in the scene's unit, ...), or "
        "the text of MVDet and MVDeTr; may be repeated.",
        "[SOURCE=]FILE",
    )
    grid: str | None = option_setting(
        None,
        "Grid of positions that are given as cell numbers (WILDTRACK, MultiviewX): size of a cell, and x and y of "
        "cell 0, in the scene's unit; in metres 0.025,-3,-9 is WILDTRACK's, 0.025,0,0 MultiviewX's.",
        metavar="SIZE,X,Y",
        shown="positions are lengths",
    )
    doa: tuple[str, ...] = _several(
        "Log of directions of arrival: CSV (time, azimuth_deg, ...), or of FRIDA, telemetr or ODAS; may be repeated.",
        "[ARRAY=]FILE",
    )
    reads: tuple[Path, ...] = source(
        "Log of tag reads of fixed readers: a CSV table time [s], reader, tag, and perhaps "
        "rssi [dBm]; may be repeated.",
        there=False,
        metavar="FILE",
    )
    truth: tuple[str, ...] = _several(
        "Ground truth of targets in a format of --truth-format: positions (CSV: time or "
        "frame, id, x, y) or boxes; may be repeated.",
        "[CAM=]FILE",
    )
    timestamps: tuple[str, ...] = _several(
        "Times of the frames: text with one per line [s], or columns time [s] (or t_ms, "
        "t_ns), frame, camera. They take precedence over any other source.",
        "[CAM=]FILE",
    )
    calibration: tuple[Path, ...] = source(
        "Calibration of the cameras, intrinsics and extrinsics: a file or folder in a format of --calibration-format; "
        "may be repeated.",
        there=False,
        metavar="FILE",
    )
    image_size: tuple[int, int] | None = option_setting(
        None,
        "Width and height of the images [px], where the calibration states none; a calibration of another size is "
        "scaled to them.",
        metavar="WxH",
        size=True,
        shown="",
    )
    scene: Path | None = source(
        "Scene file (YAML), or a recording, with room, occluders, microphone arrays and "
        "further cameras; a camera that the calibration has too is refused.",
        there=False,
        scene=True,
    )
    arrays: tuple[str, ...] = _several(
        "Positions [m]: a table name,x,y of arrays or direction finders, or x,y,z of the microphones of one array, "
        "then called NAME; may be repeated.",
        "[NAME=]FILE",
    )
    readers: Path | None = source(
        "Tag readers: a CSV table reader, x, y, and perhaps z, range (of reading) in the "
        "scene's unit, and power [dBm] at 1 m.",
        there=False,
        metavar="FILE",
    )
    start_time: tuple[str, ...] = _several(
        "Date and time (ISO 8601, UTC) or seconds since 1970 of time 0 of the inputs; it is "
        "added to all their times but those of --truth. [default: 0]",
        "[CAM=]TIME",
    )
    clock_offset: tuple[str, ...] = _several(
        "Clock offset, added to the times of a sensor: cam2=-0.4s for a clock that is 0.4 s ahead.",
        "SENSOR=SECONDS",
    )
    fps: tuple[str, ...] = _several(
        "Frames per second, where --timestamps gives no times; replaces the time stamps of a video file.",
        "[CAM=]RATE",
    )
    frames: tuple[str, ...] = _several(
        "Only frames A <= number < B, and true positions of their times. Frames of this range without a row in "
        "--boxes count as frames without a detection (of a file with every n-th frame number, only these).",
        "[CAM=]A:B",
    )
    settings: Mapping[str, object] = group(lambda: IngestPlan)

    def __post_init__(self) -> None:
        """Raise UsageError for invalid frame ranges at once, before the run begins."""
        frames_of(self.frames or ())

    @property
    def plan(self) -> IngestPlan:
        """The request as a plan: files and values by sensor; UsageError for invalid or contradictory values."""
        own = {name: value or () for name, value in vars(self).items() if name not in ("settings", *SINGLE)}
        return IngestPlan.of({**own, **{name: getattr(self, name) for name in SINGLE}, **self.settings})

    @property
    def inputs(self) -> list[Path]:
        """All files that are read; folders are replaced by the files in them."""
        return self.plan.inputs()


SINGLE = ("output", "image_size", "scene", "readers", "grid")
"""Fields of one value, which may be None."""
