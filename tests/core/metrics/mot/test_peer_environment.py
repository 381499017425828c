"""When the comparison with other programs is skipped, and when it fails."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import mot_environment
import pytest

OFFLINE = "WARNING: Retrying: Failed to establish a new connection\nERROR: No matching distribution found"
BROKEN = "error: subprocess-exited-with-error\nnumpy: no C compiler"


def pip_says(monkeypatch: pytest.MonkeyPatch, expected: str) -> None:
    """Let every command of the environment fail, once it is made, with these words."""

    def run(command: list[Any], **_: Any) -> subprocess.CompletedProcess[str]:
        return subprocess.CompletedProcess(command, int("pip" in command), "", expected)

    monkeypatch.delenv("OCCLOG_PEERS", raising=False)
    monkeypatch.setattr(mot_environment.subprocess, "run", run)


@pytest.mark.parametrize(
    ("expected", "required", "outcome"),
    [
        (OFFLINE, "", pytest.skip.Exception),
        (OFFLINE, "0", pytest.skip.Exception),
        (OFFLINE, "1", pytest.fail.Exception),
        (BROKEN, "", pytest.fail.Exception),
        (BROKEN, "1", pytest.fail.Exception),
    ],
)
def test_skipped_without_a_network_only(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, expected: str, required: str, outcome: type[BaseException]
) -> None:
    pip_says(monkeypatch, expected)
    monkeypatch.setenv("OCCLOG_PEERS_REQUIRED", required)
    with pytest.raises(outcome) as info:
        mot_environment.make_environment(tmp_path)
    assert expected.splitlines()[-1] in str(info.value)
