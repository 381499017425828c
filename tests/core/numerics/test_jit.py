"""Compiled kernels after an upgrade: what an older version left in the cache is not used."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

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


def run(folder: Path, name: str, factor: float, version: str = "1") -> list[str]:
    """Result of a kernel that takes a tuple and calls one of another file, and how often it came from the cache."""
    (folder / "calling.py").write_text(KERNEL.format(name=name))
    (folder / "called.py").write_text(CALLED.format(factor=factor))
    code = f"import occlog; occlog.__version__ = {version!r}; import calling"
    path = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
    own = {"PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1", "NUMBA_CACHE_DIR": "", "NUMBA_DISABLE_JIT": "0"}
    environment = {**os.environ, **own}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_a_kernel_is_taken_from_the_cache(tmp_path: Path) -> None:
    assert run(tmp_path, "Given", 3.0) == ["6.0", "0"]
    assert run(tmp_path, "Given", 3.0) == ["6.0", "1"]


def test_an_index_that_names_a_type_that_is_gone_counts_as_empty(tmp_path: Path) -> None:
    run(tmp_path, "Old", 3.0)
    assert run(tmp_path, "New", 3.0) == ["6.0", "0"]
    assert run(tmp_path, "New", 3.0) == ["6.0", "1"]


def test_a_new_version_compiles_what_calls_a_changed_kernel_of_another_file(tmp_path: Path) -> None:
    run(tmp_path, "Given", 3.0)
    assert run(tmp_path, "Given", 5.0, version="2") == ["10.0", "0"]
