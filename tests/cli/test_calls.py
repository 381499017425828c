"""Commands that are called with values."""

from __future__ import annotations

from enum import Enum

from occlog.cli.calls import context_of
from occlog.cli.main import load_command


def test_what_is_not_given_is_none() -> None:
    with context_of(load_command("simulate"), "simulate", {"output": "a.mcap"}, "people") as context:
        assert not [name for name, value in context.params.items() if isinstance(value, Enum)]
        assert context.params["output"].name == "a.mcap"
