"""YAML before it becomes values: a bounded number of nodes, names as keys, whole characters."""

from __future__ import annotations

import re
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml
from yaml.composer import Composer
from yaml.constructor import SafeConstructor
from yaml.resolver import Resolver

from occlog.errors import InputError
from occlog.io.files.untrusted.guard import check_text, guarded

MAX_NODES = 200_000
"""Values of a YAML text at most, those of aliases counted each time."""
LONGEST_NUMBER = 1_000
"""Characters of a number at most: of one to the base of 60, as `1:30:15` is, time rises with the square of them."""
_NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")


class _TooManyError(Exception):
    """A text has more nodes than are read on for."""


if yaml.__with_libyaml__:

    class _SafeLoader(Composer, yaml.cyaml.CParser, SafeConstructor, Resolver):  # type: ignore[name-defined,misc]
        """Safe loader whose events are found by libyaml, in a sixth of the time; nodes can be counted as they come."""

        def __init__(self, stream: str) -> None:
            """Begin to read a text."""
            yaml.cyaml.CParser.__init__(self, stream)  # type: ignore[attr-defined]
            Composer.__init__(self)
            SafeConstructor.__init__(self)
            Resolver.__init__(self)

else:
    _SafeLoader = yaml.SafeLoader  # type: ignore[misc,assignment]


class BoundedLoader(_SafeLoader):
    """Safe loader that reads no further than `MAX_NODES` values, each with its key: some seconds, whatever comes."""

    def __init__(self, stream: str) -> None:
        """Begin to read a text."""
        super().__init__(stream)
        self._nodes = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """The next node, a key, a value or an alias."""
        self._nodes += 1
        if self._nodes > 2 * MAX_NODES:
            raise _TooManyError
        return super().compose_node(parent, index)


def _too_many(where: Path | str) -> InputError:
    return InputError(f"{where}: more than {MAX_NODES} entries with its aliases expanded; write it out plainly")


def compose_yaml(text: str, where: Path | str, loader: type[BoundedLoader]) -> yaml.Node | None:
    """The nodes of one document of YAML, at most `MAX_NODES`; None for an empty one.

    Raises:
        yaml.YAMLError: it is not YAML.
        InputError: it is too large with its aliases written out, nested too deeply, or an alias holds itself.
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
                    raise InputError(f"{where}: line {line}: a list or a mapping cannot be a key; give a name")
                _check_scalar(key, where)
                waiting.append(value)
        elif isinstance(node, yaml.SequenceNode):
            waiting.extend(node.value)
        elif isinstance(node, yaml.ScalarNode):
            _check_scalar(node, where)


def _check_scalar(node: yaml.ScalarNode, where: Path | str) -> None:
    """InputError for half of a character, and for a number that is too long to be one."""
    place = f"{where}: line {node.start_mark.line + 1}"
    check_text(node.value, place)
    if node.tag in _NUMBERS and len(node.value) > LONGEST_NUMBER:
        raise InputError(f"{place}: a number of {len(node.value)} characters; at most {LONGEST_NUMBER} are read")


class _Unknowing(BoundedLoader):
    """Safe loader that takes the matrices of OpenCV for plain mappings."""


def _plain_mapping(loader: yaml.SafeLoader, node: yaml.MappingNode) -> dict[Hashable, object]:
    return loader.construct_mapping(node, deep=True)


for _tag in ("tag:yaml.org,2002:opencv-matrix", "tag:yaml.org,2002:opencv-nd-matrix", "!opencv-matrix"):
    _Unknowing.add_constructor(_tag, _plain_mapping)


def yaml_documents(text: str, where: Path | str, what: str) -> list[Any]:
    """The values of every document of a YAML text that another program wrote; InputError for anything else.

    `%YAML:1.0`, as OpenCV 3 and 4 begin their files, is no directive of YAML and is left out.
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
        raise InputError(f"{where}: not YAML ({' '.join(str(error).split())[:100]}); {what} was expected") from None
