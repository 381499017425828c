"""Provenance of a page: the command (options that change results), the seed, and the version of the program."""

from __future__ import annotations

import json
import shlex
import subprocess
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import NamedTuple

import occlog

COMMIT_S = 5.0
"""Time that git has to name the commit [s]."""


class PageProvenance(NamedTuple):
    """Where a page comes from.

    Attributes:
        command: command line, with the options that change results.
        seed: seed of the experiments.
        version: version of occlog.
        commit: its commit; None if unknown.
    """

    command: str
    seed: int
    version: str
    commit: str | None

    def as_dict(self) -> dict[str, object]:
        """Fields by name as plain values for JSON."""
        return self._asdict()

    def text(self) -> str:
        """Sentence for the page that states command, seed, version and commit."""
        commit = f" (commit {self.commit})" if self.commit else ""
        return f"Made by `{self.command}`, seed {self.seed}, with occlog {self.version}{commit}."


def made_by(arguments: Sequence[str], seed: int) -> PageProvenance:
    """Provenance of a page that `occlog` makes with these arguments and this seed."""
    return PageProvenance(shlex.join(["occlog", *arguments]), seed, occlog.__version__, commit_of_program())


def commit_of_program() -> str | None:
    """Commit that the program is from: of the repository it runs in, or that pip has installed; None if unknown."""
    folder = Path(occlog.__file__).resolve().parents[1]
    if (folder / ".git").exists():
        asked = ["git", "-C", str(folder), "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
        try:
            done = subprocess.run(asked, capture_output=True, text=True, timeout=COMMIT_S, check=False)
        except (OSError, subprocess.SubprocessError):
            return None
        return done.stdout.strip() or None if done.returncode == 0 else None
    try:
        text = distribution("occlog").read_text("direct_url.json")
        commit = json.loads(text or "{}").get("vcs_info", {}).get("commit_id")
    except (PackageNotFoundError, ValueError, AttributeError):
        return None
    return commit if isinstance(commit, str) else None
