"""Outputs appear whole or not at all."""

from __future__ import annotations

import errno
import os
import resource
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from occlog.errors import OutputError, OutputExistsError, UsageError
from occlog.io.files import atomic

WRITER = """
import sys, time
from pathlib import Path
from occlog.io.files.atomic import open_output
with open_output(Path(sys.argv[1]), True) as file:
    file.write(b"x" * 100_000)
    file.flush()
    print("half", flush=True)
    time.sleep(60)
"""


@pytest.fixture(params=["nameless", "hidden"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Both ways of writing: without a name, and under a hidden one (where O_TMPFILE is missing)."""
    if request.param == "hidden":
        monkeypatch.delattr(os, "O_TMPFILE", raising=False)
    return str(request.param)


@pytest.mark.usefixtures("way")
def test_a_complete_file_takes_its_name(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    with atomic.open_output(path) as file:
        file.write(b"new")
        assert not path.exists()
    assert path.read_bytes() == b"new"
    assert os.listdir(tmp_path) == ["a.bin"]


@pytest.mark.usefixtures("way")
def test_an_error_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    with pytest.raises(ZeroDivisionError), atomic.open_output(path, overwrite=True) as file:
        file.write(b"half")
        raise ZeroDivisionError
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.bin"]


def test_existing_output_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    with pytest.raises(OutputExistsError, match="exists"), atomic.open_output(path):
        pass
    assert path.read_bytes() == b"old"


def test_output_that_appears_meanwhile_is_not_lost(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    with pytest.raises(OutputExistsError, match="during this run"), atomic.open_output(path) as file:
        file.write(b"ours")
        path.write_bytes(b"theirs")
    assert path.read_bytes() == b"theirs"


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("fails", ["none", "first", "second", "after"])
def test_files_that_belong_together_appear_together(tmp_path: Path, fails: str) -> None:
    """None has its name before the last is complete; whatever fails, the old ones stay."""
    paths = [tmp_path / "a.bin", tmp_path / "b.bin"]
    paths[0].write_bytes(b"old")
    with ExitStack() as stack:
        if fails != "none":
            stack.enter_context(pytest.raises(ZeroDivisionError))
        together = stack.enter_context(atomic.OutputGroup())
        for path, name in zip(paths, ("first", "second"), strict=True):
            with atomic.open_output(path, True, together) as file:
                file.write(b"new")
                _ = 1 / (fails != name)
        assert paths[0].read_bytes() == b"old"
        assert not paths[1].exists()
        _ = 1 / (fails != "after")
    assert paths[0].read_bytes() == (b"new" if fails == "none" else b"old")
    assert sorted(os.listdir(tmp_path)) == (["a.bin", "b.bin"] if fails == "none" else ["a.bin"])


@pytest.mark.usefixtures("way")
def test_one_that_appears_meanwhile_holds_back_all(tmp_path: Path) -> None:
    with pytest.raises(OutputExistsError, match=r"b\.bin"), atomic.OutputGroup() as together:
        for name in ("a.bin", "b.bin"):
            with atomic.open_output(tmp_path / name, False, together) as file:
                file.write(b"ours")
        (tmp_path / "b.bin").write_bytes(b"theirs")
    assert (tmp_path / "b.bin").read_bytes() == b"theirs"
    assert os.listdir(tmp_path) == ["b.bin"]


def test_missing_folder_and_folder_as_output(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="does not exist"), atomic.open_output(tmp_path / "no" / "a.bin"):
        pass
    with pytest.raises(OutputError, match="is a folder"), atomic.open_output(tmp_path):
        pass


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT])
def test_full_disk_is_one_line_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int) -> None:
    def full(_: int) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match="disk is full"), atomic.open_output(tmp_path / "a.bin") as file:
        file.write(b"x")
    assert os.listdir(tmp_path) == []


def test_a_limit_on_file_size_is_one_line(tmp_path: Path) -> None:
    script = WRITER.replace("time.sleep(60)", "").replace("100_000", "10_000_000")
    code = "from occlog.errors import OcclogError\ntry:\n" + "\n".join("    " + x for x in script.splitlines())
    code += "\nexcept OcclogError as error:\n    print(error)\n    sys.exit(4)\n"

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))

    done = subprocess.run(
        [sys.executable, "-c", "import sys\n" + code, str(tmp_path / "a.bin")],
        capture_output=True,
        text=True,
        preexec_fn=limit,
        check=False,
    )
    assert done.returncode == 4, done.stderr
    assert "larger than this system allows" in done.stdout
    assert done.stderr == ""
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_killed_in_the_middle_of_writing(tmp_path: Path, how: int) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    assert process.stdout is not None
    with process.stdout:
        assert process.stdout.readline() == b"half\n"
        process.send_signal(how)
        process.wait(10)
    assert path.read_bytes() == b"old"
    if hasattr(os, "O_TMPFILE"):
        assert os.listdir(tmp_path) == ["a.bin"]


def test_leftovers_of_killed_writers_are_removed(tmp_path: Path) -> None:
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    for _ in range(50):
        if not Path(f"/proc/{dead.pid}").exists():
            break
        time.sleep(0.01)
    stale = tmp_path / f".a.bin.{dead.pid}.partial"
    live = tmp_path / f".a.bin.{os.getppid()}.partial"
    stale.write_bytes(b"half")
    live.write_bytes(b"half")
    atomic.write_bytes(tmp_path / "a.bin", b"new")
    assert not stale.exists()
    assert live.exists()


def test_a_folder_next_to_an_output_goes_and_so_does_that_of_a_killed_process(tmp_path: Path) -> None:
    path = tmp_path / "a.avi"
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    stale = tmp_path / f".a.avi.{dead.pid}.folder.partial"
    live = tmp_path / f".a.avi.{os.getppid()}.folder.partial"
    for folder in (stale, live):
        folder.mkdir()
        (folder / "video.avi").write_bytes(b"half")
    with pytest.raises(KeyError), atomic.folder_beside(path) as folder:
        assert sorted(tmp_path.iterdir()) == sorted([folder, live])
        # The output takes its name while the folder is there
        atomic.write_bytes(path, b"whole")
        (folder / "video.avi").write_bytes(b"half")
        raise KeyError
    assert sorted(tmp_path.iterdir()) == sorted([path, live])
    assert path.read_bytes() == b"whole"


def test_standard_output_is_refused() -> None:
    with pytest.raises(UsageError, match="nothing is written to standard output; name a file"):
        atomic.check_writable(Path("-"), overwrite=True)


def test_a_link_stays_and_the_file_that_it_leads_to_is_replaced(tmp_path: Path) -> None:
    link, target = tmp_path / "link", tmp_path / "folder" / "target"
    target.parent.mkdir()
    link.symlink_to(target)
    atomic.write_bytes(link, b"first")
    with pytest.raises(OutputExistsError):
        atomic.write_bytes(link, b"second")
    atomic.write_bytes(link, b"second", overwrite=True)
    assert link.is_symlink()
    assert target.read_bytes() == b"second"


def test_a_pipe_is_not_replaced(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(OutputError, match="is no file but a pipe or a device"):
        atomic.write_bytes(pipe, b"x", overwrite=True)
    assert pipe.is_fifo()


def test_nothing_is_left_where_the_last_step_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "x.bin").write_bytes(b"before")

    def fails(_self: Path, _to: Path) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(Path, "replace", fails)
    with pytest.raises(OutputError, match=r"x\.bin: cannot be written: Input/output error; nothing was written"):
        atomic.write_bytes(tmp_path / "x.bin", b"new", overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == ["x.bin"]
    assert (tmp_path / "x.bin").read_bytes() == b"before"


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("old", [True, False])
def test_where_one_of_several_cannot_take_its_name_all_is_as_before(
    old: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [tmp_path / name for name in ("a.bin", "b.bin", "c.bin")]
    for path in paths if old else ():
        path.write_bytes(b"old")
    replace = Path.replace

    def fails(self: Path, to: Path) -> Path:
        if to.name == "b.bin" and "before" not in self.name:
            raise OSError(errno.EIO, "Input/output error")
        return replace(self, to)

    monkeypatch.setattr(Path, "replace", fails)
    with pytest.raises(OutputError, match=r"b\.bin: cannot be written"), atomic.OutputGroup() as together:
        for path in paths:
            with atomic.open_output(path, True, together) as file:
                file.write(b"new")
    assert sorted(os.listdir(tmp_path)) == (["a.bin", "b.bin", "c.bin"] if old else [])
    assert all(path.read_bytes() == b"old" for path in paths if old)
