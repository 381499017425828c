"""XML that is read with care: no entities, clear errors that name the missing part."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from occlog.errors import InputError
from occlog.io.files.untrusted.guard import guarded


def parse_xml(text: str, path: Path) -> Element:
    """The root element; InputError with the line where the text is not XML, or declares entities."""
    if "<!ENTITY" in text:
        raise InputError(f"{path}: declares XML entities; remove them")
    with guarded(path, "XML"):
        try:
            return ElementTree.fromstring(text)
        except ElementTree.ParseError as error:
            raise InputError(
                f"{path}: line {error.position[0]}: not XML ({error}); correct or export it again"
            ) from None


def required(parent: Element, name: str, where: str) -> Element:
    """The child of that name; InputError if there is none."""
    child = parent.find(name)
    if child is None:
        raise InputError(f"{where}: the part <{name}> is missing")
    return child


def number(element: Element, name: str, where: str, default: float | None = None) -> float:
    """A finite number from an attribute; InputError where it is missing (without a default) or none."""
    text = element.get(name)
    if text is None:
        if default is None:
            raise InputError(f"{where}: <{element.tag}> has no {name}")
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: {name} of <{element.tag}> is {text!r}; a finite number was expected")
    return value
