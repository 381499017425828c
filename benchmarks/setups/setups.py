"""Whether occlog names the fault of a set-up, and is silent about sound ones.

    python -m benchmarks.setups.setups [--quick] [--seed N] [--only GROUP,...] [--kinds WORDS,...] [--json]

`faults`: 100 set-ups of 20 s with one fault each, `clean`: 100 without any, of rooms, numbers of cameras and people,
lenses, frame rates and detectors drawn from seeds.  `rigs`: 20 rigs each of 2, 4 and 8 cameras with a fault of one
camera, or of two, `sound-rigs`: the same without.  `calibrations`: 40 rigs with an error of a pose, lens or clock, or
of all files of a kind.  A fault counts as named if the first warning of `ingest`, `track` or `evaluate`, or a refusal,
names its cause, and the camera (of two that are late to each other, or exchanged: one of them); a note that a camera is
rotated counts as a last warning.  A sound set-up counts as an alarm if there is any warning; such notes, of less than a
degree, are none.  Identity switches that are stated and happen are no alarm, and no answer.  Seeds 20,000 to 31,999,
60,000 to 64,999, 200,000 to 204,999, 300,000 to 304,999, 360,000 to 364,999, 370,000 to 384,999, 390,000 to 424,999,
640,000 to 646,999, 730,000 to 736,999, 830,000 to 846,999 and 880,000 to 886,999 were used in development.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.setups._clocks import CLOCKS
from benchmarks.setups._faults import CALIBRATIONS, FAULTS
from benchmarks.setups._judge import ROTATED, Answer, Said, people
from benchmarks.setups._others import OTHERS
from benchmarks.setups._rigs import rig, write, write_truth

NAME = "setups"
SUMMARY = "share of set-ups with one fault of which the fault is not named first, and of sound ones with a warning"
LIMIT = 0.1
SEED, QUICK = 50_000, 10
"""First seed, and every how manieth set-up the quick choice takes."""
RIGS, PER_SIZE = (2, 4, 8), 20
GROUPS = ("faults", "clean", "rigs", "sound-rigs", "calibrations", "clocks", "sound-clocks")
SOUND_CLOCKS = 3
"""Recordings without a fault of each kind of `CLOCKS`."""


class Case(NamedTuple):
    """A set-up: its name, how to run it in a folder, and what must be said of it; None: nothing."""

    name: str
    run: Callable[[Path], tuple[list[Said], Answer | None]]


class Outcome(NamedTuple):
    """What was said of a set-up: `named`, `other` (another cause first), `silent`, or `clean`, `alarm`."""

    name: str
    result: str
    said: list[Said]
    answer: Answer | None
    seconds: float


def _rig_case(kind: str | None, seed: int, cameras: int | None = None) -> Case:
    """A rig with a fault, or without one."""

    def run(folder: Path) -> tuple[list[Said], Answer | None]:
        made = rig(seed, cameras)
        answer = None
        if kind is not None:
            fault, other = (FAULTS | CALIBRATIONS)[kind], seed
            while len(made.names) < fault.cameras:
                other += 1_000_003
                made = rig(other, cameras)
            answer = fault.make(made, np.random.default_rng((seed, 5)))
        files = write(made, folder)
        return people(files, write_truth(folder / "true.csv", made.true_positions()), made.fps), answer

    return Case(f"{kind or 'sound'}, seed {seed}" + (f", {cameras} cameras" if cameras else ""), run)


def _other_case(kind: str, seed: int, faulty: bool) -> Case:
    """A set-up without boxes on the ground."""

    def run(folder: Path) -> tuple[list[Said], Answer | None]:
        other = OTHERS[kind]
        return other.run(folder, seed, faulty), other.answer if faulty else None

    return Case(f"{kind}{'' if faulty else ': sound'}, seed {seed}", run)


def _clock_case(kind: str, seed: int, faulty: bool) -> Case:
    """Files with times."""

    def run(folder: Path) -> tuple[list[Said], Answer | None]:
        said, answer = CLOCKS[kind].run(folder, seed, faulty)
        return said, answer if faulty else None

    return Case(f"{kind}{'' if faulty else ': sound'}, seed {seed}", run)


def cases(group: str, seed: int) -> Iterator[Case]:
    """Set-ups of a group; seeds of different groups differ."""
    if group == "calibrations":
        kinds = [kind for kind, fault in CALIBRATIONS.items() for _ in range(fault.count)]
        yield from (_rig_case(kind, seed + 4000 + n) for n, kind in enumerate(kinds))
    elif group in ("clocks", "sound-clocks"):
        faulty = group == "clocks"
        chosen = [kind for kind, each in CLOCKS.items() for _ in range(each.count if faulty else SOUND_CLOCKS)]
        yield from (_clock_case(kind, seed + (5000 if faulty else 6000) + n, faulty) for n, kind in enumerate(chosen))
    elif group == "faults":
        kinds = [kind for kind, fault in FAULTS.items() for _ in range(fault.count)]
        yield from (_rig_case(kind, seed + n) for n, kind in enumerate(kinds))
        others = [kind for kind, other in OTHERS.items() for _ in range(other.count)]
        yield from (_other_case(kind, seed + 500 + n, True) for n, kind in enumerate(others))
    elif group == "clean":
        others = [kind for kind, other in OTHERS.items() for _ in range(other.count)]
        yield from (_rig_case(None, seed + 1000 + n) for n in range(100 - len(others)))
        yield from (_other_case(kind, seed + 1500 + n, False) for n, kind in enumerate(others))
    else:
        base = seed + (2000 if group == "rigs" else 3000)
        for n in range(PER_SIZE * len(RIGS)):
            count = RIGS[n % len(RIGS)]
            kinds = [kind for kind, fault in FAULTS.items() if fault.of_camera and fault.cameras <= count]
            yield _rig_case(kinds[n // len(RIGS) % len(kinds)] if group == "rigs" else None, base + n, count)


def judged(case: Case) -> Outcome:
    """Run a set-up."""
    begin = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        said, answer = case.run(Path(folder))
    if answer is None:
        alarms = [each for each in said if each.id != "note" or ROTATED not in each.text]
        result = "alarm" if alarms else "clean"
    else:
        result = "silent" if not said else "named" if answer.fits(said[0]) else "other"
    return Outcome(case.name, result, said, answer, time.process_time() - begin)


def measured(
    groups: list[str], seed: int, step: int, kinds: list[str], show: Callable[[Outcome], None]
) -> dict[str, Any]:
    """Counts of what was said, by group."""
    out: dict[str, Any] = {}
    for group in groups:
        counts: dict[str, int] = {}
        for case in list(cases(group, seed))[::step]:
            if not kinds or any(words in case.name for words in kinds):
                found = judged(case)
                counts[found.result] = counts.get(found.result, 0) + 1
                show(found)
        out[group] = counts
    return out


def run(repeats: int = 5) -> dict[str, Any]:
    """The quick choice, as a benchmark; seeds are fixed, so that repeats would be the same."""
    del repeats
    counts = measured(list(GROUPS), SEED, QUICK, [], lambda _: None)
    total = sum(sum(each.values()) for each in counts.values())
    good = sum(each.get("named", 0) + each.get("clean", 0) for each in counts.values())
    parts = {f"{group}: {result}": n for group, each in counts.items() for result, n in each.items()}
    return {"ratio": 1.0 - good / total, "limit": LIMIT, "parts": parts}


def _print(found: Outcome) -> None:
    """One set-up for a person, with what was said if that was wrong."""
    print(f"{found.result:<7} {found.name} ({found.seconds:.1f} s)")
    if found.result not in ("named", "clean"):
        print("".join(f"        {said}\n" for said in found.said[:4]), end="", flush=True)


def main() -> None:
    """Run the set-ups, and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help=f"every {QUICK}th set-up")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--only", default=",".join(GROUPS), help="groups, with commas")
    parser.add_argument("--kinds", default="", help="only set-ups with one of these words in their name")
    parser.add_argument("--json", action="store_true", help="counts as JSON")
    given = parser.parse_args()
    kinds = [words for words in given.kinds.split(",") if words]
    step = QUICK if given.quick else 1
    counts = measured(given.only.split(","), given.seed, step, kinds, (lambda _: None) if given.json else _print)
    print(json.dumps(counts, sort_keys=True) if given.json else "\n".join(f"{g}: {c}" for g, c in counts.items()))


if __name__ == "__main__":
    main()
