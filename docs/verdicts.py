"""Keeps what runs of `occlog reproduce` gave, and writes the page of all verdicts from it.

    occlog reproduce lee fig2.7 -o out/
    python -m docs.verdicts out/

takes the experiments of the folders into `docs/research/reproduced/PAPER.json`, in place of what was there of the same
experiments; `make docs` writes `docs/research/verdicts.md` from these files.
"""

from __future__ import annotations

import csv
import json
import math
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from occlog.papers.catalogue import PAPERS, RECORDED, TITLES
from occlog.papers.verdicts import WORDS

KEPT = Path(__file__).resolve().parent / "research" / "reproduced"
FIELDS = ("id", "statement", "place", "page", "paper", "measured", "error_bar", "runs", "verdict")
"""What is kept of a verdict."""
DIGITS = 6
"""Significant digits that are kept."""
CURVE = 13
"""A series of more points is a curve, whose points are not kept."""


class RefusedError(Exception):
    """Outputs that are no record of the program: the text says why."""


@dataclass(frozen=True)
class Kept:
    """What a run gave of one experiment."""

    command: str
    seed: int
    version: str
    commit: str
    runs: int
    steps: int
    verdicts: list[dict[str, str | float | None]]
    rows: list[tuple[str, float | None, int, float, float | None]]
    """Series, x (None: a line across), runs, mean, standard error (None: unknown) of each row of the table."""

    def is_full(self, paper: str, item: str) -> bool:
        """Return whether runs and steps are those of the full form; recordings have their own number of steps."""
        full = {e.item: (e.runs, e.steps) for e in PAPERS[paper]}
        return item not in full or full[item] == (self.runs, self.steps)

    def count(self, word: str) -> int:
        """Return how many statements have this verdict."""
        return sum(v["verdict"] == word for v in self.verdicts)


def items_of(paper: str) -> list[str]:
    """Return the names of the experiments of a paper, in its order."""
    return [e.item for e in PAPERS[paper]] + list(RECORDED.get(paper, ()))


def kept_of(paper: str, folder: Path = KEPT) -> dict[str, Kept]:
    """Return what is kept of a paper by experiment, in the paper's order."""
    path = folder / f"{paper}.json"
    found = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    for one in found.values():
        one["rows"] = [tuple(row) for row in one["rows"]]
    return {item: Kept(**found[item]) for item in items_of(paper) if item in found}


def keep(folders: Iterable[Path], into: Path = KEPT) -> list[str]:
    """Take the experiments of folders of `occlog reproduce -o`; return a line for each.

    What was run at a reduced size does not replace what was run at full size.  Raises RefusedError for quick looks, and
    for a program whose commit is unknown or that was changed since.
    """
    lines, papers = [], {paper: kept_of(paper, into) for paper in PAPERS}
    for path, found in _outputs(folders):
        paper, item, own = found["paper"], found["item"], _record(path, found)
        before = papers[paper].get(item)
        if before and before.is_full(paper, item) and not own.is_full(paper, item):
            lines.append(f"{paper} {item}: left as it is, of full size; {path} has {own.runs} x {own.steps}")
            continue
        papers[paper][item] = own
        lines.append(f"{paper} {item}: {own.runs} x {own.steps}, commit {own.commit}")
    for paper, kept in papers.items():
        if kept:
            (into / f"{paper}.json").write_text(_text(paper, kept), encoding="utf-8")
    return lines


def _outputs(folders: Iterable[Path]) -> Iterator[tuple[Path, dict]]:
    """Yield file and content of the verdicts of each experiment."""
    for folder in folders:
        for path in sorted(folder.rglob("*.json")):
            found = json.loads(path.read_text(encoding="utf-8"))
            if isinstance(found, dict) and {"paper", "item", "made"} <= found.keys():
                yield path, found


def _record(path: Path, found: dict) -> Kept:
    made = found["made"]
    if found["quick"]:
        raise RefusedError(f"{path}: a quick look is no result; run it without --quick")
    commit = made["commit"] or "unknown"
    if commit == "unknown" or commit.endswith("-dirty"):
        raise RefusedError(f"{path}: the program's commit is {commit}; run it from a clean checkout")
    verdicts = [{name: _rounded(v[name]) for name in FIELDS} for v in found["verdicts"]]
    with path.with_suffix(".csv").open(encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(file))
    points = Counter(r["series"] for r in table)
    rows = [
        (r["series"], _number(r["x"]), int(r["runs"]), float(r["mean"]), _number(r["standard_error"]))
        for r in table
        if r["mean"] and points[r["series"]] <= CURVE
    ]
    return Kept(**made, runs=found["runs"], steps=found["steps"], verdicts=verdicts, rows=rows)


def _number(text: str) -> float | None:
    return float(text) if text else None


def _rounded(value: str | float | None) -> str | float | None:
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def _text(paper: str, kept: dict[str, Kept]) -> str:
    """Return JSON with a line for each verdict and each row, so that a change is seen where it is."""
    parts = []
    for item in (i for i in items_of(paper) if i in kept):
        fields = asdict(kept[item])
        lists = {name: fields.pop(name) for name in ("verdicts", "rows")}
        head = "".join(f"  {json.dumps(k)}: {json.dumps(v)},\n" for k, v in fields.items())
        long = ",\n".join(f"  {json.dumps(k)}: [\n{_lines(v)}\n  ]" for k, v in lists.items())
        parts.append(f" {json.dumps(item)}: {{\n{head}{long}\n }}")
    return "{\n" + ",\n".join(parts) + "\n}\n"


def _lines(values: Iterable[object]) -> str:
    return ",\n".join(f"   {json.dumps(v, ensure_ascii=False)}" for v in values)


def verdicts_page() -> str:
    """Every statement of the four papers that was judged, and by which run."""
    kept = {paper: kept_of(paper) for paper in PAPERS}
    head = (
        "# Verdicts of the four papers\n\nMade by `make docs` from `docs/research/reproduced/`, where "
        "`python -m docs.verdicts DIR` "
        "puts what a run of\n`occlog reproduce -o DIR` gave. By [one rule](reproduce.md#the-rule); figures are "
        "means and standard errors.\n\nStatements of the experiments that were run at full size:\n"
    )
    return "\n".join([head, counts_table(kept), *(_paper(paper, own) for paper, own in kept.items())])


def counts_table(kept: dict[str, dict[str, Kept]]) -> str:
    """A row for each paper: experiments by size, and how many statements of full-size runs got which verdict."""
    rows = []
    for paper, own in kept.items():
        full = [k for item, k in own.items() if k.is_full(paper, item)]
        sizes = (len(full), len(own) - len(full), len(items_of(paper)) - len(own))
        rows.append([*sizes, *(sum(k.count(word) for k in full) for word in WORDS)])
    total = [sum(column) for column in zip(*rows, strict=True)]
    head = ["", "run at full size", "at a reduced size", "no run kept", *WORDS]
    names = [f"[{paper.capitalize()}](#{paper})" for paper in kept] + ["all papers"]
    body = [[name, *map(str, row)] for name, row in zip(names, [*rows, total], strict=True)]
    return _table(head, body)


def _paper(paper: str, own: dict[str, Kept]) -> str:
    experiments, statements, commands = [], [], {}
    titles = {e.item: e.title for e in PAPERS[paper]}
    for item in items_of(paper):
        title, k = titles.get(item, "on recorded detections"), own.get(item)
        if k is None:
            experiments.append([f"`{item}`", title, "no run kept", *[""] * 6])
            continue
        size = f"{k.runs} × {k.steps}" + ("" if k.is_full(paper, item) else ", reduced")
        counts = [str(k.count(word)) for word in WORDS]
        experiments.append([f"`{item}`", title, size, str(k.seed), k.commit, *counts])
        commands[k.command] = None
        for v in k.verdicts:
            at = f"{v['place']}" + (f", p. {v['page']}" if v["page"] else "")
            text = str(v["statement"]).replace("|", "\\|")
            printed = "" if v["paper"] is None else f"{v['paper']:.4g}"
            statements.append([f"`{v['id']}`", at, text, printed, _measured(v), str(v["verdict"])])
    shown = "\n".join(f"* `{command}`" for command in commands)
    return "\n".join(
        [
            f"## {paper.capitalize()}\n\n{TITLES[paper]}; [its page](reproduce-{paper}.md).\n",
            _table(["experiment", "what", "runs × steps", "seed", "commit", *WORDS], experiments),
            *([f"Commands:\n\n{shown}\n"] if commands else []),
            *([_table(["id", "place", "statement", "paper", "measured", "verdict"], statements)] if statements else []),
        ]
    )


def _measured(v: dict[str, str | float | None]) -> str:
    value, error = v["measured"], v["error_bar"]
    if not isinstance(value, int | float):
        return ""
    if not isinstance(error, int | float) or not error or math.isnan(error):
        return f"{value:.4g}"
    places = max(0, 1 - math.floor(math.log10(error)))
    return f"{value:.{places}f} ± {error:.{places}f}"


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


if __name__ == "__main__":
    try:
        sys.stdout.write("".join(f"{line}\n" for line in keep(map(Path, sys.argv[1:]))))
    except RefusedError as error:
        sys.exit(str(error))
