"""Options that every command has without declaring them: units of columns, more messages."""

from __future__ import annotations

from typing import Any

import click

from .standard_input import Input


def add_common(command: click.Command) -> None:
    """Give a command, or those of a group, the options that are the same everywhere; once."""
    if isinstance(command, click.Group):
        for each in command.commands.values():
            add_common(each)
        return
    there = {param.name for param in command.params}
    reads = any(isinstance(param.type, Input) for param in command.params)
    if reads and "input_units" not in there:
        command.params.append(_input_units())


def _input_units() -> click.Option:
    return click.Option(
        ["--input-units"],
        multiple=True,
        expose_value=False,
        callback=_state,
        metavar="COLUMN=UNIT,...",
        help="Units of columns of other programs whose names say none: bearing=deg,x=cm, or deg,cm for all angles and "
        "lengths.",
    )


def _state(ctx: click.Context, param: click.Parameter, texts: tuple[str, ...]) -> None:  # noqa: ARG001
    """Let the units hold until the command ends."""
    if texts and not ctx.resilient_parsing:
        from occlog.io.files.stated_units import stated_units

        ctx.find_root().meta[STATED] = ctx.find_root().with_resource(stated_units(texts))


STATED = "occlog.input_units"
"""Key of the stated units in the metadata of click's context."""


def check_common(ctx: click.Context) -> None:
    """After a command: UsageError where a unit was stated in vain."""
    stated: Any = ctx.find_root().meta.get(STATED)
    unused = () if stated is None else stated.unused()
    if unused:
        raise click.UsageError(
            f"--input-units {','.join(unused)}: no table that was read has such a column without a unit in its name; "
            "outputs were made without it",
            ctx,
        )
