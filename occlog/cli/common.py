"""Options that every command has without declaring them: units of columns, more messages."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import click

from occlog.details import dry_run, told_to

from .standard_input import Input, named


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
    if (there & {"output", "png"}) and "dry_run" not in there and command.name not in WITHOUT_DRY_RUN:
        command.params.append(_flag("--dry-run", _dry_run, DRY_RUN_HELP))
    if "verbose" not in there:
        command.params.append(_flag("-v", _tell_details, VERBOSE_HELP, "--verbose"))


WITHOUT_DRY_RUN = ("reproduce", "schema")
"""Commands that write where nothing stops them."""
DRY_RUN_HELP = (
    "Check inputs, settings and outputs as far as the work does before it begins, say what would be written, and stop."
)
VERBOSE_HELP = "Say on standard error what inputs are taken for, what is written, and how long it takes."


def _flag(name: str, callback: Callable[..., None], help: str, *more: str) -> click.Option:
    return click.Option([name, *more], is_flag=True, expose_value=False, callback=callback, help=help)


def _dry_run(ctx: click.Context, param: click.Parameter, given: bool) -> None:  # noqa: ARG001
    if given and not ctx.resilient_parsing:
        ctx.find_root().with_resource(dry_run())


def _tell_details(ctx: click.Context, param: click.Parameter, given: bool) -> None:  # noqa: ARG001
    """Print details with the time since the start, and at the end the time and memory of everything."""
    if not given or ctx.resilient_parsing:
        return
    start, command = time.perf_counter(), ctx.info_name

    def say(text: str) -> None:
        click.echo(f"occlog: {time.perf_counter() - start:7.2f} s  {named(text)}", err=True)

    def end() -> None:
        import resource

        used = resource.getrusage(resource.RUSAGE_SELF)
        seconds, megabytes = used.ru_utime + used.ru_stime, used.ru_maxrss / 1024
        say(f"{command}: {seconds:.2f} s of a processor, at most {megabytes:.0f} MB")

    ctx.find_root().call_on_close(end)
    ctx.find_root().with_resource(told_to(say))


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
