"""Tracking methods of installed packages are found by their entry points, used like ours, and fail in one line."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from packages import install
from places import ROOT
from walk_frames import bearings_frame, stations_frame, truth_frame

import occlog
from occlog.cli.main import cli, run

BAD = """
import numpy as np
from occlog.plugins.interface import EstimatedPosition, Settings

class Fails:
    summary, settings = "it fails", Settings
    def __init__(self, scene, settings, rng): pass
    def step(self, time): return 1 / 0

class Lies(Fails):
    def step(self, time): return EstimatedPosition(np.zeros(2), -np.eye(2))

class Empty: pass
"""


@pytest.fixture
def walk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with bearings, stations and truth, in which packages with plug-ins are installed."""
    site = tmp_path / "site"
    site.mkdir()
    shutil.copy(ROOT / "examples/plugins/own_filter/own_filter.py", site)
    (site / "bad_filters.py").write_text(BAD, encoding="utf-8")
    install(site, "occlog-own-filter", "1.0", {"method": {"own": "own_filter:OwnFilter"}})
    wrong = {"fails": "Fails", "lies": "Lies", "empty": "Empty", "gone": "Gone", "fix": "Fails"}
    install(site, "bad-filters", "0.3", {"method": {name: f"bad_filters:{where}" for name, where in wrong.items()}})
    install(site, "absent", "2.0", {"method": {"absent": "no_such_module:X"}})
    monkeypatch.syspath_prepend(str(site))
    for name in ("own_filter", "bad_filters"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    bearings_frame().to_csv(tmp_path / "bearings.csv", index=False)
    stations_frame().to_csv(tmp_path / "stations.csv", index=False)
    return tmp_path


def called(*args: object) -> Result:
    return CliRunner().invoke(cli, [str(a) for a in args])


def failed(capsys: pytest.CaptureFixture[str], *args: object) -> tuple[int, str]:
    code = run([str(a) for a in args])
    stderr = capsys.readouterr().err
    assert stderr.count("\n") == 1, stderr
    return code, stderr


def test_a_method_of_others_is_used_like_ours(walk: Path) -> None:
    args = ("track", walk / "bearings.csv", "--scene", walk / "stations.csv", "--method", "own")
    for out in ("a", "b"):
        made = called(*args, "-o", walk / f"{out}.parquet", "--sigma-a", 1, "--seed", 4)
        assert made.exit_code == 0, made.output
    assert (walk / "a.parquet").read_bytes() == (walk / "b.parquet").read_bytes()
    made_by = occlog.read(walk / "a.parquet").provenance["parameters"]
    assert made_by["plugin"] == "occlog-own-filter 1.0"
    assert made_by["sigma_a"] == 1.0
    result = occlog.track(walk / "bearings.csv", walk / "stations.csv", method="own", sigma_a=1, seed=4)
    assert result.tracks.path.read_bytes() == (walk / "a.parquet").read_bytes()
    assert occlog.evaluate(result, truth_frame()).metrics["rmse_m"] < 1.0
    assert np.isfinite(result["residuals"]["residual"]).all()


def test_settings_of_others_are_shown_and_checked_like_ours(walk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shown = called("track", "--method", "own", "--help").output
    assert "--sigma-a" in shown
    assert "White acceleration of the target." in shown
    listed = called("track", "--help").output
    assert "extended Kalman filter in thirty lines" in listed
    args = ("track", walk / "bearings.csv", "--scene", walk / "stations.csv", "-o", walk / "t.parquet", "--method")
    code, message = failed(capsys, *args, "own", "--set", "sigma_b=1")
    assert (code, "did you mean 'sigma_a'" in message) == (2, True)
    code, message = failed(capsys, *args, "own", "--sigma-a", "0")
    assert code == 2
    code, message = failed(capsys, *args, "owm")
    assert (code, "did you mean 'own'" in message) == (2, True)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("fails", r"plug-in fails \(bad-filters 0.3\): ZeroDivisionError: division by zero at .*bad_filters.py:8"),
        ("lies", r"plug-in lies \(bad-filters 0.3\): at \d+ s: the covariance is not positive definite"),
        ("empty", r"plug-in empty \(bad-filters 0.3\): bad_filters:Empty has no summary"),
        ("gone", r"plug-in gone \(bad-filters 0.3\): AttributeError: .*Gone"),
        ("absent", r"plug-in absent \(absent 2.0\): ModuleNotFoundError: No module named 'no_such_module'"),
    ],
)
def test_a_plug_in_that_fails_gives_one_line(walk: Path, name: str, words: str) -> None:
    with pytest.raises(occlog.PluginError, match=words) as error:
        occlog.track(walk / "bearings.csv", walk / "stations.csv", method=name)
    assert int(error.value.exit_code) == 4


def test_plug_ins_that_fail_break_no_other_command(walk: Path) -> None:
    made = called("track", walk / "bearings.csv", "--scene", walk / "stations.csv", "--method", "fix", "-o", walk / "f")
    assert made.exit_code == 0, made.output
    assert "plugin" not in occlog.read(walk / "f").provenance["parameters"]
    assert "ModuleNotFoundError" in called("track", "--help").output


def test_plug_ins_are_listed_and_checked(walk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stdout = {each["name"]: each for each in json.loads(called("plugin", "list", "--json").stdout)["plugins"]}
    assert stdout["own"]["package"] == "occlog-own-filter 1.0"
    assert "is not used: occlog has one of that name itself" in stdout["fix"]["summary"]
    assert run(["plugin", "check", "own"]) == 0
    assert "31 checks, 0 faults" in capsys.readouterr().out
    assert run(["plugin", "check", "fails"]) == 6
    assert "follows: step raises ZeroDivisionError: division by zero" in capsys.readouterr().out
    code, text = failed(capsys, "plugin", "check", "won")
    assert (code, "did you mean 'own'" in text) == (2, True)


def test_two_packages_with_one_name_are_refused(walk: Path) -> None:
    install(walk / "site", "another", "9", {"method": {"own": "bad_filters:Fails"}})
    sys.path.append(str(walk))  # another path: metadata are read again
    try:
        with pytest.raises(occlog.UsageError, match="is in another and occlog-own-filter; uninstall"):
            occlog.track(walk / "bearings.csv", walk / "stations.csv", method="own")
    finally:
        sys.path.remove(str(walk))
