"""The page of the Python API, made from signatures and docstrings."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator

import occlog.api as api

SECTIONS = ("Args", "Returns", "Raises", "Warns", "Attributes")
ERRORS = {name: getattr(api, name) for name in api.__all__ if name.endswith(("Error", "Warning"))}
PLAIN = ("Scene", "Loss")
"""Classes of other rooms, of which the page has the summary and the attributes."""


def api_page() -> str:
    """Functions, classes and errors."""
    functions = {n: v for n in api.__all__ if inspect.isfunction(v := getattr(api, n))}
    classes = {n: v for n in api.__all__ if inspect.isclass(v := getattr(api, n)) and n not in ERRORS}
    parts = [
        "# The Python API\n\nMade by `make docs` from the docstrings; "
        "[python.md](../how-to/python.md) shows how it is used. "
        "Everything here is a name of `occlog`\nafter `import occlog`; what is not here may change. A `Source` is a "
        "path, a `Table`, a `Recording`, a DataFrame of pandas or polars, anything\nelse that speaks the Arrow "
        "PyCapsule interface, or a dict of columns; a `SceneSource` is one of these or a `Scene`.\nA "
        "`File` is a path; `Files` are one, several, or a dict of paths by the names of cameras or arrays;\n`Times` "
        "are a number or a text, or a dict of these by such names.\n",
        "## Functions\n",
        *(f"### {name}\n\n{_signature(f'occlog.{name}', f)}\n\n{_text(f)}" for name, f in functions.items()),
        "## Classes\n",
        *(_class(name, c) for name, c in classes.items()),
        "## Errors and warnings\n",
        _errors(),
    ]
    return "\n".join(parts)


def _signature(name: str, function: object) -> str:
    """The call, an argument a line."""
    assert callable(function)
    signature = inspect.signature(function)
    given = [p for p in signature.parameters.values() if p.name != "self"]
    lines, starred = [], False
    for p in given:
        if p.kind is p.KEYWORD_ONLY and not starred:
            lines.append("*")
            starred = True
        mark = {p.VAR_POSITIONAL: "*", p.VAR_KEYWORD: "**"}.get(p.kind, "")
        default = "" if p.default is p.empty else f" = {p.default!r}"
        lines.append(f"{mark}{p.name}: {p.annotation}{default}")
    inside = "".join(f"\n    {line}," for line in lines) + ("\n" if lines else "")
    return f"```python\n{name}({inside}) -> {signature.return_annotation}\n```"


def _text(of: object) -> str:
    """A docstring as Markdown: sections become lists."""
    out, section = [], False
    for line in (inspect.getdoc(of) or "").splitlines():
        if line.rstrip(":") in SECTIONS and line.endswith(":"):
            out += [f"**{line.rstrip(':')}**", ""]
            section = True
        elif section and line.startswith("    ") and not line.startswith("     "):
            name, colon, words = line.strip().partition(": ")
            plain = not colon or " " in name.replace(", ", "")
            out.append(f"* {line.strip()}" if plain else f"* `{name}`: {words}")
        elif section and line.startswith("     "):
            out.append(f"  {line.strip()}")
        else:
            section = section and not line
            out.append(line)
    return re.sub(r"\n{3,}", "\n\n", "\n".join(out)).strip() + "\n"


def _class(name: str, of: type) -> str:
    """A class: what it is, then its properties and methods."""
    parts = [f"### {name}\n", _text(of)]
    if name not in PLAIN:
        parts += list(_members(of))
    return "\n".join(parts)


def _members(of: type) -> Iterator[str]:
    """Properties and methods that the class itself has, but not how it is made."""
    for name, member in vars(of).items():
        if isinstance(member, property) and not name.startswith("_"):
            yield f"* **`.{name}`**: {_summary(member)}"
    yield ""
    for name, member in vars(of).items():
        if inspect.isfunction(member) and (not name.startswith("_") or name in ("__getitem__",)):
            called = {"__getitem__": f"{of.__name__}.__getitem__"}
            yield f"{_signature(called.get(name, f'{of.__name__}.{name}'), member)}\n\n{_text(member)}"


def _summary(of: object) -> str:
    return " ".join((inspect.getdoc(of) or "").split())


def _errors() -> str:
    """A row for each error, the exit code of the command that raises it, and what it is a kind of."""
    rows = [
        f"| `{name}` | `{of.__bases__[0].__name__}` | {getattr(of, 'exit_code', '') and int(of.exit_code)} "
        f"| {_summary(of).split(' Attributes:')[0]} |"
        for name, of in ERRORS.items()
    ]
    return "| name | is a | exit code of commands | when |\n|---|---|---|---|\n" + "\n".join(rows) + "\n"
