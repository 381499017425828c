"""What a type checker knows of the API: mypy checks this file with the package, and the tests run it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, assert_type

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from walk_frames import bearings_frame, stations_frame, truth_frame

import occlog


def test_tracks_have_types() -> None:
    result = occlog.track(bearings_frame(), stations_frame(), method="fix")
    assert_type(result, occlog.TrackResult)
    assert_type(result.tracks, occlog.Table)
    assert_type(result.tracks.to_pandas(), pd.DataFrame)
    assert_type(result.tracks["x"], NDArray[Any])
    assert_type(result.plausible, bool | None)
    assert_type(result.warnings, tuple[str, ...])
    assert_type(result.losses, tuple[occlog.Loss, ...])
    figures = occlog.evaluate(result, truth_frame())
    assert_type(figures, occlog.EvaluateResult)
    assert_type(figures.metrics, Mapping[str, float])
    assert figures.metrics["rmse_m"] < 3.0


def test_inputs_of_all_kinds_have_types() -> None:
    frame = bearings_frame()
    columns: dict[str, NDArray[Any]] = {str(name): np.asarray(frame[name]) for name in frame.columns}
    assert_type(occlog.read(columns, "bearings"), occlog.Table)
    assert_type(occlog.read_scene(stations_frame()), occlog.Scene)


def test_arguments_that_are_not_there_are_no_types() -> None:
    with pytest.raises(occlog.InputError):
        occlog.track(3, stations_frame())  # type: ignore[arg-type]
    with pytest.raises(TypeError):
        occlog.evaluate(None, None, None)  # type: ignore[call-arg]
