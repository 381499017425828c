"""The published schemas: tables, MCAP messages, scene files; all made from the declarations in the code."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import partial

import msgspec

from occlog.errors import UsageError
from occlog.io.formats.scenes.paths import paths_schema
from occlog.io.formats.scenes.scene import SceneSpec
from occlog.io.recording.rows import RECORDED, message_schema, schema_of
from occlog.io.recording.writer import VIDEO_FRAME, VIDEO_FRAME_SCHEMA
from occlog.records.columns import ANY_WIDTH, ColumnTable
from occlog.records.tables import TABLES
from occlog.records.verdicts import Verdict

from .fundamental_matrices import epipolar_schema
from .motion_models import motion_schema, path_loss_schema
from .networks import network_schema

_KINDS = {"i8": "int64", "i4": "int32", "f8": "float64", "f4": "float32", "?": "bool", "U": "string"}


def table_definition(table: type[ColumnTable]) -> dict[str, object]:
    """Published schema of a table, as JSON-compatible values: name, version, key, and its columns with units."""
    return {
        "name": table.NAME,
        "version": table.VERSION,
        "description": " ".join((table.__doc__ or "").split()),
        "key": list(table.KEY),
        "columns": [
            {
                "name": c.name,
                "type": f"{_KINDS[c.kind]}[{'' if c.width == ANY_WIDTH else c.width}]" if c.width else _KINDS[c.kind],
                "unit": c.unit,
                "description": c.doc,
                **({"nan": c.nan} if c.nan is not None else {}),
            }
            for c in table.columns()
        ],
    }


def scene_schema() -> dict[str, object]:
    """JSON Schema of scene files, for editors and other programs."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **msgspec.json.schema(SceneSpec)}


def verdict_schema() -> dict[str, object]:
    """JSON Schema of a verdict; `verdicts` in the provenance of every output is a list of them."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **msgspec.json.schema(Verdict)}


SCHEMAS: dict[str, Callable[[], dict[str, object]]] = {
    **{name: partial(table_definition, table) for name, table in TABLES.items()},
    **{schema_of(table): partial(message_schema, table) for table in RECORDED},
    VIDEO_FRAME: lambda: VIDEO_FRAME_SCHEMA,
    "scene": scene_schema,
    "motion": motion_schema,
    "path_loss": path_loss_schema,
    "network": network_schema,
    "paths": paths_schema,
    "epipolar": epipolar_schema,
    "verdict": verdict_schema,
}
"""Every published schema by name; `schemas/NAME.json` holds its text."""


def schema_text(name: str, schemas: Mapping[str, Callable[[], dict[str, object]]] = SCHEMAS) -> str:
    """JSON text of the schema `name`, one of `schemas`; UsageError for an unknown name."""
    if name not in schemas:
        raise UsageError(f"no schema {name!r}; there are {', '.join(schemas)}", id="unknown-name")
    return json.dumps(schemas[name](), indent=2) + "\n"
