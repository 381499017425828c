"""The `occlog schema` command."""

from __future__ import annotations

from pathlib import Path

import click

from occlog.cli import options


@click.command(name="schema", short_help="Print the schema of a table, a message, a file format or settings.")
@click.argument("name", required=False)
@click.option("-o", "--output", type=options.PATH, default=None, help="Write every schema into this folder.")
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
def command(name: str | None, output: Path | None, overwrite: bool) -> None:
    """Print the schema NAME as JSON, or list the names.

    Tables are column definitions (type, unit, meaning); messages, file formats and settings are JSON Schemas.
    The settings of a verb have its name; those of each tracking method are a definition in `track`.

    \b
      occlog schema bearings | jq -r '.columns[] | [.name, .unit, .description] | @tsv'
      occlog schema track | jq '."$defs".map.properties | keys'
    """
    from occlog.io.files.atomic import write_bytes
    from occlog.io.models.schemas import SCHEMAS, schema_text

    from .declared_settings import settings_schemas

    schemas = SCHEMAS | settings_schemas()
    if output is not None:
        for each in schemas:
            write_bytes(output / f"{each}.json", schema_text(each, schemas).encode(), overwrite)
    elif name is None:
        click.echo("\n".join(schemas))
    else:
        click.echo(schema_text(name, schemas), nl=False)
