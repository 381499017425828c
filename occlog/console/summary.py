"""Summaries on standard output, and exit codes."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping
from typing import Protocol, TypeGuard

from occlog.console.notes import note_losses, write_line
from occlog.errors import ExitCode


class InWords(list[object]):
    """A value of a summary with two forms: a list for `--json`, and a text for people."""

    def __init__(self, values: Iterable[object], words: str) -> None:
        """Store the values of the list, and the text `words` that the summary prints in their stead."""
        super().__init__(values)
        self.words = words


class ListedLoss(Protocol):
    """Interface of a loss of data (a damaged part of an input) in the list of a summary."""

    def as_dict(self) -> Mapping[str, object]:
        """Return the loss as a JSON object."""


FROM_WHOLE, TO_WHOLE = 1e4, 1e15
"""Numbers of this size are reported as whole ones: four digits of them would need a power of ten."""


def echo_summary(summary: Mapping[str, object], as_json: bool) -> None:
    """Print the summary on standard output: one JSON object if `as_json`, else lines of text (`lines_of`)."""
    for line in lines_of(summary, as_json):
        write_line(line, sys.stdout)


def lines_of(summary: Mapping[str, object], as_json: bool, first: Iterable[str] = ()) -> list[str]:
    """Return the lines of a summary: `key: value` for people, or one JSON object if `as_json`.

    Keys of the object are sorted, after those in `first`.
    """
    if as_json:
        plain = json.loads(json.dumps(_plain(summary), sort_keys=True))
        return [json.dumps({key: plain[key] for key in first if key in plain} | plain)]
    shown = {k: v for k, v in summary.items() if k not in ("plausible", "warnings")}
    if "plausible" in summary:
        shown["plausible"] = plausible_in_words(summary)
    width, out = max((len(k) for k in shown), default=0), list[str]()
    for key, value in shown.items():
        if isinstance(value, list | tuple | dict) and not value:
            continue
        # Mappings of mappings, of each camera for instance, take a line each
        lines = [f"{k}: {_in_words(v)}".rstrip() for k, v in value.items()] if _nested(value) else [_shown(value)]
        for n, line in enumerate(lines):
            head = "" if n else f"{key.replace('_', ' ')}:"
            out.append(f"{head:<{width + 2}}{line}")
    return out


def _nested(value: object) -> TypeGuard[dict[object, object]]:
    return isinstance(value, dict) and any(isinstance(each, dict) for each in value.values())


def _in_words(figures: object) -> str:
    """Return the figures of one item of several (a camera, for example) as text: names with values."""
    if not isinstance(figures, dict):
        return _shown(figures)
    return ", ".join(f"{str(key).replace('_', ' ')} {_shown(value)}" for key, value in figures.items())


def _shown(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}" if not FROM_WHOLE <= abs(value) < TO_WHOLE else f"{value:.0f}"
    if isinstance(value, InWords):
        return value.words
    if isinstance(value, dict):
        return ", ".join(f"{k} {_shown(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(_shown(v) for v in value)
    return str(value)


def _plain(value: object) -> object:
    """Return a value for JSON: paths and other objects as text, NaN and infinities as None."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float) and (value != value or value in (float("inf"), float("-inf"))):
        return None
    return value if isinstance(value, str | int | float | bool | type(None)) else str(value)


def plausible_in_words(summary: Mapping[str, object]) -> str:
    """Return the verdict of a summary as text: yes, or no with the ids of its warnings by stage."""
    if summary["plausible"] is None:
        return "not known (no check could be made)"
    if summary["plausible"]:
        return "yes"
    warnings = summary.get("warnings")
    by_stage: dict[str, dict[str, dict[str, None]]] = {}
    for each in warnings if isinstance(warnings, list) else []:
        sensors = by_stage.setdefault(each.get("stage", ""), {}).setdefault(each["id"], {})
        sensors.update(dict.fromkeys(each.get("sensors", ())))
    parts = []
    for stage, codes in by_stage.items():
        statement = ", ".join(" ".join([code, *sensors]) for code, sensors in codes.items())
        parts.append(f"{stage}: {statement}" if stage else statement)
    return f"no ({'; '.join(parts)})"


def strict_code(code: int, plausible: object, strict: bool) -> int:
    """Return the exit code `code`, or 6 if --strict was given and `plausible` is False (None: unknown)."""
    return ExitCode.THRESHOLD if strict and plausible is False else code


def finish(
    summary: Mapping[str, object], losses: Iterable[ListedLoss], as_json: bool, earlier: Iterable[ListedLoss] = ()
) -> int:
    """Print the summary and list the data losses; return exit code 0, or 3 if anything was lost by this command.

    Args:
        summary: figures by name.
        losses: of this command.
        as_json: print one JSON object, which includes the losses.
        earlier: losses when the inputs were made; in JSON they are listed as `lost_earlier`.
    """
    lost, before = list(losses), [loss.as_dict() for loss in earlier]
    listed = {"losses": [loss.as_dict() for loss in lost], **({"lost_earlier": before} if before else {})}
    echo_summary({**summary, **listed} if as_json else summary, as_json)
    note_losses(lost)
    return ExitCode.LOSSY if lost else ExitCode.DONE
