"""One recording of a batch: the stages of its run, and its row in the table of runs.

A fault in a recording is an outcome rather than an error: the others continue. The folder of a batch may be at a URL: a
run is then processed in a local folder; existing files are fetched, and new ones are uploaded, `run.json` last, so that
a worker may be killed at any time.
"""

from __future__ import annotations

import io
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, redirect_stderr
from dataclasses import dataclass, field, replace
from pathlib import Path

from occlog import __version__
from occlog.cli.main import explain
from occlog.console.foreign_code import hidden
from occlog.errors import ExitCode, InputError, OutputError, UsageError
from occlog.io.files.atomic import PARTIAL, alone_with, no_links_out_of, translate_write_errors
from occlog.io.files.provenance import hash_file
from occlog.io.files.texts.documents import read_json, write_json
from occlog.io.remote import Cache, check_output, fetch, is_url, names_in, public_url, put, remove
from occlog.pipeline.run.run import GOING_ON, STATE, StageStep, do_stages, drop_empty, losses_of, verdicts_of, worst
from occlog.pipeline.run.stages import Config
from occlog.records.losses import Loss
from occlog.records.tables import TABLES
from occlog.records.verdicts import Verdict, all_plausible, found_by_stage

from .plan import in_line

MARK = "batch.json"
"""File that states that a folder is one of a batch."""
RUNS = "runs"
"""Folder of the run folders."""


@contextmanager
def batch_folder(output: str, results: Sequence[str], cache: Cache) -> Iterator[Path]:
    """Context manager that yields a local folder for the results of a batch; for a URL they are uploaded at the end.

    Tables of an earlier command are removed, since runs change.

    Args:
        output: folder or URL.
        results: names of files over all recordings.
        cache: has the local folder for a URL.

    Raises:
        UsageError: the folder holds files and is not of a batch.
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
        raise UsageError(
            f"{public_url(output)}: holds files but no {MARK}, so it is not of a batch; name a new folder",
            id="wrong-content",
        )
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
        raise UsageError(
            f"{output}: holds files but no {MARK}, so it is not of a batch; name a new or empty folder",
            id="wrong-content",
        )
    if mark.exists() and read_json(mark).get("program") != "occlog":
        raise InputError(
            f"{mark}: is of another program, not of a batch; name a new or empty folder", id="wrong-content"
        )
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
def run_folder(location: str, name: str, cache: Cache) -> Iterator[Path]:
    """Context manager that yields the local folder of a run; for a URL, new files are uploaded at the end.

    Args:
        location: path or URL of the run.
        name: name of the recording, and of the local folder for a URL.
        cache: has the local folder for a URL.
    """
    if not is_url(location):
        yield Path(location)
        return
    with cache.scratch() as folder:
        run = folder / name
        names = names_in(location)
        # Without its state the files of a run are unknown
        fetch_files(location, names if STATE in names else (), run)
        before = {path.name: hash_file(path) for path in run.iterdir()}
        yield run
        files = [path for path in run.glob("*") if path.is_file()]
        # What a stage made that the configuration no longer has would pass for the run's own
        remove(f"{location}/{name}" for name in before.keys() - {path.name for path in files})
        for path in sorted(files, key=lambda path: path.name == STATE):
            if before.get(path.name) != hash_file(path):
                put(path, f"{location}/{path.name}")


def fetch_files(location: str, names: Iterable[str], folder: Path) -> None:
    """Download the files `names` of a run at the URL `location` into a folder, which is created if missing."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        fetch(f"{location}/{name}", folder / name)


STATES = {ExitCode.DONE: "done", ExitCode.LOSSY: "lossy", ExitCode.THRESHOLD: "threshold"}
FAILED = "failed"
"""State of a recording with a stage that ended with any other exit code."""


@dataclass(frozen=True)
class Task:
    """Task of a worker: to run the stages of a configuration on one recording.

    `name`: name of the recording and its run; `shown`: its name in tables; `location`: path or URL of the recording;
    `folder`: path or URL of its run folder; `force`: run stages that are up to date, too; `cache`: for files at URLs.
    """

    name: str
    shown: str  # what it is called in tables
    location: str = field(repr=False)  # where it is; a URL may hold what opens it
    config: Config  # without a recording
    folder: str = field(repr=False)  # of its run; the same
    force: bool  # do every stage
    cache: Cache  # for files at URLs


@dataclass(frozen=True)
class RecordingOutcome:
    """Outcome of the run of one recording.

    Attributes:
        name: name of its run folder.
        shown: the recording as shown to the user.
        sha256: SHA-256 of the recording; empty: it could not be read.
        code: exit code.
        stage, message: name of the failed stage, and the reason; empty: none failed.
        verdicts: consistency verdicts of all stages.
        losses: input that was lost.
        outputs: files of the run folder that are valid for this recording and configuration.
        redone: whether a stage had to run, since it was not up to date.
        seconds, cpu_seconds: elapsed time, and processor time of the process that ran it [s].
    """

    name: str
    shown: str
    sha256: str = ""  # of the recording; empty: it could not be read
    code: int = ExitCode.DONE
    stage: str = ""  # the one that failed
    message: str = ""  # why
    verdicts: tuple[Verdict, ...] = ()  # of all stages
    losses: tuple[Loss, ...] = ()
    outputs: tuple[str, ...] = ()  # files of the run folder that hold for this recording and configuration
    redone: bool = False  # a stage was not up to date
    seconds: float = 0.0
    cpu_seconds: float = 0.0  # of this process

    @property
    def state(self) -> str:
        """Exit code as a word, for example `done`, `lossy` or `failed`."""
        return STATES.get(ExitCode(self.code), FAILED)

    @property
    def plausible(self) -> bool | None:
        """True if every stage found its results plausible; None if none was checked."""
        return all_plausible(self.verdicts)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the results as text, each with its stage and id."""
        failed = ((stage, check) for stage, check in found_by_stage(self.verdicts) if check.status == "failed")
        return tuple(f"{stage}: {check.id}: {check.text}" for stage, check in failed)


def process(task: Task) -> RecordingOutcome:
    """Run the stages of a recording that are not up to date; return the outcome, in which failures are recorded."""
    begin, used = time.perf_counter(), time.process_time()
    # What stages state about losses and warnings is in the outcome
    with hidden("matplotlibrc"), redirect_stderr(io.StringIO()):
        outcome = _Run(task).outcome()
    return replace(outcome, seconds=time.perf_counter() - begin, cpu_seconds=time.process_time() - used)


class _Run:
    """Run of one recording of a batch, with its current stage for messages."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._stage = "recording"
        self._names = {str(task.config.path): task.config.path.name}  # of positions of this machine, for messages
        self._steps: list[StageStep] = []

    def outcome(self) -> RecordingOutcome:
        """Run all stages until one fails; return the outcome."""
        task, found = self._task, RecordingOutcome(self._task.name, self._task.shown)
        try:
            with self._recording() as recording, run_folder(task.folder, task.name, task.cache) as folder:
                self._names |= {str(recording): task.shown, str(folder): task.name}
                # Of the files next to it, such as videos
                self._names[f"{recording.parent}/"] = task.shown[: task.shown.rfind("/") + 1]
                found = replace(found, sha256=hash_file(recording))
                try:
                    code = self._do_stages(recording, folder)
                except Exception as error:
                    found = self._failed(found, error)
                    if not self._steps:
                        drop_empty(folder)
                else:
                    found = replace(found, code=code)
                    if code not in GOING_ON:
                        found = replace(found, stage=self._stage, message=f"ended with exit code {code}")
                found = self._with_outputs(found, folder)
        except Exception as error:
            found = self._failed(replace(found, outputs=()), error)
        return found

    def _recording(self) -> AbstractContextManager[Path]:
        """Return a context manager that yields the path of a local copy of the recording."""
        location = self._task.location
        return self._task.cache.holding(location) if is_url(location) else nullcontext(Path(location))

    def _do_stages(self, recording: Path, folder: Path) -> int:
        """Run the stages on the local copy of the recording, into the run folder; return the worst exit code."""
        config = self._task.config
        config = replace(config, values={**config.values, "recording": str(recording)})
        folder.parent.mkdir(parents=True, exist_ok=True)
        for step in do_stages(config, folder, force=self._task.force, dry_run=False, begin=self._begin):
            self._steps.append(step)
        last = self._steps[-1]
        return last.code if last.code not in GOING_ON else worst(step.code for step in self._steps)

    def _failed(self, found: RecordingOutcome, error: Exception) -> RecordingOutcome:
        """Return the outcome `found` with an error as one line of text, with names instead of local folders."""
        text, code, _ = explain(error)
        for path, name in self._names.items():
            for each in {path, " ".join(path.split())} - {"/"}:
                text = text.replace(each, name)
        return replace(found, code=int(code), stage=self._stage, message=in_line(text), redone=True)

    def _begin(self, stage: str) -> None:
        self._stage = stage

    def _with_outputs(self, outcome: RecordingOutcome, folder: Path) -> RecordingOutcome:
        """Return the outcome with names, losses and verdicts of the outputs in the run folder."""
        made = tuple(name for step in self._steps for name in step.outputs)
        redone = outcome.redone or any(step.what == "done" for step in self._steps)
        files = [folder / name for name in made]
        return replace(outcome, outputs=made, redone=redone, losses=losses_of(files), verdicts=verdicts_of(files))
