"""Opening of inputs: a recording, an occlog table or an external table, recognised by content.

Every command opens its inputs here. The first bytes of a file determine what it is; its name does not matter. An
external table is known by its columns (`occlog.io.external`). An opened input streams its rows, and has their scene,
length unit and losses. Readers are imported when a file of their kind is opened.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar, cast

from occlog.console.notes import log_detail
from occlog.errors import InputError, NoSceneError, OcclogError, UsageError, abridged, option
from occlog.io.files.input_units import STATED
from occlog.io.files.limits import EXPECTED, ROS_BAG, Content, content_of, describe_unsupported, holds_text
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import describe, is_ours, iter_table, read_header
from occlog.records.columns import LENGTHS, ColumnTable
from occlog.records.losses import Loss
from occlog.records.tables import Truth, table_with

if TYPE_CHECKING:
    from occlog.io.external.source import ColumnSource
    from occlog.io.external.table import ExternalTable
    from occlog.io.recording.reader import McapRecording
    from occlog.records.scene import Scene

T = TypeVar("T", bound=ColumnTable)
RECORDING_SUFFIX = ".mcap"
WORDS = {
    "boxes": "boxes of a detector",
    "doa": "directions of arrival",
    "positions": "positions on the ground",
    "reads": "reads of tags",
    "truth_boxes": "true boxes",
    "view_tracks": "tracks in images",
}
"""Descriptions of tables with names that do not state the content."""
SWAPPED = (
    ("tracks", "truth", "; are the files of tracks and truth swapped?"),
    ("truth", "bearings", "; true positions go to the evaluation, make measurements of a recording by `occlog detect`"),
    ("views", "bearings", "; bearings are the other output of `occlog detect`"),
    ("boxes", "bearings", "; the method jipda tracks boxes"),
)
"""Tables that are given for others by mistake: table of the file, requested table, and a hint."""
REMEDY = "give a recording or a table that has them"


TEXT = (".txt", ".csv")
"""Suffixes of text, which may be empty: whoever reads it states whether that can be."""


@dataclass(frozen=True)
class Opened:
    """An opened input, of which only the header has been read.

    Attributes:
        path: the file.
        provenance: how it was made.
        scene: the scene of a recording; None: it holds none, or the input is a table.
        length_unit: unit of its lengths; None: not stated.
        recording: the recording; None: the input is a table.
        table: name of the table; empty for a recording.
        external_table: the external table; None: the input was made by occlog.
    """

    path: Path
    provenance: Provenance
    scene: Scene | None
    length_unit: str | None
    recording: McapRecording | None
    table: str
    external_table: ExternalTable | None = None

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Losses of input that are recorded in the file's provenance."""
        return self.provenance.losses

    @property
    def made_in_a_scene(self) -> bool:
        """Whether the input is a table with a unit of length that must match the scene.

        It is an external table that states its unit, or a table that was made from other files, and so in their scene.
        """
        if self.external_table is not None:
            return self.length_unit is not None
        return self.recording is None and bool(self.provenance.inputs)

    def has_lengths(self, table: type[ColumnTable]) -> bool:
        """Whether the input has lengths of `table` in a stated unit, which must match the scene."""
        return self.made_in_a_scene or (
            self.recording is not None and self.has(table) and any(c.unit in LENGTHS for c in table.columns())
        )

    def has(self, table: type[ColumnTable]) -> bool:
        """Whether the input is `table`, or a recording with rows of it."""
        return self.table == table.NAME if self.recording is None else self.recording.has(table)

    @property
    def counts_frames(self) -> bool:
        """Whether the input is an external table with frame numbers and a frame rate in place of times."""
        return self.external_table is not None and any(s.fps is not None for s in self.external_table.layout.columns)

    def widest(self, table: type[T]) -> type[T]:
        """Variant of `table` with the most columns that the file has (`PeopleTracks` for `Tracks`).

        `table` for a recording.
        """
        if self.external_table is not None:
            return self.external_table.widest(table)
        if self.recording is not None:
            return table
        return cast("type[T]", table_with(table.NAME, [c["name"] for c in describe(self.path)["columns"]]))

    def rows(self, table: type[T], *, remedy: str = REMEDY, at_once: int | None = None) -> Iterator[T]:
        """Yield the rows of `table` in chunks, in the order of time.

        Args:
            table: type of the table.
            remedy: what to do if the input has no such rows, for the message.
            at_once: most rows in a chunk of a Parquet table; None: the default.

        Raises:
            InputError: the input has no such rows, or is damaged.
        """
        self.require(table, remedy=remedy)
        if self.external_table is not None:
            return self.external_table.rows(table)
        if self.recording is not None:
            return self.recording.tables(table)
        return iter_table(self.path, table) if at_once is None else iter_table(self.path, table, at_once)

    def read(self, table: type[T]) -> T:
        """All rows of `table`; InputError if the input has none, or is damaged."""
        return table.concat(self.rows(table))

    def require(self, *tables: type[ColumnTable], remedy: str = REMEDY) -> None:
        """InputError unless the input holds at least one of the tables; `remedy` is what to do, for the message."""
        if any(self.has(table) for table in tables):
            return
        if self.external_table is not None:
            if not any(self.external_table.fits(table) for table in tables):
                from occlog.io.external.table import best_fit

                try:
                    best_fit(self.external_table.source, tables)
                except InputError as error:
                    raise InputError(f"{error}; with its present columns it is read as {self.table}") from error
            return
        names = [t.NAME for t in tables]
        if self.recording is None:
            swapped = next((hint for have, want, hint in SWAPPED if have == self.table and want in names), "")
            raise InputError(f"{self.path}: holds {self.table}; expected {_or(names)}{swapped}", id="wrong-content")
        missing = " and no ".join(WORDS.get(t.NAME, t.NAME) for t in tables)
        hint = "" if self.recording.ours else f"; {ROS_BAG}"
        raise InputError(f"{self.path}: holds no {missing}; {remedy}{hint}", id="wrong-content")


def _or(names: list[str]) -> str:
    """Format names as `a`, `a or b`, `a, b or c`."""
    return " or ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def open_input(path: Path, *wants: type[ColumnTable], remedy: str = REMEDY, fps: Fraction | None = None) -> Opened:
    """Open a recording, an occlog table or an external table, recognised by its content.

    Args:
        path: the file.
        wants: tables of which the input must hold at least one; empty: any will do.
        remedy: what to do if a recording holds none of them, for the message.
        fps: frames per second of an external table that counts frames and states no times; None: not given.

    Raises:
        InputError: the file is missing or damaged, is of another kind, or holds none of the tables.
    """
    path = Path(path)
    opened = open_if_ours(path)
    if opened is None:
        source = _source(path)
        try:
            opened = None if source is None else _external_table(source._replace(fps=fps), wants)
        except InputError:
            _refuse_stations(path)
            raise
    if opened is None:
        mistaken = describe_unsupported(path)
        if mistaken is not None:
            raise InputError(f"{path}: is {mistaken}", id="wrong-content")
        if path.suffix.lower() == ".json":
            raise InputError(
                f"{path}: is JSON, which is not read here; convert boxes in JSON to a recording: `occlog ingest "
                "--boxes`",
                id="wrong-content",
            )
        if path.suffix.lower() not in (RECORDING_SUFFIX, ".parquet") and holds_text(path):
            raise InputError(
                f"{path}: is text without a header line; begin it with the names of its columns, one of them of times, "
                "as time,id,x,y",
                id="unknown-format",
            )
        # The reader of the kind that the name states explains the fault of the content
        opened = _recording(path) if is_recording_name(path) else _table(path)
    if wants:
        opened.require(*wants, remedy=remedy)
        if opened.external_table is not None:
            opened = _external_table(opened.external_table.source, wants)
    return opened


def open_if_ours(path: Path, what: str = EXPECTED) -> Opened | None:
    """Open a recording, an occlog table or an external table; None for any other file, such as a scene.

    `what` is the expected content, for messages. InputError for a missing or unreadable file, or a damaged one of
    occlog.
    """
    if path.suffix.lower() in TEXT and path.is_file() and not path.stat().st_size:
        return None
    if not (path.is_dir() and is_table_in_parts(path)):
        content = content_of(path, what)
        if content is Content.RECORDING:
            return _recording(path)
        if content is Content.TABLE and is_ours(path):
            return _table(path)
    source = _source(path)
    try:
        return None if source is None else _external_table(source)
    except InputError:
        return None


def held(path: Path, *tables: type[ColumnTable]) -> tuple[type[ColumnTable], ...]:
    """Which of the given tables an input holds, by its header; empty if it cannot be opened.

    For an external table that fits several it is the best fitting one.
    """
    from occlog.io.external.table import best_fit

    try:
        opened = open_if_ours(path)
        source = _source(path) if opened is None else None
        if opened is not None:
            return tuple(table for table in tables if opened.has(table))
        return () if source is None else (best_fit(source, tables).table,)
    except (InputError, OSError):
        return ()


def _refuse_stations(path: Path) -> None:
    """InputError if a file is a text table of stations, which has neither times nor frames and is given as a scene.

    Returns without an error for other files.
    """
    from occlog.io.external.names import is_in_time
    from occlog.io.formats.scenes.stations import check_stations, holds_stations, occurs_twice

    source = _source(path) if content_of(path) is Content.OTHER and holds_stations(path) else None
    if source is not None and not is_in_time(source.names):
        check_stations(path)
        if occurs_twice(path):
            raise InputError(
                f"{path}: has no column of times or frame numbers among {abridged(source.names)}; name one "
                "time_s or t_ns",
                id="missing-column",
            )
        raise InputError(
            f"{path}: holds the positions of stations, not their measurements; give it by {option('scene')}",
            id="wrong-content",
        )


def frames_counted_by(path: Path) -> str | None:
    """Name of the column of frame numbers of an external table without times; None for other files."""
    from occlog.io.external.names import frame_column

    source = None if open_if_ours(path) is not None else _source(path)
    return None if source is None else frame_column(source.names)


def is_table_in_parts(folder: Path) -> bool:
    """Whether a folder is one table in Parquet files."""
    from occlog.io.external.source import parquet_parts

    return bool(parquet_parts(folder))


def _source(path: Path) -> ColumnSource | None:
    from occlog.io.external.source import find_source

    return find_source(path)


def _external_table(source: ColumnSource, wants: Sequence[type[ColumnTable]] = ()) -> Opened:
    """Open an external table as the one of `wants` (empty: of all tables) that fits its columns best.

    Stated units that apply to it count as used. InputError if no table fits.
    """
    from occlog.io.external.names import kind_of, unit_in_name
    from occlog.io.external.table import ExternalTable, best_fit

    table = ExternalTable(source, best_fit(source, wants))
    for column, name, *_ in table.layout.columns:
        reported = unit_in_name(table.layout.table, column, name)
        STATED.get().note_use(name, kind_of(column), reported, source.path)
    names = (f"{s.name} is {s.column.name}" + (f" [{s.unit}]" if s.unit else "") for s in table.layout.columns)
    log_detail(
        f"{source.path}: {source.kind} of another program, read as {table.layout.table.NAME}: {', '.join(names)}"
    )
    return Opened(
        source.path,
        Provenance("unknown", version="", versions={}),
        None,
        table.length_unit,
        None,
        table.layout.table.NAME,
        table,
    )


def _recording(path: Path) -> Opened:
    from occlog.io.recording.reader import open_recording

    recording = open_recording(path)
    unit = None if recording.scene is None else recording.scene.length_unit
    log_detail(f"{path}: a recording{'' if recording.scene is None else f' with a scene, lengths in {unit}'}")
    return Opened(path, recording.provenance, recording.scene, unit, recording, "")


def _table(path: Path) -> Opened:
    header = read_header(path)
    log_detail(f"{path}: a table of occlog: {header.table}, lengths in {header.length_unit}")
    return Opened(path, header.provenance, None, header.length_unit, None, header.table)


class ExternalPositions(NamedTuple):
    """True positions from an external file; `on_earth`: they were converted from geodetic positions."""

    rows: Iterator[Truth]
    on_earth: bool


def external_positions(path: Path, length_unit: str) -> ExternalPositions | None:
    """True positions from a file in a format that the readers of data sets lack; None for a file of another kind.

    Such formats are trajectories (TUM, TRC, GeoJSON, GPX, EuRoC), geodetic positions, Parquet and Arrow, and text with
    column names that state length units.

    Args:
        path: the file.
        length_unit: unit to which positions are converted.

    Raises:
        InputError: the file is of such a kind, and cannot be read.
    """
    from occlog.io.external.source import parquet_parts

    if path.is_dir() and not parquet_parts(path):
        return None
    source = _source(path)
    if source is None:
        return None
    text = source.kind == "CSV" and source.geodetic is None
    try:
        opened = _external_table(source, (Truth,))
    except InputError:
        if text:
            return None
        raise
    assert opened.external_table is not None
    if text and not source.commented and opened.length_unit is None:
        return None
    opened.external_table.convert_to(length_unit)
    on_earth = source.geodetic is not None or source.kind in ("GPX", "GeoJSON")
    return ExternalPositions(opened.external_table.rows(Truth), on_earth)


def is_external(path: Path | None) -> bool:
    """Whether a file is a table or trajectory of another program; False for None."""
    return path is not None and _source(path) is not None


def load_scene(scene: Path | None, recording: Scene | None, where: Path) -> Scene:
    """The scene in the file `scene`, or else (None) that of the input recording.

    Args:
        scene: file that the user gives: YAML, a table of stations, or a recording with a scene.
        recording: scene of the input recording; None: it has none.
        where: the input, for the message.

    Raises:
        NoSceneError: there is no scene.
    """
    if scene is not None:
        found = scene_in(scene)
        if found is None:
            raise NoSceneError(scene)
        return found
    if recording is None:
        raise NoSceneError(where)
    return recording


def scene_in(path: Path) -> Scene | None:
    """Scene in a YAML file, a recording, or a table of stations; None for a recording without one.

    InputError for other files.
    """
    content = content_of(path, "a scene file (YAML), a table of stations or a recording with a scene")
    if content is Content.RECORDING:
        from occlog.io.recording.reader import open_recording

        return open_recording(path).scene
    from occlog.io.formats.scenes.scene import read_scene
    from occlog.io.formats.scenes.stations import header_of_table, holds_stations, read_stations

    if content is Content.OTHER and holds_stations(path):
        return read_stations(path)
    if content is Content.OTHER and (header := header_of_table(path)):
        raise InputError(
            f"{path}: is a table ({', '.join(header[:4])}, ...), not a scene: stations have name, x and y; are the "
            "measurements and the scene swapped?",
            id="wrong-content",
        )
    return read_scene(path)


def is_recording_name(output: Path) -> bool:
    """Whether the name of a file has the suffix of a recording (.mcap)."""
    return output.suffix.lower() == RECORDING_SUFFIX


def check_unit(
    opened: Opened, length_unit: str, source: str = "the scene", error: type[OcclogError] = UsageError
) -> None:
    """Raise an error if an input has lengths in another unit; an external table is set to be converted instead.

    Args:
        opened: the input; one that does not state its unit passes.
        length_unit: what it must be.
        source: the owner of that unit, for the message.
        error: class of the error.
    """
    if opened.external_table is not None:
        opened.external_table.convert_to(length_unit)
    elif opened.length_unit not in (None, length_unit):
        raise error(
            f"{opened.path}: lengths are in {opened.length_unit}, but in {length_unit} in {source}; "
            "use files of one scene"
        )


def common_unit(inputs: Iterable[Opened | None]) -> tuple[str, str]:
    """Length unit of inputs that are used without a scene, and the file that determines it (empty: none does).

    The first occlog table that states a unit decides. Without one, the unit is that of the first external table with
    lengths, or m if an external table has lengths without a unit. None is skipped.
    """
    opened = [each for each in inputs if each is not None]
    for each in opened:
        if each.external_table is None and each.length_unit is not None:
            return each.length_unit, str(each.path)
    others = [each for each in opened if each.external_table is not None and each.external_table.has_lengths]
    first = next((each for each in others if each.length_unit is None), next(iter(others), None))
    return ("m", "") if first is None else (first.length_unit or "m", str(first.path))


def open_in_unit(path: Path, length_unit: str | None, *wants: type[ColumnTable]) -> Opened:
    """Open an input; lengths of an external table are converted to `length_unit` when its rows are read.

    Lengths of occlog's own files are not converted.

    Args:
        path: the file.
        length_unit: unit of lengths; None: as the file has them.
        wants: tables of which the input must hold at least one; empty: any will do.
    """
    opened = open_input(path, *wants)
    if opened.external_table is not None and length_unit is not None:
        opened.external_table.convert_to(length_unit)
    return opened


def input_losses(inputs: Iterable[Opened | None]) -> tuple[Loss, ...]:
    """Losses recorded in the provenance of several inputs, without duplicates; None is skipped."""
    return tuple(dict.fromkeys(loss for opened in inputs if opened is not None for loss in opened.losses))
