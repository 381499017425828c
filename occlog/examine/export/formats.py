"""Export formats: accepted tables, and file suffixes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from occlog.io.formats.calibration.outputs import OUTPUTS

ANY, PLACES, IN_IMAGES = "any table", "tracks, truth", "boxes, truth_boxes, views, view_tracks"
PLACE_TABLES = ("tracks", "truth")
IMAGE_TABLES = ("view_tracks", "truth_boxes", "boxes", "views")


VIEWERS, FOXGLOVE, RERUN = "viewers", "foxglove", "rerun"
SCENE = "scene"
"""Formats for viewers: for all of them, and smaller ones for some; and for scenes."""
PROGRAMS = {"rerun": RERUN, "foxglove": FOXGLOVE, "foxglove-studio": FOXGLOVE, "lichtblick": FOXGLOVE}
"""Programs that are searched for, in this order, and the format that each takes."""


@dataclass(frozen=True)
class ExportFormat:
    """An export format.

    Attributes:
        endings: endings of file names that select this format; empty: it must be named.
        tables: names of the tables that it can hold; the first that an input has is exported; empty: any.
        doc: description in one line.
        viewer: whether it holds all data of a run folder or a recording for a viewer, and is no table.
        cameras: whether it holds the cameras of a scene, and is no table.
    """

    endings: tuple[str, ...]
    tables: Sequence[str]
    doc: str
    viewer: bool = False
    cameras: bool = False


FORMATS: dict[str, ExportFormat] = {
    "csv": ExportFormat((".csv", ".csv.gz"), (), "text with a header; names of columns end in the unit"),
    "parquet": ExportFormat((".parquet", ".pq"), (), "Parquet with plain columns and nulls, as pandas has it"),
    "mot": ExportFormat((), IMAGE_TABLES, "MOTChallenge text of boxes in the images of one camera"),
    "mot3d": ExportFormat((), PLACE_TABLES, "MOTChallenge text of positions on the ground"),
    "tum": ExportFormat((".tum",), PLACE_TABLES, "t x y z qx qy qz qw of one target, as evo reads it"),
    "kitti": ExportFormat((), IMAGE_TABLES, "KITTI's text of tracked boxes in the images of one camera"),
    "geojson": ExportFormat((".geojson",), PLACE_TABLES, "a line for each target, in longitude and latitude"),
    "coco": ExportFormat((".json",), IMAGE_TABLES, "COCO's images, annotations and categories"),
    "trc": ExportFormat((".trc",), PLACE_TABLES, "OpenSim's table of markers, one per target"),
    VIEWERS: ExportFormat((".mcap",), (), "a run or a recording for Foxglove, Lichtblick and Rerun", viewer=True),
    FOXGLOVE: ExportFormat((), (), "as viewers, without data that Foxglove and Lichtblick do not need", viewer=True),
    RERUN: ExportFormat((), (), "as viewers, without data that Rerun does not draw", viewer=True),
    **{name: ExportFormat(of.endings, (), of.doc, cameras=True) for name, of in OUTPUTS.items()},
    SCENE: ExportFormat((".yaml", ".yml"), (), "the scene of a recording, or of a table of stations", cameras=True),
}
"""Every format by the name that `--to` takes; the first with the ending of a name is taken."""


def format_of(name: str) -> str | None:
    """Return the format that the ending of a file name implies; None if it implies none."""
    low = name.lower()
    return next((key for key, entry in FORMATS.items() if low.endswith(entry.endings) and entry.endings), None)
