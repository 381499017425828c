"""Tables of occlog in Python: columns with units, and conversions to pandas, polars and pyarrow."""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from occlog.console.text import counted, noun
from occlog.errors import InputError, UsageError, abridged
from occlog.io.files.atomic import check_writable, write_bytes
from occlog.io.files.tables.parquet import arrow_batches, describe, open_parquet
from occlog.records.losses import Loss

from .folders import Folder

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    import pyarrow as pa
    from numpy.typing import NDArray

NOTEBOOK_ROWS = 8
"""Rows that a notebook shows."""


class Table:
    """Rows of one kind, for example tracks or bearings.

    A table is a Parquet file on disk; a temporary file is removed with the last reference to the table. Rows are read
    when they are used. Columns, units and meanings are in docs/reference/tables.md. Every function of occlog accepts a
    table in place of a file.

    DataFrames are copies: changes in them do not change the table; give the DataFrame to the next function instead. It
    is then a table of another program, without provenance, losses and the unit of lengths.
    """

    def __init__(self, path: Path, source: Path | None = None, home: Folder | None = None) -> None:
        """Create the object for a file; users call `occlog.open` or `occlog.read` instead.

        Args:
            path: Parquet file written by occlog.
            source: file that functions read instead, the original table of another program; None: `path`.
            home: temporary folder that contains the file, removed with the last table in it; None: not temporary.
        """
        self.path, self.source = path, path if source is None else source
        self._home = home

    @cached_property
    def _described(self) -> Any:
        return describe(self.path)

    @property
    def name(self) -> str:
        """Name of the kind of table, for example `tracks`."""
        return str(self._described["schema"])

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns in their order."""
        return tuple(c["name"] for c in self._described["columns"])

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of each column, by name; empty: a pure number or a text."""
        return {c["name"]: c.get("unit", "") for c in self._described["columns"]}

    @property
    def length_unit(self) -> str:
        """Unit of lengths: m, cm, mm, ft, in, or one specific to the scene."""
        return str(self._described["length_unit"])

    @property
    def provenance(self) -> Mapping[str, Any]:
        """Provenance: command, parameters, seed, version, names and SHA-256 of the inputs."""
        found: dict[str, Any] = self._described["provenance"]
        return found

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Input that was lost when the table was made."""
        return tuple(Loss(**loss) for loss in self.provenance.get("losses", ()))

    def __len__(self) -> int:
        """Return the number of rows."""
        return int(self._described["rows"])

    def __getitem__(self, column: str) -> NDArray[Any]:
        """Return the values (n,) of a column: times in ns since the Unix epoch, unknown values as NaN.

        Raises:
            InputError: the table has no such column.
        """
        if column not in self.columns:
            raise InputError(
                f"{self.name} has no column {column!r}; it has {abridged(self.columns)}", id="missing-column"
            )
        values = self._read([column]).column(column)
        return np.asarray(values.to_numpy(zero_copy_only=False) if values.num_chunks else [])

    def to_arrow(self, *, datetimes: bool = False) -> pa.Table:
        """Return the rows as a `pyarrow.Table`, the fields of which carry unit and meaning.

        Args:
            datetimes: convert `t_ns` from integers to time stamps (UTC, ns).
        """
        return self._read(None, datetimes)

    def to_pandas(self, *, datetimes: bool = False) -> pd.DataFrame:
        """Return the rows as a `pandas.DataFrame`.

        Args:
            datetimes: convert `t_ns` from integers to time stamps (UTC, ns).
        """
        frame: pd.DataFrame = self._read(None, datetimes).to_pandas()
        return frame

    def to_polars(self, *, datetimes: bool = False) -> pl.DataFrame:
        """Return the rows as a `polars.DataFrame`.

        Args:
            datetimes: convert `t_ns` from integers to time stamps (UTC, ns).

        Raises:
            UsageError: polars is not installed.
        """
        try:
            import polars
        except ImportError:
            raise UsageError(
                "polars is not installed; install it (`pip install polars`), or use to_pandas", id="missing-package"
            ) from None
        frame = polars.from_arrow(self._read(None, datetimes))
        assert isinstance(frame, polars.DataFrame)  # from_arrow makes a Series of an array only
        return frame

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """Return the rows as a PyCapsule of an Arrow C stream, so that polars, DuckDB and others can take the table."""
        return self._read(None).__arrow_c_stream__(requested_schema)

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the table to a file in the format of the name's ending; Parquet is a copy of the table's own file.

        Args:
            path: path of the file: `.parquet`, or an ending of `occlog export` (`.csv`, `.csv.gz`, `.tum`, `.trc`).
            overwrite: replace a file that exists.

        Raises:
            OutputExistsError: the file exists and may not be replaced.
            OutputError: the file cannot be written.
            UsageError: the ending belongs to no known format.
        """
        wanted = Path(path)
        if wanted.suffix.lower() in (".parquet", ""):
            check_writable(wanted, overwrite)
            write_bytes(wanted, self.path.read_bytes(), overwrite)
            return
        from occlog.examine.export.run import ExportRequest, run_export

        request = ExportRequest(
            input=self.path,
            output=wanted,
            to=None,
            table=self.name,
            targets=(),
            camera=None,
            origin=None,
            scene=None,
            overwrite=overwrite,
            quiet=True,
        )
        run_export(request)

    def _read(self, columns: list[str] | None, datetimes: bool = False) -> Any:
        """Return the rows as a pyarrow table; dictionary-encoded texts are converted to plain ones.

        Args:
            columns: names of the columns to read; None: all.
            datetimes: convert `t_ns` from integers to time stamps (UTC, ns).
        """
        import pyarrow as pa

        with open_parquet(self.path) as file:
            found = file.read(columns)
        for n, field in enumerate(found.schema):
            kind = field.type
            if pa.types.is_dictionary(kind):
                kind = kind.value_type
            elif datetimes and field.name == "t_ns":
                kind = pa.timestamp("ns", tz="UTC")
            if kind != field.type:
                found = found.set_column(n, field.with_type(kind), found.column(n).cast(kind))
        return found

    def __repr__(self) -> str:
        lengths = f", lengths in {self.length_unit}" if any("m" in unit for unit in self.units.values()) else ""
        return (
            f"<occlog table {self.name}: {counted(len(self), 'row')}, {counted(len(self.columns), 'column')}{lengths}>"
        )

    def _repr_html_(self) -> str:
        """Return an HTML table of the first `NOTEBOOK_ROWS` rows with the columns' units, which notebooks show."""
        first = next(arrow_batches(self.path, NOTEBOOK_ROWS), None)
        rows = [] if first is None else first.to_pylist()
        units = self.units
        head = "".join(f"<th>{escape(c)}<br><small>{escape(units[c])}</small></th>" for c in self.columns)
        body = "".join(
            "<tr>" + "".join(f"<td>{escape(in_words(row[c]))}</td>" for c in self.columns) + "</tr>" for row in rows
        )
        rest = (
            f"<p>{len(self) - len(rows)} more {noun(len(self) - len(rows), 'row')}</p>" if len(self) > len(rows) else ""
        )
        words = f"{self.name}: {counted(len(self), 'row')}"
        return f"<table><caption>{escape(words)}</caption><tr>{head}</tr>{body}</table>{rest}"


def in_words(value: object) -> str:
    """Return a value as the text of a cell: numbers with four significant digits; empty for None and NaN.

    Long sequences are cut after `NOTEBOOK_ROWS` items.
    """
    if value is None or (isinstance(value, float) and np.isnan(value)):
        return ""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {in_words(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(in_words(v) for v in value[:NOTEBOOK_ROWS]) + (", ..." if len(value) > NOTEBOOK_ROWS else "")
    return str(value)
