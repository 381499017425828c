"""`occlog reproduce` on the command line: files, JSON, resuming, bad input."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from occlog import __version__
from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.papers.catalogue import PAPERS
from occlog.papers.page import Paper, build_verdicts
from occlog.papers.run import PAGE, sizes_of, was_stopped
from occlog.papers.verdicts import WORDS

FIG17 = ["reproduce", "ercan", "fig17", "--quick", "--steps", "60", "-q"]
SMALL = ["reproduce", "ercan", "fig9", "--quick", "--steps", "12", "-q"]


def test_list_names_all(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["reproduce", "--list"]) == ExitCode.DONE
    text = capsys.readouterr().out
    assert "ercan: Ercan, El Gamal" in text
    assert "fig6 " in text
    assert "fig17 " in text
    assert run(["reproduce", "--list", "--json"]) == ExitCode.DONE
    assert list(json.loads(capsys.readouterr().out)) == ["ercan", "lee", "qu", "rahimi"]


def test_list_of_a_paper_has_that_paper_alone(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["reproduce", "rahimi", "--list"]) == ExitCode.DONE
    text = capsys.readouterr().out
    assert text.startswith("rahimi: Rahimi")
    assert "ercan" not in text
    assert run(["reproduce", "rahimi", "--list", "--json"]) == ExitCode.DONE
    assert list(json.loads(capsys.readouterr().out)) == ["rahimi"]


def test_a_run_that_was_stopped_goes_on(tmp_path: Path) -> None:
    """Without its page a folder is that of a stopped run: trials are kept, and files of experiments replaced."""
    assert run([*SMALL, "-o", str(tmp_path)]) == ExitCode.DONE
    first = (tmp_path / "fig9.csv").read_bytes()
    (tmp_path / "reproduce.html").unlink()
    lines = (tmp_path / "trials.jsonl").read_bytes().splitlines(keepends=True)
    (tmp_path / "trials.jsonl").write_bytes(b"".join(lines[:-1]) + lines[-1][:20])
    assert was_stopped(tmp_path)
    assert run([*SMALL, "-o", str(tmp_path)]) == ExitCode.DONE
    assert not was_stopped(tmp_path)
    kept = list(csv.DictReader(first.decode().splitlines()))
    again = list(csv.DictReader((tmp_path / "fig9.csv").read_text().splitlines()))
    assert [r["values"] for r in again] == [r["values"] for r in kept]
    assert run([*SMALL, "-o", str(tmp_path)]) == ExitCode.EXISTS


def test_the_page_says_how_it_was_made(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([*FIG17, "--seed", "3", "-o", str(tmp_path), "--json"]) == ExitCode.DONE
    printed = json.loads(capsys.readouterr().out)
    command = "occlog reproduce ercan fig17 --quick --steps 60 --seed 3"
    assert printed["made"]["command"] == command
    assert (printed["made"]["seed"], printed["made"]["version"]) == (3, __version__)
    assert set(printed["counts"]) == set(WORDS)
    assert sum(printed["counts"].values()) == len(printed["items"][0]["verdicts"])
    assert f"`{command}`, seed 3, with occlog {__version__}" in (tmp_path / "reproduce.html").read_text()


def test_every_verdict_of_the_page_of_all_papers_leads_to_that_of_its_paper() -> None:
    verdict = {"id": "fig1-a", "statement": "A <b>.", "place": "Fig. 1", "page": 3, "paper": 1.0, "measured": None}
    paper = Paper("Title", [{**verdict, "error_bar": None, "verdict": word} for word in WORDS])
    totals = {"ercan": dict.fromkeys(WORDS, 1), "all papers": dict.fromkeys(WORDS, 1)}
    page = build_verdicts({"ercan": paper}, totals, PAGE, "Made by hand.")
    assert page.count('href="ercan/reproduce.html#fig1-a"') == 4
    assert all(f'<td class="verdict {kind}">' in page for kind in ("reproduced", "part", "not", "undecided"))
    assert "A &lt;b&gt;." in page
    assert "Fig. 1, p. 3" in page
    assert "Made by hand." in page
    assert '<td class="n">4</td>' in page


def test_files_of_an_experiment(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new" / "out"
    assert run([*FIG17, "--json", "-o", str(out)]) == ExitCode.DONE
    printed = json.loads(capsys.readouterr().out)
    assert sorted(p.name for p in out.iterdir()) == ["fig17.csv", "fig17.json", "fig17.png", "reproduce.html"]
    written = json.loads((out / "fig17.json").read_text())
    assert written == {"paper": "ercan", "made": printed["made"], **printed["items"][0]}
    verdicts = written["verdicts"]
    assert {
        "id",
        "statement",
        "paper",
        "measured",
        "error_bar",
        "runs",
        "verdict",
        "rule",
        "place",
        "page",
        "words",
    } == set(verdicts[0])
    rows = list(csv.DictReader((out / "fig17.csv").read_text().splitlines()))
    assert {r["series"] for r in rows} == {"printed", "improved", "quadrature"}
    assert all(len(r["values"].split()) == 2 for r in rows)
    assert (out / "fig17.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    page = (out / "reproduce.html").read_text()
    assert page.count("<svg") == 1
    assert all(v["id"] in page for v in verdicts)
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert run([*FIG17, "-o", str(out)]) == ExitCode.EXISTS
    before = (out / "fig17.csv").read_bytes()
    assert run([*FIG17, "-o", str(out), "--overwrite"]) == ExitCode.DONE
    assert (out / "fig17.csv").read_bytes() == before
    assert (out / "reproduce.html").read_text() == page


def test_finished_trials_are_not_run_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([*SMALL, "-o", str(tmp_path)]) == ExitCode.DONE
    first, store = (tmp_path / "fig9.csv").read_bytes(), (tmp_path / "trials.jsonl").read_bytes()
    assert "fig9-few" in capsys.readouterr().out
    assert run([*SMALL, "-o", str(tmp_path), "--overwrite"]) == ExitCode.DONE
    # Times of the trackers are in the table too, so equal bytes mean that none ran again.
    assert (tmp_path / "fig9.csv").read_bytes() == first
    assert (tmp_path / "trials.jsonl").read_bytes() == store


def test_size_of_one_experiment(capsys: pytest.CaptureFixture[str]) -> None:
    assert run([*FIG17[:4], "-q", "--size", "fig17=3x50", "--json"]) == ExitCode.DONE
    found = json.loads(capsys.readouterr().out)["items"][0]
    assert (found["runs"], found["steps"]) == (3, 50)


def test_every_experiment_can_be_given_a_size() -> None:
    for experiments in PAPERS.values():
        items = [e.item for e in experiments]
        assert sizes_of([f"{item}=2x10" for item in items], items) == dict.fromkeys(items, (2, 10))


@pytest.mark.parametrize(
    ("args", "code", "expected"),
    [
        ([], ExitCode.USAGE, "--list"),
        (["erkan", "--list"], ExitCode.USAGE, "erkan"),
        (["--all", "--size", "fig7=2x50"], ExitCode.USAGE, "--size requires a paper"),
        (["--all", "--bearings", __file__], ExitCode.USAGE, "--scene"),
        (["ercan"], ExitCode.USAGE, "--all"),
        (["erkan", "fig6"], ExitCode.USAGE, "erkan"),
        (["ercan", "fig66"], ExitCode.USAGE, "did you mean 'fig6'"),
        (["ercan", "fig6", "--runs", "1"], ExitCode.USAGE, "runs"),
        (["ercan", "fig6", "--workers", "0"], ExitCode.USAGE, "workers"),
        (["ercan", "fig6", "--size", "fig6=5"], ExitCode.USAGE, "'fig6=5'"),
        (["ercan", "fig6", "--size", "fig6=1x50"], ExitCode.USAGE, "from 2x10 up"),
        (["ercan", "fig6", "--size", "fig6=2x9"], ExitCode.USAGE, "from 2x10 up"),
        (["ercan", "fig6", "--size", "fig7=2x50"], ExitCode.USAGE, "fig7 is not among"),
    ],
)
def test_bad_input_is_one_line(
    args: list[str], code: ExitCode, expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["reproduce", *args]) == code
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert expected in error


def test_output_that_is_a_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "file"
    path.write_text("")
    assert run([*FIG17, "-o", str(path)]) == ExitCode.BAD_INPUT
    assert "name a folder" in capsys.readouterr().err


def test_floor_plans_are_written_and_on_the_page(tmp_path: Path) -> None:
    assert (
        run(["reproduce", "rahimi", "fig5", "--quick", "--runs", "2", "--steps", "40", "-q", "-o", str(tmp_path)]) == 0
    )
    names = sorted(p.name for p in tmp_path.iterdir())
    assert names == ["fig5-constraints.png", "fig5.csv", "fig5.json", "fig5.png", "reproduce.html", "trials.jsonl"]
    page = (tmp_path / "reproduce.html").read_text()
    assert page.count("<svg") == 2
    assert page.count("<figcaption>") == 1
    assert (tmp_path / "fig5-constraints.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    again = ["reproduce", "rahimi", "fig5", "--quick", "--runs", "2", "--steps", "40", "-q", "-o", str(tmp_path)]
    (tmp_path / "fig5.csv").unlink()
    assert run(again) == ExitCode.EXISTS
