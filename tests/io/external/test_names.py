"""Names of columns: which table a file is, what each of its columns is, in which unit."""

from __future__ import annotations

import pytest

from occlog.errors import InputError
from occlog.io.external.names import describe_missing, ending, lay_out, misspelled, spellings
from occlog.records.columns import Column, ColumnTable
from occlog.records.declared.sensors import Measurements
from occlog.records.tables import TABLES, Bearings, Boxes, Doa, Tracks, Truth


def found(table: type[ColumnTable], *names: str) -> dict[str, tuple[str, str]]:
    return {s.column.name: (s.name, s.unit) for s in lay_out(names, table).columns}


@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
def test_a_table_has_its_own_names(table: type[ColumnTable]) -> None:
    names = [c.name for c in table.columns()]
    layout = lay_out(names, table)
    assert [s.name for s in layout.columns] == names
    assert not layout.missing
    assert layout.similarities == (len(names), len(names))
    assert misspelled(layout, names) is None


def test_usual_names_are_known_with_their_units() -> None:
    assert found(Bearings, "Time", "Station", "Azimuth_deg", "SIGMA_DEG") == {
        "t_ns": ("Time", "s"),
        "sensor": ("Station", ""),
        "bearing": ("Azimuth_deg", "deg"),
        "sigma": ("SIGMA_DEG", "deg"),
    }
    assert found(Truth, "t_ms", "person_id", "x_cm", "y_cm") == {
        "t_ns": ("t_ms", "ms"),
        "target_id": ("person_id", ""),
        "x": ("x_cm", "cm"),
        "y": ("y_cm", "cm"),
    }
    assert found(Boxes, "timestamp_us", "cam", "x1", "y1", "x2", "y2", "score")["width_px"] == ("x2", "")


@pytest.mark.parametrize(
    ("column", "expected"), [("x", "_cm"), ("vx", "_cm_s"), ("cov_xx", "_cm2"), ("cov_x_vx", "_cm2_s")]
)
def test_units_of_powers_are_written_out(column: str, expected: str) -> None:
    declared = {c.name: c for c in Tracks.columns()}[column]
    assert ending(declared, "cm") == expected
    assert spellings(declared)[column + expected] == "cm"


def test_a_missing_column_is_named_with_the_nearest() -> None:
    names = ("time", "station", "brng_deg", "sigma_deg")
    layout = lay_out(names, Bearings)
    assert layout.missing == ("bearing",)
    assert describe_missing(layout, names) == (
        "bearings requires bearing (or bearing_deg, bearing_rad), is it 'brng_deg'?; the file has "
        "time, station, brng_deg, sigma_deg"
    )


def test_an_angle_without_a_unit_is_refused_but_next_to_the_tables_own_times() -> None:
    assert found(Bearings, "t_ns", "sensor", "bearing", "sigma")["bearing"] == ("bearing", "")
    with pytest.raises(InputError, match="column bearing does not state its unit; name it bearing_deg or bearing_rad"):
        lay_out(("time", "sensor", "bearing", "sigma"), Bearings)


def test_lengths_are_in_one_unit() -> None:
    assert lay_out(("t", "x_cm", "y_cm"), Truth).length_unit == "cm"
    assert lay_out(("t", "x", "y"), Truth).length_unit is None
    for names in (("t", "x_cm", "y_m"), ("t", "x_cm", "y")):
        with pytest.raises(InputError, match="have different units; use one unit for all lengths"):
            lay_out(names, Truth)


def test_a_length_without_a_unit_next_to_one_with_it_is_named_with_it() -> None:
    with pytest.raises(InputError, match=r"column dist does not state its unit: .* \(dist_cm, sigma_range_cm\)"):
        lay_out(("t", "sensor", "dist", "sigma_range_cm"), Measurements)
    with pytest.raises(InputError, match=r"column sigma_range does not state its unit: .* \(range_m, sigma_range_m\)"):
        lay_out(("t", "sensor", "range_m", "sigma_range"), Measurements)


def test_two_columns_of_one_meaning_are_refused_but_the_own_name_counts() -> None:
    assert found(Doa, "t_ns", "sensor", "azimuth", "bearing")["azimuth"] == ("azimuth", "")
    with pytest.raises(InputError, match="both state target_id; keep one"):
        lay_out(("t", "id", "track_id", "x", "y"), Truth)


@pytest.mark.parametrize(("name", "wrong"), [("elevatoin_deg", True), ("note", False), ("temperature", False)])
def test_a_name_that_is_nearly_right_is_not_passed_over(name: str, wrong: bool) -> None:
    names = ("time", "station", "azimuth_deg", name)
    message = misspelled(lay_out(names, Doa), names)
    assert (message is not None) == wrong
    assert message is None or "did you mean 'elevation_deg'?" in message


def test_a_column_of_pixels_is_not_a_length() -> None:
    kinds: dict[str, Column] = {c.name: c for c in Boxes.columns()}
    assert "left_px_cm" not in spellings(kinds["left_px"])


def test_lengths_of_scenes_without_a_unit_are_known_again() -> None:
    layout = lay_out(["t_ns", "target_id", "x_unit", "y_unit", "vx_unit_s", "cov_xx_unit2"], Tracks)
    assert layout.length_unit == "unit"
    assert {s.column.name for s in layout.columns} == {"t_ns", "target_id", "x", "y", "vx", "cov_xx"}
