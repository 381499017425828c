"""First ellipses: CSV files and tables of boxes, and everything that can be wrong with them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from view_videos import SMALL, record_balls, small_balls

from occlog.errors import InputError
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.models.ellipses import FIRST, read_ellipses
from occlog.records.declared.views import ViewTracks
from occlog.records.tables import Bearings, Boxes, TruthBoxes

SIZES = {"view1": (160, 120), "view2": (160, 120)}
CAMERAS = ("view1", "view2")
HEADER = "sensor,target_id,x_px,y_px,a_px,b_px,rho_deg"
MADE = Provenance("test")


def written(path: Path, *lines: str, header: str = HEADER) -> Path:
    path.write_text("\n".join((header, *lines)) + "\n")
    return path


def test_csv_rows_in_either_camera_and_frame(tmp_path):
    path = written(
        tmp_path / "e.csv", "view1,0,10,20,5,4,90,3", "2,0,30,40,6,6,0,0", "# a note", header=f"{HEADER},frame"
    )
    first, second = read_ellipses(path, SIZES, CAMERAS)
    assert (first.sensor, first.target_id, first.frame) == ("view1", 0, 3)
    np.testing.assert_allclose(first.ellipse, [10, 20, 5, 4, np.pi / 2])
    assert (second.sensor, second.frame) == ("view2", 0)


def test_without_a_frame_it_is_the_first_and_other_cameras_are_left_out(tmp_path):
    path = written(tmp_path / "e.csv", "view1,0,10,20,5,4,0", "view2,0,10,20,5,4,0")
    (only,) = read_ellipses(path, {"view2": (160, 120)}, CAMERAS)
    assert (only.sensor, only.frame) == ("view2", FIRST)


@pytest.mark.parametrize(
    ("line", "reported"),
    [
        ("view1,0,160,20,5,4,0", "line 2: x_px is 160, outside the image of camera view1, which reaches from -0.5 to"),
        ("view1,0,10,-3,5,4,0", "line 2: y_px is -3, outside the image"),
        ("view1,0,10,20,0,4,0", "line 2: a_px is 0; it must be above 0 px"),
        ("view1,0,10,20,5,-1,0", "line 2: b_px is -1; it must be above 0 px"),
        ("view1,0,10,20,5000,4,0", "line 2: a_px is 5000, must be at most 200 px"),
        ("view7,0,10,20,5,4,0", "line 2: camera 'view7' is none of view1, view2"),
        ("view1,-1,10,20,5,4,0", "line 2: target_id is -1"),
        ("view1,0.5,10,20,5,4,0", "line 2: target_id is '0.5'; a whole number"),
        ("view1,0,ten,20,5,4,0", "line 2: x_px is 'ten'; a number"),
        ("view1,0,10,20,5,4", "line 2: 6 cells, but the first line has 7"),
    ],
)
def test_an_ellipse_that_cannot_be_is_named(tmp_path, line, reported):
    with pytest.raises(InputError, match=r"e\.csv: ") as caught:
        read_ellipses(written(tmp_path / "e.csv", line), SIZES, CAMERAS)
    assert reported in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_target_twice_in_a_view(tmp_path):
    path = written(tmp_path / "e.csv", "view1,4,10,20,5,4,0", "view2,4,10,20,5,4,0", "view1,4,50,20,5,4,0")
    with pytest.raises(InputError, match=r"line 4: target 4 is in camera view1 already \(line 2\)"):
        read_ellipses(path, SIZES, CAMERAS)


def test_columns_that_miss_or_are_unknown(tmp_path):
    bare = written(tmp_path / "a.csv", "view1,0,1,1,1,1", header="sensor,target_id,x_px,y_px,a_px,b_px")
    with pytest.raises(InputError, match="has no column rho_deg; add it"):
        read_ellipses(bare, SIZES, CAMERAS)
    path = written(tmp_path / "b.csv", "view1,0,1,1,1,1,0,1", header=f"{HEADER},speed")
    with pytest.raises(InputError, match="unknown column 'speed'") as caught:
        read_ellipses(path, SIZES, CAMERAS)
    assert "ignore" not in str(caught.value)


def test_true_boxes_of_a_recording_give_the_outlines_of_the_first_frame(tmp_path):
    found = read_ellipses(record_balls(tmp_path / "balls.mcap"), SIZES, CAMERAS)
    assert len(found) == 2 * SMALL.balls
    truth = small_balls()[0].ellipses
    for each in found:
        np.testing.assert_allclose(each.ellipse[:2], truth[CAMERAS.index(each.sensor), each.target_id, :2], atol=1e-9)
        np.testing.assert_allclose(each.ellipse[2:4], SMALL.radius, rtol=1e-3)
        assert each.frame == 0


def boxes(table=TruthBoxes, target=(0, 0, 0), visible=(0.2, 0.7, 1.0), left=(10.0, 12.0, 14.0)):
    n = len(target)
    values = {
        "t_ns": np.arange(n),
        "sensor": np.full(n, "view1"),
        "frame": np.arange(n),
        "box": np.zeros(n, dtype=np.int32),
        "target_id": np.array(target, dtype=np.int32),
        "left_px": np.array(left),
        "top_px": np.full(n, 20.0),
        "width_px": np.full(n, 10.0),
        "height_px": np.full(n, 20.0),
        "confidence": np.full(n, np.nan),
    }
    return table.of(**values, **({"visible": np.array(visible)} if table is TruthBoxes else {}))


def test_of_true_boxes_the_first_half_visible_one_with_its_centre_inside_is_taken(tmp_path):
    path = tmp_path / "t.parquet"
    write_table(path, boxes(), MADE)
    (first,) = read_ellipses(path, SIZES, CAMERAS)
    assert first.frame == 1
    np.testing.assert_allclose(first.ellipse, [17, 30, 5, 10, 0])
    write_table(path, boxes(left=(-20.0, -8.0, -4.0)), MADE, overwrite=True)
    assert read_ellipses(path, SIZES, CAMERAS)[0].frame == 2


def test_boxes_want_identities(tmp_path):
    path = tmp_path / "b.parquet"
    write_table(path, boxes(Boxes, (-1, -1, -1)), MADE)
    with pytest.raises(InputError, match="its boxes have no identities"):
        read_ellipses(path, SIZES, CAMERAS)
    write_table(path, boxes(Boxes, (-1, 3, 3)), MADE, overwrite=True)
    (first,) = read_ellipses(path, SIZES, CAMERAS)
    assert (first.target_id, first.frame) == (3, 1)


def test_tracks_in_images_go_on(tmp_path):
    one = {c.name: [""] if c.kind == "U" else np.zeros(1, c.dtype) for c in ViewTracks.columns()}
    given = {
        "sensor": ["view2"],
        "frame": [7],
        "target_id": np.array([2], np.int32),
        "x_px": [5.0],
        "y_px": [6.0],
        "a_px": [3.0],
        "b_px": [2.0],
        "rho": [0.5],
    }
    path = tmp_path / "v.parquet"
    write_table(path, ViewTracks.of(**one | given), MADE)
    (first,) = read_ellipses(path, SIZES, CAMERAS)
    assert (first.sensor, first.target_id, first.frame) == ("view2", 2, 7)
    np.testing.assert_allclose(first.ellipse, [5, 6, 3, 2, 0.5])


def test_files_without_an_ellipse(tmp_path):
    bearings = tmp_path / "b.parquet"
    write_table(bearings, Bearings.empty(), MADE)
    with pytest.raises(InputError, match="holds bearings; expected view_tracks, truth_boxes or boxes"):
        read_ellipses(bearings, SIZES, CAMERAS)
    with pytest.raises(InputError, match="holds no tracks in images and no true boxes and no boxes of a detector"):
        read_ellipses(record_balls(tmp_path / "plain.mcap", boxes=False), SIZES, CAMERAS)
    path = written(tmp_path / "e.csv", "view1,0,10,20,5,4,0")
    with pytest.raises(InputError, match="no ellipse of a target in view2"):
        read_ellipses(path, {"view2": (160, 120)}, CAMERAS)
    with pytest.raises(InputError, match="a table of ellipses"):
        read_ellipses(tmp_path / "none.csv", SIZES, CAMERAS)
