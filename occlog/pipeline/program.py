"""What the results of a stage depend on beside its inputs and settings: the program itself, and what it is built on."""

from __future__ import annotations

import hashlib
import platform
import re
from functools import cache
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

import occlog
from occlog.plugins.loading import installed


@cache
def identity() -> str:
    """Hash the program's own code, and the versions of Python, of what it requires, and of packages with plug-ins.

    A version number alone is not enough: it stays the same while the program is worked on, and the packages that it
    requires change without it.  Optional packages count where they are installed.
    """
    folder = Path(occlog.__file__).parent
    digest = hashlib.sha256(f"{occlog.__version__}\0{platform.python_version()}\0".encode())
    for path in sorted(folder.rglob("*.py")):
        digest.update(f"{path.relative_to(folder).as_posix()}\0".encode() + path.read_bytes() + b"\0")
    for name in (*_required(), *sorted({plugin.package for plugin in installed()})):
        digest.update(f"{name}\0{_version(name)}\0".encode())
    return digest.hexdigest()


def _required() -> list[str]:
    """Names of the packages that occlog requires, optional ones included; none where it is not installed."""
    try:
        lines = requires("occlog") or []
    except PackageNotFoundError:  # run from its folder
        return []
    return sorted({re.split(r"[^\w.-]", line, maxsplit=1)[0] for line in lines})


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
