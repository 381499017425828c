"""Tables that are nearly right: what is said of them, and that none is read as something else in silence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode, InputError
from occlog.io.open import open_input
from occlog.measure.scans.grouping import nearest
from occlog.records.tables import Bearings, Boxes, Doa, Truth


def text(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("names", ["angle_deg,sigma_deg", "heading_deg,std_deg", "baering_deg,sigma_deg"])
def test_angles_of_unknown_names_are_no_reads_of_tags(tmp_path: Path, names: str) -> None:
    with pytest.raises(InputError, match="bearings wants bearing"):
        open_input(text(tmp_path / "t.csv", f"time,station,id,{names}", "0,a,1,10,1"))


def test_reads_of_tags_are_known_by_a_name_of_their_own(tmp_path: Path) -> None:
    assert open_input(text(tmp_path / "t.csv", "time,reader,tag,note", "0,a,1,x")).table == "reads"


@pytest.mark.parametrize("name", ["bearing_std_deg", "std_deg", "sd_bearing_deg", "bearing_sigma_deg"])
def test_standard_deviations_may_be_called_so(tmp_path: Path, name: str) -> None:
    opened = open_input(text(tmp_path / "t.csv", f"time,station,id,bearing_deg,{name}", "0,a,1,10,2"))
    assert opened.table == "bearings"
    assert opened.read(Bearings).sigma[0] == np.radians(2)


def test_stations_in_place_of_bearings_are_a_scene(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a table of stations, not of what they measured; give it as the scene"):
        open_input(text(tmp_path / "t.csv", "name,x,y", "a,0,0"))


def test_a_table_of_another_kind_says_what_it_holds(tmp_path: Path) -> None:
    opened = open_input(text(tmp_path / "t.csv", "time,id,x,y", "0,1,0,0"))
    with pytest.raises(InputError, match="as it is, it holds tracks"):
        opened.require(Bearings, Doa)


def test_a_decimal_comma_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="line 2: '0,5' has a decimal comma; write it with a point"):
        open_input(text(tmp_path / "t.csv", "time;id;x;y", "0,5;1;0;0")).read(Truth)


def test_a_name_in_other_letters_is_the_nearest() -> None:
    assert nearest("EAST", ("west", "east")) == "did you mean 'east'?"


def test_times_in_milliseconds_that_are_taken_for_seconds_are_doubted(tmp_path: Path, capsys: Any) -> None:
    scene = text(tmp_path / "stations.csv", "name,x,y", "a,0,0", "b,10,0")
    rows = [f"{500 * k},{name},1,{angle},1" for k in range(6) for name, angle in (("a", 45), ("b", 135))]
    table = text(tmp_path / "t.csv", "time,station,id,bearing_deg,sigma_deg", *rows)
    args = ["track", str(table), "--scene", str(scene), "--method", "ekf", "-o", str(tmp_path / "o.parquet")]
    assert run(args) == ExitCode.DONE
    assert "state it by --input-units ms" in capsys.readouterr().err
    assert run([*args, "--overwrite", "--input-units", "ms"]) == ExitCode.DONE
    assert "--input-units" not in capsys.readouterr().err


def test_widths_that_contradict_the_edges_are_of_the_image(tmp_path: Path) -> None:
    head = "time,sensor,width,height,xmin,ymin,xmax,ymax"
    opened = open_input(text(tmp_path / "t.csv", head, "0,a,1280,720,10,20,80.5,90"))
    with pytest.raises(InputError, match=r"line 2: width is 1280, but xmax is 80\.5 and the near edge 10"):
        opened.read(Boxes)
    assert open_input(text(tmp_path / "t.csv", head, "0,a,70,71,10,20,80.5,90")).read(Boxes).width_px[0] == 70
