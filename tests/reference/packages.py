"""Packages with plug-ins, as pip leaves them on the path: their metadata."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest
from places import ROOT

GROUPS = {
    "method": "occlog.tracking_methods",
    "view": "occlog.view_trackers",
    "reader": "occlog.readers",
    "detector": "occlog.detectors",
    "metric": "occlog.metrics",
    "exporter": "occlog.exporters",
}


def install(folder: Path, package: str, version: str, points: Mapping[str, Mapping[str, str]]) -> None:
    """Metadata of a package; `points` by a key of `GROUPS`, then by name."""
    info = folder / f"{package.replace('-', '_')}-{version}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: {version}\n", encoding="utf-8")
    lines = [
        line
        for kind, named in points.items()
        for line in (f"[{GROUPS[kind]}]", *(f"{name} = {where}" for name, where in named.items()))
    ]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def install_own_parts(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The example with a reader, a detector, a tracker, a metric and an exporter, and the own filter, on the path."""
    folder.mkdir()
    for name in ("own_parts/own_tables", "own_parts/own_images", "own_filter/own_filter"):
        path = ROOT / f"examples/plugins/{name}.py"
        shutil.copy(path, folder)
        monkeypatch.delitem(sys.modules, path.stem, raising=False)
    install(folder, "occlog-own-filter", "1.0", {"method": {"own": "own_filter:OwnFilter"}})
    install(
        folder,
        "occlog-own-parts",
        "1.0",
        {
            "reader": {"compass": "own_tables:CompassLog"},
            "metric": {"gaps": "own_tables:Gaps"},
            "exporter": {"gnuplot": "own_tables:Gnuplot"},
            "detector": {"bright": "own_images:BrightRegions"},
            "view": {"overlap": "own_images:OverlapTracker"},
        },
    )
    monkeypatch.syspath_prepend(str(folder))
