"""What occlog is made of, as CycloneDX JSON: `python -m docs.sbom` writes `sbom.json` from `requirements.lock`."""

from __future__ import annotations

import json
import re
import tomllib
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

from occlog import __version__
from occlog.io.files.provenance import hash_file
from occlog.measure.networks.shipped import shipped_network

ROOT = Path(__file__).resolve().parents[1]
SBOM = ROOT / "sbom.json"
_PIN = re.compile(r"^([A-Za-z0-9._-]+)==([^ ;\\]+)", re.MULTILINE)
_NAME = re.compile(r"[A-Za-z0-9._-]+")
LICENCE = "License :: "
NETWORK = "pkg:npm/%40vladmandic/human-models@3.0.4"
"""Source of the network that comes with occlog."""
LONGEST_NAME = 60
"""Some packages state the whole text of their licence instead of its name."""


def locked() -> list[tuple[str, str]]:
    """Name and version of every package in the lock, in its order; some have one for each Python."""
    return _PIN.findall((ROOT / "requirements.lock").read_text(encoding="utf-8"))


def direct() -> set[str]:
    """Names of the packages that occlog itself requires."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return {_NAME.match(text)[0] for text in project["dependencies"]}  # type: ignore[index]


def licences(name: str) -> list[dict[str, object]]:
    """Licences of an installed package as it states them; none where it does not, or is not installed here."""
    try:
        reported = metadata(name)
    except PackageNotFoundError:
        return []
    if expression := reported.get("License-Expression"):
        return [{"expression": expression}]
    stated = reported.get("License") or ""
    if stated and "\n" not in stated and len(stated) <= LONGEST_NAME:
        return [{"license": {"name": stated}}]
    classified = [
        text.rpartition(" :: ")[2] for text in reported.get_all("Classifier") or () if text.startswith(LICENCE)
    ]
    return [{"license": {"name": text}} for text in classified]


def sbom() -> str:
    """The text of `sbom.json`, without time and serial number, so that it is the same each time."""
    packages = locked()
    refs = {(name, version): f"pkg:pypi/{name}@{version}" for name, version in packages}
    own = f"pkg:pypi/occlog@{__version__}"
    wanted = direct()
    network = shipped_network()
    values = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": own,
                "name": "occlog",
                "version": __version__,
                "licenses": [{"expression": "MIT"}],
                "purl": own,
            }
        },
        "components": [
            {
                "type": "library",
                "bom-ref": ref,
                "name": name,
                "version": version,
                "purl": ref,
                **({"licenses": found} if (found := licences(name)) else {}),
            }
            for (name, version), ref in refs.items()
        ]
        + [
            {
                "type": "machine-learning-model",
                "bom-ref": NETWORK,
                "name": network.name,
                "version": NETWORK.rpartition("@")[2],
                "purl": NETWORK,
                "hashes": [{"alg": "SHA-256", "content": hash_file(network)}],
                "licenses": [{"expression": "MIT AND Apache-2.0"}],
            }
        ],
        "dependencies": [{"ref": own, "dependsOn": sorted([NETWORK, *(refs[p] for p in refs if p[0] in wanted)])}],
    }
    return json.dumps(values, indent=2, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    SBOM.write_text(sbom(), encoding="utf-8")
