"""Values that a function takes in the place of files: tables in memory become files for the length of a call."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol, Self, TypeAlias

from occlog.errors import SPELLING, InputError, OcclogError
from occlog.records.scene import Scene

from .folders import Folder

if TYPE_CHECKING:
    import pandas as pd

    from .recordings import Recording
    from .tables import Table


class ArrowStream(Protocol):
    """A table in memory that speaks the Arrow PyCapsule interface: of polars, DuckDB, pyarrow and others."""

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """A capsule of an Arrow C stream."""


Source: TypeAlias = "str | os.PathLike[str] | Table | Recording | ArrowStream | pd.DataFrame | Mapping[str, Any]"
"""Where rows come from: a file, a table or a recording of this program, a DataFrame, or a dict of columns."""
SceneSource: TypeAlias = "Source | Scene"
"""A scene: a file or a recording that holds one, a `Scene`, or a table of stations."""


class Inputs:
    """The inputs of one call; tables in memory are files until it ends.

    Errors inside the block name the argument in the place of such a file, and arguments in the place of options.
    """

    def __init__(self, arguments: Mapping[str, str] | None = None) -> None:
        """No input yet.

        Args:
            arguments: names of arguments by those of what a request takes, where they differ.
        """
        self._arguments = arguments or {}
        self._folder = Folder()
        self._names: dict[str, str] = {}

    def __enter__(self) -> Self:
        """Begin the call; messages spell options as arguments."""
        self._spelling = SPELLING.set(self._as_argument)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Remove the files; an error speaks of arguments."""
        self._folder.remove()
        if isinstance(error, OcclogError):
            error.args = (self.named(str(error)),)
        SPELLING.reset(self._spelling)

    def rows(self, value: Source, name: str) -> Path:
        """The file with the rows that an argument gives.

        Args:
            value: what was given.
            name: of the argument.

        Raises:
            InputError: it is nothing that holds rows, or its columns do not go together.
        """
        from .recordings import Recording
        from .tables import Table

        if isinstance(value, str | os.PathLike):
            return Path(value)
        if isinstance(value, Table | Recording):
            return value.source
        path = self._folder.file(f"{name}.arrow")
        write_arrow(arrow_of(value, name), path)
        return self.called(path, name)

    def called(self, path: Path, name: str) -> Path:
        """A file that errors call by the name of an argument."""
        self._names[str(path)] = name
        return path

    def optional(self, value: Source | None, name: str) -> Path | None:
        """The file with the rows that an argument gives; None for None."""
        return None if value is None else self.rows(value, name)

    def scene(self, value: SceneSource | None) -> Path | None:
        """The file of a scene: of a `Scene` and of a table of stations in memory a new one; None for None."""
        from .recordings import Recording
        from .tables import Table

        if value is None or isinstance(value, str | os.PathLike):
            return None if value is None else Path(value)
        if isinstance(value, Table | Recording):
            return value.source
        if isinstance(value, Scene):
            from occlog.io.scenes.scene import scene_to_yaml

            path = self._folder.file("scene.yaml")
            path.write_text(scene_to_yaml(value), encoding="utf-8")
        else:
            import pyarrow.csv

            path = self._folder.file("stations.csv")
            pyarrow.csv.write_csv(arrow_of(value, "scene"), path)
        return self.called(path, "scene")

    def named(self, text: str) -> str:
        """A sentence with arguments in the place of files."""
        for path, name in self._names.items():
            text = text.replace(path, name)
        return text

    def _as_argument(self, name: str) -> str:
        """What a request takes, or a setting, as an argument."""
        free = name.removeprefix("set.")
        return self._arguments.get(name, name) if free == name else f"{free}="


@contextmanager
def in_memory(name: str) -> Iterator[None]:
    """Turn every failure of pyarrow with a value in memory into one InputError that names the argument."""
    import pyarrow as pa

    try:
        yield
    except (pa.ArrowException, TypeError, ValueError, KeyError) as error:
        raise InputError(f"{name}: cannot be read as a table ({' '.join(str(error).split())[:160]})") from error


def arrow_of(value: object, name: str) -> Any:
    """A `pyarrow.Table` of a value in memory.

    A pandas index that has a name becomes a column, any other is dropped.

    Args:
        value: a DataFrame of pandas, anything that speaks `__arrow_c_stream__`, or a dict of columns.
        name: of the argument, for messages.

    Raises:
        InputError: it is none of these, or its columns do not go together.
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
        f"{name}: is a {type(value).__name__}; give a file, a table of occlog, a DataFrame (pandas, polars), "
        "a pyarrow table, or a dict of columns"
    )


def write_arrow(table: Any, path: Path) -> None:
    """Write a `pyarrow.Table` as an Arrow file, as tables of other programs: without the keys of this one."""
    import pyarrow as pa

    bare = table.replace_schema_metadata(None)
    with pa.OSFile(str(path), "wb") as file, pa.ipc.new_file(file, bare.schema) as writer:
        writer.write_table(bare)
