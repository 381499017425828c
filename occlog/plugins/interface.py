"""Interfaces of plug-ins: classes with a one-line summary, a settings class, and one working method.

Detectors: image to boxes. Exporters: table to a file in an external format. Tracking methods of bearings: scans to
positions. Metrics: tracks and truth to figures. Readers: file of an external format to named columns. Tracking methods
of one camera: boxes to identities.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import IO, ClassVar, NamedTuple, Protocol

from numpy.random import Generator
from numpy.typing import ArrayLike

from occlog.array_types import Floats, Floats32, Ints
from occlog.records.columns import ColumnTable
from occlog.records.frames import Image
from occlog.records.scene import Scene
from occlog.records.tables import Errors, Tracks, Truth
from occlog.settings import Settings, setting


class Detected(NamedTuple):
    """The N boxes in an image; N may be 0.

    Attributes:
        boxes: (N, 4) left and upper edge, width and height [px], the last two above 0; the centre of the first pixel is
            (0, 0).
        scores: (N,) confidence, 0 to 1.
        embeddings: (N, D) appearance in the boxes, D the same in all images; None: the detector gives none.
    """

    boxes: Floats
    scores: Floats
    embeddings: Floats32 | None = None


class Detector(Protocol):
    """A detector of people (group `occlog.detectors`): an object for each camera.

    It draws random numbers from its generator alone, changes nothing that it is given, and writes nothing.
    """

    summary: ClassVar[str]  # one line for --help
    settings: ClassVar[type[Settings]]

    def __init__(self, settings: Settings, rng: Generator) -> None:
        """Create a detector that has seen no image yet; `rng` is the source of all its random numbers."""

    def detect(self, image: Image) -> Detected:
        """Return the boxes of people in an image (height, width, 3), BGR, uint8; images come in the order of time."""


class ExportContext(NamedTuple):
    """Context that is needed with the rows.

    Attributes:
        length_unit: of all lengths.
        scene: cameras, arrays and the room; None: not given.
    """

    length_unit: str
    scene: Scene | None


class Exporter(Protocol):
    """A format that tables are written in (group `occlog.exporters`).  It changes nothing that it is given."""

    summary: ClassVar[str]  # one line for --help
    settings: ClassVar[type[Settings]]
    tables: ClassVar[tuple[str, ...]]  # names of the tables that it takes; the first that an input holds is taken

    def __init__(self, settings: Settings) -> None:
        """Create an exporter that has written nothing yet; one object may write several files."""

    def write(self, rows: ColumnTable, world: ExportContext, file: IO[bytes]) -> None:
        """Write all rows to a file that can only be written on, may be standard output, and is closed by its opener.

        `world`: unit and scene of the rows.
        """


class TargetScan(NamedTuple):
    """Measurements of one target by R sensors at one time.

    Attributes:
        t_ns: time [ns since the Unix epoch]; it never goes back.
        sensors: (R,) names; one may be there several times, with candidates that may be of anything.
        places: (R, 2) where they are, in the scene's unit of length.
        bearings: (R,) from +x towards +y [rad]; NaN: the sensor observed and did not see the target.
        sigma: (R,) standard deviations [rad]; NaN where the bearing is.
    """

    t_ns: int
    sensors: tuple[str, ...]
    places: Floats
    bearings: Floats
    sigma: Floats


class EstimatedPosition(NamedTuple):
    """Estimated position of a target.

    Attributes:
        xy: (2,) in the scene's unit of length.
        covariance: (2, 2) of xy, symmetric and positive definite.
        velocity: (2,) per second; None: the method does not estimate it.
    """

    xy: Floats
    covariance: Floats
    velocity: Floats | None = None


class Filter(Protocol):
    """A tracking method of bearings (group `occlog.tracking_methods`): an object for each target.

    It draws random numbers from its generator alone, changes nothing that it is given, and writes nothing.
    """

    summary: ClassVar[str]  # one line for --help
    settings: ClassVar[type[Settings]]

    def __init__(self, scene: Scene, settings: Settings, rng: Generator) -> None:
        """Create a filter that knows nothing of the target yet; `rng` is the source of all its random numbers."""

    def step(self, scan: TargetScan) -> EstimatedPosition | None:
        """Update the filter with a scan; return the target's position at its time, or None if that is not known yet."""


class MetricInput(NamedTuple):
    """Tracks on the ground and what they are compared with.

    Attributes:
        tracks: rows in the order of time.
        truth: likewise; `role` distinguishes targets from occluders.
        errors: of each estimate that has a truth at its time, paired as `occlog evaluate` pairs them.
        length_unit: of all lengths.
    """

    tracks: Tracks
    truth: Truth
    errors: Errors
    length_unit: str


class Metric(Protocol):
    """A metric (group `occlog.metrics`).  It changes nothing that it is given, and writes nothing."""

    summary: ClassVar[str]  # one line for --help
    settings: ClassVar[type[Settings]]
    units: ClassVar[Mapping[str, str]]  # unit of each figure by its name: `length`, `s`, `1`, ...

    def __init__(self, settings: Settings) -> None:
        """Create a metric; one object may compare several times, without memory of earlier comparisons."""

    def figures(self, compared: MetricInput) -> Mapping[str, float]:
        """Return all figures of a comparison by name; NaN: there is nothing to compute one from."""


Columns = Mapping[str, ArrayLike]
"""Values by the name of their column, which may state the unit (`bearing_deg`, `x_cm`); all of one length.

Names and units are those that any table of another program may have.  NaN and None are cells without a value.
"""


class Reader(Protocol):
    """A reader of a file format (group `occlog.readers`)."""

    summary: ClassVar[str]  # one line for --help
    settings: ClassVar[type[Settings]]
    endings: ClassVar[tuple[str, ...]]  # of the names of such files, as (".xyz",)
    table: ClassVar[str]  # what such files hold, as `bearings`: a name of the tables of this program

    def __init__(self, settings: Settings) -> None:
        """Create a reader that has not read anything."""

    def read(self, path: Path) -> Columns:
        """Return the columns of a file; ValueError, which describes the fault and where, for a damaged one."""


class BoxesInFrame(NamedTuple):
    """The N boxes that a detector has found in a frame of one camera; N may be 0.

    Attributes:
        t_ns: time of the frame [ns since the Unix epoch]; it never goes back.
        frame: number of the frame in the camera's stream; it grows, perhaps by more than 1.
        boxes: (N, 4) left and upper edge, width and height [px].
        scores: (N,) confidence of the detector, 0 to 1; NaN: it gives none.
        embeddings: (N, D) appearance in the boxes; D is 0 if not given.
    """

    t_ns: int
    frame: int
    boxes: Floats
    scores: Floats
    embeddings: Floats32


class ViewTracker(Protocol):
    """A tracking method in the images of one camera (group `occlog.view_trackers`): an object for each camera.

    It draws random numbers from its generator alone, changes nothing that it is given, and writes nothing.
    """

    summary: ClassVar[str]  # one line for --help
    settings: ClassVar[type[Settings]]

    def __init__(self, settings: Settings, rng: Generator) -> None:
        """Create a tracker without tracked objects; `rng` is the source of all its random numbers."""

    def step(self, found: BoxesInFrame) -> Ints:
        """Update the tracker with the boxes of a frame, and return their identities (N,).

        From 0, each once; -1: a box without an identity (yet).
        """


__all__ = [
    "BoxesInFrame",
    "Columns",
    "Detected",
    "Detector",
    "Errors",
    "EstimatedPosition",
    "ExportContext",
    "Exporter",
    "Filter",
    "Image",
    "Metric",
    "MetricInput",
    "Reader",
    "Scene",
    "Settings",
    "TargetScan",
    "Tracks",
    "Truth",
    "ViewTracker",
    "setting",
]
"""Everything that a plug-in needs of this program."""
