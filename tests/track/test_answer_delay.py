"""`occlog track --method imm --answer-delay`: how long cameras' answers take, in seconds or by delays of traffic."""

from __future__ import annotations

import json
from pathlib import Path

import click
import pytest
from places import EXAMPLES

from occlog.cli.main import run
from occlog.cli.options import NumberOrFile
from occlog.errors import ExitCode, InputError, UsageError
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.records.tables import Delays
from occlog.settings import SettingError
from occlog.track.request import TrackRequest
from occlog.track.run import make_config, max_router_delay

ONE_CASE = ("--protocol", "sbvc", "--image-kb", "40", "--objects-share", ".1")


def traffic(path: Path, *options: str) -> Path:
    assert run(["traffic", str(EXAMPLES / "traffic.yaml"), "-o", str(path), *options, "--json"]) == ExitCode.DONE
    return path


def request(delay: float | Path | None, **settings: object) -> TrackRequest:
    return TrackRequest(
        bearings=Path("heard.parquet"),
        output=Path("tracks.parquet"),
        method="imm",
        settings=settings,
        answer_delay=delay,
    )


def test_delays_of_one_case_count_by_their_slowest_router(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = traffic(tmp_path / "sbvc.parquet", *ONE_CASE)
    (longest,) = json.loads(capsys.readouterr().out)["delay_s"].values()
    assert max_router_delay(path) == longest == pytest.approx(1.031, abs=5e-4)
    assert make_config(request(path), "m") == make_config(request(longest), "m")
    assert request(path).inputs == [Path("heard.parquet"), path]
    assert request(longest).inputs == [Path("heard.parquet")]


def test_delays_of_several_cases_or_of_none_are_refused(tmp_path: Path) -> None:
    path = traffic(tmp_path / "both.parquet", "--image-kb", "10", "--objects-share", ".1")
    with pytest.raises(UsageError, match=r"delays of 2 cases \(rbvc, shared, 10 kB, 0.1; sbvc, shared, 10 kB, 0.1"):
        max_router_delay(path)
    rows = read_table(path, Delays)
    write_table(tmp_path / "messages.parquet", rows.take(rows.kind != "end-to-end"), Provenance("traffic"))
    with pytest.raises(InputError, match="has no end-to-end delays"):
        max_router_delay(tmp_path / "messages.parquet")


def test_seconds_are_those_of_the_setting_and_both_are_an_error() -> None:
    assert make_config(request(0.25), "m") == make_config(request(None, answer_delay_s=0.25), "m")
    assert make_config(request(1e6), "m") == make_config(request(None, answer_delay_s=1e6), "m")
    with pytest.raises(SettingError, match="answer_delay_s"):
        make_config(request(1.1e6), "m")
    with pytest.raises(UsageError, match="state the same quantity"):
        make_config(request(0.25, answer_delay_s=0.25), "m")


def test_an_option_takes_numbers_from_its_limit_on_and_else_paths() -> None:
    kind = NumberOrFile(0.0)
    assert [kind.convert(text, None, None) for text in ("0", "10", "delays.parquet")] == [0, 10, Path("delays.parquet")]
    for text in ("-0.1", "nan", "inf"):
        with pytest.raises(click.BadParameter):
            kind.convert(text, None, None)
