"""Check that exported rows are identical when read back; and report what a format cannot hold."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Ints
from occlog.console.text import counted
from occlog.errors import InputError
from occlog.io.external.names import MAY_BE_EMPTY
from occlog.io.files.timing.utc import utc
from occlog.records.columns import ColumnTable
from occlog.records.declared.views import ViewTracks
from occlog.records.tables import Boxes, Tracks, Truth, TruthBoxes

T = TypeVar("T", bound=ColumnTable)
BREAKS = ("\n", "\r", "\0")
"""Values that no cell of a text can hold."""


def readable(chunks: Iterable[T], source: Path, *, text: bool) -> Iterator[T]:
    """Generate the chunks of a table unchanged, after a check that their names can be read back from the output.

    Args:
        chunks: the rows.
        source: file of the rows, for messages.
        text: whether the output is text, in which names have no line breaks, blanks at an end, or (mostly) empty cells.

    Raises:
        InputError: a name would be read back differently.
    """
    for chunk in chunks:
        if text:
            _check_names(chunk, source)
        yield chunk


def _check_names(chunk: ColumnTable, source: Path) -> None:
    for c in chunk.columns():
        if c.kind != "U":
            continue
        empty = c.name not in chunk.KEY or c.name in MAY_BE_EMPTY.get(chunk.NAME, ())
        for name in np.unique(getattr(chunk, c.name)).tolist():
            if name != name.strip() or any(mark in name for mark in BREAKS) or not (name or empty):
                raise InputError(
                    f"{source}: {c.name} {name!r}: a text table takes no line break, no blank at either end and "
                    "no empty cell in "
                    "this column; rename it, or export Parquet"
                )


UNITLESS = ("tum", "mot3d")
"""Formats of positions that do not state in which unit these are."""
PLACES = {
    "tum": ("t_ns", "x", "y", "z"),
    "trc": ("t_ns", "target_id", "x", "y", "z"),
    "geojson": ("t_ns", "target_id", "x", "y"),
    "mot3d": ("target_id", "x", "y", "z", "existence_probability"),
}
"""Columns of positions that a format holds."""
EDGES = ("left_px", "top_px", "width_px", "height_px")
BOXES = {
    "mot": ("frame", *EDGES, "confidence"),
    "kitti": ("frame", "target_id", *EDGES, "confidence"),
    "coco": ("t_ns", "sensor", "frame", "target_id", *EDGES, "confidence"),
}
"""Columns of boxes that a format holds; MOTChallenge has identities of tracks, too."""
ELLIPSE = ("x_px", "y_px", "a_px", "b_px", "rho")
SILENT = ("role", "box", "cluster", "sensor")
"""Columns that are reported otherwise, or number existing rows."""
WORDS = {"t_ns": "times", "target_id": "identities", "z": "heights"}


class UnrepresentableColumns:
    """Detects columns of a table that have values and that the output format cannot hold."""

    def __init__(
        self, name: str, table: type[ColumnTable], length_unit: str, chosen: tuple[int, ...], camera: str | None
    ):
        """Create a note of what a format cannot represent, without rows yet.

        Args:
            name: name of the format.
            table: type of the exported table.
            length_unit: unit of its lengths.
            chosen: identities that are exported; empty: all.
            camera: name of the only camera that is exported; None: all.
        """
        self._name, self._table, self._unit, self._chosen, self._camera = name, table, length_unit, chosen, camera
        held = (PLACES | BOXES)[name]
        if issubclass(table, ViewTracks):
            held = (*held, *ELLIPSE)
        if name == "mot" and issubclass(table, ViewTracks | TruthBoxes):
            held = (*held, "target_id")
        self._open = [c for c in table.columns() if c.name not in held and c.name not in SILENT]
        self._known: dict[str, None] = {}
        self._first: int | None = None
        self._heightless = self._others = 0
        self._frames = ExportedFrames()

    def watched(self, rows: Iterable[T]) -> Iterator[T]:
        """Generate the parts of a table unchanged, each checked; rows of one time must be in one part."""
        for part in rows:
            self._see(part)
            yield part

    def _see(self, part: ColumnTable) -> None:
        own = part
        if isinstance(own, Truth):
            own = own.take(own.role == "target")
            self._others += len(part) - len(own)
        if isinstance(own, Truth | Tracks):
            own = own.take(np.isin(own.target_id, self._chosen)) if self._chosen else own
            self._heightless += int(np.isnan(own.z).sum())
            if len(own) and self._first is None:
                self._first = int(own.t_ns[0])
        elif self._camera is not None:
            own = own.take(own.sensor == self._camera)  # type: ignore[attr-defined]
        if isinstance(own, Boxes):
            self._frames.see(own)
        for c in self._open:
            if c.name not in self._known and _says_something(getattr(own, c.name)):
                self._known[c.name] = None

    def words(self) -> tuple[str, ...]:
        """Return descriptions of what the format cannot hold, one each, such as `velocities`."""
        out = []
        if self._name in UNITLESS and self._unit != "m":
            out.append(f"that lengths are in {self._unit}")
        if self._name == "trc" and self._first:
            out.append(f"the time of the first row, {utc(self._first)} ({self._first} ns)")
        if self._heightless and "z" in PLACES.get(self._name, ()):
            out.append(f"which heights are not known (0 in {counted(self._heightless, 'row')})")
        if self._others and not self._chosen:
            out.append(f"{counted(self._others, 'row')} of other objects than targets")
        covariances = [name for name in self._known if name.startswith(("cov_", "sd_"))]
        speeds = [name for name in self._known if name in ("vx", "vy", "vz")]
        rest = [name for name in self._known if name not in covariances and name not in speeds]
        out += [WORDS[name] for name in rest if name in WORDS]
        out += ["velocities"] if speeds else []
        out += ["covariances"] if covariances else []
        other = [name for name in rest if name not in WORDS]
        out += [f"columns {', '.join(other)}"] if other else []
        return (*out, *self._frames.words())


def _says_something(values: NDArray[np.generic]) -> bool:
    """Return whether any value of a column is known: a finite number, an identity >= 0, a text, or True."""
    if values.dtype.kind == "f":
        return bool(np.isfinite(values).any())
    if values.dtype.kind in "US":
        return bool((values != "").any())
    return bool((values.astype(np.int64) >= 0).any()) if values.dtype.kind == "i" else bool(values.any())


class ExportedFrames:
    """Detects frames without boxes, which formats of boxes cannot hold."""

    def __init__(self) -> None:
        """Create a check for frames without boxes, before the first frame."""
        self._ends: dict[str, tuple[int, int]] = {}
        self._boxed: dict[str, tuple[int, int]] = {}
        self._rows: Counter[str] = Counter()

    def see(self, boxes: Boxes) -> None:
        """Add the frames of rows; all rows of one time must be in one call."""
        for name in np.unique(boxes.sensor).tolist():
            own = boxes.sensor == name
            frames = boxes.frame[own]
            _widen(self._ends, name, frames)
            _widen(self._boxed, name, frames[boxes.box[own] >= 0])
            self._rows[name] += len(np.unique(frames))

    def words(self) -> tuple[str, ...]:
        """Return descriptions of frames without boxes before the first and after the last box, and of missing frames.

        A frame between two others that is not in the text is read as one without a detection.
        """
        outside = missing = 0
        for name, (low, high) in self._ends.items():
            first, last = self._boxed.get(name, (high + 1, high))
            outside += first - low + high - last
            missing += max(0, high - low + 1 - self._rows[name])
        out = []
        if outside:
            out.append(f"{counted(outside, 'frame')} without a box before the first or behind the last one with some")
        if missing:
            out.append(f"that {counted(missing, 'frame')} between others were not recorded: read as without a box")
        return tuple(out)


def _widen(ends: dict[str, tuple[int, int]], name: str, frames: Ints) -> None:
    if len(frames):
        low, high = int(frames.min()), int(frames.max())
        before = ends.get(name, (low, high))
        ends[name] = (min(low, before[0]), max(high, before[1]))
