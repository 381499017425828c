"""Every option of a command is an argument or a setting of its function, or python.md says that it is not."""

from __future__ import annotations

import inspect
from collections.abc import Callable

import click
import pytest
from places import ROOT

import occlog
from occlog.cli.main import cli
from occlog.cli.setting_options import CHOSEN, SettingOption, VariantCommand

PRINTED = {"overwrite", "quiet", "as_json", "strict", "dry_run", "verbose", "_click_default_help"}
"""What is printed, checked and replaced: of a command line, not of a function."""
CALLED = {
    "method": "settings",
    "turn": "in_turn",
    "others": "tracks",
    "size": "settings",
}
"""Options whose arguments have other names."""
FUNCTIONS: dict[str, tuple[Callable[..., object], ...]] = {
    "ingest": (occlog.ingest,),
    "detect": (occlog.detect,),
    "fuse": (occlog.fuse, occlog.fuse_tracks),
    "label": (occlog.label,),
    "track": (occlog.track,),
    "evaluate": (occlog.evaluate,),
    "simulate": (occlog.simulate,),
    "report": (occlog.report, occlog.overlay),
}
TABLES = {
    "ingest": set[str](),
    "detect": {"output", "views"},
    "fuse": {"output", "fused_views", "events"},
    "label": {"output"},
    "track": {
        *("output", "diagnostics", "residuals", "associations", "events"),
        *("calibration", "particle_cloud", "cooperation", "view_tracks", "virtual_sensors", "ground_tracks"),
    },
    "evaluate": {"output", "errors", "bound", "failures", "counts"},
    "simulate": set[str](),
    "report": set[str](),
}
"""Outputs that are tables of the result."""
MISSING = {
    "label": {"--gallery", "--images", "--reidentified"},
    "evaluate": {"--write-scene", "--also", "--mot"},
    "report": {"other"},  # of two runs side by side
}
EVERYWHERE = {"--input-units", "--origin", "--reader"}
"""Options that have no argument on purpose."""


def options_of(name: str) -> list[click.Parameter]:
    """All parameters of a command and of its variants that are no settings."""
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    found = {}
    for variant in [None, *(command.variants if isinstance(command, VariantCommand) else ())]:
        context = click.Context(command, info_name=name)
        if variant is not None:
            context.meta[CHOSEN] = variant
        found |= {str(p.name): p for p in command.get_params(context) if not isinstance(p, SettingOption)}
    return list(found.values())


@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_a_command_takes_its_function_takes(name: str) -> None:
    arguments = set[str]().union(*(inspect.signature(f).parameters for f in FUNCTIONS[name]))
    taken = arguments | PRINTED | TABLES[name]
    params = options_of(name)
    lacking = {p.opts[0] for p in params if not {str(p.name), CALLED.get(str(p.name), "")} & taken}
    assert lacking == MISSING.get(name, set()) | (EVERYWHERE & {p.opts[0] for p in params})
    page = (ROOT / "docs/how-to/python.md").read_text(encoding="utf-8")
    assert [flag for flag in sorted(lacking) if f"`{flag}`" not in page] == []
