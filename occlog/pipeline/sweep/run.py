"""Work of `occlog sweep`: plans the trials, runs them, and writes the tables."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import msgspec
from tqdm import tqdm

from occlog import __version__
from occlog.cli import options
from occlog.errors import ExitCode, OutputError, OutputExistsError, UsageError
from occlog.io.files.atomic import write_bytes
from occlog.io.files.json_file import read_json, write_json
from occlog.io.files.provenance import hash_inputs

from .engine import run_all
from .plan import read_sweep, settings_of
from .table import summary_rows, to_csv, to_text, trial_rows

STORE = "trials.jsonl"
MADE = "sweep.json"
RESULTS = ("trials.csv", "summary.csv")


def run_sweep(
    path: Path,
    folder: Path,
    *,
    workers: int,
    scheduler: str | None,
    figures: tuple[str, ...],
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    """Run all trials and write the tables; return the exit code.

    Args:
        path: sweep file.
        folder: of the results.
        workers: number of processes on this machine.
        scheduler: address of a Dask scheduler; its workers are used instead.
        figures: columns of the printed table.
        overwrite: true: replace another sweep in the folder.
        quiet: true: no progress bar.
        as_json: true: print JSON.
    """
    spec = read_sweep(path)
    settings = settings_of(spec, path.parent)
    trials = [trial for setting in settings for trial in setting.trials]
    made = {
        "program": "occlog",
        "version": __version__,
        "sweep": msgspec.to_builtins(spec),
        "inputs": [list(i) for i in hash_inputs([path, path.parent / spec.scene])],
    }
    _prepare(folder, made, overwrite)
    with _progress(len(trials), quiet) as progress:
        results = run_all(trials, workers, scheduler, folder / STORE, progress)
    unknown = [name for name in figures if name not in results[0]]
    rows = summary_rows(settings, results)
    write_bytes(folder / "trials.csv", to_csv(trial_rows(settings, results)), overwrite=True)
    write_bytes(folder / "summary.csv", to_csv(rows), overwrite=True)
    if unknown:
        raise UsageError(f"--figures: no figure {unknown[0]!r}; there are: {', '.join(results[0])}")
    if as_json:
        options.echo_summary({"sweep": str(folder), "trials": len(trials), "settings": rows}, as_json=True)
    else:
        click.echo(to_text(rows, figures))
        click.echo(f"\n{len(trials)} trials; {folder / 'trials.csv'}, {folder / 'summary.csv'}")
    return ExitCode.DONE


def _prepare(folder: Path, made: dict[str, Any], overwrite: bool) -> None:
    """Make the folder; refuse one that holds another sweep, unless it may be replaced."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made: {error.strerror}") from error
    marker = folder / MADE
    if marker.exists() and msgspec.json.decode(msgspec.json.encode(read_json(marker))) == msgspec.to_builtins(made):
        return
    if any((folder / name).exists() for name in (MADE, STORE, *RESULTS)) and not overwrite:
        raise OutputExistsError(f"{folder}: holds another sweep; give another folder")
    for name in (STORE, *RESULTS):
        (folder / name).unlink(missing_ok=True)
    write_json(marker, made, overwrite=True)


@contextmanager
def _progress(total: int, quiet: bool) -> Iterator[Callable[[int], None] | None]:
    """Show a progress bar on a terminal; yield what advances it, None elsewhere."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    with tqdm(total=total, desc="sweep", unit="trial", file=sys.stderr, leave=False) as bar:

        def advance(done: int) -> None:
            bar.update(done)

        yield advance
