from __future__ import annotations

from pathlib import Path

import pytest

from occlog.errors import InputError, UsageError
from occlog.measure.networks.heads import COCO, COCO_91, ClassNames, names_in, names_of, read_names, wanted_classes


def test_coco_has_its_80_classes_by_both_numbers() -> None:
    assert len(COCO) == len(set(COCO)) == len(COCO_91) == 80
    known = {0: "person", 2: "car", 24: "backpack", 39: "bottle", 56: "chair", 79: "toothbrush"}
    assert {k: COCO[k] for k in known} == known
    assert {COCO_91[k] for k in (1, 3, 27, 44, 62, 90)} == set(known.values())


def test_names_are_read_as_ultralytics_writes_them() -> None:
    assert names_in({"names": "{0: 'person', 1: \"traffic light\"}"}) == {0: "person", 1: "traffic light"}
    assert names_in({"names": "['a', 'b']"}) == {0: "a", 1: "b"}
    assert names_in({}) is None


@pytest.mark.parametrize("text", ["{0: 'a'", "__import__('os')", "3", "{'x': 'a'}", "{}", "{-1: 'a'}", "[" * 9999])
def test_names_that_cannot_be_read_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="its names of classes"):
        names_in({"names": text})


def test_names_come_from_the_file_the_network_or_coco(tmp_path: Path) -> None:
    file = tmp_path / "names.txt"
    file.write_text("owl\nfox\n\n")
    assert names_of(2, {0: "x", 1: "y"}, file) == ClassNames({0: "owl", 1: "fox"}, "names.txt")
    assert names_of(2, {0: "x", 1: "y"}, None) == ClassNames({0: "x", 1: "y"}, "the network")
    assert names_of(80, None, None) == ClassNames(dict(enumerate(COCO)), "COCO")
    assert names_of(91, None, None) == ClassNames(COCO_91, "COCO")
    assert names_of(None, None, None).source == "COCO, assumed"
    assert names_of(7, None, None) == ClassNames({}, "")
    with pytest.raises(InputError, match="names its class 5, but has 2 classes"):
        names_of(2, {0: "x", 5: "y"}, None)
    with pytest.raises(InputError, match="2 class names, but the network has 3 classes"):
        names_of(3, None, file)


def test_files_that_hold_no_names_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "names.txt"
    for data, fault in (
        (b"a\n\nb\n", "line 2: is empty"),
        (b"\xff\xfe", "not UTF-8"),
        (b"\n\n", "holds no class name"),
    ):
        file.write_bytes(data)
        with pytest.raises(InputError, match=fault):
            read_names(file)


def test_classes_are_asked_for_by_name_or_number() -> None:
    names = ClassNames(dict(enumerate(COCO)), "COCO")
    assert wanted_classes((), names, 80).tolist() == [0]
    assert wanted_classes(("Bicycle", "0", "79"), names, 80).tolist() == [0, 1, 79]
    assert wanted_classes((), ClassNames({}, ""), 1).tolist() == [0]
    assert wanted_classes(("6",), ClassNames({}, ""), 7).tolist() == [6]


@pytest.mark.parametrize(
    ("asked", "names", "count", "fault"),
    [
        (("persn",), dict(enumerate(COCO)), 80, "did you mean 'person'"),
        (("80",), dict(enumerate(COCO)), 80, "the classes 0 to 79"),
        (("zzz",), {0: "owl", 1: "fox"}, 2, "it has owl, fox"),
        ((), {0: "owl", 1: "fox"}, 2, "class 'person': the network has no such class"),
        ((), {}, 7, "does not name its 7 classes"),
    ],
)
def test_a_class_that_is_not_there_is_refused(
    asked: tuple[str, ...], names: dict[int, str], count: int, fault: str
) -> None:
    with pytest.raises(UsageError, match=fault):
        wanted_classes(asked, ClassNames(names, ""), count)
