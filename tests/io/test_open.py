"""An input is known by its content; rows, scene, unit and losses come from the file that is opened."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from occlog.errors import InputError, UsageError
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.io.open import (
    Content,
    check_unit,
    content_of,
    input_losses,
    is_recording_name,
    open_if_ours,
    open_input,
    scene_in,
)
from occlog.io.recording.writer import RecordingWriter
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Doa, Hulls, Tracks, Truth, TruthBoxes

YAML = "occlog_scene: 1\ncameras: [{name: cam1, position: [0, 0, 3], yaw_deg: 10, focal_px: 500, fov_deg: 60}]\n"
FEET = YAML.replace("occlog_scene: 1\n", "occlog_scene: 1\nlength_unit: ft\n")
LOSSES = (Loss("cam1", "frame 7", "cut", 1), Loss("cam2", "frame 9", "cut", 1))
N = 40_000


def truth(rows: int = 3) -> Truth:
    """A target that stands still."""
    return Truth.of(
        t_ns=np.arange(rows) * 1_000_000,
        target_id=np.zeros(rows, np.int32),
        role=["target"] * rows,
        x=np.zeros(rows),
        y=np.ones(rows),
        z=np.full(rows, np.nan),
    )


def table(path: Path, rows: int = 3, losses: tuple[Loss, ...] = (), unit: str = "m") -> Path:
    plain = path.with_suffix(".parquet")
    write_table(plain, truth(rows), Provenance("test", losses=losses), length_unit=unit)
    return plain.rename(path)


def recording(path: Path, scene: Scene | None = None, losses: tuple[Loss, ...] = (), rows: int = 3) -> Path:
    made = path.with_name("made.mcap")
    with RecordingWriter(made, scene, Provenance("test", losses=losses)) as writer:
        if rows:
            writer.table(truth(rows))
    return made.rename(path)


@pytest.mark.parametrize("name", ["x.parquet", "x.mcap", "x.csv", "x"])
def test_a_table_opens_under_any_name(tmp_path: Path, name: str) -> None:
    opened = open_input(table(tmp_path / name), Truth)
    assert opened.recording is None
    assert len(opened.read(Truth)) == 3


@pytest.mark.parametrize("name", ["x.parquet", "x.mcap", "x.yaml", "x"])
def test_a_recording_opens_under_any_name(tmp_path: Path, name: str) -> None:
    opened = open_input(recording(tmp_path / name), Truth)
    assert opened.recording is not None
    assert len(opened.read(Truth)) == 3


def test_content_of_other_files(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(YAML)
    assert content_of(scene) is Content.OTHER
    assert open_if_ours(scene) is None
    short = tmp_path / "short"
    short.write_bytes(b"PAR")
    assert content_of(short) is Content.OTHER


def test_rows_stream_in_chunks(tmp_path: Path) -> None:
    for path in (table(tmp_path / "t.parquet", 2 * N), recording(tmp_path / "r.mcap", rows=N)):
        chunks = [len(chunk) for chunk in open_input(path).rows(Truth)]
        assert len(chunks) > 1
        assert sum(chunks) in (N, 2 * N)


def test_rows_stream_in_chunks_as_large_as_asked_for(tmp_path: Path) -> None:
    opened = open_input(table(tmp_path / "t.parquet", rows=10))
    chunks = list(opened.rows(Truth, at_once=4))
    assert max(map(len, chunks)) == 4
    assert np.concatenate([chunk.t_ns for chunk in chunks]).tolist() == truth(10).t_ns.tolist()


def test_the_unit_is_that_of_the_table_or_of_the_recordings_scene(tmp_path: Path) -> None:
    assert open_input(table(tmp_path / "t.parquet", unit="ft")).length_unit == "ft"
    feet = recording(tmp_path / "feet.mcap", scene_from_yaml(FEET, "scene"))
    assert open_input(feet).length_unit == "ft"
    assert open_input(recording(tmp_path / "bare.mcap")).length_unit is None


def test_another_unit_is_refused_and_an_unknown_one_passes(tmp_path: Path) -> None:
    opened = open_input(table(tmp_path / "t.parquet", unit="ft"))
    check_unit(opened, "ft")
    with pytest.raises(UsageError, match=r"t.parquet: lengths are in ft, but in m in the scene"):
        check_unit(opened, "m")
    with pytest.raises(InputError, match=r"but in m in other.parquet"):
        check_unit(opened, "m", "other.parquet", InputError)
    check_unit(open_input(recording(tmp_path / "bare.mcap")), "in")


def test_only_a_table_with_inputs_was_made_in_a_scene(tmp_path: Path) -> None:
    assert not open_input(table(tmp_path / "t.parquet")).made_in_a_scene
    path = tmp_path / "made.parquet"
    write_table(path, truth(), Provenance("test", inputs=(("scene.yaml", "00"),)))
    assert open_input(path).made_in_a_scene


def test_losses_of_several_inputs_count_once_in_their_order(tmp_path: Path) -> None:
    one = open_input(table(tmp_path / "a.parquet", losses=LOSSES[1:]))
    both = open_input(recording(tmp_path / "b.mcap", losses=LOSSES))
    assert input_losses([one, None, both]) == (LOSSES[1], LOSSES[0])
    assert input_losses([]) == ()


def test_what_is_missing_is_named_with_its_remedy(tmp_path: Path) -> None:
    bare = recording(tmp_path / "bare.mcap", rows=0)
    with pytest.raises(InputError, match=r"bare.mcap: holds no tracks; give a recording or a table that has them"):
        open_input(bare, Tracks)
    with pytest.raises(InputError, match=r"holds no bearings and no directions of arrival; detect"):
        open_input(bare, Bearings, Doa, remedy="detect")
    with pytest.raises(InputError, match="holds no true boxes"):
        open_input(bare).read(TruthBoxes)


def test_a_table_of_another_kind_names_what_it_holds(tmp_path: Path) -> None:
    path = table(tmp_path / "t.parquet")
    for wants, reported in (
        ((Tracks,), "expected tracks$"),
        ((Tracks, Hulls), "expected tracks or hulls$"),
        ((Tracks, Hulls, Doa), "expected tracks, hulls or doa$"),
    ):
        with pytest.raises(InputError, match=r"t.parquet: holds truth; " + reported):
            open_input(path, *wants)


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("none.parquet", None, "no such file; a recording or a table was expected"),
        ("empty.mcap", b"", "is empty"),
        ("text.parquet", b"neither of them\n", "not a Parquet file"),
        ("cut.parquet", b"PAR1x", "not a Parquet file"),
        ("text.mcap", b"neither of them\n", "MCAP"),
        ("cut.mcap", b"\x89MCAP0\r\nx", "MCAP"),
    ],
)
def test_a_damaged_file_is_explained_by_the_reader_of_its_kind(
    tmp_path: Path, name: str, content: bytes | None, expected: str
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=expected):
        open_input(path)


@pytest.mark.parametrize("name", ["scene.yaml", "scene.mcap", "scene"])
def test_a_scene_is_read_from_yaml_or_from_a_recording_under_any_name(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_text(FEET)
    found = scene_in(path)
    assert found is not None
    assert found.length_unit == "ft"
    again = scene_in(recording(tmp_path / f"recording.{name}", found))
    assert again is not None
    assert again.length_unit == "ft"
    assert scene_in(recording(tmp_path / "bare.yaml")) is None


def test_a_table_of_measurements_is_no_scene(tmp_path: Path) -> None:
    (tmp_path / "boxes.csv").write_text("frame,left,top,width,height\n0,1,2,3,4\n")
    with pytest.raises(InputError, match=r"boxes.csv: is a table \(frame, left, top, width, \.\.\.\), not a scene"):
        scene_in(tmp_path / "boxes.csv")


def test_the_name_of_an_output_says_whether_it_is_a_recording() -> None:
    assert is_recording_name(Path("a/b.MCAP"))
    assert not is_recording_name(Path("b.mcap.json"))
