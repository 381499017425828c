"""Commands that are called with values, not with the words of a command line."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

import click
from click.core import iter_params_for_processing

from .setting_options import CHOSEN


def context_of(
    command: click.Command, name: str, values: Mapping[str, object], variant: str | None = None
) -> click.Context:
    """A context of a command in which its parameters have these values.

    Args:
        command: what is called.
        name: how it is called, for messages.
        values: by the names of parameters: texts, several in a list where the parameter takes several, and the truth
            of flags; what is left out has its default.
        variant: of a command that has several.

    Raises:
        click.BadParameter: a value that a parameter cannot have, or a missing one.
    """
    ctx = click.Context(command, info_name=name)
    if variant is not None:
        ctx.meta[CHOSEN] = variant
    try:
        with ctx.scope(cleanup=False):
            for param in iter_params_for_processing([], command.get_params(ctx)):
                given = {str(param.name): values[str(param.name)]} if param.name in values else {}
                param.handle_parse_result(ctx, given, [])
            # As click's own parsing does at its end
            ctx.params = {name: None if _unset(value) else value for name, value in ctx.params.items()}
    except BaseException:
        ctx.close()
        raise
    return ctx


def _unset(value: object) -> bool:
    """Whether a value is the sentinel of click 8.3 for what was not given."""
    return isinstance(value, Enum) and value.name == "UNSET"
