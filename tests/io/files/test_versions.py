"""Versions in provenance: all that the package requires, the same each time, and of the file where it is read."""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import version
from pathlib import Path

from places import ROOT

from occlog import __version__
from occlog.io.files.provenance import DISTRIBUTIONS, UNKNOWN, Provenance, installed_versions, provenance_from_json
from occlog.io.files.tables.parquet import read_provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.records.tables import Bearings


def test_every_requirement_has_its_version() -> None:
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    assert sorted(DISTRIBUTIONS) == sorted(re.split("[><=]", text)[0] for text in stated)
    found = installed_versions()
    assert set(DISTRIBUTIONS) <= set(found)
    assert all(found[name] == version(name) for name in found if name != "python")


def test_versions_are_those_that_the_file_was_made_with(tmp_path: Path) -> None:
    made = Provenance("detect", version="0.0.1", versions={"numpy": "1.0"})
    write_table(tmp_path / "t.parquet", Bearings.concat([]), made)
    found = read_provenance(tmp_path / "t.parquet")
    assert found == made
    assert found.as_dict()["version"] == "0.0.1"
    assert found.as_dict()["versions"] == {"numpy": "1.0"}


def test_older_files_and_those_of_others_state_none() -> None:
    assert provenance_from_json("", Path("t")) is UNKNOWN
    old = provenance_from_json('{"command": "detect", "parameters": {}, "version": "0.1.0"}', Path("t"))
    assert (old.version, old.versions) == ("0.1.0", {})
    assert "versions" not in old.as_dict()
    assert Provenance("detect").version == __version__
