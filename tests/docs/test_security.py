"""The limits on the page on security are those of the code, and the tests that it names are there."""

from __future__ import annotations

import importlib
import re

import pytest
from places import ROOT

PAGE = (ROOT / "docs/reference/security.md").read_text(encoding="utf-8")
LIMITS = re.findall(r"^\|[^|]+\| ([0-9,]+)[^|]*\| `([a-z_.]+)\.([A-Z_]+)` \|$", PAGE, re.MULTILINE)


@pytest.mark.parametrize(("number", "module", "name"), LIMITS, ids=[row[2] for row in LIMITS])
def test_limits_are_those_of_the_code(number: str, module: str, name: str) -> None:
    assert f"{getattr(importlib.import_module(module), name):,}" == number


def test_every_row_of_the_table_is_compared() -> None:
    table = PAGE.partition("## Limits")[2].partition("## ")[0]
    assert len(LIMITS) == sum(line.startswith("| ") for line in table.splitlines()) - 1 == 49


def test_the_tests_that_it_names_are_there() -> None:
    named = re.findall(r"`(tests/[a-z_/]+(?:\.py)?)`", PAGE)
    assert len(named) >= 5
    assert [path for path in named if not (ROOT / path).exists()] == []
