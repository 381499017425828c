"""Docs cannot drift: made pages are up to date, every command and every shown command line exists."""

from __future__ import annotations

import re
import shlex

import click
import pytest
from places import ROOT

from docs.make import PAGES, RESULTS
from docs.pictures.__main__ import PICTURES
from occlog.cli.main import COMMANDS, cli
from occlog.cli.setting_options import VariantCommand, params_of

FRONT = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
TEXTS = [*FRONT, *sorted((ROOT / "docs").rglob("*.md"))]


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
                command = line.strip().removeprefix("$ ").split(" | ")[0].split(" && ")[0].split("  #")[0]
                if command.startswith("occlog "):
                    found.append((path.name, command))
    return found


def test_docs_show_every_command() -> None:
    shown = {shlex.split(line)[1] for _, line in shown_commands()}
    assert set(COMMANDS) <= shown


@pytest.mark.parametrize(("file", "line"), shown_commands())
def test_shown_options_exist(file: str, line: str) -> None:
    words = shlex.split(line)
    if words[1].startswith("-"):
        return
    command = cli.get_command(click.Context(cli), words[1])
    assert command is not None, f"{file}: {line}"
    if isinstance(command, click.Group):
        assert words[2] in command.commands, f"{file}: {line}"
        command = command.commands[words[2]]
    chosen = command.choose(words[2:]) if isinstance(command, VariantCommand) else None
    valid = {o for p in params_of(command, chosen) for o in (*p.opts, *p.secondary_opts)} | {"-h", "--help"}
    for word in words[2:]:
        if word.startswith("-") and not re.fullmatch(r"-?[\d.,]*", word):
            assert word.split("=")[0] in valid, f"{file}: {line}: {word}"


def test_links_lead_somewhere() -> None:
    for path in TEXTS:
        for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", path.read_text(encoding="utf-8")):
            if "://" not in target:
                assert (path.parent / target).exists(), f"{path.name}: {target}"


def test_every_picture_is_made_by_a_command_and_shown() -> None:
    there = {path.name for path in (ROOT / "docs/pictures").iterdir() if path.suffix not in (".py", "")}
    shown = "".join(path.read_text(encoding="utf-8") for path in TEXTS)
    assert there == set(PICTURES), "python -m docs.pictures makes what is there, and what it makes is there"
    assert not [name for name in there if f"pictures/{name})" not in shown]
