"""One recording of a batch: the stages of its run, and what a row of the table of runs says of it.

Whatever is wrong with a recording is an outcome, not an error: the others go on.
"""

from __future__ import annotations

import io
import time
from contextlib import AbstractContextManager, nullcontext, redirect_stderr
from dataclasses import dataclass, field, replace
from pathlib import Path

from occlog.cli.main import explain
from occlog.errors import ExitCode
from occlog.io.files.provenance import hash_file
from occlog.io.remote.cache import Cache
from occlog.io.remote.urls import is_url
from occlog.pipeline.run.run import GOING_ON, Step, do_stages, drop_empty, losses_of, verdicts_of, worst
from occlog.pipeline.run.stages import Config
from occlog.records.losses import Loss
from occlog.records.verdicts import Verdict, all_plausible, found_by_stage

from .folders import run_folder
from .plan import in_line

STATES = {ExitCode.DONE: "done", ExitCode.LOSSY: "lossy", ExitCode.THRESHOLD: "threshold"}
FAILED = "failed"
"""State of a recording one of whose stages ended with any other exit code."""


@dataclass(frozen=True)
class Task:
    """What a worker is told of a recording."""

    name: str
    shown: str  # what it is called in tables
    place: str = field(repr=False)  # where it is; a URL may hold what opens it
    config: Config  # without a recording
    folder: str = field(repr=False)  # of its run; the same
    force: bool  # do every stage
    cache: Cache  # for what is at a URL


@dataclass(frozen=True)
class Outcome:
    """What became of a recording."""

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
        """The exit code in a word."""
        return STATES.get(ExitCode(self.code), FAILED)

    @property
    def plausible(self) -> bool | None:
        """Whether every stage found its results plausible; None: none has judged."""
        return all_plausible(self.verdicts)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What speaks against the results, each with its stage."""
        failed = ((stage, check) for stage, check in found_by_stage(self.verdicts) if check.status == "failed")
        return tuple(f"{stage}: {check.id}: {check.text}" for stage, check in failed)


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
        self._names = {str(task.config.path): task.config.path.name}  # of places of this machine, for messages
        self._steps: list[Step] = []

    def outcome(self) -> Outcome:
        """Do all stages, until one fails."""
        task, found = self._task, Outcome(self._task.name, self._task.shown)
        try:
            with self._recording() as recording, run_folder(task.folder, task.name, task.cache) as folder:
                self._names |= {str(recording): task.shown, str(folder): task.name}
                # Of what lies beside it, such as videos
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
        """The recording on this machine, while the block lasts."""
        place = self._task.place
        return self._task.cache.holding(place) if is_url(place) else nullcontext(Path(place))

    def _do_stages(self, recording: Path, folder: Path) -> int:
        """Do the stages; the exit code of the run."""
        config = self._task.config
        config = replace(config, values={**config.values, "recording": str(recording)})
        folder.parent.mkdir(parents=True, exist_ok=True)
        for step in do_stages(config, folder, force=self._task.force, dry_run=False, begin=self._begin):
            self._steps.append(step)
        last = self._steps[-1]
        return last.code if last.code not in GOING_ON else worst(step.code for step in self._steps)

    def _failed(self, found: Outcome, error: Exception) -> Outcome:
        """The outcome with the error, in one line that names no folder of this machine."""
        text, code = explain(error)
        for path, name in self._names.items():
            for each in {path, " ".join(path.split())} - {"/"}:
                text = text.replace(each, name)
        return replace(found, code=int(code), stage=self._stage, message=in_line(text), redone=True)

    def _begin(self, stage: str) -> None:
        self._stage = stage

    def _with_outputs(self, told: Outcome, folder: Path) -> Outcome:
        """The outcome with what its files say."""
        made = tuple(name for step in self._steps for name in step.outputs)
        redone = told.redone or any(step.what == "done" for step in self._steps)
        files = [folder / name for name in made]
        return replace(told, outputs=made, redone=redone, losses=losses_of(files), verdicts=verdicts_of(files))
