"""`occlog run`: every stage of a configuration in order, except those that are up to date.

The state of the run folder, `run.json`, has for each stage a hash of everything that it depends on, its exit code, and
hashes of its outputs.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from occlog import __version__, console
from occlog.errors import ExitCode, InputError, OutputError, UsageError
from occlog.evaluate.mot import figures as headline
from occlog.io.files.atomic import PARTIAL, alone_with, no_links_out_of
from occlog.io.files.inputs import previous_losses, verdicts_of_file
from occlog.io.files.provenance import hash_file, installed_versions
from occlog.io.files.texts.documents import read_json, write_json
from occlog.records.losses import Loss
from occlog.records.verdicts import Verdict, distinct, summary_of, texts_of

from .stage import RunStage, files_of, name_of, places_of
from .stages import Config, check_settings, plan, read_config, refused_in

STATE = "run.json"
METRICS_FILES = ("metrics.json", "metrics_in_images.json")
"""Figures of a run: those of tracks on the ground first."""
CONFIGURATION = "run.yaml"
"""Name of a configuration that `occlog start` writes into the run folder."""
GOING_ON = (ExitCode.DONE, ExitCode.LOSSY, ExitCode.THRESHOLD)
"""Exit codes of a stage after which the next stage runs."""
UP_TO_DATE = "up to date"
PATIENCE = 5.0
"""Time to wait for another command in a run folder [s]: workers of one that was killed need a time step to end."""
WAITING = "would run"
"""Text of a dry run for a stage that is not up to date."""


@dataclass(frozen=True)
class StageOutcome:
    """Outcome of a stage, as `run.json` stores it.

    `key`: hash of everything that its outputs depend on (settings, inputs, program); `code`: exit code; `outputs`: hash
    of each output, by path in the run folder.
    """

    key: str  # hash of everything that the outputs depend on
    code: int
    outputs: dict[str, str]  # hashes by path in the run folder


class StageStep(NamedTuple):
    """Report on one stage of a run.

    `what`: `up to date`, `would run` or `done`; `code`: exit code; `outputs`: paths in the run folder, empty if it
    failed.
    """

    stage: str
    what: str  # "up to date", `WAITING` or "done"
    code: int
    outputs: tuple[str, ...]  # paths in the run folder; none of a stage that failed


class Digests:
    """Cache of file hashes; each file is read once unless it changes."""

    def __init__(self) -> None:
        """Create an empty cache of hashes of files."""
        self._known: dict[tuple[str, int, int], str] = {}

    def of(self, path: Path) -> str:
        """Return the SHA-256 of a file's content, in hexadecimal; InputError if unreadable."""
        status = path.stat()
        key = (str(path), status.st_mtime_ns, status.st_size)
        if key not in self._known:
            self._known[key] = hash_file(path)
        return self._known[key]


def run_stages(
    config: Path,
    output: Path,
    *,
    force: bool,
    dry_run: bool,
    strict: bool,
    quiet: bool,
    as_json: bool,
    noted: Collection[str] = (),
) -> int:
    """Run all stages of a configuration that are not up to date; return the exit code.

    Args:
        config: file of the configuration; its paths are relative to its folder.
        output: run folder.
        force: run every stage.
        dry_run: only report which stages would run.
        strict: exit code 6 if a stage finds its results implausible.
        quiet: no notes.
        as_json: print the summary as JSON.
        noted: names of stages with notes that are printed.
    """
    wanted = read_config(config)
    for stage in plan(wanted, output.resolve()):  # checks every key and value before any stage runs
        check_settings(wanted, stage)
    folder = _folder(output, dry_run)
    if others := other_versions(folder):
        console.note(f"{folder} was made with other packages: {others}", quiet)
    steps, verdicts = list[StageStep](), tuple[Verdict, ...]()
    noted = () if quiet else noted
    for step in do_stages(
        wanted, folder, force=force, dry_run=dry_run, begin=lambda name: _note_begin(name, quiet), noted=noted
    ):
        steps.append(step)
        known = texts_of(verdicts, "run")
        verdicts = distinct((*verdicts, *verdicts_of(folder / name for name in step.outputs)))
        if step.stage not in noted or step.what == UP_TO_DATE:
            console.note_findings((text for text in texts_of(verdicts, "run") if text not in known), quiet)
    if steps and steps[-1].code not in GOING_ON:
        return steps[-1].code
    # Losses of a finished stage are in its state
    kept = [step for step in steps if step.what == UP_TO_DATE and step.code == ExitCode.LOSSY]
    console.note_losses(losses_of(folder / name for step in kept for name in step.outputs))
    summary = {**_summary(folder, {step.stage: step.what for step in steps}, as_json), **summary_of(verdicts)}
    lost = losses_of(folder / name for step in steps for name in step.outputs)
    if as_json:
        summary["losses"] = [loss.as_dict() for loss in lost]
    for loss in lost if all(step.code != ExitCode.LOSSY for step in steps) else ():
        console.note(f"lost earlier: {loss}", quiet)
    console.echo_summary(summary, as_json)
    return console.strict_code(worst(step.code for step in steps), summary.get("plausible"), strict)


def do_stages(
    wanted: Config,
    output: Path,
    *,
    force: bool,
    dry_run: bool,
    begin: Callable[[str], None],
    noted: Collection[str] = (),
) -> Iterator[StageStep]:
    """Run the stages of a configuration that are not up to date, in order, until one fails; generate a report on each.

    Args:
        wanted: the configuration; its paths are relative to its folder.
        output: run folder; made if missing.
        force: run every stage.
        dry_run: only report which stages would run.
        begin: called with the name of each stage before it runs.
        noted: names of stages with notes that are printed.

    Raises:
        OcclogError, click.ClickException: a stage fails, or another command works in that folder.
    """
    folder = _folder(output, dry_run)
    with nullcontext() if dry_run else alone_with(folder, "run", PATIENCE):
        yield from _stages(wanted, folder, force=force, dry_run=dry_run, begin=begin, noted=noted)


def _stages(
    wanted: Config, folder: Path, *, force: bool, dry_run: bool, begin: Callable[[str], None], noted: Collection[str]
) -> Iterator[StageStep]:
    """Run the stages in an existing run folder, and generate a report on each, up to the first that fails.

    Args:
        wanted: the configuration.
        folder: folder of the run.
        force: run stages that are up to date, too.
        dry_run: run none, report which would run.
        begin: called with the name of a stage before it runs.
        noted: names of stages with notes that are printed.
    """
    state = outcomes(folder)
    if not dry_run and not (folder / STATE).exists():
        _write_state(folder, state)  # so that a run which is killed in its first stage leaves a run folder
    digests = Digests()
    stages: list[RunStage] = []
    for stage in plan(wanted, folder):  # outputs of a stage determine the next ones
        stages.append(stage)
        with inside(wanted.path.resolve().parent):
            key = key_of(stage, folder, digests)
            kept = state.get(stage.name)
            if not force and kept is not None and _is_current(kept, key, folder):
                step = StageStep(stage.name, UP_TO_DATE, kept.code, tuple(kept.outputs))
            elif dry_run:
                step = StageStep(stage.name, WAITING, ExitCode.DONE, ())
            else:
                begin(stage.name)
                with refused_in(wanted, stage.name), no_links_out_of(folder):
                    code = stage.do(quiet=False) if stage.name in noted else _do(stage)
                step = StageStep(stage.name, "done", code, ())
                if code in GOING_ON:
                    hashes = _hashes(stage, folder)
                    if kept is not None:
                        others = (o.outputs for name, o in state.items() if name != stage.name)
                        _remove_outputs(folder, kept, set(hashes).union(*others))
                    state[stage.name] = StageOutcome(key, code, hashes)
                    _write_state(folder, state)
                    step = StageStep(stage.name, "done", code, tuple(hashes))
        yield step
        if step.code not in GOING_ON:
            return
    if not dry_run:
        _drop_others(folder, state, stages)


def _drop_others(folder: Path, state: dict[str, StageOutcome], stages: Sequence[RunStage]) -> None:
    """Remove stages that the configuration no longer has from `state`, in place, and delete their outputs.

    Files changed since, or made by another stage now, are kept. `stages`: those of the configuration.
    """
    made = {str(Path(p).relative_to(folder)) for stage in stages for p in stage.output_paths}
    for name in set(state) - {stage.name for stage in stages}:
        _remove_outputs(folder, state.pop(name), made)
        _write_state(folder, state)


def _remove_outputs(folder: Path, older: StageOutcome, made: Collection[str]) -> None:
    """Delete the unchanged outputs of an older outcome of a stage, except those with names in `made`."""
    for file, digest in older.outputs.items():
        path = folder / file
        if file not in made and path.is_file() and hash_file(path) == digest:
            path.unlink()


def _note_begin(stage: str, quiet: bool) -> None:
    console.note(f"{stage} ...", quiet)


def verdicts_of(files: Iterable[Path]) -> tuple[Verdict, ...]:
    """Return the consistency verdicts in the outputs of a run, without duplicates, in the order of stages."""
    return distinct(verdict for file in files for verdict in verdicts_of_file(file))


def losses_of(files: Iterable[Path]) -> tuple[Loss, ...]:
    """Return the data losses recorded in the Parquet tables among `files`, without duplicates."""
    return previous_losses(file for file in files if file.suffix == ".parquet")


def worst(codes: Iterable[int]) -> int:
    """Return the most severe of several exit codes after which the work continued."""
    codes = list(codes)
    for code in (ExitCode.THRESHOLD, ExitCode.LOSSY):
        if code in codes:
            return code
    return ExitCode.DONE


def _summary(folder: Path, done: dict[str, str], as_json: bool) -> dict[str, object]:
    metrics = next((path for name in METRICS_FILES if (path := folder / name).is_file()), folder)
    # Figures that another evaluation made, before a dry run, are not those of this configuration
    values = read_json(metrics) if done.get("evaluate", WAITING) != WAITING and metrics.is_file() else {}
    numbers = {k: v for k, v in values.items() if not k.startswith("_") and k not in ("plausible", "warnings")}
    if as_json:
        return {"stages": done, "folder": str(folder), "metrics": numbers}
    # Tracks in images have identities of their own, and no errors of position
    own = headline.independent_ids(numbers) or ("idf1" in numbers and not any(map(_is_headline, numbers)))
    shown = headline.first_of(numbers) if own else {k: v for k, v in numbers.items() if _is_headline(k)}
    head = {k: v for k, v in shown.items() if v is not None}
    page = {} if done.get("report", WAITING) == WAITING else {"report": str(folder / "report.html")}
    if "report" not in done and done.get("overlay", WAITING) != WAITING:
        page = {"overlay": str(folder / "overlay.webm")}
    return {**done, **page, **head}


def _is_headline(name: str) -> bool:
    whole = "_target_" not in name and "_sensor_" not in name
    return whole and name.startswith(("rmse", "bound_r", "triangulation_distance", "triangulation_share"))


def _folder(output: Path, dry_run: bool) -> Path:
    if output.exists() and not output.is_dir():
        raise OutputError(f"{output}: is a file; name a folder for the run")
    if not dry_run:
        try:
            output.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{output}: the run folder cannot be made: {error.strerror or error}") from error
    return output.resolve()


@contextmanager
def inside(folder: Path) -> Iterator[None]:
    """Context manager that sets the current folder, since paths in a configuration are relative to it."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def _do(stage: RunStage) -> int:
    """Run a stage without printing its summary; return the exit code."""
    return stage.do()


def key_of(stage: RunStage, folder: Path, digests: Digests) -> str:
    """Return the hash of all that a stage's outputs depend on: program and packages, values, and content of the inputs.

    Files are identified by name (relative path within a folder) and content, so that a run folder may be moved.

    Args:
        stage: the stage.
        folder: folder of the run.
        digests: cache of hashes of files.
    """
    digest = hashlib.sha256(f"{__version__}\0{installed_versions()}\0{stage.name}\0".encode())
    for text in stage.texts():
        shown = text.replace(str(folder), "RUN")
        if text in stage.output_paths:
            digest.update(f"{shown}\0".encode())
            continue
        for path in places_of(text):
            shown = shown.replace(str(path), path.name) if path.is_file() else shown
        digest.update(f"{shown}\0".encode())
        for file in files_of(text):
            digest.update(f"{name_of(file, text)}\0{digests.of(file)}\0".encode())
    return digest.hexdigest()


def _hashes(stage: RunStage, folder: Path) -> dict[str, str]:
    paths = (Path(p) for p in stage.output_paths)
    return {str(p.relative_to(folder)): hash_file(p) for p in paths if p.is_file()}


def _is_current(outcome: StageOutcome, key: str, folder: Path) -> bool:
    if outcome.key != key:
        return False
    return all((folder / n).is_file() and hash_file(folder / n) == digest for n, digest in outcome.outputs.items())


def outcomes(folder: Path) -> dict[str, StageOutcome]:
    """Return the outcomes of finished stages by name, from `run.json` of a run folder; empty for an empty folder.

    Raises:
        UsageError: it is not a run folder.
        InputError: its state is damaged.
    """
    path = folder / STATE
    if not path.exists():
        if folder.is_dir() and any(
            not each.name.endswith(PARTIAL) and each.name != CONFIGURATION for each in folder.iterdir()
        ):
            raise UsageError(
                f"{folder}: holds files but no {STATE}, so it is not a run folder; name a new or empty one",
                id="wrong-content",
            )
        return {}
    try:
        found = {name: StageOutcome(**outcome) for name, outcome in read_json(path)["stages"].items()}
        whole = all(_is_outcome(outcome, folder.resolve()) for outcome in found.values())
    except (KeyError, TypeError, AttributeError, ValueError, OSError):
        whole = False
    if not whole:
        raise InputError(f"{path}: not the state of a run; remove it to do every stage again", id="damaged-file")
    return found


def _is_outcome(outcome: StageOutcome, folder: Path) -> bool:
    """Return whether the stored outcome of a stage is valid: types, exit code, and outputs inside the run folder."""
    texts = [outcome.key, *outcome.outputs.keys(), *outcome.outputs.values()]
    return (
        all(isinstance(text, str) for text in texts)
        and type(outcome.code) is int
        and outcome.code in GOING_ON
        and all((folder / name).parent.resolve().is_relative_to(folder) for name in outcome.outputs)
    )


def other_versions(folder: Path) -> str:
    """Return text on packages with other versions now than when a run folder was made; empty if equal or unknown."""
    path = folder / STATE
    then = read_json(path).get("versions") if path.is_file() else None
    if not isinstance(then, dict):
        return ""
    now = installed_versions()
    names = [name for name in sorted({*now, *then}) if now.get(name) != then.get(name)]
    return ", ".join(f"{name} {then.get(name, 'none')}, now {now.get(name, 'none')}" for name in names)


def drop_empty(folder: Path) -> None:
    """Delete a run folder in which no stage has ever finished; a folder with other files is kept."""
    if [path.name for path in folder.glob("*")] == [STATE] and not outcomes(folder):
        (folder / STATE).unlink()
    with suppress(OSError):  # it holds something, or is not there
        folder.rmdir()


def _write_state(folder: Path, state: dict[str, StageOutcome]) -> None:
    stages = {name: outcome.__dict__ for name, outcome in state.items()}
    made = {"program": "occlog", "version": __version__, "versions": installed_versions()}
    with no_links_out_of(folder):
        write_json(folder / STATE, {**made, "stages": stages}, overwrite=True)
