"""The files of versions agree with the bounds that pyproject.toml states."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version
from places import ROOT

from docs.sbom import sbom

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
LOCK, LOWEST = ROOT / "constraints.txt", ROOT / ".ci" / "lowest.txt"
HASHED, SBOM = ROOT / "requirements.lock", ROOT / "sbom.json"
FOR_DEVELOPERS = ("dev", "docs", "fuzz", "test")
"""Extras without upper bounds: they change nothing that users see."""
FOR_USERS = [name for name in PROJECT["optional-dependencies"] if name not in FOR_DEVELOPERS]


def direct(*extras: str) -> list[Requirement]:
    """Stated requirements of the package and of some of its extras, those of other projects only."""
    stated = list(PROJECT["dependencies"])
    for extra in extras:
        stated += PROJECT["optional-dependencies"][extra]
    return [found for found in map(Requirement, stated) if found.name != PROJECT["name"]]


def pinned(path: Path) -> dict[str, list[Version]]:
    """The exact versions in a file; one for each Python where they differ."""
    versions: dict[str, list[Version]] = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            found = Requirement(line)
            (only,) = found.specifier
            assert only.operator == "=="
            versions.setdefault(canonicalize_name(found.name), []).append(Version(only.version))
    return versions


def test_lock_has_a_version_that_the_bounds_allow() -> None:
    locked = pinned(LOCK)
    for requirement in direct(*PROJECT["optional-dependencies"]):
        for version in locked[canonicalize_name(requirement.name)]:
            assert requirement.specifier.contains(version), f"{requirement}: run `make lock`"


def test_lowest_versions_are_the_stated_bounds() -> None:
    lowest = pinned(LOWEST)
    for requirement in direct("test", "cluster", "qp", "ros2", "sound"):
        (version,) = lowest[canonicalize_name(requirement.name)]
        (bound,) = [part.version for part in requirement.specifier if part.operator == ">="]
        # The bound 8 stands for 8.0.0; where 8.0.0 was never released, for the first release that follows it.
        assert requirement.specifier.contains(version), requirement
        stated = version.release[: len(Version(bound).release)]
        assert stated == Version(bound).release, f"{requirement}: run `make lock`"


def test_upper_bounds_are_the_next_major_versions_after_those_that_are_tested() -> None:
    locked = pinned(LOCK)
    for requirement in direct(*FOR_USERS):
        tested = max(locked[canonicalize_name(requirement.name)])
        (bound,) = [part.version for part in requirement.specifier if part.operator == "<"]
        assert Version(bound) == Version(str(tested.major + 1)), requirement


def test_the_lock_with_digests_has_the_tested_versions_of_all_that_users_need() -> None:
    text = HASHED.read_text(encoding="utf-8")
    pins = re.findall(r"^([^=\s]+)==([^ ;]+)[^\\]*((?:\\\n +--hash=sha256:[0-9a-f]{64}\s*)+)$", text, re.MULTILINE)
    assert len(pins) == text.count("==") - text.count("python_full_version ==") - text.count("sys_platform ==")
    tested = pinned(LOCK)
    assert [name for name, version, _ in pins if Version(version) not in tested[canonicalize_name(name)]] == []
    assert {canonicalize_name(r.name) for r in direct()} <= {name for name, _, _ in pins}


def test_the_list_of_parts_is_that_of_the_lock() -> None:
    """Licences are those of the packages that were there when it was made."""
    made, now = (json.loads(text) for text in (SBOM.read_text(encoding="utf-8"), sbom()))
    for each in (made, now):
        stated = [part.pop("licenses", None) for part in each["components"]]
        assert sum(part is not None for part in stated) >= 30
    assert made == now, "run `make sbom`"


def test_versions_name_no_package_host() -> None:
    for path in (LOCK, LOWEST, HASHED, SBOM):
        assert "://" not in path.read_text(encoding="utf-8"), path.name


def test_makefile_locks_every_python_that_is_promised() -> None:
    prefix = "Programming Language :: Python :: 3."
    promised = [line.rpartition(" ")[2] for line in PROJECT["classifiers"] if line.startswith(prefix)]
    locked = next(
        line for line in (ROOT / "Makefile").read_text(encoding="utf-8").splitlines() if line.startswith("LOCKED")
    )
    assert locked.partition("=")[2].split() == promised


def test_every_file_of_the_package_is_in_the_wheel() -> None:
    """Modules are found by themselves, other files by the patterns of package-data."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    patterns = settings["package-data"]["occlog"]
    package = ROOT / "occlog"
    files = [path for path in package.rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    others = {path.relative_to(package) for path in files if path.suffix != ".py"}
    assert {Path("py.typed"), Path("report/templates/report.html.j2")} <= others
    assert [path for path in others if not any(path.match(pattern) for pattern in patterns)] == []
    assert all((path.parent / "__init__.py").exists() for path in files if path.suffix == ".py")
