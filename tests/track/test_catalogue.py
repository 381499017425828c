"""What the catalogue says of methods."""

from __future__ import annotations

import pytest

from occlog.track.catalogue import smooths


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
