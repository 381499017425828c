"""Logs of reads: order, doubles, tags, and every way in which a log can be wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from occlog.array_types import NS
from occlog.errors import InputError
from occlog.io.formats.tags import read_reads
from occlog.records.scene import Clock

READERS = ("A", "B")


def log(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "reads.csv"
    path.write_text(text)
    return path


def test_reads_are_put_in_the_order_of_time(tmp_path: Path) -> None:
    found = read_reads(log(tmp_path, "t,reader,tag,rssi\n2,A,x,-70\n1,B,x,-80\n3,A,x,\n"), READERS)
    assert found.reads.t_ns.tolist() == [NS, 2 * NS, 3 * NS]
    assert found.reads.sensor.tolist() == ["B", "A", "A"]
    assert found.reads.rssi[:2].tolist() == [-80.0, -70.0]
    assert np.isnan(found.reads.rssi[2])
    assert (found.late, found.double) == (1, 0)


def test_a_read_that_stands_there_twice_counts_once(tmp_path: Path) -> None:
    text = "t,reader,tag,rssi\n1,A,x,-70\n1,A,x,-70\n1,A,x,-71\n1,B,x,-70\n2,A,x,\n2,A,x,\n"
    found = read_reads(log(tmp_path, text), READERS)
    assert found.double == 2
    assert len(found.reads) == 4


def test_a_log_without_strengths_has_none(tmp_path: Path) -> None:
    found = read_reads(log(tmp_path, "t,reader,tag\n1,A,x\n"), READERS)
    assert np.isnan(found.reads.rssi).all()


def test_tags_that_are_numbers_keep_them(tmp_path: Path) -> None:
    assert read_reads(log(tmp_path, "t,reader,tag\n1,A,7\n1,A,12\n"), READERS).tags == {"7": 7, "12": 12}


@pytest.mark.parametrize("tags", [("b", "a"), ("07", "7")])
def test_other_tags_are_numbered_by_their_names(tmp_path: Path, tags: tuple[str, str]) -> None:
    found = read_reads(log(tmp_path, f"t,reader,tag\n1,A,{tags[0]}\n2,A,{tags[1]}\n"), READERS)
    assert sorted(found.tags.values()) == [0, 1]
    assert found.tags[min(tags)] == 0


def test_times_are_those_of_the_world(tmp_path: Path) -> None:
    path = log(tmp_path, "t,reader,tag\n1,A,x\n1,B,x\n")
    clocks = {"A": Clock("late", offset_ns=NS)}
    found = read_reads(path, READERS, start_ns=10 * NS, clocks=clocks)
    assert dict(zip(found.reads.sensor.tolist(), found.reads.t_ns.tolist(), strict=True)) == {
        "A": 10 * NS,
        "B": 11 * NS,
    }


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("t,reader,tag,rssi\n1,C,x,-70\n", "line 2: reader 'C' has no position; readers: A, B"),
        ("t,reader,tag,rssi\n1,A,x,-201\n", "line 2: rssi is -201; it must be -200 to 50 dBm"),
        ("t,reader,tag,rssi\n1,A,x,51\n", "line 2: rssi is 51; it must be -200 to 50 dBm"),
        ("t,reader,tag,rssi\n1,A,x,loud\n", "line 2: rssi is 'loud'; a number was expected"),
        ("t,reader,tag\n1,A,x\nnan,A,x\n", "line 3: time 'nan'"),
        ("t,reader,tag\n1,A,\n", "line 2: tag is empty"),
        ("reader,tag\nA,x\n", "has no column of times"),
        ("t,tag\n1,x\n", "has no column reader"),
        ("t,reader,tag\n", "holds no reads"),
    ],
)
def test_a_wrong_log_is_one_line(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        read_reads(log(tmp_path, text), READERS)
    assert "\n" not in str(caught.value)


def test_the_limits_of_strengths_are_strengths(tmp_path: Path) -> None:
    found = read_reads(log(tmp_path, "t,reader,tag,rssi\n1,A,x,-200\n2,A,x,50\n"), READERS)
    assert found.reads.rssi.tolist() == [-200.0, 50.0]
