"""Parses command lines of texts and pages as click does, without files and without running them."""

from __future__ import annotations

import re
from collections.abc import Sequence

import click

from occlog.cli.main import cli
from occlog.cli.options import parse_setting
from occlog.cli.setting_options import CHOSEN, SettingsCommand, VariantCommand
from occlog.errors import OcclogError
from occlog.settings import check_setting

PLACEHOLDER = re.compile(r"\{|\||\.\.\.|\b[A-Z]+\b")
"""A part of a value that the reader is to replace."""


def refusal(words: Sequence[str]) -> str:
    """Why a command refuses its words (`occlog track a.mcap --lag 1`); empty where it takes them.

    Commands, options, the number of arguments and the values are checked, and the settings of `--set`; not that files
    exist, that all that is required is given, or what values have to do with each other.  Placeholders (`FILE`, `{}`)
    stand for any value, and the value of the last option may be missing: a mention of the option alone.
    """
    try:
        _parse(list(words[1:]))
    except (click.UsageError, OcclogError) as error:
        return error.format_message() if isinstance(error, click.UsageError) else str(error)
    return ""


def _parse(words: list[str]) -> None:
    if not words or words[0] in ("--help", "-h", "--version") or PLACEHOLDER.search(words[0]):
        return
    context = click.Context(cli, info_name="occlog")
    name, command, words = cli.resolve_command(context, words)
    if isinstance(command, click.Group):
        if not words:
            return
        name, command, words = command.resolve_command(context, words)
    assert command is not None
    context = click.Context(command, info_name=name, parent=context)
    if not isinstance(command, VariantCommand):
        _check(command, words, context)
        return
    words = _completed(words, [p for each in command.variants.values() for p in (*each.params(), *command.params)])
    chosen = command.choose(words)
    if chosen is not None and not PLACEHOLDER.search(chosen) and command.variant(chosen) is None:
        raise click.UsageError(f"no {command.what} {chosen!r}", context)
    # Without a choice in the words inputs may choose, or it is a mention of an option alone
    names = [chosen] if chosen in command.variants else [command.default, *command.variants]
    errors = []
    for name in names:
        context = click.Context(command, info_name=command.name, parent=context.parent)
        context.meta[CHOSEN] = name
        try:
            _check(command, words, context)
        except (click.UsageError, OcclogError) as error:
            errors.append(error)
        else:
            return
    raise errors[0]


def _completed(words: list[str], params: Sequence[click.Parameter]) -> list[str]:
    """The words with placeholders for the values of the last one, where it is an option."""
    for param in params:
        if words and words[-1] in param.opts and isinstance(param, click.Option) and not (param.is_flag or param.count):
            return [*words, *["..."] * param.nargs]
    return words


def _check(command: click.Command, words: list[str], context: click.Context) -> None:
    """Parse the words of a command, of the variant of the context, and convert the values."""
    params = {param.name: param for param in command.get_params(context)}
    values, left, _ = command.make_parser(context).parse_args([*_completed(words, list(params.values()))])
    if left:
        raise click.UsageError(f"{left[0]}: one argument too many", context)
    for key, value in values.items():
        _convert(params[key], value, context)
    if isinstance(command, SettingsCommand) and any("--set" in param.opts for param in params.values()):
        for text in values.get("settings") or ():
            if not PLACEHOLDER.search(text):
                check_setting(command.classes(context), *parse_setting(text))


def _convert(param: click.Parameter, value: object, context: click.Context) -> None:
    """Convert a value, or the values of an option that takes several; names of files are not."""
    if isinstance(value, list | tuple):
        for each in value:
            _convert(param, each, context)
    elif (
        isinstance(value, str)
        and not isinstance(param.type, click.Path | click.Tuple)
        and not PLACEHOLDER.search(value)
    ):
        param.type.convert(value, param, context)
