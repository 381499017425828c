"""`occlog schema`, and JSON Schemas of the settings of all commands, made from the declarations.

Settings classes are named as text and imported on request.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from occlog.cli import options
from occlog.errors import UsageError, did_you_mean

if TYPE_CHECKING:
    from occlog.settings import Settings

PUBLISHED = Path(__file__).parent.parent / "schemas"
"""The schemas as text, made by `occlog schema -o`: printing one loads nothing of what it describes."""
METHODS = "occlog.track.catalogue:METHODS"
"""The tracking methods, each with the text of its class of settings."""
CLASSES: dict[str, tuple[str, ...]] = {
    "ingest": ("occlog.ingest.plan:IngestPlan",),
    "simulate": (
        "occlog.simulate.config:WorldConfig",
        "occlog.simulate.config:FieldConfig",
        "occlog.simulate.config:ObserveConfig",
        "occlog.simulate.config:SoundConfig",
        "occlog.simulate.config:RenderConfig",
        "occlog.simulate.config:StoreConfig",
        "occlog.simulate.config:PeopleConfig",
        "occlog.simulate.balls.config:BallsConfig",
    ),
    "traffic": ("occlog.papers.lee.traffic.config:TrafficConfig",),
    "calibrate": ("occlog.calibrate.config:CalibrateConfig",),
    "listen": ("occlog.measure.doa.config:DoaConfig",),
    "epipolar": ("occlog.measure.epipolar.config:EpipolarConfig",),
    "detect": (
        "occlog.measure.detect.config:DetectConfig",
        "occlog.measure.networks.config:NetworkConfig",
    ),
    "fuse": (
        "occlog.measure.fuse.config:FuseConfig",
        "occlog.measure.fuse.tracks.config:TrackFusionConfig",
    ),
    "priors": (
        "occlog.measure.priors.config:PositionPriorConfig",
        "occlog.measure.priors.config:HullConfig",
        "occlog.measure.priors.config:AcousticConfig",
    ),
    "label": (
        "occlog.measure.associate.config:LabelConfig",
        "occlog.measure.appearance.config:MatchConfig",
        "occlog.measure.associate.config:NamingConfig",
    ),
    "appearance": ("occlog.measure.appearance.config:LearnConfig",),
    "fit-motion": ("occlog.track.methods.map.fit_motion.config:FitConfig",),
    "fit-readers": ("occlog.track.methods.readers.fit.config:FitReadersConfig",),
    "evaluate": (
        "occlog.evaluate.matching.config:EvaluateConfig",
        "occlog.evaluate.mot.config:MultiTargetConfig",
    ),
    "ground": ("occlog.track.methods.images.ground.config:GroundConfig",),
    "report": ("occlog.report.comparison.config:RunComparisonConfig",),
    "navigate": ("occlog.papers.lee.navigation.config:NavigateConfig",),
    "plan": ("occlog.plan.config:PlanConfig",),
}
"""Classes of settings of each verb but `track`."""
AROUND_METHODS = (
    "occlog.track.methods.images.initiation.config:ViewsConfig",
    "occlog.track.methods.apf.config:SelectConfig",
    "occlog.scans.config:DistanceMeasurementConfig",
)
"""Settings that several methods of `track` share."""
DRAFT = "https://json-schema.org/draft/2020-12/schema"
NAMES = {"epipolar": "epipolar-settings", "plan": "plan-settings"}
"""Verbs with a name that is that of a file's schema."""


def load(where: str) -> Any:
    """Import and return the object that `where` names as `module:name`."""
    module, _, name = where.partition(":")
    return getattr(importlib.import_module(module), name)


def verbs() -> tuple[str, ...]:
    """Return the names of the commands that have settings."""
    return (*CLASSES, "track")


def settings_of(verb: str) -> dict[str, type[Settings]]:
    """Return the settings classes of a command by name of their group; of `track` by method, and shared groups."""
    if verb != "track":
        classes = [load(where) for where in CLASSES[verb]]
        return {of.OWNER: of for of in classes}
    methods = {name: load(entry.settings) for name, entry in load(METHODS).items()}
    return methods | {of.OWNER: of for of in map(load, AROUND_METHODS)}


def settings_schema(verb: str) -> dict[str, object]:
    """Return the JSON Schema of the settings of a command; of several settings classes, an object matches one."""
    from occlog.settings import json_schema

    parts = {name: json_schema(of) for name, of in settings_of(verb).items()}
    head = {"$schema": DRAFT, "title": f"occlog {verb}: settings"}
    if len(parts) == 1:
        return head | next(iter(parts.values()))
    definitions = {part_key(name): part for name, part in parts.items()}
    return head | {"anyOf": [{"$ref": f"#/$defs/{name}"} for name in definitions], "$defs": definitions}


def part_key(name: str) -> str:
    """Return the key of a schema definition: the name with hyphens instead of blanks."""
    return name.replace(" ", "-")


def settings_schemas() -> dict[str, Callable[[], dict[str, object]]]:
    """Return functions that make the schema of the settings of each command, by published name."""
    return {NAMES.get(verb, verb): partial(settings_schema, verb) for verb in verbs()}


def every_schema() -> dict[str, Callable[[], dict[str, object]]]:
    """Return functions that make all schemas, by published name.

    They are of tables, messages, file formats, settings, and the output of `doctor`.
    """
    from occlog.io.formats.models.schemas import SCHEMAS

    from .doctor.findings import finding_schema

    return {**SCHEMAS, **settings_schemas(), "doctor": finding_schema}


@click.command(name="schema", short_help="Print the JSON Schema of a table, a file format or settings.")
@click.argument("name", required=False)
@click.option("-o", "--output", type=options.PATH, default=None, help="Write every schema into this folder.")
@options.overwrite_opt
@click.option("--json", "as_json", is_flag=True, help="List the names as JSON; schemas are JSON anyway.")
def command(name: str | None, output: Path | None, overwrite: bool, as_json: bool) -> None:
    """Print the schema NAME as JSON, or list the names.

    Tables are column definitions (type, unit, meaning); messages, file formats and settings are JSON Schemas. The
    settings of a command have its name; those of each tracking method are a definition in `track`. The settings of
    a plug-in are printed for its name.

    \b
      occlog schema bearings | jq -r '.columns[] | [.name, .unit, .description] | @tsv'
      occlog schema track | jq '."$defs".map.properties | keys'
    """
    if output is not None:
        from occlog.io.files.atomic import write_bytes
        from occlog.io.formats.models.schemas import schema_text

        schemas = every_schema()
        for each in schemas:
            write_bytes(output / f"{each}.json", schema_text(each, schemas).encode(), overwrite)
        return
    names = sorted(path.stem for path in PUBLISHED.glob("*.json"))
    if name is None:
        click.echo(json.dumps(names) if as_json else "\n".join(names))
    elif name not in names:
        click.echo(json.dumps(_of_plugin(name, names), indent=2))
    else:
        click.echo((PUBLISHED / f"{name}.json").read_text(encoding="utf-8"), nl=False)


def _of_plugin(name: str, names: Sequence[str]) -> dict[str, object]:
    """Return the JSON Schema of a plug-in's settings; of several plug-ins with this name, a definition for each kind.

    UsageError if there is none.

    Args:
        name: name of the plug-in.
        names: names of occlog's schemas, for a hint in the error.
    """
    from occlog.plugins.loading import installed
    from occlog.settings import json_schema

    found = [plugin for plugin in installed() if plugin.name == name]
    if not found:
        hint = did_you_mean(name, [*names, *(p.name for p in installed())], "`occlog schema` lists all:")
        raise UsageError(f"no schema {name!r}; {hint}", id="unknown-name")
    parts = {part_key(plugin.kind): json_schema(plugin.load().settings) for plugin in found}
    title = f"{found[0].label}: settings" if len(found) == 1 else f"plug-ins {name}: settings"
    head: dict[str, object] = {"$schema": DRAFT, "title": title}
    if len(parts) == 1:
        return head | next(iter(parts.values()))
    return head | {"anyOf": [{"$ref": f"#/$defs/{kind}"} for kind in parts], "$defs": parts}
