"""Where things are in the repository, for tests that read examples, samples, docs or schemas."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
DOCS = ROOT / "docs"
