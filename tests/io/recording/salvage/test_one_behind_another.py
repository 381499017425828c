"""Recordings that stand in a file one behind another, and damage that resembles an end or like another record."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import IndexType, Writer

from occlog.cli.main import run
from occlog.errors import ExitCode, InputError
from occlog.io.files.provenance import Provenance
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.io.messages.mcap_file import McapFile
from occlog.io.recording.mcap_errors import open_mcap
from occlog.io.recording.salvage.ends import SalvagedRecording
from occlog.io.recording.salvage.recover import Recovered, recover_recording
from occlog.io.recording.writer import RecordingWriter
from occlog.records.losses import Loss
from occlog.records.scene import Scene

CAMERAS = "occlog_scene: 1\ncameras:\n" + "".join(
    f"  - {{name: {name}, position: [0, 0], yaw_deg: 45, focal_px: 70, fov_deg: 90}}\n" for name in "ab"
)
SCENE = scene_from_yaml(CAMERAS, "scene")
OTHER = replace(SCENE, cameras=SCENE.cameras[::-1])
FRAMES, STEP_NS = 20, 100_000_000
Message = tuple[str, int, bytes]


def recording(path: Path, *, scene: Scene = SCENE, seed: int = 0, step: int = 1, start_ns: int = 0) -> bytes:
    """Frames of 200 kB of two cameras, in the order of the scene: four chunks and a piece."""
    rng = np.random.default_rng(seed)
    with RecordingWriter(
        path, scene, Provenance("ingest", {}, None, (), (Loss("a", f"seed {seed}", "cut", 1),))
    ) as out:
        for n in range(FRAMES):
            for camera in scene.cameras:
                out.image(camera.name, start_ns + n * STEP_NS, n * step, rng.bytes(100_000), "png")
    return path.read_bytes()


def messages(path: Path) -> list[Message]:
    with path.open("rb") as file:
        return [(c.topic, m.sequence, m.data) for _, c, m in make_reader(file).iter_messages(log_time_order=False)]


def places(data: bytes, code: int) -> list[int]:
    """Where records of a kind begin."""
    at, found = 8, []
    while at < len(data) - 8:
        kind, length = struct.unpack_from("<BQ", data, at)
        found += [at] if kind == code else []
        at += 9 + length
    return found


def recovered(tmp_path: Path, data: bytes) -> tuple[list[Message], Recovered]:
    (tmp_path / "bad.mcap").write_bytes(data)
    found = recover_recording(tmp_path / "bad.mcap", tmp_path / "good.mcap", overwrite=True)
    return messages(tmp_path / "good.mcap"), found


def counted(found: Recovered) -> dict[tuple[str, str], int]:
    """How many messages are lost, by camera and time."""
    return {(loss.source, loss.place): loss.count for loss in found.losses if "messages of /camera" in loss.what}


@pytest.mark.parametrize("cut", [None, 2_600_000])
def test_a_second_recording_of_the_same_scene_is_taken_too(cut: int | None, tmp_path: Path) -> None:
    first, second = recording(tmp_path / "1.mcap"), recording(tmp_path / "2.mcap", seed=1, start_ns=10**10)
    ours, theirs = messages(tmp_path / "1.mcap"), messages(tmp_path / "2.mcap")
    got, found = recovered(tmp_path, first[:cut] + second)
    kept = len(got) - len(theirs)
    assert got == ours[:kept] + theirs
    assert kept == len(ours) if cut is None else 20 < kept < len(ours)
    assert any(loss.place == f"from byte {len(first[:cut])} on" for loss in found.losses)
    assert Loss("a", "seed 1", "cut", 1) in found.losses
    # The end of the first one, which says what was lost, went with the cut
    assert (Loss("a", "seed 0", "cut", 1) in found.losses) == (cut is None)


@pytest.mark.parametrize("cut", [None, 2_600_000])
def test_a_second_recording_of_another_scene_is_left_out_and_counted(cut: int | None, tmp_path: Path) -> None:
    first, second = recording(tmp_path / "1.mcap"), recording(tmp_path / "2.mcap", scene=OTHER, seed=1)
    got, found = recovered(tmp_path, first[:cut] + second)
    assert got == messages(tmp_path / "1.mcap")[: len(got)]
    (left,) = [loss.count for loss in found.losses if "which has another scene or none, are skipped" in loss.what]
    assert left == 2 * FRAMES


def test_a_second_recording_without_its_beginning_is_reported_by_its_definitions(tmp_path: Path) -> None:
    first, second = recording(tmp_path / "1.mcap"), recording(tmp_path / "2.mcap", scene=OTHER, seed=1)
    cut, begin = places(first, 6)[2], places(second, 6)[0]
    data = first[:cut] + second[begin:]
    got, found = recovered(tmp_path, data)
    assert got == messages(tmp_path / "1.mcap")[: len(got)]
    assert sum(loss.count for loss in found.losses if "messages of another recording" in loss.what) == 2 * FRAMES
    bag = McapFile(tmp_path / "bad.mcap", "bad")
    taken = [message.data for message in bag.messages({"/camera/a/image"})]
    assert taken == [data for topic, _, data in got if topic == "/camera/a/image"]
    what = f"channel 1 is defined a second time, and otherwise; {len(data) - cut} bytes from there on were not read"
    assert Loss("bad", f"byte {cut}", what) in bag.losses


def test_bytes_behind_the_end_are_counted(tmp_path: Path) -> None:
    data = recording(tmp_path / "1.mcap")
    got, found = recovered(tmp_path, data + bytes(1234))
    assert got == messages(tmp_path / "1.mcap")
    lost = Loss("bad.mcap", f"byte {len(data)}", "1234 bytes behind the end mark are no records, and are skipped")
    assert lost in found.losses


def test_doctor_and_recover_tell_of_a_second_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = recording(tmp_path / "1.mcap")
    (tmp_path / "two.mcap").write_bytes(data + data)
    assert run(["doctor", str(tmp_path / "two.mcap")]) != ExitCode.DONE
    assert f"byte {len(data)}: the recording is damaged: another recording begins here" in capsys.readouterr().out
    assert run(["recover", str(tmp_path / "two.mcap"), "-o", str(tmp_path / "out.mcap")]) == ExitCode.LOSSY


@pytest.mark.parametrize(("code", "changed"), [(6, 2), (6, 4), (6, 0x46), (7, 15), (7, 6), (7, 5), (7, 3)])
@pytest.mark.parametrize("whole", [True, False])
def test_a_flipped_bit_of_a_kind_costs_nothing(code: int, changed: int, whole: bool, tmp_path: Path) -> None:
    data = bytearray(recording(tmp_path / "1.mcap"))
    chunk = places(data, 6)[-1]
    place = places(data, code)[2]
    data[place] = changed
    got, found = recovered(tmp_path, bytes(data if whole else data[:chunk]))
    ours = messages(tmp_path / "1.mcap")
    assert got == ours[: len(got)]
    assert len(got) == len(ours) or (not whole and len(got) > 25)
    assert any(
        loss.place == f"byte {place}"
        and loss.what == f"the kind of a record is damaged ({changed}, which must be {code})"
        for loss in found.losses
    )
    assert not any(counted(found).values())


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("chunk", [0, 1])
def test_frames_are_counted_and_dated_though_their_numbers_rise_by_five(
    chunk: int, whole: bool, tmp_path: Path
) -> None:
    data = bytearray(recording(tmp_path / "1.mcap", step=5))
    begin, last = places(data, 6)[chunk], places(data, 6)[-1]
    data[begin + 500] ^= 1
    if not whole and chunk == 0:
        pytest.skip("what the topics are is lost with the first chunk")
    got, found = recovered(tmp_path, bytes(data if whole else data[:last]))
    gone = [m for m in messages(tmp_path / "1.mcap") if m not in got and (whole or m[1] < 5 * 15)]
    reported = {key: count for key, count in counted(found).items() if count}
    assert sum(reported.values()) == len(gone) > 5
    for (camera, place), count in reported.items():
        numbers = [number // 5 for topic, number, _ in gone if topic == f"/camera/{camera}/image"]
        after = f"1970-01-01T00:00:0{(numbers[-1] + 1) / 10:.3f}Z"
        before = f"1970-01-01T00:00:0{(numbers[0] - 1) / 10:.3f}Z to " if chunk else "before "
        assert (place, count) == (before + after, len(numbers))


def test_files_that_follow_one_without_an_index_are_refused(tmp_path: Path) -> None:
    path, bare = tmp_path / "two.mcap", tmp_path / "bare.mcap"
    with bare.open("wb") as file:
        writer = Writer(file, index_types=IndexType.NONE, use_statistics=False, use_summary_offsets=False)
        writer.start()
        writer.add_message(writer.register_channel("/x", "json", 0), 1, b"{}", 1)
        writer.finish()
    path.write_bytes(bare.read_bytes() * 2)
    with pytest.raises(InputError), open_mcap(path):
        pass


def test_a_bag_behind_another_one_is_reported(tmp_path: Path) -> None:
    data = recording(tmp_path / "1.mcap")
    (tmp_path / "two.mcap").write_bytes(data + data)
    bag = McapFile(tmp_path / "two.mcap", "two")
    assert len(list(bag.messages({"/camera/a/image"}))) == FRAMES
    left = f"{len(data)} bytes behind the end mark were not read; split the file there if they are a bag"
    assert Loss("two", f"byte {len(data)}", left) in bag.losses


def test_a_chunk_of_a_bag_that_looks_like_an_end_is_one_loss(tmp_path: Path) -> None:
    data = bytearray(recording(tmp_path / "1.mcap"))
    place = places(data, 6)[1]
    data[place] = 2
    (tmp_path / "bad.mcap").write_bytes(data)
    bag = McapFile(tmp_path / "bad.mcap", "bad")
    found = len(list(bag.messages({"/camera/a/image"})))
    assert FRAMES - 6 <= found < FRAMES
    assert [loss.place for loss in bag.losses] == [f"byte {place}"]


def test_a_recording_that_stands_there_twice_counts_once(tmp_path: Path) -> None:
    """What came back had each message twice, so that no command read it."""
    data = recording(tmp_path / "a.mcap")
    found, output = recovered(tmp_path, data + data)
    assert found == messages(tmp_path / "a.mcap")
    assert [loss.what for loss in output.losses if loss.place == "copies"] == [
        "20 messages that are stored in the file twice, and count once"
    ] * 2
    assert not any("skipped" in loss.what for loss in output.losses)


@pytest.mark.parametrize("cut", [None, 2_600_000])
def test_a_copy_that_follows_leaves_nothing_out(cut: int | None, tmp_path: Path) -> None:
    """A copy that was cut, and then one that is not: messages that are there were listed as left out, and as lost."""
    data = recording(tmp_path / "a.mcap")
    found, output = recovered(tmp_path, data[:cut] + data)
    assert found == messages(tmp_path / "a.mcap")
    assert any("stored in the file twice, and count once" in loss.what for loss in output.losses)
    assert not any("skipped" in loss.what for loss in output.losses)
    assert not any(counted(output).values())


def test_another_recording_of_the_same_times_is_left_out(tmp_path: Path) -> None:
    """Two trials in one scene became one, in which everybody was twice."""
    data, other = recording(tmp_path / "a.mcap"), recording(tmp_path / "b.mcap", seed=1, start_ns=STEP_NS * FRAMES // 2)
    found, output = recovered(tmp_path, data + other)
    assert found[:40] == messages(tmp_path / "a.mcap")
    assert found[40:] == messages(tmp_path / "b.mcap")[20:]
    assert any("not later than those before it are skipped" in loss.what and loss.count == 20 for loss in output.losses)


def test_chunks_that_stand_there_twice_count_once_and_exchanged_ones_are_taken(tmp_path: Path) -> None:
    data = recording(tmp_path / "a.mcap")
    first, second, third = (places(data, 6)[n] for n in range(3))
    found, output = recovered(tmp_path, data[:second] + data[first:])
    assert found == messages(tmp_path / "a.mcap")
    assert any("messages that are stored in the file twice, and count once" in loss.what for loss in output.losses)
    found, output = recovered(tmp_path, data[:first] + data[second:third] + data[first:second] + data[third:])
    assert sorted(found) == sorted(messages(tmp_path / "a.mcap"))
    assert not any("twice" in loss.what for loss in output.losses)


def test_a_scene_whose_check_sum_is_wiped_is_not_taken(tmp_path: Path) -> None:
    """It was, with whatever else had been wiped of it."""
    data = bytearray(recording(tmp_path / "a.mcap"))
    (at,) = places(bytes(data), 9)
    (length,) = struct.unpack_from("<Q", data, at + 1)
    end = at + 9 + length
    data[end - 20 : end] = bytes(20)
    _, output = recovered(tmp_path, bytes(data))
    assert any("attached file with a wrong check sum" in loss.what for loss in output.losses)
    assert any(loss.place == "scene.yaml" for loss in output.losses)


def test_messages_without_numbers_are_copies_if_their_bytes_are_the_same() -> None:
    """MCAP has 0 for none: several of one time that say different things are no copies of each other."""
    part = SalvagedRecording(0)
    reported = [
        (5, b"a", False),
        (5, b"b", False),
        (5, b"a", True),
        (6, b"a", False),
        (5, b"b", True),
        (6, b"c", False),
    ]
    assert [part.is_copy("t", 0, t_ns, data) for t_ns, data, _ in reported] == [copy for *_, copy in reported]
    assert part.copies == {"t": 2}
    assert [part.is_copy("n", number, 5 + number, b"") for number in (0, 1, 2, 0, 1, 3)] == [False] * 3 + [True] * 2 + [
        False
    ]
