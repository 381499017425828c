"""What is whole in a cut or damaged recording comes back, and nothing else does."""

from __future__ import annotations

import json
import zlib
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from random_tables import random_table

from occlog.cli.main import run
from occlog.errors import ExitCode, InputError
from occlog.io.files.provenance import Provenance, hash_file
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.io.recording.reader import open_recording
from occlog.io.recording.salvage.recover import recover_recording
from occlog.io.recording.writer import RecordingWriter
from occlog.records.losses import Loss
from occlog.records.tables import Bearings

SCENE = scene_from_yaml(
    """
occlog_scene: 1
cameras:
  - {name: a, position: [0, 0], yaw_deg: 45, focal_px: 70, fov_deg: 90}
""",
    "scene",
)
PROVENANCE = Provenance("ingest", {"fps": 10}, None, (), (Loss("a", "frame 7", "cut", 1),))
T0, STEP, FRAMES = 1_700_000_000_000_000_000, 100_000_000, 40
Message = tuple[str, int, int, bytes]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Forty frames of 100 kB that no method makes smaller, and bearings between them: four chunks and a piece."""
    path = tmp_path_factory.mktemp("whole") / "hall.mcap"
    rng = np.random.default_rng(0)
    nothing = np.array([np.nan])
    with RecordingWriter(path, SCENE, PROVENANCE) as writer:
        for n in range(FRAMES):
            writer.image("a", T0 + n * STEP, n, rng.bytes(100_000), "png")
            row = Bearings.of(
                t_ns=np.array([T0 + n * STEP]), sensor=["a"], target_id=[0], seen=[False], bearing=nothing,
                sigma=nothing, u_px=nothing, sigma_px=nothing, score=nothing,
            )  # fmt: skip
            writer.table(row)
    return path


def messages(path: Path) -> list[Message]:
    with path.open("rb") as file:
        found = make_reader(file).iter_messages(log_time_order=False)
        return [(c.topic, m.sequence, m.log_time, m.data) for _, c, m in found]


def chunks(path: Path) -> list[tuple[int, int]]:
    """Where each chunk begins and ends."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        return [(c.chunk_start_offset, c.chunk_start_offset + c.chunk_length) for c in summary.chunk_indexes]


def test_what_is_not_damaged_is_the_same(whole: Path, tmp_path: Path) -> None:
    found = recover_recording(whole, tmp_path / "out.mcap")
    assert messages(tmp_path / "out.mcap") == messages(whole)
    assert found.losses == PROVENANCE.losses
    assert found.messages == {"/camera/a/image": FRAMES, "/bearings/a": FRAMES}
    assert found.span == (T0, T0 + (FRAMES - 1) * STEP)
    again = open_recording(tmp_path / "out.mcap")
    assert again.provenance.inputs == (("hall.mcap", hash_file(whole)),)
    assert again.scene is not None
    assert [c.name for c in again.scene.cameras] == ["a"]


def test_every_complete_message_before_a_cut_comes_back(whole: Path, tmp_path: Path) -> None:
    data, all_of_it, places = whole.read_bytes(), messages(whole), chunks(whole)
    cut, out = tmp_path / "hall.mcap", tmp_path / "out.mcap"
    # The frames cannot be compressed, so that the bytes of a cut chunk are those of its messages, nearly
    size = (places[0][1] - places[0][0]) / 10.5
    for place in np.random.default_rng(1).integers(places[0][1], len(data) - 8, 12):
        cut.write_bytes(data[:place])
        found = recover_recording(cut, out, overwrite=True)
        got = messages(out)
        assert got == all_of_it[: len(got)]
        before = [end for _, end in places if end <= place]
        begun = next((begin for begin, end in places if begin <= place < end), place)
        complete = 21 * len(before) + 2 * int(max(place - begun - 140_000, 0) / size)  # blocks of zstd have 128 kB
        assert len(got) >= min(complete, len(all_of_it))
        if len(got) < len(all_of_it):
            assert any("the file is cut" in str(loss) for loss in found.losses)
            last = max(n for topic, n, _, _ in got if topic == "/camera/a/image")
            place = f"after 2023-11-14T22:13:2{last // 10}.{last % 10}00Z"
            assert Loss("a", place, "messages of /camera/a/image, if there were more") in found.losses
        assert open_recording(out).losses == found.losses


def test_flipped_bits_are_never_taken_for_data(whole: Path, tmp_path: Path) -> None:
    data, all_of_it, places = whole.read_bytes(), messages(whole), chunks(whole)
    damaged, out = tmp_path / "hall.mcap", tmp_path / "out.mcap"
    rng = np.random.default_rng(2)
    for place in rng.integers(places[0][0], places[-1][1], 12):
        flipped = bytearray(data)
        flipped[place] ^= 1 << int(rng.integers(8))
        damaged.write_bytes(flipped)
        found = recover_recording(damaged, out, overwrite=True)
        got = messages(out)
        assert [m for m in all_of_it if m in got] == got
        own = [loss for loss in found.losses if loss not in PROVENANCE.losses]
        assert sum(loss.count for loss in own) == len(all_of_it) - len(got)


@pytest.mark.parametrize("index", [True, False])
def test_lost_frames_are_counted_and_dated(whole: Path, tmp_path: Path, index: bool) -> None:
    data, places = bytearray(whole.read_bytes()), chunks(whole)
    data[places[1][0] + 500] ^= 1
    damaged = tmp_path / "hall.mcap"
    damaged.write_bytes(data if index else data[: places[-1][1]])
    found = recover_recording(damaged, tmp_path / "out.mcap")
    kept = {number for topic, number, _, _ in messages(tmp_path / "out.mcap") if topic == "/camera/a/image"}
    gone = sorted(set(range(FRAMES)) - kept)
    assert gone == list(range(gone[0], gone[-1] + 1))
    last, after = (f"2023-11-14T22:13:2{n // 10}.{n % 10}00Z" for n in (gone[0] - 1, gone[-1] + 1))
    frames = Loss("a", f"{last} to {after}", "messages of /camera/a/image in damaged parts", len(gone))
    assert frames in found.losses
    assert any(loss.source == "/bearings/a" and loss.count in (10, 11) for loss in found.losses)


@pytest.mark.parametrize(
    ("of", "byte"),
    [*((of, byte) for of in ("chunk", "index", "attachment", "header") for byte in (0, 7)), ("chunk", 2), ("index", 3)],
)
def test_a_damaged_length_costs_nothing(whole: Path, tmp_path: Path, of: str, byte: int) -> None:
    """A length of an index or of the header that had become larger, or smaller, cost the chunks behind it."""
    data, (begin, end) = bytearray(whole.read_bytes()), chunks(whole)[0]
    place = {"chunk": begin, "index": end, "attachment": data.index(b"scene.yaml") - 29, "header": 8}[of]
    data[place + 1 + byte] ^= 0x14
    damaged = tmp_path / "hall.mcap"
    damaged.write_bytes(data)
    found = recover_recording(damaged, tmp_path / "out.mcap")
    assert messages(tmp_path / "out.mcap") == messages(whole)
    assert open_recording(tmp_path / "out.mcap").scene is not None
    (loss,) = (loss for loss in found.losses if loss not in PROVENANCE.losses)
    assert (loss.place, loss.count) == (f"byte {place}", 0)
    assert "the length of a record is damaged" in loss.what


def test_a_record_whose_length_nothing_tells_costs_one_chunk(whole: Path, tmp_path: Path) -> None:
    data, places = bytearray(whole.read_bytes()), chunks(whole)
    begin = places[1][0]
    data[begin + 4] = data[begin + 9 + 28] = 0xFF
    damaged = tmp_path / "hall.mcap"
    damaged.write_bytes(data)
    found = recover_recording(damaged, tmp_path / "out.mcap")
    assert "records are damaged: read on at the next chunk" in str(found.losses)
    first = [m for m in messages(whole) if m[2] > T0 + 22 * STEP]
    assert messages(tmp_path / "out.mcap")[-len(first) :] == first


def test_a_lost_link_to_a_video_is_asked_for(tmp_path: Path) -> None:
    (tmp_path / "a.avi").write_bytes(b"frames")
    path, cut, out = tmp_path / "r.mcap", tmp_path / "cut.mcap", tmp_path / "out" / "new.mcap"
    out.parent.mkdir()
    with RecordingWriter(path, SCENE, PROVENANCE) as writer:
        writer.video("a", "a.avi", hash_file(tmp_path / "a.avi"))
        for n in range(15):
            writer.video_frame("a", T0 + n, n)
            writer.image("b", T0 + n, n, np.random.default_rng(n).bytes(100_000), "png")
    recover_recording(path, out)
    assert open_recording(out).videos["a"] == {"path": "../a.avi", "sha256": hash_file(tmp_path / "a.avi")}
    cut.write_bytes(path.read_bytes()[: chunks(path)[0][1]])
    with pytest.raises(InputError, match=r"cut.mcap: camera a: the link to its video is lost; .* --video a=FILE"):
        recover_recording(cut, tmp_path / "x.mcap")
    assert not (tmp_path / "x.mcap").exists()
    found = recover_recording(cut, out, {"a": tmp_path / "a.avi"}, overwrite=True)
    assert open_recording(out).videos["a"]["path"] == "../a.avi"
    assert any("how it was made, and the losses then, is not known" in loss.what for loss in found.losses)


def test_what_is_none_of_ours_or_nothing_is_refused(tmp_path: Path) -> None:
    bag = tmp_path / "bag.mcap"
    with bag.open("wb") as file:
        writer = Writer(file, compression=CompressionType.LZ4)
        writer.start()
        channel = writer.register_channel("/x", "json", writer.register_schema("s", "jsonschema", b"{}"))
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(InputError, match=r"no occlog recording.*`occlog ingest` takes the intact messages"):
        recover_recording(bag, tmp_path / "x.mcap")
    (tmp_path / "table.csv").write_text("a,b\n")
    with pytest.raises(InputError, match="does not begin with the MCAP mark"):
        recover_recording(tmp_path / "table.csv", tmp_path / "x.mcap")
    (tmp_path / "cut.parquet").write_bytes(b"PAR1\x15\x04")
    with pytest.raises(InputError, match=r"is a table \(Parquet\); .*: make it again"):
        recover_recording(tmp_path / "cut.parquet", tmp_path / "x.mcap")
    assert not (tmp_path / "x.mcap").exists()


def test_a_chunk_may_not_unpack_to_more_than_it_says(whole: Path, tmp_path: Path) -> None:
    """A check sum over the declared part alone does not make a bomb good."""
    data, (begin, _) = bytearray(whole.read_bytes()), chunks(whole)[0]
    at = begin + 9 + 16  # the declared size
    declared = int.from_bytes(data[at : at + 8], "little")
    data[at : at + 8] = (declared // 2).to_bytes(8, "little")
    data[at + 8 : at + 12] = (zlib.crc32(b"") + 1).to_bytes(4, "little")
    damaged = tmp_path / "hall.mcap"
    damaged.write_bytes(data)
    found = recover_recording(damaged, tmp_path / "out.mcap")
    assert "wrong check sum" in str(found.losses)


def test_the_command_lists_losses_and_later_stages_carry_them(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut, out = tmp_path / "hall.mcap", tmp_path / "out.mcap"
    cut.write_bytes(whole.read_bytes()[: chunks(whole)[1][1]])
    assert run(["info", str(cut)]) == ExitCode.BAD_INPUT
    assert f"salvage it: `occlog recover {cut} -o OUT.mcap`" in capsys.readouterr().err
    assert run(["recover", str(cut), "-o", str(out), "--json"]) == ExitCode.LOSSY
    captured = capsys.readouterr()
    assert json.loads(captured.out)["messages"] == len(messages(out)) > 40
    assert "lost: hall.mcap: byte" in captured.err
    assert run(["info", str(out), "--json"]) == ExitCode.DONE
    assert "the file is cut" in capsys.readouterr().out
    assert run(["recover", str(cut), "-o", str(out)]) == ExitCode.EXISTS
    assert run(["recover", str(cut), "-o", str(cut), "--overwrite"]) == ExitCode.USAGE
    assert run(["recover", str(cut), "-o", str(tmp_path / "y.mcap"), "--video", "a"]) == ExitCode.USAGE


def test_a_table_is_made_again_by_its_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "b.parquet", tmp_path / "out.parquet"
    write_table(path, random_table(Bearings, 20), Provenance("detect", {}, 1, (("hall.mcap", "00"),)))
    whole = path.read_bytes()
    for data, words in (
        (whole, f"{path}: is a table (bearings); tables are not salvaged: make it again by `occlog detect` from hall"),
        (whole[:-20], f"{path}: damaged or not a Parquet file"),
    ):
        path.write_bytes(data)
        assert run(["recover", str(path), "-o", str(out)]) == ExitCode.BAD_INPUT
        stderr = capsys.readouterr().err
        assert words in stderr
        assert stderr.count("\n") == 1
        assert not out.exists()
