"""The numbers are those that were looked at when the golden outputs were made."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode

HERE = Path(__file__).resolve().parent


def _make() -> ModuleType:
    spec = importlib.util.spec_from_file_location("golden_make", HERE / "make.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


make = _make()


@pytest.mark.slow
@pytest.mark.parametrize("part", make.PARTS)
def test_outputs_have_not_changed(tmp_path: Path, capsys: pytest.CaptureFixture[str], part: str) -> None:
    make.PARTS[part](tmp_path / part)
    capsys.readouterr()
    code = run(["diff", str(make.EXPECTED / part), str(tmp_path / part)])
    assert code == ExitCode.DONE, capsys.readouterr().out + "\nif the change is meant: make golden"


def test_a_change_would_be_noticed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    metrics = json.loads((make.EXPECTED / "simulated" / "metrics.json").read_text())
    changed = tmp_path / "metrics.json"
    changed.write_text(json.dumps({**metrics, "rmse_m": metrics["rmse_m"] * (1 + 1e-6)}))
    assert run(["diff", str(make.EXPECTED / "simulated" / "metrics.json"), str(changed)]) == ExitCode.DIFFERENT
    assert "rmse_m" in capsys.readouterr().out
