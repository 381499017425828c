"""Work of `occlog batch`: runs every recording on an executor, and gathers the results in tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click

from occlog import console
from occlog.console.details import begin_work, note_files
from occlog.console.summary import plausible_in_words
from occlog.console.text import counted, told
from occlog.errors import ExitCode, UsageError, did_you_mean, option
from occlog.io.files.atomic import write_bytes
from occlog.io.remote.cache import Cache
from occlog.io.remote.urls import is_url, kind_of, shown
from occlog.pipeline.csv_text import to_csv
from occlog.pipeline.executors.chosen import executor_of
from occlog.pipeline.executors.interface import Lost
from occlog.pipeline.executors.options import JOBS_FOLDER
from occlog.pipeline.progress import shown_progress
from occlog.pipeline.run.run import worst
from occlog.pipeline.run.stages import OVERLAY, Config, check_settings, plan, read_config
from occlog.records.tables import TABLES
from occlog.records.verdicts import summary_of

from .folders import RUNS, batch_folder, fetch_files
from .plan import Source, in_line, in_text, sources_of
from .recording import FAILED, Outcome, Task, process
from .tables import METRICS_FILES, METRICS_TABLE, RUNS_TABLE, gather

TIMINGS = "timings.csv"
"""What differs from run to run; the other files have the same bytes each time."""
TOLD = 20
"""So many recordings that failed are named; the table has all."""


@dataclass(frozen=True)
class BatchRequest:
    """What the command line asks for.

    Attributes:
        config: file of the configuration.
        recordings: files and patterns.
        output: folder of the batch, or its URL.
        tables: names of tables that are joined over all recordings.
        workers: processes of this machine.
        scheduler: what does the work instead of these; None: nothing.
        jobs: settings of jobs, where the scheduler makes them.
        force: do every stage.
        cache: keeps what was fetched from URLs.
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
    """Do the stages of every recording that are not up to date, and write the tables; return the exit code.

    Args:
        request: what is asked for.
        strict: true: exit code 6 if tracks of a recording are not plausible.
        quiet: true: no progress and no notes.
        as_json: true: print the summary as JSON.
    """
    for name in request.tables:
        if name not in TABLES:
            raise UsageError(f"{option('tables')}: no table {name!r}; {did_you_mean(name, TABLES)}")
    config = read_config(request.config, ())
    sources = sources_of(request.recordings, request.output)
    _check_config(config)
    _check_places(request, sources)
    files = [request.config, *(Path(source.place) for source in sources if not is_url(source.place))]
    note_files(files, [] if is_url(request.output) else [Path(request.output)])
    begin_work()
    results = (RUNS_TABLE, METRICS_TABLE, *(f"{table}.parquet" for table in request.tables), TIMINGS)
    with batch_folder(request.output, results, request.cache) as folder:
        place = request.output if is_url(request.output) else str(folder)
        outcomes = _outcomes(request, config, sources, place, quiet)
        if is_url(place):
            _fetch_gathered(place, folder / RUNS, outcomes, results)
        gathered = gather(folder, folder / RUNS, outcomes, request.tables, config)
        times = [{"recording": o.name, "seconds": o.seconds, "cpu_seconds": o.cpu_seconds} for o in outcomes]
        write_bytes(folder / TIMINGS, to_csv(times), overwrite=True)
    _tell(outcomes, sources, quiet)
    for name in request.tables:
        if name not in gathered.rows and not gathered.losses:
            console.note(f"warning: no run has made {name}, so that there is no table of all", quiet)
    for loss in gathered.losses:
        console.note(f"lost: {loss}")
    console.echo_summary(_summary(shown(place), outcomes, gathered.rows), as_json)
    plausible = all(each.plausible is not False for each in outcomes)
    return console.strict_code(_code(outcomes, bool(gathered.losses)), plausible, strict)


def _check_config(config: Config) -> None:
    """Refuse keys and values that every run would refuse, before any recording is looked at."""
    # What a recording holds is not known yet; the video that is drawn on depends on it
    values = {key: value for key, value in config.values.items() if key != OVERLAY}
    unknown = replace(config, values={**values, "recording": "recording.mcap"})
    for stage in plan(unknown, Path.cwd() / RUNS):
        check_settings(unknown, stage)


def _check_places(request: BatchRequest, sources: Sequence[Source]) -> None:
    """Refuse places that other processes do not have."""
    here = [p for p in (request.output, *(source.place for source in sources)) if is_url(p) and kind_of(p) == "memory"]
    if here and (request.workers > 1 or request.scheduler is not None):
        raise UsageError(f"{here[0]}: lies in the memory of this process; give {option('workers')} 1")


def _outcomes(
    request: BatchRequest, config: Config, sources: Sequence[Source], folder: str, quiet: bool
) -> list[Outcome]:
    """The outcome of every recording, in their order."""
    # A worker of another machine may have another working folder
    config = replace(config, path=config.path.absolute())
    tasks = {
        s.name: Task(s.name, s.shown, s.place, config, f"{folder}/{RUNS}/{s.name}", request.force, request.cache)
        for s in sources
        if not s.fault
    }
    places = [folder, *(source.place for source in sources)]
    isolated = not any(is_url(place) and kind_of(place) == "memory" for place in places)
    jobs = None if is_url(folder) else Path(folder) / JOBS_FOLDER
    workers = max(1, min(request.workers, len(tasks)))
    executor = executor_of(workers, request.scheduler, request.jobs, jobs, isolated=isolated)
    done = {s.name: _refused(s) for s in sources if s.fault}
    with shown_progress("batch", "recording", len(tasks), quiet) as progress:
        for name, found in executor.outcomes(tasks, process) if tasks else ():
            if isinstance(found, Lost):
                task = tasks[name]
                found = Outcome(name, task.shown, code=ExitCode.BUG, stage="worker", message=found.reason, redone=True)
            done[name] = found
            if progress is not None:
                progress(1)
    return [done[source.name] for source in sources]


def _refused(source: Source) -> Outcome:
    """The outcome of a recording that is not tried."""
    message = in_line(f"{source.shown}: {source.fault}")
    return Outcome(source.name, source.shown, code=ExitCode.BAD_INPUT, stage="recording", message=message, redone=True)


def _fetch_gathered(place: str, runs: Path, outcomes: Sequence[Outcome], results: Sequence[str]) -> None:
    """Fetch what the tables over all are made of."""
    for each in outcomes:
        wanted = [name for name in each.outputs if name in METRICS_FILES or name in results]
        fetch_files(f"{place}/{RUNS}/{each.name}", wanted, runs / each.name)


def _code(outcomes: Sequence[Outcome], lost: bool) -> int:
    """The exit code: 3 where recordings failed, as where anything else was lost; that of the first if all did."""
    if all(each.state == FAILED for each in outcomes):
        return outcomes[0].code
    codes = [ExitCode.LOSSY if each.state == FAILED else ExitCode(each.code) for each in outcomes]
    return worst([*codes, ExitCode.LOSSY] if lost else codes)


def _from_here(source: Source) -> str:
    """What a command takes for a recording: tables have its name without the folder."""
    if is_url(source.place):
        return source.shown
    place, here = Path(source.place), Path.cwd()
    return in_text(str(place.relative_to(here) if place.is_relative_to(here) else place))


def _tell(outcomes: Sequence[Outcome], sources: Sequence[Source], quiet: bool) -> None:
    """Name recordings that failed or that are not to be believed, on standard error."""
    failed = [(each, source) for each, source in zip(outcomes, sources, strict=True) if each.state == FAILED]
    for each, source in failed[:TOLD]:
        message = each.message.replace(in_line(each.shown), _from_here(source))
        line = " ".join(f"occlog: failed: {each.name}: {each.stage}: {message}".split())
        click.echo(told(line), err=True)
    if len(failed) > TOLD:
        click.echo(f"occlog: {len(failed) - TOLD} more have failed; {RUNS_TABLE} names them", err=True)
    lossy = [each for each in outcomes if each.losses]
    if lossy:
        click.echo(
            f"occlog: lost: input of {counted(len(lossy), 'recording')}; {RUNS_TABLE} lists it (losses)", err=True
        )
    doubted = [each for each in outcomes if each.plausible is False]
    for each in doubted[:TOLD]:
        console.note(f"warning: {each.name}: plausible: {plausible_in_words(summary_of(each.verdicts))}", quiet)
    if len(doubted) > TOLD:
        console.note(f"warning: {len(doubted) - TOLD} more are not plausible; {RUNS_TABLE} names them", quiet)


def _summary(folder: str, outcomes: Sequence[Outcome], rows: object) -> dict[str, object]:
    states = Counter(each.state for each in outcomes)
    return {
        "recordings": len(outcomes),
        **{state: states[state] for state in ("done", "lossy", "threshold", FAILED)},
        "up_to_date": sum(not each.redone for each in outcomes),
        "not_plausible": sum(each.plausible is False for each in outcomes),
        "rows": rows,
        "folder": folder,
    }
