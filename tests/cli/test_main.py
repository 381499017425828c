"""The command line as a process shows it: exit codes, streams, start-up."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import click
import pytest
from places import ROOT

from occlog.cli.main import COMMANDS, LazyGroup, cli, run
from occlog.cli.setting_options import VariantCommand
from occlog.console.notes import QUIET
from occlog.console.text import escaped
from occlog.errors import ExitCode
from occlog.io.files.tables.parquet import read_table
from occlog.records.tables import Bearings

HEAVY = (
    "numpy",
    "scipy",
    "pandas",
    "pyarrow",
    "mcap",
    "cv2",
    "numba",
    "matplotlib",
    "jinja2",
    "shapely",
    "msgspec",
    "yaml",
)


def occlog(*args: str, **more: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "occlog", *args],
        capture_output=True,
        text=True,
        check=False,
        **more,  # type: ignore[call-overload]
    )


def imported_by(*args: str) -> set[str]:
    code = (
        "import sys\nfrom occlog.cli.main import run\ncode = run(sys.argv[1:])\n"
        "print('MODULES', *sys.modules)\nsys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", code, *args], capture_output=True, text=True, check=True)
    return set(done.stdout.split("MODULES", 1)[1].split())


def test_help_imports_no_heavy_package() -> None:
    loaded = imported_by("--help")
    assert not {m for m in loaded if m.split(".")[0] in HEAVY}
    assert len([m for m in loaded if m.startswith("occlog")]) <= 18
    assert len(loaded) < 250


def test_help_of_a_command_imports_no_heavy_package() -> None:
    """Each in a process that is forked from one which has imported the command line."""
    code = (
        "import os, sys\nfrom occlog.cli.main import run\n"
        "for name in sys.argv[1:]:\n    if not os.fork():\n        run([name, '--help'])\n"
        "        print('MODULES', name, *sys.modules, flush=True)\n        os._exit(0)\n    os.wait()\n"
    )
    done = subprocess.run([sys.executable, "-c", code, *COMMANDS], capture_output=True, text=True, check=True)
    loaded = [line.split()[1:] for line in done.stdout.splitlines() if line.startswith("MODULES")]
    assert [name for name, *_ in loaded] == list(COMMANDS)
    for name, *modules in loaded:
        assert not {m for m in modules if m.split(".")[0] in HEAVY}, name


def test_schema_loads_nothing_of_what_it_describes() -> None:
    assert not {m for m in imported_by("schema", "track") if m.split(".")[0] in HEAVY}


def test_a_comparison_of_json_loads_neither_numpy_nor_parquet() -> None:
    path = str(ROOT / "schemas" / "tracks.json")
    assert {m for m in imported_by("diff", path, path) if m in HEAVY} <= {"msgspec"}


@pytest.mark.parametrize("command", ["info", "diff"])
def test_looking_at_a_table_loads_no_more_than_its_reader(command: str) -> None:
    path = str(ROOT / "tests" / "golden" / "expected" / "simulated" / "tracks.parquet")
    args = [command, path, path] if command == "diff" else [command, path]
    assert {m for m in imported_by(*args) if m in HEAVY} == {"msgspec", "numpy", "pyarrow"}


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_that_ends_in_an_example(name: str) -> None:
    command = cli.get_command(click.Context(cli), name) if isinstance(cli, LazyGroup) else None
    assert command is not None
    assert command.name == name
    text = command.help or ""
    assert "\b" in text
    assert f"occlog {name}" in text.split("\b")[-1]
    variants = command.variants.values() if isinstance(command, VariantCommand) else ()
    for param in (*command.params, *(p for variant in variants for p in variant.params())):
        if isinstance(param, click.Option):
            assert param.help, f"{name}: {param.opts} has no help"
            for begin, end in ("()", "[]"):
                assert param.help.count(begin) == param.help.count(end), f"{name}: {param.opts}: cut help"


def test_exit_code_2_for_usage_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    for args in (["info"], ["info", "--wrong"], ["schema", "nope"]):
        assert run(args) == ExitCode.USAGE
        captured = capsys.readouterr()
        assert captured.out == ""
        assert captured.err.count("\n") == 1
        assert captured.err.startswith("occlog: error: ")
    done = occlog("trakc")
    assert (done.returncode, done.stdout) == (ExitCode.USAGE, "")
    assert done.stderr.count("\n") == 1
    assert "did you mean 'track'" in done.stderr.lower()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("x.yaml", None),
        ("x.yaml", b""),
        ("x.mcap", b"abc"),
        ("x.parquet", b"PAR1"),
        ("x.parquet", None),
        ("x.txt", b"a"),
    ],
)
def test_exit_code_4_for_bad_input_is_one_line(
    tmp_path: Path, name: str, content: bytes | None, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    assert run(["info", str(path)]) == ExitCode.BAD_INPUT
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert str(path) in captured.err


def closed_pipe() -> int:
    """The writing end of a pipe that no one reads."""
    reading, writing = os.pipe()
    os.close(reading)
    return writing


def test_a_closed_standard_output_is_quiet_and_ends_like_sigpipe() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "occlog", "schema", "views"], stdout=closed_pipe(), stderr=subprocess.PIPE, check=False
    )
    assert (done.returncode, done.stderr) == (ExitCode.PIPE, b"")


def test_messages_that_no_one_reads_do_not_stop_the_work() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "occlog", "info", "missing.parquet"], stderr=closed_pipe(), check=False
    )
    assert done.returncode == ExitCode.BAD_INPUT


@pytest.mark.parametrize(("encoding", "shown"), [("latin-1", rb"\u043a"), ("utf-8", "к".encode())])
def test_what_an_encoding_does_not_have_is_shown_somehow(encoding: str, shown: bytes, tmp_path: Path) -> None:
    scene = tmp_path / "room.yaml"
    scene.write_text((ROOT / "examples/room.yaml").read_text().replace("southwest", "к"), encoding="utf-8")
    words, variables = [sys.executable, "-m", "occlog", "info", str(scene)], {"PYTHONIOENCODING": encoding}
    done = subprocess.run(words, env=os.environ | variables, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (ExitCode.DONE, b"")
    assert shown in done.stdout


def test_streams_that_are_closed_do_not_become_outputs(tmp_path: Path) -> None:
    recording, output = ROOT / "sample_data/room/recording.mcap", tmp_path / "v.parquet"
    words = [sys.executable, "-m", "occlog", "detect", str(recording), "-o", str(output), "--cameras", "southwest"]
    closed = ["sh", "-c", 'exec "$@" 0<&- 1>&- 2>&-', "sh", *words]
    assert subprocess.run(closed, check=False).returncode == ExitCode.DONE
    assert len(read_table(output, Bearings)) > 0


@pytest.mark.skipif(sys.platform != "linux", reason="limits of open files are those of Linux")
def test_too_many_open_files_are_one_line(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "occlog", "detect", str(ROOT / "sample_data/room/recording.mcap"), "-o", "v.parquet"]
    limited = ["sh", "-c", 'ulimit -n 14 && exec "$@"', "sh", *words]
    done = subprocess.run(limited, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == ExitCode.BAD_INPUT
    assert done.stderr == (
        "occlog: error: too many open files, limit: 14; raise it (ulimit -n), or take fewer cameras or workers at a "
        "time\n"
    )
    assert list(tmp_path.iterdir()) == []


def test_a_limit_of_open_files_that_may_be_raised_is(tmp_path: Path) -> None:
    code = (
        "import resource\nfrom contextlib import suppress\nfrom occlog.cli.main import main\n"
        "with suppress(SystemExit):\n    main(['--version'])\nprint(*resource.getrlimit(resource.RLIMIT_NOFILE))\n"
    )
    limited = ["sh", "-c", 'ulimit -S -n 14 && exec "$@"', "sh", sys.executable, "-c", code]
    done = subprocess.run(limited, capture_output=True, text=True, check=True)
    soft, hard = map(int, done.stdout.split()[-2:])
    assert soft == min(hard, 65_536) > 14


def test_a_full_standard_output_is_one_line() -> None:
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            [sys.executable, "-m", "occlog", "schema", "views"], stdout=full, stderr=subprocess.PIPE, check=False
        )
    assert done.returncode == ExitCode.BAD_INPUT
    assert done.stderr.startswith(b"occlog: error: standard output: cannot be written: No space left on device")
    assert done.stderr.count(b"\n") == 1


@pytest.mark.parametrize(
    ("args", "wanted"),
    [
        (
            ["info", "no.parquet"],
            {"id": "file-not-found", "error": "no such file", "file": "no.parquet", "exit_code": 4},
        ),
        (["fix-nothing" * 40], {"id": "unknown-name", "file": None, "exit_code": 2}),
        (["track", "b.csv", "--method", "apff"], {"id": "unknown-name", "exit_code": 2}),
        (["track", "b.csv", "--particle", "9"], {"id": "unknown-name", "exit_code": 2}),
        (["track", "b.csv", "--particles", "-9"], {"id": "invalid-option", "exit_code": 2}),
        (["track", "--method", "apf"], {"id": "missing-option", "exit_code": 2}),
        (["track", "b.csv", "--set", "particles=0", "-o", "t.parquet"], {"id": "invalid-setting", "exit_code": 2}),
        (["trakc"], {"error": "No such command 'trakc'. Did you mean 'track'?", "file": None, "exit_code": 2}),
        (["schema", "trcks"], {"error": "no schema 'trcks'", "hint": "did you mean 'tracks'?", "exit_code": 2}),
    ],
)
def test_an_error_is_an_object_where_json_is_asked_for(args: list[str], wanted: dict[str, object], capsys: Any) -> None:
    code = run([*args, "--json"])
    out, err = capsys.readouterr()
    found = json.loads(err)
    assert out == ""
    assert set(found) == {"id", "error", "file", "hint", "exit_code"}
    assert found.items() >= wanted.items()
    assert code == found["exit_code"]


def test_an_option_before_the_command_is_reported_where_it_goes(capsys: Any) -> None:
    assert run(["--overwrite", "info", "x"]) == ExitCode.USAGE
    assert "options go after it: occlog COMMAND --overwrite" in capsys.readouterr().err


def test_the_shell_completes_commands_and_methods() -> None:
    for words, count, wanted in (("occlog sche", 1, "plain,schema"), ("occlog track --method uk", 3, "plain,ukf")):
        done = occlog(
            env={**os.environ, "_OCCLOG_COMPLETE": "bash_complete", "COMP_WORDS": words, "COMP_CWORD": str(count)}
        )
        assert done.stdout.split() == [wanted]


def test_version() -> None:
    done = occlog("--version")
    assert done.returncode == 0
    assert done.stdout.startswith("occlog, version ")


def test_no_command_shows_the_help() -> None:
    done = occlog()
    assert done.returncode == ExitCode.USAGE
    assert done.stdout == ""
    assert done.stderr == occlog("--help").stdout


def test_control_characters_of_names_do_not_reach_the_terminal(tmp_path: Path) -> None:
    """R28: U+202E turns the line, CSI (U+009B) moves the cursor, U+200F and U+FEFF are not seen."""
    wicked = "a\u202eb\u009bc\u200fd\ufeffe\x1b[31m"
    table = tmp_path / f"{wicked}.csv"
    table.write_text(f"time,id,x,y,{wicked}\n0,1,1,2,3\n", encoding="utf-8")
    code = (
        "import sys\nfrom occlog.cli import streams\nfrom occlog.cli.main import run\nstreams.install()\n"
        "for words in ['info'], ['doctor'], ['evaluate'], ['track', '--method', 'fix', '-o', 't.parquet']:\n"
        "    print('ends with', run([*words, sys.argv[1]]), file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", code, str(table)], cwd=tmp_path, capture_output=True, check=True)
    assert done.stderr.count(b"ends with") == 4
    assert b"a\\u202eb" in done.stdout
    assert b"a\\u202eb" in done.stderr
    assert not set((done.stdout + done.stderr).decode()) & set("\u202e\u009b\u200f\ufeff\x1b")


def test_progress_bars_keep_what_moves_the_cursor() -> None:
    assert escaped("\r50%\x1b[A\b\u202e", bars=True) == "\r50%\x1b[A\b\\u202e"


def test_a_quiet_command_that_is_refused_leaves_others_loud() -> None:
    """`--quiet` is of one command, also where its other words cannot be parsed."""
    assert run(["simulate", "-q", "--steps", "many"]) == ExitCode.USAGE
    assert not QUIET.get()
