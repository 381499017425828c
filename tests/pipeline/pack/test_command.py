"""`occlog pack` and `occlog verify`: a run is made again to the same bytes, and what differs is named."""

from __future__ import annotations

import json
import os
import shutil
import zipfile
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

import msgspec
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.atomic import write_bytes
from occlog.io.files.provenance import Provenance, installed_versions, processor_type
from occlog.io.recording.writer import RecordingWriter
from occlog.pipeline.pack.archive import INPUTS, LOCK, MANIFEST, OUTPUTS, Manifest, lock_text
from occlog.pipeline.run.stage import RunStage

CONFIG = """
occlog_run: 1
seed: 3
recording: ../recordings/room.mcap
track: {particles: 20}
"""
VALUES = {"rmse_m": 1.0}
"""What the evaluation of the stages below comes to."""


def write_outputs(stage: RunStage) -> int:
    """A stage that is done at once; what the real ones make is tried in test_made_again."""
    if stage.name == "ingest":
        (output,) = stage.output_paths
        link = os.path.relpath(Path("../recordings/cam1.avi"), Path(output).parent)
        with RecordingWriter(Path(output), None, Provenance("ingest")) as writer:
            writer.video_frame("cam1", 40_000_000, 0)
            writer.video("cam1", link, "ab" * 32)
        return 0
    for number, name in enumerate(stage.output_paths):
        made = dict(VALUES) if name.endswith(".json") else {"stage": stage.name, "output": number}
        Path(name).write_text(json.dumps(made))
    return 0


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with a run, its archive, the same again, and one without inputs."""
    folder = tmp_path_factory.mktemp("packed")
    (folder / "recordings").mkdir()
    (folder / "study").mkdir()
    with RecordingWriter(folder / "recordings" / "room.mcap", None, Provenance("simulate")) as writer:
        writer.video_frame("cam1", 40_000_000, 0)
        writer.video("cam1", "cam1.avi", "ab" * 32)
    (folder / "recordings" / "cam1.avi").write_bytes(b"frames")
    (folder / "study" / "run.yaml").write_text(CONFIG)
    config = str(folder / "study" / "run.yaml")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("occlog.pipeline.run.run._do", write_outputs)
        assert run(["run", config, "-o", str(folder / "out"), "-q"]) == ExitCode.DONE
        for name, more in (("x.zip", []), ("again.zip", []), ("bare.zip", ["--reference"])):
            args = ["pack", str(folder / "out"), "--config", config, "-o", str(folder / name), *more]
            assert run(args) == ExitCode.DONE
        yield folder


def verify(path: Path, capsys: pytest.CaptureFixture[str], *args: str) -> tuple[int, dict[str, object]]:
    capsys.readouterr()
    code = run(["verify", str(path), "--json", "-q", *args])
    out, error = capsys.readouterr()
    return code, json.loads(out or error.splitlines()[-1])


def changed(source: Path, target: Path, **changes: object) -> Path:
    """An archive with other entries in its manifest."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        content = json.dumps({**json.loads(old.read(MANIFEST)), **changes}).encode()
        others = {MANIFEST: content, LOCK: lock_text(msgspec.json.decode(content, type=Manifest))}
        for name in old.namelist():
            new.writestr(name, others.get(name) or old.read(name))
    return target


def test_an_archive_has_all_that_the_run_was_made_of_and_the_same_bytes_each_time(packed: Path) -> None:
    assert (packed / "x.zip").read_bytes() == (packed / "again.zip").read_bytes()
    with zipfile.ZipFile(packed / "x.zip") as file:
        names = set(file.namelist())
        lock = file.read(LOCK).decode()
        content = json.loads(file.read(MANIFEST))
    recorded = {f"{INPUTS}/recordings/room.mcap", f"{INPUTS}/recordings/cam1.avi"}
    assert {*recorded, f"{INPUTS}/study/run.yaml", MANIFEST, LOCK} <= names
    assert {f"{OUTPUTS}/tracks.parquet", f"{OUTPUTS}/metrics.json", f"{OUTPUTS}/report.html"} <= names
    assert f"numpy=={content['versions']['numpy']}" in lock.splitlines()
    assert str(packed) not in json.dumps(content)
    with zipfile.ZipFile(packed / "bare.zip") as file:
        assert [name for name in file.namelist() if name.startswith(INPUTS)] == [f"{INPUTS}/study/run.yaml"]


def test_a_configuration_in_a_folder_that_is_a_link_names_the_same_inputs(
    packed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "link").symlink_to(packed / "study")
    config, archive = str(tmp_path / "link" / "run.yaml"), tmp_path / "x.zip"
    assert run(["pack", str(packed / "out"), "--config", config, "-o", str(archive)]) == ExitCode.DONE
    assert archive.read_bytes() == (packed / "x.zip").read_bytes()
    assert verify(archive, capsys)[0] == ExitCode.DONE


def test_recordings_that_say_where_their_videos_are_are_the_same_bytes(
    packed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, out, archive = packed / "study" / "ingest.yaml", packed / "far" / "away" / "out", packed / "ingest.zip"
    config.write_text("occlog_run: 1\ningest: {video: {cam1: ../recordings/cam1.avi}, calibration: run.yaml}\n")
    assert run(["run", str(config), "-o", str(out), "-q"]) == ExitCode.DONE
    assert run(["pack", str(out), "--config", str(config), "-o", str(archive)]) == ExitCode.DONE
    with zipfile.ZipFile(archive) as file:
        assert json.loads(file.read(MANIFEST))["folder"] == "far/away/out"
    code, found = verify(archive, capsys)
    assert (code, found["result"]) == (ExitCode.DONE, "made again to the same bytes")


def test_inputs_that_are_not_in_it_are_asked_for(packed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, found = verify(packed / "bare.zip", capsys)
    assert code == ExitCode.USAGE
    assert "recordings/cam1.avi is not in it" in str(found["error"])
    code, found = verify(packed / "bare.zip", capsys, "--inputs", str(packed))
    assert (code, found["result"]) == (ExitCode.DONE, "made again to the same bytes")


def test_other_inputs_are_refused(packed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(packed / "recordings", tmp_path / "recordings")
    (tmp_path / "recordings" / "cam1.avi").write_bytes(b"Frames")
    code, found = verify(packed / "bare.zip", capsys, "--inputs", str(tmp_path))
    assert (code, "is not what pack.json states" in str(found["error"])) == (ExitCode.BAD_INPUT, True)


def test_what_differs_is_named_and_whether_versions_explain_it(
    packed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(VALUES, "rmse_m", 2.0)
    code, found = verify(packed / "x.zip", capsys)
    assert (code, list(found["different"])) == (ExitCode.DIFFERENT, ["metrics.json"])
    assert "1.0 is now 2.0" in found["different"]["metrics.json"]
    assert "versions and processor are the same" in str(found["result"])
    old = changed(packed / "x.zip", tmp_path / "old.zip", versions={"numpy": "1.0"})
    code, found = verify(old, capsys)
    assert (code, "may explain" in str(found["result"])) == (ExitCode.DIFFERENT, True)
    assert found["versions"]["numpy"].startswith("1.0, now ")


def test_another_python_is_the_first_version_that_is_named(
    packed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(VALUES, "_provenance", 5)
    now = installed_versions()
    old = changed(packed / "x.zip", tmp_path / "old.zip", versions={**now, "python": "3.12.1"})
    code, found = verify(old, capsys)
    cause = f"other versions (python 3.12.1, now {now['python']})"
    assert (code, found["result"]) == (ExitCode.DONE, f"the same values; {cause}, so that bytes differ")
    monkeypatch.setitem(VALUES, "rmse_m", 2.0)
    without_click = {name: version for name, version in now.items() if name != "click"}
    many = changed(
        packed / "x.zip", tmp_path / "many.zip", versions={**without_click, "python": "3.12.1", "numpy": "1.0"}
    )
    code, found = verify(many, capsys)
    assert code == ExitCode.DIFFERENT
    cause = f"other versions (python 3.12.1, now {now['python']}; numpy 1.0, now {now['numpy']}; and 1 more)"
    assert str(found["result"]).startswith(f"{cause}: may explain what differs; ")


def test_the_same_values_in_other_bytes_are_explained_by_versions_alone(
    packed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(VALUES, "_provenance", 5)
    code, found = verify(packed / "x.zip", capsys)
    assert (code, found["same_values"], found["different"]) == (ExitCode.DIFFERENT, ["metrics.json"], {})
    code, found = verify(changed(packed / "x.zip", tmp_path / "old.zip", version="0.0.1"), capsys)
    assert (code, "other versions" in str(found["result"])) == (ExitCode.DONE, True)


def test_another_processor_is_named_as_the_cause(
    packed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Finding R26: last digits differ on another type of processor, with the same versions."""
    old = changed(packed / "x.zip", tmp_path / "old.zip", processor="nehalem")
    code, found = verify(old, capsys)
    assert (code, found["result"]) == (ExitCode.DONE, "made again to the same bytes")
    assert found["versions"] == {"processor": f"nehalem, now {processor_type()}"}
    with monkeypatch.context() as bytes_differ:
        bytes_differ.setitem(VALUES, "_provenance", 5)
        code, found = verify(old, capsys)
        assert (code, found["same_values"]) == (ExitCode.DONE, ["metrics.json"])
        assert "another processor (nehalem, now" in str(found["result"])
    monkeypatch.setitem(VALUES, "rmse_m", 2.0)
    code, found = verify(old, capsys)
    assert (code, list(found["different"])) == (ExitCode.DIFFERENT, ["metrics.json"])
    assert "another processor (nehalem, now" in str(found["result"])
    assert "verify on one of its type" in str(found["result"])


def test_a_stage_that_ends_otherwise_is_named(packed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with zipfile.ZipFile(packed / "x.zip") as file:
        stages = json.loads(file.read(MANIFEST))["stages"]
    old = changed(packed / "x.zip", tmp_path / "old.zip", stages=stages | {"detect": 3})
    code, found = verify(old, capsys)
    assert (code, found["different"]) == (ExitCode.DIFFERENT, {"stage detect": "ended with 3, now with 0"})


def test_what_is_made_and_not_in_the_archive_is_named(
    packed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An archive that tells of no outputs would be made again to the same bytes whatever they were."""
    with zipfile.ZipFile(packed / "x.zip") as old, zipfile.ZipFile(tmp_path / "x.zip", "w") as new:
        content = json.loads(old.read(MANIFEST))
        for name in old.namelist():
            if not name.startswith(OUTPUTS):
                data = (
                    json.dumps({**content, "outputs": [], "stages": {}}).encode()
                    if name == MANIFEST
                    else old.read(name)
                )
                new.writestr(name, data)
    code, found = verify(tmp_path / "x.zip", capsys)
    assert code == ExitCode.DIFFERENT
    assert found["different"]["tracks.parquet"] == "was made, and is not in the archive"
    assert found["different"]["stage track"] == "ended with nothing, now with 0"


def test_a_configuration_may_name_no_file_outside_of_the_archive(
    tmp_path: Path, packed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = CONFIG.replace("../recordings/room.mcap", str(packed / "recordings" / "room.mcap")).encode()
    with zipfile.ZipFile(packed / "x.zip") as old, zipfile.ZipFile(tmp_path / "x.zip", "w") as new:
        content = json.loads(old.read(MANIFEST))
        for file in content["inputs"]:
            if file["path"] == "study/run.yaml":
                file |= {"sha256": sha256(text).hexdigest(), "bytes": len(text)}
        for name in old.namelist():
            data = {MANIFEST: json.dumps(content).encode(), f"{INPUTS}/study/run.yaml": text}
            new.writestr(name, data.get(name, old.read(name)))
    code, found = verify(tmp_path / "x.zip", capsys)
    assert (code, "which is not in the archive" in str(found["error"])) == (ExitCode.BAD_INPUT, True)


def test_an_input_that_no_stage_names_is_refused(
    tmp_path: Path, packed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = b"cache_dir: /tmp"
    with zipfile.ZipFile(packed / "x.zip") as old, zipfile.ZipFile(tmp_path / "x.zip", "w") as new:
        content = json.loads(old.read(MANIFEST))
        more = {"path": "study/.numba_config.yaml", "sha256": sha256(text).hexdigest(), "bytes": len(text)}
        content["inputs"].append(more)
        new.writestr(f"{INPUTS}/{more['path']}", text)
        for name in old.namelist():
            new.writestr(name, json.dumps(content).encode() if name == MANIFEST else old.read(name))
    code, found = verify(tmp_path / "x.zip", capsys)
    assert code == ExitCode.BAD_INPUT
    assert "study/.numba_config.yaml" in str(found["error"])


def test_a_stage_may_write_nothing_outside_of_the_inputs(
    packed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Options of a stage name more outputs than those that a run has, and a configuration gives them any place."""
    places = [tmp_path / "out.parquet", Path("../../run/out.parquet"), Path("../../../out.parquet")]

    def write_elsewhere(stage: RunStage) -> int:
        write_bytes(places[0], b"")
        return 0

    monkeypatch.setattr("occlog.pipeline.run.run._do", write_elsewhere)
    while places:
        code, found = verify(packed / "x.zip", capsys)
        assert code == ExitCode.BAD_INPUT
        assert "out.parquet: is outside of inputs" in str(found["error"])
        del places[0]
    write_bytes(tmp_path / "out.parquet", b"")  # elsewhere is anywhere again


def test_what_cannot_be_packed_is_refused(packed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def pack(folder: Path, config: Path) -> tuple[int, str]:
        code = run(["pack", str(folder), "--config", str(config), "-o", str(tmp_path / "y.zip")])
        return code, capsys.readouterr().err

    config = packed / "study" / "run.yaml"
    assert pack(tmp_path, config)[0] == ExitCode.USAGE
    other = packed / "study" / "other.yaml"
    other.write_text(CONFIG.replace("particles: 20", "particles: 30"))
    code, error = pack(packed / "out", other)
    assert (code, "stage track is not up to date" in error) == (ExitCode.BAD_INPUT, True)
    other.write_text(CONFIG.replace("../recordings/room.mcap", str(packed / "recordings" / "room.mcap")))
    code, error = pack(packed / "out", other)
    assert (code, "an absolute path" in error) == (ExitCode.BAD_INPUT, True)
    assert os.listdir(tmp_path) == []


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let stages be done at once."""
    monkeypatch.setattr("occlog.pipeline.run.run._do", write_outputs)


def pack_recording(folder: Path, name: str, beside: str = "") -> int:
    """Run and pack with a recording of a name, and a truth of another."""
    truth = f"evaluate: {{truth: {beside}}}\n" if beside else ""
    (folder / "run.yaml").write_text(f"occlog_run: 1\nrecording: '{name}'\ntrack: {{particles: 20}}\n{truth}")
    for each in filter(None, (name, beside)):
        with RecordingWriter(folder / each, None, Provenance("simulate")) as writer:
            writer.video_frame("cam1", 40_000_000, 0)
    config = str(folder / "run.yaml")
    assert run(["run", config, "-o", str(folder / "out"), "-q"]) == ExitCode.DONE
    return run(["pack", str(folder / "out"), "--config", config, "-o", str(folder / "x.zip")])


@pytest.mark.usefixtures("at_once")
def test_a_recording_may_be_called_after_its_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert pack_recording(tmp_path, "hall 10:30.mcap") == ExitCode.DONE
    code, found = verify(tmp_path / "x.zip", capsys)
    assert (code, found["result"]) == (ExitCode.DONE, "made again to the same bytes")


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize(
    ("name", "beside", "words"),
    [
        ("ha\\ll.mcap", "", "is no name of a file inside the archive; rename it, run again, and pack"),
        ("hall\u200e.mcap", "", "is no name of a file inside the archive; rename it"),
        ("HALL.mcap", "hall.mcap", "twice where case does not count, 'HALL.mcap' and 'hall.mcap'; rename it"),
    ],
)
def test_names_that_would_not_be_unpacked_are_not_packed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, beside: str, words: str
) -> None:
    assert pack_recording(tmp_path, name, beside) == ExitCode.BAD_INPUT
    assert words in capsys.readouterr().err
    assert not (tmp_path / "x.zip").exists()


@pytest.mark.usefixtures("at_once")
def test_more_files_than_are_unpacked_are_not_packed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("occlog.pipeline.pack.run.MAX_FILES", 4)
    assert pack_recording(tmp_path, "hall.mcap") == ExitCode.BAD_INPUT
    assert "the limit is 4; leave them out: --reference" in capsys.readouterr().err
