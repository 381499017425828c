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


@pytest.mark.parametrize(("words", "lines"), [([], 1), (["-q"], 0), (["--quiet"], 0)])
def test_compilation_is_reported_once_unless_the_command_is_quiet(words: list[str], lines: int, capsys: Any) -> None:
    with stage.make_context("occlog", words) as ctx, with_compile_notice():
        stage.invoke(ctx)
    captured = capsys.readouterr()
    assert captured.err.count("\n") == lines
    assert captured.err.startswith("occlog: compiling, once") == bool(lines)
    assert captured.out == ""
    assert not COMPILING


def test_where_nothing_can_be_kept_the_line_says_what_to_set(capsys: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(details, "_UNCACHED", [])
    note_uncached()
    with stage.make_context("occlog", []) as ctx, with_compile_notice():
        stage.invoke(ctx)
    (line,) = capsys.readouterr().err.splitlines()
    assert "in every run" in line
    assert "NUMBA_CACHE_DIR" in line
