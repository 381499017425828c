"""Discovery of installed plug-ins by entry points, which are read only for names that are not built in, and for help.

`Chosen` is a plug-in selected by the user, with its settings.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from functools import cache
from typing import Any, NamedTuple

from occlog.errors import OcclogError, PluginError, UsageError, did_you_mean
from occlog.settings import Settings, configure

METHOD, VIEW_TRACKER, READER = "tracking method", "tracker in images", "reader"
DETECTOR, METRIC, EXPORTER = "detector", "metric", "exporter"


class PluginKind(NamedTuple):
    """A kind of plug-in.

    Attributes:
        group: entry point group under which packages register such plug-ins.
        wants: attributes that the class must have in addition to `summary` and `settings`.
    """

    group: str
    wants: tuple[str, ...]


KINDS = {
    METHOD: PluginKind("occlog.tracking_methods", ("step",)),
    VIEW_TRACKER: PluginKind("occlog.view_trackers", ("step",)),
    READER: PluginKind("occlog.readers", ("endings", "table", "read")),
    DETECTOR: PluginKind("occlog.detectors", ("detect",)),
    METRIC: PluginKind("occlog.metrics", ("units", "figures")),
    EXPORTER: PluginKind("occlog.exporters", ("tables", "write")),
}


class Plugin(NamedTuple):
    """An installed plug-in, not imported yet.

    Attributes:
        kind: kind of plug-in, a key of `KINDS`.
        name: name on the command line.
        where: `module:class` to import.
        package: name of the package that provides it.
        version: version of that package.
    """

    kind: str
    name: str
    where: str
    package: str
    version: str

    @property
    def origin(self) -> str:
        """Package and version of the plug-in, separated by a space, as in provenance."""
        return f"{self.package} {self.version}"

    @property
    def label(self) -> str:
        """`plug-in NAME (PACKAGE VERSION)`, for messages."""
        return f"plug-in {self.name} ({self.origin})"

    @property
    def summary(self) -> str:
        """Summary line of the plug-in, or the reason why it cannot be loaded."""
        try:
            return str(self.load().summary)
        except PluginError as error:
            return str(error)

    def load(self) -> Any:
        """Import the class of the plug-in, and return it.

        Raises:
            PluginError: the import fails, or the class lacks an attribute that its kind requires.
        """
        from importlib import import_module

        module, _, name = self.where.partition(":")
        with plugin_errors(self):
            found = import_module(module)
            for part in name.split("."):
                found = getattr(found, part)
        for wanted in ("summary", "settings", *KINDS[self.kind].wants):
            if getattr(found, wanted, None) is None:
                raise PluginError(f"{self.label}: {self.where} has no {wanted}; a {self.kind} must have one")
        return found


@contextmanager
def plugin_errors(plugin: Plugin) -> Iterator[None]:
    """Context manager that converts exceptions of a plug-in's code to PluginError.

    The message has the plug-in's name, the error and its line in the code. An OcclogError is raised as it is.
    """
    try:
        yield
    except OcclogError:
        raise
    except Exception as error:
        location, trace = "", error.__traceback__
        while trace is not None:
            file = trace.tb_frame.f_code.co_filename
            if "importlib" not in file:
                location = f" at {file}:{trace.tb_lineno}"
            trace = trace.tb_next
        reason = " ".join(str(error).split())[:160]
        raise PluginError(f"{plugin.label}: {type(error).__name__}: {reason}{location}") from error


def installed(kind: str | None = None) -> list[Plugin]:
    """Return the installed plug-ins of a kind (None: of all kinds), sorted by kind and name.

    A plug-in of a package that is on the path several times is listed once.
    """
    return [plugin for plugin in _installed(tuple(sys.path)) if kind in (None, plugin.kind)]


@cache
def _installed(path: tuple[str, ...]) -> tuple[Plugin, ...]:
    """Return all plug-ins of the packages on a module search path, sorted; cached, since reading metadata is slow.

    `path`: value of `sys.path`.
    """
    from importlib.metadata import distributions

    kinds = {kind.group: name for name, kind in KINDS.items()}
    found: dict[tuple[str, str, str], Plugin] = {}
    for package in distributions(path=list(path)):
        for point in package.entry_points:
            if point.group in kinds:
                plugin = Plugin(kinds[point.group], point.name, point.value, package.name, package.version)
                found.setdefault((*plugin[:2], package.name), plugin)
    return tuple(sorted(found.values()))


def find(name: str, *kinds: str) -> Plugin | None:
    """Return the installed plug-in with a name and one of the kinds `kinds`; None if there is none.

    Raises:
        UsageError: several packages have one of that name.
    """
    found = [plugin for plugin in installed() if plugin.name == name and plugin.kind in kinds]
    if len(found) > 1:
        packages = " and ".join(plugin.package for plugin in found)
        raise UsageError(f"plug-in {name}: is in {packages}; uninstall all but one of them", id="duplicate-name")
    return found[0] if found else None


def named(name: str) -> list[Plugin]:
    """Return all installed plug-ins with a name, of any kind.

    Raises:
        UsageError: there is none; the message suggests the most similar name.
    """
    found = [plugin for plugin in installed() if plugin.name == name]
    if not found:
        raise UsageError(
            f"no plug-in {name!r} is installed; {did_you_mean(name, [p.name for p in installed()])}", id="unknown-name"
        )
    return found


class Chosen(NamedTuple):
    """A plug-in selected by the user, with its settings.

    Attributes:
        plugin: the plug-in.
        values: values of its settings that the user gave, by name; others have their defaults.
    """

    plugin: Plugin
    values: Mapping[str, object]

    def config(self, length_unit: str) -> Settings:
        """Return the settings of the plug-in: defaults for scenes in `length_unit`, with the given values on top.

        Raises:
            PluginError: the plug-in cannot be imported, or its defaults are invalid.
            UsageError: an unknown setting, or an invalid text.
            SettingError: a value out of its range.
        """
        of = self.plugin.load()
        with plugin_errors(self.plugin):
            defaults: Settings = of.settings.in_unit(length_unit)
        return configure(defaults, self.values)

    def make(self, length_unit: str, *more: Any) -> Any:
        """Return a new object of the plug-in's class.

        Args:
            length_unit: unit of lengths in which the settings' defaults are made.
            *more: arguments of the constructor after the settings, for example the generator of random numbers.

        Raises:
            PluginError: the import or the constructor fails.
        """
        of, config = self.plugin.load(), self.config(length_unit)
        with plugin_errors(self.plugin):
            return of(config, *more)

    def provenance(self, length_unit: str) -> dict[str, object]:
        """Return name, package and all settings of the plug-in, for the provenance of outputs.

        `length_unit`: unit in which the settings' defaults are made.
        """
        return {"name": self.plugin.name, "package": self.plugin.origin, **asdict(self.config(length_unit))}
