"""An environment for TrackEval and py-motmetrics, and a script that runs in it.

It lies over the packages of the tests: what the two want that is there in a version that they allow, pip neither
fetches nor unpacks again.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any, NoReturn

import pytest

SCRIPT = Path(__file__).with_name("mot_peers.py")
PATHS = ("purelib", "platlib")
PACKAGES = ("trackeval==1.3.0", "motmetrics==1.4.0")


NO_NETWORK = (
    "failed to establish a new connection",
    "connection refused",
    "name resolution",
    "name or service not known",
    "network is unreachable",
    "no route to host",
    "timed out",
    "timeout",
    "max retries exceeded",
    "proxyerror",
    "from versions: none",
    "connection broken",
    "connection aborted",
)
"""What pip says, in small letters, where no index of packages can be reached."""


def make_environment(folder: Path) -> Path:
    """Python of an environment with both packages: that of OCCLOG_PEERS, or one in a folder.

    One that is not complete is made.

    Without a network the test is skipped, but fails if OCCLOG_PEERS_REQUIRED is set (to anything but 0); it
    fails where the packages can be had and not be installed.
    """
    if given := os.environ.get("OCCLOG_PEERS"):
        return Path(given)
    python, complete = folder / "bin" / "python", folder / "complete"
    if complete.exists():
        return python
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    packages = Path(sysconfig.get_path("purelib", "venv", {"base": str(folder)}))
    packages.mkdir(parents=True, exist_ok=True)
    (packages / "packages_of_the_tests.pth").write_text("\n".join(dict.fromkeys(map(sysconfig.get_path, PATHS))))
    install = [python, "-m", "pip", "install", "--quiet", "--no-compile", "--disable-pip-version-check", *PACKAGES]
    done = subprocess.run(install, capture_output=True, text=True, env=_alone())
    if done.returncode:
        _cannot_install(done.stdout + done.stderr)
    complete.touch()
    return python


def _cannot_install(expected: str) -> NoReturn:
    """Skip where there is no network, unless the comparison is required; fail with all that pip stated otherwise."""
    what = f"{' and '.join(PACKAGES)} cannot be installed"
    required = os.environ.get("OCCLOG_PEERS_REQUIRED", "0") not in ("", "0")
    if required or not any(words in expected.lower() for words in NO_NETWORK):
        pytest.fail(f"{what}:\n{expected.strip()}", pytrace=False)
    last = (expected.strip().splitlines() or ["pip says nothing"])[-1]
    pytest.skip(f"{what} without a network: {last}")


def ask(python: Path, *given: Path | str) -> Any:
    """What the script answers."""
    done = subprocess.run([python, SCRIPT, *given], capture_output=True, text=True, env=_alone())
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def _alone() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
