"""A plug-in that the user has chosen, with the settings that were given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, NamedTuple

from occlog.settings import Settings, configure

from .loading import Plugin, said_by


class Chosen(NamedTuple):
    """A plug-in and its settings.

    Attributes:
        plugin: the plug-in.
        values: settings as far as they were given.
    """

    plugin: Plugin
    values: Mapping[str, object]

    def config(self, length_unit: str) -> Settings:
        """All settings, for lengths in this unit."""
        of = self.plugin.load()
        with said_by(self.plugin):
            defaults: Settings = of.settings.in_unit(length_unit)
        return configure(defaults, self.values)

    def make(self, length_unit: str, *more: Any) -> Any:
        """A new object of the plug-in; PluginError where it fails."""
        of, config = self.plugin.load(), self.config(length_unit)
        with said_by(self.plugin):
            return of(config, *more)

    def provenance(self, length_unit: str) -> dict[str, object]:
        """Name, package, version and all settings, for the provenance of what is made."""
        return {"name": self.plugin.name, "package": self.plugin.origin, **asdict(self.config(length_unit))}
