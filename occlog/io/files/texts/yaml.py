"""Strict YAML: repeated keys, unknown keys and wrong types are errors with their line.

Also limits the number of nodes before values are made.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Callable, Hashable, Iterator
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import msgspec
import yaml
from yaml.composer import Composer
from yaml.constructor import SafeConstructor
from yaml.resolver import Resolver

from occlog.errors import InputError, did_you_mean, option
from occlog.io.files.limits import (
    FAILURES,
    Content,
    bounded_text,
    check_input,
    check_text,
    content_of,
    describe_unsupported,
    guarded,
)

MAX_NODES = 200_000
"""Values of a YAML text at most, those of aliases counted each time."""
LONGEST_NUMBER = 1_000
"""Characters of a number at most: of one to the base of 60, as `1:30:15` is, time rises with the square of them."""
_NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")


class _TooManyError(Exception):
    """A text has more nodes than allowed."""


if yaml.__with_libyaml__:

    class _SafeLoader(Composer, yaml.cyaml.CParser, SafeConstructor, Resolver):  # type: ignore[name-defined,misc]
        """Safe loader with the parser of libyaml (six times faster); nodes are composed in Python, to be counted."""

        def __init__(self, stream: str) -> None:
            """Begin to read a YAML text (`stream`)."""
            yaml.cyaml.CParser.__init__(self, stream)  # type: ignore[attr-defined]
            Composer.__init__(self)
            SafeConstructor.__init__(self)
            Resolver.__init__(self)

else:
    _SafeLoader = yaml.SafeLoader  # type: ignore[misc,assignment]


class BoundedLoader(_SafeLoader):
    """Safe loader that raises `_TooManyError` after 2 `MAX_NODES` nodes, which limits the time of parsing."""

    def __init__(self, stream: str) -> None:
        """Begin to read a YAML text (`stream`), without nodes so far."""
        super().__init__(stream)
        self._nodes = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose the next node (key, value or alias); _TooManyError if there are more than 2 `MAX_NODES`."""
        self._nodes += 1
        if self._nodes > 2 * MAX_NODES:
            raise _TooManyError
        return super().compose_node(parent, index)


def _too_many(where: Path | str) -> InputError:
    return InputError(
        f"{where}: more than {MAX_NODES} entries with its aliases expanded; write it without aliases",
        id="input-too-large",
    )


def compose_yaml(text: str, where: Path | str, loader: type[BoundedLoader]) -> yaml.Node | None:
    """Root node of one YAML document; None for an empty one.

    Args:
        text: YAML.
        where: its file, for messages.
        loader: class of the loader.

    Raises:
        yaml.YAMLError: it is not YAML.
        InputError: it has more than `MAX_NODES` nodes with its aliases expanded, is nested too deeply, has a key that
            is not a scalar, or an alias contains itself.
    """
    with guarded(where, "YAML"):
        try:
            node = yaml.compose(text, Loader=loader)
        except _TooManyError:
            raise _too_many(where) from None
        if node is not None:
            _check_nodes(node, where)
        return node


def _check_nodes(root: yaml.Node, where: Path | str) -> None:
    count = 0
    waiting = [root]
    while waiting:
        node = waiting.pop()
        count += 1
        if count > MAX_NODES:
            raise _too_many(where)
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                if not isinstance(key, yaml.ScalarNode):
                    line = key.start_mark.line + 1
                    raise InputError(
                        f"{where}: line {line}: a list or a mapping cannot be a key; give a name", id="invalid-syntax"
                    )
                _check_scalar(key, where)
                waiting.append(value)
        elif isinstance(node, yaml.SequenceNode):
            waiting.extend(node.value)
        elif isinstance(node, yaml.ScalarNode):
            _check_scalar(node, where)


def _check_scalar(node: yaml.ScalarNode, where: Path | str) -> None:
    """InputError for a YAML scalar with a lone surrogate, or a number of more than `LONGEST_NUMBER` characters.

    `where` is the file, for messages.
    """
    location = f"{where}: line {node.start_mark.line + 1}"
    check_text(node.value, location)
    if node.tag in _NUMBERS and len(node.value) > LONGEST_NUMBER:
        raise InputError(
            f"{location}: a number of {len(node.value)} characters; at most {LONGEST_NUMBER} are read",
            id="input-too-large",
        )


class _Unknowing(BoundedLoader):
    """Safe loader that reads matrices of OpenCV (`!!opencv-matrix`) as plain mappings."""


def _plain_mapping(loader: yaml.SafeLoader, node: yaml.MappingNode) -> dict[Hashable, object]:
    return loader.construct_mapping(node, deep=True)


for _tag in ("tag:yaml.org,2002:opencv-matrix", "tag:yaml.org,2002:opencv-nd-matrix", "!opencv-matrix"):
    _Unknowing.add_constructor(_tag, _plain_mapping)


def yaml_documents(text: str, where: Path | str, what: str) -> list[Any]:
    """Values of all documents in the YAML text of another program; InputError if it is not YAML.

    `%YAML:1.0`, with which OpenCV 3 and 4 begin their files, is not a valid directive and is skipped.

    Args:
        text: YAML.
        where: its file, for messages.
        what: expected content, for messages.
    """
    body = re.sub(r"\A%YAML[^\n]*\n(---[^\n]*\n)?", "", text)
    try:
        with guarded(where, what):
            loader = _Unknowing(body)
            found = []
            while loader.check_node():
                node = loader.get_node()
                if node is not None:
                    _check_nodes(node, where)
                    found.append(loader.construct_document(node))
            return found
    except _TooManyError:
        raise _too_many(where) from None
    except yaml.YAMLError as error:
        raise InputError(
            f"{where}: not YAML ({' '.join(str(error).split())[:100]}); {what} was expected", id="invalid-syntax"
        ) from None


T = TypeVar("T")
Upgrade: TypeAlias = Callable[[dict[str, Any]], dict[str, Any]]
"""From the values of a file of an earlier release to those of this one; its argument is not changed."""


class _Loader(BoundedLoader):
    """Safe loader that reads 1e-3 as a number, and 20:30 as a text rather than a base-60 number."""


def _number(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> float | str:
    """Convert a scalar that YAML takes for a number; one with colons (sexagesimal in YAML 1.1) is returned as text."""
    if ":" in node.value:
        return str(node.value)
    whole = node.tag.endswith(":int")
    return loader.construct_yaml_int(node) if whole else loader.construct_yaml_float(node)


_Loader.add_constructor("tag:yaml.org,2002:int", _number)
_Loader.add_constructor("tag:yaml.org,2002:float", _number)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)$"),
    list("-+0123456789."),
)


class _Constructor(_Loader):
    """Constructs values from nodes; an InputError for an invalid scalar names the line."""

    def __init__(self, text: str, source: str) -> None:
        """Begin with a YAML text; `source` is its file, for messages."""
        super().__init__(text)
        self._source = source

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """Value of a node (`deep`: with all its items at once); InputError for a scalar such as the date 2001-99-99."""
        try:
            return super().construct_object(node, deep)
        except FAILURES:
            if not isinstance(node, yaml.ScalarNode):
                raise
            kind = node.tag.rpartition(":")[2]
            raise InputError(
                f"{self._source}: line {node.start_mark.line + 1}: {node.value[:40]!r} cannot be read as {kind}; "
                "correct it, or put it in quotes"
            ) from None


def read_yaml(path: Path, kind: type[T], what: str, upgrade: Upgrade | None = None) -> T:
    """Read a YAML file as an instance of a msgspec type; keys and types are checked strictly.

    Args:
        path: the file.
        kind: the type.
        what: description of such a file, for messages.
        upgrade: converts the values of files of earlier releases to those of this one; None: no conversion.

    Raises:
        InputError: the file is not YAML, or a key or value is invalid; with the line and the most similar valid key.
    """
    path = check_input(path, what)
    _refuse_binary(path, what)
    return parse_yaml(bounded_text(path, what), str(path), kind, upgrade)


def _refuse_binary(path: Path, what: str) -> None:
    """InputError for a file that by its first bytes is a recording, a table, or in another known format than YAML.

    `what` describes the expected content, for the message.
    """
    content = content_of(path, what)
    if content is not Content.OTHER:
        raise InputError(f"{path}: is {content.value}; {what} was expected", id="wrong-content")
    mistaken = describe_unsupported(path, yaml=True)
    if mistaken is not None:
        kind, _, remedy = mistaken.partition("; ")
        raise InputError(f"{path}: is {kind}; {what} was expected; {remedy}", id="wrong-content")


def lines_of(path: Path) -> dict[str, int]:
    """Line number of every value in a YAML file, by its path, such as `$.track.set.sigma_v` or `$.cases[0]`."""
    node = compose_yaml(bounded_text(path, "YAML of occlog"), path, _Loader)
    return {} if node is None else dict(_lines(node, "$", str(path)))


def parse_yaml(text: str, source: str, kind: type[T], upgrade: Upgrade | None = None) -> T:
    """Parse YAML text as an instance of the msgspec type `kind`; keys and types are checked strictly.

    Args:
        text: YAML.
        source: name of the file in messages.
        kind: the type.
        upgrade: converts the values of earlier releases to those of this one; None: no conversion.

    Raises:
        InputError: the text is not YAML, or a key or value is invalid; with the line and the most similar valid key.
    """
    raw, lines = _values(text, source)
    if not isinstance(raw, dict):
        raise InputError(f"{source}: expected keys and values at the top level, got {type(raw).__name__}")
    try:
        return msgspec.convert(raw if upgrade is None else upgrade(raw), kind, strict=True)
    except msgspec.ValidationError as error:
        raise InputError(f"{source}: {_explain(str(error), raw, lines, kind)}") from error


_KEPT: dict[str, tuple[Any, dict[str, int]]] = {}
"""The last texts and what they state: a command opens a recording, and reads its scene, several times."""
KEPT_TEXTS, KEPT_LENGTH = 8, 100_000


def _values(text: str, source: str) -> tuple[Any, dict[str, int]]:
    """Value of a YAML text (a copy that may be changed), and the line number of every value in it by its path.

    The latest texts are cached. `source` is the file in messages. InputError if it is not YAML, or has NaN or infinity.
    """
    known = _KEPT.get(text)
    if known is None:
        try:
            node = compose_yaml(text, source, _Loader)
            with guarded(source, "YAML of occlog"):
                lines = dict(_lines(node, "$", source)) if node is not None else {}
                raw = _Constructor(text, source).construct_document(node) if node is not None else None
                _check_finite(raw, "$", lines, source)
        except yaml.YAMLError as error:
            if text.startswith("%YAML") and "opencv-" in text:
                raise InputError(
                    f"{source}: a calibration of OpenCV; give it to occlog ingest {option('calibration')}",
                    id="wrong-content",
                ) from None
            raise InputError(f"{source}: {_yaml_problem(error)}", id="invalid-syntax") from error
        known = raw, lines
        if len(text) <= KEPT_LENGTH:
            for oldest in list(_KEPT)[: max(len(_KEPT) + 1 - KEPT_TEXTS, 0)]:
                _KEPT.pop(oldest, None)
            _KEPT[text] = known
    # Whoever gets the value may change it
    return copy.deepcopy(known[0]), known[1]


def _yaml_problem(error: yaml.YAMLError) -> str:
    mark = getattr(error, "problem_mark", None)
    problem = getattr(error, "problem", None) or "cannot be parsed"
    return f"line {mark.line + 1}: not valid YAML: {problem}" if mark else f"not valid YAML: {problem}"


def _lines(node: yaml.Node, location: str, source: str) -> Iterator[tuple[str, int]]:
    """Yield (path, line number) of a node and all nodes below it; `location` is the path of the node.

    InputError, which names the file `source`, for repeated keys.
    """
    yield location, node.start_mark.line + 1
    if isinstance(node, yaml.MappingNode):
        seen: set[str] = set()
        for key, value in node.value:
            if key.value in seen:
                raise InputError(
                    f"{source}: line {key.start_mark.line + 1}: key {key.value!r} appears twice; keep one",
                    id="duplicate-name",
                )
            seen.add(key.value)
            yield from _lines(value, f"{location}.{key.value}", source)
    elif isinstance(node, yaml.SequenceNode):
        for index, value in enumerate(node.value):
            yield from _lines(value, f"{location}[{index}]", source)


def _check_finite(raw: object, location: str, lines: dict[str, int], source: str) -> None:
    """InputError for NaN and infinity, which YAML parses as numbers, in a value and all that it contains.

    Args:
        raw: value.
        location: its path, as `$.track`.
        lines: line number by path.
        source: name of the file.
    """
    if isinstance(raw, float) and not math.isfinite(raw):
        line = f"line {lines[location]}: " if location in lines else ""
        raise InputError(f"{source}: {line}{location.removeprefix('$.')}: {raw} is not a finite number")
    items = raw.items() if isinstance(raw, dict) else enumerate(raw) if isinstance(raw, list) else ()
    for key, value in items:
        _check_finite(value, f"{location}.{key}" if isinstance(raw, dict) else f"{location}[{key}]", lines, source)


def _explain(message: str, raw: object, lines: dict[str, int], kind: type[T]) -> str:
    """Rewrite an error message of msgspec with line number, readable path, and the most similar valid key.

    Args:
        message: of the library.
        raw: parsed values.
        lines: line number by path.
        kind: type that the values should have.
    """
    match = re.fullmatch(r"(.*?)(?: - at `(?:key in )?(\$.*)`)?", message, re.DOTALL)
    text, location = (match.group(1), match.group(2) or "$") if match else (message, "$")
    unknown = re.search(r"unknown field `([^`]*)`", text)
    if unknown:
        return _unknown_key(unknown.group(1), location, lines, kind)
    line = f"line {lines[location]}: " if location in lines else ""
    shown = location.removeprefix("$").removeprefix(".")
    value = _value_at(raw, location)
    if text.startswith("Invalid enum value"):
        info = _type_at(kind, location)
        known = info.values if isinstance(info, msgspec.inspect.LiteralType) else ()
        return f"{line}{shown}: {value!r} is none of {', '.join(map(str, known))}"
    got = f", got {value!r}" if isinstance(value, str | int | float | bool) else ""
    return f"{line}{shown + ': ' if shown else ''}{text[:1].lower() + text[1:]}{got}"


def _unknown_key(key: str, location: str, lines: dict[str, int], kind: type[T]) -> str:
    line = lines.get(f"{location}.{key}")
    valid = _valid_keys(kind, location)
    hint = did_you_mean(key, valid, "valid keys:")
    shown = location.removeprefix("$").removeprefix(".")
    where = f" in {shown}" if shown else ""
    return f"{f'line {line}: ' if line else ''}unknown key {key!r}{where}; {hint}"


def _valid_keys(kind: type[T], location: str) -> list[str]:
    """Sorted keys that a value of the msgspec type `kind` allows at the path `location`.

    Empty unless that is a struct.
    """
    info = _type_at(kind, location)
    return sorted(f.encode_name for f in info.fields) if isinstance(info, msgspec.inspect.StructType) else []


def _type_at(kind: type[T], location: str) -> msgspec.inspect.Type:
    """Declared type at the path `location` (as `$.track.set`) in a value of the msgspec type `kind`."""
    info = _strip(msgspec.inspect.type_info(kind))
    for part in re.findall(r"\.([^.\[\]]+)|\[[^\]]*\]", location.removeprefix("$")):
        info = _strip(_step(info, part))
    return info


def _strip(info: msgspec.inspect.Type) -> msgspec.inspect.Type:
    """Type without annotation and None; of a union the first struct, or else its first type."""
    if isinstance(info, msgspec.inspect.Metadata):
        return _strip(info.type)
    if isinstance(info, msgspec.inspect.UnionType):
        inner = [t for t in info.types if not isinstance(t, msgspec.inspect.NoneType)]
        structs = [t for t in inner if isinstance(t, msgspec.inspect.StructType)]
        return _strip((structs or inner)[0])
    return info


def _step(info: msgspec.inspect.Type, part: str) -> msgspec.inspect.Type:
    """Type of the field `part` of a struct, or of the items or values of a container; `info` itself for other types."""
    if part and isinstance(info, msgspec.inspect.StructType):
        for f in info.fields:
            if f.encode_name == part:
                return f.type
    if isinstance(info, msgspec.inspect.CollectionType):
        return info.item_type
    return info.value_type if isinstance(info, msgspec.inspect.DictType) else info


def _value_at(raw: Any, location: str) -> object:
    for name, index in re.findall(r"\.([^.\[\]]+)|\[(\d+)\]", location.removeprefix("$")):
        try:
            raw = raw[name] if name else raw[int(index)]
        except (KeyError, IndexError, TypeError):
            return None
    return raw


def yaml_text(value: object) -> str:
    """YAML text of mappings, lists, numbers and texts; innermost containers on one line each."""
    return yaml.safe_dump(value, sort_keys=False, default_flow_style=None, width=200, allow_unicode=True)
