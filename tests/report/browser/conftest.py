"""The browser in which pages are tried, one for all tests of a module, and pages opened in it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser_pages import Open, opening

from docs.browser import browser


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    pytest.importorskip("playwright.sync_api")
    with browser() as started:
        yield started


@pytest.fixture
def opened(chromium: Any, shown: Path) -> Iterator[Open]:
    """Opens a page, by default the one that the module's fixture `shown` makes."""
    with opening(chromium, shown) as go:
        yield go
