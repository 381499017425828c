"""Draws the rooms of the code and lists its folders, from the imports, the contracts and the docstrings."""

from __future__ import annotations

import ast
import textwrap
import tomllib
from collections import Counter
from html import escape
from pathlib import Path
from typing import NamedTuple

import grimp

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = "occlog"
GROUND = ("settings", "array_types", "errors", "request", "runner")
"""Modules that are no rooms: one strip at the bottom of the picture, without lines."""
SIZES = ((36, 9.0), (12, 6.5), (4, 4.5), (1, 2.8))
"""Radius of a dot [px] for at least so many imports. Classes, so that one more import rarely changes the picture."""

GUTTER, PITCH, FLOOR, TOP = 330, 50, 42, 6
BOX_W, BOX_H = 88, 26
INK, FAINT, LINE, BAND = "#1c2733", "#5a6876", "#9db0c3", "#f2f5f8"
ROOM, VERB = "#dbe7f3", "#fbe9cf"
EDGE = {ROOM: "#4f7ea8", VERB: "#c08a3e"}


class Rooms(NamedTuple):
    """The rooms from the top to the ground, and who imports whom."""

    layers: list[list[str]]  # the rooms of each floor, top floor first
    imports: dict[tuple[str, str], int]  # (importing room, imported room) -> number of imports between their modules
    about: dict[str, str]  # a room's docstring


def rooms() -> Rooms:
    """Read the floors from the contract "rooms", and the imports from the code."""
    graph = grimp.build_graph(PACKAGE, cache_dir=None)
    pairs = Counter(
        (room(importer), room(imported))
        for importer in graph.modules
        for imported in graph.find_modules_directly_imported_by(importer)
    )
    layers = [[name for name in floor if name not in GROUND] for floor in floors()]
    named = {name for floor in layers for name in floor}
    imports = {(a, b): n for (a, b), n in sorted(pairs.items()) if a != b and a in named and b in named}
    return Rooms([floor for floor in layers if floor], imports, {name: docstring(package(name)) for name in named})


def floors() -> list[list[str]]:
    """The order of the rooms, as the import contract in pyproject.toml states it."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contract = next(c for c in settings["tool"]["importlinter"]["contracts"] if c["name"] == "rooms")
    return [[part.strip().removeprefix(f"{PACKAGE}.") for part in layer.split("|")] for layer in contract["layers"]]


def room(module: str) -> str:
    """The part of a module's name after `occlog.`; empty for the package itself."""
    return module.split(".")[1] if "." in module else ""


def package(name: str) -> Path:
    """The file with the docstring of a room."""
    folder = ROOT / PACKAGE / name
    return folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")


def docstring(path: Path) -> str:
    """The first paragraph of a module's docstring on one line."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return " ".join(text.split("\n\n")[0].split())


def picture() -> str:
    """Draw the rooms as SVG: a floor for each layer, a box for each room, a dot where a room imports the one below."""
    plan = rooms()
    order = [name for floor in plan.layers for name in floor]
    place = {name: i for i, name in enumerate(order)}
    verbs = {name for name in order if plan.about[name].startswith("Verb")}
    width, height = GUTTER + PITCH * len(order) + BOX_W // 2, TOP + FLOOR * len(order) + 116
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        'font-family="Helvetica, Arial, sans-serif">',
        "<title>The rooms of occlog and which of them import which</title>",
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
    ]
    parts += _bands(plan.layers, width)
    parts += _lines(plan.imports, place)
    for name in order:
        parts += _room(name, place[name], plan.about[name], VERB if name in verbs else ROOM)
    parts += _dots(plan.imports, place)
    parts += _foot(TOP + FLOOR * len(order), width)
    return "\n".join([*parts, "</svg>", ""])


def _x(column: int) -> float:
    return GUTTER + PITCH * (column + 0.5)


def _y(row: int) -> float:
    return TOP + FLOOR * (row + 0.5)


def _bands(layers: list[list[str]], width: int) -> list[str]:
    """Every second floor is shaded; rooms of one floor share it."""
    parts, row = [], 0
    for i, floor in enumerate(layers):
        if i % 2 == 0:
            y, h = TOP + FLOOR * row, FLOOR * len(floor)
            parts.append(f'<rect x="0" y="{y}" width="{width}" height="{h}" fill="{BAND}"/>')
        row += len(floor)
    return parts


def _lines(imports: dict[tuple[str, str], int], place: dict[str, int]) -> list[str]:
    """One line out of each room to the right, and one into each room from above."""
    parts = []
    for name, i in place.items():
        right = [place[b] for a, b in imports if a == name]
        above = [place[a] for a, b in imports if b == name]
        if right:
            parts.append(f'<path d="M{_x(i):g} {_y(i):g}H{_x(max(right)):g}" stroke="{LINE}" fill="none"/>')
        if above:
            tip = _y(i) - BOX_H / 2
            parts.append(f'<path d="M{_x(i):g} {_y(min(above)):g}V{tip - 4:g}" stroke="{LINE}" fill="none"/>')
            parts.append(f'<path d="M{_x(i) - 4:g} {tip - 7:g}h8l-4 7z" fill="{FAINT}"/>')
    return parts


def _room(name: str, i: int, about: str, fill: str) -> list[str]:
    """A room's box on the diagonal, and what it is for at the left."""
    x, y = _x(i), _y(i)
    parts = [
        f'<rect x="{x - BOX_W / 2:g}" y="{y - BOX_H / 2:g}" width="{BOX_W}" height="{BOX_H}" rx="4" fill="{fill}" '
        f'stroke="{EDGE[fill]}"/>',
        f'<text x="{x:g}" y="{y + 4.5:g}" font-size="12" font-weight="bold" text-anchor="middle" '
        f'fill="{INK}">{name}</text>',
    ]
    width = x - BOX_W / 2 - 18
    text = about.removeprefix("Verbs: ").removeprefix("Verb: ").replace("`", "")
    lines = textwrap.wrap(text[:1].upper() + text[1:], int(width / 6.3))
    for k, line in enumerate(lines):
        at = y + 4 + 14 * (k - (len(lines) - 1) / 2)
        parts.append(f'<text x="10" y="{at:g}" font-size="11.5" fill="{FAINT}">{escape(line)}</text>')
    return parts


def _dots(imports: dict[tuple[str, str], int], place: dict[str, int]) -> list[str]:
    return [
        f'<circle cx="{_x(place[b]):g}" cy="{_y(place[a]):g}" r="{_radius(n)}" fill="{INK}"/>'
        for (a, b), n in imports.items()
    ]


def _radius(count: int) -> float:
    return next(radius for least, radius in SIZES if count >= least)


def _foot(y: float, width: int) -> list[str]:
    """The ground, and how to read the picture."""
    ground = f"{', '.join(GROUND)}: modules without a room (their lines are not drawn)."
    parts = [
        f'<rect x="4" y="{y + 6:g}" width="{width - 8}" height="26" rx="4" fill="#e3e6ea" stroke="#8a949e"/>',
        _text(width / 2, y + 23.5, ground, anchor="middle"),
        _text(10, y + 58, "Follow a room's line to the right: under each dot stands a room that it uses."),
        _text(
            10,
            y + 80,
            "Lines run to the right and down only; an import back up breaks a contract, and the linter fails. "
            "Rooms of one floor do not use each other.",
        ),
        _text(560, y + 58, "Imports:"),
    ]
    x = 630.0
    for k in range(len(SIZES) - 1, -1, -1):
        least, radius = SIZES[k]
        label = f"{least} and more" if k == 0 else f"{least} to {SIZES[k - 1][0] - 1}"
        parts.append(f'<circle cx="{x:g}" cy="{y + 54:g}" r="{radius}" fill="{INK}"/>')
        parts.append(_text(x + 14, y + 58, label))
        x += 88
    for k, (fill, text) in enumerate(((VERB, "rooms of verbs"), (ROOM, "rooms that verbs share"))):
        left = 10 + 150 * k
        parts.append(
            f'<rect x="{left}" y="{y + 91:g}" width="22" height="14" rx="3" fill="{fill}" stroke="{EDGE[fill]}"/>'
        )
        parts.append(_text(left + 30, y + 103, text))
    return parts


def _text(x: float, y: float, text: str, anchor: str = "start") -> str:
    return f'<text x="{x:g}" y="{y:g}" font-size="12.5" text-anchor="{anchor}" fill="{INK}">{escape(text)}</text>'


def folders_page() -> str:
    """Every folder of the package with the first sentence of its docstring, rooms in their order."""
    head = (
        "# Folders\n\nMade by `make docs` from the packages' docstrings. The rooms stand in the order of\n"
        "[architecture](architecture.md), the top room first.\n"
    )
    parts = [head]
    for name in (name for floor in floors() for name in floor if name not in GROUND):
        top = ROOT / PACKAGE / name
        found = sorted(path.parent for path in top.rglob("__init__.py"))
        lines = [f"| `{path.relative_to(ROOT / PACKAGE)}/` | {docstring(path / '__init__.py')} |" for path in found]
        parts.append("\n".join([f"## {name}\n", "| folder | what it holds |", "|---|---|", *lines, ""]))
    return "\n".join(parts)
