"""Fixtures of the tests of the experiments."""

import pytest
from places import EXAMPLES


@pytest.fixture
def repository_examples() -> dict[str, str]:
    """Scene files of examples/ by name."""
    folder = EXAMPLES
    return {p.stem: p.read_text(encoding="utf-8") for p in sorted(folder.glob("*.yaml"))}
