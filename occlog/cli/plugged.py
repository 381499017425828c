"""Commands that plug-ins serve: the settings of a plug-in that the arguments name are options under its name.

An exporter `gpx` with the setting `creator` has the option `--gpx-creator`, so that several plug-ins can be used in one
call, and none takes a name of the command's own.  Installed plug-ins are looked at for a name that is not ours, and by
--help.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import click

from occlog.errors import PluginError, UsageError, did_you_mean
from occlog.plugins.chosen import Chosen
from occlog.plugins.loading import Plugin, find, installed
from occlog.settings import declared

from .setting_options import SettingOption, SettingsCommand, values_after

CHOSEN = "occlog.plugins"
"""Key of the plug-ins that the arguments name, with their options, in the metadata of click's context."""


class PluggedCommand(SettingsCommand):
    """A command with an option whose value can be the name of a plug-in.

    Args:
        flag: the option.
        kind: of the plug-ins.
        ours: values that name none.
    """

    def __init__(self, *args: Any, flag: str, kind: str, ours: Collection[str] = (), **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.flag, self.kind, self.ours = flag, kind, ours

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """The command's own options, then those of the plug-ins."""
        shared = super().get_params(ctx)
        own = [option for some in ctx.meta.get(CHOSEN, {}).values() for option in some]
        last = shared[-1:] if shared and shared[-1].name == "help" else []
        return [*shared[: len(shared) - len(last)], *own, *last]

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Find the plug-ins that the arguments name, then parse."""
        if not ctx.resilient_parsing:
            ctx.meta[CHOSEN] = self.options_of(values_after(args, self.flag))
        return super().parse_args(ctx, args)

    def options_of(self, names: Iterable[str]) -> dict[Plugin, list[SettingOption]]:
        """The plug-ins of some names with their options; UsageError for a name that is neither ours nor a plug-in's."""
        found = {}
        for name in names:
            if name not in self.ours:
                plugin = wanted(name, self.kind, self.flag, self.ours)
                found[plugin] = plugin_options(plugin, self.params)
        return found

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The command's own options; those of the plug-ins that are named; without any the installed plug-ins."""
        chosen = ctx.meta.pop(CHOSEN, {})
        super().format_options(ctx, formatter)
        ctx.meta[CHOSEN] = chosen
        for plugin, params in chosen.items():
            rows = [row for option in params if (row := option.get_help_record(ctx)) is not None]
            if rows:
                with formatter.section(f"Options of {self.flag} {plugin.name} ({plugin.origin})"):
                    formatter.write_dl(rows)
        others = [] if chosen else installed(self.kind)
        if others:
            title = f"{self.kind.capitalize()}s of plug-ins ({self.flag} NAME --help tells what each takes)"
            with formatter.section(title):
                formatter.write_dl([(plugin.name, plugin.summary) for plugin in others])


def wanted(name: str, kind: str, flag: str, ours: Collection[str] = ()) -> Plugin:
    """The plug-in of a name and kind; UsageError, with the nearest name, where there is none."""
    plugin = find(name, kind)
    if plugin is None:
        names = [*ours, *(each.name for each in installed(kind))]
        raise UsageError(f"{flag} {name!r}: no such {kind}; {did_you_mean(name, names)}")
    return plugin


def plugin_options(plugin: Plugin, there: Sequence[click.Parameter]) -> list[SettingOption]:
    """An option for each setting of a plug-in; PluginError where the command has one of that name itself."""
    settings = plugin.load().settings
    taken = {name for param in there for name in (*param.opts, *param.secondary_opts)}
    found = [SettingOption(settings, f, _prefix(plugin), plugin.name) for f in declared(settings)]
    for option in found:
        both = taken.intersection((*option.opts, *option.secondary_opts))
        if both:
            raise PluginError(f"{plugin.label}: {both.pop()} is an option of the command itself; rename the setting")
    return found


def chosen_in(ctx: click.Context, values: Mapping[str, object]) -> tuple[Chosen, ...]:
    """The plug-ins that the arguments name, with those values of the command's options that are settings of theirs."""
    plugins: dict[Plugin, list[SettingOption]] = ctx.meta.get(CHOSEN, {})
    out = []
    for plugin, options in plugins.items():
        given = [(option, values.get(str(option.name))) for option in options]
        out.append(Chosen(plugin, {each.setting: each.told(v) for each, v in given if v not in (None, ())}))
    return tuple(out)


def _prefix(plugin: Plugin) -> str:
    return "plugin_" + "".join(c if c.isalnum() else "_" for c in plugin.name) + "_"
