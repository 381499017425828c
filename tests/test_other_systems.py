"""Systems without the POSIX modules, as Windows, and with memory counted in bytes, as macOS; both are simulated."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from occlog.cli.common import peak_memory
from occlog.io.files.children import environment_for_children

OTHER_SYSTEM = """
import importlib, json, os, re, signal, subprocess, sys, tempfile
from pathlib import Path
import click, cv2, numba, numpy, pyarrow, scipy.optimize  # libraries have forms for each system
for module in ("fcntl", "resource", "grp", "pwd"):
    sys.modules[module] = None
for name in ("fork", "getuid", "geteuid", "memfd_create", "waitstatus_to_exitcode"):
    delattr(os, name)
for name in ("SIGCHLD", "SIGXCPU"):
    delattr(signal, name)
sys.platform = "darwin"
import occlog
package = Path(occlog.__file__).parent
posix = re.compile(r"fcntl|resource\\b|getuid|geteuid|SIGCHLD|SIGXCPU|memfd|os[.]fork|sys[.]platform")
for file in sorted(package.rglob("*.py")):
    if posix.search(file.read_text()) and not file.stem.endswith("_main"):
        importlib.import_module(".".join(file.relative_to(package.parent).with_suffix("").parts).removesuffix(".__init__"))
from occlog.cli.main import run
codes = [int(run(line)) for line in json.loads(sys.argv[1])]
from occlog.api.folders import Folder
Folder()
from occlog.errors import UsageError
from occlog.io.remote import Cache
try:
    with Cache(Path(sys.argv[2]) / "cache", 1).scratch():
        pass
except UsageError as error:
    print(error)
print(codes)
"""


def test_commands_run_without_the_modules_of_posix(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("frame,left,top,width,height\n0,10,20,30,60\n")
    out = str(tmp_path / "a.mcap")
    ingest = ["ingest", "-o", out, "--boxes", f"a={tmp_path / 'a.csv'}", "--fps", "10", "--allow-uncalibrated", "-v"]
    done = subprocess.run(
        [sys.executable, "-P", "-c", OTHER_SYSTEM, json.dumps([ingest, ["info", out]]), str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
        env=environment_for_children(),
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[0, 0]"
    assert "file locks, which this system lacks" in done.stdout
    assert " s of a processor\n" in done.stderr


@pytest.mark.parametrize(("platform", "unit"), [("linux", 1024), ("darwin", 1)])
def test_memory_is_in_bytes(monkeypatch: pytest.MonkeyPatch, platform: str, unit: int) -> None:
    resource = pytest.importorskip("resource")
    monkeypatch.setattr(sys, "platform", platform)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    peak = peak_memory()
    assert peak is not None
    assert before * unit <= peak <= 2 * before * unit
