"""Pages opened in a browser: what is waited for, read off them, and asked of them at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

Open = Callable[..., Any]
EVIL = "</script><script>window.evil=1</script>\"'><img src=x onerror=window.evil=2>javascript:window.evil=3"
"""A name that would run if a page took it for anything but text."""


@contextmanager
def opening(browser: Any, shown: Path) -> Iterator[Open]:
    """Opens pages, by default `shown`; at the end they must have asked for nothing and complained of nothing."""
    contexts, statement, asked = [], [], []

    def go(path: Path = shown, at: str = "", **how: Any) -> Any:
        contexts.append(browser.new_context(**({"viewport": {"width": 1280, "height": 900}} | how)))
        contexts[-1].complaints = statement
        page = contexts[-1].new_page()
        page.on("console", lambda message: statement.append(message.text))
        page.on("pageerror", lambda error: statement.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(path.as_uri() + at)
        if how.get("java_script_enabled", True):
            settled(page)
        return page

    yield go
    for context in contexts:
        context.close()
    assert statement == []
    assert all(url.startswith(("file:", "data:image/jpeg")) for url in asked), asked
    assert sum(url.startswith("file:") for url in asked) == len(contexts)


def settled(page: Any) -> None:
    """Wait until what was asked for is drawn."""
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


def clock(page: Any) -> float:
    """The time that is shown [s]."""
    return float(page.text_content("#replay-clock").split()[0])


def pixels(page: Any, plan: str = "replay-plan") -> str:
    """What is drawn in a plan."""
    data: str = page.evaluate(f"() => document.getElementById('{plan}').toDataURL()")
    return data
