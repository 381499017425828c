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
    """Outcome of one check of a stage's results: its name and status, and of a finding its id, text and figures."""

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
        """Whether the check has a finding (a warning or a note) that the user must know."""
        return bool(self.id)

    @property
    def severity(self) -> Severity:
        """Severity: `warning` if the check failed; `note` if it passed with a remark."""
        return "warning" if self.status == "failed" else "note"


class Verdict(Struct, frozen=True, omit_defaults=True):
    """All checks of one stage, with their findings, and whether the results are plausible."""

    stage: Annotated[str, Meta(description="The command that made the checks.")]
    plausible: Annotated[bool | None, Meta(description="Whether no check failed; null: no check could be made.")]
    checks: tuple[Check, ...] = ()

    @classmethod
    def of(cls, stage: str, checks: Iterable[Check]) -> Verdict:
        """Build the verdict of a stage from its checks; options in their texts are spelled for the surface in use.

        Of findings with one id the first `MAX_FINDINGS` are kept, and the text of the last of them states how many more
        there were.
        """
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
    """Create a check with a finding: failed if the severity is `warning`, else passed with a remark (`note`).

    Args:
        check: what was checked.
        id: of what was found, in `occlog.records.messages.VERDICT`.
        severity: `warning` if the results are not to be accepted as they are; None: that of the message.
        sensors: names of the affected sensors.
        targets: identities of the affected targets.
        **values: of the fields of the message; finite numbers are also the figures of the check, with the limit as
            `allowed`.
    """
    message, names, ids = VERDICT[id], tuple(sensors), tuple(targets)
    status: Status = "failed" if (severity or message.severity) == "warning" else "passed"
    figures = {name: value for name, value in values.items() if not isinstance(value, str)}
    return Check(check, status, id, message.fill(names, ids, **values), names, ids, _rounded(figures))


def outcome(name: str, findings: Iterable[Check], *, unless: str = "", **figures: float) -> tuple[Check, ...]:
    """The findings of a check or, without any, one check with the status `passed` or `not applicable`.

    Args:
        name: what is checked.
        findings: what is found.
        unless: why the check could not be made; empty: it could be.
        **figures: what was measured, for a check that passed.
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
    """Text with the numbers of checks by outcome, as `3 passed (1 with a note), 1 failed`; `nothing` without checks."""
    made = tuple(checks)
    by_status = Counter(check.status for check in made)
    noted = sum(check.found and check.status == "passed" for check in made)
    parts = [f"{by_status['passed']} passed{f' ({noted} with a note)' if noted else ''}"] if made else ["nothing"]
    parts += [f"{by_status[status]} {status}" for status in ("failed", "not applicable") if by_status[status]]
    return ", ".join(parts)


def findings(checks: Iterable[Check]) -> tuple[Check, ...]:
    """The checks that have findings, in the given order."""
    return tuple(check for check in checks if check.found)


def all_plausible(verdicts: Iterable[Verdict]) -> bool | None:
    """Whether every stage with checks found its results plausible; None without checks."""
    given = [verdict.plausible for verdict in verdicts if verdict.plausible is not None]
    return all(given) if given else None


def distinct(verdicts: Iterable[Verdict]) -> tuple[Verdict, ...]:
    """The verdicts without equal ones, in the order of first appearance."""
    kept: list[Verdict] = []
    for verdict in verdicts:
        if verdict not in kept:
            kept.append(verdict)
    return tuple(kept)


def found_by_stage(verdicts: Sequence[Verdict]) -> tuple[tuple[str, Check], ...]:
    """(stage, check) of all findings; of a finding that a later stage repeats only the last is kept.

    Findings are the same if id, status, sensors and targets are equal.
    """
    kept: list[tuple[str, Check]] = []
    for verdict in verdicts:
        found = findings(verdict.checks)
        again = {_subject(check) for check in found}
        kept = [each for each in kept if _subject(each[1]) not in again] + [(verdict.stage, check) for check in found]
    return tuple(kept)


def _subject(check: Check) -> tuple[str, Status, tuple[str, ...], tuple[int, ...]]:
    """Id, status, sensors and targets of a finding: findings of two stages with equal ones are the same."""
    return check.id, check.status, check.sensors, check.targets


def texts_of(verdicts: Sequence[Verdict], own: str) -> tuple[str, ...]:
    """Lines for the terminal, one per finding.

    They are `SEVERITY: text` for findings of the stage `own`, and `warning: STAGE: text` for failures of other stages.
    A finding repeated by a later stage is listed once.
    """
    return tuple(
        f"{check.severity}: {check.text}" if stage == own else f"warning: {stage}: {check.text}"
        for stage, check in found_by_stage(verdicts)
        if stage == own or check.status == "failed"
    )


def summary_of(verdicts: Sequence[Verdict]) -> dict[str, object]:
    """Entries for a JSON summary: `plausible`, and `warnings` with stage, id, message, sensors, targets and figures.

    Only failed checks are listed; empty without verdicts.
    """
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
    """(stage, check) for each check, in the order in which they were first made.

    If a check was made by several stages, its findings are kept, or else its last result; "not applicable" is kept only
    if no stage could make it.
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
