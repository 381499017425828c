"""Changes that the mutation of a module's source makes."""

from __future__ import annotations

from pathlib import Path

from tests.mutate import drawn, mutants, parts

SOURCE = """
@kernel
def f(x: int = 1) -> int:
    if x < 2 and min(x, 0.5) > -x:
        raise ValueError(f"{x + 1}")
    return x
"""


def test_each_operator_number_and_name_is_changed_once() -> None:
    found = [(line, before, after) for line, before, after, _ in mutants(SOURCE)]
    assert sorted(found) == sorted(
        [
            (3, "1", "2"),
            (4, "x < 2 and min(x, 0.5) > -x", "x < 2 or min(x, 0.5) > -x"),
            (4, "x < 2", "x <= 2"),
            (4, "2", "3"),
            (4, "min(x, 0.5) > -x", "min(x, 0.5) >= -x"),
            (4, "min", "max"),
            (4, "0.5", "0.75"),
            (4, "-x", "x"),
        ]
    )


def test_a_mutant_is_the_source_with_that_change_alone() -> None:
    texts = [text for *_, text in mutants(SOURCE)]
    assert len(set(texts)) == len(texts)
    assert all(text.count("\n") == texts[0].count("\n") for text in texts)


def test_changes_are_drawn_from_all_places_of_a_folder(tmp_path: Path) -> None:
    (tmp_path / "long.py").write_text(SOURCE)
    (tmp_path / "short.py").write_text("SIZE = 3\nzip(a, b, strict=True)\n")
    chosen, places = drawn(tmp_path, 100, 1)
    assert places == 9
    assert chosen == {tmp_path / "long.py": set(range(8)), tmp_path / "short.py": {0}}
    few, _ = drawn(tmp_path, 4, 1)
    assert sum(map(len, few.values())) == 4
    assert len(list(mutants(SOURCE, few[tmp_path / "long.py"]))) == len(few[tmp_path / "long.py"])


def test_test_files_that_name_the_module_come_first(tmp_path: Path) -> None:
    for name, text in (("test_a.py", "other"), ("test_b.py", "from x.short import f"), ("test_c.py", "shorter")):
        (tmp_path / name).write_text(text)
    found = parts(tmp_path, [".", "test_a.py"], Path("x/short.py"))
    assert [[Path(file).name for file in part] for part in found] == [
        ["test_b.py"],
        ["test_a.py", "test_c.py", "test_a.py"],
    ]
