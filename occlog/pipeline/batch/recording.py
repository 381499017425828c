"""One recording of a batch: the stages of its run, and what a row of the table of runs says of it.

Whatever is wrong with a recording is an outcome, not an error: the others go on.
"""

from __future__ import annotations

import io
import time
from collections.abc import Iterable
from contextlib import redirect_stderr
from dataclasses import dataclass, replace
from pathlib import Path

from occlog.cli.main import explain
from occlog.errors import ExitCode
from occlog.io.files.json_file import read_json
from occlog.io.files.parquet import read_provenance
from occlog.io.files.provenance import hash_file
from occlog.pipeline.run.run import GOING_ON, Step, do_stages, drop_empty, sentences, worst
from occlog.pipeline.run.stages import Config
from occlog.records.losses import Loss

METRICS = "metrics.json"
STATES = {ExitCode.DONE: "done", ExitCode.LOSSY: "lossy", ExitCode.THRESHOLD: "threshold"}
FAILED = "failed"
"""State of a recording one of whose stages ended with any other exit code."""


@dataclass(frozen=True)
class Task:
    """What a worker is told of a recording."""

    name: str
    shown: str  # what it is called in tables
    place: str  # where it is
    config: Config  # without a recording
    folder: str  # of its run
    force: bool  # do every stage


@dataclass(frozen=True)
class Outcome:
    """What became of a recording."""

    name: str
    shown: str
    sha256: str = ""  # of the recording; empty: it could not be read
    code: int = ExitCode.DONE
    stage: str = ""  # the one that failed
    message: str = ""  # why
    plausible: bool | None = None  # None: nothing was evaluated
    warnings: tuple[str, ...] = ()
    losses: tuple[Loss, ...] = ()
    outputs: tuple[str, ...] = ()  # files of the run folder that hold for this recording and configuration
    redone: bool = False  # a stage was not up to date
    seconds: float = 0.0
    cpu_seconds: float = 0.0  # of this process

    @property
    def state(self) -> str:
        """The exit code in a word."""
        return STATES.get(ExitCode(self.code), FAILED)


def process(task: Task) -> Outcome:
    """Do the stages of a recording that are not up to date."""
    begin, used = time.perf_counter(), time.process_time()
    with redirect_stderr(io.StringIO()):  # what stages say of losses and warnings is in the outcome
        outcome = _Run(task).outcome()
    return replace(outcome, seconds=time.perf_counter() - begin, cpu_seconds=time.process_time() - used)


class _Run:
    """The run of a recording, as far as it has come."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._stage = "recording"
        self._steps: list[Step] = []

    def outcome(self) -> Outcome:
        """Do all stages, until one fails."""
        blank = Outcome(self._task.name, self._task.shown)
        try:
            recording = Path(self._task.place)
            blank = replace(blank, sha256=hash_file(recording))
            return self._done(blank, recording, Path(self._task.folder))
        except Exception as error:
            told = replace(blank, code=int(explain(error).code), stage=self._stage, message=self._message(error))
            folder = Path(self._task.folder)
            if not self._steps:
                drop_empty(folder)
            return self._with_outputs(told, folder)

    def _done(self, blank: Outcome, recording: Path, folder: Path) -> Outcome:
        config = self._task.config
        config = replace(config, values={**config.values, "recording": str(recording)})
        folder.parent.mkdir(parents=True, exist_ok=True)
        for step in do_stages(config, folder, force=self._task.force, dry_run=False, begin=self._begin):
            self._steps.append(step)
        last = self._steps[-1]
        if last.code not in GOING_ON:
            told = replace(blank, code=last.code, stage=last.stage, message=f"ended with exit code {last.code}")
        else:
            told = replace(blank, code=int(worst(step.code for step in self._steps)))
        return self._with_outputs(told, folder)

    def _message(self, error: Exception) -> str:
        """What is told of an error, in one line that names no folder of this machine."""
        text = " ".join(explain(error).message.split())
        return text.replace(self._task.place, self._task.shown).replace(self._task.folder, self._task.name)

    def _begin(self, stage: str) -> None:
        self._stage = stage

    def _with_outputs(self, told: Outcome, folder: Path) -> Outcome:
        """The outcome with what its files say."""
        made = tuple(name for step in self._steps for name in step.outputs)
        redone = told.state == FAILED or any(step.what == "done" for step in self._steps)
        told = replace(told, outputs=made, redone=redone, losses=_losses(folder / name for name in made))
        if METRICS not in made:
            return told
        values = read_json(folder / METRICS)
        plausible = None if values.get("plausible") is None else bool(values["plausible"])
        return replace(told, plausible=plausible, warnings=tuple(sentences(values)))


def _losses(files: Iterable[Path]) -> tuple[Loss, ...]:
    """What was lost on the way to some tables, each once."""
    tables = (file for file in files if file.suffix == ".parquet")
    return tuple(dict.fromkeys(loss for file in tables for loss in read_provenance(file).losses))
