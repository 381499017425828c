"""Among very many people priors of their places help, or hurt little: their errors last, and are tempered."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from places import ROOT

from occlog.cli.main import run
from occlog.errors import ExitCode


@pytest.mark.statistics
@pytest.mark.jit
def test_among_160_people_priors_are_not_worse_than_none_and_covariances_hold(tmp_path: Path, capsys) -> None:
    room, priors, tracks = (str(tmp_path / name) for name in ("room.mcap", "priors.parquet", "tracks.parquet"))
    rmse: dict[bool, list[float]] = {True: [], False: []}
    for seed in ("3", "4"):
        made = [str(ROOT / "examples" / "room100.yaml"), "-o", room, "--steps", "120", "--seed", seed]
        assert run(["simulate", *made, "--occluders", "160", "-q", "--overwrite"]) == ExitCode.DONE
        assert run(["priors", "kalman", room, "-o", priors, "--seed", seed, "-q", "--overwrite"]) == ExitCode.DONE
        for reported in (True, False):
            also = ["--occluders", priors] if reported else []
            assert run(["track", room, *also, "-o", tracks, "--overwrite", "-q"]) == ExitCode.DONE
            capsys.readouterr()
            assert run(["evaluate", tracks, "--truth", room, "--json"]) == ExitCode.DONE
            found = json.loads(capsys.readouterr().out)
            rmse[reported].append(found["rmse_unit"])
            assert found["nees_mean"] < 4.0
    assert np.mean(rmse[True]) < 1.2 * np.mean(rmse[False])
