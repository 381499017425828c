"""Fixtures that all tests share."""

from __future__ import annotations

import base64
import fcntl
import gc
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parents[1]

# The same examples in every run, whatever machine it is on; HYPOTHESIS_PROFILE=more has more of them, explore new ones.
settings.register_profile("same", max_examples=25, derandomize=True, deadline=None)
settings.register_profile("more", max_examples=100, derandomize=True, deadline=None)
settings.register_profile("explore", max_examples=500, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    # A shell lets jobs in the background ignore interrupts, and so would the programs that tests start and interrupt.
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_configure(config: pytest.Config) -> None:
    """Let every second worker begin with the last tests: each compiles half of the assertions of a new checkout.

    What one has compiled the others read; `pytest_collection_modifyitems` restores the order.
    """
    number = os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")
    if int(number) % 2 and [Path(arg).resolve() for arg in config.args] == [ROOT / "tests"]:
        entries = (
            p for p in (ROOT / "tests").iterdir() if p.name[0] not in "._" and (p.is_dir() or p.match("test_*.py"))
        )
        config.args = sorted(map(str, entries), reverse=True)


def pytest_collectstart() -> None:
    """Search for no garbage: while tests are collected hardly any is made."""
    gc.disable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sort by the folder in `tests`: the workers must agree, and those of a folder share kernels."""
    items.sort(key=lambda item: item.nodeid.split("::")[0].split("/")[:2])


def pytest_collection_finish() -> None:
    """Leave the tests and what they import, which stay, out of every later search for garbage."""
    gc.collect()
    gc.freeze()
    gc.enable()


SAVE = Figure.savefig
DOT = "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGNgAAAAAgABSK+kcQAAAABJRU5ErkJggg=="
BLANK: dict[str, Any] = {"png": base64.b64decode(DOT), "svg": '<svg width="72pt" height="72pt"></svg>'}


def save_blank(_: Figure, out: Any, *, format: str, **__: object) -> None:
    """Write no figure: layout and rendering take most of the time of a page."""
    out.write(BLANK[format])


def leave_in_memory(descriptor: int) -> None:
    """Wait for no disk: what a test writes need not outlast the machine's power."""
    os.fstat(descriptor)


os.fsync = leave_in_memory  # type: ignore[assignment]


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Draw figures only for tests with the mark `drawn`."""
    Figure.savefig = SAVE if item.get_closest_marker("drawn") else save_blank  # type: ignore[method-assign, assignment]


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of recorded data that is not shipped; the test is skipped where it is missing."""
    path = Path(os.environ.get("OCCLOG_SHARED_DATA", ROOT.parent / "shared" / "data"))
    if not path.is_dir():
        pytest.skip(f"recorded data not found at {path}; set OCCLOG_SHARED_DATA")
    return path


@pytest.fixture(scope="session")
def shared_cases(shared_data: Path) -> Path:
    """Folder of inputs that went wrong once, next to the recorded data; the test is skipped where it is missing."""
    path = shared_data.parent / "cases"
    if not path.is_dir():
        pytest.skip(f"cases not found at {path}")
    return path


@pytest.fixture(scope="session")
def peers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Python of an environment with TrackEval and py-motmetrics; OCCLOG_PEERS names one that exists.

    It is made once for all workers of pytest-xdist, whose folders lie side by side; the others wait for it.
    """
    from mot_environment import make_environment

    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    with (folder / "peers.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        return make_environment(folder / "peers")
