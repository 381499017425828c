"""A first run that compiles for long says so, once, unless it is quiet."""

from __future__ import annotations

from typing import Any

import click
import pytest

from occlog.cli.options import quiet_opt
from occlog.cli.startup import with_compile_notice
from occlog.console import notes as details
from occlog.console.notes import COMPILING, log_compiling, note_uncached


@click.command()
@quiet_opt
def stage(quiet: bool) -> None:
    """What compiles."""
    log_compiling()
    log_compiling()


@click.command()
@quiet_opt
def stages(quiet: bool) -> None:
    """A command that runs a quiet one, as `occlog run` does."""
    stage.main(["-q"], standalone_mode=False)


@pytest.mark.parametrize(
    ("command", "words", "lines"), [(stage, [], 1), (stage, ["-q"], 0), (stages, [], 1), (stages, ["--quiet"], 0)]
)
def test_compilation_is_told_once_unless_the_command_that_was_called_is_quiet(
    command: click.Command, words: list[str], lines: int, capsys: Any
) -> None:
    with command.make_context("occlog", words) as ctx, with_compile_notice(ctx):
        command.invoke(ctx)
    said = capsys.readouterr()
    assert said.err.count("\n") == lines
    assert said.err.startswith("occlog: compiling, once") == bool(lines)
    assert said.out == ""
    assert not COMPILING


def test_where_nothing_can_be_kept_the_line_says_what_to_set(capsys: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(details, "_UNCACHED", [])
    note_uncached()
    with stage.make_context("occlog", []) as ctx, with_compile_notice(ctx):
        stage.invoke(ctx)
    (line,) = capsys.readouterr().err.splitlines()
    assert "in every run" in line
    assert "NUMBA_CACHE_DIR" in line
