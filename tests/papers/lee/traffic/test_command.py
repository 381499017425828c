"""`occlog traffic`: delays of all cases, and every way in which a network can be wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from places import ROOT

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.tables.parquet import read_table
from occlog.records.tables import Delays

NETWORK = """occlog_network: 1
server: server
links: [[R1, R2], [R2, server]]
objects: {R1: 10}
sensors: [{name: S1, router: R1, detects: 10, assigned: 1.0}]
cameras: [{name: V, router: R2}]
"""


def test_every_case_has_a_delay_of_each_router(tmp_path: Path) -> None:
    out = tmp_path / "delays.parquet"
    sizes = ["--image-kb", "10,40", "--objects-share", ".1,1", "--channel", "link"]
    assert run(["traffic", str(ROOT / "examples" / "traffic.yaml"), *sizes, "-o", str(out), "-q"]) == ExitCode.DONE
    table = read_table(out, Delays)
    ends = table.take(table.kind == "end-to-end")
    assert len(ends) == 2 * 2 * 2 * 5
    assert set(table.channel.tolist()) == {"link"}
    larger = ends.delay_s[ends.image_kb == 40].max() > ends.delay_s[ends.image_kb == 10].max()
    assert larger
    assert np.isfinite(table.air_s[table.kind != "end-to-end"]).all()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("router: R1, det", "router: R9, det", "S1: no router 'R9'"),
        ("objects: {R1: 10}", "objects: {R9: 10}", "no router 'R9'"),
        ("objects: {R1: 10}", "objects: {R2: 10}", "router R2 has 10 objects, but no sensor"),
        ("objects: {R1: 10}", "objects: {R1: 0}", "objects: "),
        ("[R2, server]]", "[R2, R3]]", "no link leads to the server"),
        ("[[R1, R2],", "[[R1, R9],", "no way leads from the server"),
        ("[[R1, R2],", "[[R1, R1],", "a link leads from R1 to itself"),
        ("name: V,", "name: R2,", "two nodes are named R2"),
        ("detects: 10", "detects: -1", "detects"),
        ("occlog_network: 1", "occlog_network: 1\nspeed: 3", "speed"),
        ("server: server", "server: server\nrate_bps: 0", "rate_bps"),
    ],
)
def test_a_wrong_network_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, says: str
) -> None:
    assert old in NETWORK
    path = tmp_path / "network.yaml"
    path.write_text(NETWORK.replace(old, new))
    assert run(["traffic", str(path), "-o", str(tmp_path / "d.parquet")]) == ExitCode.BAD_INPUT
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1
    assert says in error[0]


@pytest.mark.parametrize(
    ("option", "value", "says"),
    [
        ("--objects-share", "0", "above 0 and at most 1"),
        ("--objects-share", "1.1", "above 0 and at most 1"),
        ("--image-kb", "0", "above 0"),
        ("--protocol", "abc", "of rbvc, sbvc"),
    ],
)
def test_wrong_options_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, value: str, says: str
) -> None:
    path = tmp_path / "network.yaml"
    path.write_text(NETWORK)
    assert run(["traffic", str(path), option, value, "-o", str(tmp_path / "d.parquet")]) == ExitCode.USAGE
    assert says in capsys.readouterr().err
