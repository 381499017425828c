"""Temporary folders vanish: with their last reference, with their process, and after a process that was killed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

CODE = """
import json, multiprocessing, os, signal, sys, time
from pathlib import Path
from occlog.api.folders import FRESH_S, PREFIX, Folder, _Home

def keep(how):
    globals()["kept"] = Folder()
    kept.file("table").write_text("rows")
    if how == "killed":
        os.kill(os.getpid(), signal.SIGKILL)

def there():
    return len(list(Path(os.environ["TMPDIR"]).glob(PREFIX + "*")))

def run(how):
    child = multiprocessing.get_context("fork").Process(target=keep, args=(how,))
    child.start()
    child.join()
    return there()

mine = Folder()
found = {"alone": there(), "ended": run("ended"), "killed": run("killed")}
for home in Path(os.environ["TMPDIR"]).iterdir():
    os.utime(home, (0, time.time() - FRESH_S - 1))
found["next"] = run("ended")
found["mine"] = mine.path.is_dir()
path = mine.path
del mine
found["gone"] = not path.exists()
other = Folder()
print(json.dumps(found))
raise ValueError("no one catches this")
"""


def test_no_folder_outlives_its_process(tmp_path: Path) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", CODE], env={**os.environ, "TMPDIR": str(tmp_path)}, capture_output=True, text=True
    )
    assert "no one catches this" in ended.stderr
    found = json.loads(ended.stdout)
    # One folder of the process itself; a child that ends takes its own along, one that is killed leaves it to the next
    assert found == {"alone": 1, "ended": 1, "killed": 2, "next": 1, "mine": True, "gone": True}
    assert list(tmp_path.iterdir()) == []
