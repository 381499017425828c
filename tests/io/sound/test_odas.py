"""Streams of ODAS: hops, empty slots, tilted arrays, what is cut off, what is damaged."""

from __future__ import annotations

import json
import math
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode, InputError, UsageError
from occlog.io.formats.sound.csv_log import DoaOptions
from occlog.io.formats.sound.directions import read_doa
from occlog.io.formats.sound.formats import parse_hop
from occlog.io.recording.reader import open_recording
from occlog.records.losses import Loss
from occlog.records.scene import MicrophoneArray
from occlog.records.tables import Doa

EMPTY = '{ "id": 0, "tag": "", "x": 0.000, "y": 0.000, "z": 0.000, "activity": 0.000 }'


def hop(count: int, *sources: str) -> str:
    """One object as `snk_tracks.c` prints it."""
    slots = ",\n        ".join(sources or (EMPTY,))
    return f'{{\n    "timeStamp": {count},\n    "src": [\n        {slots}\n    ]\n}}\n'


def source(identity: int, x: float, y: float, z: float, activity: float = 0.5) -> str:
    return (
        f'{{ "id": {identity}, "tag": "dynamic", "x": {x:1.3f}, "y": {y:1.3f}, "z": {z:1.3f}, '
        f'"activity": {activity:1.3f} }}'
    )


def read(tmp_path: Path, text: str, array: MicrophoneArray | None = None, **options: object) -> tuple[Doa, list[Loss]]:
    path = tmp_path / "tracks.json"
    path.write_text(text)
    losses: list[Loss] = []
    array = array or MicrophoneArray("mic", np.zeros(3), yaw=math.radians(90))
    given = {"sensor": "mic", "hop": Fraction(128, 16000), **options}
    return Doa.concat(read_doa(path, [array], DoaOptions(**given), losses=losses)), losses  # type: ignore[arg-type]


def test_a_stream_gives_times_by_hops_and_azimuths_by_the_pose_of_the_array(tmp_path: Path) -> None:
    text = hop(1) + hop(2, source(7, 0.6, 0.8, 0.0), EMPTY) + hop(250, source(8, 0.0, -0.6, 0.8, 1.0))
    doa, losses = read(tmp_path, text, start_ns=10**18)
    assert (doa.t_ns - 10**18).tolist() == [16_000_000, 2_000_000_000]
    assert np.allclose(np.degrees(doa.azimuth), [math.degrees(math.atan2(0.8, 0.6)) + 90, 0.0])
    assert np.allclose(np.degrees(doa.elevation), [0.0, math.degrees(math.atan2(0.8, 0.6))])
    assert (doa.source_id.tolist(), doa.confidence.tolist(), losses) == ([7, 8], [0.5, 1.0], [])


def test_hops_on_one_line_each_are_read_as_well(tmp_path: Path) -> None:
    text = "".join(json.dumps(json.loads(hop(n, source(1, 1, 0, 0)))) + "\n" for n in range(1, 2001))
    doa, _ = read(tmp_path, text)
    assert doa.t_ns.tolist() == [8_000_000 * n for n in range(1, 2001)]


def test_found_sources_have_no_identity_and_their_energy_is_the_confidence(tmp_path: Path) -> None:
    text = '{"timeStamp": 3, "src": [{"x": -1, "y": 0, "z": 0, "E": 0.31}, {"x": 0, "y": 0, "z": 0, "E": 0}]}'
    doa, _ = read(tmp_path, text, MicrophoneArray("mic", np.zeros(3)))
    assert (doa.source_id.tolist(), doa.confidence.tolist(), doa.azimuth.tolist()) == ([-1], [0.31], [-math.pi])


def test_directions_of_a_tilted_array_are_turned_as_vectors(tmp_path: Path) -> None:
    # Its x axis points up, its z axis backwards: what is before it (+x) is above, what is above it (z) behind.
    array = MicrophoneArray("mic", np.zeros(3), pitch=math.radians(90))
    doa, _ = read(tmp_path, hop(1, source(1, 0.8, 0.0, 0.6)), array)
    assert np.allclose(np.degrees(doa.elevation), math.degrees(math.atan2(0.8, 0.6)))
    assert np.allclose(np.abs(np.degrees(doa.azimuth)), 180)


def test_an_object_that_the_end_cuts_off_is_a_loss(tmp_path: Path) -> None:
    text = hop(1, source(1, 1, 0, 0)) + hop(2, source(1, 1, 0, 0))[:-30]
    doa, losses = read(tmp_path, text)
    assert len(doa) == 1
    assert [(loss.place, loss.count) for loss in losses] == [("line 7", 1)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (hop(1, source(1, 1, 0, 0).replace("1.000", "nan", 1)), "line 1: not an object of ODAS"),
        ("{}", "line 1: timeStamp is None; a number of hops"),
        (hop(1) + '{"timeStamp": -1, "src": []}', "line 7: timeStamp is -1"),
        ('{"timeStamp": 1700000000000, "src": []}', "timeStamp is 1700000000000; a number of hops"),
        ('{"timeStamp": 1, "src": 4}', "src is not a list"),
        (hop(1, source(1, 0.5, 0.5, 0)), "of length 0.707; a unit vector was expected"),
        (hop(1, source(1, 1, 0, 0).replace('"x": 1.000', '"x": "a"')), "x of a source is 'a'"),
        (hop(5, source(1, 1, 0, 0)) + hop(4, source(1, 1, 0, 0)), "line 7: time of mic goes back"),
        (hop(1) + "}" + hop(2), "line 7: not an object of ODAS"),
    ],
)
def test_faults_are_named_by_their_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read(tmp_path, text)
    assert "tracks.json" in str(caught.value)


def test_the_hop_and_the_array_must_be_given(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"counts hops; state the hop"):
        read(tmp_path, hop(1), hop=None)
    with pytest.raises(UsageError, match=r"does not name its array"):
        read(tmp_path, hop(1), sensor=None)


def test_a_hop_is_a_number_or_a_quotient_above_0_and_at_most_1() -> None:
    assert parse_hop("0.008") == parse_hop("128/16000") == Fraction(1, 125)
    assert parse_hop("1") == 1
    for bad in ("0", "-1", "1.001", "1/0", "x"):
        with pytest.raises(UsageError, match="expected seconds above 0"):
            parse_hop(bad)


def test_ingest_takes_a_stream_and_says_what_the_end_cut_off(tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text(
        "occlog_scene: 1\nroom: [[0, 0], [4, 0], [4, 3], [0, 3]]\n"
        "microphone_arrays:\n- {name: mic, position: [2, 1, 1]}\n"
    )
    (tmp_path / "sst.json").write_text(hop(100, source(3, 0, 1, 0)) + hop(101)[:20])
    out = tmp_path / "out.mcap"
    scene, log = str(tmp_path / "scene.yaml"), f"mic={tmp_path / 'sst.json'}"
    code = run(["ingest", "-o", str(out), "--scene", scene, "--doa", log, "--odas-hop", "0.008", "-q"])
    assert code == ExitCode.LOSSY
    recording = open_recording(out)
    assert recording.read(Doa).t_ns.tolist() == [800_000_000]
    assert len(recording.losses) == 1


def test_a_log_of_two_runs_is_named_with_the_line_of_the_second(
    shared_cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = shared_cases / "c02_odas_two"
    words = ["--scene", str(case / "arr.yaml"), "--doa", f"table={case / 'odas_two.json'}", "--odas-hop", "128/16000"]
    assert run(["ingest", "-o", str(tmp_path / "x.mcap"), *words, "--start-time", "2024-05-01T12:00:00Z"]) == 4
    assert "line 2701: time of table goes back by 2.39 s; it starts again there" in capsys.readouterr().err


def test_idle_sources_and_those_straight_above_are_left_out_with_a_note(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Finding H5: a tracked source without activity is a prediction, and threw estimates out of the room."""
    heard, idle, above = source(3, 0, 1, 0), source(4, 1, 0, 0, 0.0), source(5, 0, 0, 1)
    table, _ = read(tmp_path, hop(1, heard, idle, above) + hop(2, idle))
    assert table.source_id.tolist() == [3]
    stderr = capsys.readouterr().err
    assert "note:" in stderr
    assert "2 directions without activity omitted" in stderr
    assert "1 directions straight up or down omitted" in stderr
    assert "warning" not in stderr


def test_a_stream_without_any_direction_is_a_warning(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "quiet.json"
    path.write_text("".join(hop(k) for k in range(5)))
    array = MicrophoneArray("mic", np.zeros(3))
    assert list(read_doa(path, [array], DoaOptions(sensor="mic", hop=Fraction(1, 125), start_ns=0))) == []
    assert "warning:" in (stderr := capsys.readouterr().err)
    assert "5 hops and no direction" in stderr


def test_a_list_of_json_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a list of JSON; write its objects one after another"):
        read(tmp_path, "[" + hop(1) + "," + hop(2) + "]")


def test_a_counter_of_32_bits_that_begins_again_at_0_goes_on(tmp_path: Path) -> None:
    text = "".join(hop(n % 2**32, source(1, 1, 0, 0)) for n in range(2**32 - 3, 2**32 + 3))
    doa, _ = read(tmp_path, text)
    assert doa.t_ns.tolist() == [8_000_000 * n for n in range(2**32 - 3, 2**32 + 3)]
    with pytest.raises(InputError, match="it starts again there"):
        read(tmp_path, hop(2**31, source(1, 1, 0, 0)) + hop(0, source(1, 1, 0, 0)))


def stream(*counts: int) -> str:
    return "".join(hop(n, source(1, 1, 0, 0)) for n in counts)


@pytest.mark.parametrize(
    ("counts", "message"),
    [
        # one count is off: no wrap-around, and no second run
        ([1, 2, 2**32 - 1, 3, 4], "line 13: timeStamp is 4294967295 between 2 and 3"),
        ([1, 2, 900, 3, 4], "line 13: timeStamp is 900 between 2 and 3"),
        ([700, 701, 0, 702], "line 13: timeStamp is 0 between 701 and 702"),
        ([2**32 - 1, 1, 2], "line 7: time of mic goes back by 3.44e.07 s; it starts again there"),
        ([1, 2, 2**32 - 2, 2**32 - 1, 5], "line 13: timeStamp jumps from 2 to 4294967294"),
        # a second run need not begin at 0
        ([*range(240, 600), *range(250, 260)], "line 2161: time of mic goes back by 2.79 s; it starts again there"),
        # seconds are no hops
        ([1, 1, 1, 1, 2, 2, 2, 2], "timeStamp repeats in 6 of 8 objects"),
    ],
)
def test_a_count_of_hops_that_is_none_is_refused_with_its_line(tmp_path: Path, counts: list[int], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read(tmp_path, stream(*counts))
    assert caught.value.id == "unsorted-times"


def test_counts_that_repeat_or_jump_are_named_with_line_and_size(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    doa, _ = read(tmp_path, hop(0) + stream(1, 2, 2, 3, 4_950_003))
    assert doa.t_ns[-1] == 4_950_003 * 8_000_000
    stderr = capsys.readouterr().err
    assert "warning:" in stderr
    assert "line 19: timeStamp repeats (1 in all)" in stderr
    assert "line 31: timeStamp jumps by 4950000 hops (39600 s)" in stderr


def test_pauses_of_a_log_of_heard_hops_alone_are_no_warning(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    read(tmp_path, stream(1, 2, 20_000, 20_001, 22_000))
    assert "warning" not in capsys.readouterr().err
