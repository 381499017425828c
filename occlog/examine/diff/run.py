"""`occlog diff`: reads and compares two outputs: tables, recordings, JSON, other files, folders.

Readers are imported when needed.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable
from pathlib import Path

from occlog.errors import InputError, UsageError
from occlog.io.files.limits import Content, content_of

from .content import compare_contents, content, diff_bytes, diff_json
from .result import DiffResult, DiffSettings, RowDifference

STAGES = (
    "scene",
    "truth",
    "recording",
    "views",
    "bearings",
    "occluders",
    "tracks",
    "diagnostics",
    "errors",
    "bound",
    "metrics",
    "report",
)
"""Names of outputs, those of earlier stages first: the first output that differs is nearest to the cause."""
RUN_STATE = "run.json"
"""State of `occlog run`: hashes of everything, so it counts as provenance."""
NAMED = {".mcap": Content.RECORDING, ".parquet": Content.TABLE}
"""Default kind of a file without a signature; its reader describes the fault."""
OTHERS = (".csv", ".tsv", ".gz", ".txt", ".arrow", ".feather", ".tum", ".trc", ".geojson")
"""Endings of names of tables that other programs make; those of Parquet are known by their content."""


def compare_paths(a: Path, b: Path, settings: DiffSettings) -> list[DiffResult]:
    """Compare two files or folders; parts made by earlier stages come first.

    Raises:
        UsageError: a file and a folder, or files of different kinds.
        InputError: a file is missing or damaged.
    """
    for path in (a, b):
        if not path.exists():
            raise InputError(f"{path}: no such file or folder", id="file-not-found")
    if a.is_dir() != b.is_dir():
        folder, file = (a, b) if a.is_dir() else (b, a)
        raise UsageError(f"{folder} is a folder and {file} is a file; give two of one kind", id="incompatible-inputs")
    if a.is_dir() and b.is_dir():
        return _compare_folders(a, b, settings)
    kinds = kind_of(a), kind_of(b)
    found = _as_tables(a, b, a.name, settings, *kinds, alone=True)
    if found is not None:
        return found
    if kinds[0] != kinds[1]:
        raise UsageError(
            f"{a.name} and {b.name} are of different kinds; give two tables, two recordings, "
            "or two other files with the same ending",
            id="incompatible-inputs",
        )
    return compare_files(a, b, a.name, settings)


def kind_of(path: Path) -> Content | str:
    """Return the kind of a file by its first bytes, or its ending if these are no known signature (text and others)."""
    content = content_of(path) if path.stat().st_size else Content.OTHER
    suffix = path.suffix.lower()
    return NAMED.get(suffix, suffix) if content is Content.OTHER else content


def stage_order(names: Iterable[str]) -> list[str]:
    """Sort file names by the stage that writes them, then by name."""

    def order_key(name: str) -> tuple[int, str]:
        stem = name.rsplit("/", maxsplit=1)[-1].split(".")[0].lower()
        found = [n for n, stage in enumerate(STAGES) if stage in stem]
        return (min(found) if found else len(STAGES), name)

    return sorted(names, key=order_key)


def _compare_folders(a: Path, b: Path, settings: DiffSettings) -> list[DiffResult]:
    files_a, files_b = _files(a, settings), _files(b, settings)
    out: list[DiffResult] = []
    for name in stage_order(files_a | files_b):
        if name in files_a and name in files_b:
            out += compare_files(a / name, b / name, name, settings)
            continue
        kind = "missing" if name in files_a else "added"
        out.append(DiffResult(name, "files", first=RowDifference(kind, name)))
    return out


def _files(folder: Path, settings: DiffSettings) -> set[str]:
    """Return the relative names of a folder's files, at any depth, without hidden and excluded ones."""
    found = (p.relative_to(folder) for p in folder.rglob("*") if p.is_file())
    names = {str(p.as_posix()) for p in found if not any(part.startswith(".") for part in p.parts)}
    skipped = settings.exclude if settings.provenance else (*settings.exclude, RUN_STATE)
    return {
        name
        for name in names
        if not any(fnmatch.fnmatch(name, glob) or fnmatch.fnmatch(Path(name).name, glob) for glob in skipped)
    }


def compare_files(a: Path, b: Path, name: str, settings: DiffSettings) -> list[DiffResult]:
    """Compare two files by their kind; those of different kinds byte by byte.

    `name`: name of the files in the results, of which recordings have several.
    """
    kind, other = kind_of(a), kind_of(b)
    found = _as_tables(a, b, name, settings, kind, other)
    if found is not None:
        return found
    if kind != other:
        return [diff_bytes(name, content(a, settings), content(b, settings))]
    if kind is Content.RECORDING:
        from .recordings import compare_recordings

        return compare_recordings(a, b, name, settings)
    if kind == ".json":
        from occlog.io.files.texts.documents import read_json

        return [diff_json(name, read_json(a), read_json(b), settings.tolerances, settings.provenance)]
    return [compare_contents(a, b, name, settings)]


def _as_tables(
    a: Path, b: Path, name: str, settings: DiffSettings, *kinds: Content | str, alone: bool = False
) -> list[DiffResult] | None:
    """Compare two files as tables; None if they are no tables.

    Args:
        a: first file.
        b: second file.
        name: name of the files in the results.
        settings: tolerances, provenance.
        kinds: kind of each file (see `kind_of`).
        alone: whether these two files are all that is compared, so that tolerances of columns they lack are an error.
    """
    if not all(kind is Content.TABLE or kind in OTHERS for kind in kinds):
        return None
    from .tables import compare_tables

    return compare_tables(a, b, name, settings, alone=alone)
