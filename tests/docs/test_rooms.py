"""Docs agree with the code: the picture of the rooms, the list of folders, every path and commit that is named."""

from __future__ import annotations

import re
import shutil
import subprocess

import pytest
from places import ROOT

from docs.make import ROOMS
from docs.rooms import GROUND, rooms

TEXTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
PATH = re.compile(r"`((?:[a-z0-9_.-]+/)+(?:[a-z0-9_.-]+\.(?:py|md|yaml|toml|txt|json|j2|svg|sh|cff)|run)?)`")
"""A path in backticks: a file in a folder, or a folder with a slash at its end. Placeholders have capitals."""
COMMIT = re.compile(r"git show (?:--stat )?([0-9a-f]{7,40})(?: --((?: [\w./]+)+))?")
"""A commit that is shown, and the paths in it."""


@pytest.mark.parametrize("name", ROOMS)
def test_made_pages_are_up_to_date(name: str) -> None:
    assert (ROOT / "docs" / name).read_text(encoding="utf-8") == ROOMS[name](), "run `make docs`"


def test_picture_shows_every_room() -> None:
    shown = {name for floor in rooms().layers for name in floor}
    folders = {path.parent.name for path in (ROOT / "occlog").glob("*/__init__.py")}
    assert shown == folders
    assert not shown & set(GROUND)


def test_no_room_imports_one_above_it_or_next_to_it() -> None:
    plan = rooms()
    floor = {name: i for i, names in enumerate(plan.layers) for name in names}
    assert all(floor[importing] < floor[imported] for importing, imported in plan.imports)


def paths(text: str) -> set[str]:
    return set(PATH.findall(text))


def exists(path: str) -> bool:
    """Whether a path is there, from the project's root or, as in the docs of the methods, from the package."""
    return (ROOT / path).exists() or (ROOT / "occlog" / path).exists()


def test_a_path_that_is_named_is_found() -> None:
    assert paths("see `core/plane.py`, `track/` and `--method fix`") == {"core/plane.py", "track/"}


def test_every_path_that_is_named_exists() -> None:
    named = [(text.name, path) for text in TEXTS for path in paths(text.read_text(encoding="utf-8"))]
    assert sorted((name, path) for name, path in named if not exists(path)) == []


MODULE = re.compile(r"`occlog((?:\.[a-z_0-9]+)+)`")
"""A module in backticks, or a function in one."""


def is_module(name: str) -> bool:
    """Whether a dotted name, after that of the package, is a module or something in one."""
    path = ROOT / "occlog" / name[1:].replace(".", "/")
    if path.is_dir() or path.with_suffix(".py").exists():
        return True
    within = path.parent.with_suffix(".py")
    return within.exists() and bool(
        re.search(rf"^(?:def |class )?{path.name}\b", within.read_text("utf-8"), re.MULTILINE)
    )


def test_every_module_that_is_named_exists() -> None:
    named = [(text.name, name) for text in TEXTS for name in MODULE.findall(text.read_text(encoding="utf-8"))]
    assert named
    assert [each for each in named if not is_module(each[1])] == []


def test_every_commit_that_is_named_exists_and_has_the_paths() -> None:
    git = shutil.which("git")
    if git is None or not (ROOT / ".git").exists() or (ROOT / ".git" / "shallow").exists():
        pytest.skip("the history is not here")
    named = COMMIT.findall((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"))
    assert named
    for commit, inside in named:
        for thing in [f"{commit}^{{commit}}", *(f"{commit}:{path}" for path in inside.split())]:
            found = subprocess.run([git, "cat-file", "-e", thing], cwd=ROOT, capture_output=True)
            assert found.returncode == 0, thing


def steps() -> list[tuple[str, str]]:
    """(file, name of a function or class) of each step of the walks through the code."""
    text = (ROOT / "docs/development/architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(occlog/[\w/]+\.py)` \| ((?:`\w+`(?:, )?)+) \|", text, re.MULTILINE)
    return [(file, name) for file, names in rows for name in re.findall(r"\w+", names)]


def test_functions_of_the_walks_are_in_their_files() -> None:
    assert len(steps()) >= 20
    for file, name in steps():
        assert re.search(rf"^(?:def|class) {name}\b", (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE), name
