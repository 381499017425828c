"""Files of the current folder, and of folders that others can write, decide nothing that runs."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import subprocess
import sys
from collections.abc import Iterable
from importlib.metadata import packages_distributions
from pathlib import Path

import numba
import pytest
from numba.core import caching
from places import EXAMPLES

from occlog.cli.main import run
from occlog.console.foreign_code import is_own
from occlog.core import plane as polygons
from occlog.core.numerics.kernel_cache import CONFIGURATION, KernelCache

WITNESS = "witness.txt"
IMPORTED = ("json", "socket", "pickle", "threading", "click", "pathlib", "contextlib", "numba", "numpy", "yaml")
"""Modules that the program imports, as files of the current folder."""
ALL = (*sys.stdlib_module_names, *packages_distributions(), "sitecustomize", "usercustomize", "conftest")
"""Every module that there is, and those that Python and others import where they exist."""
STAGES = "occlog_run: 1\nseed: 1\nrecording: data/recording.mcap\ntrack: {method: fix}\nevaluate: {}\nreport: {}\n"
SWEEP = (
    "occlog_sweep: 1\nscene: room.yaml\nseed: 1\nruns: 1\nsimulate: {steps: 3}\ntrack: {particles: 5}\n"
    "order: [southwest, southeast]\nvary: {cameras: [1, 2]}\n"
)


class Payload:
    """Writes a file when it is unpickled."""

    def __init__(self, witness: Path) -> None:
        self.witness = witness

    def __reduce__(self) -> tuple[object, ...]:
        return (Path.write_text, (self.witness, "run"))


@pytest.fixture
def hostile(tmp_path: Path) -> Path:
    """A folder with modules that leave a witness when they are imported."""
    return filled(tmp_path / "hostile", IMPORTED)


def filled(folder: Path, modules: Iterable[str]) -> Path:
    """Make a folder with modules, plug-ins, and configurations of libraries; what runs leaves a witness in it."""
    folder.mkdir()
    witness = str(folder / WITNESS)
    for name in modules:
        (folder / f"{name}.py").write_text(f"import os\nopen({witness!r}, 'w').write({name!r})\nos._exit(99)\n")
    (folder / ".pdbrc").write_text(f"!open({witness!r}, 'w')\n")
    (folder / CONFIGURATION).write_text("disable_jit: 1\ndebug: 1\n")
    # A package with plug-ins, and a configuration of matplotlib that names a module of this folder
    (folder / "evil-1.0.dist-info").mkdir()
    (folder / "evil-1.0.dist-info/METADATA").write_text("Metadata-Version: 2.1\nName: evil\nVersion: 1.0\n")
    points = "".join(f"[occlog.{group}]\nevil = json:evil\n" for group in ("readers", "tracking_methods"))
    (folder / "evil-1.0.dist-info/entry_points.txt").write_text(points)
    (folder / "matplotlibrc").write_bytes(b"backend: module://json\nunknown: 1\n# \xff\n")
    return folder


def started(folder: Path, *args: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """A new process of Python in a folder, without the variables by which tests find things."""
    environment = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "PYTHONSAFEPATH")}
    environment |= {"NUMBA_DISABLE_JIT": "0", **variables}
    return subprocess.run(
        [sys.executable, *args], cwd=folder, env=environment, capture_output=True, text=True, timeout=120, check=False
    )


def crafted_index(folder: Path, witness: Path) -> Path:
    """The index of a kernel in a folder as numba lays it out, which runs something when it is unpickled."""
    locator = getattr(caching, "UserProvidedCacheLocator", None) or caching._UserProvidedCacheLocator
    below = folder / locator.get_suitable_cache_subpath(polygons.__file__)
    below.mkdir(parents=True)
    index = below / f"{KernelCache(polygons.point_inside)._impl.filename_base}.nbi"
    index.write_bytes(pickle.dumps(numba.__version__) + pickle.dumps(Payload(witness)))
    return index


CALLS = "import numpy; from occlog.core.plane import point_inside; point_inside(0.5, 0.5, numpy.eye(3)[:, :2])"


@pytest.mark.jit
def test_a_configuration_of_numba_in_the_current_folder_is_not_read(tmp_path: Path) -> None:
    crafted_index(tmp_path / "kept", tmp_path / WITNESS)
    (tmp_path / CONFIGURATION).write_text(f"cache_dir: {tmp_path / 'kept'}\n")
    done = started(tmp_path, "-P", "-c", CALLS)
    assert (done.returncode, done.stderr) == (0, "")
    assert not (tmp_path / WITNESS).exists()


@pytest.mark.jit
def test_a_configuration_that_the_caller_has_let_numba_read_decides_nothing(tmp_path: Path) -> None:
    crafted_index(tmp_path / "kept", tmp_path / WITNESS)
    (tmp_path / CONFIGURATION).write_text(f"cache_dir: {tmp_path / 'kept'}\n")
    done = started(tmp_path, "-P", "-c", f"import numba; {CALLS}")
    assert (done.returncode, done.stderr) == (0, "")
    assert not (tmp_path / WITNESS).exists()


@pytest.mark.jit
@pytest.mark.parametrize(("mode", "used"), [(0o700, True), (0o777, False), (0o1777, False)])
def test_kernels_are_kept_where_the_user_says_unless_others_can_write_there(
    tmp_path: Path, mode: int, used: bool
) -> None:
    folder = tmp_path / "kernels"
    folder.mkdir()
    folder.chmod(mode)
    assert is_own(folder) == used
    if mode == 0o1777:
        return  # as 0o777
    done = started(tmp_path, "-P", "-c", CALLS, NUMBA_CACHE_DIR=str(folder))
    assert done.returncode == 0, done.stderr
    assert any(folder.rglob("*.nbi")) == used
    assert ("NUMBA_CACHE_DIR" in done.stderr) != used


def test_a_relative_folder_for_kernels_is_not_used(tmp_path: Path) -> None:
    done = started(tmp_path, "-P", "-c", CALLS, NUMBA_CACHE_DIR="kernels")
    assert done.returncode == 0, done.stderr
    assert "NUMBA_CACHE_DIR" in done.stderr
    assert not (tmp_path / "kernels").exists()


@pytest.mark.parametrize("args", [("--version",), ("doctor", "missing.mcap"), ("plugin", "list")])
def test_the_program_imports_nothing_of_the_current_folder(hostile: Path, args: tuple[str, ...]) -> None:
    done = started(hostile, "-m", "occlog", *args)
    assert done.returncode in (0, 4), done.stderr
    assert "evil" not in done.stdout
    assert not (hostile / WITNESS).exists()


def test_workers_import_nothing_of_the_current_folder(hostile: Path, tmp_path: Path) -> None:
    # As the command does, whose script lies elsewhere
    script = tmp_path / "script.py"
    script.write_text("""
from occlog.pipeline.executors.processes import Processes
if __name__ == "__main__":
    print(dict(Processes(2).outcomes({"a": -1, "b": 2}, abs)))
""")
    done = started(hostile, str(script))
    assert (done.returncode, done.stdout) == (0, "{'a': 1, 'b': 2}\n"), done.stderr
    assert not (hostile / WITNESS).exists()


def test_processes_that_take_files_apart_import_nothing_of_the_current_folder(hostile: Path, tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text("""
import subprocess, sys
from occlog.io.files.children import environment_for_children
command = [sys.executable, "-P", "-c", "import socket, json; print(socket.__file__)"]
print(subprocess.run(command, env=environment_for_children(), capture_output=True, text=True).stdout)
""")
    done = started(hostile, str(script), PYTHONPATH=os.pathsep.join(["", ".", os.environ.get("PYTHONPATH", "")]))
    assert str(hostile) not in done.stdout
    assert "socket.py" in done.stdout or not done.stdout


@pytest.mark.slow
@pytest.mark.drawn
def test_whole_runs_execute_and_follow_nothing_of_their_folders(tmp_path: Path) -> None:
    """Of the current folder, of that of the inputs, and of that in which a packed run is unpacked."""
    clean, folder = tmp_path / "clean", filled(tmp_path / "hostile", ALL)
    (clean / "data").mkdir(parents=True)
    made = str(clean / "data/recording.mcap")
    assert run(["simulate", str(EXAMPLES / "room.yaml"), "-o", made, "--seconds", "0.2", "--seed", "1"]) == 0
    (clean / "run.yaml").write_text(STAGES)
    assert run(["run", str(clean / "run.yaml"), "-o", str(clean / "run"), "-q"]) == 0
    packed = ["pack", str(clean / "run"), "--config", str(clean / "run.yaml"), "-o", str(folder / "run.zip")]
    assert run(packed) == 0
    data = filled(folder / "data", ALL)
    shutil.copy(made, data)
    shutil.copy(EXAMPLES / "room.yaml", data)
    (data / "each.yaml").write_text(STAGES.replace("recording: data/recording.mcap\n", ""))
    (data / "sweep.yaml").write_text(SWEEP)
    (folder / "run.yaml").write_text(STAGES)
    commands = [
        ["verify", "run.zip", "-q"],
        ["run", "run.yaml", "-o", "out", "-q"],
        ["batch", "data/each.yaml", "data/recording.mcap", "-o", "batch", "--workers", "1", "-q"],
        ["sweep", "data/sweep.yaml", "-o", "sweep", "--workers", "1", "-q"],
        ["plan", "data/room.yaml", "--cells", "4", "--samples-per-cell", "4", "--report", "plan.html", "-q"],
        ["start", "data", "-o", "started", "--as", "room.yaml=unused", "--write-only", "-q"],
    ]
    script = tmp_path / "script.py"
    script.write_text(f"""
from occlog import __main__
if __name__ == "__main__":
    from occlog.cli.main import run
    print([run(words) for words in {json.dumps(commands)}])
""")
    own = {name: os.environ[name] for name in ("NUMBA_CACHE_DIR", "NUMBA_DISABLE_JIT") if name in os.environ}
    done = started(folder, str(script), TMPDIR=str(folder), **own)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-1] == str([0] * len(commands)), done.stdout
    assert not list(tmp_path.rglob(WITNESS))
    for name in ("tracks.parquet", "report.html"):
        assert (folder / "out" / name).read_bytes() == (clean / "run" / name).read_bytes()
