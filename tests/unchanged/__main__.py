"""Whether two checkouts give the same results: `python -m tests.unchanged BASE NEW --kept DIR`.

BASE and NEW are checkouts with an environment in `.venv`, or the Python of an environment. Each side runs the commands
of `commands.txt` on the same inputs. Files must be equal byte for byte, or in value with --rtol and --atol; what
--json prints counts as a file, and other printed words are only mentioned. In the provenance, the version, the versions
of packages and the command may differ. BASE's results are kept in DIR and used again.

    python -m tests.unchanged ../base . --kept ../kept
    python -m tests.unchanged ../base . --kept ../kept --only single,people --rtol 1e-12
    python -m tests.unchanged ../base . --kept ../kept --verdicts
    python -m tests.unchanged ../base . --benchmarks track,occlusion
    python -m tests.unchanged . --mutants occlog/track/methods/jipda/kernels=tests/track/jipda

Exit code 1: something differs, or too few mutants are noticed.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from .compare import Tolerance, first_difference

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
FIRST = "recordings"
PAPERS = ("ercan", "rahimi", "lee", "qu")
PRINTED = "printed"
"""Folder of a section for exit codes and what its commands print."""
ENVIRONMENT = {
    "PYTHONDONTWRITEBYTECODE": "",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MPLBACKEND": "Agg",
    "COLUMNS": "100",
    "TZ": "UTC",
}


def sections(text: str) -> dict[str, list[str]]:
    """Commands by section."""
    found: dict[str, list[str]] = {}
    for line in filter(None, (line.strip() for line in text.splitlines())):
        if line.startswith("["):
            found[line[1:-1]] = lines = []
        elif not line.startswith("#"):
            lines.append(line)
    return found


def python_of(side: Path) -> Path:
    """The Python of a side."""
    return side.absolute() if side.is_file() else side.absolute() / ".venv" / "bin" / "python"


def run_section(python: Path, lines: list[str], folder: Path, limit_s: float) -> None:
    """Run commands in a folder, and keep what each printed, how it ended and how long it took.

    A section that was stopped goes on; from the first command that is another one than before, all are run again.
    """
    printed = folder / PRINTED
    kept = done(folder)
    if [line for line, _ in kept] != lines[: len(kept)]:
        shutil.rmtree(folder, ignore_errors=True)
        kept = []
    printed.mkdir(parents=True, exist_ok=True)
    environment = {**os.environ, **ENVIRONMENT}
    for n, line in list(enumerate(lines))[len(kept) :]:
        words = shlex.split(line.removeprefix("! "))
        program = [python, "-m", "occlog"] if words[0] == "occlog" else [python]
        start = time.monotonic()
        try:
            ended = subprocess.run(
                [*program, *words[1:]],
                cwd=folder,
                env=environment,
                capture_output=True,
                timeout=limit_s,
                stdin=subprocess.DEVNULL,
            )
            code, out, err = ended.returncode, ended.stdout, ended.stderr
        except subprocess.TimeoutExpired as error:
            code, out, err = -1, error.stdout or b"", error.stderr or b""
        (printed / f"{n}.code").write_text(f"{code}\n")
        (printed / f"{n}.out{'.json' if '--json' in words else ''}").write_bytes(out)
        (printed / f"{n}.err").write_bytes(err)
        kept.append((line, time.monotonic() - start))
        (printed / "done.json").write_text(json.dumps(kept, indent=1))


def done(folder: Path) -> list[tuple[str, float]]:
    """The commands of a section that were run, with the seconds of each."""
    stamp = folder / PRINTED / "done.json"
    return [(line, seconds) for line, seconds in json.loads(stamp.read_text())] if stamp.is_file() else []


def run_side(
    python: Path, commands: Mapping[str, list[str]], folder: Path, inputs: Path, workers: int, limit_s: float
) -> None:
    """Run what has not been run."""
    if not (folder / "inputs").exists():
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "inputs").symlink_to(inputs.absolute())
    missing = {name: lines for name, lines in commands.items() if [line for line, _ in done(folder / name)] != lines}
    if FIRST in missing:
        run_section(python, missing.pop(FIRST), folder / FIRST, limit_s)
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(lambda name: run_section(python, missing[name], folder / name, limit_s), missing))


def files(folder: Path) -> dict[str, Path]:
    """Every file of a folder by its path."""
    return {str(path.relative_to(folder)): path for path in sorted(folder.rglob("*")) if path.is_file()}


def differences(lines: list[str], base: Path, new: Path, tolerance: Tolerance) -> Iterator[tuple[str, str, str]]:
    """Of a section: kind (`!` of a fault, `~` of words alone), file or command, and what differs."""
    for n, line in enumerate(lines):
        before, after = ((side / PRINTED / f"{n}.code").read_text().strip() for side in (base, new))
        if before != after:
            error = (new / PRINTED / f"{n}.err").read_text(errors="replace").strip().splitlines()
            yield "!", line, f"exit code {before} and {after}: {error[-1] if error else ''}"
        elif (before not in ("0", "3")) != line.startswith("! ") or before == "1":
            yield "!", line, f"exit code {before} on both sides, which is not what the list expects"
    first, second = files(base), files(new)
    for name in sorted(first.keys() | second.keys()):
        if name == f"{PRINTED}/done.json" or name.endswith(".code"):
            continue
        words = name.startswith(PRINTED) and not name.endswith(".json")
        where = name
        if name.startswith(PRINTED):
            number, _, stream = name.removeprefix(f"{PRINTED}/").partition(".")
            where = f"{stream} of {lines[int(number)]}"
        if name not in first or name not in second:
            yield "!", where, "only in " + ("BASE" if name in first else "NEW")
            continue
        found = first_difference(first[name].read_bytes(), second[name].read_bytes(), name, tolerance)
        if found:
            yield "~" if words else "!", where, found


def compare_outputs(options: argparse.Namespace) -> bool:
    """Run both sides, print what differs; whether nothing does."""
    commands = sections((HERE / "commands.txt").read_text(encoding="utf-8"))
    if options.only:
        names = options.only.split(",")
        unknown = set(names) - commands.keys()
        if unknown:
            sys.exit(f"no section {sorted(unknown)[0]!r}; there are {', '.join(commands)}")
        commands = {name: lines for name, lines in commands.items() if name == FIRST or name in names}
    inputs = options.kept / "inputs"
    if not (inputs / "made.json").exists():
        from .inputs import make_inputs

        shutil.rmtree(inputs, ignore_errors=True)
        inputs.mkdir(parents=True)
        make_inputs(inputs, options.base if options.base.is_dir() else ROOT)
    run_side(python_of(options.base), commands, options.kept / "base", inputs, options.workers, options.limit)
    with tempfile.TemporaryDirectory() as made:
        folder = options.out or Path(made)
        if options.again and options.out:
            shutil.rmtree(folder, ignore_errors=True)
        run_side(python_of(options.new), commands, folder, inputs, options.workers, options.limit)
        same = True
        print(f"{'section':<12}{'commands':>9}{'files':>7}{'differ':>8}{'BASE s':>8}{'NEW s':>8}")
        found_all = []
        for name, lines in commands.items():
            base, new = options.kept / "base" / name, folder / name
            found = list(differences(lines, base, new, Tolerance(options.rtol, options.atol)))
            faults = [row for row in found if row[0] == "!"]
            same = same and not faults
            seconds = [sum(each for _, each in done(side)) for side in (base, new)]
            count = len(files(base)) - 3 * len(lines) - 1
            print(
                f"{name:<12}{len(lines):>9}{count:>7}{len(faults):>8}{seconds[0]:>8.0f}{seconds[1]:>8.0f}", flush=True
            )
            found_all += [(name, *row) for row in found]
        for name, kind, where, what in found_all:
            if kind == "!" or options.words:
                print(f"{kind} {name}: {where}\n      {what}")
    hidden = sum(kind == "~" for _, kind, _, _ in found_all)
    if hidden and not options.words:
        print(f"printed words differ {hidden} times: --words lists them")
    return same


def compare_verdicts(options: argparse.Namespace) -> bool:
    """The quick form of every experiment of the papers on both sides: the same verdicts and figures."""
    lines = [f"occlog reproduce {paper} --all --quick -q -o {paper} --json" for paper in PAPERS]
    commands = {f"verdicts_{paper}": [line] for paper, line in zip(PAPERS, lines, strict=True)}
    run_side(python_of(options.base), commands, options.kept / "base", options.kept, options.workers, 7200)
    with tempfile.TemporaryDirectory() as made:
        folder = options.out or Path(made)
        run_side(python_of(options.new), commands, folder, options.kept, options.workers, 7200)
        same = True
        for name, section in commands.items():
            found = list(
                differences(section, options.kept / "base" / name, folder / name, Tolerance(options.rtol, options.atol))
            )
            faults = [row for row in found if row[0] == "!"]
            same = same and not faults
            print(f"{name}: {'the same' if not faults else f'{len(faults)} files differ'}")
            for _, where, what in faults:
                print(f"! {where}\n      {what}")
    return same


def compare_speed(options: argparse.Namespace) -> bool:
    """Benchmarks of both sides in turn: their own ratios and their times by pairs, within 3 %."""
    names = options.benchmarks.split(",")
    ratios: dict[str, list[float]] = {name: [] for name in names}
    for pair in range(options.pairs):
        sides = [options.base, options.new] if pair % 2 == 0 else [options.new, options.base]
        took: dict[tuple[Path, str], float] = {}
        for side in sides:
            for name in names:
                took[side, name] = _processor_time(side, name)
        for name in names:
            ratios[name].append(took[options.new, name] / took[options.base, name])
    worst = 0.0
    for name, values in ratios.items():
        middle = statistics.median(values)
        worst = max(worst, middle)
        print(f"{name:<14} NEW / BASE in processor time: {middle:.3f} ({min(values):.3f} to {max(values):.3f})")
    return worst <= 1.03


def _processor_time(side: Path, name: str) -> float:
    """Processor time [s] of a benchmark."""
    before = os.times()
    command = [python_of(side), "-m", "benchmarks", name, "--json", "--repeats", "3"]
    ended = subprocess.run(command, cwd=side, env={**os.environ, **ENVIRONMENT}, capture_output=True, text=True)
    after = os.times()
    if ended.returncode:
        sys.exit(f"{name} in {side}: {ended.stderr.strip().splitlines()[-1:]}")
    return after.children_user + after.children_system - before.children_user - before.children_system


def try_mutants(options: argparse.Namespace) -> bool:
    """Mutants of folders of kernels by their own tests: 9 of 10 must be noticed."""
    enough = True
    for pair in options.mutants:
        folder, _, tests = pair.partition("=")
        command = [
            python_of(options.base),
            "-m",
            "tests.mutate",
            folder,
            *tests.split(","),
            "--count",
            str(options.count),
        ]
        command += ["--jit"] if options.jit else []
        ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
        if ended.returncode:
            sys.exit(f"{folder}: {(ended.stderr.strip().splitlines() or ['?'])[-1]}")
        print(ended.stdout.strip(), flush=True)
        noticed, tried = ended.stdout.strip().splitlines()[-1].rpartition(": ")[2].split(" noticed")[0].split(" of ")
        enough = enough and int(noticed) >= 0.9 * int(tried)
    return enough


def main() -> None:
    """Do what the options ask for."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.unchanged", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("base", type=Path, metavar="BASE", help="checkout, or the Python of an environment")
    add("new", type=Path, nargs="?", default=ROOT, metavar="NEW", help="the other one; default: this checkout")
    add("--kept", type=Path, default=ROOT / "build" / "unchanged", help="folder of inputs and BASE's results")
    add("--out", type=Path, help="keep NEW's results in this folder, and use those that are there")
    add("--again", action="store_true", help="with --out: run everything of NEW again")
    add("--only", metavar="A,B,...", help="sections of commands.txt")
    add("--rtol", type=float, default=0.0, help="relative tolerance of numbers; default: bytes are equal")
    add("--atol", type=float, default=0.0, help="absolute tolerance of numbers")
    add("--words", action="store_true", help="list printed words that differ, too")
    add("--workers", type=int, default=1, help="sections at a time; default 1")
    add("--limit", type=float, default=300.0, help="seconds of a command; default 300")
    add("--verdicts", action="store_true", help="compare what `reproduce --all --quick` says instead")
    add("--benchmarks", metavar="A,B,...", help="compare the times of these benchmarks instead")
    add("--pairs", type=int, default=5, help="pairs of runs of benchmarks; default 5")
    add("--mutants", nargs="+", metavar="FOLDER=TESTS,...", help="try mutants of BASE's kernels instead")
    add("--count", type=int, default=50, help="mutants of a folder; default 50")
    add("--jit", action="store_true", help="with --mutants: compile the kernels")
    options = parser.parse_args()
    if options.verdicts:
        same = compare_verdicts(options)
    elif options.benchmarks:
        same = compare_speed(options)
    elif options.mutants:
        same = try_mutants(options)
    else:
        same = compare_outputs(options)
    sys.exit(0 if same else 1)


if __name__ == "__main__":
    main()
