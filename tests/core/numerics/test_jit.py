"""Compiled kernels: what an older version left in the cache is not used, and long compilation is reported."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.event import Event, EventStatus

from occlog.console.foreign_code import PROGRAM
from occlog.core.numerics import jit
from occlog.core.numerics.kernel_cache import files_behind

pytestmark = pytest.mark.jit

KERNEL = """
from typing import NamedTuple
from occlog.core.numerics.jit import kernel
from called import called

class {name}(NamedTuple):
    value: float

@kernel
def calling(given):
    return called(given.value)

print(calling({name}(2.0)), sum(calling.stats.cache_hits.values()))
"""
CALLED = """
from occlog.core.numerics.jit import kernel

@kernel
def called(value):
    return {factor} * value
"""


def run(folder: Path, name: str, factor: float, before: str = "", **variables: str) -> list[str]:
    """Result of a kernel that takes a tuple and calls one of another file, and how often it came from the cache."""
    (folder / "calling.py").write_text(KERNEL.format(name=name))
    (folder / "called.py").write_text(CALLED.format(factor=factor))
    code = f"{before}import calling"
    path = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
    own = {"PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1", "NUMBA_CACHE_DIR": "", "NUMBA_DISABLE_JIT": "0"}
    environment = {**os.environ, **own, **variables}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_a_kernel_is_taken_from_the_cache_unless_what_it_calls_or_its_type_has_changed(tmp_path: Path) -> None:
    """Of compilation alone is a message; an index that names a type that is gone counts as empty."""
    before = "from occlog.core.numerics import jit; jit.PATIENCE_S = 0.0; "
    before += "from occlog.console.notes import COMPILING; COMPILING.append(lambda _: print('compiling')); "
    assert run(tmp_path, "Given", 3.0, before) == ["compiling", "6.0", "0"]
    assert run(tmp_path, "Given", 3.0, before) == ["6.0", "1"]
    assert run(tmp_path, "Given", 5.0, before) == ["compiling", "10.0", "0"]
    assert run(tmp_path, "New", 5.0, before) == ["compiling", "10.0", "0"]
    assert run(tmp_path, "New", 5.0, before) == ["10.0", "1"]


@pytest.mark.parametrize(
    ("steps", "told_at"),
    [
        ([(0.0, "start"), (1.9, "end"), (50.0, "start"), (50.2, "end")], 50.2),  # in all; waiting in between is free
        ([(0.0, "start"), (1.0, "start"), (2.5, "end"), (9.0, "end")], 2.5),  # inside a kernel that takes long
        ([(0.0, "start"), (1.0, "start"), (1.1, "end"), (1.9, "end")], None),  # what is inside counts once
    ],
)
def test_long_compilation_is_reported_as_soon_as_a_kernel_begins_or_ends(
    steps: list[tuple[float, str]], told_at: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, reported = {"now": 0.0}, []
    monkeypatch.setattr(jit.time, "perf_counter", lambda: clock["now"])
    watch = jit.Stopwatch(lambda: reported.append(clock["now"]))
    for clock["now"], kind in steps:
        watch.notify(Event("numba:compile", EventStatus.START if kind == "start" else EventStatus.END))
    assert (reported[0] if reported else None) == told_at


PACKAGE = {
    "parts/__init__.py": "from . import scaling\n",
    "parts/scaling.py": "from .constants import FACTOR\nfrom occlog.core.numerics.jit import kernel\n"
    "@kernel\ndef scaled(x):\n    return FACTOR * x\n",
    "parts/constants.py": "FACTOR = 3.0\n",
    "parts/calling/__init__.py": "",
    "parts/calling/inner.py": "from occlog.core.numerics.jit import kernel\nfrom .. import scaling as by\n"
    "scaled = by.scaled\n@kernel\ndef calling(x):\n    return scaled(x)\nprint(calling(2.0))\n",
}


def test_a_kernel_is_compiled_again_when_a_constant_behind_a_package_changes(tmp_path: Path) -> None:
    for name, text in PACKAGE.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True, parents=True)
        path.write_text(text)
    environment = {**os.environ, "NUMBA_CACHE_DIR": "", "NUMBA_DISABLE_JIT": "0", "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-c", "import parts.calling.inner"]
    found = []
    for factor in (3.0, 7.0):
        (tmp_path / "parts/constants.py").write_text(f"FACTOR = {factor}\n")
        done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=True)
        found.append(done.stdout.strip())
    assert found == ["6.0", "14.0"]


@pytest.mark.parametrize("module", ["occlog.track.methods.jipda.kernels.marginals", "occlog.core.plane"])
def test_the_stamp_of_a_kernel_covers_all_of_occlog_that_its_module_loads(module: str) -> None:
    code = f"import sys, {module}; print(*(name for name in sys.modules if name.startswith('occlog')))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    behind = files_behind(module, str(PROGRAM))
    # occlog/__init__.py loads rooms by names that are made; no kernel is there
    by_name = {f"occlog.{room}" for room in ("evaluate", "ingest", "report", "simulate", "track")}
    assert set(loaded) - by_name <= set(behind)


def test_where_no_folder_can_be_written_kernels_run_uncached(tmp_path: Path) -> None:
    kept = "from occlog.core.numerics import jit; jit.PATIENCE_S = 0.0; "
    kept += "from occlog.console.notes import COMPILING; COMPILING.append(lambda kept: print('kept', kept)); "
    (tmp_path / "__pycache__").write_text("a file where a folder would be, which root cannot write into either")
    blocked = {"HOME": str(tmp_path / "__pycache__"), "XDG_CACHE_HOME": str(tmp_path / "__pycache__")}
    assert run(tmp_path, "Given", 3.0, before=kept, **blocked) == ["kept", "False", "6.0", "0"]
    blocked["XDG_CACHE_HOME"] = str(tmp_path / "user")
    assert run(tmp_path, "Given", 3.0, before=kept, **blocked) == ["kept", "True", "6.0", "0"]
    assert any((tmp_path / "user").rglob("*.nbc"))


@jit.kernel
def times(number: int, by: int) -> int:
    return number * by


@jit.kernel_part
def doubled_if_odd(number: int) -> int:
    if number % 2 == 0:
        return number
    return times(number, 2)


@jit.kernel
def sum_of(numbers: int) -> int:
    total = times(3, numbers)
    for k in range(numbers):
        total += times(k, 5) + doubled_if_odd(k)
    return total


def test_constants_among_arguments_compile_nothing_again_and_a_part_is_compiled_with_its_kernel_alone() -> None:
    assert sum_of(4) == 12 + 5 * (0 + 1 + 2 + 3) + (0 + 2 + 2 + 6)
    assert times(3, 4) == 12  # what calls it may be from the cache
    assert len(times.signatures) == 1  # type: ignore[attr-defined]
    assert doubled_if_odd.signatures == []  # type: ignore[attr-defined]
