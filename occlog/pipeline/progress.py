"""Progress bar of many tasks."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm


@contextmanager
def shown_progress(label: str, unit: str, total: int, quiet: bool) -> Iterator[Callable[[int], None] | None]:
    """Context manager with a progress bar on a terminal; yields the function that advances it by a number, or None.

    Args:
        label: text before the bar.
        unit: noun for what is counted.
        total: number at the end.
        quiet: show none.
    """
    if quiet or not sys.stderr.isatty():
        yield None
        return
    with tqdm(total=total, desc=label, unit=unit, file=sys.stderr, leave=False) as bar:

        def advance(done: int) -> None:
            bar.update(done)

        yield advance
