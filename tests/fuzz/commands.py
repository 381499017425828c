"""Runs whole commands on changed inputs: what `python -m tests.fuzz --commands` does, and `commands.txt` lists.

An input is a command with one file changed (bytes, structure, emptied, cut, or swapped with another file), or with one
value of its options changed.  Each runs in a process of its own, forked from one that has run the unchanged command.
"""

from __future__ import annotations

import gc
import hashlib
import importlib
import json
import os
import pkgutil
import re
import resource
import shlex
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import cv2
import pyarrow.parquet as pq
from mcap.reader import make_reader

import occlog
from occlog.cli.main import run
from occlog.console.text import escaped
from occlog.errors import ExitCode
from occlog.pipeline.executors import chosen
from occlog.pipeline.executors.interface import InThisProcess

from . import seeds
from .mutations import LONGEST, MCAP, PARQUET, ZIP, Layer, changed, draw
from .structure import restructured

HERE = Path(__file__).resolve().parent
PROCESSOR_S, WAITED_S = 20, 60
"""Limits of a command: processor time, and time [s]."""
MEMORY_MB = 2048
ADDRESS_SPACE = 4 << 30
"""Address space beyond that of the process that forks [bytes]."""
LAYERS = {".mcap": MCAP, ".parquet": PARQUET, ".zip": ZIP}
VALUES = (
    "0",
    "-1",
    "0.5",
    "-0.5",
    "1e-9",
    "1e308",
    "nan",
    "inf",
    "-inf",
    "",
    "x",
    "1,2",
    "9" * 30,
    "\u202e",
    "../x",
    "1:0",
)
CODES = frozenset({0, 2, 3, 4, 5, 6, 7})
REFUSED = frozenset({ExitCode.USAGE, ExitCode.BAD_INPUT, ExitCode.EXISTS})
FOLDERS = ("run", "batch", "sweep", "start")
"""Commands that keep the outputs of stages that were completed."""
LONG_LINE = 400
"""Characters of a message: files, place, value, limit and remedy need fewer."""


class Attempt(NamedTuple):
    """A command to try, with what is changed: a file (None: an option) and its content."""

    words: list[str]
    file: str | None
    data: bytes


class Ended(NamedTuple):
    """How a command ended: exit code (negative: a signal), what it printed, time [s], memory [MB], and its folder."""

    code: int
    out: str
    err: str
    seconds: float
    megabytes: float


class Fault(NamedTuple):
    """A finding: what tells its kind from others, and the words that show it."""

    kind: str
    detail: str


@cache
def sections() -> dict[str, list[str]]:
    """Command lines by section of `commands.txt`."""
    from tests.unchanged.__main__ import sections as read

    return read((HERE / "commands.txt").read_text(encoding="utf-8"))


def make(folder: Path) -> None:
    """Make the inputs of all commands in a folder, where an earlier run has not made them."""
    done = folder.with_name("made.json")
    lines = json.loads(done.read_text()) if done.is_file() else []
    if lines != sections()["inputs"][: len(lines)] or not lines:
        lines = []
        shutil.rmtree(folder, ignore_errors=True)
        _make_files(folder)
    for line in sections()["inputs"][len(lines) :]:
        code = in_child(folder, shlex.split(line)[1:], limits=False).code
        if code not in (0, 3):
            raise SystemExit(f"exit code {code}: {line}")
        lines.append(line)
        done.write_text(json.dumps(lines))


def _make_files(folder: Path) -> None:
    import ros1_bags
    import ros_bags
    import stream_samples

    from tests.unchanged.inputs import make_inputs

    make_inputs(folder, HERE.parents[1])
    for heavy in [*folder.glob("sample_data/*/*.mp4"), *folder.glob("sample_data/room/*")]:
        heavy.unlink()
    ros1_bags.write_bag(folder / "ros1.bag", ros_bags.two_cameras(2))
    messages = [("foxglove.CompressedVideo", "json", seeds.video_message(n)) for n in range(len(stream_samples.H264))]
    (folder / "video.mcap").write_bytes(seeds.foxglove_bag(messages))
    (folder / "small.avi").write_bytes(seeds.videos_avi()[0])
    (folder / "tracks.gpx").write_text(seeds.GPX)
    (folder / "pair.json").write_text(seeds.EPIPOLAR.replace("cam1", "a").replace("cam2", "b"))
    rows = "".join(f"a,b,{37 * k % 640},{91 * k % 480},{53 * k % 640},{29 * k % 480}\n" for k in range(12))
    (folder / "pair.csv").write_text(seeds.MATCHES.partition("\n")[0] + f"\n{rows}")
    (folder / "ellipses.csv").write_text(seeds.ELLIPSES.replace("view1", "1").replace("3\n", "0\n"))
    bearings = ("southwest,0.64", "southeast,2.5", "northeast,-2.5", "northwest,-0.64")
    rows = "".join(f"{n / 10},{row},0.05\n" for n in range(8) for row in bearings)
    (folder / "bearings.csv").write_text(f"time,sensor,bearing_rad,sigma_rad\n{rows}")
    stages = "track: {particles: 20}\nevaluate: {}\n"
    (folder / "walk.yaml").write_text(f"occlog_run: 1\nrecording: walk.mcap\n{stages}report: {{}}\n")
    (folder / "each.yaml").write_text(f"occlog_run: 1\n{stages}")
    tiny = folder / "tiny"
    shutil.copytree(folder / "sample_data/boxes", tiny)
    for name, rows in (("left.csv", 40), ("right.csv", 40), ("truth.csv", 40)):
        text = (tiny / name).read_text().splitlines(keepends=True)
        (tiny / name).write_text("".join(text[:rows]))
    (tiny / "plain.yaml").write_text((tiny / "run.yaml").read_text().partition("report:")[0])
    for name in ("README.md", "make.py"):
        (tiny / name).unlink()
    sweep = (folder / "sweep.yaml").read_text().replace("examples/", "../examples/")
    (tiny / "sweep.yaml").write_text(sweep.replace("steps: 60", "steps: 6").replace("200", "20"))


def inputs_of(line: str, folder: Path) -> tuple[list[str], list[str]]:
    """Words of a command, and the names of the files that may be changed."""
    command, _, more = line.partition(" | ")
    words = shlex.split(command)[1:]
    found: dict[str, None] = {}
    for word in [*(part for each in words for part in (each, each.rpartition("=")[2])), *more.split()]:
        path = folder / word
        if path.is_file():
            found[word] = None
        elif word and path.is_dir():
            found |= dict.fromkeys(str(p.relative_to(folder)) for p in sorted(path.rglob("*")) if p.is_file())
    return words, list(found)


def draw_attempt(line: str, folder: Path, random: Random) -> Attempt:
    """A changed command."""
    words, files = inputs_of(line, folder)
    options = [n for n in range(1, len(words)) if words[n - 1].startswith("--") and not (folder / words[n]).exists()]
    options = options if files else [len(words) - 1]
    if options and (not files or random.random() < 0.15):
        return Attempt(_with_option(words, random.choice(options), random), None, b"")
    name = random.choice(files)
    data = (folder / name).read_bytes()
    others = [each for each in files if Path(each).suffix == Path(name).suffix]
    others = random.choice(
        (others, files, [str(p.relative_to(folder)) for p in sorted(folder.iterdir()) if p.is_file()])
    )
    other = (folder / random.choice(others)).read_bytes()
    match random.choices(("structure", "bytes", "swap", "cut", "empty"), (10, 7, 1, 1, 0.2))[0]:
        case "structure":
            with suppress(Exception):  # a file without structure, or values that a library cannot write
                return Attempt(words, name, restructured(data, random))
        case "swap":
            return Attempt(words, name, other)
        case "cut":
            return Attempt(words, name, data[: random.randrange(len(data) + 1)])
        case "empty":
            return Attempt(words, name, b"")
    layer: Layer | None = LAYERS.get(Path(name).suffix)
    long = data[LONGEST:]  # `changed` keeps files short
    return Attempt(
        words, name, changed(data[:LONGEST] if long else data, draw(random, _is_text(data)), other, layer) + long
    )


def _with_option(words: list[str], n: int, random: Random) -> list[str]:
    """The words with one value of an option, or a number in it, another."""
    new = random.choice(VALUES)
    numbers = list(re.finditer(r"\d+(?:\.\d+)?", words[n]))
    if numbers and random.random() < 0.7:
        at = random.choice(numbers)
        new = words[n][: at.start()] + new + words[n][at.end() :]
    return [*words[:n], new, *words[n + 1 :]]


def _is_text(data: bytes) -> bool:
    return b"\0" not in data[:4096] and not data.startswith((b"\x89", b"PAR1", b"PK", b"RIFF"))


def in_child(folder: Path, words: list[str], *, limits: bool = True) -> Ended:
    """Run a command in a folder, in a forked process with limits, and end all processes that it left."""
    printed = _printed(folder)
    begin = time.monotonic()
    child = os.fork()
    if not child:
        code = int(ExitCode.BUG)
        try:
            os.setpgid(0, 0)
            _prepare(folder, printed, limits)
            code = run(words)
            sys.stdout.flush()
            sys.stderr.flush()
        except BaseException:  # `run` lets nothing through but a kill
            traceback.print_exc()
        finally:
            os._exit(code)
    with suppress(OSError):
        os.setpgid(child, child)
    status, usage = None, None
    while status is None:
        done, state, used = os.wait4(child, os.WNOHANG)
        if done:
            status, usage = state, used
        elif limits and time.monotonic() - begin > WAITED_S:
            os.killpg(child, signal.SIGKILL)
            _, status, usage = os.wait4(child, 0)
        else:
            time.sleep(0.004)
    with suppress(OSError):
        os.killpg(child, signal.SIGKILL)
    out, err = ((printed / name).read_text(errors="replace") for name in ("out", "err"))
    megabytes = (usage.ru_maxrss if usage else 0) / 1024
    return Ended(os.waitstatus_to_exitcode(status), out, err, time.monotonic() - begin, megabytes)


def _printed(folder: Path) -> Path:
    """Where what commands in a folder print goes: a folder next to it."""
    printed = folder.with_name(f"{folder.name}.printed")
    printed.mkdir(exist_ok=True)
    return printed


def _prepare(folder: Path, printed: Path, limits: bool) -> None:
    """Let this process work in a folder, print to files, and have limits."""
    warnings.simplefilter("ignore")  # as the program does
    os.chdir(folder)
    for number, name in ((1, "out"), (2, "err")):
        target = os.open(printed / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(target, number)
        os.close(target)
    empty = os.open(os.devnull, os.O_RDONLY)
    os.dup2(empty, 0)
    for name, number in (("stdout", 1), ("stderr", 2)):
        setattr(sys, name, open(number, "w", encoding="utf-8", errors="backslashreplace", closefd=False))  # noqa: SIM115
    if limits:
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + ADDRESS_SPACE, resource.RLIM_INFINITY))
        spent = int(sum(resource.getrusage(resource.RUSAGE_SELF)[:2]))
        resource.setrlimit(resource.RLIMIT_CPU, (spent + PROCESSOR_S, spent + PROCESSOR_S + 5))


def links(made: Path, folder: Path) -> None:
    """A folder with the made files; what is written into it leaves these as they are."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(made, folder, copy_function=os.link)


def tried(made: Path, folder: Path, attempt: Attempt) -> tuple[Ended, Fault | None]:
    """Run a changed command in a new folder."""
    links(made, folder)
    if attempt.file is not None:
        (folder / attempt.file).unlink()
        (folder / attempt.file).write_bytes(attempt.data)
    before = stamps(folder)
    ended = in_child(folder, attempt.words)
    return ended, fault(attempt.words, ended, folder, before)


def stamps(folder: Path) -> dict[str, tuple[int, int]]:
    """Size and time of change of every file."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            state = path.stat()
            found[str(path.relative_to(folder))] = (state.st_size, state.st_mtime_ns)
    return found


def fault(words: list[str], ended: Ended, folder: Path, before: dict[str, tuple[int, int]]) -> Fault | None:
    """What is wrong with how a command ended; None where nothing is."""
    return next(_faults(words, ended, folder, before), None)


def _faults(words: list[str], ended: Ended, folder: Path, before: dict[str, tuple[int, int]]) -> Iterator[Fault]:
    lines = ended.err.splitlines()
    last = lines[-1][:600] if lines else ""
    form = " ".join(re.findall(r"[A-Za-z]{2,}", last))[:80]
    if ended.code == -signal.SIGXCPU or (ended.code == -signal.SIGKILL and ended.seconds > WAITED_S):
        yield Fault(f"hang of {words[0]}", f"{ended.seconds:.0f} s; {last}")
    if "Traceback" in ended.err or ended.code == ExitCode.BUG:
        place = re.search(r"a bug of occlog [^:]*: (\w+):.*?(\([\w/.]+:\d+\))", ended.err)
        yield Fault(" ".join(place.groups()) if place else f"traceback: {form}", ended.err[-600:])
    if ended.code not in CODES:
        yield Fault(f"exit code {ended.code} of {words[0]}", last)
    if ended.megabytes > MEMORY_MB:
        yield Fault(f"memory of {words[0]}", f"{ended.megabytes:.0f} MB")
    after = stamps(folder)
    written = {name for name in after if name not in before}
    if changed_inputs := [name for name in before if after.get(name) != before[name]]:
        yield Fault(f"input changed by {words[0]}", ", ".join(changed_inputs))
    if ended.code in REFUSED and words[0] not in FOLDERS and written:
        yield Fault(f"left behind by {words[0]}", ", ".join(sorted(written)))
    for name in sorted(written):
        if why := incomplete(folder / name):
            yield Fault(f"incomplete {Path(name).suffix} of {words[0]}", f"{name}: {why}")
    for line in lines:
        if not line.startswith(("occlog: ", "{")):
            yield Fault(
                f"a line without occlog: {words[0]} {' '.join(re.findall('[A-Za-z]{2,}', line))[:60]}", line[:300]
            )
        if len(line) > LONG_LINE:
            yield Fault(f"a long line: {words[0]} {form}", line)
    if ended.code in REFUSED and words[0] != "doctor":  # which prints its findings
        errors = [line for line in lines if line.startswith(("occlog: error: ", "{"))]
        if len(errors) != 1:
            yield Fault(f"{len(errors)} error lines of {words[0]}", ended.err[-600:])
        elif ended.code == ExitCode.BAD_INPUT and not any(_names(errors[0], name) for name in (*before, *words)):
            yield Fault(f"no file in the message: {form}", last)
    if "--json" in words and ended.code not in REFUSED and (why := _json_error(ended.out)):
        yield Fault(f"JSON of {words[0]}", why)


def _names(line: str, name: str) -> bool:
    """Whether a message names a file or the folder that it is in, or an option or its value."""
    if name.startswith("--") and name in line:
        return True
    path = Path(name.rpartition("=")[2])
    whole = f" {escaped(name) or '.'}: " in line or repr(name) in line
    return whole or bool(path.suffix and path.name in line) or any(part in line for part in path.parts[:-1])


def incomplete(path: Path) -> str:
    """Why an output is not complete; nothing where it is."""
    if path.name.startswith((".", "tmp")) or path.suffix in (".tmp", ".part"):
        return "a temporary file"
    try:
        match path.suffix:
            case ".parquet":
                pq.read_table(path)
            case ".mcap":
                with path.open("rb") as file:
                    if make_reader(file).get_summary() is None:
                        return "no summary"
            case ".json" | ".geojson":
                return _json_error(path.read_text(encoding="utf-8"))
            case ".html":
                return "" if path.read_text(encoding="utf-8").rstrip().endswith("</html>") else "no end"
    except Exception as error:  # of libraries that read
        return f"{type(error).__name__}: {error}"
    return "" if path.stat().st_size or path.suffix in (".txt", ".lock", ".log") else "empty"


def _json_error(text: str) -> str:
    def refuse(word: str) -> None:
        raise ValueError(f"{word} is not JSON")

    try:
        json.loads(text, parse_constant=refuse)
    except ValueError as error:
        return str(error)[:200]
    return ""


def try_commands(
    names: list[str], count: int, seconds: float, seed: int, out: Path
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Try commands, `count` inputs over all of their lines; yield what was counted and found of each command."""
    out = out.resolve()
    for module in pkgutil.walk_packages(occlog.__path__, "occlog."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    cv2.setNumThreads(0)
    # An attempt is a process already; new ones of a batch would import everything again
    chosen.Processes = lambda _: InThisProcess()  # type: ignore[misc,assignment]
    root = Path(tempfile.mkdtemp(prefix="occlog-fuzz-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    try:
        make(out / "made")
        shutil.copytree(out / "made", root / "made")
        lines = sum(len(sections()[name]) for name in names)
        for name in names:
            findings: dict[str, Any] = {"inputs": 0, "seconds": 0.0, "codes": Counter(), "findings": {}}
            for line in sections()[name]:
                server = os.fork()
                if not server:
                    with suppress(BaseException):
                        drawn = seed ^ zlib.crc32(line.encode())
                        found = _try_line(line, -(-count // lines), seconds / lines, drawn, root, out)
                        (root / "told.json").write_text(json.dumps(found))
                    os._exit(0)
                os.waitpid(server, 0)
                found = json.loads((root / "told.json").read_text())
                (root / "told.json").unlink()
                findings["inputs"] += found["inputs"]
                findings["seconds"] += found["seconds"]
                findings["codes"].update(found["codes"])
                findings["findings"] = found["findings"] | findings["findings"]
            yield name, findings
    finally:
        shutil.rmtree(root)


def _try_line(line: str, count: int, seconds: float, seed: int, root: Path, out: Path) -> dict[str, Any]:
    """Try changes of one command line in children of this process, which has loaded what the command needs."""
    made, folder, random = root / "made", root / "work", Random(seed)
    codes: Counter[str] = Counter()
    findings: dict[str, str] = {}
    links(made, folder)
    _prepare(folder, _printed(folder), limits=False)
    before = stamps(folder)
    words = inputs_of(line, made)[0]
    ended = Ended(run(words), "{}", "", 0.0, 0.0)
    first = fault(words, ended, folder, before)
    if ended.code in REFUSED or first:
        findings[f"unchanged: {line}"] = f"exit code {ended.code} {(_printed(folder) / 'err').read_text()} {first}"
    gc.freeze()
    begin = time.monotonic()
    while sum(codes.values()) < count and time.monotonic() < begin + seconds:
        attempt = draw_attempt(line, made, random)
        ended, found = tried(made, folder, attempt)
        codes[str(ended.code)] += 1
        if found and found.kind not in findings:
            findings[found.kind] = found.detail
            keep(out / f"finding-{hashlib.sha256(found.kind.encode()).hexdigest()[:8]}", attempt, found)
    return {"inputs": sum(codes.values()), "seconds": time.monotonic() - begin, "codes": codes, "findings": findings}


def keep(folder: Path, attempt: Attempt, found: Fault) -> None:
    """Write the attempt of a finding."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "finding.json").write_text(json.dumps({"words": attempt.words, "file": attempt.file, **found._asdict()}))
    (folder / "data").write_bytes(attempt.data)
