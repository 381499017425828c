"""Fixtures of the tests of pages."""

from __future__ import annotations

import pytest

from occlog.report import drawing as plot


@pytest.fixture
def no_svg(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are drawn, but not written as SVG, which takes most of the time of a page: for tests of its words."""
    monkeypatch.setattr(plot, "raw_svg", lambda _: "<svg></svg>")
