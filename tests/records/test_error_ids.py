"""Each error that occlog raises has an id of the table, and each id of the table is one that is raised."""

import ast
import pickle
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import occlog
from occlog.errors import InputError, NoSceneError, OcclogError, UsageError
from occlog.records.error_ids import ERRORS
from occlog.settings import SettingError

SOURCES = sorted(Path(occlog.__file__).parent.rglob("*.py"))


@cache
def calls() -> tuple[tuple[str, ast.Call], ...]:
    """Where an error is made, and the call."""
    return tuple(
        (f"{path}:{node.lineno}", node)
        for path in SOURCES
        if "Error(" in (text := path.read_text("utf-8"))
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call) and called(node).endswith("Error")
    )


def called(call: ast.Call) -> str:
    return getattr(call.func, "attr", getattr(call.func, "id", ""))


def ids_in_code() -> Iterator[tuple[str, str]]:
    """Where an id is written, and the id."""
    for where, call in calls():
        for keyword in call.keywords:
            if keyword.arg == "id" and isinstance(keyword.value, ast.Constant):
                yield where, str(keyword.value.value)


def classes() -> list[type[OcclogError]]:
    found: list[type[OcclogError]] = [OcclogError]
    for each in found:
        found += each.__subclasses__()
    return found


def test_each_id_in_the_code_is_in_the_table() -> None:
    assert [(where, id) for where, id in ids_in_code() if id not in ERRORS] == []
    assert {each.default_id for each in classes()} <= set(ERRORS)


def test_each_id_of_the_table_is_raised() -> None:
    ended = {"bug", "interrupted", "out-of-memory", "terminated", "too-many-open-files"}  # in occlog.cli.main
    raised = {id for _, id in ids_in_code()} | {each.default_id for each in classes()}
    assert set(ERRORS) - raised == ended


def test_most_errors_state_an_id_of_their_own() -> None:
    """The id of a class, `invalid-value`, is for what has no better one: not for what was forgotten."""
    made = [call for _, call in calls() if called(call) in ("InputError", "UsageError")]
    own = sum(any(keyword.arg == "id" for keyword in call.keywords) for call in made)
    assert own > 4 * (len(made) - own)


@pytest.mark.parametrize(
    ("error", "id"),
    [
        (InputError("a: is 3; the limit is 2"), "invalid-value"),
        (UsageError("--a and --b: keep one", id="conflicting-options"), "conflicting-options"),
        (UsageError("--a: must be 2"), "invalid-option"),
        (NoSceneError("a.parquet"), "missing-scene"),
        (SettingError("track", "particles", -1, "at least 1"), "invalid-setting"),
    ],
)
def test_an_id_is_that_of_the_raise_or_of_the_class(error: OcclogError, id: str) -> None:
    assert error.id == id


def test_an_error_with_the_file_in_front_keeps_the_id_of_its_cause() -> None:
    try:
        try:
            raise InputError("no column x", id="missing-column")
        except InputError as error:
            raise InputError(f"a.csv: {error}") from error
    except InputError as error:
        found = error
    assert (str(found), found.id) == ("a.csv: no column x", "missing-column")


def test_an_error_of_a_worker_has_its_id() -> None:
    sent = pickle.loads(pickle.dumps(InputError("no column x", id="missing-column")))
    assert (str(sent), sent.id) == ("no column x", "missing-column")
