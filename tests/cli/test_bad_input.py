"""Bad input and bad luck through the command line: one clear line, the right exit code, nothing half written."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode

SCENE = """
occlog_scene: 1
room: [[0, 0], [8, 0], [8, 6], [0, 6]]
cameras:
- {name: a, position: [0, 0, 1.5], yaw_deg: 40, focal_px: 60, image_size_px: [64, 48]}
- {name: b, position: [8, 0, 1.5], yaw_deg: 140, focal_px: 60, image_size_px: [64, 48]}
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a good scene, recording, bearings and tracks."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "scene.yaml").write_text(SCENE)
    ok = [
        ["simulate", f"{folder}/scene.yaml", "-o", f"{folder}/r.mcap", "--steps", "20", "-q"],
        ["detect", f"{folder}/r.mcap", "-o", f"{folder}/b.parquet", "-q"],
        [
            "track",
            f"{folder}/b.parquet",
            "--scene",
            f"{folder}/r.mcap",
            "-o",
            f"{folder}/t.parquet",
            "--particles",
            "50",
        ],
    ]
    for args in ok:
        assert run(args) == ExitCode.DONE
    return folder


@pytest.fixture
def work(made: Path, tmp_path: Path) -> Path:
    """A copy of the good files to damage."""
    return Path(shutil.copytree(made, tmp_path / "work"))


def damage(work: Path, how: str) -> None:
    """Spoil one of the files."""
    name, what = how.split(":")
    path = work / name
    raw = path.read_bytes()
    if what == "missing":
        path.unlink()
    elif what == "empty":
        path.write_bytes(b"")
    elif what == "cut":
        path.write_bytes(raw[: len(raw) // 2])
    elif what == "flipped":
        middle = len(raw) // 2
        path.write_bytes(raw[:middle] + bytes(b ^ 255 for b in raw[middle : middle + 8]) + raw[middle + 8 :])
    elif what == "folder":
        path.unlink()
        path.mkdir()
    else:
        change_bearings(path, what)


def change_bearings(path: Path, what: str) -> None:
    """Bearings that other programs might write."""
    table = pq.read_table(path)
    metadata = table.schema.metadata
    t_ns = table["t_ns"].to_numpy().copy()
    if what == "backwards":
        t_ns[-1] = t_ns[0]
    elif what == "repeated":
        t_ns[:] = t_ns[0]
    if what == "nan":
        bearing = np.full(len(table), np.nan)
        table = table.set_column(
            table.schema.get_field_index("bearing"), table.schema.field("bearing"), pa.array(bearing)
        )
    elif what == "stranger":
        table = table.set_column(1, "sensor", pa.array(["nobody"] * len(table)).dictionary_encode())
    else:
        table = table.set_column(0, table.schema.field("t_ns"), pa.array(t_ns))
    pq.write_table(table.replace_schema_metadata(metadata), path)


DETECT = ["detect", "r.mcap", "-o", "new.parquet"]
TRACK = ["track", "b.parquet", "--scene", "scene.yaml", "-o", "new.parquet"]
EVALUATE = ["evaluate", "t.parquet", "--truth", "r.mcap", "--scene", "scene.yaml", "-o", "new.json"]
REPORT = ["report", "t.parquet", "--scene", "scene.yaml", "-o", "new.html"]
SIMULATE = ["simulate", "scene.yaml", "-o", "new.mcap", "--steps", "5"]
CASES = [
    *[(f"r.mcap:{what}", DETECT, "r.mcap") for what in ("missing", "empty", "cut", "flipped", "folder")],
    *[(f"b.parquet:{what}", TRACK, "b.parquet") for what in ("missing", "empty", "cut", "flipped", "folder")],
    *[(f"t.parquet:{what}", EVALUATE, "t.parquet") for what in ("missing", "empty", "cut")],
    *[(f"t.parquet:{what}", REPORT, "t.parquet") for what in ("missing", "cut")],
    *[(f"scene.yaml:{what}", SIMULATE, "scene.yaml") for what in ("missing", "empty", "folder")],
    ("b.parquet:backwards", TRACK, "goes back"),
    ("b.parquet:repeated", TRACK, "two rows"),
    ("b.parquet:nan", TRACK, "seen is True but bearing is nan"),
    ("b.parquet:stranger", TRACK, "nobody"),
]


@pytest.mark.parametrize(("how", "args", "message"), CASES, ids=[f"{c[1][0]}-{c[0]}" for c in CASES])
def test_exit_code_4_one_line_and_no_output(
    work: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    how: str,
    args: list[str],
    message: str,
) -> None:
    damage(work, how)
    before = sorted(os.listdir(work))
    monkeypatch.chdir(work)
    assert run([*args, "-q"]) == ExitCode.BAD_INPUT
    out = capsys.readouterr()
    assert out.out == ""
    assert out.err.count("\n") == 1, out.err
    assert message in out.err
    assert sorted(os.listdir(work)) == before


@pytest.mark.parametrize("args", [DETECT, TRACK, EVALUATE, REPORT, SIMULATE], ids=lambda a: a[0])
def test_exit_code_7_for_an_output_that_exists(
    work: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], args: list[str]
) -> None:
    monkeypatch.chdir(work)
    target = Path(args[args.index("-o") + 1])
    target.write_text("old")
    assert run([*args, "-q"]) == ExitCode.EXISTS
    assert "--overwrite" in capsys.readouterr().err
    assert target.read_text() == "old"
    assert run([*args, "-q", "--overwrite"]) == ExitCode.DONE
    assert target.read_bytes() != b"old"


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("edge_noise_px=-1", "--set edge_noise_px=-1: must be above 0"),
        ("egde_px=1", "--set egde_px=1: jipda has no setting 'egde_px'; did you mean 'edge_noise_px'?"),
        ("edge_noise_px=wide", "--set edge_noise_px=wide: expected a number"),
    ],
)
def test_exit_code_2_for_a_setting_before_any_input_is_looked_for(
    capsys: pytest.CaptureFixture[str], setting: str, message: str
) -> None:
    args = ["track", "nowhere.parquet", "--method", "jipda", "--set", setting, "-o", "t.parquet"]
    assert run(args) == ExitCode.USAGE
    assert message in capsys.readouterr().err


def test_exit_code_2_for_an_output_that_is_an_input(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = work / "b.parquet"
    before = path.read_bytes()
    args = ["track", str(path), "--scene", str(work / "scene.yaml"), "-o", str(path), "--overwrite"]
    assert run(args) == ExitCode.USAGE
    assert "is an input too" in capsys.readouterr().err
    assert path.read_bytes() == before


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A real disk of 64 kB."""
    path = tmp_path / "disk"
    path.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(path)], capture_output=True, check=False
    )
    if mounted.returncode != 0:
        pytest.skip("mounting a small disk is not allowed here")
    yield path
    subprocess.run(["umount", str(path)], check=True)


@pytest.mark.parametrize("command", ["simulate", "detect"])
def test_exit_code_4_for_a_full_disk(
    work: Path, small_disk: Path, capfd: pytest.CaptureFixture[str], command: str
) -> None:
    args = {
        "simulate": ["simulate", f"{work}/scene.yaml", "-o", f"{small_disk}/r.mcap", "--steps", "2000", "-q"],
        "detect": ["detect", f"{work}/long.mcap", "-o", f"{small_disk}/b.parquet", "-q"],
    }
    if command == "detect":
        assert (
            run(["simulate", f"{work}/scene.yaml", "-o", f"{work}/long.mcap", "--steps", "2000", "-q"]) == ExitCode.DONE
        )
        capfd.readouterr()
    assert run(args[command]) == ExitCode.BAD_INPUT
    error = capfd.readouterr().err
    assert "the disk is full" in error
    assert error.count("\n") == 1
    assert os.listdir(small_disk) == []


def writes_into(folder: Path, pid: int) -> bool:
    """Whether a process has an unnamed or temporary file of a folder open."""
    links = []
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(OSError):
            links.append(str(descriptor.readlink()))
    return any(link.startswith(f"{folder}/") and ("deleted" in link or "partial" in link) for link in links)


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="looks for open files in /proc")
@pytest.mark.parametrize(
    ("how", "code", "line"),
    [
        (signal.SIGINT, ExitCode.INTERRUPTED, "occlog: interrupted\n"),
        (signal.SIGTERM, ExitCode.TERMINATED, "occlog: terminated\n"),
        (signal.SIGKILL, -9, ""),
    ],
)
def test_stopped_in_the_middle(work: Path, how: int, code: int, line: str) -> None:
    output = work / "long.mcap"
    output.write_text("old")
    args = ["simulate", str(work / "scene.yaml"), "-o", str(output), "--steps", "2000000", "--overwrite", "-q"]
    with subprocess.Popen([sys.executable, "-m", "occlog", *args], stderr=subprocess.PIPE, text=True) as process:
        try:
            deadline = time.monotonic() + 60
            while not writes_into(work, process.pid) and time.monotonic() < deadline:
                time.sleep(0.05)
            assert process.poll() is None, "it ended before it could be stopped"
            assert writes_into(work, process.pid)
            process.send_signal(how)
            _, error = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == code
    assert "Traceback" not in error
    assert error == line
    assert output.read_text() == "old"
    assert not [name for name in os.listdir(work) if "partial" in name]


IN_A_FINALISER = """
class Swallows:
    def __del__(self):
        interrupt()

def work(**_):
    Swallows()
    time.sleep(60)
"""
IN_COMPILED_CODE = """
def work(**_):
    try:
        interrupt()
    except KeyboardInterrupt:
        pass
    for _ in console.progress(range(60), "work", quiet=True):
        time.sleep(1)
"""
IN_TEXT_THAT_RUNS = """
def work(**_):
    exec("interrupt()")
"""
IN_WHAT_A_KERNEL_CALLS = """
def work(**_):
    # As numba makes a kernel's result: a class is unpickled by a function of this module, and crashes where that raises
    there = {"__name__": "numba.core.serialize", "interrupt": inside}
    exec("def unpickle(): interrupt()", there)
    try:
        there["unpickle"]()
    except KeyboardInterrupt:
        os._exit(9)
    time.sleep(60)

def inside():
    main.INTERRUPTS._arrived(signal.SIGINT, sys._getframe(1))
"""
WHILE_IT_ENDS = """
def work(**_):
    atexit.register(interrupt)
    interrupt()
"""


@pytest.mark.skipif(os.name != "posix", reason="wants signals")
@pytest.mark.parametrize(
    "where", [IN_A_FINALISER, IN_COMPILED_CODE, IN_TEXT_THAT_RUNS, IN_WHAT_A_KERNEL_CALLS, WHILE_IT_ENDS]
)
def test_an_interrupt_ends_the_program_once_wherever_it_arrives(tmp_path: Path, where: str) -> None:
    (tmp_path / "program.py").write_text(f"""
import atexit, os, signal, sys, time
from occlog import console
from occlog.cli import main

def interrupt():
    os.kill(os.getpid(), signal.SIGINT)
    for _ in range(10_000):
        pass
{where}
main.cli.main = work
main.main([])
""")
    # Only a module that runs by its name, as occlog does, could end by the signal
    run_it = [sys.executable, "-m", "program"]
    done = subprocess.run(run_it, cwd=tmp_path, stderr=subprocess.PIPE, text=True, timeout=50, check=False)
    assert (done.returncode, done.stderr.strip()) == (ExitCode.INTERRUPTED, "occlog: interrupted")


@pytest.mark.parametrize("debug", ["", "1"])
def test_warnings_of_libraries_are_no_lines_of_ours(tmp_path: Path, debug: str) -> None:
    (tmp_path / "program.py").write_text("""
import warnings
from occlog.cli import main

def work(**_):
    warnings.warn("overflow", RuntimeWarning)
    raise main.OutputExistsError("x.parquet: exists")

main.cli.main = work
main.main([])
""")
    run_it = [sys.executable, "-m", "program"]
    reported = {**os.environ, "OCCLOG_DEBUG": debug}
    done = subprocess.run(
        run_it, cwd=tmp_path, env=reported, stderr=subprocess.PIPE, text=True, timeout=50, check=False
    )
    lines = done.stderr.splitlines()
    assert lines[-1].startswith("occlog: error: x.parquet: exists")
    assert ("RuntimeWarning" in done.stderr) == bool(debug)
    assert bool(debug) or len(lines) == 1


def test_the_scene_of_another_unit_is_refused(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = work / "other.yaml"
    other.write_text(SCENE.replace("occlog_scene: 1", "occlog_scene: 1\nlength_unit: unit"))
    capsys.readouterr()
    code = run(["track", str(work / "b.parquet"), "--scene", str(other), "-o", str(work / "new.parquet"), "-q"])
    assert code == ExitCode.USAGE
    assert "lengths are in m, but in unit in the scene" in capsys.readouterr().err


def test_true_places_in_another_unit_are_no_occluders(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = work / "other.yaml"
    other.write_text(SCENE.replace("occlog_scene: 1", "occlog_scene: 1\nlength_unit: ft"))
    feet = work / "feet.mcap"
    assert run(["simulate", str(other), "--steps", "3", "-o", str(feet), "-q"]) == ExitCode.DONE
    capsys.readouterr()
    occluders = ["--occluders", str(work / "r.mcap")]
    assert run(["track", str(feet), *occluders, "-o", str(work / "new.parquet"), "-q"]) == ExitCode.USAGE
    assert "r.mcap: lengths are in m, but in ft in the scene" in capsys.readouterr().err
