"""Options that several commands share, so that they mean the same everywhere.

-o, --output PATH      the main output                          all that write
--overwrite            replace outputs that exist               all that write
--scene PATH           scene file, instead of the recording's   detect track evaluate report
--seed N               seed of all random numbers               simulate track run
--json                 the summary as JSON on standard output   all
-v / -q                more / fewer messages                    all
--workers N            threads; the result does not depend on it   detect run
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, TypeGuard, TypeVar

import click

from occlog.details import begin_work, note_files, tell
from occlog.errors import ExitCode, NoSceneError, UsageError
from occlog.words import told

from .first_run import note_quiet
from .input_paths import Input, named
from .interrupts import INTERRUPTS

if TYPE_CHECKING:
    from occlog.records.losses import Loss
    from occlog.records.scene import Scene
    from occlog.records.verdicts import Verdict

F = TypeVar("F", bound=Callable[..., object])
T = TypeVar("T")
PATH = click.Path(path_type=Path)
"""Of an output, a folder or a configuration."""
INPUT = Input()
"""Of an input; `-` is standard input."""

overwrite_opt = click.option("--overwrite", is_flag=True, help="Replace outputs that exist.")
json_opt = click.option("--json", "as_json", is_flag=True, help="Print the summary as one JSON object.")
seed_opt = click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of all random numbers."
)
SCENE_HELP = "Scene file (YAML), a recording that holds one, or a text table of stations."
scene_opt = click.option("--scene", type=INPUT, default=None, help=SCENE_HELP)
STRICT_HELP = "Exit code 6 if warnings say that the estimates are not plausible. Outputs are written all the same."
strict_opt = click.option("--strict", is_flag=True, help=STRICT_HELP)
quiet_opt = click.option(
    "-q", "--quiet", is_flag=True, callback=note_quiet, help="No progress and no notes on standard error."
)
workers_opt = click.option(
    "--workers",
    type=click.IntRange(min=1),
    default=None,
    help="Threads; default: one a processor. The result is the same.",
)


def set_opt(example: str) -> Callable[[F], F]:
    """`--set`, repeated, for settings that have no option of their own."""
    return click.option(
        "--set", "settings", multiple=True, metavar="NAME=VALUE", help=f"A setting, e.g. {example}; may be repeated."
    )


def output_opt(help_text: str, *, required: bool = True) -> Callable[[F], F]:
    """`-o/--output` with its meaning for this command."""
    return click.option("-o", "--output", type=PATH, required=required, help=help_text)


_KEPT: ContextVar[list[str] | None] = ContextVar("kept", default=None)


@contextmanager
def notes_kept() -> Iterator[list[str]]:
    """Keep notes in a list inside the block, those that `quiet` would drop too, and write none on standard error."""
    kept: list[str] = []
    token = _KEPT.set(kept)
    try:
        yield kept
    finally:
        _KEPT.reset(token)


def note(message: str, quiet: bool = False) -> None:
    """A line on standard error, or in the list of `notes_kept`."""
    kept = _KEPT.get()
    if kept is not None:
        kept.append(message)
    elif not quiet:
        click.echo(f"occlog: {told(named(message))}", err=True)


def progress(items: Iterable[T], label: str, total: int | None = None, *, quiet: bool = False) -> Iterator[T]:
    """The items, with a progress bar on standard error when that is a terminal.

    Raises:
        KeyboardInterrupt: there was an interrupt that got lost.
    """
    begin_work()
    start, count = time.perf_counter(), 0
    if not quiet and sys.stderr.isatty():
        from tqdm import tqdm

        items = tqdm(items, desc=label, total=total, file=sys.stderr, leave=False)
    for item in items:
        INTERRUPTS.check()
        count += 1
        yield item
    tell(f"{label}: {count} parts in {time.perf_counter() - start:.2f} s")


FROM_WHOLE, TO_WHOLE = 1e4, 1e15
"""Numbers of this size are told as whole ones: four digits of them would need a power of ten."""


def echo_summary(summary: Mapping[str, object], as_json: bool) -> None:
    """The result on standard output: one JSON object, or `key: value` lines for a person."""
    if as_json:
        click.echo(json.dumps(_plain(summary), sort_keys=True))
        return
    shown = {k: v for k, v in summary.items() if k not in ("plausible", "warnings")}
    if "plausible" in summary:
        shown["plausible"] = plausible_in_words(summary)
    width = max((len(k) for k in shown), default=0)
    for key, value in shown.items():
        if isinstance(value, list | tuple | dict) and not value:
            continue
        # Mappings of mappings, of each camera for instance, take a line each
        lines = [f"{k}: {_in_words(v)}".rstrip() for k, v in value.items()] if _nested(value) else [_shown(value)]
        for n, line in enumerate(lines):
            head = "" if n else f"{key.replace('_', ' ')}:"
            click.echo(f"{head:<{width + 2}}{line}")


def _nested(value: object) -> TypeGuard[dict[object, object]]:
    return isinstance(value, dict) and any(isinstance(each, dict) for each in value.values())


def _in_words(figures: object) -> str:
    """What is said of one of many; the keys are our words."""
    if not isinstance(figures, dict):
        return _shown(figures)
    return ", ".join(f"{str(key).replace('_', ' ')} {_shown(value)}" for key, value in figures.items())


def _shown(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}" if not FROM_WHOLE <= abs(value) < TO_WHOLE else f"{value:.0f}"
    if isinstance(value, dict):
        return ", ".join(f"{k} {_shown(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(_shown(v) for v in value)
    return str(value)


def _plain(value: object) -> object:
    """JSON-ready: paths as text, NaN as null."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float) and (value != value or value in (float("inf"), float("-inf"))):
        return None
    return value if isinstance(value, str | int | float | bool | type(None)) else str(value)


def plausible_in_words(summary: Mapping[str, object]) -> str:
    """The verdict of a summary in a few words: yes, or no with the ids of its warnings, stage by stage."""
    if summary["plausible"] is None:
        return "not known (no check could be made)"
    if summary["plausible"]:
        return "yes"
    warnings = summary.get("warnings")
    by_stage: dict[str, dict[str, dict[str, None]]] = {}
    for each in warnings if isinstance(warnings, list) else []:
        sensors = by_stage.setdefault(each.get("stage", ""), {}).setdefault(each["code"], {})
        sensors.update(dict.fromkeys(each.get("sensors", ())))
    parts = []
    for stage, codes in by_stage.items():
        said = ", ".join(" ".join([code, *sensors]) for code, sensors in codes.items())
        parts.append(f"{stage}: {said}" if stage else said)
    return f"no ({'; '.join(parts)})"


def note_verdicts(verdicts: Sequence[Verdict], own: str, quiet: bool = False) -> None:
    """What was found against estimates, in a line each on standard error.

    Args:
        verdicts: of a stage and of those before it.
        own: the command that runs now; see `texts_of`.
        quiet: print nothing.
    """
    from occlog.records.verdicts import texts_of

    for text in texts_of(verdicts, own):
        note(text, quiet)


def strict_code(code: int, plausible: object, strict: bool) -> int:
    """The exit code, or 6 where estimates are not plausible and --strict was given; None: not known."""
    return ExitCode.THRESHOLD if strict and plausible is False else code


def note_losses(losses: Iterable[Loss]) -> None:
    """What was lost, in a line each on standard error."""
    for loss in losses:
        click.echo(told(named(" ".join(f"occlog: lost: {loss}".split()))), err=True)


def finish(summary: Mapping[str, object], losses: Iterable[Loss], as_json: bool) -> int:
    """Print the summary and list what was lost; exit code 0, or 3 if anything was."""
    lost = list(losses)
    echo_summary({**summary, "losses": [loss.as_dict() for loss in lost]} if as_json else summary, as_json)
    note_losses(lost)
    return ExitCode.LOSSY if lost else ExitCode.DONE


def check_outputs(inputs: Iterable[Path | None], outputs: Iterable[Path | None], overwrite: bool) -> None:
    """Refuse outputs that exist, that are also inputs, or that are named twice, before any work is done."""
    from occlog.io.files.atomic import check_writable

    wanted = [Path(p) for p in outputs if p is not None]
    read = [Path(p) for p in inputs if p is not None]
    used = {os.path.realpath(p) for p in read}  # Path.resolve fails on a link to itself
    for n, path in enumerate(wanted):
        if os.path.realpath(path) in used:
            raise UsageError(f"{path}: is an input too; give the output another name")
        if os.path.realpath(path) in {os.path.realpath(p) for p in wanted[:n]}:
            raise UsageError(f"{path}: is named for two outputs; give each its own name")
        check_writable(path, overwrite)
    note_files(read, wanted)


def load_scene(scene: Path | None, recording: Scene | None, where: Path) -> Scene:
    """The scene of `--scene` (YAML, or a recording that holds one), or else `recording`, that of the input."""
    if scene is not None:
        from occlog.io.open import scene_in

        found = scene_in(scene)
        if found is None:
            raise NoSceneError(scene)
        return found
    if recording is None:
        raise NoSceneError(where)
    return recording
