"""Fixtures of the tests of the experiments."""

from pathlib import Path

import pytest


@pytest.fixture
def repository_examples() -> dict[str, str]:
    """Scene files of examples/ by name."""
    folder = Path(__file__).resolve().parents[2] / "examples"
    return {p.stem: p.read_text(encoding="utf-8") for p in sorted(folder.glob("*.yaml"))}
