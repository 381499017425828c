"""The `occlog schema` command."""

from __future__ import annotations

from pathlib import Path

import click

from occlog.cli import options


@click.command(name="schema", short_help="Print the schema of a table, a message or a file format.")
@click.argument("name", required=False)
@click.option("-o", "--output", type=options.PATH, default=None, help="Write every schema into this folder.")
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
def command(name: str | None, output: Path | None, overwrite: bool) -> None:
    """Print the schema NAME as JSON, or list the names.

    Tables are column definitions (type, unit, meaning); messages and file formats are JSON Schemas.

    \b
      occlog schema bearings | jq -r '.columns[] | [.name, .unit, .description] | @tsv'
    """
    from occlog.io.files.atomic import write_bytes
    from occlog.io.models.schemas import SCHEMAS, schema_text

    if output is not None:
        for each in SCHEMAS:
            write_bytes(output / f"{each}.json", schema_text(each).encode(), overwrite)
    elif name is None:
        click.echo("\n".join(SCHEMAS))
    else:
        click.echo(schema_text(name), nl=False)
