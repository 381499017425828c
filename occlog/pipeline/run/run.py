"""Work of `occlog run`: every stage of a configuration in order, without those that are up to date.

The state of the run folder, `run.json`, has for each stage a hash of everything that it depends on, its
exit code, and hashes of its outputs.
"""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import click

from occlog import __version__
from occlog.cli import options
from occlog.cli.common import check_common
from occlog.errors import ExitCode, InputError, OutputError, UsageError
from occlog.io.files.json_file import read_json, write_json
from occlog.io.files.provenance import hash_file

from .stages import Stage, check_settings, plan, read_config, refused_in

STATE = "run.json"
GOING_ON = (ExitCode.DONE, ExitCode.LOSSY, ExitCode.THRESHOLD)
"""Exit codes of a stage after which the next stage runs."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of a stage, kept in `run.json`."""

    key: str  # hash of everything that the outputs depend on
    code: int
    outputs: dict[str, str]  # hashes by path in the run folder


def run_stages(
    config: Path, output: Path, *, force: bool, dry_run: bool, strict: bool, quiet: bool, as_json: bool
) -> int:
    """Run all stages of a configuration that are not up to date; return the exit code.

    Args:
        config: file of the configuration; its paths are relative to its folder.
        output: run folder.
        force: true: run every stage.
        dry_run: true: only say which stages would run.
        strict: true: exit code 6 if the evaluation says that the tracks are not plausible.
        quiet: true: no notes.
        as_json: true: print the summary as JSON.
    """
    wanted = read_config(config)
    for stage in plan(wanted, output.resolve()):  # checks every key and value before any stage runs
        check_settings(wanted, stage)
    folder = _folder(output, dry_run)
    state = _read_state(folder)
    codes: list[int] = []
    done: dict[str, str] = {}
    for stage in plan(wanted, folder):
        with _inside(config.resolve().parent):
            key = _key(stage, folder)
            if not force and _is_current(state.get(stage.name), key, folder):
                done[stage.name], code = "up to date", state[stage.name].code
            elif dry_run:
                done[stage.name], code = "would run", ExitCode.DONE
            else:
                options.note(f"{stage.name} ...", quiet)
                with refused_in(wanted, stage):
                    code = _do(stage)
                done[stage.name] = "done"
                if code in GOING_ON:
                    state[stage.name] = Outcome(key, code, _hashes(stage, folder))
                    _write_state(folder, state)
        codes.append(code)
        if code not in GOING_ON:
            return code
    summary = _summary(folder, done, as_json)
    options.note_findings((("", "warning", text) for text in _sentences(summary)), quiet)
    options.echo_summary(summary, as_json)
    return options.strict_code(_worst(codes), bool(summary.get("plausible", True)), strict)


def _sentences(summary: Mapping[str, object]) -> list[str]:
    """The warnings of a summary."""
    warnings = summary.get("warnings")
    return [str(w["sentence"]) for w in warnings] if isinstance(warnings, list) else []


def _worst(codes: list[int]) -> int:
    for code in (ExitCode.THRESHOLD, ExitCode.LOSSY):
        if code in codes:
            return code
    return ExitCode.DONE


def _summary(folder: Path, done: dict[str, str], as_json: bool) -> dict[str, object]:
    metrics = folder / "metrics.json"
    values = read_json(metrics) if metrics.is_file() else {}
    verdict = {k: v for k, v in values.items() if k in ("plausible", "warnings")}
    numbers = {k: v for k, v in values.items() if not k.startswith("_") and k not in verdict}
    if as_json:
        return {"stages": done, "folder": str(folder), "metrics": numbers, **verdict}
    head = {k: v for k, v in numbers.items() if _is_headline(k) and v is not None}
    return {**done, "report": str(folder / "report.html"), **head, **verdict}


def _is_headline(name: str) -> bool:
    whole = "_target_" not in name and "_sensor_" not in name
    return whole and name.startswith(("rmse", "bound_r", "sight_lines_distance", "sight_lines_share"))


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
def _inside(folder: Path) -> Iterator[None]:
    """Work inside a folder: paths in a configuration are relative to it."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def _do(stage: Stage) -> int:
    """Run a stage's command without its own summary; return its exit code."""
    args = [*stage.args, "--overwrite"]
    with redirect_stdout(io.StringIO()), stage.command.make_context(f"occlog {stage.name}", args) as context:
        result = stage.command.invoke(context)
        try:
            check_common(context)
        except click.UsageError as error:
            raise UsageError(error.message) from error
    return int(result) if isinstance(result, int) else ExitCode.DONE


def _key(stage: Stage, folder: Path) -> str:
    """Hash everything that the stage's outputs depend on: program, arguments, and content of the inputs."""
    digest = hashlib.sha256(f"{__version__}\0{stage.name}\0".encode())
    for text in stage.args:
        path = Path(text.split("=", 1)[-1])
        shown = text.replace(str(folder), "RUN")
        digest.update(f"{shown}\0".encode())
        if text in stage.output_paths:
            continue
        for file in [path] if path.is_file() else sorted(path.rglob("*")) if path.is_dir() else []:
            if file.is_file():
                digest.update(f"{file.name}\0{hash_file(file)}\0".encode())
    return digest.hexdigest()


def _hashes(stage: Stage, folder: Path) -> dict[str, str]:
    paths = (Path(p) for p in stage.output_paths)
    return {str(p.relative_to(folder)): hash_file(p) for p in paths if p.is_file()}


def _is_current(outcome: Outcome | None, key: str, folder: Path) -> bool:
    if outcome is None or outcome.key != key:
        return False
    return all((folder / n).is_file() and hash_file(folder / n) == digest for n, digest in outcome.outputs.items())


def _read_state(folder: Path) -> dict[str, Outcome]:
    path = folder / STATE
    if not path.exists():
        if folder.is_dir() and any(folder.iterdir()):
            raise UsageError(
                f"{folder}: holds files but no {STATE}, so it is not a run folder; name a new or empty one"
            )
        return {}
    try:
        return {name: Outcome(**outcome) for name, outcome in read_json(path)["stages"].items()}
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: not the state of a run; remove it to do every stage again") from error


def _write_state(folder: Path, state: dict[str, Outcome]) -> None:
    stages = {name: outcome.__dict__ for name, outcome in state.items()}
    write_json(folder / STATE, {"program": "occlog", "version": __version__, "stages": stages}, overwrite=True)
