"""What the catalogue says of methods."""

from __future__ import annotations

import pytest

from occlog.track.catalogue import method_for, smooths


@pytest.mark.parametrize(
    ("command", "parameters", "smoothed"),
    [
        ("track", {"method": "map"}, True),
        ("track", {"method": "map", "lag_s": 3.0}, True),
        ("track", {"method": "apf"}, False),
        ("track", {"method": "apf", "smooth": False, "lag_s": None}, False),
        ("track", {"method": "apf", "smooth": True, "lag_s": None}, True),
        ("track", {"method": "imm", "smooth": False, "lag_s": 0.5}, True),
        ("ground", {"method": "map"}, False),
        ("track", {}, False),
    ],
)
def test_tracks_say_whether_they_know_what_came_after_them(
    command: str, parameters: dict[str, object], smoothed: bool
) -> None:
    assert smooths(command, parameters) is smoothed


def test_the_method_for_a_file_that_cannot_be_read_is_the_default(tmp_path):
    (tmp_path / "x.parquet").write_bytes(b"PAR1")
    (tmp_path / "x.csv").write_text("t,sensor,bearing_deg\n0,a,1\n")
    for name in ("x.parquet", "missing.mcap", "x.csv"):
        assert method_for(tmp_path / name) == "apf"
