"""`occlog batch`: a run folder for each recording, tables over all, failures that are listed, and kills."""

from __future__ import annotations

import csv
import fcntl
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from sweep_scene import SCENE

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.pipeline.batch import run as batch
from occlog.pipeline.executors.interface import InThisProcess, R, T

CONFIG = "occlog_run: 1\nseed: 2\ntrack: {particles: 50}\n"
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings, one that is cut off, and a configuration."""
    folder = tmp_path_factory.mktemp("simulated")
    (folder / "scene.yaml").write_text(SCENE)
    for seed, name in enumerate(("hall", "yard")):
        args = ["simulate", str(folder / "scene.yaml"), "--steps", "6", "--seed", str(seed), "-q"]
        assert run([*args, "-o", str(folder / f"{name}.mcap")]) == ExitCode.DONE
    whole = (folder / "hall.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    (folder / "batch.yaml").write_text(CONFIG)
    return folder


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the work be done in this process, where everything is compiled."""
    monkeypatch.setattr(batch, "executor_of", lambda *_, **__: InThisProcess())


def do(folder: Path, out: Path, *more: str, pattern: str = "*.mcap", code: int = ExitCode.DONE) -> None:
    args = ["batch", str(folder / "batch.yaml"), str(folder / pattern), "-o", str(out), "-q", "--json", *more]
    assert run(args) == code


def contents(folder: Path) -> dict[str, bytes]:
    """Every file but that of times."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file() and path.name != "timings.csv")
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.fixture(scope="module")
def whole(simulated: Path) -> tuple[Path, str, str]:
    """The results of all recordings, and what was printed."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(batch, "executor_of", lambda *_, **__: InThisProcess())
        do(simulated, simulated / "whole", code=ExitCode.LOSSY)
    return simulated / "whole", out.getvalue(), err.getvalue()


@pytest.mark.usefixtures("here")
def test_failures_are_listed_and_the_rest_goes_on(
    simulated: Path, whole: tuple[Path, str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    out, printed, warned = whole
    result = json.loads(printed)
    assert (result["recordings"], result["done"], result["failed"], result["up_to_date"]) == (3, 2, 1, 0)
    assert warned.startswith(f"occlog: failed: cut: detect: {simulated / 'cut.mcap'}: ")
    assert f"`occlog recover {simulated / 'cut.mcap'} -o OUT.mcap`" in warned, "the remedy works where it is read"
    rows = {row["recording"]: row for row in pq.read_table(out / "runs.parquet").to_pylist()}
    assert len(rows) == 3
    assert rows["cut"]["state"] == "failed"
    assert (rows["cut"]["exit_code"], rows["cut"]["stage"]) == (ExitCode.BAD_INPUT, "detect")
    assert "cut.mcap" in rows["cut"]["message"]
    assert rows["yard"]["state"] == "done"
    assert {row["source"] for row in rows.values()} == {"hall.mcap", "yard.mcap", "cut.mcap"}
    assert str(simulated) not in str(rows), "the table names folders of this machine"
    assert {path.name for path in (out / "runs").iterdir()} == set(rows) - {"cut"}

    tracks = pq.read_table(out / "tracks.parquet")
    assert set(tracks["recording"].to_pylist()) == set(rows) - {"cut"}
    own = pq.read_table(out / "runs" / "yard" / "tracks.parquet")
    joined = tracks.filter([name == "yard" for name in tracks["recording"].to_pylist()])
    assert joined["x"].to_pylist() == own["x"].to_pylist()
    metrics = json.loads((out / "runs" / "yard" / "metrics.json").read_text())
    (found,) = [
        row["value"]
        for row in pq.read_table(out / "metrics.parquet").to_pylist()
        if (row["recording"], row["name"]) == ("yard", "rmse_unit")
    ]
    assert found == metrics["rmse_unit"]
    with (out / "timings.csv").open() as file:
        assert [row["recording"] for row in csv.DictReader(file)] == sorted(rows)
    assert run(["info", str(out / "tracks.parquet")]) == ExitCode.DONE
    assert "lost      cut: the whole recording" in capsys.readouterr().out

    before = contents(out)
    do(simulated, out, code=ExitCode.LOSSY)
    assert json.loads(capsys.readouterr().out)["up_to_date"] == 2
    assert contents(out) == before


@pytest.mark.usefixtures("here")
def test_more_recordings_join_and_a_changed_one_is_done_again(
    simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = tmp_path / "in", tmp_path / "out"
    shutil.copytree(simulated, folder, ignore=shutil.ignore_patterns("whole"))
    do(folder, out, pattern="hall.mcap")
    do(folder, out, pattern="[hy]a*.mcap")
    lines = capsys.readouterr().out.splitlines()
    assert [json.loads(line)["up_to_date"] for line in lines] == [0, 1]
    shutil.copy(folder / "yard.mcap", folder / "hall.mcap")
    do(folder, out, pattern="[hy]a*.mcap")
    assert json.loads(capsys.readouterr().out)["up_to_date"] == 1
    runs = {row["recording"]: row["sha256"] for row in pq.read_table(out / "runs.parquet").to_pylist()}
    assert runs["hall"] == runs["yard"]


@pytest.mark.usefixtures("here")
def test_tables_of_an_earlier_command_do_not_stay_next_to_newer_ones(simulated: Path, tmp_path: Path) -> None:
    """Tables that the second command does not join were left, of runs that are no more."""
    memory, out = pytest.importorskip("fsspec").filesystem("memory"), tmp_path / "out"
    for place, more in ((str(out), ()), ("memory://old", ("--cache", str(tmp_path / "cache"), "--workers", "1"))):
        for tables in ("tracks,bearings", "tracks"):
            args = [str(simulated / "batch.yaml"), str(simulated / "hall.mcap"), "-o", place, "--tables", tables]
            assert run(["batch", *args, "-q", "--json", *more]) == ExitCode.DONE
    names = {path.name for path in out.iterdir()}
    assert {Path(name).name for name in memory.ls("/old", detail=False)} == names
    assert {name for name in names if name.endswith(".parquet")} == {
        "runs.parquet",
        "metrics.parquet",
        "tracks.parquet",
    }
    memory.rm("/old", recursive=True)


@pytest.mark.usefixtures("here")
def test_all_that_fail_are_no_batch(simulated: Path, tmp_path: Path) -> None:
    do(simulated, tmp_path / "out", pattern="cut.mcap", code=ExitCode.BAD_INPUT)
    assert pq.read_table(tmp_path / "out" / "runs.parquet")["state"].to_pylist() == ["failed"]
    assert not (tmp_path / "out" / "tracks.parquet").exists()


@pytest.mark.usefixtures("here")
def test_a_link_that_leads_nowhere_has_failed(
    simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    for name in ("batch.yaml", "hall.mcap"):
        shutil.copy(simulated / name, folder)
    (folder / "gone.mcap").symlink_to(tmp_path / "no" / "hall.mcap")
    (folder / "self.mcap").symlink_to("self.mcap")
    do(folder, out, code=ExitCode.LOSSY)
    rows = {row["recording"]: row for row in pq.read_table(out / "runs.parquet").to_pylist()}
    assert {name: row["state"] for name, row in rows.items()} == {"gone": "failed", "hall": "done", "self": "failed"}
    assert (rows["gone"]["exit_code"], rows["gone"]["stage"]) == (ExitCode.BAD_INPUT, "recording")
    assert "gone.mcap: is a symbolic link to a file that is not there" in rows["gone"]["message"]
    assert f"occlog: failed: gone: recording: {folder / 'gone.mcap'}: is a symbolic link" in capsys.readouterr().err
    (folder / "hall.mcap").unlink()
    do(folder, tmp_path / "none", code=ExitCode.BAD_INPUT)


def test_a_configuration_that_is_named_by_a_relative_path_is_found_by_workers_in_other_folders(
    simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What it names was looked for in the worker's own folder, and taken from there."""

    class Elsewhere(InThisProcess):
        def outcomes(self, todo: Mapping[str, T], work: Callable[[T], R]) -> Iterator[tuple[str, R]]:
            with chdir(tmp_path):
                found = list(super().outcomes(todo, work))
            yield from found

    (simulated / "with_scene.yaml").write_text(f"{CONFIG}scene: scene.yaml\noverlay: {{}}\n")
    (tmp_path / "scene.yaml").write_text("no scene")
    monkeypatch.setattr(batch, "executor_of", lambda *_, **__: Elsewhere())
    monkeypatch.chdir(simulated)
    out = tmp_path / "out"
    assert run(["batch", "with_scene.yaml", "hall.mcap", "-o", str(out), "-q"]) == ExitCode.BAD_INPUT
    (row,) = pq.read_table(out / "runs.parquet").to_pylist()
    assert row["message"] == "with_scene.yaml: overlay: the recording holds no video; remove this key"
    assert (out / "runs" / "hall" / "report.html").exists()


@pytest.mark.usefixtures("here")
def test_a_name_with_ends_of_lines_stays_in_its_line(
    simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It began lines of its own, and moved the cursor; the table named the folder of this machine."""
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    shutil.copy(simulated / "batch.yaml", folder)
    shutil.copy(simulated / "cut.mcap", folder / "cut\x1b[31m\n.mcap")
    (folder / "gone\nlink.mcap").symlink_to("nowhere")
    do(folder, out, code=ExitCode.BAD_INPUT)
    lines = capsys.readouterr().err.splitlines()
    assert [line[:21] for line in lines] == ["occlog: failed: cut\\x", "occlog: failed: gone "]
    for row in pq.read_table(out / "runs.parquet").to_pylist():
        assert str(folder) not in row["message"]
        assert "\n" not in row["message"]


@pytest.mark.usefixtures("here")
def test_a_name_that_is_no_text_fails_alone(simulated: Path, tmp_path: Path) -> None:
    folder, out = tmp_path / "in", tmp_path / "out"
    odd = os.fsdecode(b"d\xe9")
    (folder / odd).mkdir(parents=True)
    shutil.copy(simulated / "batch.yaml", folder)
    shutil.copy(simulated / "hall.mcap", folder / odd)
    shutil.copy(simulated / "cut.mcap", folder / odd / os.fsdecode(b"b\xe9.mcap"))
    shutil.copy(simulated / "cut.mcap", folder / r"b\xe9.mcap")
    do(folder, out, pattern="**/*.mcap", code=ExitCode.LOSSY)
    rows = {row["source"]: row for row in pq.read_table(out / "runs.parquet").to_pylist()}
    assert rows[r"d\xe9/hall.mcap"]["state"] == "done"
    refused = rows[r"d\xe9/b\xe9.mcap"]
    assert (refused["state"], refused["exit_code"]) == ("failed", ExitCode.BAD_INPUT)
    assert refused["message"].startswith(r"d\xe9/b\xe9.mcap: its name is not UTF-8")
    assert rows[r"b\xe9.mcap"]["stage"] == "detect"
    assert len({row["recording"] for row in rows.values()}) == 3
    assert set(pq.read_table(out / "tracks.parquet")["recording"].to_pylist()) == {"hall"}


def test_an_object_store_holds_recordings_and_results(
    simulated: Path, whole: tuple[Path, str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The run folder has the bytes of one on the disk; the second time nothing is done or written."""
    system = pytest.importorskip("fsspec").filesystem("memory")
    system.pipe_file("/in/hall.mcap", (simulated / "hall.mcap").read_bytes())
    system.pipe_file("/in/cut.mcap", (simulated / "cut.mcap").read_bytes())
    args = ["batch", str(simulated / "batch.yaml"), "memory://in/*.mcap", "-o", "memory://out/it", "--workers", "1"]
    args += ["-q", "--json", "--cache", str(tmp_path / "cache")]
    assert run(args) == ExitCode.LOSSY
    result = json.loads(capsys.readouterr().out)
    assert (result["done"], result["failed"], result["folder"]) == (1, 1, "memory://out/it")
    first = {name: system.cat_file(name) for name in system.find("/out/it")}
    assert run(args) == ExitCode.LOSSY
    assert json.loads(capsys.readouterr().out)["up_to_date"] == 1
    again = {name: system.cat_file(name) for name in system.find("/out/it")}
    times = "/out/it/timings.csv"
    assert first.pop(times)
    assert again.pop(times)
    assert again == first
    for path in (whole[0] / "runs" / "hall").iterdir():
        assert path.read_bytes() == first[f"/out/it/runs/hall/{path.name}"], path.name
    (tmp_path / "runs.parquet").write_bytes(first["/out/it/runs.parquet"])
    rows = pq.read_table(tmp_path / "runs.parquet").to_pylist()
    assert {row["source"] for row in rows} == {"memory:///in/hall.mcap", "memory:///in/cut.mcap"}
    assert str(tmp_path) not in str(rows)
    assert not list((tmp_path / "cache").glob("scratch-*"))
    system.rm("/", recursive=True)


def test_a_run_at_a_url_loses_what_its_configuration_no_longer_makes(simulated: Path, tmp_path: Path) -> None:
    """Names behind the two slashes of `out/` and `runs` were not found again."""
    system = pytest.importorskip("fsspec").filesystem("memory")
    for track, out in (("particle_cloud: true", "memory://slash/"), ("particles: 50", "memory://slash")):
        (tmp_path / "batch.yaml").write_text(f"occlog_run: 1\nseed: 2\ntrack: {{{track}}}\n")
        args = ["batch", str(tmp_path / "batch.yaml"), str(simulated / "hall.mcap"), "-o", out, "--workers", "1"]
        assert run([*args, "-q", "--cache", str(tmp_path / "cache")]) == ExitCode.DONE
        assert system.exists("/slash/runs/hall/particles.parquet") == ("cloud" in track)
        assert not [name for name in system.find("/") if "//" in name]
    system.rm("/", recursive=True)


@pytest.mark.parametrize(
    ("places", "words"),
    [
        (("memory://in/a.mcap", "-o", "out", "--workers", "2"), "is in the memory of this process"),
        (("ftp://h/a.mcap", "-o", "out"), "URLs of ftp are not read"),
        (("hall.mcap", "-o", "out", "--tables", "traks"), "--tables: no table 'traks'; did you mean 'tracks'?"),
        (("hall.mcap", "-o", "out", "--tables", "runs"), "--tables: no table 'runs'"),
        (
            ("hall.mcap", "-o", "https://me:word@h/out?sig=word", "--workers", "1"),
            "https://h/out: nothing can be written",
        ),
    ],
)
def test_places_that_cannot_be_are_refused(
    simulated: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    places: tuple[str, ...],
    words: str,
) -> None:
    monkeypatch.chdir(simulated)
    assert run(["batch", "batch.yaml", *places]) == ExitCode.USAGE
    error = capsys.readouterr().err
    assert words in error
    assert "word@" not in error
    assert "sig" not in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("recording: hall.mcap\n", "recording: a batch has its recordings from the command line; remove this key"),
        ("simulate: {scene: scene.yaml}\n", "simulate: a batch has its recordings from the command line"),
        ("detect: {gap: x}\n", "batch.yaml: line 4: detect.gap: unknown key"),
        ("priors: {source: hul}\n", "did you mean 'hull'?"),
    ],
)
def test_a_configuration_that_fits_no_recording_is_refused_at_once(
    simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, words: str
) -> None:
    (tmp_path / "batch.yaml").write_text(CONFIG + text)
    args = ["batch", str(tmp_path / "batch.yaml"), str(simulated / "*.mcap"), "-o", str(tmp_path / "out")]
    assert run(args) == ExitCode.BAD_INPUT
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_other_folders_are_left_alone(simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "thesis.tex").write_text("words")
    do(simulated, tmp_path, code=ExitCode.USAGE)
    assert "not of a batch" in json.loads(capsys.readouterr().err)["error"]
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
    do(simulated, tmp_path / "out", "--dry-run")
    assert not (tmp_path / "out").exists()
    do(simulated, tmp_path / "out", "--workers", "2", "--scheduler", "tcp://x:1", code=ExitCode.USAGE)


def test_a_link_in_the_folder_replaces_nothing_elsewhere(
    simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "run.json"
    mine.write_text('{"program": "occlog"}')
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "batch.json").symlink_to(mine)
    do(simulated, tmp_path / "out", code=ExitCode.BAD_INPUT)
    assert f"is a link to {mine}" in capsys.readouterr().err
    assert mine.read_text() == '{"program": "occlog"}'


def test_two_commands_do_not_work_in_one_folder(
    simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out" / "runs").mkdir(parents=True)
    (tmp_path / "out" / "batch.json").write_text('{"program": "occlog"}')
    descriptor = os.open(tmp_path / "out", os.O_RDONLY)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    try:
        do(simulated, tmp_path / "out", code=ExitCode.USAGE)
    finally:
        os.close(descriptor)
    assert "is in use by another `occlog batch`" in json.loads(capsys.readouterr().err)["error"]


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.usefixtures("here")
def test_killed_it_ends_with_the_same_bytes(simulated: Path, whole: tuple[Path, str, str], tmp_path: Path) -> None:
    """It is killed when the first file appears, which is in the midst of stages."""
    killed = tmp_path / "killed"
    args = ["batch", str(simulated / "batch.yaml"), str(simulated / "*.mcap"), "-q", "--workers", "1"]
    program = subprocess.Popen([sys.executable, "-m", "occlog", *args, "-o", str(killed)], env=ENVIRONMENT)
    deadline = time.monotonic() + 120
    while not any(killed.glob("runs/*/bearings.parquet")) and time.monotonic() < deadline:
        assert program.poll() is None, "it ended before it could be killed"
        time.sleep(0.002)
    program.send_signal(signal.SIGKILL)
    program.wait()
    assert not (killed / "runs.parquet").exists()
    do(simulated, killed, code=ExitCode.LOSSY)
    assert contents(killed) == contents(whole[0])
