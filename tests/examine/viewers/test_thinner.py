"""`occlog export --every`: which messages of a long recording are left out."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.reader import make_reader
from viewer_runs import fill

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.examine.viewers.drawings.shapes import DrawingGroup
from occlog.examine.viewers.series import Series
from occlog.examine.viewers.time_stream import LogLine, Numbers, SceneDrawing, Thinner

NS = 10**9


def raw(path: Path) -> dict[str, list[tuple[int, bytes]]]:
    """Times and bytes of the messages by topic."""
    messages: dict[str, list[tuple[int, bytes]]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            messages.setdefault(channel.topic, []).append((message.log_time, message.data))
    return messages


def drawn(topic: str, t: float, *, empty: bool = False) -> SceneDrawing:
    return SceneDrawing(topic, round(t * NS), [] if empty else [DrawingGroup("one")])


def test_the_first_moment_of_a_topic_in_each_stretch_is_kept() -> None:
    thinner = Thinner(NS)
    # Stretches begin with the first time of all, at 0.5 s: up to 1.5 s, up to 2.5 s, ...
    kept = [t for t in (0.5, 0.6, 1.4999, 1.5, 1.6, 2.5, 4.7, 4.8) if thinner.keeps(drawn("/targets", t))]
    assert kept == [0.5, 1.5, 2.5, 4.7]
    kept = [t for t in (4.9, 5.4, 5.5) if thinner.keeps(drawn("/truth", t))]
    assert kept == [4.9, 5.5]
    numbers = [Numbers(f"/tracks/{k}", 6 * NS, Series("Tracks", ("x",)), [1.0]) for k in (1, 2, 1)]
    assert [thinner.keeps(each) for each in numbers] == [True, True, False]
    assert all(thinner.keeps(LogLine(6 * NS, True, "target 1", "quality_flags")) for _ in range(3))


def test_the_end_of_what_was_drawn_is_kept_once() -> None:
    thinner = Thinner(NS)
    assert not thinner.keeps(drawn("/targets", 0.0, empty=True))  # nothing was there
    assert thinner.keeps(drawn("/targets", 0.1))
    assert thinner.keeps(drawn("/targets", 0.2, empty=True))
    assert not thinner.keeps(drawn("/targets", 0.3, empty=True))
    assert not thinner.keeps(drawn("/targets", 0.4))  # this stretch has had its time
    assert not thinner.keeps(drawn("/targets", 0.5, empty=True))
    assert thinner.keeps(drawn("/targets", 1.0))


@pytest.mark.parametrize("viewer", ["viewers", "rerun"])
def test_messages_that_are_kept_are_those_of_the_whole_file(tmp_path: Path, viewer: str) -> None:
    folder = fill(tmp_path)
    for name, more in (("whole", ()), ("thin", ("--every", "2"))):
        command = ["export", str(folder), "-o", str(tmp_path / f"{name}.mcap"), "--to", viewer, "-q", *more]
        assert run(command) == ExitCode.DONE
    whole, thin = raw(tmp_path / "whole.mcap"), raw(tmp_path / "thin.mcap")
    assert set(whole) == set(thin)
    assert all(set(thin[topic]) <= set(whole[topic]) for topic in whole)
    assert thin["/log"] == whole["/log"]
    assert sum(map(len, thin.values())) < sum(map(len, whole.values()))


def test_it_is_of_viewers_only_and_refused_for_what_is_made_already(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = fill(tmp_path)
    monkeypatch.chdir(folder)
    assert run(["export", "tracks.parquet", "-o", "t.csv", "--every", "1"]) == ExitCode.USAGE
    assert "--every: is for viewers' formats only" in capsys.readouterr().err
    for bad in ("0", "-1", "nan", "inf"):
        assert run(["export", ".", "-o", "bad.mcap", "--every", bad]) == ExitCode.USAGE
    assert run(["view", ".", "--print", "--viewer", "rerun", "-o", "v.mcap", "--every", "2", "-q"]) == ExitCode.DONE
    assert run(["export", ".", "-o", "r.mcap", "--to", "rerun", "--every", "2", "-q"]) == ExitCode.DONE
    assert Path("v.mcap").read_bytes() == Path("r.mcap").read_bytes()
    capsys.readouterr()
    assert run(["view", "v.mcap", "--print", "--viewer", "rerun", "--every", "1"]) == ExitCode.USAGE
    assert "give --every to occlog export" in capsys.readouterr().err
    assert not Path("bad.mcap").exists()
