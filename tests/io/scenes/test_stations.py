"""A text table of stations is a scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from occlog.errors import InputError, UsageError
from occlog.io.formats.scenes.stations import holds_stations, read_stations
from occlog.io.formats.sound.formats import read_arrays
from occlog.io.open import scene_in


def stations(folder: Path, *lines: str) -> Path:
    path = folder / "stations.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_stations_are_sensors_that_tell_no_elevation(tmp_path: Path) -> None:
    path = stations(tmp_path, "Tower,x,y", "north,0,40", "east,45,-5")
    scene = scene_in(path)
    assert holds_stations(path)
    assert scene is not None
    assert [a.name for a in scene.arrays] == ["north", "east"]
    np.testing.assert_array_equal(scene.arrays[1].position, [45, -5, 0])
    assert all(a.planar for a in scene.arrays)
    assert scene.length_unit == "m"


def test_arrays_have_the_azimuth_of_their_x_axis(tmp_path: Path) -> None:
    """A12: a table of arrays, by `--scene` and by `ingest --arrays`."""
    path = stations(tmp_path, "array,x,y,z,yaw_deg", "north,0,5,1,90", "south,0,-5,1,0")
    for arrays in (read_stations(path).arrays, read_arrays(path)):
        assert [(a.name, a.planar) for a in arrays] == [("north", False), ("south", False)]
        np.testing.assert_allclose([a.yaw for a in arrays], [np.pi / 2, 0.0])
    with pytest.raises(UsageError, match="names its arrays; give the file without a name"):
        read_arrays(path, "north")
    with pytest.raises(InputError, match="yaw_deg of station north is 400; it must be within 360"):
        read_stations(stations(tmp_path, "array,x,y,yaw_deg", "north,0,5,400"))


def test_height_unit_and_noise(tmp_path: Path) -> None:
    scene = read_stations(stations(tmp_path, "name;x_cm;y_cm;z_cm;sigma_deg", "a;1;2;3;0.5", "b;4;5;6;2"))
    assert scene.length_unit == "cm"
    assert not scene.arrays[0].planar
    np.testing.assert_allclose([a.sigma for a in scene.arrays], np.radians([0.5, 2]))


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (("name,x,y", "a,1,2", "a,3,4"), "line 3: station a is there twice"),
        (("name,x,y,sigma_deg", "a,1,2,0"), "line 2: sigma_deg of station a is 0; it must be above 0"),
        (("name,x_m,y_cm", "a,1,2"), "positions are in cm and m; state all in one unit"),
        (("name,x,x_m,y", "a,1,1,2"), "columns x and x_m both state x; keep one"),
        (("name,x,y", "a,1,far"), "line 2: y is 'far'; a number was expected"),
        (("name,x,y,colour", "a,1,2,red"), "unknown column 'colour'"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(tmp_path: Path, lines: tuple[str, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        scene_in(stations(tmp_path, *lines))
