"""Tries every reader on many changed files: `python -m tests.fuzz [READER ...] --inputs 1000000 --out FOLDER`.

Each reader runs in a process of its own, so that a crash is a finding as well.  With atheris (extra `fuzz`) changes
that reach new code are kept and changed again; without it all are drawn from good files.  With `--grown BYTES` a piece
of a good file is repeated until there are so many bytes: what takes longer than it may shows.  Each kind of finding is
written once, as the bytes that show it and a line that says what happened.  Prints one line a reader, and ends with 1
if there is a finding.  A run with the same seed draws the same changes.

With `--commands` whole commands are tried (`commands.py`), by the names of commands in place of those of readers.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import importlib.util
import json
import mmap
import os
import resource
import signal
import sys
import time
import zlib
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from random import Random

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/reference" / name) for name in ("", "forms", "scenes", "video", "peers")]
SPARE = 4 << 30
"""Address space beyond what the process has when it begins [bytes]: a bomb is an error, and not the machine's end."""
KEPT = 300
"""Changed files that are changed again, at most, of the run without atheris: those whose outcome was new."""
TELL_S = 1.0
LONGEST = 64 << 20
"""Bytes of an input that are kept for the case of a crash."""


class Current:
    """The input that is read now, in memory that a process shares with its children: a crash leaves it there."""

    def __init__(self) -> None:
        self._memory = mmap.mmap(-1, LONGEST + 8)

    def put(self, data: bytes) -> None:
        """Keep an input; of one that is too long, its beginning."""
        data = data[:LONGEST]
        self._memory[:8] = len(data).to_bytes(8, "little")
        self._memory[8 : 8 + len(data)] = data

    def get(self) -> bytes:
        """The input that was kept last."""
        return self._memory[8 : 8 + int.from_bytes(self._memory[:8], "little")]


def attempt(name: str, options: argparse.Namespace, seed: int, out: Path, current: Current) -> None:
    """Try one reader, in this process; what was found goes to `out`."""
    from tests.fuzz.mutations import changed, draw, grown
    from tests.fuzz.readers import READERS
    from tests.fuzz.watch import watching

    seconds, inputs = options.seconds, options.inputs
    guided = "atheris" in sys.modules and not options.grown
    reader = READERS[name]
    seeds = reader.seeds
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + SPARE, resource.RLIM_INFINITY))
    begin, reported = time.monotonic(), 0.0
    counts: Counter[str] = Counter()
    findings: dict[str, str] = {}
    random = Random(seed)
    text = all(map(_is_text, seeds))

    def tell() -> None:
        elapsed = time.monotonic() - begin
        done = {"reader": name, "inputs": sum(counts.values()), "seconds": round(elapsed, 1), "guided": guided}
        (out / "done.json").write_text(json.dumps({**done, "counts": dict(counts), "findings": findings}))

    with watching() as watch:

        def one(data: bytes) -> str:
            nonlocal reported
            current.put(data)
            outcome = watch.outcome(reader, data)
            counts["finding" if outcome.found else outcome.kind] += 1
            if outcome.found and outcome.kind not in findings:
                findings[outcome.kind] = outcome.detail
                (out / f"finding-{hashlib.sha256(outcome.kind.encode()).hexdigest()[:8]}").write_bytes(data)
                tell()
            elapsed = time.monotonic() - begin
            if elapsed - reported > TELL_S or sum(counts.values()) == inputs:
                reported = elapsed
                tell()
            if outcome.found:  # nothing begins there again: what takes long would
                return ""
            return outcome.kind if outcome.kind != "refused" else _form(outcome.detail)

        for data in seeds:
            one(data)
        while options.grown and sum(counts.values()) < inputs and time.monotonic() - begin < seconds:
            one(grown(random.choice(seeds), random, options.grown, reader.layer))
        if guided:
            _guided(
                one,
                lambda d, r: changed(d, draw(r, text), r.choice(seeds), reader.layer),
                seeds,
                inputs,
                seconds,
                seed,
                out,
            )
        elif not options.grown:
            # Half begin at a good file: the others are of many kinds, but most of these are refused at once.
            pool, known = list(seeds), set[str]()
            while sum(counts.values()) < inputs and time.monotonic() - begin < seconds:
                start = random.choice(seeds if random.random() < 0.5 else pool)
                new = one(data := changed(start, draw(random, text), random.choice(seeds), reader.layer))
                if new and new not in known and len(known) < KEPT:
                    known.add(new)
                    pool.append(data)
        tell()


def _import_traced() -> None:
    """Import the readers so that libFuzzer sees which lines of files and records run."""
    import atheris

    package = ROOT / "occlog"
    modules = [path.relative_to(ROOT).with_suffix("").parts for path in package.rglob("*.py")]
    names = [".".join(parts[:-1] if parts[-1] == "__init__" else parts) for parts in modules]
    silent, error = os.open(os.devnull, os.O_WRONLY), os.dup(2)
    os.dup2(silent, 2)  # every module is stated there
    with atheris.instrument_imports(
        include=["occlog"],
        exclude=[name for name in names if not name.startswith(("occlog.io.", "occlog.records."))],
        enable_loader_override=False,
    ):
        importlib.import_module("tests.fuzz.readers")
    os.dup2(error, 2)
    os.close(silent)
    os.close(error)


def _form(line: str) -> str:
    """A line without the numbers and the words that come from the file: what code path refused it."""
    return " ".join(word for word in line.split() if word.isalpha())


def _is_text(data: bytes) -> bool:
    try:
        return "\0" not in data.decode()
    except UnicodeDecodeError:
        return False


def _guided(
    one: Callable[[bytes], str],
    change: Callable[[bytes, Random], bytes],
    seeds: list[bytes],
    inputs: int,
    seconds: float,
    seed: int,
    out: Path,
) -> None:
    """Let libFuzzer choose what to change; it knows which changes reached new code.  It ends the process."""
    import atheris

    corpus = out / "corpus"
    corpus.mkdir(exist_ok=True)
    for data in seeds:
        (corpus / hashlib.sha256(data).hexdigest()[:16]).write_bytes(data)
    flags = [f"-runs={inputs}", f"-max_total_time={int(seconds)}", f"-seed={seed}", "-max_len=262144", "-verbosity=0"]
    flags += ["-handle_alrm=0", "-timeout=60", "-rss_limit_mb=0", "-len_control=0", f"-artifact_prefix={out}/"]
    atheris.Setup(
        [sys.argv[0], *flags, str(corpus)],
        lambda data: one(bytes(data)) and None,
        custom_mutator=lambda data, most, number: change(bytes(data), Random(number))[:most],
    )
    atheris.Fuzz()


def run(name: str, options: argparse.Namespace) -> dict[str, object]:
    """Try one reader in a process of its own; what it stated."""
    out: Path = options.out / name.replace(" ", "-").replace("(", "").replace(")", "").replace(",", "").lower()
    out.mkdir(parents=True, exist_ok=True)
    current = Current()
    child = os.fork()
    if not child:
        status = 1
        try:
            attempt(name, options, options.seed ^ zlib.crc32(name.encode()), out, current)
            status = 0
        except SystemExit as end:
            status = int(end.code or 0)
        finally:
            sys.stdout.flush()
            os._exit(status)
    _, status = os.waitpid(child, 0)
    result: dict[str, object] = json.loads((out / "done.json").read_text()) if (out / "done.json").is_file() else {}
    code = os.waitstatus_to_exitcode(status)
    if code:
        (out / "input").write_bytes(current.get())
        what = signal.Signals(-code).name if code < 0 else f"exit {code}"
        result.setdefault("findings", {})[f"crash {what}"] = "the last input is in `input`"  # type: ignore[index]
    return {"reader": name, "inputs": 0, "seconds": 0.0, **result}


def _commands(options: argparse.Namespace) -> int:
    """Try commands; the number of findings."""
    commands = importlib.import_module("tests.fuzz.commands")
    names = [n for n in commands.sections() if n != "inputs" and (not options.readers or n in options.readers)]
    total = 0
    for name, reported in commands.try_commands(names, options.inputs, options.seconds, options.seed, options.out):
        total += len(reported["findings"])
        codes = ", ".join(f"{code}: {count}" for code, count in sorted(reported["codes"].items()))
        print(f"{name:12} {reported['inputs']:>6} inputs {reported['seconds']:>7.1f} s  exit codes {codes}", flush=True)
        for kind, detail in reported["findings"].items():
            print(f"    {kind}: {detail}", flush=True)
    return total


def main() -> None:
    """Try readers one after another."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("readers", nargs="*", help="names of readers, or their beginnings; none: all")
    parser.add_argument("--inputs", type=int, default=1_000_000, help="for each reader; default 1000000")
    parser.add_argument("--seconds", type=float, default=86_400, help="for each reader, at most; default a day")
    parser.add_argument("--seed", type=int, default=1, help="of the draw; default 1")
    parser.add_argument("--grown", type=int, default=0, metavar="BYTES", help="repeat pieces up to so many bytes")
    parser.add_argument("--commands", action="store_true", help="try whole commands; --inputs are for all together")
    parser.add_argument("--out", type=Path, default=Path("fuzz"), help="folder of findings; default fuzz")
    options = parser.parse_args()
    if options.commands:
        sys.exit(1 if _commands(options) else 0)
    if importlib.util.find_spec("atheris") is not None:
        _import_traced()
    names = importlib.import_module("tests.fuzz.readers").READERS
    chosen = [n for n in names if not options.readers or any(n.startswith(word) for word in options.readers)]
    total = 0
    for name in chosen:
        reported = run(name, options)
        findings: dict[str, str] = reported.get("findings", {})  # type: ignore[assignment]
        total += len(findings)
        print(
            f"{name:32} {reported['inputs']:>9} inputs {reported['seconds']:>8} s  {len(findings)} findings", flush=True
        )
        for kind, detail in findings.items():
            print(f"    {kind}: {detail}", flush=True)
    sys.exit(1 if total else 0)


if __name__ == "__main__":
    main()
