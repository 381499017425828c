"""`occlog start`: inspect, choose, write the configuration, and run it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import yaml

from occlog import console
from occlog.console.notes import begin_work, note_files
from occlog.errors import ExitCode, OutputExistsError, UsageError, did_you_mean, nearest
from occlog.io.files.atomic import open_output
from occlog.io.files.texts.yaml import parse_yaml
from occlog.pipeline.run.run import CONFIGURATION, drop_empty, outcomes, run_stages
from occlog.pipeline.run.stages import known_keys

from .choices import Choices, choose
from .survey import read_stated, survey, unused_lines

WHOLE = ("seed", "scene", "recording", "table")
"""Keys of the whole configuration, which `--set` takes as they are."""
STAGES = ("ingest", "listen", "detect", "track", "evaluate", "report", "overlay")


def start(
    sources: Sequence[Path],
    output: Path,
    *,
    kinds: Sequence[str],
    settings: Sequence[str],
    write_only: bool,
    overwrite: bool,
    strict: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    """Write `run.yaml` for the given files into the run folder, and run it; return the exit code.

    Args:
        sources: folders and files.
        output: run folder.
        kinds: statements `PATH=KIND[:NAME]` on what files are.
        settings: keys of the configuration, `STAGE.KEY=VALUE`.
        write_only: do not run it.
        overwrite: replace a configuration with other content.
        strict: exit code 6 if results are not plausible.
        quiet: no notes.
        as_json: print the summary as JSON.
    """
    given = read_settings(settings)
    found = survey(sources, read_stated(kinds, sources))
    made = Choices(found, sources, given)
    try:
        choose(made)
    finally:
        for line in (*map(str, made.lines), *unused_lines(found, sources)):
            console.note(line, quiet)
    path = output / CONFIGURATION
    text = as_text(made, list(unused_lines(found, sources)), output)
    written = not path.exists()
    if written or _without_comments(path.read_text("utf-8", "replace")) != _without_comments(text):
        if not written and not overwrite:
            raise OutputExistsError(f"{path}: exists, and is another configuration")
        note_files((item.path for item in found.items), [path])
        begin_work()
        output.mkdir(parents=True, exist_ok=True)
        with open_output(path, overwrite=overwrite) as file:
            file.write(text.encode())
    if write_only:
        console.echo_summary({"configuration": str(path), **(_summary(made) if as_json else {})}, as_json)
        return ExitCode.DONE
    try:
        return run_stages(
            path,
            output,
            force=False,
            dry_run=False,
            strict=strict,
            quiet=quiet,
            as_json=as_json,
            noted=("ingest", "listen"),
        )
    finally:
        if written and not outcomes(output):  # no stage was done; another choice needs no --overwrite
            path.unlink()
            drop_empty(output)


def _without_comments(text: str) -> list[str]:
    """Return the lines of a configuration without comments."""
    return [line for line in text.splitlines() if not line.startswith("#")]


def _summary(made: Choices) -> dict[str, object]:
    return {"choices": [{"text": line.text, "change": line.change} for line in made.lines]}


def read_settings(texts: Sequence[str]) -> dict[str, dict[str, object]]:
    """Return the keys in the `texts` STAGE.KEY=VALUE of `--set` by stage; top-level keys are under "".

    Raises:
        UsageError: a text is not `STAGE.KEY=VALUE`.
    """
    out: dict[str, dict[str, object]] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        stage, dot, name = key.strip().partition(".")
        if not equals or not ((dot and name and stage in STAGES) or (not dot and stage in WHOLE)):
            near = nearest(stage, STAGES if dot else (*STAGES, *WHOLE)) if equals else []
            hint = f"did you mean {near[0]!r}? " if near and stage not in STAGES else ""
            raise UsageError(
                f"--set {text}: expected STAGE.KEY=VALUE, such as ingest.fps=25; {hint}stages: {', '.join(STAGES)}, "
                f"and {', '.join(WHOLE)} alone"
            )
        read = parse_yaml(f"value: {value}", f"--set {key}", dict)["value"]
        out.setdefault(stage if dot else "", {})[name if dot else stage] = read
    for stage, values in out.items():
        known = known_keys(stage, values) if stage else ()
        for key in values if known else ():
            if key not in known:
                raise UsageError(
                    f"--set {stage}.{key}: unknown key; {did_you_mean(key, known, owner=stage)}", id="unknown-key"
                )
    return out


def as_text(made: Choices, unused: Sequence[str], folder: Path) -> str:
    """Return the configuration as YAML text, with its choices as comments.

    Paths are relative to the run folder. `unused`: lines about files that are not used.
    """
    stages = list(dict.fromkeys([*made.values, *made.given]))
    values: dict[str, object] = {"occlog_run": 1}
    whole = {**made.values.get("", {}), **made.given.get("", {})}
    values |= {key: _plain(value, folder) for key, value in whole.items()}
    for stage in sorted((s for s in stages if s), key=STAGES.index):
        own = {**made.values.get(stage, {}), **_relative(made.given.get(stage, {}))}
        values[stage] = {key: _plain(value, folder) for key, value in own.items()}
    lines = [f"# {line}" for line in (*map(str, made.lines), *unused)]
    head = ["# Written by `occlog start`; `occlog run` runs it. Each choice, and the option that changes it:", *lines]
    body = yaml.safe_dump(values, sort_keys=False, allow_unicode=True, default_flow_style=False, width=1000)
    return "\n".join(head) + "\n" + body


def _relative(given: Mapping[str, object]) -> dict[str, object]:
    """Return a copy of the user's values in which texts that name existing files are paths."""
    return {key: Path(v) if isinstance(v, str) and Path(v).exists() else v for key, v in given.items()}


def _plain(value: object, folder: Path) -> object:
    if isinstance(value, Path):
        return _from(value, folder)
    if isinstance(value, Mapping):
        return {str(key): _plain(each, folder) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each, folder) for each in value]
    if isinstance(value, str) and "=" in value:
        name, _, path = value.partition("=")
        return f"{name}={_from(Path(path), folder)}" if Path(path).exists() else value
    return value


def _from(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
