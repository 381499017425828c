"""The published schemas are those of the code."""

from __future__ import annotations

import pytest
from places import ROOT

from occlog.io.formats.models.schemas import SCHEMAS, schema_text

FOLDER = ROOT / "schemas"


@pytest.mark.parametrize("name", SCHEMAS)
def test_published_text_is_up_to_date(name: str) -> None:
    published = FOLDER / f"{name}.json"
    assert published.is_file(), "run `make schemas`"
    assert published.read_text() == schema_text(name), "run `make schemas` and raise the table's VERSION if it changed"
