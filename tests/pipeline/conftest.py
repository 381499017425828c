"""Pages without figures in all tests but those of `run`: elsewhere a page is one output of many."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from markupsafe import Markup

import occlog.report.page
import occlog.report.run
from occlog.report.content.model import ReportInput
from occlog.report.drawing import Plot


def without_figure(_name: str, heading: str, caption: str, *_: object) -> Plot:
    """A heading and its caption: the figure would take as long as all other stages."""
    return Plot(heading, Markup(), caption)


def without_picture(_: ReportInput) -> bytes:
    return b"PNG"


@pytest.fixture(autouse=True, scope="module")
def no_figures(request: pytest.FixtureRequest) -> Iterator[None]:
    """Leave the figures out of the pages of a file of tests."""
    with pytest.MonkeyPatch.context() as patch:
        if request.path.parent.name != "run":
            patch.setattr(occlog.report.page, "plot", without_figure)
            patch.setattr(occlog.report.run, "build_picture", without_picture)
        yield
