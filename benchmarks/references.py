"""Independent forms and scenes of the tests: `tests/reference/forms` and `tests/reference/scenes`."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

SHARED = Path(__file__).resolve().parents[1] / "tests" / "reference"
FORMS, SCENES = SHARED / "forms", SHARED / "scenes"


def reference(name: str) -> ModuleType:
    """Import one of the forms by its plain name; they import each other so."""
    return _plain(FORMS, name)


def scene(name: str) -> ModuleType:
    """Import one of the scenes by its plain name."""
    return _plain(SCENES, name)


def _plain(folder: Path, name: str) -> ModuleType:
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    return importlib.import_module(name)
