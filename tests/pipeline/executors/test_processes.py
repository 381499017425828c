"""Executors: every piece has one outcome, also when its process dies."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from occlog.pipeline.executors.chosen import executor_of
from occlog.pipeline.executors.interface import InThisProcess, Lost
from occlog.pipeline.executors.processes import ONE_THREAD, Processes


def square(number: int) -> int:
    return number * number


def die_of_three(number: int) -> int:
    if number == 3:
        os._exit(9)
    time.sleep(0.02)
    return number * number


def die_once(path: str) -> str:
    """The first process that comes here dies."""
    if path and not Path(path).exists():
        Path(path).touch()
        os._exit(9)
    return path


def threads(_: int) -> list[str | None]:
    return [os.environ.get(name) for name in ONE_THREAD]


def refuse(_: int) -> int:
    raise ZeroDivisionError


def test_one_worker_works_here_unless_it_is_to_be_alone() -> None:
    assert isinstance(executor_of(1, None, {}, None), InThisProcess)
    assert isinstance(executor_of(1, None, {}, None, isolated=True), Processes)
    assert dict(InThisProcess().outcomes({"a": 3}, square)) == {"a": 9}


@pytest.mark.slow
def test_a_process_that_dies_takes_no_other_work_with_it() -> None:
    found = dict(Processes(2).outcomes({str(n): n for n in range(12)}, die_of_three))
    assert isinstance(found.pop("3"), Lost)
    assert found == {str(n): n * n for n in range(12) if n != 3}


@pytest.mark.slow
def test_what_died_by_chance_is_done_again(tmp_path: Path) -> None:
    mark = str(tmp_path / "mark")
    assert dict(Processes(1).outcomes({"a": mark, "b": ""}, die_once)) == {"a": mark, "b": ""}


@pytest.mark.slow
def test_processes_have_one_thread_and_errors_come_through() -> None:
    before = dict(os.environ)
    assert dict(Processes(1).outcomes({"a": 0}, threads)) == {"a": ["1"] * len(ONE_THREAD)}
    with pytest.raises(ZeroDivisionError):
        list(Processes(1).outcomes({"a": 0}, refuse))
    assert dict(os.environ) == before
