"""Findings in files: their kinds, and the list of those found."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from enum import StrEnum
from typing import Any, NamedTuple

from occlog.errors import ExitCode

MAX_LISTED_FINDINGS = 10
"""Findings of one kind and file that are listed one by one; further ones are counted."""


class Severity(StrEnum):
    """Severity of a finding: the reaction of a command that reads the file."""

    ERROR = "error"
    """The command stops, and states it (exit code 4)."""
    WARNING = "warning"
    """The command goes on: something is lost, or its result may be wrong."""
    NOTE = "note"
    """Worth knowing."""


EXIT_CODES = {Severity.ERROR: ExitCode.BAD_INPUT, Severity.WARNING: ExitCode.LOSSY, Severity.NOTE: ExitCode.DONE}
"""The exit code of the worst finding; without any it is 0."""


class FindingKind(NamedTuple):
    """A kind of findings.

    Attributes:
        severity: how bad it is.
        what: the fault, in words.
        limit: up to where it would not be; empty: none can be stated, or the value states it.
        remedy: what to do; empty: the value states it.
    """

    severity: Severity
    what: str
    limit: str = ""
    remedy: str = ""


E, W, N = Severity.ERROR, Severity.WARNING, Severity.NOTE
GAP_INTERVALS = 2.5
"""An interval of more than this many usual ones is a gap."""
KINDS: dict[str, FindingKind] = {
    "unreadable": FindingKind(E, "cannot be read"),
    "unknown": FindingKind(
        W, "not a file that occlog can read", remedy="name a recording, a table, a scene or a video"
    ),
    "no-table": FindingKind(N, "fits none of occlog's tables"),
    "not-looked-at": FindingKind(W, "not checked", remedy="name the files, or a folder with fewer"),
    "damaged-recording": FindingKind(E, "damaged", remedy="salvage it: occlog recover {file} -o OUT.mcap"),
    "no-index": FindingKind(
        N,
        "no index, or an incomplete one: each command rebuilds it in a pass through the file",
        remedy="write one: occlog recover {file} -o OUT.mcap",
    ),
    "damaged-table": FindingKind(E, "damaged rows"),
    "damaged-bag": FindingKind(W, "lost; `occlog ingest` lists it", remedy="copy it again, if it is whole elsewhere"),
    "miscounted": FindingKind(N, "more messages than its metadata count; `occlog ingest` reads all"),
    "message": FindingKind(E, "a message that does not match its type", remedy="make the recording again"),
    "row": FindingKind(E, "invalid row"),
    "repeated-row": FindingKind(E, "duplicate rows", "once", "remove the copies"),
    "two-places": FindingKind(E, "a person in two positions at one time", "one row", "keep one of them"),
    "double-key": FindingKind(W, "rows of one key with different values", "one row", "keep one of them"),
    "order": FindingKind(E, "a time before the preceding one", "increasing times", "sort by time"),
    "restart": FindingKind(
        W,
        "times of a sensor or an identity that go back, in file order",
        "increasing times",
        "rows are read in the order of time: if a clock was set or restarted, give each run its own file",
    ),
    "repeated-time": FindingKind(E, "a repeated time", "increasing times", "give each frame its own time"),
    "left-out": FindingKind(
        W, "a header stamp that repeats or goes back", "increasing times", "`occlog ingest` skips it"
    ),
    "lost-message": FindingKind(W, "a message that does not match its type", remedy="`occlog ingest` skips it"),
    "undecoded": FindingKind(N, "messages that were not decoded: only their recording times were checked"),
    "linked-video": FindingKind(E, "its video cannot be used"),
    "image": FindingKind(W, "an image that cannot be decoded", remedy="its frame is lost; ingest the source again"),
    "video-frames": FindingKind(W, "lost frames", remedy="copy or repair the file"),
    "sound": FindingKind(W, "lost samples", remedy="copy or repair the file"),
    "uneven-video": FindingKind(
        N, "frames at uneven times", remedy="keep its time stamps: give no frame rate (ingest --fps) for it"
    ),
    "doubt": FindingKind(W, "may be wrong"),
    "losses": FindingKind(N, "lost when it was made"),
    "epoch-unit": FindingKind(
        W, "times in another unit than stated", remedy="name the column after its unit, or multiply"
    ),
    "epoch": FindingKind(W, "times outside 1970 to 2100", remedy="give the origin of the times"),
    "gap": FindingKind(
        W, "no data", f"{GAP_INTERVALS:g} usual intervals", "expect no estimates of this time by this sensor"
    ),
    "jump": FindingKind(
        W,
        "a clock jump: the frame numbers continue",
        f"{GAP_INTERVALS:g} usual intervals",
        "take the times of another clock",
    ),
    "clock-apart": FindingKind(
        W, "times far from those of the other sensors", remedy="give an offset (ingest --offset)"
    ),
    "truth-apart": FindingKind(
        W,
        "a truth without a time in common with the sensors",
        remedy="ingest it again with times of the same origin (ingest --start-time)",
    ),
    "clock-late": FindingKind(
        W,
        "starts and ends later than the others by the same time (earlier, if negative)",
        f"{GAP_INTERVALS:g} usual intervals",
        "if its clock is off, give an offset (ingest --offset)",
    ),
    "two-clocks": FindingKind(
        W, "recorded at other times than its header stamps state", remedy="choose one: ingest --stamp"
    ),
}
"""Every kind of findings, by the name that it has in JSON."""


class Finding(NamedTuple):
    """Something that is wrong.

    Attributes:
        kind: one of `KINDS`.
        file: the file, as it was named.
        place: where in it: byte, line, row, sensor and time; empty: in the whole of it.
        value: value found.
        limit: what may be there; empty: that of the kind.
        places: how many positions are like this one, itself included.
    """

    kind: str
    file: str
    place: str
    value: str
    limit: str = ""
    places: int = 1

    @property
    def severity(self) -> Severity:
        """Severity of the kind."""
        return KINDS[self.kind].severity

    def as_dict(self) -> dict[str, Any]:
        """The finding as JSON-ready values."""
        kind = KINDS[self.kind]
        return {
            "severity": str(kind.severity),
            "kind": self.kind,
            "file": self.file,
            "place": self.place or None,
            "what": kind.what,
            "value": self.value or None,
            "limit": self.limit or kind.limit or None,
            "remedy": kind.remedy.format(file=self.file) or None,
            "count": self.places,
        }

    def __str__(self) -> str:
        said = self.as_dict()
        place = f" {self.place}:" if self.place else ""
        more = f" (and {self.places - 1} more like it)" if self.places > 1 else ""
        limit = f"; limit: {said['limit']}" if said["limit"] else ""
        remedy = f"; {said['remedy']}" if said["remedy"] else ""
        value = f": {self.value}" if self.value else ""
        return f"{self.severity}: {self.file}:{place} {said['what']}{value}{more}{limit}{remedy}"


_PLACE = re.compile(r"^((?:among )?(?:line|rows?|entry|after line|byte) [\d andto]*\d)(?: \(from 0\))?: ")
_VALUE = re.compile(r"'[^']*'|[-+]?\d[\d.]*(?:e[-+]?\d+)?")


class Findings:
    """The findings of one file; those that differ in location and numbers alone are counted together."""

    def __init__(self, file: str) -> None:
        """Create an empty list of findings."""
        self._file = file
        self._found: dict[tuple[str, str], Finding] = {}
        self._kinds: dict[str, int] = {}

    def add(self, kind: str, place: str, value: str, *, limit: str = "", count: int = 1, alike: str = "") -> None:
        """Note a finding.

        Args:
            kind: one of `KINDS`.
            place: where it is.
            value: value found.
            limit: what may be there, if the kind does not state it.
            count: how many locations it represents.
            alike: what findings have in common that are counted as one; empty: each of the first `MAX_LISTED_FINDINGS`
                is listed separately.
        """
        key = (kind, alike or f"{place}\0{value}")
        if key not in self._found and self._kinds.get(kind, 0) >= MAX_LISTED_FINDINGS:
            key = next(each for each in reversed(self._found) if each[0] == kind)
        known = self._found.get(key)
        if known is not None:
            self._found[key] = known._replace(places=known.places + count)
            return
        self._kinds[kind] = self._kinds.get(kind, 0) + 1
        self._found[key] = Finding(kind, self._file, place, value, limit, count)

    def refused(self, kind: str, error: Exception, *, place: str = "", count: int = 1) -> None:
        """Note a reader's message on a position; equal messages on other positions are counted with it."""
        text = str(error).removeprefix(f"{self._file}: ")
        found = _PLACE.match(text)
        if found is not None:
            place, text = found[1], text[found.end() :]
        self.add(kind, place, text, count=count, alike=_VALUE.sub("#", text))

    def join(self, others: Findings) -> None:
        """Take the findings of another file."""
        for (kind, alike), finding in others._found.items():
            self._found[kind, f"{finding.file}\0{alike}"] = finding
            self._kinds.setdefault(kind, 0)

    def __iter__(self) -> Iterator[Finding]:
        return iter(self._found.values())

    def has(self, *kinds: str) -> bool:
        """Return whether there is a finding of one of the kinds."""
        return any(kind in self._kinds for kind in kinds)


def exit_code(findings: Iterable[Finding]) -> ExitCode:
    """The exit code of the worst of the findings."""
    return max((EXIT_CODES[finding.severity] for finding in findings), default=ExitCode.DONE)


def finding_schema() -> dict[str, object]:
    """JSON Schema of what `occlog doctor --json` prints."""
    text, maybe = {"type": "string"}, {"type": ["string", "null"]}
    count = {"type": "integer", "minimum": 0}
    finding = {
        "severity": {"enum": [str(severity) for severity in Severity]},
        "kind": {"enum": list(KINDS)},
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
