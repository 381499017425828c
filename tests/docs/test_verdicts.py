"""Figures of the pages of the papers are those of the runs that are kept."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from places import ROOT

from docs.verdicts import KEPT, Kept, RefusedError, items_of, keep, kept_of
from occlog.papers.catalogue import PAPERS, SOURCES
from occlog.papers.verdicts import WORDS, source_of

NUMBER = r"-?(?:\d[\d,]*)?\.?\d+"
PAIR = re.compile(rf"(?<![\d.])({NUMBER}) ± ({NUMBER})")
PART = re.compile(r"<!-- figures of (.*?) -->\n(.*?)<!-- end of figures -->", re.DOTALL)
"""A part of a page, and the experiments that its figures are of."""


def parts() -> Iterator[tuple[str, list[str], str]]:
    """Paper, experiments and text of every part of a page that has figures of runs that are kept."""
    for paper in PAPERS:
        text = (ROOT / "docs/research" / f"reproduce-{paper}.md").read_text(encoding="utf-8")
        for items, part in PART.findall(text):
            yield paper, items.split(), part


def figures_of(kept: Kept) -> Iterator[tuple[float, float]]:
    """Every mean with its standard error."""
    for v in kept.verdicts:
        if isinstance(v["measured"], float) and isinstance(v["error_bar"], float):
            yield v["measured"], v["error_bar"]
    yield from ((mean, error) for _, _, _, mean, error in kept.rows if error is not None)


def shown(text: str, value: float) -> bool:
    """Whether a text is a number rounded to its digits, or that of percent; signs are stated in words."""
    digits = len(text.partition(".")[2])
    printed, near = abs(float(text.replace(",", ""))), 0.501 * 10.0**-digits
    return any(abs(abs(value) * scale - printed) <= near for scale in (1.0, 100.0))


@pytest.mark.parametrize(("paper", "items", "text"), list(parts()))
def test_figures_of_a_page_are_those_of_its_runs(paper: str, items: list[str], text: str) -> None:
    kept = kept_of(paper)
    known = [pair for item in items for pair in figures_of(kept[item])]
    missing = [
        f"{value} ± {error}"
        for value, error in PAIR.findall(text)
        if not any(shown(value, mean) and shown(error, own) for mean, own in known)
    ]
    assert not missing, f"reproduce-{paper}.md: not of the runs of {', '.join(items)}: {', '.join(missing)}"


@pytest.mark.parametrize("paper", PAPERS)
def test_what_is_kept_is_of_experiments_and_statements_of_today(paper: str) -> None:
    path = KEPT / f"{paper}.json"
    written = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    assert set(written) <= set(items_of(paper)), "an experiment has another name"
    for own in kept_of(paper).values():
        assert re.fullmatch(r"[0-9a-f]{12}", own.commit)
        for v in own.verdicts:
            assert v["verdict"] in WORDS
            source = source_of(str(v["id"]), SOURCES[paper])
            assert v["place"] == (source.place if source else v["place"]), f"{v['id']} has another place"


def outputs(folder: Path, **changes: object) -> None:
    """Files of an experiment as `occlog reproduce -o` writes them."""
    made = {"command": "occlog reproduce rahimi fig5 --seed 0", "seed": 0, "version": "0.1.0", "commit": "0123456789ab"}
    verdict = {"id": "fig5-behind", "statement": "S.", "place": "Fig. 5", "page": None, "paper": None, "runs": 50}
    verdict |= {"measured": 0.3599999, "error_bar": 0.07, "verdict": "reproduced", "rule": "", "words": ""}
    found = {"paper": "rahimi", "item": "fig5", "runs": 50, "steps": 200, "quick": False, "made": made}
    folder.mkdir(exist_ok=True)
    (folder / "fig5.json").write_text(json.dumps({**found, "verdicts": [verdict], **changes}))
    with (folder / "fig5.csv").open("w", newline="") as file:
        head = ["series", "x", "runs", "mean", "sd", "standard_error", "values"]
        curve = [["curve", k, 50, k, "", "", ""] for k in range(14)]
        csv.writer(file).writerows([head, ["free", "", 50, 1.5, 1, 0.25, "1 2"], *curve])


def test_outputs_are_kept_with_their_provenance(tmp_path: Path) -> None:
    outputs(tmp_path / "out")
    assert keep([tmp_path / "out"], tmp_path) == ["rahimi fig5: 50 x 200, commit 0123456789ab"]
    own = kept_of("rahimi", tmp_path)["fig5"]
    assert own.is_full("rahimi", "fig5")
    assert (own.seed, own.commit, own.count("reproduced")) == (0, "0123456789ab", 1)
    assert own.rows == [("free", None, 50, 1.5, 0.25)]
    assert own.verdicts[0]["measured"] == 0.36
    # A reduced run leaves that of full size alone; a later one of full size replaces it
    outputs(tmp_path / "small", runs=3)
    assert "left as it is" in keep([tmp_path / "small"], tmp_path)[0]
    outputs(tmp_path / "later", verdicts=[])
    keep([tmp_path / "later"], tmp_path)
    assert kept_of("rahimi", tmp_path)["fig5"].verdicts == []


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"quick": True}, "--quick"),
        ({"made": {"command": "", "seed": 0, "version": "", "commit": "0123456789ab-dirty"}}, "clean checkout"),
        ({"made": {"command": "", "seed": 0, "version": "", "commit": None}}, "unknown"),
    ],
)
def test_what_is_no_record_is_refused(tmp_path: Path, changes: dict[str, object], expected: str) -> None:
    outputs(tmp_path / "out", **changes)
    with pytest.raises(RefusedError, match=expected):
        keep([tmp_path / "out"], tmp_path)
    assert not (tmp_path / "rahimi.json").exists()
