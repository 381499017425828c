"""Click commands made from requests: options from the fields; the callback builds and runs the request."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import click

from occlog import console
from occlog.request import Form, Request, RequestEntry, Verb, VerbKind, Verbs, load
from occlog.settings import Settings, declaration, kind_of, plain_kind

from . import options
from .options import NumberOrFile, parse_setting
from .setting_options import (
    CHOSEN,
    CommandVariant,
    PluggedCommand,
    SettingOption,
    SettingsCommand,
    VariantCommand,
    chosen_in,
    in_own_unit,
    value_after,
)


def command_of(verb: type[Request] | Verb | Verbs, name: str, short_help: str) -> click.Command:
    """Return the click command of a request; its help is the docstring of the request class.

    Args:
        verb: request class; or several of them, chosen by an option (`Verb`) or as subcommands (`Verbs`).
        name: name of the command.
        short_help: its line in the list of commands.
    """
    if isinstance(verb, Verbs):
        commands: dict[str, click.Command] = {
            each: _one(request, each, line) for each, (request, line) in verb.verbs.items()
        }
        return click.Group(name, commands, help=verb.help, short_help=short_help)
    return _one(verb, name, short_help) if isinstance(verb, type) else _several(verb, name, short_help)


def _one(request: type[Request], name: str, short_help: str) -> SettingsCommand:
    form = Form(request)
    free = form.set_group()
    taken: dict[str, Any] = {
        "name": name,
        "params": [*map(_param, form.entries()), *_strict(request), *_common("" if free is None else free[1])],
        "callback": partial(_do, form),
        "help": request.__doc__,
        "short_help": short_help,
        "settings": None if free is None else partial(_settings_of, form, free[0]),
    }
    of = next((entry.plugged for entry in form.entries() if entry.plugged is not None), None)
    return SettingsCommand(**taken) if of is None else PluggedCommand(flag=of.option, kind=of.kind, **taken)


def _several(verb: Verb, name: str, short_help: str) -> VariantCommand:
    flags = {f"--{key.replace('_', '-')}": choose for key, choose in verb.by.items()}

    def choose(args: Sequence[str]) -> str | None:
        given = ((of, value_after(args, flag)) for flag, of in flags.items())
        chosen = next((kind for of, value in given if value is not None and (kind := of(value))), None)
        if chosen is not None or not (verb.counted or verb.fits):
            return chosen
        words = _arguments(args, [*command.params, *(p for each in command.variants.values() for p in each.params())])
        if verb.fits and words and Path(words[0]).is_file():
            return str(load(verb.fits)(words[0], value_after(args, "--scene")))
        return next((kind for least, kind in sorted(verb.counted.items(), reverse=True) if len(words) >= least), None)

    command = VariantCommand(
        name=name,
        params=[*(_param(entry, verb) for entry in Form(verb.shared).entries()), *_common(verb.example)],
        help=verb.help,
        short_help=short_help,
        variants={each: _variant(verb, kind) for each, kind in verb.kinds.items()},
        more=lambda: {each: _variant(verb, kind) for each, kind in verb.more().items()},
        choose=choose,
        default=verb.default,
        shows_default=verb.shows_default,
        what=verb.what,
        chosen_by=verb.chosen_by,
    )
    command.callback = partial(_do_chosen, verb)
    return command


def _arguments(args: Sequence[str], known: Iterable[click.Parameter]) -> list[str]:
    """Return the positional arguments among the words of a command line.

    Args:
        args: the words.
        known: parameters of all kinds of the command, by which options with a value are known.
    """
    takes = {name for p in known if isinstance(p, click.Option) and not p.is_flag for name in p.opts}
    found: list[str] = []
    skip = False
    for index, arg in enumerate(args):
        if skip:
            skip = False
        elif arg == "--":
            return [*found, *args[index + 1 :]]
        elif arg.startswith("--"):
            skip = arg in takes
        elif arg.startswith("-") and arg != "-":
            # Short options may be joined (-qo FILE); a value comes at once (-oFILE) or next
            valued = next((k for k, letter in enumerate(arg[1:], 1) if f"-{letter}" in takes), 0)
            skip = valued == len(arg) - 1
        else:
            found.append(arg)
    return found


def _variant(verb: Verb, kind: VerbKind) -> CommandVariant:
    """Return the variant of a command for one kind of request: fields that not all kinds share, and settings."""
    shared = {entry.name for entry in Form(verb.shared).entries()}

    @cache
    def params() -> list[click.Parameter]:
        form = kind.form()
        return [*(_param(entry) for entry in form.entries() if entry.name not in shared), *_strict(form.request)]

    def settings() -> list[type[Settings]]:
        form = kind.form()
        free = form.set_group()
        return [] if free is None else [_settings_of(form, free[0]), *form.around]

    return CommandVariant(kind.summary, params, settings, kind.called, kind.about)


def _settings_of(form: Form, group: str) -> type[Settings]:
    return form.classes()[group]


def _do_chosen(verb: Verb, /, **values: Any) -> int:
    """Callback of a command with several kinds of requests: run the kind that the arguments choose.

    Return the exit code.
    """
    name = click.get_current_context().meta[CHOSEN]
    kind = verb.kind(name)
    assert kind is not None  # checked when the command was parsed
    if verb.fits and all(values.get(key) is None for key in verb.by):
        values[next(iter(verb.by))] = name
        if name != verb.default:
            console.note(f"{verb.what} {name}, by the input: {kind.summary}; --help lists others", values["quiet"])
    return _do(kind.form(), **values)


def _do(
    form: Form,
    /,
    *,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    strict: bool = False,
    settings: Collection[str] = (),
    **values: Any,
) -> int:
    """Callback of a command: build the request from the options, run it, print its result, and return the exit code.

    Args:
        form: fields and settings of the request.
        overwrite: replace outputs that exist.
        quiet: print no notes and no progress.
        as_json: print the summary as one JSON object.
        strict: exit with code 6 if a consistency check fails.
        settings: texts `NAME=VALUE` of `--set`.
        **values: values of the other options by name.
    """
    request = request_of(form, values, settings)
    from occlog.runner import exit_code, run

    done = run(request, overwrite=overwrite, quiet=quiet)
    for loss in done.earlier:
        console.note(f"lost earlier: {loss}", quiet)
    if done.shown is None:
        console.finish(done.summary, done.losses, as_json, done.earlier)
    else:
        click.echo(done.shown(as_json))
    for line in done.failed:
        click.echo(f"occlog: --fail-if {line}", err=True)
    for path in request.files(output=True).values() if done.shown is not None else ():
        console.note(f"wrote {path}", quiet)
    return exit_code(request, done, strict=strict)


def request_of(form: Form, values: Mapping[str, Any], settings: Iterable[str] = ()) -> Request:
    """Return the request made from the options of a command.

    Args:
        form: fields and settings of the request.
        values: values of the options by parameter name; None or () is not given.
        settings: texts `NAME=VALUE` of `--set`.
    """
    given: dict[str, Any] = {}
    for entry in form.entries():
        value = values.get(entry.name)
        if entry.plugged is not None:
            given[entry.name] = chosen_in(click.get_current_context(), values)
        elif value not in (None, ()):
            given[entry.name] = value if entry.file is not None else in_own_unit(value, declaration(entry.of))
    free = form.set_group()
    return form.build(given, {} if free is None else {free[0]: dict(parse_setting(text) for text in settings)})


def _param(entry: RequestEntry, verb: Verb | None = None) -> click.Parameter:
    """Return the click option or argument of one field of a request.

    `verb`: command with several kinds of requests; for the option that chooses a kind, shells complete their names.
    """
    of = entry.file
    if (plugged := entry.plugged) is not None:
        return click.Option([plugged.option, entry.of.name], multiple=True, metavar="NAME", help=plugged.help)
    if of is None:
        names = tuple(verb.kinds) if verb is not None and entry.key in verb.by else ()
        return SettingOption(entry.owner, entry.of, entry.name.removesuffix(entry.of.name), entry.under, names)
    path: click.ParamType[Any] = options.PATH if of.output or not of.there else options.INPUT
    kind = path if of.number is None else NumberOrFile(of.number)
    several = plain_kind(kind_of(entry.owner, entry.of.name)) is tuple
    if of.argument:
        return click.Argument(
            [entry.of.name], type=kind, required=entry.required, nargs=-1 if several else 1, metavar=of.metavar
        )
    flags = (of.option or f"--{entry.of.name.replace('_', '-')}").split("/")
    return click.Option(
        [*flags, entry.of.name],
        type=kind,
        required=entry.required,
        multiple=several,
        nargs=of.together,
        default=None,
        metavar=of.metavar,
        help=of.help,
    )


def _strict(request: type[Request]) -> list[click.Option]:
    help_text = f"Exit with code 6 {request.STRICT}"
    return [click.Option(["--strict"], is_flag=True, help=help_text)] if request.JUDGED and request.STRICT else []


def _common(example: str) -> list[click.Option]:
    """Return the options of every request: --set, --overwrite, --quiet and --json.

    `example`: a setting for the help of --set; empty: no --set.
    """
    decorators = [options.set_opt(example)] if example else []
    decorators += [options.overwrite_opt, options.quiet_opt, options.json_opt]
    return [_made(each) for each in decorators]


def _made(decorator: Callable[[Any], Any]) -> click.Option:
    """Return the option that a click decorator adds to a function."""

    def function() -> None:
        """Do nothing: function on which the decorator of an option leaves its click parameter."""

    decorator(function)
    option: click.Option = function.__dict__["__click_params__"][0]
    return option
