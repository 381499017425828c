"""Limits of YAML: entries with aliases expanded, repeated keys, numbers."""

from __future__ import annotations

from pathlib import Path

import pytest

from occlog.errors import InputError
from occlog.io.files.texts import yaml as yaml_nodes
from occlog.io.files.texts.yaml import (
    KEPT_LENGTH,
    KEPT_TEXTS,
    MAX_NODES,
    BoundedLoader,
    compose_yaml,
    parse_yaml,
    read_yaml,
    yaml_documents,
)


def test_a_document_has_at_most_so_many_entries_with_its_aliases_expanded() -> None:
    # 2 for the document and the second list, 738 lists of one entry for itself and 270 for its numbers
    assert MAX_NODES == 2 + 738 * (1 + 270)
    text = f"a: &a [{', '.join('1' * 270)}]\nb: [{', '.join(['*a'] * 737)}]\n"
    assert len(parse_yaml(text, "x", dict)["b"]) == 737
    with pytest.raises(InputError, match=f"x: more than {MAX_NODES} entries with its aliases expanded"):
        parse_yaml(text + "c: 1\n", "x", dict)


@pytest.mark.parametrize("entry", ["1, ", "a: 1, "])
def test_a_text_is_not_read_on_behind_so_many_entries(monkeypatch: pytest.MonkeyPatch, entry: str) -> None:
    """4 MB of them took three quarters of a minute before they were counted; what comes behind is not looked at."""
    monkeypatch.setattr(yaml_nodes, "MAX_NODES", 100)
    open_, close = "[]" if ":" not in entry else "{}"
    text = f"a: {open_}{entry * 300}{close}\n"
    compose_yaml(f"a: {open_}{entry * 40}{close}", "x", BoundedLoader)
    for read in (lambda: compose_yaml(text + "@", "x", BoundedLoader), lambda: yaml_documents(text + "@", "x", "YAML")):
        with pytest.raises(InputError, match="x: more than 100 entries"):
            read()


def test_keys_come_once() -> None:
    with pytest.raises(InputError, match="x: line 3: key 'a' appears twice"):
        parse_yaml("a: 1\nb: 2\na: 3\n", "x", dict)


@pytest.mark.parametrize(("text", "value"), [("1e-3", 1e-3), ("1E3", 1e3), (".5e1", 5.0), ("1.e2", 100.0), ("12", 12)])
def test_numbers_are_read_as_people_mean_them(text: str, value: float) -> None:
    assert parse_yaml(f"a: {text}", "x", dict) == {"a": value}


def test_numbers_with_colons_are_texts() -> None:
    text = "frames: 20:30\nlong: 0:100\nseconds: 20:30.5\nsigned: -1:30\n"
    wanted = {"frames": "20:30", "long": "0:100", "seconds": "20:30.5", "signed": "-1:30"}
    assert parse_yaml(text, "a.yaml", dict) == wanted


@pytest.mark.parametrize("text", [".nan", ".inf", "-.inf", "1e999"])
def test_numbers_are_finite(text: str) -> None:
    with pytest.raises(InputError, match=r"x: line 1: a: .* is not a finite number"):
        parse_yaml(f"a: {text}", "x", dict)


@pytest.mark.parametrize(
    ("head", "words"),
    [
        (
            b"\0\0\0\x18ftypmp42",
            "V.bin: is a video .MP4.; a plan was expected; .*ingest -o OUT.mcap --video CAMERA=V.bin`",
        ),
        (b"PAR1", "V.bin: is a table .Parquet.; a plan was expected"),
        (b"a: \xff", "V.bin: byte 3: not UTF-8 text; a plan was expected"),
    ],
)
def test_what_is_no_text_is_called_by_its_name(tmp_path: Path, head: bytes, words: str) -> None:
    path = tmp_path / "V.bin"
    path.write_bytes(head)
    with pytest.raises(InputError, match=words):
        read_yaml(path, dict, "a plan")


def test_what_is_made_of_a_text_is_the_callers_own_however_often_it_is_read() -> None:
    for _ in range(2):
        for n in range(KEPT_TEXTS + 1):
            found = parse_yaml(f"a: [1, {{b: {n}}}]", "x", dict)
            assert found == {"a": [1, {"b": n}]}
            found["a"][1]["b"] = found["c"] = -1
    long = f"a: {'b' * KEPT_LENGTH}"
    assert parse_yaml(long, "x", dict) == parse_yaml(long, "y", dict)
