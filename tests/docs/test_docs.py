"""Docs cannot drift: made pages are up to date, every command and every shown command line exists."""

from __future__ import annotations

import csv
import re
import shlex

import pytest
from command_lines import refusal
from places import ROOT

from docs.make import PAGES, RESULTS
from docs.pictures.__main__ import PICTURES
from occlog.cli.main import COMMANDS

FRONT = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
TEXTS = [*FRONT, *sorted((ROOT / "docs").rglob("*.md"))]


PLUGINS = re.compile(r"--method (mine|bright)\b")
"""Methods of plug-ins that a page makes."""
MADE = {**PAGES, **RESULTS}


@pytest.mark.parametrize("name", MADE)
def test_made_pages_are_up_to_date(name: str) -> None:
    assert (ROOT / "docs" / name).read_text(encoding="utf-8") == MADE[name](), "run `make docs`"


def shown_commands() -> list[tuple[str, str]]:
    """(file, command line) of every `occlog ...` line in a shell block."""
    found = []
    for path in TEXTS:
        for block in re.findall(r"```(?:sh|shell|console|bash)\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL):
            for line in block.replace("\\\n", " ").splitlines():
                command = re.split(r" [|#] | && |  #| 2?> ", line.strip().removeprefix("$ "))[0]
                if command.startswith("occlog "):
                    found.append((path.name, command))
    return found


def test_docs_show_every_command() -> None:
    shown = {shlex.split(line)[1] for _, line in shown_commands()}
    assert set(COMMANDS) <= shown


def mentioned_commands() -> list[tuple[str, str]]:
    """(file, command line) of every `occlog ...` in the running text; the changelog names former options."""
    pages = [path for path in TEXTS if path.name != "CHANGELOG.md"]
    texts = [(path.name, re.sub(r"```.*?```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)) for path in pages]
    named = [(file, " ".join(line.split())) for file, text in texts for line in re.findall(r"`(occlog [^`]*)`", text)]
    return [(file, line.partition(" | ")[0]) for file, line in named if not PLUGINS.search(line)]


def test_shown_command_lines_are_valid() -> None:
    """Commands, options, the types and limits of values, and settings; files need not exist."""
    lines = [*shown_commands(), *mentioned_commands()]
    assert len(lines) > 500
    wrong = [(file, line, why) for file, line in lines if (why := refusal(shlex.split(line)))]
    assert wrong == []


@pytest.mark.parametrize(
    "line",
    [
        "occlog track a.mcap --method fix --particles 5", "occlog track a.mcap --particles no", "occlog info a b",
        "occlog track a.mcap --set nothing=1", "occlog track a.mcap --method nothing", "occlog nothing",
        "occlog simulate --store gif", "occlog priors nothing", "occlog info --rows -1 FILE",
    ],
)  # fmt: skip
def test_a_command_line_that_is_refused_is_noticed(line: str) -> None:
    assert refusal(shlex.split(line))


def test_links_lead_somewhere() -> None:
    for path in TEXTS:
        for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", path.read_text(encoding="utf-8")):
            if "://" not in target:
                assert (path.parent / target).exists(), f"{path.name}: {target}"


def test_glossary_names_modules_that_exist() -> None:
    page = (ROOT / "docs/development/glossary.md").read_text(encoding="utf-8")
    folders = {path.name for path in (ROOT / "occlog").iterdir() if path.is_dir()}
    named = [name for name in re.findall(r"`([a-z_]+(?:\.[a-z0-9_]+)+)`", page) if name.split(".")[0] in folders]
    assert len(named) > 80
    paths = [ROOT / "occlog" / name.replace(".", "/") for name in named]
    assert [str(path) for path in paths if not (path.is_dir() or path.with_suffix(".py").exists())] == []


def test_every_picture_is_made_by_a_command_and_shown() -> None:
    there = {path.name for path in (ROOT / "docs/pictures").iterdir() if path.suffix not in (".py", "")}
    shown = "".join(path.read_text(encoding="utf-8") for path in TEXTS)
    assert there == set(PICTURES), "python -m docs.pictures makes what is there, and what it makes is there"
    assert not [name for name in there if f"pictures/{name})" not in shown]


def test_findings_have_their_present_ids() -> None:
    """Old ids of several words; single words also name columns and settings."""
    rows = csv.DictReader((ROOT / "occlog" / "renamed.csv").read_text("utf-8").splitlines())
    old = {row["old"] for row in rows if row["kind"] == "message" and "-" in row["old"]}
    found = [
        f"{page.relative_to(ROOT)}: {word}"
        for page in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
        if page.name != "renamed.md"
        for word in re.findall(r"`([a-z]+(?:-[a-z]+)+)`", page.read_text())
        if word in old
    ]
    assert not found
