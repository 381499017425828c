"""Findings in files, with their messages, and lists of findings."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from occlog.errors import ExitCode
from occlog.records.messages import DOCTOR, Severity

MAX_LISTED_FINDINGS = 10
"""Findings of one kind and file that are listed one by one; further ones are counted."""


EXIT_CODES = {Severity.ERROR: ExitCode.BAD_INPUT, Severity.WARNING: ExitCode.LOSSY, Severity.NOTE: ExitCode.DONE}
"""The exit code of the worst finding; without any it is 0."""


class Finding(NamedTuple):
    """A fault in a file.

    Attributes:
        kind: key of the message table `DOCTOR`.
        file: name of the file as given by the user.
        location: byte, line, row, sensor or time; empty: the whole file.
        value: value found.
        limit: permitted values; empty: those of the kind.
        n_locations: number of locations with this fault, this one included.
    """

    kind: str
    file: str
    location: str
    value: str
    limit: str = ""
    n_locations: int = 1

    @property
    def severity(self) -> Severity:
        """Severity of this kind of finding: error, warning or note."""
        return DOCTOR[self.kind].severity

    def as_dict(self) -> dict[str, Any]:
        """Return the finding as values for JSON; None for what is not stated."""
        kind = DOCTOR[self.kind]
        return {
            "severity": str(kind.severity),
            "kind": self.kind,
            "file": self.file,
            "place": self.location or None,
            "what": kind.text,
            "value": self.value or None,
            "limit": self.limit or kind.limit or None,
            "remedy": kind.remedy.format(file=self.file) or None,
            "count": self.n_locations,
        }

    def __str__(self) -> str:
        reported = self.as_dict()
        location = f" {self.location}:" if self.location else ""
        more = f" (and {self.n_locations - 1} more like it)" if self.n_locations > 1 else ""
        limit = f"; limit: {reported['limit']}" if reported["limit"] else ""
        remedy = f"; {reported['remedy']}" if reported["remedy"] else ""
        value = f": {self.value}" if self.value else ""
        return f"{self.severity}: {self.file}:{location} {reported['what']}{value}{more}{limit}{remedy}"


_PLACE = re.compile(r"^((?:among )?(?:line|rows?|entry|after line|byte) [\d andto]*\d)(?: \(from 0\))?: ")
_VALUE = re.compile(r"'[^']*'|[-+]?\d[\d.]*(?:e[-+]?\d+)?")


class Findings:
    """Findings in one file; those that differ only in location and numbers are counted together."""

    def __init__(self, file: str) -> None:
        """Create an empty list of findings in the file of this name."""
        self._file = file
        self._found: dict[tuple[str, str], Finding] = {}
        self._kinds: dict[str, int] = {}

    def add(self, kind: str, location: str, value: str, *, limit: str = "", count: int = 1, similar: str = "") -> None:
        """Add a finding.

        Args:
            kind: key of the message table `DOCTOR`.
            location: byte, line, row, sensor or time.
            value: value found.
            limit: permitted values, if the kind does not state them.
            count: number of locations it represents.
            similar: findings of a kind with an equal text are counted as one; empty: each of the first
                `MAX_LISTED_FINDINGS` is listed separately.
        """
        key = (kind, similar or f"{location}\0{value}")
        if key not in self._found and self._kinds.get(kind, 0) >= MAX_LISTED_FINDINGS:
            key = next(each for each in reversed(self._found) if each[0] == kind)
        known = self._found.get(key)
        if known is not None:
            self._found[key] = known._replace(n_locations=known.n_locations + count)
            return
        self._kinds[kind] = self._kinds.get(kind, 0) + 1
        self._found[key] = Finding(kind, self._file, location, value, limit, count)

    def refused(self, kind: str, error: Exception, *, location: str = "", count: int = 1) -> None:
        """Add a finding with the text of a reader's error.

        Errors that differ in numbers only are counted with the first.

        Args:
            kind: key of the message table `DOCTOR`.
            error: its text may begin with file and location, which are removed.
            location: used if the text states none.
            count: number of faults.
        """
        text = str(error).removeprefix(f"{self._file}: ")
        found = _PLACE.match(text)
        if found is not None:
            location, text = found[1], text[found.end() :]
        self.add(kind, location, text, count=count, similar=_VALUE.sub("#", text))

    def join(self, others: Findings) -> None:
        """Add the findings of another file to these, in place."""
        for (kind, similar), finding in others._found.items():
            self._found[kind, f"{finding.file}\0{similar}"] = finding
            self._kinds.setdefault(kind, 0)

    def __iter__(self) -> Iterator[Finding]:
        return iter(self._found.values())

    def has(self, *kinds: str) -> bool:
        """Return whether there is a finding of one of these kinds."""
        return any(kind in self._kinds for kind in kinds)


def exit_code(findings: Iterable[Finding]) -> ExitCode:
    """Return the exit code of the worst finding; `DONE` without any."""
    return max((EXIT_CODES[finding.severity] for finding in findings), default=ExitCode.DONE)


def finding_schema() -> dict[str, object]:
    """Return the JSON Schema of the output of `occlog doctor --json`."""
    text, maybe = {"type": "string"}, {"type": ["string", "null"]}
    count = {"type": "integer", "minimum": 0}
    finding = {
        "severity": {"enum": [str(severity) for severity in Severity]},
        "kind": {"enum": list(DOCTOR)},
        "file": text | {"description": "as it was named, with the folder in which it was found"},
        "place": maybe | {"description": "byte, line, row, sensor and time; null: the whole file"},
        "what": text,
        "value": maybe | {"description": "value found"},
        "limit": maybe | {"description": "what may be there"},
        "remedy": maybe | {"description": "what to do; null where the value states it"},
        "count": count | {"description": "positions like this one, itself included"},
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "occlog doctor: findings",
        "type": "object",
        "properties": {
            "files": count | {"description": "files that were checked"},
            "others": {
                "type": "object",
                "additionalProperties": count,
                "description": "files of folders that occlog does not know, by the ending of their names",
            },
            "errors": count,
            "warnings": count,
            "notes": count,
            "findings": {"type": "array", "items": _object(finding)},
        },
        "required": ["files", "others", "errors", "warnings", "notes", "findings"],
        "additionalProperties": False,
    }


def _object(properties: dict[str, Any]) -> dict[str, object]:
    return {"type": "object", "properties": properties, "required": list(properties), "additionalProperties": False}
