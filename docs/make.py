"""Writes the pages that are made from the code: commands, settings, tables, folders and the picture of the rooms."""

from __future__ import annotations

import copy
import csv
import re
from collections.abc import Sequence
from pathlib import Path

import click

from docs.api import api_page
from docs.doctor import doctor_page
from docs.rooms import folders_page, picture
from docs.verdicts import verdicts_page
from occlog.cli.main import COMMANDS, cli
from occlog.cli.setting_options import CHOSEN, VariantCommand, value_words
from occlog.examine.schema import settings_of, verbs
from occlog.records.columns import ANY_WIDTH, Column, ColumnTable
from occlog.records.error_ids import ERRORS
from occlog.records.messages import DOCTOR, VERDICT
from occlog.records.tables import TABLES
from occlog.settings import Settings, declaration, declared, default_in

FOLDER = Path(__file__).resolve().parent
WIDTH = 100


def help_text(command: click.Command, name: str, variant: str | None = None) -> str:
    """`--help` of a command, or of one of its variants, as it is printed at a fixed width."""
    alike = copy.copy(command)
    if "_help_option" in vars(alike):  # click keeps it as it was when the command was first asked for help
        vars(alike)["_help_option"] = None
    context = click.Context(
        alike,
        info_name=name,
        max_content_width=WIDTH,
        terminal_width=WIDTH,
        help_option_names=["-h", "--help"],
    )
    if variant is not None:
        context.meta[CHOSEN] = variant
    return alike.get_help(context).rstrip()


def variant_text(command: VariantCommand, name: str, variant: str) -> str:
    """What a variant takes beside the shared options: the end of its `--help`."""
    text = help_text(command, name, variant)
    marks = [text.find(f"\n{what} of {command.called(variant)}") for what in ("Options", "Settings")]
    own = text[min((m for m in marks if m >= 0), default=len(text)) :]
    return own.partition(f"\n{command.what.capitalize()}s (")[0].strip()


def commands_page() -> str:
    """The command line: the help of every command."""
    parts = ["# The command line\n\nMade by `make docs` from the `--help` of every command.\n"]
    parts.append(f"```text\n{help_text(cli, 'occlog')}\n```\n")
    for name in COMMANDS:
        command = cli.get_command(click.Context(cli), name)
        if command is not None:
            parts.append(f"## occlog {name}\n\n```text\n{help_text(command, f'occlog {name}')}\n```\n")
        if isinstance(command, VariantCommand):
            for variant in command.variants:
                text = variant_text(command, f"occlog {name}", variant)
                parts.append(f"### occlog {name} {command.called(variant)}\n\n```text\n{text}\n```\n")
        if isinstance(command, click.Group):
            for part, own in command.commands.items():
                text = help_text(own, f"occlog {name} {part}")
                parts.append(f"### occlog {name} {part}\n\n```text\n{text}\n```\n")
    return "\n".join(parts)


def table_section(table: type[ColumnTable]) -> str:
    """Columns of one table, and those that some files of it have besides."""
    summary = " ".join((table.__doc__ or "").split())
    head = f"## {table.NAME}\n\n{summary}\n\nSorted by {', '.join(f'`{k}`' for k in table.KEY)}.\n\n"
    parts = [head + columns_table(table.columns())]
    known = {c.name for c in table.columns()}
    # A dataclass with slots is made twice, and both classes count as subclasses
    wider_ones = {of.__name__: of for of in table.__subclasses__() if of.NAME == table.NAME}
    for _, wider in sorted(wider_ones.items()):
        more = [c for c in wider.columns() if c.name not in known]
        summary = " ".join((wider.__doc__ or "").split())
        parts.append(f"### {table.NAME}: `{wider.__name__}`\n\n{summary} More columns:\n\n{columns_table(more)}")
    return "\n".join(parts)


def columns_table(columns: Sequence[Column]) -> str:
    """A row for each column."""
    rows = [
        f"| `{c.name}` | {c.dtype.name if c.kind != 'U' else 'string'}{_extent(c)} "
        f"| {c.unit} | {c.doc}{f' (NaN: {c.nan})' if c.nan else ''} |"
        for c in columns
    ]
    return "| column | type | unit | meaning |\n|---|---|---|---|\n" + "\n".join(rows) + "\n"


def _extent(c: Column) -> str:
    """How many numbers a row of a column has, in words."""
    return f" x {'any' if c.width == ANY_WIDTH else c.width}" if c.width else ""


def tables_page() -> str:
    """Every table with its columns."""
    head = (
        "# Tables\n\nMade by `make docs` from `occlog/records/tables.py`; `occlog schema NAME` prints them as JSON.\n\n"
        "Time is int64 nanoseconds since the Unix epoch. World frame: x, y on the ground, z up, in the scene's\n"
        "length unit (m below stands for it). Angles are radians from +x towards +y in [-pi, pi). Pixels: x to the\n"
        "right, y down, the centre of the first pixel is (0, 0).\n"
    )
    return "\n".join([head, *(table_section(t) for t in TABLES.values())])


def settings_table(of: type[Settings]) -> str:
    """Every setting of a class: its name, defaults, range, unit, option and meaning."""
    rows = []
    for f in declared(of):
        spec = declaration(f)
        people, own = (value_words(f, default_in(f, unit)) for unit in ("m", ""))
        option = f"`{spec.option}`" if spec.option else ""
        unit = spec.unit.replace("length", "m")
        cells = (f"`{f.name}`", people, "" if own == people else own, spec.limit(), unit, option, spec.help)
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    head = "| setting | default | in a scene-specific unit | range | unit | option | meaning |\n|" + 7 * "---|"
    return "\n".join([head, *rows]) + "\n"


def settings_page() -> str:
    """Every setting of every verb."""
    parts = [
        "# Settings\n\nMade by `make docs` from the declarations in the code; `occlog schema VERB` prints them as JSON "
        "Schema.\n\nDefaults are those of a scene in metres; in feet and inches lengths are converted. Where a scene "
        "has a unit of its own\nthe next column has the default, if it is another. What has no option of its own is "
        "given by `--set NAME=VALUE` where\nthe command has it, or as a key of `occlog run` and `occlog sweep`.\n"
    ]
    for verb in verbs():
        classes = settings_of(verb)
        parts.append(f"## occlog {verb}\n")
        for name, of in classes.items():
            title = f"### {name}\n\n" if len(classes) > 1 else ""
            summary = (of.__doc__ or "").split("\n\n")[0]
            parts.append(f"{title}{' '.join(summary.split())}\n\n{settings_table(of)}")
    return "\n".join(parts)


def messages_page() -> str:
    """Every finding of verdicts and of `occlog doctor`, by its id."""
    out = (
        "# Messages\n\nMade by `make docs` from the table in the code (`occlog.records.messages`). Words in italics "
        "stand for values, which\n`--json` has too. A warning makes results not plausible; a note does not, and some "
        "warnings are notes where they\nare weak. [When to believe an estimate](../explanation/believe.md) has limits "
        "and causes.\n"
    )
    parts = {"Findings of verdicts": VERDICT, "Findings of `occlog doctor`": DOCTOR}
    for title, messages in parts.items():
        out += f"\n## {title}\n\n| id | severity | when | what to do |\n|---|---|---|---|\n"
        for name, each in messages.items():
            when = f"{each.text} (limit: {each.limit})" if each.limit else each.text
            out += f"| `{name}` | {each.severity} | {_with_fields(when)} | {_with_fields(each.remedy)} |\n"
    return out


def errors_page() -> str:
    """Every kind of error, by its id."""
    out = (
        "# Errors\n\nMade by `make docs` from the table in the code (`occlog.records.error_ids`). The message of an "
        "error names the file, the\nposition in it, the value, the limit and the remedy; the id is the kind of error, "
        "and never changes its meaning. It is\nthe key `id` of the object that a failing command prints with `--json` "
        "([in a shell](command-line.md#errors)), and the\nattribute `id` of an exception in Python. Findings about "
        "results and files have [ids of their own](messages.md).\n\n| id | meaning | what to do |\n|---|---|---|\n"
    )
    return out + "".join(f"| `{name}` | {each.meaning} | {each.remedy} |\n" for name, each in ERRORS.items())


KINDS = {
    "setting": "Settings",
    "option": "Options",
    "run": "Keys of configurations",
    "scene": "Keys of scenes",
    "table": "Tables",
    "column": "Columns",
    "value": "Values",
    "summary": "Figures of summaries and metrics",
    "message": "Messages",
    "check": "Checks",
}
"""Headings of the kinds of names in `renamed.csv`."""


def renamed_page() -> str:
    """Public names of the last release, and what replaces them."""
    rows = list(csv.DictReader((FOLDER.parent / "occlog" / "renamed.csv").read_text("utf-8").splitlines()))
    out = (
        "# Names that changed since 0.1.0\n\nMade by `make docs` from `occlog/renamed.csv`. In this release occlog "
        "answers an old setting, option, key, column\nor figure with the new name. Scenes with old keys are read.\n"
    )
    for kind, title in KINDS.items():
        out += f"\n## {title}\n\n| of | old | new |\n|---|---|---|\n"
        for row in rows:
            if row["kind"] == kind:
                out += f"| {row['owner']} | `{row['old']}` | `{row['new']}` |\n"
    return out


def _with_fields(template: str) -> str:
    """A template with names in italics for its fields, and with options as in the command line."""
    text = re.sub(r"\{option\[([^]]+)\]\}", lambda found: f"`--{found[1].replace('_', '-')}`", template)
    return re.sub(r"\{(\w+)[^}]*\}", lambda found: f"*{found[1].replace('_', ' ')}*", text)


PAGES = {
    "reference/api.md": api_page,
    "reference/commands.md": commands_page,
    "how-to/doctor.md": doctor_page,
    "reference/errors.md": errors_page,
    "reference/messages.md": messages_page,
    "reference/renamed.md": renamed_page,
    "reference/settings.md": settings_page,
    "reference/tables.md": tables_page,
}
"""Reference pages of the program."""
RESULTS = {"research/verdicts.md": verdicts_page}
"""What runs of the experiments gave."""
ROOMS = {"development/rooms.svg": picture, "development/folders.md": folders_page}
"""How the code is laid out."""


def main() -> None:
    """Write every page."""
    for name, make in {**PAGES, **RESULTS, **ROOMS}.items():
        (FOLDER / name).write_text(make(), encoding="utf-8")


if __name__ == "__main__":
    main()
