"""Verdicts: checks of a stage's results and their findings, stored with its outputs (like losses)."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Literal

from msgspec import Meta, Struct
from msgspec.structs import replace

from occlog.errors import spelled

from .messages import VERDICT

Status = Literal["passed", "failed", "not applicable"]
Severity = Literal["warning", "note"]
MAX_FINDINGS = 20
"""Findings of one id that a stored verdict lists; one more check has the number of the others."""


class Check(Struct, frozen=True, omit_defaults=True):
    """A check of a stage's results."""

    name: Annotated[str, Meta(description="What was checked, as words of a list: `track loss`.")]
    status: Annotated[
        Status,
        Meta(description="`failed`: the results are not plausible; `not applicable`: could not be checked."),
    ]
    id: Annotated[str, Meta(description="Id of what was found, the same in all outputs; empty: nothing was.")] = ""
    text: Annotated[
        str,
        Meta(description="What was found, the limit and the remedy; of a check that could not be made, the reason."),
    ] = ""
    sensors: Annotated[tuple[str, ...], Meta(description="Names of the sensors that are affected.")] = ()
    targets: Annotated[tuple[int, ...], Meta(description="Ids of the targets that are affected.")] = ()
    figures: Annotated[
        dict[str, float], Meta(description="What was measured and, as `allowed`, its limit, to six digits.")
    ] = {}

    @property
    def found(self) -> bool:
        """Whether there is a finding that the user must know."""
        return bool(self.id)

    @property
    def severity(self) -> Severity:
        """Severity: `warning` if the check failed; `note` if it passed with a remark."""
        return "warning" if self.status == "failed" else "note"


class Verdict(Struct, frozen=True, omit_defaults=True):
    """Checks of a stage, with findings."""

    stage: Annotated[str, Meta(description="The command that made the checks.")]
    plausible: Annotated[bool | None, Meta(description="Whether no check failed; null: no check could be made.")]
    checks: tuple[Check, ...] = ()

    @classmethod
    def of(cls, stage: str, checks: Iterable[Check]) -> Verdict:
        """Verdict of a stage; of findings with one id, the first `MAX_FINDINGS` are listed."""
        kept: list[Check] = []
        of_id: dict[str, list[Check]] = {}
        for check in checks:
            same = of_id.setdefault(check.id, [])
            same.append(check)
            if not check.found or len(same) <= MAX_FINDINGS:
                kept.append(replace(check, text=spelled(check.text)))
        for same in of_id.values():
            if same[0].found and len(same) > MAX_FINDINGS:
                last = max(n for n, check in enumerate(kept) if check.id == same[0].id)
                more = f"; and {len(same) - MAX_FINDINGS} more findings of this kind"
                kept[last] = replace(kept[last], text=kept[last].text + more)
        return cls(stage, plausible(kept), tuple(kept))


def finding(
    check: str,
    id: str,
    /,
    severity: Severity | None = None,
    *,
    sensors: Iterable[str] = (),
    targets: Iterable[int] = (),
    **values: float | str,
) -> Check:
    """Create a failed check (`warning`), or a passed one with a remark (`note`).

    Args:
        check: what was checked.
        id: of what was found, in `occlog.records.messages.VERDICT`.
        severity: `warning` if the results are not to be accepted as they are; None: that of the message.
        sensors: names of those that are affected.
        targets: ids of those that are affected.
        **values: of the fields of the message; numbers are also the figures of the check, with the limit as `allowed`,
            unless they are not finite.
    """
    message, names, ids = VERDICT[id], tuple(sensors), tuple(targets)
    status: Status = "failed" if (severity or message.severity) == "warning" else "passed"
    figures = {name: value for name, value in values.items() if not isinstance(value, str)}
    return Check(check, status, id, message.fill(names, ids, **values), names, ids, _rounded(figures))


def outcome(name: str, findings: Iterable[Check], *, unless: str = "", **figures: float) -> tuple[Check, ...]:
    """Findings of a check; without any, the check itself as passed.

    Args:
        name: what is checked.
        findings: what is found.
        unless: why the check could not be made; empty: it could be.
        **figures: what was measured.
    """
    found = tuple(findings)
    if found:
        return found
    if unless:
        return (Check(name, "not applicable", text=unless),)
    return (Check(name, "passed", figures=_rounded(figures)),)


def _rounded(figures: Mapping[str, float]) -> dict[str, float]:
    """Round finite figures to six significant digits, so that they do not depend on the order of summation."""
    return {name: float(f"{value:.6g}") for name, value in figures.items() if math.isfinite(value)}


def plausible(checks: Iterable[Check]) -> bool | None:
    """Whether no check failed; None if none could be made."""
    made = [check.status for check in checks if check.status != "not applicable"]
    return "failed" not in made if made else None


def counts_of(checks: Iterable[Check]) -> str:
    """Numbers of checks by outcome; `nothing` if there is none."""
    made = tuple(checks)
    by_status = Counter(check.status for check in made)
    noted = sum(check.found and check.status == "passed" for check in made)
    parts = [f"{by_status['passed']} passed{f' ({noted} with a note)' if noted else ''}"] if made else ["nothing"]
    parts += [f"{by_status[status]} {status}" for status in ("failed", "not applicable") if by_status[status]]
    return ", ".join(parts)


def findings(checks: Iterable[Check]) -> tuple[Check, ...]:
    """Those of the checks that have findings, in order."""
    return tuple(check for check in checks if check.found)


def all_plausible(verdicts: Iterable[Verdict]) -> bool | None:
    """Whether every stage with checks found its results plausible; None without checks."""
    given = [verdict.plausible for verdict in verdicts if verdict.plausible is not None]
    return all(given) if given else None


def distinct(verdicts: Iterable[Verdict]) -> tuple[Verdict, ...]:
    """Verdicts without duplicates, in order."""
    kept: list[Verdict] = []
    for verdict in verdicts:
        if verdict not in kept:
            kept.append(verdict)
    return tuple(kept)


def found_by_stage(verdicts: Sequence[Verdict]) -> tuple[tuple[str, Check], ...]:
    """Findings with their stages; of those repeated by a later stage (same sensors and targets) only the last."""
    kept: list[tuple[str, Check]] = []
    for verdict in verdicts:
        found = findings(verdict.checks)
        again = {_subject(check) for check in found}
        kept = [each for each in kept if _subject(each[1]) not in again] + [(verdict.stage, check) for check in found]
    return tuple(kept)


def _subject(check: Check) -> tuple[str, Status, tuple[str, ...], tuple[int, ...]]:
    """Key of a finding: id, status, sensors and targets."""
    return check.id, check.status, check.sensors, check.targets


def texts_of(verdicts: Sequence[Verdict], own: str) -> tuple[str, ...]:
    """Lines for the findings: warnings and notes of the stage `own`, and warnings of other stages with their names.

    A finding repeated by a later stage is listed once.
    """
    return tuple(
        f"{check.severity}: {check.text}" if stage == own else f"warning: {stage}: {check.text}"
        for stage, check in found_by_stage(verdicts)
        if stage == own or check.status == "failed"
    )


def summary_of(verdicts: Sequence[Verdict]) -> dict[str, object]:
    """The verdict for a summary: `plausible`, and `warnings` with stage, id, message, sensors, targets and figures."""
    if not verdicts:
        return {}
    warnings = [
        {
            "stage": stage,
            "id": check.id,
            "message": check.text,
            **({"sensors": list(check.sensors)} if check.sensors else {}),
            **({"targets": list(check.targets)} if check.targets else {}),
            **({"figures": check.figures} if check.figures else {}),
        }
        for stage, check in found_by_stage(verdicts)
        if check.status == "failed"
    ]
    return {"plausible": all_plausible(verdicts), "warnings": warnings}


def made_checks(verdicts: Sequence[Verdict]) -> tuple[tuple[str, Check], ...]:
    """Outcome of each check with its stage, in the order of the stages.

    For a check made by several stages, findings are kept, or else the last result; "not applicable" is kept only if no
    stage could make it.
    """
    by_name: dict[str, list[tuple[str, Check]]] = {}
    for verdict in verdicts:
        for check in verdict.checks:
            by_name.setdefault(check.name, []).append((verdict.stage, check))
    found = found_by_stage(verdicts)
    out: list[tuple[str, Check]] = []
    for name, made in by_name.items():
        findings_of = [each for each in found if each[1].name == name]
        applied = [each for each in made if each[1].status != "not applicable"]
        out += findings_of or [(applied or made)[-1]]
    return tuple(out)
