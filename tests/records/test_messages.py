"""The table of messages: its ids, the lengths of its texts, and their uses in the code."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from string import Formatter

from places import ROOT

from occlog.errors import spelled
from occlog.records.messages import DOCTOR, VERDICT, Message

MAX_CHARACTERS = 160
TYPICAL = {"sensors": "camera 12", "targets": "12", "time": "2023-11-14T22:13:20.100Z", "file": "west/tracks.parquet"}
TYPICAL |= {"recording": "walk-12.mcap", "warning": "track: camera-inconsistent", "what": "the bearings of camera 12"}
TYPICAL |= {"does": "does what mipf does, with colours that adapt", "other": "camera 3", "microphones": "1, 2"}
TYPICAL |= {"method": "idmot", "unit": "m"}
NUMBERS = {"%": "100%", "d": "12345", "g": "0.123", "f": "12.3", "": "12345"}


def typical(message: Message) -> str:
    """The text and the remedy of a message with typical values."""
    out = ""
    for text, name, spec, _ in Formatter().parse(f"{message.text}; {message.remedy}".removesuffix("; ")):
        out += text
        if name is not None and name.startswith("option["):
            out += "--" + name[len("option[") : -1]
        elif name is not None:
            out += TYPICAL.get(name) or NUMBERS[(spec or "")[-1:]]
    return out


def stated_ids() -> Iterator[tuple[str, str]]:
    """Calls that report a finding with an id in quotes: the function, and the id."""
    for path in (ROOT / "occlog").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if "finding" in text else ():
            name = getattr(node.func, "id", getattr(node.func, "attr", "")) if isinstance(node, ast.Call) else ""
            if name not in ("finding", "_of_boxes", "depleted_particles") and not (
                name in ("add", "refused") and "doctor" in path.parts
            ):
                continue
            for argument in node.args[: 1 if name in ("add", "refused") else 2]:
                for each in ast.walk(argument):
                    if isinstance(each, ast.Constant) and re.fullmatch(r"[a-z]+(-[a-z]+)*", str(each.value)):
                        yield name, str(each.value)


def test_ids_are_unique_and_in_kebab_case() -> None:
    assert VERDICT.keys().isdisjoint(DOCTOR)
    assert [id for id in (*VERDICT, *DOCTOR) if not re.fullmatch(r"[a-z]+(-[a-z]+)*", id)] == []
    table = (ROOT / "occlog/records/messages.py").read_text(encoding="utf-8")
    assert len(re.findall(r'^    "[a-z-]+": Message\(', table, re.MULTILINE)) == len(VERDICT) + len(DOCTOR)


def test_messages_fit_into_a_line() -> None:
    reported = {id: typical(message) for id, message in VERDICT.items()}
    assert [(id, len(text), text) for id, text in reported.items() if len(text) > MAX_CHARACTERS] == []


def test_every_id_is_used_and_every_used_id_is_declared() -> None:
    texts = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "occlog").rglob("*.py"))
    assert [id for id in (*VERDICT, *DOCTOR) if texts.count(f'"{id}"') < 2] == []
    stated = set(stated_ids())
    assert len(stated) > 60
    assert [each for each in stated if each[1] not in (DOCTOR if each[0] in ("add", "refused") else VERDICT)] == []


def test_options_are_spelled_and_further_names_counted() -> None:
    message = VERDICT["view-without-tracks"]
    reported = spelled(message.fill(sensors=("a", "b", "c", "d", "e")))
    assert reported.startswith("no initial ellipse began a tracker in a, b, c, 2 more: ")
    assert "--without" in reported
