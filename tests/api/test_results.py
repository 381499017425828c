"""Results show themselves, warn, and live as long as they are used."""

from __future__ import annotations

import gc
import inspect
import pickle
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from walk_frames import bearings_frame, stations_frame, truth_frame

import occlog
import occlog.api


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = (
        "import sys, occlog\n"
        "assert not {'numpy', 'pyarrow', 'click', 'importlib.metadata', 'occlog.api'} & set(sys.modules)\n"
        "import occlog.track.catalogue, occlog.evaluate.matching.config\n"
        "assert callable(occlog.track) and callable(occlog.evaluate) and callable(occlog.report)\n"
        "assert 'track' in dir(occlog) and occlog.open is occlog.api.open\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_function_and_the_sub_package_of_its_name_are_one() -> None:
    import occlog.evaluate.matching.config as matching
    import occlog.track.catalogue as methods

    assert "apf" in methods.METHODS
    assert matching.__name__ == "occlog.evaluate.matching.config"
    for name in ("evaluate", "ingest", "report", "simulate", "track"):
        package, function = getattr(occlog, name), getattr(occlog.api, name)
        assert inspect.signature(package) == inspect.signature(function)
        assert package.__doc__ == function.__doc__
        assert pickle.loads(pickle.dumps(package)) is package
    with pytest.raises(occlog.OcclogError):
        occlog.track(bearings_frame(), method="fix")  # without the stations: as the function does


def test_a_method_that_is_not_there_is_refused_with_the_nearest() -> None:
    with pytest.raises(occlog.UsageError, match="kalman") as refused:
        occlog.track(bearings_frame(), stations_frame(), method="kalman")
    assert all(name in str(refused.value) for name in ("apf", "ekf", "jipda"))
    with pytest.raises(occlog.UsageError, match="'jipda'"):
        occlog.track(bearings_frame(), stations_frame(), method="jpda")


def test_a_name_that_is_not_there_is_refused() -> None:
    with pytest.raises(AttributeError, match=r"has no attribute 'trakc'; it has .*track"):
        occlog.trakc  # type: ignore[attr-defined]  # noqa: B018


def test_tables_outlive_the_result_and_their_files_go_with_them() -> None:
    tracks = occlog.track(bearings_frame(), stations_frame(), method="fix").tracks
    gc.collect()
    assert len(tracks.to_pandas()) == len(tracks)
    path = tracks.path
    del tracks
    gc.collect()
    assert not path.exists()


def test_a_notebook_shows_figures_a_floor_plan_and_escapes_what_users_wrote() -> None:
    stations, bearings = stations_frame(), bearings_frame()
    result = occlog.track(bearings, stations, method="fix")
    page = result._repr_html_()
    assert "<svg" in page
    assert "targets" in page
    assert "TrackResult: tracks 40" in repr(result)
    named = occlog.read(bearings.assign(station="<script>alert(1)</script>"), "bearings")._repr_html_()
    assert "<script>" not in named
    assert "&lt;script&gt;" in named
    shown = occlog.report(result)._repr_html_()
    assert shown.startswith("<iframe srcdoc=")
    assert "<svg" not in shown


@pytest.mark.parametrize("method", ["ekf", "ukf", "apf"])
def test_what_speaks_against_estimates_is_a_warning_of_python(method: str) -> None:
    bearings = bearings_frame().assign(sigma_deg=0.02)
    with pytest.warns(occlog.OcclogWarning, match="bearings") as caught:
        result = occlog.track(bearings, stations_frame(), method=method)
    assert any("bearings are rejected" in str(w.message) for w in caught)
    assert any("their sigma may be in radians" in str(w.message) for w in caught)
    assert result.plausible is False
    assert {str(w.message) for w in caught} == set(result.warnings)
    assert all(w.filename == __file__ for w in caught)
    assert result.warnings[0].replace("&", "&amp;")[:20] in result._repr_html_()


def test_tables_are_saved_as_what_their_name_says(tmp_path: Path) -> None:
    tracks = occlog.track(bearings_frame(), stations_frame(), method="fix").tracks
    tracks.save(tmp_path / "tracks.csv")
    assert len(pd.read_csv(tmp_path / "tracks.csv")) == len(tracks)
    with pytest.raises(occlog.OutputExistsError):
        tracks.save(tmp_path / "tracks.csv")
    with pytest.raises(occlog.UsageError, match="its name does not state the format"):
        tracks.save(tmp_path / "tracks.xyz")
    with pytest.raises(occlog.InputError, match="tracks has no column 'z_m'"):
        tracks["z_m"]
    assert tracks.units["x"] == "m"
    assert tracks.provenance["command"] == "track"


def test_functions_write_nothing_on_the_standard_streams(capfd: pytest.CaptureFixture[str]) -> None:
    result = occlog.track(bearings_frame(), stations_frame(), method="fix", progress=True)
    occlog.report(result, truth=truth_frame())
    assert capfd.readouterr() == ("", "")
