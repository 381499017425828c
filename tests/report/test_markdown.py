"""A report as Markdown: its words and figures, with nothing in them that is markup."""

from __future__ import annotations

from dataclasses import replace

from made_up import run

from occlog.records.losses import Loss
from occlog.report.page import MAX_LOSSES, build_markdown


def test_verdict_figures_and_losses() -> None:
    losses = tuple(Loss("cam.mp4", f"frame {n}", "ends early", 2) for n in range(MAX_LOSSES + 3))
    text = build_markdown(replace(run(steps=60), losses=losses))
    assert text.startswith("# A made\\-up run\n")
    assert "| RMSE | " in text
    assert "| cam.mp4 | frame 0 | ends early | 2 |" in text
    assert "and 3 more." in text
    assert text.count("\n## ") >= 3
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert all(line.endswith("|") for line in rows)
    assert build_markdown(replace(run(steps=60), losses=losses)) == text


def test_names_cannot_begin_markup() -> None:
    evil = "a|b](javascript:x) <img src=x> `c` **d**\n# e"
    text = build_markdown(replace(run(steps=20), title=evil, losses=(Loss(evil, evil, evil, 1),)))
    line = next(line for line in text.splitlines() if line.startswith("| a\\|b"))
    assert "\\<img src=x\\>" in line
    assert "\\]\\(javascript:x\\)" in line
    assert "\n# e" not in text
    assert text.count(" | ") > 10
