"""False alarms: how often the verdict of `track` or `evaluate` speaks against an estimate that nothing is wrong with.

Recordings of `occlog simulate`, in which all that the methods assume holds.  `python -m benchmarks.track.false_alarms`
prints a line for each case with every warning; `--cases` chooses among them.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from occlog.cli.main import run as occlog

NAME = "false-alarms"
SUMMARY = "Share of clean simulations with a warning, all methods in the plane and in space"
LIMIT = 0.02
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
WORLDS = {
    "room": ("room.yaml", "--seconds", "60"),
    "room100": ("room100.yaml", "--steps", "300", "--occluders", "20"),
    "lroom": ("lroom.yaml", "--steps", "300", "--occluders", "20"),
    "arrays": ("arrays.yaml", "--seconds", "60", "--object-height", "1.6"),
    "arrays, labels": ("arrays.yaml", "--seconds", "60", "--object-height", "1.6", "--label-doa"),
    "field": ("lee_field.yaml", "--paths", str(EXAMPLES / "lee_field_paths.yaml")),
}
"""What is simulated."""
IMM = (
    *("alpha=0.01", "sigma_v=0.03", "association=joint", "hold_s=50"),
    *("--start", "5,3,0.1,0.2,0.2,0.01", "--start", "22,3,0.1,-0.2,0.2,0.01"),
)
"""Settings of `imm` for the field of [Lee] Fig. 3-7."""
CASES = {
    "apf": (("room", ()), ("room100", ()), ("lroom", ()), ("arrays", ())),
    "map": (("room", ()), ("room100", ()), ("lroom", ()), ("arrays, labels", ("--doa-labels",))),
    "fix": (("room", ()), ("room100", ()), ("lroom", ()), ("arrays, labels", ("--doa-labels",))),
    "imm": (("arrays", ()), ("field", IMM)),
    "direct3d": (("arrays", ()),),
    "pps": (("arrays", ()),),
}
"""Worlds in which each method is tried, with its settings there."""


class Said(NamedTuple):
    """What was said of one recording."""

    codes: tuple[str, ...]
    nees: float  # mean over the dimensions; 1 is consistent
    outside: float  # share of the rows outside the stated 95 % ellipse


def one(method: str, world: str, settings: Sequence[str], seed: int) -> Said:
    """Simulate, track and evaluate by the command line."""
    scene, *how = WORLDS[world]
    given = [s for s in settings if "=" in s]
    rest = [s for s in settings if "=" not in s]
    changed = [word for s in given for word in ("--set", s)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        record, tracks, notes = folder / "r.mcap", folder / "t.parquet", folder / "d.parquet"
        _call("simulate", EXAMPLES / scene, *how, "--seed", seed, "-o", record)
        of = ["--method", method, "--seed", seed, *changed, *rest]
        tracked = _call("track", record, *of, "-o", tracks, "--diagnostics", notes, "--json")
        of = ["--truth", record, "--bearings", record, "--diagnostics", notes, "--match", "optimal"]
        judged = _call("evaluate", tracks, *of, "--json")
    codes = {w["id"] for w in tracked["warnings"] + judged["warnings"]}
    share = judged.get("nees_share_95")
    return Said(tuple(sorted(codes)), judged.get("nees_mean") or math.nan, math.nan if share is None else 1.0 - share)


def _call(*arguments: object) -> dict[str, Any]:
    """The summary of a command."""
    out, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
        code = occlog([str(a) for a in arguments])
    if code not in (0, 3):
        raise RuntimeError(f"{arguments}: exit code {code}: {errors.getvalue()}")
    found: dict[str, Any] = json.loads(out.getvalue()) if "--json" in arguments else {}
    return found


def tally(method: str, world: str, settings: Sequence[str], seeds: Sequence[int]) -> Counter[str]:
    """Runs, runs with a warning, and each warning of one case, printed as they come."""
    count: Counter[str] = Counter()
    nees, outside = [], []
    for seed in seeds:
        reported = one(method, world, settings, seed)
        count.update(("runs", *(("alarms",) if reported.codes else ()), *reported.codes))
        nees.append(reported.nees)
        outside.append(reported.outside)
    codes = {code: n for code, n in count.items() if code not in ("runs", "alarms")}
    far = max(outside)
    print(f"| {method} | {world} | {count['runs']} | {count['alarms']} | {codes or ''} ", end="")
    print(f"| {min(nees):.2f} to {max(nees):.2f} | {far:.3f} |", flush=True)
    return count


def run(repeats: int = 5) -> dict[str, Any]:
    """Share of runs with a warning."""
    whole: Counter[str] = Counter()
    for method, worlds in CASES.items():
        for world, settings in worlds:
            whole += tally(method, world, settings, range(repeats))
    parts = {code: n for code, n in whole.items() if code not in ("runs", "alarms")}
    return {"ratio": whole["alarms"] / whole["runs"], "limit": LIMIT, "parts": parts}


def main() -> None:
    """Print a table: a line for each method and world."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", nargs="+", default=list(CASES), choices=CASES)
    parser.add_argument("--seeds", type=int, default=12)
    options = parser.parse_args()
    print("| method | world | runs | with a warning | which | mean NEES | outside at most |\n" + "|---" * 7 + "|")
    for method in options.methods:
        for world, settings in CASES[method]:
            tally(method, world, settings, range(options.seeds))


if __name__ == "__main__":
    main()
