"""The first finding or refusal of `ingest`, `track` and `evaluate` of a set-up, and whether it is right."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Iterable
from datetime import datetime
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import occlog

WARNING, ROTATED, SWITCHES = "warning: ", "is rotated from its calibration", "identity-switches-likely"
MIN_SWITCHES_SHARE = 0.25
"""Share of the stated identity switches that happen, from which it is right to state them."""


NUMBER = re.compile(r"about ([0-9.]+) ")


class Said(NamedTuple):
    """A warning, or the error of a stage that refuses its input (id `refused`)."""

    stage: str
    id: str
    text: str
    sensors: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.stage}: {self.id}: {', '.join(self.sensors)}: {self.text}"


DATE = re.compile(r"\d{4}-\d\d-\d\dT[\d:.]+Z")
QUANTITY = re.compile(r"([-+]?\d[\d.]*(?:e[-+]?\d+)?)(?= (?:to [-+\d.e]+ )?(?:s|ppm|times|lost|frames|messages)\b)")
MAX_SIZE_ERROR = 0.05
"""Relative error of the size of a fault that counts as named."""


class Answer(NamedTuple):
    """What a set-up must be answered with.

    Attributes:
        cause: regular expression that id or text must match.
        sensors: one of them must be named; empty: any.
        size: of the fault [s, ppm, or a factor or count], within `MAX_SIZE_ERROR`; NaN: need not be named.
        slack: by how much the size [s], or the difference of two times that are named, may differ from it besides.
        similar: another size that is as good, or its inverse; NaN: none is.
    """

    cause: str
    sensors: tuple[str, ...] = ()
    size: float = math.nan
    slack: float = 0.0
    similar: float = math.nan

    def fits(self, said: Said) -> bool:
        """Whether a warning or refusal names the cause, the sensor, and the size or two times that differ by it."""
        named = not self.sensors or any(re.search(rf"\b{re.escape(name)}\b", str(said)) for name in self.sensors)
        return named and re.search(self.cause, f"{said.id}: {said.text}") is not None and self._sized(said.text)

    def _sized(self, text: str) -> bool:
        if math.isnan(self.size):
            return True
        dates = [datetime.fromisoformat(each).timestamp() for each in DATE.findall(text)]
        sizes = [float(each) for each in QUANTITY.findall(DATE.sub("", text))]
        apart = [abs(a - b) for a, b in combinations([*dates, *sizes], 2)]
        wanted = (self.size, self.similar, 1.0 / self.similar)
        return any(abs(abs(each) - size) <= MAX_SIZE_ERROR * size for each in sizes for size in wanted) or any(
            abs(abs(each) - self.size) <= MAX_SIZE_ERROR * self.size + self.slack for each in (*apart, *sizes)
        )


def warned(stage: str, result: Any) -> list[Said]:
    """Warnings of a result, in their order: notes that are warnings, findings, and notes on rotated cameras."""
    summary = result.summary
    notes = [str(n).removeprefix(WARNING) for n in summary.get("notes", ()) if str(n).startswith(WARNING)]
    found = [
        Said(each["stage"], each["id"], each["message"], tuple(each.get("sensors", ())))
        for each in summary.get("warnings", ())
        if each["stage"] == stage
    ]
    rotated = [text for text in getattr(result, "notes", ()) if ROTATED in text]
    return [*(Said(stage, "note", text) for text in notes), *found, *(Said(stage, "note", text) for text in rotated)]


def answers(stages: Iterable[tuple[str, Callable[[], Any]]]) -> list[Said]:
    """Run the stages of a set-up up to one that refuses; all warnings, and the refusal."""
    out: list[Said] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, stage in stages:
            try:
                out += warned(name, stage())
            except occlog.OcclogError as error:
                out.append(Said(name, "refused", str(error)))
                break
    return out


def people(files: dict[str, Any], true: Path, fps: float, seed: int = 0) -> list[Said]:
    """The answers to files of a rig: `ingest`, `track --method jipda`, `evaluate` if there is a truth.

    Identity switches that happen, by the true positions in `true`, are no warning of the set-up.
    """
    made: dict[str, Any] = {}

    def ingest() -> Any:
        made["recording"] = occlog.ingest(**files)
        return made["recording"]

    def track() -> Any:
        made["tracks"] = occlog.track(made["recording"], method="jipda", seed=seed)
        return made["tracks"]

    def evaluate() -> Any:
        return occlog.evaluate(made["tracks"], made["recording"])

    stages = [("ingest", ingest), ("track", track), *([("evaluate", evaluate)] if "truth" in files else [])]
    said = answers(stages)
    numbers = [NUMBER.search(each.text) for each in said if each.id == SWITCHES]
    stated = max((float(number[1]) for number in numbers if number is not None), default=0.0)
    if stated:
        try:
            found = occlog.evaluate(made["tracks"], true, fps=fps).metrics["id_switches"]
        except occlog.OcclogError:
            found = 0.0
        if found >= max(MIN_SWITCHES_SHARE * stated, 1.0):
            said = [each for each in said if each.id != SWITCHES]
    return said
