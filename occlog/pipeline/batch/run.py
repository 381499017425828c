"""`occlog batch`: run every recording on an executor, and collect results in tables.

Tables: outcome of each recording, its figures, and its rows in joined tables.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click

from occlog import console
from occlog.console.notes import begin_work, note_files
from occlog.console.summary import plausible_in_words
from occlog.console.text import counted, shortened
from occlog.errors import ExitCode, InputError, UsageError, did_you_mean, option
from occlog.io.dataset import join_tables, write_metrics, write_runs
from occlog.io.files.atomic import write_bytes
from occlog.io.files.inputs import hash_inputs
from occlog.io.files.provenance import Provenance
from occlog.io.files.texts.documents import read_json
from occlog.io.remote import Cache, is_url, kind_of, public_url
from occlog.pipeline.csv_text import to_csv
from occlog.pipeline.executors.chosen import executor_of
from occlog.pipeline.executors.interface import Lost
from occlog.pipeline.executors.options import JOBS_FOLDER
from occlog.pipeline.progress import shown_progress
from occlog.pipeline.run.run import METRICS_FILES, worst
from occlog.pipeline.run.stages import OVERLAY, Config, check_settings, plan, read_config
from occlog.records.losses import Loss
from occlog.records.tables import TABLES
from occlog.records.verdicts import Check, finding, outcome, summary_of

from .plan import BatchRecording, in_line, in_text, sources_of
from .recording import FAILED, RUNS, RecordingOutcome, Task, batch_folder, fetch_files, process

RUNS_TABLE, METRICS_TABLE = "runs.parquet", "metrics.parquet"
VERDICTS = "recording verdicts"
"""Name of the check of a batch."""
MAX_LOSSES = 20
"""Losses of a recording that the provenance of each table has; the table of runs has all."""
WHOLE = "the whole recording"
"""Position of the loss of a recording that failed."""


@dataclass(frozen=True)
class DatasetTables:
    """Tables over all recordings of a batch that were written.

    Attributes:
        rows: number of rows of each table, by name.
        losses: tables that could not be made, and why.
    """

    rows: Mapping[str, int]
    losses: tuple[Loss, ...]


def gather(
    folder: Path, runs: Path, outcomes: Sequence[RecordingOutcome], tables: Sequence[str], config: Config
) -> DatasetTables:
    """Write the tables over all recordings: outcomes, metrics, and joined tables. Older files are replaced.

    Args:
        folder: folder of the batch.
        runs: folder of the run folders.
        outcomes: outcomes of all recordings, in the order of rows.
        tables: names of the tables to join, e.g. `tracks`.
        config: the configuration of every run.
    """
    provenance = _provenance(outcomes, tables, config)
    rows = {
        "runs": write_runs(folder / RUNS_TABLE, (_row(each) for each in outcomes), provenance),
        "metrics": write_metrics(folder / METRICS_TABLE, _figures(runs, outcomes), provenance),
    }
    losses = []
    for name in tables:
        file = f"{name}.parquet"
        parts = {each.name: runs / each.name / file for each in outcomes if file in each.outputs}
        try:
            if parts:
                rows[name] = join_tables(folder / file, parts, name, provenance)
        except InputError as error:
            losses.append(Loss(file, "all recordings", f"is not made: {error}"))
    return DatasetTables(rows, tuple(losses))


def losses_of(outcomes: Sequence[RecordingOutcome]) -> tuple[Loss, ...]:
    """Return the data losses of all recordings; a failed recording is lost as a whole.

    Of many losses of a recording only the first ones and the number of the others are listed (the table of runs has
    all), since file metadata cannot hold millions.
    """
    found = []
    for each in outcomes:
        shown, more = each.losses[:MAX_LOSSES], each.losses[MAX_LOSSES:]
        found += [Loss(f"{each.name}: {loss.source}", loss.place, loss.what, loss.count) for loss in shown]
        if more:
            counts = [loss.count for loss in more]
            what = f"{len(more)} more losses; {RUNS_TABLE} lists them"
            found.append(Loss(each.name, "other positions", what, sum(counts) if all(counts) else 0))
        if each.state == FAILED:
            found.append(Loss(each.name, WHOLE, f"{each.stage} failed: {each.message}"))
    return tuple(found)


def _provenance(outcomes: Sequence[RecordingOutcome], tables: Sequence[str], config: Config) -> Provenance:
    seed = config.values.get("seed")
    recordings = tuple((each.shown, each.sha256) for each in outcomes)
    made = Provenance(
        "batch",
        {"config": config.values, "tables": list(tables)},
        seed if isinstance(seed, int) else None,
        (*hash_inputs([config.path]), *recordings),
        losses_of(outcomes),
        verdicts=(),
    )
    return made.with_checks(_checks(outcomes))


def _checks(outcomes: Sequence[RecordingOutcome]) -> tuple[Check, ...]:
    """Return the verdicts of all recordings as one check of the batch, which warns of each implausible one."""
    judged = [each for each in outcomes if each.plausible is not None]
    doubted = (
        finding(
            VERDICTS,
            "recording-not-plausible",
            recording=each.name,
            warning=": ".join(each.warnings[0].split(": ")[:2]),
            warnings=len(each.warnings),
        )
        for each in judged
        if not each.plausible
    )
    return outcome(VERDICTS, doubted, unless="" if judged else "no recording was judged", recordings=len(judged))


def _row(each: RecordingOutcome) -> dict[str, object]:
    return {
        "recording": each.name,
        "source": each.shown,
        "sha256": each.sha256,
        "state": each.state,
        "exit_code": each.code,
        "stage": each.stage,
        "message": each.message,
        "plausible": each.plausible,
        "warnings": list(each.warnings),
        "losses": [loss.as_dict() for loss in each.losses],
    }


def _figures(runs: Path, outcomes: Sequence[RecordingOutcome]) -> Iterator[dict[str, object]]:
    """Generate a row (recording, file, name, value) for each metric of each recording; the value may be None.

    `runs`: folder of the run folders.
    """
    for each in outcomes:
        for file in METRICS_FILES:
            if file not in each.outputs:
                continue
            for name, value in sorted(read_json(runs / each.name / file).items()):
                if value is None or (isinstance(value, int | float) and not isinstance(value, bool)):
                    number = None if value is None else float(value)
                    yield {"recording": each.name, "file": file, "name": name, "value": number}


TIMINGS = "timings.csv"
"""Files that differ from run to run; the other files have the same bytes each time."""
MAX_REPORTED = 20
"""Maximum number of failed recordings named in the summary; the table has all."""


@dataclass(frozen=True)
class BatchRequest:
    """Request of a batch.

    Attributes:
        config: file of the configuration.
        recordings: files, patterns and URLs.
        output: folder of the batch, or its URL.
        tables: names of tables that are joined over all recordings.
        workers: number of local processes.
        scheduler: address or name of the cluster to use instead; None: local processes.
        jobs: settings of jobs, for schedulers that run jobs.
        force: run every stage, also if up to date.
        cache: keeps files fetched from URLs.
    """

    config: Path
    recordings: tuple[str, ...]
    output: str
    tables: tuple[str, ...]
    workers: int
    scheduler: str | None
    jobs: Mapping[str, str]
    force: bool
    cache: Cache


def run_batch(request: BatchRequest, *, strict: bool, quiet: bool, as_json: bool) -> int:
    """Run the stages of every recording that are not up to date, and write the tables; return the exit code.

    Args:
        request: options.
        strict: exit code 6 if the tracks of a recording are not plausible.
        quiet: no progress and no notes.
        as_json: print the summary as JSON.
    """
    for name in request.tables:
        if name not in TABLES:
            raise UsageError(f"{option('tables')}: no table {name!r}; {did_you_mean(name, TABLES)}", id="unknown-name")
    config = read_config(request.config, ())
    sources = sources_of(request.recordings, request.output)
    _check_config(config)
    _check_places(request, sources)
    files = [request.config, *(Path(source.location) for source in sources if not is_url(source.location))]
    note_files(files, [] if is_url(request.output) else [Path(request.output)])
    begin_work()
    results = (RUNS_TABLE, METRICS_TABLE, *(f"{table}.parquet" for table in request.tables), TIMINGS)
    with batch_folder(request.output, results, request.cache) as folder:
        location = request.output if is_url(request.output) else str(folder)
        outcomes = _outcomes(request, config, sources, location, quiet)
        if is_url(location):
            _fetch_collected(location, folder / RUNS, outcomes, results)
        collected = gather(folder, folder / RUNS, outcomes, request.tables, config)
        times = [{"recording": o.name, "seconds": o.seconds, "cpu_seconds": o.cpu_seconds} for o in outcomes]
        write_bytes(folder / TIMINGS, to_csv(times), overwrite=True)
    _tell(outcomes, sources, quiet)
    for name in request.tables:
        if name not in collected.rows and not collected.losses:
            console.note(f"warning: no run has made {name}, so that there is no table of all", quiet)
    for loss in collected.losses:
        console.note(f"lost: {loss}")
    console.echo_summary(_summary(public_url(location), outcomes, collected.rows), as_json)
    plausible = all(each.plausible is not False for each in outcomes)
    return console.strict_code(_code(outcomes, bool(collected.losses)), plausible, strict)


def _check_config(config: Config) -> None:
    """Check keys and settings of the configuration before any recording is opened; UsageError for invalid ones."""
    # What a recording holds is not known yet; the video that is drawn on depends on it
    values = {key: value for key, value in config.values.items() if key != OVERLAY}
    unknown = replace(config, values={**values, "recording": "recording.mcap"})
    for stage in plan(unknown, Path.cwd() / RUNS):
        check_settings(unknown, stage)


def _check_places(request: BatchRequest, sources: Sequence[BatchRecording]) -> None:
    """Raise UsageError for URLs in the memory of this process, if other processes are to work on them."""
    here = [
        p for p in (request.output, *(source.location for source in sources)) if is_url(p) and kind_of(p) == "memory"
    ]
    if here and (request.workers > 1 or request.scheduler is not None):
        raise UsageError(
            f"{here[0]}: is in the memory of this process; give {option('workers')} 1", id="not-applicable"
        )


def _outcomes(
    request: BatchRequest, config: Config, sources: Sequence[BatchRecording], folder: str, quiet: bool
) -> list[RecordingOutcome]:
    """Run all recordings on an executor, and return their outcomes in the order of `sources`.

    Args:
        request: workers, scheduler, whether to redo runs.
        config: configuration of the runs.
        sources: recordings; those with a fault are not run.
        folder: path or URL of the batch.
        quiet: show no progress.
    """
    # A worker of another machine may have another working folder
    config = replace(config, path=config.path.absolute())
    tasks = {
        s.name: Task(s.name, s.shown, s.location, config, f"{folder}/{RUNS}/{s.name}", request.force, request.cache)
        for s in sources
        if not s.fault
    }
    locations = [folder, *(source.location for source in sources)]
    isolated = not any(is_url(location) and kind_of(location) == "memory" for location in locations)
    jobs = None if is_url(folder) else Path(folder) / JOBS_FOLDER
    workers = max(1, min(request.workers, len(tasks)))
    executor = executor_of(workers, request.scheduler, request.jobs, jobs, isolated=isolated)
    done = {s.name: _refused(s) for s in sources if s.fault}
    with shown_progress("batch", "recording", len(tasks), quiet) as progress:
        for name, found in executor.outcomes(tasks, process) if tasks else ():
            if isinstance(found, Lost):
                task = tasks[name]
                found = RecordingOutcome(
                    name, task.shown, code=ExitCode.BUG, stage="worker", message=found.reason, redone=True
                )
            done[name] = found
            if progress is not None:
                progress(1)
    return [done[source.name] for source in sources]


def _refused(source: BatchRecording) -> RecordingOutcome:
    """Return the outcome of a recording that is not run, because of its fault."""
    message = in_line(f"{source.shown}: {source.fault}")
    return RecordingOutcome(
        source.name, source.shown, code=ExitCode.BAD_INPUT, stage="recording", message=message, redone=True
    )


def _fetch_collected(location: str, runs: Path, outcomes: Sequence[RecordingOutcome], results: Sequence[str]) -> None:
    """Download the files of all runs that are needed for the tables over all recordings.

    Args:
        location: URL of the batch.
        runs: local folder, with a subfolder for each run.
        outcomes: outcomes of the recordings.
        results: names of the tables over all recordings.
    """
    for each in outcomes:
        wanted = [name for name in each.outputs if name in METRICS_FILES or name in results]
        fetch_files(f"{location}/{RUNS}/{each.name}", wanted, runs / each.name)


def _code(outcomes: Sequence[RecordingOutcome], lost: bool) -> int:
    """Return the exit code of a batch: 3 if recordings failed or data was lost; that of the first if all failed.

    `lost`: whether a table over all recordings could not be made.
    """
    if all(each.state == FAILED for each in outcomes):
        return outcomes[0].code
    codes = [ExitCode.LOSSY if each.state == FAILED else ExitCode(each.code) for each in outcomes]
    return worst([*codes, ExitCode.LOSSY] if lost else codes)


def _from_here(source: BatchRecording) -> str:
    """Return the name of a recording as an argument of a command: relative to the current folder, or the URL."""
    if is_url(source.location):
        return source.shown
    path, here = Path(source.location), Path.cwd()
    return in_text(str(path.relative_to(here) if path.is_relative_to(here) else path))


def _tell(outcomes: Sequence[RecordingOutcome], sources: Sequence[BatchRecording], quiet: bool) -> None:
    """Write failed, lossy and implausible recordings to standard error, a line each.

    Args:
        outcomes: outcomes of all recordings.
        sources: the recordings, in the same order.
        quiet: no warnings about implausible ones.
    """
    failed = [(each, source) for each, source in zip(outcomes, sources, strict=True) if each.state == FAILED]
    for each, source in failed[:MAX_REPORTED]:
        message = each.message.replace(in_line(each.shown), _from_here(source))
        line = " ".join(f"occlog: failed: {each.name}: {each.stage}: {message}".split())
        click.echo(shortened(line), err=True)
    if len(failed) > MAX_REPORTED:
        click.echo(f"occlog: {len(failed) - MAX_REPORTED} more have failed; {RUNS_TABLE} names them", err=True)
    lossy = [each for each in outcomes if each.losses]
    if lossy:
        click.echo(
            f"occlog: lost: input of {counted(len(lossy), 'recording')}; {RUNS_TABLE} lists it (losses)", err=True
        )
    doubted = [each for each in outcomes if each.plausible is False]
    for each in doubted[:MAX_REPORTED]:
        console.note(f"warning: {each.name}: plausible: {plausible_in_words(summary_of(each.verdicts))}", quiet)
    if len(doubted) > MAX_REPORTED:
        console.note(f"warning: {len(doubted) - MAX_REPORTED} more are not plausible; {RUNS_TABLE} names them", quiet)


def _summary(folder: str, outcomes: Sequence[RecordingOutcome], rows: object) -> dict[str, object]:
    states = Counter(each.state for each in outcomes)
    return {
        "recordings": len(outcomes),
        **{state: states[state] for state in ("done", "lossy", "threshold", FAILED)},
        "up_to_date": sum(not each.redone for each in outcomes),
        "not_plausible": sum(each.plausible is False for each in outcomes),
        "rows": rows,
        "folder": folder,
    }
