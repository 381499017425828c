"""Executors of clusters: what can be tried on one machine, and what is stated where something is missing."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import pytest

from occlog import __version__
from occlog.errors import InputError, UsageError
from occlog.pipeline.executors import clusters as jobs_of_slurm
from occlog.pipeline.executors.chosen import executor_of
from occlog.pipeline.executors.clusters import DaskCluster, Jobs, RayCluster
from occlog.pipeline.executors.interface import Lost, done_alike
from occlog.pipeline.executors.options import job_settings


def square_or_die(number: int) -> int:
    if number == 3:
        os._exit(9)
    return number * number


def test_what_the_options_name_is_what_works(tmp_path: Path) -> None:
    wanted = {"tcp://x:1": DaskCluster, "slurm": Jobs, "slurm-here": Jobs, "ray": RayCluster, "ray://x:1": RayCluster}
    for scheduler, kind in wanted.items():
        assert isinstance(executor_of(1, scheduler, {}, tmp_path), kind)
    with pytest.raises(UsageError, match="give a folder that all machines see: --job folder=PATH"):
        executor_of(1, "slurm", {}, None)


@pytest.mark.parametrize(
    ("texts", "scheduler", "words"),
    [
        (("mem_gb=2",), None, "only goes with --scheduler slurm or slurm-here"),
        (("mem_gb",), "slurm", "--job mem_gb: expected NAME=VALUE"),
        (("jobs=none",), "slurm", "--job jobs=none: expected a number above 0"),
    ],
)
def test_settings_that_are_none_are_refused(
    tmp_path: Path, texts: tuple[str, ...], scheduler: str | None, words: str
) -> None:
    with pytest.raises(UsageError, match=words):
        executor_of(1, scheduler, job_settings(texts, scheduler), tmp_path)


def test_a_package_that_is_not_there_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, scheduler in (("submitit", "slurm"), ("ray", "ray")):
        monkeypatch.setitem(sys.modules, name, None)
        with pytest.raises(UsageError, match=rf"pip install '?{name}"):
            list(executor_of(1, scheduler, {}, tmp_path).outcomes({"a": 1}, square_or_die))


FAKE_SLURM = {
    "srun": "",
    "scancel": "",
    "sbatch": 'cp "$1" "$FAKE_SLURM/script"; echo Submitted batch job 42',
    "sacct": "printf 'JobID|State|NodeList\\n42_0|FAILED|n1\\n42_1|FAILED|n1\\n'",
}
"""Programs that say what those of Slurm say of jobs that fail at once."""


def test_slurm_gets_one_script_with_the_settings_and_jobs_that_fail_are_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("submitit")
    monkeypatch.setattr(jobs_of_slurm, "POLL_S", 0.1)
    monkeypatch.setattr("submitit.core.core.Job._results_timeout_s", 0)
    for name, line in FAKE_SLURM.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{line}\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("FAKE_SLURM", str(tmp_path))
    settings = {"jobs": "2", "slurm_partition": "cpu", "timeout_min": "90", "mem_gb": "4"}
    jobs = Jobs("slurm", tmp_path / "jobs", settings)
    found = dict(jobs.outcomes({"a": 1, "b": 2, "c": 4}, square_or_die))
    assert set(found) == {"a", "b", "c"}
    assert all(isinstance(value, Lost) and "ended early" in value.reason for value in found.values())
    script = (tmp_path / "script").read_text()
    for wanted in ("--partition=cpu", "--time=90", "--mem=4GB", "--array=0-1", "--job-name=occlog"):
        assert f"#SBATCH {wanted}" in script


@pytest.mark.statistics
def test_jobs_share_the_work_and_a_piece_that_kills_its_process_takes_no_other_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("submitit")
    monkeypatch.setattr(jobs_of_slurm, "POLL_S", 0.1)
    monkeypatch.setattr("submitit.core.core.Job._results_timeout_s", 0)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), *sys.path]))
    work = {str(n): n for n in range(6)}
    folder = tmp_path / "jobs"
    found = dict(Jobs("local", folder, {"jobs": "2", "timeout_min": "2"}).outcomes(work, square_or_die))
    # What jobs were given may name signed URLs: no one else can read it, and it is taken away
    assert folder.stat().st_mode & 0o077 == 0
    assert list(folder.iterdir())
    assert not list(folder.rglob("*submitted.pkl"))
    assert isinstance(found.pop("3"), Lost)
    assert found == {str(n): n * n for n in range(6) if n != 3}
    with pytest.raises(UsageError, match="--job: "):
        list(Jobs("local", tmp_path, {"no_such": "2"}).outcomes(work, square_or_die))


@pytest.mark.statistics
def test_ray_does_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ray")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), *sys.path]))
    found = dict(RayCluster("ray").outcomes({str(n): n for n in range(5)}, partial(square_or_die)))
    assert isinstance(found.pop("3"), Lost)
    assert found == {str(n): n * n for n in (0, 1, 2, 4)}


BUSY = threading.Lock()


def alone_or_die(number: int) -> int:
    """What another thread disturbs is -1."""
    if number == 3:
        time.sleep(0.3)
        os._exit(9)
    if not BUSY.acquire(blocking=False):
        return -1
    time.sleep(0.05 if number < 9 else 15)
    BUSY.release()
    return number


DASK = """
import threading
from distributed import LocalCluster
from test_others import alone_or_die
from occlog.errors import InputError
from occlog.pipeline.executors.clusters import DaskCluster
if __name__ == "__main__":
    with LocalCluster(n_workers=1, threads_per_worker=2, processes=True, dashboard_address=None) as cluster:
        dask = DaskCluster(cluster.scheduler_address)
        found = dict(dask.outcomes({str(n): n for n in range(6)}, alone_or_die))
        print({key: value for key, value in found.items() if value != int(key)})
        threading.Timer(1, cluster.close).start()
        try:
            list(dask.outcomes({"9": 9}, alone_or_die))
        except InputError as error:
            print(error)
"""


@pytest.mark.statistics
def test_a_worker_of_dask_that_dies_takes_no_other_work_with_it_and_a_scheduler_that_goes_is_named() -> None:
    """What had waited at its worker was blamed for its death, and two threads disturbed each other."""
    pytest.importorskip("distributed")
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    done = subprocess.run(
        [sys.executable, "-c", DASK],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    lost, gone = done.stdout.splitlines()
    assert lost.startswith("{'3': Lost(")
    assert lost.count(":") == 1, lost
    assert "is gone; start it again" in gone


def test_a_worker_with_another_version_is_refused() -> None:
    assert done_alike(__version__, square_or_die, 2) == 4
    with pytest.raises(InputError, match=f"a worker has occlog {__version__}, this machine 0.0.1; install 0.0.1 there"):
        done_alike("0.0.1", square_or_die, 2)
