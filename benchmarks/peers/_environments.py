"""Environments of their own for packages of other projects, and programs that run in them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent


def environment(home: Path, *packages: str) -> Path:
    """Return the Python of the environment in a folder; make it with these packages if there is none."""
    python = home / "bin" / "python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", str(home)], check=True)
        command: list[str | Path] = [python, "-m", "pip", "install", "--quiet", *packages]
        subprocess.run(command, check=True, capture_output=True, env=_without_path())
    return python


def output_of(python: Path, script: str, *arguments: str | Path) -> dict[str, Any]:
    """Run a script of this folder in an environment; return the JSON that it prints."""
    command = [python, HERE / script, *arguments]
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=_without_path())
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def _without_path() -> dict[str, str]:
    """Return the environment variables without a path to packages of this environment."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
