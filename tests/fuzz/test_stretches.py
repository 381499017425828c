"""Long stretches of one thing in every file: no reader takes time in proportion to the square of their length.

Expressions that may match one text in many ways do, as in a number of 120,000 digits with a letter behind it.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from .readers import READERS
from .watch import EVERY, Watch, watching

LENGTH = 120_000
STRETCHES = {
    "digits": b"9" * LENGTH + b"x",
    "digits before others": b"9" * LENGTH + b"a1",
    "points": b"." * LENGTH,
    "lines": b"\n" * LENGTH,
    "blanks": b" " * LENGTH + b"x",
    "cells": b"a," * (LENGTH // 2),
    "brackets": b"[ " * (LENGTH // 2),
}


@pytest.fixture(scope="module")
def watch() -> Iterator[Watch]:
    with watching() as found:
        yield found


@pytest.mark.parametrize("name", READERS)
def test_a_long_stretch_is_read_or_refused_soon(name: str, watch: Watch) -> None:
    good = READERS[name].seeds[0]
    tried = [(what, place) for what in STRETCHES for place in (0, len(good) // 2)]
    for what, place in tried[list(READERS).index(name) % min(EVERY, len(tried)) :: EVERY]:
        outcome = watch.outcome(READERS[name], good[:place] + STRETCHES[what] + good[place:])
        assert not outcome.found, (outcome.kind, outcome.detail[:200], what, place)
