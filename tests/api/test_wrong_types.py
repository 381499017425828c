"""Arguments of the Python API of another type than documented are refused with an error of occlog."""

from __future__ import annotations

import inspect

import pytest

import occlog

FUNCTIONS = ("detect", "evaluate", "fuse", "fuse_tracks", "ingest", "label", "overlay", "report", "simulate", "track")
READERS = ("open", "read", "read_scene")
VALUES = (5, 3.5, "x", b"x", ["x"], {"x": 5}, {"x": [5]}, object())
VARIABLE = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
PLAIN = ("overwrite", "progress", "kwargs")


def arguments() -> list[tuple[str, str]]:
    """Names of all functions with each of their arguments."""
    return [
        (name, parameter.name)
        for name in (*FUNCTIONS, *READERS)
        for parameter in inspect.signature(getattr(occlog, name)).parameters.values()
        if parameter.kind not in VARIABLE and parameter.name not in PLAIN
    ]


@pytest.mark.filterwarnings("ignore::occlog.OcclogWarning")
@pytest.mark.parametrize(("name", "argument"), arguments())
def test_values_of_other_types_are_refused(name: str, argument: str, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    function = getattr(occlog, name)
    required = {
        each.name: "missing.parquet"
        for each in inspect.signature(function).parameters.values()
        if each.default is each.empty and each.kind not in VARIABLE
    }
    for value in VALUES:
        with pytest.raises(occlog.OcclogError):
            function(**{**required, argument: value})


@pytest.mark.parametrize("value", [5, b"x", None, ["x"], object()])
def test_bags_of_other_types_are_refused(value: object) -> None:
    with pytest.raises(occlog.OcclogError):
        occlog.ingest(value)
    with pytest.raises(occlog.UsageError) as refused:
        occlog.ingest(bags=value)
    assert refused.value.id == "unknown-key"


def test_pairs_are_numbers_or_text_as_on_the_command_line(tmp_path) -> None:
    made = tmp_path / "boxes.csv"
    made.write_text("frame,camera,left,top,width,height\n" + "".join(f"{k},cam,10,20,30,60\n" for k in range(9)))
    for frames in ((2, 6), [2, 6], "2:6", {"cam": (2, 6)}, {"cam": "2:6"}):
        recording = occlog.ingest(boxes=made, fps=5.0, frames=frames, allow_uncalibrated=True)
        assert sorted(set(occlog.read(recording, "boxes").to_pandas().frame)) == [2, 3, 4, 5]
    for frames in ((6, 2), (2,), (2, 6, 8), (2.0, 6.0), "6:2", 5):
        with pytest.raises(occlog.UsageError) as refused:
            occlog.ingest(boxes=made, fps=5.0, frames=frames, allow_uncalibrated=True)
        assert refused.value.id == "invalid-setting"
