"""Options that every command has without declaring them: units, origin on the earth, plug-in readers, messages."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from copy import copy
from functools import partial, wraps
from typing import TYPE_CHECKING, Any

import click

from occlog.console.notes import dry_run, logging_to, named
from occlog.console.text import shortened
from occlog.errors import UsageError
from occlog.errors import option as spelled_option

from .input_paths import Input, check_there
from .setting_options import SettingOption, value_after

if TYPE_CHECKING:
    from occlog.io.files.geodetic import Origin


def add_common(command: click.Command) -> None:
    """Add the options that all commands have, such as `--input-units` and `-v`, to a command or to those of a group."""
    if isinstance(command, click.Group):
        for each in command.commands.values():
            add_common(each)
        return
    there = {param.name for param in command.params}
    reads = any(isinstance(param.type, Input) for param in command.params)
    if reads and "input_units" not in there:
        command.params.append(_input_units())
        if command.callback is not None:
            command.callback = _after_a_look(command.callback)
    if _takes_reader(command) and "origin" not in there:
        command.params.append(_origin())
    if _takes_reader(command) and "reader" not in there:
        command.params.append(_reader())
    if (there & {"output", "png"}) and "dry_run" not in there and command.name not in WITHOUT_DRY_RUN:
        command.params.append(_flag("--dry-run", _dry_run, DRY_RUN_HELP))
    if "verbose" not in there:
        command.params.append(_flag("-v", _tell_details, VERBOSE_HELP, "--verbose"))


def _after_a_look(callback: Callable[..., Any]) -> Callable[..., Any]:
    """Return a callback that checks that all inputs exist, then calls the given callback of a command.

    With settings (`--set`) the check is omitted: the callback reports errors in the command line first.
    """

    @wraps(callback)
    def checked(*args: Any, **values: Any) -> Any:
        if not values.get("settings"):
            check_there(click.get_current_context())
        return callback(*args, **values)

    return checked


WITHOUT_DRY_RUN = ("reproduce", "schema")
"""Commands that write where nothing stops them."""
DRY_RUN_HELP = "Check inputs, settings and outputs, list what would be written, and stop."
VERBOSE_HELP = "Log input formats, outputs and elapsed times to standard error."


def _flag(name: str, callback: Callable[..., None], help: str, *more: str) -> click.Option:
    return click.Option([name, *more], is_flag=True, expose_value=False, callback=callback, help=help)


def _dry_run(ctx: click.Context, param: click.Parameter, given: bool) -> None:  # noqa: ARG001
    if given and not ctx.resilient_parsing:
        ctx.find_root().with_resource(dry_run())


def _tell_details(ctx: click.Context, param: click.Parameter, given: bool) -> None:  # noqa: ARG001
    """Callback of the flag `-v`: if `given`, print details with elapsed times, and total time and memory at the end."""
    if not given or ctx.resilient_parsing:
        return
    start, command = time.perf_counter(), ctx.info_name

    def say(text: str) -> None:
        click.echo(f"occlog: {time.perf_counter() - start:7.2f} s  {shortened(named(text))}", err=True)

    def end() -> None:
        peak = peak_memory()
        memory = "" if peak is None else f", at most {peak / 2**20:.0f} MB"
        say(f"{command}: {time.process_time():.2f} s of a processor{memory}")

    ctx.find_root().call_on_close(end)
    ctx.find_root().with_resource(logging_to(say))


def peak_memory() -> int | None:
    """Return the peak resident memory of this process [bytes]; None if the system does not report it (Windows)."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def _input_units() -> click.Option:
    return click.Option(
        ["--input-units"],
        multiple=True,
        expose_value=False,
        callback=_state,
        metavar="COLUMN=UNIT,...",
        help="Units of columns without a unit in their name, in tables of other programs: bearing=deg,x=cm, or deg,cm "
        "for all angles and lengths; FILE: before a column limits it to that file: truth.csv:x=mm,truth.csv:t=ms. "
        "[default: s, and the scene's unit of length; angles must state theirs]",
    )


def _state(ctx: click.Context, param: click.Parameter, texts: tuple[str, ...]) -> None:  # noqa: ARG001
    """Callback of `--input-units`: let the units in `texts` apply to all files that are read until the command ends."""
    if texts and not ctx.resilient_parsing:
        from occlog.io.files.input_units import stated_units

        ctx.find_root().meta[STATED] = ctx.find_root().with_resource(stated_units(texts))


STATED = "occlog.input_units"
"""Key of the stated units in the metadata of click's context."""


ORIGIN_FORM = "LAT,LON[,DEG[,HEIGHT]]"
ORIGIN_HELP = (
    "latitude and longitude of the scene's origin (WGS 84), angle of +x from east towards north [all in degrees], and "
    "height of z = 0 [m]"
)


def _origin() -> click.Option:
    return click.Option(
        ["--origin"],
        expose_value=False,
        callback=state_origin,
        metavar=ORIGIN_FORM,
        help=f"For inputs in latitude and longitude: {ORIGIN_HELP}.",
    )


def state_origin(ctx: click.Context, param: click.Parameter, text: str | None) -> Origin | None:  # noqa: ARG001
    """Callback of `--origin`: set the geodetic origin given as `text` until the command ends, and return it.

    None if the option is not given.
    """
    if text is None or ctx.resilient_parsing:
        return None
    from occlog.io.files.geodetic import stated_origin

    stated = ctx.find_root().with_resource(stated_origin(text))
    ctx.find_root().meta[ORIGIN] = stated
    return stated.origin


ORIGIN = "occlog.origin"
"""Key of the stated origin in the metadata of click's context."""


def _reader() -> click.Option:
    return click.Option(
        ["--reader"],
        expose_value=False,
        metavar="NAME",
        help="Plug-in reader, for inputs of its file types (--reader NAME --help lists its options).",
    )


def _takes_reader(command: click.Command) -> bool:
    """Return whether inputs of a command may be files that a reader plug-in can read."""
    return command.name == "ingest" or any(isinstance(param.type, Input) for param in command.params)


def with_reader(command: click.Command, words: Sequence[str]) -> click.Command:
    """Return a copy of the command with options for the settings of the reader plug-in named on the command line.

    The command itself, if the arguments `words` name none, or it has no option `--reader`.
    """
    name = value_after(words, "--reader")
    if name is None or isinstance(command, click.Group) or all(p.name != "reader" for p in command.params):
        return command
    from occlog.plugins.loading import READER, Chosen

    from .setting_options import plugin_options, wanted

    plugin = wanted(name, READER, "--reader")
    values: dict[str, object] = {}
    options = plugin_options(plugin, command.params)
    for option in options:
        option.expose_value = False
        option.callback = partial(_keep, values)
    chosen = Chosen(plugin, values)
    reader = click.Option(
        ["--reader"],
        expose_value=False,
        metavar="NAME",
        callback=partial(_name_reader, chosen),
        help=f"{next(str(p.help) for p in command.params if isinstance(p, click.Option) and p.name == 'reader')} "
        f"{plugin.name}: {plugin.load().summary} ({plugin.origin}).",
    )
    found = copy(command)
    found.params = [*(reader if p.name == "reader" else p for p in command.params), *options]
    return found


def _keep(values: dict[str, object], ctx: click.Context, param: click.Parameter, value: object) -> None:  # noqa: ARG001
    """Callback of an option of a reader plug-in: if it is given, add its setting to `values`, in place."""
    if value not in (None, ()) and isinstance(param, SettingOption):
        values[param.setting] = param.default_text(value)


def _name_reader(chosen: Any, ctx: click.Context, param: click.Parameter, name: str | None) -> None:  # noqa: ARG001
    """Callback of `--reader`: let the plug-in `chosen` read files of its types until the command ends.

    `name`: value of the option; None: not given, nothing changes.
    """
    if name is not None and not ctx.resilient_parsing:
        from occlog.io.files.texts.by_reader import named_reader

        ctx.find_root().meta[READER_KEY] = ctx.find_root().with_resource(named_reader(chosen))


READER_KEY = "occlog.reader"
"""Key of the named reader in the metadata of click's context."""


def check_common(ctx: click.Context) -> None:
    """Raise UsageError, after a command, if a unit, origin or reader given as an option was not used."""
    reader: Any = ctx.find_root().meta.get(READER_KEY)
    if reader is not None:
        reader.check_used()
    origin: Any = ctx.find_root().meta.get(ORIGIN)
    if origin is not None and not origin.used:
        raise UsageError(
            f"{spelled_option('origin')}: nothing that was read has latitudes and longitudes; leave it out",
            id="not-applicable",
        )
    stated: Any = ctx.find_root().meta.get(STATED)
    unused = () if stated is None else stated.unused()
    if unused:
        raise UsageError(
            f"{spelled_option('input_units')} {','.join(unused)}: no table that was read has such a column without a "
            "unit in its name; outputs were made without it",
            id="unknown-column",
        )
