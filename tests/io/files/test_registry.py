"""The tables of formats: what a file shows, what the user states, and that the guide lists every format."""

from __future__ import annotations

from pathlib import Path

import pytest

from occlog.errors import InputError, UsageError
from occlog.io.files.texts.formats import START, FileFormat, Probe, by_cells, by_text, is_folder, recognise
from occlog.io.formats.boxes.reader import FORMATS as BOXES
from occlog.io.formats.calibration.reader import IMPORTERS
from occlog.io.formats.sound.directions import FORMATS as DIRECTIONS
from occlog.io.formats.truth import FORMATS as TRUTH

PAIR = {
    "first": FileFormat(len, "two cells", by_cells(lambda cells: cells == ["a", "b"])),
    "second": FileFormat(len, "any b", by_text(lambda text: "b" in text)),
    "named": FileFormat(len, "by its name alone"),
}


def test_the_first_format_that_a_file_shows_is_its_format(tmp_path: Path) -> None:
    file = tmp_path / "x.txt"
    for content, expected in (("# note\nA,B\n", "first"), ("a,b,c\n", "second"), ("a,c\n", None)):
        file.write_text(content)
        assert recognise(PAIR, Probe(file, "a text")) == expected


def test_a_stated_format_counts_more_than_what_a_file_shows(tmp_path: Path) -> None:
    probe = Probe(tmp_path / "not_there.txt", "a text")
    assert recognise(PAIR, probe, "named", "test") == "named"
    with pytest.raises(UsageError, match="first, second, named"):
        recognise(PAIR, probe, "third", "test")


def test_a_probe_skips_a_byte_order_mark_and_refuses_what_is_no_text(tmp_path: Path) -> None:
    file = tmp_path / "x.txt"
    file.write_bytes(b"\xef\xbb\xbf\n  {" + b"1" * 2 * START)
    assert Probe(file, "a text").start[:2] == b"{1"
    file.write_bytes(b"ab\xff")
    with pytest.raises(InputError, match="byte 2"):
        _ = Probe(file, "a text").text
    assert is_folder(Probe(tmp_path, "a text"))
    assert not is_folder(Probe(file, "a text"))


def test_the_guide_lists_every_format_of_calibrations() -> None:
    guide = (Path(__file__).parents[3] / "docs/how-to/ingest.md").read_text()
    assert [name for name in IMPORTERS if f"| `{name}` |" not in guide] == []


@pytest.mark.parametrize("family", [BOXES, DIRECTIONS, TRUTH])
def test_no_format_stands_behind_one_that_takes_every_text(
    family: dict[str, FileFormat[object]], tmp_path: Path
) -> None:
    (tmp_path / "x.txt").write_text("1 2\n")
    probe = Probe(tmp_path / "x.txt", "a text")
    assert [name for name, each in family.items() if each.sniff(probe)] in ([], list(family)[-1:])
