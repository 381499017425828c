"""Descriptions in which one value is of another kind, or not there: JSON, YAML, XML and NumPy's archives."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from itertools import islice
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

from .readers import READERS
from .structure import OTHERS, places, replaced
from .watch import EVERY, Watch, watching

MOST_NODES = 60
LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
ARRAYS = (np.zeros(0), np.zeros((3, 3)), np.full((3, 3), np.nan), np.array("x"), np.zeros((2, 2), complex), np.int64(7))


def changed(value: Any) -> Iterator[bytes]:
    """Texts with one value another, or not there."""
    for place in list(places(value))[:MOST_NODES]:
        for other in (..., *OTHERS):
            yield json.dumps(replaced(value, place, other)).encode()


def changed_xml(text: str) -> Iterator[bytes]:
    """Texts with one element or attribute another, twice or not there."""
    many = len(list(ElementTree.fromstring(text).iter()))
    for n in range(min(many, MOST_NODES)):
        for what in ("", "x", "-1", "1e400", "9" * 40, "nan", "1 2 3", "gone", "twice", "bare"):
            root = ElementTree.fromstring(text)
            parents = {child: parent for parent in root.iter() for child in parent}
            element = list(root.iter())[n]
            if what in ("gone", "twice"):
                if element in parents:
                    (parents[element].remove if what == "gone" else parents[element].append)(element)
            elif what == "bare":
                element.attrib.clear()
            else:
                element.text = what
                element.attrib.update(dict.fromkeys(element.attrib, what))
            yield ElementTree.tostring(root)


def changed_arrays(data: bytes) -> Iterator[bytes]:
    """Archives with one array another, or not there."""
    with np.load(io.BytesIO(data)) as archive:
        arrays = {name: archive[name] for name in archive.files}
    for name in arrays:
        for other in (None, *ARRAYS):
            out = io.BytesIO()
            np.savez(out, **{k: v if k != name else other for k, v in arrays.items() if k != name or other is not None})
            yield out.getvalue()


def inputs(data: bytes) -> Iterator[bytes]:
    """Changes of a file by its form; none of one that has no such form."""
    if data.startswith(b"PK"):
        yield from changed_arrays(data)
        return
    try:
        text = data.decode()
        if text.lstrip().startswith("<"):
            yield from changed_xml(text)
            return
        value = yaml.load(text, LOADER)
    except (UnicodeDecodeError, yaml.YAMLError, ElementTree.ParseError, ValueError):
        return
    if isinstance(value, dict | list):
        yield from changed(value)


@pytest.fixture(scope="module")
def watch() -> Iterator[Watch]:
    with watching() as found:
        yield found


STRUCTURED = [name for name, reader in READERS.items() if any(next(inputs(each), None) for each in reader.seeds)]


@pytest.mark.parametrize("name", STRUCTURED)
def test_a_value_of_another_kind_is_read_or_refused_in_one_line(name: str, watch: Watch) -> None:
    reader = READERS[name]
    for data in islice(
        (data for seed in reader.seeds for data in inputs(seed)), STRUCTURED.index(name) % EVERY, None, EVERY
    ):
        outcome = watch.outcome(reader, data)
        assert not outcome.found, (outcome, data)


def test_most_descriptions_have_structure() -> None:
    assert len(STRUCTURED) > 20
