"""MCAP files whose index leaves out a topic that their chunks hold: read whole, or stated."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.writer import Writer

from occlog.cli.main import run
from occlog.errors import ExitCode, InputError
from occlog.examine.doctor.run import check_files
from occlog.io.files.provenance import Provenance
from occlog.io.messages.bag import open_bag
from occlog.io.recording.mcap_errors import open_mcap
from occlog.io.recording.metadata import add_metadata
from occlog.io.recording.reader import open_recording
from occlog.io.recording.writer import FORMAT, METADATA


def lying(path: Path, *lies: str, library: str = "occlog test") -> Path:
    """Five messages of /a and five of /b, in chunks of two; the index lies about /b.

    Args:
        path: the file.
        lies: `chunks`: does not lead to the chunks of /b; `behind`: nor do the indexes behind them; `zero`, `out`:
            counts none of its messages, or does not count them; `total`: nor in the sum of all; `other`:
            all of it says that they are of /a.
        library: what the head says of who wrote the file.
    """
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(library=library)
        a, b = (writer.register_channel(name, "json", 0) for name in ("/a", "/b"))
        for n in range(5):
            writer.add_message(a, n, b"{}", n)
            writer.add_message(b, n, b"{}", n)
            behind = vars(writer)["_Writer__chunk_builder"].message_indices
            if "other" in lies:
                behind[a].records += behind[b].records
            if {"behind", "other"} & set(lies):
                behind.pop(b)
            writer._Writer__finalize_chunk()  # type: ignore[attr-defined]  # `flush` is younger
        if "chunks" in lies:
            for index in vars(writer)["_Writer__chunk_indices"]:
                index.message_index_offsets.pop(b)
        reported = vars(writer)["_Writer__statistics"]
        if "zero" in lies:
            reported.channel_message_counts[b] = 0
        if "out" in lies:
            reported.channel_message_counts.pop(b)
        if "other" in lies:
            reported.channel_message_counts.update({a: 10, b: 0})
        if "total" in lies:
            reported.message_count -= 5
        if library == "occlog test":
            add_metadata(writer, {METADATA: {"format": FORMAT, "provenance": Provenance("test").json()}})
        writer.finish()
    return path


WHOLE = [(), ("chunks",), ("zero",), ("out",), ("chunks", "zero"), ("chunks", "out"), ("behind",)]
LESS = [("zero", "total"), ("out", "total"), ("chunks", "zero", "total"), ("chunks", "out", "total")]


@pytest.mark.parametrize("lies", WHOLE)
def test_a_topic_that_the_index_leaves_out_is_read(tmp_path: Path, lies: tuple[str, ...]) -> None:
    recording = open_recording(lying(tmp_path / "r.mcap", *lies))
    assert [(t.name, t.messages) for t in recording.topics] == [("/a", 5), ("/b", 5)]
    with open_mcap(recording.path) as (reader, _):
        assert len(list(reader.iter_messages(["/b"]))) == 5
    assert [f.kind for f in check_files([recording.path]).findings] == (["no-index"] if lies else [])


@pytest.mark.parametrize("lies", LESS)
def test_an_index_that_counts_less_than_there_is_is_refused(tmp_path: Path, lies: tuple[str, ...]) -> None:
    path = lying(tmp_path / "r.mcap", *lies)
    with pytest.raises(InputError, match="its index reports 5 records of the kind message, and there are 10"):
        open_recording(path)
    assert run(["doctor", str(path)]) == ExitCode.BAD_INPUT


@pytest.mark.parametrize("lies", [*WHOLE, *LESS])
def test_the_topic_is_read_in_bags_of_others(tmp_path: Path, lies: tuple[str, ...]) -> None:
    with open_bag([lying(tmp_path / "b.mcap", *lies, library="other")]) as bag:
        assert {t.name: t.messages for t in bag.topics().values()} == {"/a": 5, "/b": 5}
        assert len(list(bag.messages({"/b"}))) == 5
        assert len(bag.losses) == (lies in LESS)


def test_an_index_that_counts_more_than_it_leads_to_is_reported(tmp_path: Path) -> None:
    path = lying(tmp_path / "r.mcap", "other")
    with open_bag([path]) as bag:
        assert len(list(bag.messages({"/a"}))) == 5
        assert [(loss.place, loss.count) for loss in bag.losses] == [("/a", 5)]
    assert run(["doctor", str(path)]) == ExitCode.BAD_INPUT


@pytest.mark.parametrize(
    ("library", "code"), [("occlog test", ExitCode.BAD_INPUT), ("other", ExitCode.LOSSY)], ids=["ours", "a bag"]
)
@pytest.mark.parametrize("lies", [("behind", "zero", "total"), ("behind", "out", "total")])
def test_doctor_tells_of_a_topic_that_is_left_out_everywhere(
    tmp_path: Path, library: str, code: ExitCode, lies: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    path = lying(tmp_path / "r.mcap", *lies, library=library)
    assert run(["doctor", str(path)]) == code
    assert "its index counts 0 messages of /b, and there are 5" in capsys.readouterr().out
