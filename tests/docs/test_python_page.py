"""The Python of the docs and of the notebooks runs as it stands there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from places import ROOT


@pytest.mark.jit
def test_the_python_of_the_page_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs/python.md").read_text(encoding="utf-8")
    names: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL):
        exec(compile(block, "docs/python.md", "exec"), names)
    said = capsys.readouterr().out.strip()
    assert f"prints `{said}`" in page
    assert (tmp_path / "report.html").is_file()
