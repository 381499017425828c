"""`track --scene` applies clocks of the scene to a recording, once, and says so."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from walking_people import cameras, write

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.io.open import open_input
from occlog.records.scene import Clock, Scene
from occlog.records.tables import Tracks

pytestmark = pytest.mark.jit


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Boxes of 12 s: as they are, and with 0.4 s added to the times of cam1."""
    folder = tmp_path_factory.mktemp("clocks")
    asked = ["ingest", "-q", *write(folder, cameras()), "--frames", ":60"]
    assert run([*asked, "-o", str(folder / "right.mcap")]) == ExitCode.DONE
    assert run([*asked, "-o", str(folder / "late.mcap"), "--clock-offset", "cam1=0.4s"]) == ExitCode.DONE
    first, second, third = cameras()
    clocks = (Clock("cam1-offset", 0),)
    stated = Scene((first, replace(second, clock="cam1-offset"), third), clocks=clocks)
    (folder / "clocks.yaml").write_text(scene_to_yaml(stated))
    (folder / "plain.yaml").write_text(scene_to_yaml(Scene((first, second, third))))
    return folder


def tracked(
    folder: Path, recording: str, scene: str | None, capsys: pytest.CaptureFixture[str]
) -> tuple[Tracks, object]:
    out = folder / f"{recording}-{scene}.parquet"
    asked = ["track", "-q", str(folder / recording), "-o", str(out), "--method", "jipda", "--json"]
    assert run([*asked, *([] if scene is None else ["--scene", str(folder / scene)])]) == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    return open_input(out, Tracks).read(Tracks), summary.get("clock_corrections_s")


def test_the_difference_of_clocks_is_applied_once(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Tracks of corrected times are those of the recording that was right; without a clock times stay."""
    right, none = tracked(folder, "right.mcap", None, capsys)
    assert none is None
    found, corrections = tracked(folder, "late.mcap", "clocks.yaml", capsys)
    assert corrections == {"cam1": -0.4}
    np.testing.assert_array_equal(found.t_ns, right.t_ns)
    np.testing.assert_allclose(found.x, right.x, atol=1e-5)
    again, none = tracked(folder, "right.mcap", "clocks.yaml", capsys)
    assert none is None
    np.testing.assert_allclose(again.x, right.x, atol=1e-5)
    late, none = tracked(folder, "late.mcap", "plain.yaml", capsys)
    own, _ = tracked(folder, "late.mcap", None, capsys)
    assert none is None
    np.testing.assert_array_equal(late.t_ns, own.t_ns)
    np.testing.assert_allclose(late.x, own.x, atol=1e-5)
