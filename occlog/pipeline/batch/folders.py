"""The folder of a batch, on this machine or at a URL: begun, filled with tables, and known again.

A run at a URL is worked on in a folder of this machine: what is there of it is fetched, and what is new is written
back, `run.json` last, so that a worker may be killed at any time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from occlog import __version__
from occlog.errors import InputError, OutputError, UsageError
from occlog.io.files.atomic import PARTIAL, no_links_out_of, translate_write_errors
from occlog.io.files.locks import alone_with
from occlog.io.files.provenance import hash_file
from occlog.io.files.texts.json_file import read_json, write_json
from occlog.io.remote.cache import Cache
from occlog.io.remote.store import check_output, fetch, names_in, put, remove
from occlog.io.remote.urls import is_url, shown
from occlog.pipeline.run.run import STATE
from occlog.records.tables import TABLES

MARK = "batch.json"
"""File that says that a folder is one of a batch."""
RUNS = "runs"
"""Folder of the run folders."""


@contextmanager
def batch_folder(output: str, results: Sequence[str], cache: Cache) -> Iterator[Path]:
    """Yield a folder on this machine for the results of a batch; those at a URL are written there at the end.

    Results of an earlier command are removed, since runs change from here on; also tables that this one does not join.

    Args:
        output: folder or URL.
        results: names of files over all recordings.
        cache: where to work for a URL.

    Raises:
        UsageError: the folder is of something else.
        OutputError: it cannot be made.
    """
    older = dict.fromkeys((*results, *(f"{table}.parquet" for table in TABLES)))
    if not is_url(output):
        folder = _prepare(Path(output))
        with alone_with(folder, "batch"):
            for name in older:
                with translate_write_errors(folder / name):
                    (folder / name).unlink(missing_ok=True)
            yield folder
        return
    check_output(output)
    names = names_in(output)
    if names and MARK not in names:
        raise UsageError(f"{shown(output)}: holds files but no {MARK}, so it is not of a batch; name a new folder")
    with cache.scratch() as folder:
        write_json(folder / MARK, _mark())
        put(folder / MARK, f"{output}/{MARK}")
        remove(f"{output}/{name}" for name in older if name in names)
        yield folder
        for name in results:
            if (folder / name).exists():
                put(folder / name, f"{output}/{name}")


def _prepare(output: Path) -> Path:
    if output.exists() and not output.is_dir():
        raise OutputError(f"{output}: is a file; name a folder for the batch")
    mark = output / MARK
    if output.is_dir() and not mark.exists() and any(not each.name.endswith(PARTIAL) for each in output.iterdir()):
        raise UsageError(f"{output}: holds files but no {MARK}, so it is not of a batch; name a new or empty folder")
    if mark.exists() and read_json(mark).get("program") != "occlog":
        raise InputError(f"{mark}: not of a batch; name a new or empty folder")
    try:
        output.mkdir(parents=True, exist_ok=True)
        with no_links_out_of(output):
            write_json(mark, _mark(), overwrite=True)
        (output / RUNS).mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"{output}: the folder of the batch cannot be made: {error.strerror or error}") from error
    return output.resolve()


def _mark() -> dict[str, object]:
    return {"program": "occlog", "version": __version__, "occlog_batch": 1}


@contextmanager
def run_folder(place: str, name: str, cache: Cache) -> Iterator[Path]:
    """Yield the folder of a run on this machine; what is new of one at a URL is written there at the end."""
    if not is_url(place):
        yield Path(place)
        return
    with cache.scratch() as folder:
        run = folder / name
        names = names_in(place)
        # Without its state nobody knows what the files of a run are
        fetch_files(place, names if STATE in names else (), run)
        before = {path.name: hash_file(path) for path in run.iterdir()}
        yield run
        files = [path for path in run.glob("*") if path.is_file()]
        # What a stage made that the configuration no longer has would pass for the run's own
        remove(f"{place}/{name}" for name in before.keys() - {path.name for path in files})
        for path in sorted(files, key=lambda path: path.name == STATE):
            if before.get(path.name) != hash_file(path):
                put(path, f"{place}/{path.name}")


def fetch_files(place: str, names: Iterable[str], folder: Path) -> None:
    """Fetch files of a run into a folder, which is made if missing."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        fetch(f"{place}/{name}", folder / name)
