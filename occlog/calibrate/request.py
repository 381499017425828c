"""Request of `occlog calibrate`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from occlog.io.formats.calibration.outputs import format_of, is_folder
from occlog.request import Request, group, output_file, scene_file, seed_of_all, sink, source
from occlog.settings import option_setting

from .config import CalibrateConfig


@dataclass(frozen=True, kw_only=True)
class CalibrateRequest(Request):
    """Estimate the poses (extrinsics) and clock offsets of cameras from boxes of people who walk.

    RECORDING has boxes of all cameras (of `occlog ingest --boxes`, or views of `occlog detect`). Intrinsics are those
    of its scene. Poses of the scene are where the search starts; without them, or with --ignore-poses, the result has
    its origin below one of the cameras, and its scale is that of --person-height. No markers, no chessboard, no labels
    and no synchronised clocks are needed; a minute of three or more people who walk where cameras overlap is. Where
    nothing is known of a lens but the size of the images, its focal length is estimated too. Microphone arrays of the
    scene with directions of arrival of people who walk and speak get a pose and a clock, too. Cameras that share no
    view are calibrated by people who pass from one view to the next, one person at a time.

    With --board, RECORDING is a video, a folder of images or a recording of a chessboard or ChArUco board, and the
    result has the intrinsics of each camera.

    \b
      occlog calibrate walk.mcap -o scene.yaml
      occlog calibrate walk.mcap --scene rough.yaml --sigma-position 1 --sigma-angle 10 -o scene.yaml
      occlog calibrate walk.mcap --ignore-poses --focal -o scene.yaml
      occlog calibrate walk.mcap --points clicked.csv -o scene.yaml
      occlog calibrate passages.mcap --ignore-poses --max-gap 6 -o scene.yaml
      occlog calibrate board.mp4 --board 9x6 -o lens.yaml
      occlog track walk.mcap --scene scene.yaml -o tracks.parquet
    """

    OWNER: ClassVar[str] = "calibrate"
    RUN: ClassVar[str] = "occlog.calibrate.run:run_calibrate"
    JUDGED: ClassVar[bool] = True

    recording: Path = source("Recording or views with boxes; with --board also a video or images.", argument=True)
    output: Path = output_file(
        "Scene with the calibrated cameras (YAML), or a calibration by its name: a folder opencv, colmap or "
        "camera_info, a file camchain.yaml.",
        result="scene",
    )
    scene: Path | None = scene_file("the cameras and their lenses")
    ignore_poses: bool = option_setting(
        False,
        "Start without the poses of the scene, from the intrinsics alone. Needed where they are wrong by more than "
        "about 15 deg or 3 m.",
        shown="",
    )
    focal: bool = option_setting(
        False,
        "Also estimate the focal length of each camera, as a factor of the stated one. It stays as stated, with a "
        "warning, where the boxes do not determine it.",
        shown="",
    )
    radial: bool = option_setting(
        False,
        "Also estimate a correction of the first radial distortion coefficient (k1) of each lens, where the boxes "
        "determine it.",
        shown="",
    )
    points: Path | None = source(
        "CSV table of known points that were marked in images: camera, u, v [px], world position x, y and, above the "
        "floor, z [scene unit]. Four or more of a camera give its initial pose, and its focal length where that is "
        "not known.",
        metavar="FILE",
    )
    doa: Path | None = source(
        "Directions of arrival at microphone arrays, which are calibrated by people who speak: a table, or a recording "
        "that holds them. [default: those of RECORDING]"
    )
    picture: Path | None = sink(
        "Picture (PNG): the floor grid drawn on an image of each camera, with the residuals of its boxes.",
        asked="never",
        suffix=".png",
        metavar="FILE",
    )
    board: str | None = option_setting(
        None,
        "Calibrate lenses from this board: numbers of inner corners of a chessboard, or of squares of a ChArUco board, "
        "across and down, e.g. 9x6.",
        metavar="COLUMNSxROWS",
        shown="",
    )
    dictionary: str = option_setting(
        "",
        "Markers of a ChArUco board, a dictionary of OpenCV, such as 4X4_50 or 5X5_100.",
        metavar="NAME",
        shown="a chessboard",
    )
    marker: float = option_setting(
        0.75,
        "Side of a marker of a ChArUco board, as a fraction of the side of a square.",
        above=0,
        below=1,
        metavar="SHARE",
    )
    cameras: tuple[str, ...] = option_setting(
        (), "Use these cameras only, names separated by commas.", metavar="A,B,...", shown=""
    )
    without: tuple[str, ...] = option_setting(
        (), "Exclude these cameras, names separated by commas.", metavar="A,B,...", shown=""
    )
    settings: Mapping[str, object] = group(lambda: CalibrateConfig, example="rounds=3")
    seed: int = seed_of_all()

    @property
    def outputs(self) -> list[Path]:
        """All files that are written, except for a calibration folder, which is checked by the run."""
        form = format_of(self.output)
        return [path for path in super().outputs if path != self.output or form is None or not is_folder(path, form)]
