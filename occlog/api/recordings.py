"""Recordings and tables opened in Python without a command, and inputs of API functions.

Tables in memory that are given in place of files become temporary files during a call.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from html import escape
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self, TypeAlias

from occlog.errors import SPELLING, InputError, OcclogError, UsageError, abridged, did_you_mean
from occlog.io.files.tables.table_writer import TableWriter
from occlog.io.open import Opened, open_input, scene_in
from occlog.records.columns import ColumnTable as Rows
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import TABLES

from .folders import Folder
from .tables import Table, in_words

if TYPE_CHECKING:
    import pandas as pd


class Sensor(NamedTuple):
    """A sensor of a scene.

    Attributes:
        name: name of the sensor.
        kind: `camera`, `array` (of microphones) or `reader` (of radio tags).
        placed: whether its pose is known.
    """

    name: str
    kind: str
    placed: bool


class Recording:
    """A recording: its scene, sensors and tables, and the input that was lost when it was made.

    Every function of occlog accepts a recording in place of a file. A table is read on first use, for example by
    `recording["truth"]`.

    Attributes:
        source: path of the file.
        summary: what the command that made the recording reported; empty for an opened file.
    """

    def __init__(
        self,
        path: Path,
        summary: Mapping[str, object] | None = None,
        home: Folder | None = None,
    ) -> None:
        """Create the object for a file; users call `occlog.open` instead.

        Args:
            path: path of the recording.
            summary: what the command that made the recording reported.
            home: temporary folder that contains the recording, removed with the last reference to it; None: not
                temporary.
        """
        self.source = path
        self.summary: Mapping[str, object] = {} if summary is None else summary
        self._home = home
        self._tables: dict[str, Table] = {}

    @cached_property
    def _opened(self) -> Opened:
        return open_input(self.source)

    @property
    def scene(self) -> Scene | None:
        """Room, occluders and sensors; None: the recording contains no scene."""
        return self._opened.scene

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """Sensors of the scene; without a scene, the cameras that have frames."""
        scene, recording = self.scene, self._opened.recording
        if scene is None:
            return tuple(Sensor(n, "camera", False) for n in (() if recording is None else recording.cameras))
        return (
            *(Sensor(c.name, "camera", c.placed) for c in scene.cameras),
            *(Sensor(a.name, "array", True) for a in scene.arrays),
            *(Sensor(r.name, "reader", True) for r in scene.readers),
        )

    @property
    def tables(self) -> tuple[str, ...]:
        """Names of the tables that the recording contains."""
        return tuple(name for name, table in TABLES.items() if self._opened.has(table))

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Input that was lost when the recording was made."""
        return self._opened.losses

    @property
    def provenance(self) -> Mapping[str, object]:
        """Provenance: command, parameters, seed, version, names and SHA-256 of the inputs."""
        return self._opened.provenance.as_dict()

    def __getitem__(self, name: str) -> Table:
        """Return the table `name` of the recording, for example `truth`.

        Raises:
            UsageError: there is no kind of table with that name.
            InputError: the recording does not contain it, or is damaged.
        """
        if name not in self._tables:
            self._tables[name] = _stored(self._opened, _table_of(name))
        return self._tables[name]

    def __repr__(self) -> str:
        sensors = ", ".join(s.name for s in self.sensors) or "none"
        return f"<occlog recording {self.source.name}: tables {', '.join(self.tables) or 'none'}; sensors {sensors}>"

    def _repr_html_(self) -> str:
        """Return an HTML table of the recording's tables, sensors, summary and losses, which notebooks show."""
        rows = {
            "tables": ", ".join(self.tables),
            "sensors": ", ".join(f"{s.name} ({s.kind})" for s in self.sensors),
            **{name: in_words(value) for name, value in self.summary.items()},
            "lost": "; ".join(str(loss) for loss in self.losses),
        }
        body = "".join(f"<tr><th>{escape(k)}</th><td>{escape(v)}</td></tr>" for k, v in rows.items() if v)
        return f"<table><caption>recording {escape(self.source.name)}</caption>{body}</table>"


def open(path: str | os.PathLike[str]) -> Recording:
    """Open a recording or a file with one table; such a file becomes a recording without a scene.

    Args:
        path: a recording (MCAP), a table of occlog (Parquet), or one of another program (Parquet, Arrow, CSV).

    Raises:
        InputError: the file is missing, damaged, or of another kind.
    """
    recording = Recording(path_of(path, "path"))
    _ = recording.tables
    return recording


def read(source: Source, table: str | None = None) -> Table:
    """Read a table from a file, a DataFrame, a dict of columns, or a recording.

    A table of another program is recognised by its columns, as on the command line; times, units and identities are
    checked.

    Args:
        source: source of the rows.
        table: name of the table to read; None: the kind of the source, or the kind that its columns fit best.

    Raises:
        InputError: the source is no such table; the message has column, row and the nearest name.
        UsageError: no kind of table has that name, or a recording contains several and `table` is None.
    """
    wants = () if table is None else (_table_of(table),)
    if isinstance(source, Recording):
        return source[_only(source.tables, table)]
    home = Folder()
    with CallInputs() as inputs:
        if isinstance(source, str | os.PathLike | Table):
            path = inputs.rows(source, "source")
        else:
            path = inputs.called(home.file("table.arrow"), "source")
            write_arrow(arrow_of(source, "source"), path)
        opened = open_input(path, *wants)
        if opened.recording is not None:
            recording = Recording(path)
            return recording[_only(recording.tables, table)]
        if isinstance(source, Table):
            return source
        return _stored(opened, wants[0] if wants else TABLES[opened.table], home)


def read_scene(source: SceneSource) -> Scene:
    """Read a scene from a file (YAML), a recording, or a table of stations (name, x, y and optionally z).

    A `Scene` is returned as it is.

    Raises:
        InputError: the file is missing, damaged, or states something impossible.
        UsageError: the recording contains no scene.
    """
    if isinstance(source, Scene):
        return source
    with CallInputs() as inputs:
        path = inputs.scene(source)
        if path is None:
            raise UsageError("scene is missing; give it", id="missing-option")
        found = scene_in(path)
        if found is None:
            raise UsageError(f"{path}: this recording holds no scene; give a scene file", id="missing-scene")
        return found


def _table_of(name: str) -> type[Rows]:
    if not isinstance(name, str) or name not in TABLES:
        raise UsageError(f"no table {name!r}; {did_you_mean(name, TABLES)}", id="unknown-name")
    return TABLES[name]


def _only(names: tuple[str, ...], wanted: str | None) -> str:
    if wanted is None and len(names) != 1:
        remedy = f"choose one: table={names[0]!r}" if names else "give one that holds tables"
        raise UsageError(f"the recording holds {abridged(names)}; {remedy}", id="ambiguous-input")
    return names[0] if wanted is None else wanted


def _stored(opened: Opened, table: type[Rows], home: Folder | None = None) -> Table:
    """Return the rows of an opened input as a table of occlog; if they are not one yet, they are written to a file.

    Args:
        opened: the input.
        table: kind of table.
        home: temporary folder for the file; None: a new one.

    Raises:
        InputError: the input contains no such table.
    """
    if opened.recording is None and opened.external_table is None:
        opened.require(table)
        return Table(opened.path)
    home = Folder() if home is None else home
    path = home.file(f"{table.NAME}.parquet")
    with TableWriter(path, table, opened.provenance, length_unit=opened.length_unit or "m") as writer:
        for part in opened.rows(table):
            writer.write(part)
    return Table(path, opened.path if opened.external_table is not None else None, home)


class ArrowStream(Protocol):
    """A table in memory that supports the Arrow PyCapsule interface, for example of polars, DuckDB or pyarrow."""

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """Return a PyCapsule of an `ArrowArrayStream`, as the Arrow PyCapsule interface specifies."""


Source: TypeAlias = "str | os.PathLike[str] | Table | Recording | ArrowStream | pd.DataFrame | Mapping[str, Any]"
"""Source of rows: a file, a table or a recording of this program, a DataFrame, or a dict of columns."""
SceneSource: TypeAlias = "Source | Scene"
"""A scene: a file or a recording that holds one, a `Scene`, or a table of stations."""


class CallInputs:
    """Inputs of one call, as a context manager; tables in memory are written to files that exist until the call ends.

    Errors raised inside the block name the argument in place of such a file, and arguments in place of options.
    """

    def __init__(self, arguments: Mapping[str, str] | None = None) -> None:
        """Create the object without any input.

        Args:
            arguments: names of arguments by key of the request's field or setting, where the two differ.
        """
        self._arguments = arguments or {}
        self._folder = Folder()
        self._names: dict[str, str] = {}

    def __enter__(self) -> Self:
        """Begin the call; from now on messages of this thread spell options as arguments."""
        self._spelling = SPELLING.set(self._as_argument)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Delete the temporary files; the message of an `OcclogError` is changed to name arguments instead of them."""
        self._folder.remove()
        if isinstance(error, OcclogError):
            error.args = (self.named(str(error)),)
        SPELLING.reset(self._spelling)

    def rows(self, value: Source, name: str) -> Path:
        """Return the path of a file with the rows of an argument; rows in memory are written to a temporary file.

        Args:
            value: path, table, recording, or rows in memory.
            name: name of the argument.

        Raises:
            InputError: the value holds no rows, or its columns do not fit each other.
        """
        if isinstance(value, str | os.PathLike):
            return Path(value)
        if isinstance(value, Table | Recording):
            return value.source
        path = self._folder.file(f"{name}.arrow")
        write_arrow(arrow_of(value, name), path)
        return self.called(path, name)

    def called(self, path: Path, name: str) -> Path:
        """Register the name of an argument by which messages call a file, and return the file's path."""
        self._names[str(path)] = name
        return path

    def optional(self, value: Source | None, name: str) -> Path | None:
        """Return the path of a file with the rows of an argument; None for None.

        Rows in memory are written to a temporary file. `name` names the argument in messages and that file.
        """
        return None if value is None else self.rows(value, name)

    def scene(self, value: SceneSource | None) -> Path | None:
        """Return the path of a file with a scene; None for None.

        A `Scene` and a table of stations in memory are written to a temporary file.
        """
        if value is None or isinstance(value, str | os.PathLike):
            return None if value is None else Path(value)
        if isinstance(value, Table | Recording):
            return value.source
        if isinstance(value, Scene):
            from occlog.io.formats.scenes.scene import scene_to_yaml

            path = self._folder.file("scene.yaml")
            path.write_text(scene_to_yaml(value), encoding="utf-8")
        else:
            import pyarrow.csv

            path = self._folder.file("stations.csv")
            pyarrow.csv.write_csv(arrow_of(value, "scene"), path)
        return self.called(path, "scene")

    def named(self, text: str) -> str:
        """Return a message with the paths of temporary files replaced by the names of arguments."""
        for path, name in self._names.items():
            text = text.replace(path, name)
        return text

    def _as_argument(self, name: str) -> str:
        """Return the key of a request's field or setting as spelled in Python: the argument's name, or `setting=`."""
        free = name.removeprefix("set.")
        return self._arguments.get(name, name) if free == name else f"{free}="


@contextmanager
def in_memory(name: str) -> Iterator[None]:
    """Context manager that converts errors of pyarrow with a value in memory to InputError.

    `name`: argument that the message names.
    """
    import pyarrow as pa

    try:
        yield
    except (pa.ArrowException, TypeError, ValueError, KeyError) as error:
        raise InputError(
            f"{name}: this value makes no table ({' '.join(str(error).split())[:160]}); give a DataFrame, a pyarrow "
            "table, or columns of equal length and one type each",
            id="wrong-content",
        ) from error


def arrow_of(value: object, name: str) -> Any:
    """Return a value in memory as a `pyarrow.Table`.

    A named index of a pandas DataFrame becomes a column, an unnamed one is dropped.

    Args:
        value: DataFrame of pandas, object with `__arrow_c_stream__`, or dict of columns.
        name: name of the argument, for messages.

    Raises:
        InputError: the value is none of these, or its columns do not fit each other.
    """
    import pyarrow as pa

    with in_memory(name):
        if type(value).__module__.partition(".")[0] == "pandas" and type(value).__name__ == "DataFrame":
            frame: Any = value
            named = [level for level in frame.index.names if level is not None and level not in frame.columns]
            if named:
                frame = frame.reset_index(level=named)
            return pa.Table.from_pandas(frame.rename(columns=str), preserve_index=False)
        if isinstance(value, pa.Table):
            return value
        if isinstance(value, Mapping):
            return pa.table({str(column): cells for column, cells in value.items()})
        if getattr(type(value), "__arrow_c_stream__", None) is not None:
            return pa.table(value)
    raise InputError(
        f"{name}: is of type {type(value).__name__}; give a file, a table of occlog, a DataFrame (pandas, polars), "
        "a pyarrow table, or a dict of columns",
        id="wrong-content",
    )


def path_of(value: object, name: str) -> Path:
    """Return the path that an argument states; InputError, with the argument's `name`, if it is no path."""
    if isinstance(value, str | os.PathLike) and isinstance(path := os.fspath(value), str):
        return Path(path)
    raise InputError(f"{name}: is of type {type(value).__name__}; give the path of a file", id="wrong-content")


def write_arrow(table: Any, path: Path) -> None:
    """Write a `pyarrow.Table` to an Arrow file without metadata, so that it is read as a table of another program."""
    import pyarrow as pa

    bare = table.replace_schema_metadata(None)
    with pa.OSFile(str(path), "wb") as file, pa.ipc.new_file(file, bare.schema) as writer:
        writer.write_table(bare)
