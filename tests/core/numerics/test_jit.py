"""Compiled kernels: what an older version left in the cache is not used, and long compilation is reported."""

from __future__ import annotations

import dis
import importlib
import os
import re
import subprocess
import sys
from pathlib import Path
from types import BuiltinFunctionType, ModuleType

import numpy as np
import pytest
from numba.core.event import Event, EventStatus

from occlog.console.foreign_code import PROGRAM
from occlog.core.numerics import jit
from occlog.core.numerics.kernel_cache import EXTERNAL, stamp

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


MODULE = """
import enum, math
import numba
from typing import NamedTuple
import numpy as np
from occlog.core.numerics.jit import kernel, kernel_part
import {helpers} as helpers

class Kind(enum.IntEnum):
    A, B = 1, 2

class Pair(NamedTuple):
    first: float
    second: float

TYPE = numba.float64
FACTOR, TABLE = 2.0, np.array([1.0, 2.0])

def made(offset):
    @kernel
    def shifted(x):
        return x + offset
    return shifted

shifted, other = made(1.0), made(2.0)

@kernel_part
def part(x):
    return 3.0 * x

@kernel
def called(x, by=1.0):
    return part(x) * by

@kernel
def calling(x):
    '''Return a number.'''
    pair = Pair(x, FACTOR)
    if x in (5.0, 6.0):
        return math.log(TYPE(x))
    return called(pair.first) + shifted(pair.second) - other(x) + TABLE[0] + Kind.B + helpers.offset(x) + helpers.SCALE

@kernel
def recursive(n: int) -> int:
    return 1 if n == 0 else recursive(n - 1) + called(1.0)
"""
HELPERS = "from occlog.core.numerics.jit import kernel\nSCALE = 4.0\n@kernel\ndef offset(x):\n    return x - 1.0\n"


def stamps(monkeypatch: pytest.MonkeyPatch, old: str = "", new: str = "") -> tuple[str, str]:
    """Return the stamps of `calling` and `recursive` with the text `old` of the two modules replaced by `new`."""
    made = []
    for name, text in (("stamp_helpers", HELPERS), ("stamp_module", MODULE.format(helpers="stamp_helpers"))):
        module = ModuleType(name)
        monkeypatch.setitem(sys.modules, name, module)
        # numba asks for the file of a function; this one holds no cache
        exec(compile(text.replace(old, new) if old else text, __file__, "exec"), vars(module))
        made.append(module)
    return stamp(made[1].calling), stamp(made[1].recursive)


def test_a_comment_a_docstring_or_another_line_does_not_compile_a_kernel_again(monkeypatch: pytest.MonkeyPatch) -> None:
    before = stamps(monkeypatch)
    assert stamps(monkeypatch, "import enum", "# a comment\n\nimport enum") == before
    assert stamps(monkeypatch, "Return a number.", "Return another sentence.") == before
    assert stamps(monkeypatch, "first: float", "first: 'float'") == before  # annotations are not compiled


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("FACTOR, TABLE = 2.0", "FACTOR, TABLE = 2"),
        ("np.array([1.0, 2.0])", "np.array([1.0, 2.5])"),
        ("A, B = 1, 2", "A, B = 1, 3"),
        ("    first: float\n    second: float", "    second: float\n    first: float"),
        ("made(1.0)", "made(1.5)"),
        ("made(1.0), made(2.0)", "made(2.0), made(1.0)"),
        ("return 3.0 * x", "return 3.5 * x"),
        ("by=1.0", "by=1.5"),
        ("import kernel, kernel_part", "import array_kernel as kernel, kernel_part"),
        ("(5.0, 6.0)", "(5.0, 7.0)"),
        ("math.log(", "math.exp("),
        ("TYPE = numba.float64", "TYPE = numba.float32"),
        ("SCALE = 4.0", "SCALE = 5.0"),
        ("return x - 1.0", "return x - 2.0"),
    ],
)
def test_a_change_of_anything_that_a_kernel_is_compiled_from_compiles_it_again(
    old: str, new: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert old in HELPERS + MODULE
    before, after = stamps(monkeypatch), stamps(monkeypatch, old, new)
    assert before[0] != after[0]
    of_called = ("return 3.0 * x", "by=1.0", "import kernel, kernel_part")
    assert (before[1] != after[1]) == (old in of_called)  # `recursive` calls only `called`


COMPILED = (bool, int, float, np.generic, np.ndarray, tuple, type, ModuleType, BuiltinFunctionType, np.ufunc)
"""Kinds of values that stamps of kernels describe."""


def test_the_stamp_describes_every_global_that_a_kernel_of_occlog_refers_to() -> None:
    for path in sorted(PROGRAM.joinpath("occlog").rglob("*.py")):
        if re.search(r"^@(array_)?kernel(_part)?$", path.read_text(), re.M):
            module = importlib.import_module(".".join(path.relative_to(PROGRAM).with_suffix("").parts))
            for compiled in [each for each in vars(module).values() if hasattr(each, "py_func")]:
                function = compiled.py_func
                read = {each.argval for each in dis.get_instructions(function) if each.opname == "LOAD_GLOBAL"}
                for name in read & function.__globals__.keys():
                    value = function.__globals__[name]
                    external = getattr(value, "__module__", "").partition(".")[0] in EXTERNAL
                    assert hasattr(value, "py_func") or isinstance(value, COMPILED) or external, (path, name)


def swapped(folder: Path, fields: str) -> str:
    """Result of a kernel that subtracts the fields of a named tuple of another file."""
    (folder / "pair.py").write_text(f"from collections import namedtuple\nPair = namedtuple('Pair', '{fields}')\n")
    code = "from occlog.core.numerics.jit import kernel\n@kernel\ndef difference(pair):\n    return pair.a - pair.b\n"
    (folder / "difference.py").write_text(code)
    run = "from difference import difference; from pair import Pair; print(difference(Pair(a=3.0, b=1.0)))"
    own = {"PYTHONPATH": os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")]), "NUMBA_CACHE_DIR": ""}
    environment = {**os.environ, **own, "PYTHONDONTWRITEBYTECODE": "1", "NUMBA_DISABLE_JIT": "0"}
    done = subprocess.run([sys.executable, "-c", run], env=environment, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_a_kernel_is_compiled_again_when_the_fields_of_its_argument_change_their_order(tmp_path: Path) -> None:
    assert [swapped(tmp_path, fields) for fields in ("a b", "b a")] == ["2.0", "2.0"]


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
