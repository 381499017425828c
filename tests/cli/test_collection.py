"""Collections of garbage are paused while modules are loaded, and at no other time."""

from __future__ import annotations

import gc
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from occlog.console.collection import COLLECTION


@pytest.fixture
def unfrozen() -> Iterator[None]:
    yield
    gc.enable()
    gc.unfreeze()


@pytest.mark.usefixtures("unfrozen")
def test_objects_that_exist_at_the_end_of_a_pause_are_not_traversed_again() -> None:
    COLLECTION.pause()
    assert not gc.isenabled()
    COLLECTION.resume()
    assert gc.isenabled()
    assert gc.get_freeze_count() > 1000


@pytest.mark.usefixtures("unfrozen")
def test_collections_that_a_caller_has_stopped_stay_stopped() -> None:
    gc.disable()
    COLLECTION.pause()
    COLLECTION.resume()
    assert not gc.isenabled()
    assert not gc.get_freeze_count()


@pytest.mark.parametrize(
    ("words", "module", "function"),
    [
        (["info", "."], "occlog.examine.info", "describe_folder"),
        (["ingest", "--boxes", "a.csv", "-o", "a.mcap"], "occlog.ingest.run", "run_ingest"),
    ],
)
def test_a_command_computes_with_collections(words: list[str], module: str, function: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("frame,left,top,width,height\n0,1,2,3,4\n")
    code = f"""
import gc
from importlib import import_module
from occlog.cli.main import main
def command(*given):
    print("enabled" if gc.isenabled() else "paused", "frozen" if gc.get_freeze_count() else "traversed")
    raise SystemExit
setattr(import_module({module!r}), {function!r}, command)
main({words!r})
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stdout == "enabled frozen\n", done.stderr
