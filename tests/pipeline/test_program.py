"""What identifies the program: its code and the versions of what it is built on."""

from __future__ import annotations

from pathlib import Path

import pytest

import occlog
from occlog.pipeline import program


def identity() -> str:
    return program.identity.__wrapped__()


def test_code_and_versions_of_packages_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = tmp_path / "occlog" / "kernels.py"
    module.parent.mkdir()
    module.write_text("A = 1\n")
    monkeypatch.setattr(occlog, "__file__", str(module.parent / "__init__.py"))
    first = identity()
    assert identity() == first
    module.write_text("A = 2\n")
    changed = identity()
    assert changed != first
    module.rename(module.with_name("other.py"))
    renamed = identity()
    assert renamed != changed
    monkeypatch.setattr(program, "requires", lambda _: ["numpy>=2.0", "osqp>=1.0; extra == 'qp'"])
    assert program._required() == ["numpy", "osqp"]
    monkeypatch.setattr(program, "version", lambda name: f"{name} of tomorrow")
    assert identity() != renamed


def test_what_is_not_installed_has_no_version() -> None:
    assert program._version("a-package-that-nobody-has") == ""
    assert program._version("numpy")
