"""Independent forms of the tests as baselines: `tests/reference/forms`."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

FORMS = Path(__file__).resolve().parents[1] / "tests" / "reference" / "forms"


def reference(name: str) -> ModuleType:
    """Import one of the forms by its plain name; they import each other so."""
    if str(FORMS) not in sys.path:
        sys.path.insert(0, str(FORMS))
    return importlib.import_module(name)
