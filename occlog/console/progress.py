"""Progress bars, between the steps of which interrupts are raised."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

from occlog.console.details import begin_work, tell
from occlog.console.interrupts import INTERRUPTS

T = TypeVar("T")


def progress(items: Iterable[T], label: str, total: int | None = None, *, quiet: bool = False) -> Iterator[T]:
    """The items, with a progress bar on standard error when that is a terminal.

    Raises:
        KeyboardInterrupt: there was an interrupt that got lost.
    """
    begin_work()
    start, count = time.perf_counter(), 0
    if not quiet and sys.stderr.isatty():
        from tqdm import tqdm

        items = tqdm(items, desc=label, total=total, file=sys.stderr, leave=False)
    for item in items:
        INTERRUPTS.check()
        count += 1
        yield item
    tell(f"{label}: {count} parts in {time.perf_counter() - start:.2f} s")
