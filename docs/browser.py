"""Chromium without a screen: for pictures of pages, and to test and time them."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

CHROMIUM = os.environ.get("OCCLOG_CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
"""Where it is; None: nowhere."""
ARGUMENTS = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)


@contextmanager
def browser(*more: str) -> Iterator[Any]:
    """Chromium while it is used, with `more` arguments, as Playwright drives it.

    Raises:
        RuntimeError: it is not there.
    """
    from playwright.sync_api import sync_playwright

    if CHROMIUM is None:
        raise RuntimeError("no Chromium; install it, or name it in OCCLOG_CHROMIUM")
    with sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=CHROMIUM, args=[*ARGUMENTS, *more])
        yield started
        started.close()
