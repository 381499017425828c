"""`occlog track --method fix` on a field log of bearings, against its authors' fixes."""

from __future__ import annotations

import json
import re
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.parquet import read_table
from occlog.records.tables import Diagnostics, Tracks

NS = 1_000_000_000
FIX = re.compile(r"(\d\d/\d\d/\d\d)\s+(\d\d:\d\d:\d\d)[^\r]*\r\s*(\d{7})\s+(\d{7})")


@pytest.mark.parametrize(
    ("estimator", "rows", "limit"), [("mle", 266, 1.5), ("huber", 269, 1.5), ("andrews", 272, 2.0), ("rmr", 276, 50.0)]
)
def test_fixes_of_a_field_log(
    shared_data: Path, tmp_path: Path, capsys, estimator: str, rows: int, limit: float
) -> None:
    """Median distance to the published fixes, which are in whole metres: 1.2 m of maximum likelihood."""
    data = shared_data / "telemetr_bearings"
    known = {}
    for day, clock, east, north in FIX.findall((data / "fixes.dat").read_bytes().decode("latin-1")):
        at = datetime.strptime(f"{day} {clock}", "%m/%d/%y %H:%M:%S").replace(tzinfo=UTC)
        known[round(at.timestamp()) * NS] = (float(east), float(north))
    field, out, how = (str(tmp_path / n) for n in ("field.mcap", "fix.parquet", "how.parquet"))
    logs = ["--doa", str(data / "azimuth.dat"), "--arrays", str(data / "towers.dat")]
    assert run(["ingest", "-o", field, *logs, "-q"]) == ExitCode.DONE
    capsys.readouterr()
    args = ["--method", "fix", "--doa-labels", "--set", f"estimator={estimator}", "--diagnostics", how, "-q", "--json"]
    assert run(["track", field, "-o", out, *args]) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["rows"] == rows
    found = read_table(tmp_path / "fix.parquet", Tracks)
    pairs = [(x, y, *known[t]) for t, x, y in zip(found.t_ns.tolist(), found.x, found.y, strict=True) if t in known]
    assert len(pairs) > 240
    x, y, east, north = np.array(pairs).T
    assert np.median(np.hypot(x - east, y - north)) < limit
    told = read_table(tmp_path / "how.parquet", Diagnostics)
    assert set(told.fallback[told.n_seen == 2].tolist()) == {"pair"}
    assert (told.n_seen >= 2).all()


def test_settings_that_are_none(shared_data: Path, tmp_path: Path, capsys) -> None:
    data = shared_data / "telemetr_bearings"
    field = str(tmp_path / "field.mcap")
    logs = ["--doa", str(data / "azimuth.dat"), "--arrays", str(data / "towers.dat")]
    assert run(["ingest", "-o", field, *logs, "-q"]) == ExitCode.DONE
    capsys.readouterr()
    for args in (["--set", "estimator=mean"], ["--start", "1,2"], ["--set", "bend=none"]):
        code = run(["track", field, "-o", str(tmp_path / "t.parquet"), "--method", "fix", "--doa-labels", "-q", *args])
        error = capsys.readouterr().err
        assert code in (ExitCode.USAGE, ExitCode.BAD_INPUT)
        assert error.count("\n") == 1
