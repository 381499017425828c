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
    """The N boxes that a detector finds in an image; N may be 0.

    Attributes:
        boxes: (N, 4) left edge, upper edge, width and height [px], the last two above 0; the centre of the first pixel
            is (0, 0).
        scores: (N,) confidence, 0 to 1.
        embeddings: (N, D) appearance vectors of the boxes, with the same D in all images; None: the detector computes
            none.
    """

    boxes: Floats
    scores: Floats
    embeddings: Floats32 | None = None


class Detector(Protocol):
    """A detector of people (entry point group `occlog.detectors`); each camera has its own object.

    Random numbers come from the given generator alone. A detector does not modify its inputs, and writes nothing.
    """

    summary: ClassVar[str]  # one line for --help
    settings: ClassVar[type[Settings]]

    def __init__(self, settings: Settings, rng: Generator) -> None:
        """Create a detector that has seen no image yet; `rng` is the source of all its random numbers."""

    def detect(self, image: Image) -> Detected:
        """Return the boxes of people in an image (height, width, 3), BGR, uint8; images come in the order of time."""


class ExportContext(NamedTuple):
    """Unit and scene of the rows that an exporter writes.

    Attributes:
        length_unit: unit of all lengths in the rows.
        scene: cameras, arrays and the room; None: not given.
    """

    length_unit: str
    scene: Scene | None


class Exporter(Protocol):
    """An exporter: writes tables in an external format (entry point group `occlog.exporters`).

    It does not modify its inputs.
    """

    summary: ClassVar[str]  # one line for --help
    settings: ClassVar[type[Settings]]
    tables: ClassVar[tuple[str, ...]]  # names of the tables that it takes; the first that an input holds is taken

    def __init__(self, settings: Settings) -> None:
        """Create an exporter that has written nothing yet; one object may write several files."""

    def write(self, rows: ColumnTable, world: ExportContext, file: IO[bytes]) -> None:
        """Write all rows to a file.

        Args:
            rows: table to write, of one of the kinds in `tables`.
            world: unit of lengths and scene of the rows.
            file: binary file that can only be written, perhaps standard output; the caller closes it.
        """


class TargetScan(NamedTuple):
    """Bearings of one target from R sensors at one time.

    Attributes:
        t_ns: time [ns since the Unix epoch]; it never decreases from scan to scan.
        sensors: (R,) names of the sensors; a sensor with several candidates occurs once for each, and any of them may
            be false.
        places: (R, 2) x and y of the sensors, in the scene's unit of length.
        bearings: (R,) angle from +x towards +y [rad]; NaN: the sensor observed, but did not detect the target.
        sigma: (R,) standard deviation of each bearing [rad]; NaN where the bearing is NaN.
    """

    t_ns: int
    sensors: tuple[str, ...]
    places: Floats
    bearings: Floats
    sigma: Floats


class EstimatedPosition(NamedTuple):
    """Estimated position of a target.

    Attributes:
        xy: (2,) position in the scene's unit of length.
        covariance: (2, 2) covariance of the position, symmetric and positive definite.
        velocity: (2,) velocity in units of length per second; None: not estimated.
    """

    xy: Floats
    covariance: Floats
    velocity: Floats | None = None


class Filter(Protocol):
    """A tracking method for bearings (entry point group `occlog.tracking_methods`); each target has its own object.

    Random numbers come from the given generator alone. A filter does not modify its inputs, and writes nothing.
    """

    summary: ClassVar[str]  # one line for --help
    settings: ClassVar[type[Settings]]

    def __init__(self, scene: Scene, settings: Settings, rng: Generator) -> None:
        """Create a filter that has no information on the target yet; `rng` is the source of all its random numbers.

        `scene`: sensors, room and unit of length.
        """

    def step(self, scan: TargetScan) -> EstimatedPosition | None:
        """Update the filter with a scan; return the target's position at its time, or None if that is not known yet."""


class MetricInput(NamedTuple):
    """Tracks on the ground, and the truth and errors that belong to them.

    Attributes:
        tracks: estimates, in the order of time.
        truth: true positions, in the order of time; its column `role` distinguishes targets from occluders.
        errors: error of each estimate with a true position at its time, paired as `occlog evaluate` does.
        length_unit: unit of all lengths in the tables.
    """

    tracks: Tracks
    truth: Truth
    errors: Errors
    length_unit: str


class Metric(Protocol):
    """A metric: computes figures from tracks and truth (entry point group `occlog.metrics`).

    It does not modify its inputs, and writes nothing.
    """

    summary: ClassVar[str]  # one line for --help
    settings: ClassVar[type[Settings]]
    units: ClassVar[Mapping[str, str]]  # unit of each figure by its name: `length`, `s`, `1`, ...

    def __init__(self, settings: Settings) -> None:
        """Create a metric; one object may compute several comparisons, and must not remember earlier ones."""

    def figures(self, compared: MetricInput) -> Mapping[str, float]:
        """Return all figures of a comparison, by name; NaN where the input does not determine a figure."""


Columns = Mapping[str, ArrayLike]
"""Values by the name of their column, which may state the unit (`bearing_deg`, `x_cm`); all of one length.

Names and units are those that any table of another program may have.  NaN and None are cells without a value.
"""


class Reader(Protocol):
    """A reader of files in an external format (entry point group `occlog.readers`)."""

    summary: ClassVar[str]  # one line for --help
    settings: ClassVar[type[Settings]]
    endings: ClassVar[tuple[str, ...]]  # of the names of such files, as (".xyz",)
    table: ClassVar[str]  # what such files hold, as `bearings`: a name of the tables of this program

    def __init__(self, settings: Settings) -> None:
        """Create a reader that has not read any file yet."""

    def read(self, path: Path) -> Columns:
        """Return the columns of a file by name.

        Raises:
            ValueError: the file is damaged; the message states the fault and its position in the file.
        """


class BoxesInFrame(NamedTuple):
    """The N boxes that a detector has found in a frame of one camera; N may be 0.

    Attributes:
        t_ns: time of the frame [ns since the Unix epoch]; it never decreases.
        frame: number of the frame in the camera's stream; it increases, by 1 or more.
        boxes: (N, 4) left edge, upper edge, width and height [px].
        scores: (N,) confidence of the detector, 0 to 1; NaN: unknown.
        embeddings: (N, D) appearance vectors of the boxes; D is 0 if there are none.
    """

    t_ns: int
    frame: int
    boxes: Floats
    scores: Floats
    embeddings: Floats32


class ViewTracker(Protocol):
    """A tracking method in images (entry point group `occlog.view_trackers`); each camera has its own object.

    Random numbers come from the given generator alone. A tracker does not modify its inputs, and writes nothing.
    """

    summary: ClassVar[str]  # one line for --help
    settings: ClassVar[type[Settings]]

    def __init__(self, settings: Settings, rng: Generator) -> None:
        """Create a tracker without tracked objects; `rng` is the source of all its random numbers."""

    def step(self, found: BoxesInFrame) -> Ints:
        """Update the tracker with the boxes of a frame, and return their identities (N,).

        Identities are at least 0 and occur once per frame; -1: a box without an identity, or without one yet.
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
