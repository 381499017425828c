"""An environment of its own for TrackEval and py-motmetrics, and a script that runs in it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

SCRIPT = Path(__file__).with_name("mot_peers.py")
PACKAGES = ("trackeval==1.3.0", "motmetrics==1.4.0")


def make_environment(folder: Path) -> Path:
    """Python of an environment with both packages: that of OCCLOG_PEERS, or one made in a folder (about a minute)."""
    if given := os.environ.get("OCCLOG_PEERS"):
        return Path(given)
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    python = folder / "bin" / "python"
    install = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *PACKAGES]
    done = subprocess.run(install, capture_output=True, text=True, env=_alone())
    if done.returncode:
        pytest.skip(f"{' and '.join(PACKAGES)} cannot be installed: {done.stderr.strip().splitlines()[-1]}")
    return python


def ask(python: Path, *given: Path | str) -> Any:
    """What the script answers."""
    done = subprocess.run([python, SCRIPT, *given], capture_output=True, text=True, env=_alone())
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def _alone() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
