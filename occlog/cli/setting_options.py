"""Options of the command line made from declared settings, and commands with options that depend on a choice.

A setting that declares an option (`option_setting`, or `setting` with `option=`) has one with its type, range, default
and help; every setting can be given by `--set NAME=VALUE`. A `VariantCommand` has shared options and those of the
chosen variant: `occlog track --method map` takes the options of `map` only. Settings of plug-ins are options with the
plug-in's name as prefix: an exporter `gpx` with the setting `creator` has the option `--gpx-creator`. Installed
plug-ins are searched for names that are not built in, and by --help.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass
from typing import Any, TypeVar

import click

from occlog.errors import PluginError, UsageError, did_you_mean, nearest
from occlog.plugins.loading import Chosen, Plugin, find, installed
from occlog.settings import (
    METAVARS,
    Declaration,
    SettingError,
    Settings,
    check_setting,
    declaration,
    declared,
    default_in,
    item_kind,
    kind_of,
    listed,
    plain_kind,
)

from .options import FRAMES, SIZE, AnyFinite, Finite, parse_setting
from .startup import UnknownNameError

F = TypeVar("F", bound=Callable[..., object])
SET = "--set"
"""The option for settings without a separate one."""
CHOSEN = "occlog.variant"
"""Key of the chosen variant's name in the metadata of click's context."""


class SettingOption(click.Option):
    """Click option of a declared setting; its value is None if not given.

    Args:
        settings: class of the setting.
        f: its field.
        prefix: of the parameter's name, if a command has settings of one name from several classes.
        under: prefix of the option's name: `--gate` under `fuse` is `--fuse-gate`; with it, a setting that declares no
            option gets one by its name.
        names: values that a shell completes; empty: those of the option's type.
    """

    def __init__(
        self,
        settings: type[Settings],
        f: Field[object],
        prefix: str = "",
        under: str = "",
        names: Sequence[str] = (),
    ) -> None:
        spec = declaration(f)
        self.owner, self.setting, self._said = settings.OWNER, f.name, spec
        kind = plain_kind(kind_of(settings, f.name))
        option = spec.option
        if option is None:
            if not under:
                raise ValueError(f"setting {f.name} declares no option")
            own = f.name.replace("_", "-")
            option = f"--{own}/--no-{own}" if kind is bool else f"--{own}"
        flags = [f"--{under}-{flag.removeprefix('--')}" for flag in option.split("/")] if under else [option]
        super().__init__(
            ["/".join(flags), prefix + f.name],
            type=None if kind is bool else _type_of(settings, f),
            is_flag=True if kind is bool else None,
            default=None,
            required=f.default is MISSING,
            multiple=spec.repeat,
            nargs=spec.counts[0] if spec.apart else None,
            metavar=spec.metavar or METAVARS.get(spec.unit),
            shell_complete=(lambda _ctx, _param, begun: [n for n in names if n.startswith(begun)]) if names else None,
            help=spec.help if spec.shown == "" else f"{spec.help} [default: {default_words(f)}]",
        )

    def default_text(self, value: Any) -> Any:
        """Convert a value from the unit of the option to the unit of its setting."""
        return in_own_unit(value, self._said)

    def is_of(self, error: SettingError) -> bool:
        """Return whether an error is about this option's setting."""
        return (self.owner, self.setting) == (error.owner, error.setting)


def _type_of(settings: type[Settings], f: Field[object]) -> click.ParamType[Any]:
    """Return the click type for values of the settings field `f`, with the declared range or choices.

    Limits are converted to the unit of the option (`Declaration.scale`).
    """
    spec, kind = declaration(f), plain_kind(kind_of(settings, f.name))
    if spec.frames or spec.size:
        return FRAMES if spec.frames else SIZE
    low = spec.at_least if spec.above is None else spec.above
    high = spec.at_most if spec.below is None else spec.below
    if kind is int or item_kind(kind_of(settings, f.name)) == (tuple, int):
        if low is None and high is None:
            return click.INT
        whole = (None if low is None else int(low), None if high is None else int(high))
        return click.IntRange(*whole, min_open=spec.above is not None, max_open=spec.below is not None)
    if spec.apart or (kind is float and low is None and high is None):
        return AnyFinite()
    if kind is float:
        low, high = (end if not end or spec.scale == 1.0 else end / spec.scale for end in (low, high))
        return Finite(low, high, min_open=spec.above is not None, max_open=spec.below is not None)
    return click.Choice(spec.choices) if spec.choices and not spec.several else click.STRING


def default_words(f: Field[object]) -> str:
    """Return the default of the settings field `f` as text.

    `1.7 m, or 3.33 in a scene-specific unit`; where its unit has no length: `0.1 s, or 1 s where the scene has its own
    unit of length`.
    """
    spec = declaration(f)
    if spec.shown is not None:
        return spec.shown
    if f.default is None and spec.people is None and spec.own is None:
        return spec.nothing or "none"
    people, own = default_in(f, "m"), default_in(f, "")
    unit = {"length": "m"}.get(spec.unit, spec.unit.replace("length", "m"))
    text = value_words(f, people)
    if unit:
        text += f" {unit}"
    if people == own:
        return text
    if "length" in spec.unit:
        return f"{text}, or {value_words(f, own)} in a scene-specific unit"
    return f"{text}, or {f'{value_words(f, own)} {unit}'.rstrip()} where the scene has its own unit of length"


def value_words(f: Field[object], value: object) -> str:
    """Return a value of the settings field `f` as it is typed on the command line."""
    if value is None:
        return declaration(f).nothing or "none"
    if isinstance(value, bool):
        flags = (declaration(f).option or "").split("/")
        return flags[not value].removeprefix("--") if len(flags) == 2 else str(value).lower()
    if isinstance(value, tuple):
        return ",".join(n if isinstance(n, str) else f"{n:g}" for n in value)
    return f"{value / declaration(f).scale:g}" if isinstance(value, float) else str(value)


def add_options(added: Sequence[click.Option]) -> Callable[[F], F]:
    """Return a decorator that adds the options to a command, in their order."""

    def decorate(command: F) -> F:
        for option in reversed(added):
            _add(command, option)
        return command

    return decorate


def _add(command: Callable[..., object], option: click.Option) -> None:
    """Add one option to a command or to its function, like click's decorators."""
    if isinstance(command, click.Command):
        command.params.append(option)
    else:
        command.__dict__.setdefault("__click_params__", []).append(option)


def options_of(
    settings: type[Settings],
    *,
    only: Sequence[str] = (),
    without: Sequence[str] = (),
    prefix: str = "",
    under: str = "",
) -> list[SettingOption]:
    """Return the options of those fields of a settings class that declare one, in the order of declaration.

    Args:
        settings: the class.
        only: names of fields; empty: all.
        without: names of fields that are omitted.
        prefix: put before the names of the parameters.
        under: group or plug-in that the options belong to, see `SettingOption`.
    """
    return [
        SettingOption(settings, f, prefix, under)
        for f in declared(settings)
        if declaration(f).option is not None and (not only or f.name in only) and f.name not in without
    ]


def given(settings: type[Settings], values: Mapping[str, object], *, prefix: str = "") -> dict[str, Any]:
    """Return the settings that were given as options, by name of the field, in the unit of the setting.

    Args:
        settings: class of the settings.
        values: values of all options by parameter name; None or () is not given.
        prefix: before the names of the class's parameters.
    """
    wanted = {f.name: declaration(f) for f in declared(settings) if declaration(f).option is not None}
    found = {name: values.get(prefix + name) for name in wanted}
    return {name: in_own_unit(value, wanted[name]) for name, value in found.items() if value not in (None, ())}


def in_own_unit(value: Any, spec: Declaration) -> Any:
    """Return the value of an option as its setting takes it: a number times `spec.scale`.

    An option that may be repeated gives one tuple, not scaled: texts are split at commas, unless `spec.whole`; other
    values stay.
    """
    if spec.repeat:
        texts = () if spec.whole else (text for text in value if isinstance(text, str))
        return tuple(name for text in texts for name in listed(text)) or tuple(value)
    return value if spec.scale == 1.0 else value * spec.scale


def flag_of(settings: type[Settings], name: str) -> str:
    """Return how the setting `name` is given on the command line: `--shadows/--no-shadows`, or `--set name=`."""
    option = next(declaration(f).option for f in declared(settings) if f.name == name)
    return option or f"--set {name}="


def settings_table(settings: type[Settings], *, without: Sequence[str] = ()) -> list[tuple[str, str]]:
    """Return name and description of each setting that has no option, for --help; `without`: names omitted."""
    rows = []
    for f in declared(settings):
        spec = declaration(f)
        if spec.option is None and f.name not in without:
            limit = f"; {spec.limit()}" if spec.limit() else ""
            rows.append((f.name, f"{spec.help} [default: {default_words(f)}{limit}]"))
    return rows


def write_settings(formatter: click.HelpFormatter, heading: str, settings: type[Settings]) -> None:
    """Write a section of --help, titled `heading`, with the settings that have no option; nothing without such."""
    rows = settings_table(settings)
    if rows:
        with formatter.section(heading):
            formatter.write_dl(rows)


def unknown_option(name: str, params: Iterable[click.Parameter]) -> str:
    """Return the message about an unknown option, with up to three similar ones among `params`."""
    near = nearest(name, [flag for each in params for flag in (*each.opts, *each.secondary_opts)], n=3)
    return f"No such option {name!r}." + (f" Did you mean {' or '.join(map(repr, near))}?" if near else "")


@dataclass(frozen=True)
class CommandVariant:
    """A variant of a command, such as one tracking method, with its own options.

    Attributes:
        summary: one line.
        params: returns its options; called when the variant is chosen.
        settings: returns the settings classes that --help lists without an option.
        called: words that choose it, if not as the command's other variants; None: as these.
        about: paragraphs of its help, with an example; None: the help is that of the command.
    """

    summary: str
    params: Callable[[], Sequence[click.Parameter]]
    settings: Callable[[], Sequence[type[Settings]]] = tuple
    called: str | None = None
    about: str | None = None


class SettingsCommand(click.Command):
    """Click command with declared settings; a value out of range is a usage error that names the option.

    Args:
        settings: returns the settings class that --help lists without an option; None: none.
    """

    def __init__(self, *args: Any, settings: Callable[[], type[Settings]] | None = None, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.settings = settings

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the sections of --help: the options, then the settings for --set."""
        super().format_options(ctx, formatter)
        if self.settings is not None:
            write_settings(formatter, "Settings (--set NAME=VALUE)", self.settings())

    def invoke(self, ctx: click.Context) -> object:
        """Call the command; SettingError is converted to a usage error that names the option."""
        self.check_set(ctx)
        try:
            return super().invoke(ctx)
        except SettingError as error:
            raise self.refused(ctx, error) from error

    def classes(self, ctx: click.Context) -> Sequence[type[Settings]]:  # noqa: ARG002
        """Return the settings classes that --set accepts: one, or none if the command has no settings."""
        return () if self.settings is None else (self.settings(),)

    def check_set(self, ctx: click.Context) -> None:
        """Check the values of --set before anything is imported; click.UsageError names the setting."""
        for text in _texts_of_set(ctx):
            name, value = parse_setting(text)
            classes = self.classes(ctx)
            try:
                if classes:
                    check_setting(classes, name, value)
            except UsageError as error:
                problem = str(error).removeprefix(f"setting {name}: ")
                raise click.UsageError(f"--set {text}: {problem}", ctx) from error
            except SettingError as error:
                raise self.refused(ctx, error) from error

    def refused(self, ctx: click.Context, error: SettingError) -> click.UsageError:
        """Return the usage error for a SettingError, with the option that the user typed, or the setting's name."""
        limit = f"must be {error.limit}"
        for param in self.get_params(ctx):
            about = param.is_of(error) if isinstance(param, SettingOption) else param.name == error.setting
            typed = ctx.params.get(param.name or "")
            if about and typed is not None and isinstance(param, click.Option):
                words, flag = f"{typed:g}" if isinstance(typed, float) else typed, max(param.opts, key=len)
                return click.UsageError(f"{flag} {words}: {limit}", ctx)
        for text in reversed(_texts_of_set(ctx)):
            name, _ = parse_setting(text)
            if name == error.setting:
                return click.UsageError(f"--set {text}: {limit}", ctx)
        return click.UsageError(str(error), ctx)


class VariantCommand(SettingsCommand):
    """Click command with shared options, and with those of the variant that the arguments choose.

    Args:
        variants: by name.
        choose: returns the name of the variant that the arguments choose; None: they choose none.
        default: name of the variant if none is chosen.
        more: returns variants of plug-ins; called for a name that `variants` does not have, and for --help.
        shows_default: whether --help without a choice shows the options of the default variant.
        what: noun for a variant, for example `method`.
        chosen_by: how a variant is chosen, with {} for its name, for example `--method {}`.
    """

    def __init__(
        self,
        *args: Any,
        variants: Mapping[str, CommandVariant],
        choose: Callable[[Sequence[str]], str | None],
        default: str,
        more: Callable[[], Mapping[str, CommandVariant]] = dict,
        shows_default: bool = False,
        what: str,
        chosen_by: str,
        **kwargs: Any,
    ) -> None:
        super().__init__(*args, **kwargs)
        self.variants, self.choose, self.default = variants, choose, default
        self.shows_default = shows_default
        self.what, self.chosen_by, self.more = what, chosen_by, more

    def variant(self, name: str) -> CommandVariant | None:
        """Return the variant of that name, built in or of a plug-in; None if missing."""
        return self.variants[name] if name in self.variants else self.more().get(name)

    def existing(self, name: str) -> CommandVariant:
        """Return the variant of a name that `parse_args` has checked to exist."""
        found = self.variant(name)
        assert found is not None  # checked by parse_args
        return found

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Return the shared options, then those of the chosen variant, if any (none for --help without a choice)."""
        shared = super().get_params(ctx)
        name = ctx.meta.get(CHOSEN)
        if name is None:
            return shared
        own = list(self.existing(name).params())
        last = shared[-1:] if shared and shared[-1].name == "help" else []
        return [*shared[: len(shared) - len(last)], *own, *last]

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Choose the variant named in `args`, parse with its options, and return the words that are left.

        Usage error for an unknown variant, an option of other variants (which it names), or superfluous arguments.
        """
        name = self.choose(args)
        if name is not None and self.variant(name) is None:
            names = [*self.variants, *self.more()]
            raise UnknownNameError(f"no {self.what} {name!r}; {did_you_mean(name, names)}", ctx)
        if name is None and (self.shows_default or not any(a in ctx.help_option_names for a in args)):
            name = self.default
        if name is not None:
            ctx.meta[CHOSEN] = name
        ctx.allow_extra_args = True
        try:
            left = super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            raise click.UsageError(self._refusal(error, name or self.default), ctx) from error
        if left and not ctx.resilient_parsing:
            raise click.UsageError(f"{left[0]}: one argument too many for {self.called(name or self.default)}", ctx)
        return left

    def _refusal(self, error: click.NoSuchOption, name: str) -> str:
        """Return the message on an option that the variant `name` lacks: which variants have it, or similar options."""
        owners = [
            other
            for other, variant in self.variants.items()
            if any(error.option_name in (*p.opts, *p.secondary_opts) for p in variant.params())
        ]
        if not owners:
            return unknown_option(error.option_name, (*self.params, *self.existing(name).params()))
        statement = f"{error.option_name} is an option of {self._named(owners)}, not of {self.called(name)}"
        return f"{statement}; leave it out, or choose one that has it"

    def classes(self, ctx: click.Context) -> Sequence[type[Settings]]:
        """Return the settings classes that --set accepts: those of the chosen variant."""
        return self.existing(ctx.meta[CHOSEN]).settings()

    def called(self, name: str) -> str:
        """Return the words that choose the variant `name`, for example `--method apf`."""
        own = self.existing(name).called
        return self.chosen_by.format(name) if own is None else own

    def _named(self, names: Sequence[str]) -> str:
        """Return the words that choose the variants `names`: `--method apf, imm`."""
        similar = [n for n in names if self.variants[n].called is None]
        own = [self.called(n) for n in names if n not in similar]
        return ", ".join([*own, *([self.chosen_by.format(", ".join(similar))] if similar else [])])

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the sections of --help: shared options, options and settings of the chosen variant, all variants."""
        name = ctx.meta.get(CHOSEN)
        own_names = {p.name for p in (self.existing(name).params() if name else ())}
        shared = help_rows(ctx, [p for p in self.get_params(ctx) if p.name not in own_names])
        with formatter.section("Options"):
            formatter.write_dl(shared)
        if name is not None:
            self._format_own(ctx, formatter, name)
        if name is None or (self.shows_default and name == self.default):
            with formatter.section(
                f"{self.what.capitalize()}s ({self.chosen_by.format('NAME')} --help lists the options of each)"
            ):
                formatter.write_dl([(v.called or n, v.summary) for n, v in {**self.variants, **self.more()}.items()])

    def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the text of --help: that of the chosen variant if it has its own, else that of the command."""
        name = ctx.meta.get(CHOSEN)
        chosen = None if name is None else self.existing(name)
        if chosen is None or chosen.about is None:
            super().format_help_text(ctx, formatter)
            return
        formatter.write_paragraph()
        with formatter.indentation():
            formatter.write_text(f"{name}: {chosen.summary}.\n\n{inspect.cleandoc(chosen.about)}")

    def _format_own(self, ctx: click.Context, formatter: click.HelpFormatter, name: str) -> None:
        """Write sections of --help with the options and settings of the variant `name`."""
        chosen = self.existing(name)
        rows = help_rows(ctx, chosen.params())
        if rows:
            with formatter.section(f"Options of {self.called(name)}"):
                formatter.write_dl(rows)
        for settings in chosen.settings():
            write_settings(formatter, f"Settings of {self.called(name)} (--set NAME=VALUE)", settings)


def _texts_of_set(ctx: click.Context) -> Sequence[str]:
    """Return the texts NAME=VALUE of --set; empty for commands without it."""
    there = any(SET in param.opts for param in ctx.command.params)
    return ctx.params.get("settings", ()) if there else ()


def help_rows(ctx: click.Context, params: Sequence[click.Parameter]) -> list[tuple[str, str]]:
    """Return (option, help) for each of the parameters that is a visible option, for --help."""
    return [row for p in params if isinstance(p, click.Option) and (row := p.get_help_record(ctx)) is not None]


def value_after(args: Sequence[str], flag: str) -> str | None:
    """Return the value of the option `flag` in the words `args`, the last one if repeated; None if not given."""
    return next(iter(values_after(args, flag)[::-1]), None)


def values_after(args: Sequence[str], flag: str) -> list[str]:
    """Return all values of the option `flag` (`FLAG VALUE`, `FLAG=VALUE`) in `args`, in order, up to `--`."""
    found = []
    for i, arg in enumerate(args):
        if arg == "--":
            break
        if arg == flag and i + 1 < len(args):
            found.append(args[i + 1])
        elif arg.startswith(flag + "="):
            found.append(arg[len(flag) + 1 :])
    return found


CHOSEN_PLUGINS = "occlog.plugins"
"""Key of the plug-ins that the arguments name, with their options, in the metadata of click's context."""


class PluggedCommand(SettingsCommand):
    """Click command with an option that names a plug-in, and with the options of the named plug-ins.

    Args:
        flag: the option.
        kind: kind of the plug-ins.
        ours: values of the option that name no plug-in.
    """

    def __init__(self, *args: Any, flag: str, kind: str, ours: Collection[str] = (), **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.flag, self.kind, self.ours = flag, kind, ours

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Return the command's own options, then those of the named plug-ins."""
        shared = super().get_params(ctx)
        own = [option for some in ctx.meta.get(CHOSEN_PLUGINS, {}).values() for option in some]
        last = shared[-1:] if shared and shared[-1].name == "help" else []
        return [*shared[: len(shared) - len(last)], *own, *last]

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Add the options of the plug-ins named in `args`, parse, and return the words that are left."""
        if not ctx.resilient_parsing:
            ctx.meta[CHOSEN_PLUGINS] = self.options_of(values_after(args, self.flag))
        return super().parse_args(ctx, args)

    def options_of(self, names: Iterable[str]) -> dict[Plugin, list[SettingOption]]:
        """Return the options of each plug-in in `names`; UsageError for a name neither built in nor of a plug-in."""
        found = {}
        for name in names:
            if name not in self.ours:
                plugin = wanted(name, self.kind, self.flag, self.ours)
                found[plugin] = plugin_options(plugin, self.params)
        return found

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the sections of --help: own options, and those of the named plug-ins, or a list of installed ones."""
        chosen = ctx.meta.pop(CHOSEN_PLUGINS, {})
        super().format_options(ctx, formatter)
        ctx.meta[CHOSEN_PLUGINS] = chosen
        for plugin, params in chosen.items():
            rows = [row for option in params if (row := option.get_help_record(ctx)) is not None]
            if rows:
                with formatter.section(f"Options of {self.flag} {plugin.name} ({plugin.origin})"):
                    formatter.write_dl(rows)
        others = [] if chosen else installed(self.kind)
        if others:
            title = f"{self.kind.capitalize()}s of plug-ins ({self.flag} NAME --help lists the options of each)"
            with formatter.section(title):
                formatter.write_dl([(plugin.name, plugin.summary) for plugin in others])


def wanted(name: str, kind: str, flag: str, ours: Collection[str] = ()) -> Plugin:
    """Return the plug-in of a name and kind; UsageError, with the most similar name, if missing.

    Args:
        name: name of the plug-in.
        kind: kind of the plug-in, for example `filter`.
        flag: option that named it, for the message.
        ours: names of occlog itself that the option takes, for the suggestion.
    """
    plugin = find(name, kind)
    if plugin is None:
        names = [*ours, *(each.name for each in installed(kind))]
        raise UsageError(f"{flag} {name!r}: no such {kind}; {did_you_mean(name, names)}", id="unknown-name")
    return plugin


def plugin_options(plugin: Plugin, there: Sequence[click.Parameter]) -> list[SettingOption]:
    """Return a command-line option for each setting of a plug-in.

    `there`: parameters of the command; PluginError if one of them has the name of such an option.
    """
    settings = plugin.load().settings
    taken = {name for param in there for name in (*param.opts, *param.secondary_opts)}
    found = [SettingOption(settings, f, _prefix(plugin), plugin.name) for f in declared(settings)]
    for option in found:
        both = taken.intersection((*option.opts, *option.secondary_opts))
        if both:
            raise PluginError(f"{plugin.label}: {both.pop()} is an option of the command itself; rename the setting")
    return found


def chosen_in(ctx: click.Context, values: Mapping[str, object]) -> tuple[Chosen, ...]:
    """Return the plug-ins named on the command line, with those of their settings that were given.

    `values`: values of all options by parameter name.
    """
    plugins: dict[Plugin, list[SettingOption]] = ctx.meta.get(CHOSEN_PLUGINS, {})
    out = []
    for plugin, options in plugins.items():
        given = [(option, values.get(str(option.name))) for option in options]
        out.append(Chosen(plugin, {each.setting: each.default_text(v) for each, v in given if v not in (None, ())}))
    return tuple(out)


def _prefix(plugin: Plugin) -> str:
    return "plugin_" + "".join(c if c.isalnum() else "_" for c in plugin.name) + "_"
