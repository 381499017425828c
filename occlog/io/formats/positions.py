"""Positions on the ground from detectors: networks for the ground plane, lidar, radar, ultra-wideband.

A table has a header line with x, y and a column of times or `frame`, and perhaps a source, a score, an identity and the
error: a standard deviation (`sigma`, or `sigma_x` and `sigma_y`) or a covariance (`cov_xx`, `cov_xy`, `cov_yy`).  The
text files of MVDet and MVDeTr have no header: frame, x and y in cells of a grid, and perhaps a score.  In Parquet and
Arrow the columns are the same.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints, Strings
from occlog.console.text import counted
from occlog.errors import InputError, UsageError, option
from occlog.io.files.limits import FREE_ROWS, check_input, naming
from occlog.io.files.names import safe_name
from occlog.io.files.texts.csv_rows import CsvRows, first_line, is_header, read_plain
from occlog.io.files.texts.formats import (
    IDENTITY,
    LENGTH,
    RAW,
    WHOLE,
    FormatColumn,
    TextFormat,
    TextPart,
    read_format,
)
from occlog.io.files.timing.frame_times import FrameTimes, no_frame_times
from occlog.io.files.timing.times import check_unit, time_column
from occlog.records.tables import Positions

WHAT = "a table of positions"
COVARIANCE = ("cov_xx", "cov_xy", "cov_yy")
FORMAT = TextFormat(
    WHAT,
    {
        "frame": FormatColumn(
            ("frame", "frame_id", "frame_number", "frame_index", "frame_idx"), WHOLE, default=-1, blank=False
        ),
        "sensor": FormatColumn(("sensor", "source", "camera", "radar", "lidar", "station", "node"), RAW, default=""),
        "id": FormatColumn(("id", "target_id", "track_id", "tracker_id", "object_id"), IDENTITY, least=-1, default=-1),
        "x": FormatColumn(("x", "x_m", "pos_x"), LENGTH),
        "y": FormatColumn(("y", "y_m", "pos_y"), LENGTH),
        "confidence": FormatColumn(("confidence", "conf", "score", "probability"), default=np.nan),
        "sigma": FormatColumn(("sigma", "sd", "std", "stddev", "sigma_m"), above=0.0, default=np.nan),
        "sigma_x": FormatColumn(("sigma_x", "sd_x", "std_x"), above=0.0, default=np.nan),
        "sigma_y": FormatColumn(("sigma_y", "sd_y", "std_y"), above=0.0, default=np.nan),
        "cov_xx": FormatColumn(("cov_xx", "var_x"), above=0.0, default=np.nan),
        "cov_xy": FormatColumn(("cov_xy",), default=np.nan),
        "cov_yy": FormatColumn(("cov_yy", "var_y"), above=0.0, default=np.nan),
    },
    times=True,
    ignored=("z", "z_m", ""),
)
PLAIN = ("frame", "x", "y", "confidence")
"""Columns of a text without a header."""
MIN_FRAME_STEPS = 10
"""Minimum number of successive frames that determine the step of frame numbers."""
MAX_MISSING_PER_ROW = 20
"""Frames without positions that a file may have for each of its rows, above `FREE_ROWS`: each becomes a row."""
GRIDS = "0.025,-3,-9 is WILDTRACK's, 0.025,0,0 MultiviewX's, 1,0,0 states metres"


class PositionGrid(NamedTuple):
    """Grid of cells in which positions are given: size of a cell, and position of cell (0, 0), in the scene's unit."""

    cell: float  # size of a cell
    x: float  # position of cell (0, 0)
    y: float


@dataclass(frozen=True)
class PositionOptions:
    """Options for reading a position file, for values that it does not state.

    Attributes:
        sensor: source of the positions; None: the file names it, or it is named after the file.
        times: frame times by source; those of the empty name hold for all others.
        start_ns: origin of the times of a file with a column of times [ns since the Unix epoch].
        first_number: number of frame 0.
        frames: selected frames first <= number < stop, of a file that counts frames; None: all.
        grid: of positions in cells; None: they are lengths.
        scale: scores are divided by this.
        scores: `probability`, `logit` or `unknown` (not kept).
        ignore_extra: skip unknown columns instead of refusing them.
    """

    sensor: str | None = None
    times: Mapping[str, FrameTimes] = field(default_factory=dict)
    start_ns: int = 0
    first_number: int = 0
    frames: tuple[int, int] | None = None
    grid: PositionGrid | None = None
    scale: float = 1.0
    scores: str = "probability"
    ignore_extra: bool = False


class PositionLog(NamedTuple):
    """Positions read from a file, its sources, and what was skipped."""

    table: Positions
    sources: tuple[str, ...]
    duplicates: int  # rows that repeat another one, which were skipped
    other_frames: int  # rows of frames that are not chosen
    step: int  # of frame numbers; 0: times are given


class _Rows(NamedTuple):
    """n rows of a position file, in columns; times are `NO_TIME` if frames are numbered instead."""

    line: Ints
    t_ns: Ints
    frame: Ints
    sensor: Strings
    identity: Ints
    position: Floats  # (n, 2)
    covariance: Floats  # (n, 3)
    confidence: Floats


def read_positions(path: Path, options: PositionOptions) -> PositionLog:
    """Read a file of positions on the ground, sorted by time; frames without positions have a row with `detection` -1.

    Raises:
        InputError: a column is missing, a value is invalid, or a covariance is not positive definite.
        UsageError: the file has frame numbers and no frame rate is given, or cells and no grid.
    """
    check_input(path, WHAT)
    parts, head = [], None
    if _has_header(path):
        for part in _parts(path, options):
            head = head or part.rows
            parts.append(_with_header(part, options))
    else:
        parts = [*_without_header(path, options)]
    if not parts or not sum(len(part.line) for part in parts):
        raise InputError(f"{path}: holds no positions; {WHAT} was expected", id="empty-input")
    rows = _Rows._make(np.concatenate(column) for column in zip(*parts, strict=True))
    counted = bool((rows.t_ns == NO_TIME).all())
    rows, skipped = _chosen(rows, options.frames) if counted else (rows, 0)
    if not len(rows.line):
        raise InputError(
            f"{path}: holds no position of the chosen frames; choose others ({option('frames')})", id="empty-input"
        )
    step = _frame_step(rows.frame) if counted else 0
    if counted:
        rows = _timed(path, rows, options)
    else:
        if head is not None and _is_text(path):
            check_unit(head, np.diff(np.unique(rows.t_ns).astype(np.float64)) / NS)
        rows = rows._replace(t_ns=rows.t_ns + options.start_ns, frame=_numbers(rows))
    rows, duplicates = _without_duplicates(rows)
    sources = tuple(dict.fromkeys(rows.sensor.tolist()))
    with naming(path):
        table = _table(rows, options, step)
    return PositionLog(table, sources, duplicates, skipped, step)


NO_TIME = -(2**62)
"""Time of a row of a file that counts frames."""


def _has_header(path: Path) -> bool:
    return not _is_text(path) or is_header(first_line(path, WHAT))


def _is_text(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(4) not in (b"PAR1", b"ARRO", b"\xff\xff\xff\xff")


def _parts(path: Path, options: PositionOptions) -> Iterator[TextPart]:
    if _is_text(path):
        yield from read_format(path, FORMAT, ignore_extra=options.ignore_extra)
        return
    yield from _binary_parts(path, options)


def _binary_parts(path: Path, options: PositionOptions) -> Iterator[TextPart]:
    """Yield the rows of a Parquet or Arrow file of positions, with cells converted to text with all digits.

    Columns are named as in the text format; InputError for unknown or missing ones.
    """
    from occlog.io.external.source import find_source

    source = find_source(path)
    if source is None:
        raise InputError(f"{path}: {WHAT} was expected", id="unknown-format")
    known = {name: key for key, names in FORMAT.names.items() for name in names}
    columns: dict[str, str] = {}
    for name in source.names:
        key = known.get(name.lower())
        if key is None and name.lower() not in FORMAT.ignored and not options.ignore_extra:
            raise InputError(
                f"{path}: unknown column {name!r}; {WHAT} has "
                f"{', '.join(names[0] for names in FORMAT.names.values())}; or skip it "
                f"({option('ignore_extra_columns')})",
                id="unknown-column",
            )
        if key in columns:
            raise InputError(f"{path}: two columns are called {key}; keep one", id="duplicate-name")
        if key is not None:
            columns[key] = name
    parts = list(source.cells(list(columns.values())))
    cells = {
        key: np.array([_as_text(value) for part in parts for value in part.raw(name)], dtype=np.str_)
        for key, name in columns.items()
    }
    count = sum(len(part) for part in parts)
    missing = [name for name in ("x", "y") if name not in cells]
    if missing:
        raise InputError(f"{path}: has no column {' and '.join(missing)}; add it", id="missing-column")
    rows = CsvRows(path, np.arange(1, count + 1), cells, location="row")
    yield TextPart(rows, {name: column.values(rows, name) for name, column in FORMAT.columns.items()})


def _as_text(value: object) -> str:
    """Text of a cell with all digits; empty for null."""
    return "" if value is None else repr(value) if isinstance(value, float) else str(value)


def _with_header(part: TextPart, options: PositionOptions) -> _Rows:
    rows = part.rows
    n = len(rows)
    if time_column(rows) is not None:
        t_ns = part.times()
    elif rows.has("frame"):
        t_ns = np.full(n, NO_TIME)
    else:
        raise InputError(
            f"{rows.path}: has neither a column of times (time, t_ns) nor frame; add one", id="missing-column"
        )
    return _Rows(
        line=rows.lines,
        t_ns=t_ns,
        frame=part["frame"] - options.first_number if rows.has("frame") else np.full(n, -1, dtype=np.int64),
        sensor=_sources(rows, options),
        identity=part["id"],
        position=_in_lengths(np.column_stack([part["x"], part["y"]]), options.grid),
        covariance=_covariances(part),
        confidence=_scores(rows, part["confidence"], options),
    )


def _without_header(path: Path, options: PositionOptions) -> Iterator[_Rows]:
    """Yield the rows of the text of MVDet and MVDeTr: frame, x, y, and optionally a score.

    Raises:
        UsageError: positions are whole numbers, so cells of a grid, and the options have no grid.
    """
    for rows in read_plain(path, WHAT):
        if len(rows.cells) not in (3, 4):
            raise InputError(
                f"{path}: {len(rows.cells)} columns without a header; frame, x, y, and perhaps a score were expected; "
                "name the columns in a header line",
                id="unknown-format",
            )
        named = CsvRows(path, rows.lines, dict(zip(PLAIN, rows.cells.values(), strict=False)))
        position = np.column_stack([named.floats("x"), named.floats("y")])
        if options.grid is None and (position == np.round(position)).all():
            raise UsageError(
                f"{path}: positions are whole numbers, so cells of a grid; state size and origin of the cells "
                f"({option('grid')}; {GRIDS})",
                id="missing-unit",
            )
        n = len(named)
        score = named.floats("confidence") if named.has("confidence") else np.full(n, np.nan)
        yield _Rows(
            line=named.lines,
            t_ns=np.full(n, NO_TIME),
            frame=named.ints("frame") - options.first_number,
            sensor=_sources(named, options),
            identity=np.full(n, -1, dtype=np.int64),
            position=_in_lengths(position, options.grid),
            covariance=np.full((n, 3), np.nan),
            confidence=_scores(named, score, options),
        )


def _in_lengths(position: Floats, grid: PositionGrid | None) -> Floats:
    """Positions (n, 2) of grid cells (n, 2); without a grid `position` itself, which has lengths already."""
    return position if grid is None else np.array([grid.x, grid.y]) + grid.cell * position


def _sources(rows: CsvRows, options: PositionOptions) -> Strings:
    if rows.has("sensor"):
        cells = rows.cells["sensor"]
        if options.sensor is not None and len(np.unique(cells)) > 1:
            raise UsageError(
                f"{rows.path}: its column sensor names several sources; give the file without {options.sensor}=",
                id="conflicting-options",
            )
        if options.sensor is None:
            empty = np.flatnonzero(np.char.strip(cells) == "")
            if len(empty):
                raise rows.fail(int(empty[0]), "sensor is empty; a name was expected; correct this line")
            return np.array([safe_name(cell) for cell in cells.tolist()])
    return np.full(len(rows), options.sensor or safe_name(rows.path.name.split(".")[0]))


def _covariances(part: TextPart) -> Floats:
    """(n, 3) covariances xx, xy, yy from standard deviations or covariances in the file; NaN where none is stated.

    InputError, with the line, if it is stated twice or in part, or is not positive definite.
    """
    rows = part.rows
    single, both = np.isfinite(part["sigma"]), [np.isfinite(part[name]) for name in ("sigma_x", "sigma_y")]
    whole = [np.isfinite(part[name]) for name in ("cov_xx", "cov_yy")]
    for first, second, names in ((*both, "sigma_x and sigma_y"), (*whole, "cov_xx and cov_yy")):
        if (odd := first != second).any():
            raise rows.fail(int(np.flatnonzero(odd)[0]), f"has one of {names}; give both or none")
    count = single.astype(int) + both[0] + whole[0]
    if (twice := count > 1).any():
        raise rows.fail(int(np.flatnonzero(twice)[0]), "states its error twice; give sigma or a covariance")
    out = np.full((len(rows), 3), np.nan)
    out[single] = np.column_stack([part["sigma"] ** 2, np.zeros(len(rows)), part["sigma"] ** 2])[single]
    out[both[0]] = np.column_stack([part["sigma_x"] ** 2, np.zeros(len(rows)), part["sigma_y"] ** 2])[both[0]]
    full = np.column_stack([part["cov_xx"], np.nan_to_num(part["cov_xy"]), part["cov_yy"]])
    out[whole[0]] = full[whole[0]]
    with np.errstate(invalid="ignore"):
        bad = out[:, 0] * out[:, 2] - out[:, 1] ** 2 <= 0.0
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise rows.fail(row, f"covariance {out[row].tolist()} (xx, xy, yy) is not positive definite; correct this line")
    return out


def _scores(rows: CsvRows, values: Floats, options: PositionOptions) -> Floats:
    """(n,) confidences from 0 to 1, divided by the scale or converted from logits as the options state.

    NaN if missing or not used; InputError, with the line, outside 0 to 1. `values` (n,) are those of the file.
    """
    if options.scores == "unknown":
        return np.full(len(values), np.nan)
    out = values / options.scale
    if options.scores == "logit":
        return np.asarray(1.0 / (1.0 + np.exp(-out)))
    with np.errstate(invalid="ignore"):
        bad = (out < 0.0) | (out > 1.0)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise rows.fail(
            row,
            f"confidence is {values[row]:g}; it must be 0 to 1 after division by the scale; state "
            f"{option('confidence_scale')}, or {option('score_type')} logit or unknown",
        )
    return out


def _chosen(rows: _Rows, frames: tuple[int, int] | None) -> tuple[_Rows, int]:
    if frames is None:
        return rows, 0
    kept = (rows.frame >= frames[0]) & (rows.frame < frames[1])
    return _Rows._make(column[kept] for column in rows), int((~kept).sum())


def _frame_step(frame: Ints) -> int:
    """Greatest common divisor of the differences of frame numbers (n,).

    1 if there are at most `MIN_FRAME_STEPS` frames.
    """
    numbers = np.unique(frame)
    return int(np.gcd.reduce(np.diff(numbers))) if len(numbers) > MIN_FRAME_STEPS else 1


def _timed(path: Path, rows: _Rows, options: PositionOptions) -> _Rows:
    """Copy of the rows with the times of their frame numbers.

    Raises:
        InputError: a frame is before the first number, or has no time.
        UsageError: no frame times are known for a source.
    """
    if (rows.frame < 0).any():
        row = int(np.flatnonzero(rows.frame < 0)[0])
        raise InputError(
            f"{path}: line {int(rows.line[row])}: frame {rows.frame[row] + options.first_number} is before "
            f"{option('first_number')} {options.first_number}; give a smaller first number"
        )
    t_ns = rows.t_ns.copy()
    for name in np.unique(rows.sensor).tolist():
        mine = np.flatnonzero(rows.sensor == name)
        with naming(path):
            t_ns[mine] = _times_of(path, name, options).at(rows.frame[mine])
    return rows._replace(t_ns=t_ns)


def _times_of(path: Path, source: str, options: PositionOptions) -> FrameTimes:
    times = options.times.get(source, options.times.get(""))
    if times is None:
        raise no_frame_times(path)
    return times


def _numbers(rows: _Rows) -> Ints:
    """(n,) frame numbers, from 0 for each source, in the order of the times of its rows."""
    out = np.zeros(len(rows.line), dtype=np.int64)
    for name in np.unique(rows.sensor).tolist():
        mine = np.flatnonzero(rows.sensor == name)
        out[mine] = np.unique(rows.t_ns[mine], return_inverse=True)[1]
    return out


def _without_duplicates(rows: _Rows) -> tuple[_Rows, int]:
    """Rows sorted by time, source and line without duplicates, and the number of removed rows.

    Duplicates have equal time, source, identity, position and confidence.
    """
    columns = [rows.line, rows.sensor, rows.t_ns]
    rows = _Rows._make(column[np.lexsort(columns)] for column in rows)
    keys = zip(
        rows.t_ns.tolist(), rows.sensor.tolist(), rows.identity.tolist(),
        map(tuple, rows.position.tolist()), map(str, rows.confidence.tolist()), strict=True,
    )  # fmt: skip
    seen: Counter[object] = Counter()
    kept: list[bool] = []
    for key in keys:
        seen[key] += 1
        kept.append(seen[key] == 1)
    mask: Bools = np.array(kept, dtype=np.bool_)
    return _Rows._make(column[mask] for column in rows), int((~mask).sum())


def _table(rows: _Rows, options: PositionOptions, step: int) -> Positions:
    starts = np.append(True, (np.diff(rows.t_ns) != 0) | (rows.sensor[1:] != rows.sensor[:-1]))
    first = np.maximum.accumulate(np.where(starts, np.arange(len(starts)), 0))
    table = Positions.of(
        t_ns=rows.t_ns,
        sensor=rows.sensor,
        frame=rows.frame,
        detection=(np.arange(len(starts)) - first).astype(np.int32),
        target_id=rows.identity.astype(np.int32),
        x=rows.position[:, 0],
        y=rows.position[:, 1],
        **{name: rows.covariance[:, k] for k, name in enumerate(COVARIANCE)},
        confidence=rows.confidence,
    )
    missing = _missing_frames(rows, options.first_number, step) if step else {}
    return Positions.merge([table, *(_empty_frames(frames, name, options) for name, frames in missing.items())])


def _missing_frames(rows: _Rows, first_number: int, step: int) -> dict[str, Ints]:
    """Frame numbers without positions between the first and last frame of each source.

    Args:
        rows: rows with positions of all sources.
        first_number: number that the file gives frame 0, for the message.
        step: of frame numbers, for sources with too few frames to determine it.

    Raises:
        InputError: there are more than `MAX_MISSING_PER_ROW` for each row, and than `FREE_ROWS`.
    """
    there = {name: np.unique(rows.frame[rows.sensor == name]) for name in dict.fromkeys(rows.sensor.tolist())}
    spans = {
        name: range(int(at[0]), int(at[-1]) + 1, _frame_step(at) if len(at) > MIN_FRAME_STEPS else step)
        for name, at in there.items()
    }
    count, most = sum(len(spans[name]) - len(at) for name, at in there.items()), MAX_MISSING_PER_ROW * len(rows.frame)
    if count > max(FREE_ROWS, most):
        widest = max(spans.values(), key=len)
        raise InputError(
            f"frames {widest[0] + first_number} to {widest[-1] + first_number} have {counted(len(rows.frame), 'row')}: "
            f"more than {max(FREE_ROWS, most)} without one; correct the numbers, or choose frames ({option('frames')})",
            id="input-too-large",
        )
    return {
        name: np.setdiff1d(np.arange(span.start, span.stop, span.step), there[name]) for name, span in spans.items()
    }


def _empty_frames(missing: Ints, source: str, options: PositionOptions) -> Positions:
    """Rows with `detection` -1 for the frames `missing` (n,) of a source; `options` has the frame times."""
    n = len(missing)
    nothing = np.full(n, np.nan)
    return Positions.of(
        t_ns=_times_of(Path(source), source, options).at(missing),
        sensor=np.full(n, source),
        frame=missing,
        **dict.fromkeys(("detection", "target_id"), np.full(n, -1, dtype=np.int32)),
        **dict.fromkeys(("x", "y", *COVARIANCE, "confidence"), nothing),
    )


def parse_grid(text: str) -> PositionGrid:
    """Parse `SIZE,X,Y`, the size of a cell and the position of cell (0, 0); UsageError for another text."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 3 or not np.isfinite(values).all() or values[0] <= 0.0:
        raise UsageError(
            f"{option('grid')} {text}: expected the size of a cell and the position of cell (0, 0), SIZE,X,Y; {GRIDS}"
        )
    return PositionGrid(*values)
