"""Many trials: the same results however they are run, and nothing is lost when a sweep is killed."""

from __future__ import annotations

import errno
import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from sweep_scene import trial

from occlog.errors import InputError, OutputError, UsageError
from occlog.pipeline.sweep.engine import Store, TrialError, key_of, run_all
from occlog.pipeline.sweep.trial import run_trial

TRIALS = [trial(run, priors={"kind": "known"}) for run in range(3)]
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}


def test_any_number_of_workers_gives_the_same_in_the_same_order():
    one = run_all(TRIALS, workers=1)
    names = [n for n in one[0] if n not in ("track_seconds", "predicted_mse")]
    expected = [[r[n] for n in names] for r in one]
    assert len({tuple(row) for row in expected}) == 3
    two = run_all(TRIALS, workers=2)
    assert [[r[n] for n in names] for r in two] == expected


def test_a_scheduler_that_is_not_there_is_reported():
    pytest.importorskip("distributed")
    code = (
        "import sys\nfrom sweep_scene import trial\nfrom occlog.pipeline.sweep.engine import run_all\n"
        "from occlog.errors import UsageError\n"
        "for address in sys.argv[1:]:\n"
        "    try:\n        run_all([trial()], scheduler=address)\n"
        "    except UsageError as error:\n        print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "nonsense://1", "tcp://127.0.0.1:9"],
        env=ENVIRONMENT | {"DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "1s"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.stdout.count("does not answer") == 2, done.stderr[-2000:]
    assert done.stderr == ""


def test_finished_trials_are_not_run_again(tmp_path):
    store = tmp_path / "trials.jsonl"
    run_all(TRIALS[:2], store=store)
    rows = [json.loads(line) for line in store.read_text().splitlines()]
    store.write_text("".join(json.dumps({**row, "result": {"rmse": -1.0 - k}}) + "\n" for k, row in enumerate(rows)))
    found = [r["rmse"] for r in run_all(TRIALS[:3], store=store)]
    assert sorted(found[:2]) == [-2.0, -1.0]
    assert found[2] > 0.0


def worker_processes(script):
    """Processes whose environment names a script, by the file system of processes."""
    found = []
    for path in Path("/proc").glob("[0-9]*/environ"):
        try:
            if f"SWEEP_SCRIPT={script}".encode() in path.read_bytes():
                found.append(path)
        except OSError:
            continue
    return found


@pytest.mark.slow
def test_a_killed_sweep_goes_on(tmp_path):
    store = tmp_path / "trials.jsonl"
    code = (
        "from pathlib import Path\nfrom sweep_scene import trial\nfrom occlog.pipeline.sweep.engine import run_all\n"
        f"if __name__ == '__main__':\n"
        f"    run_all([trial(run) for run in range(2000)], workers=2, store=Path({str(store)!r}))\n"
    )
    script = tmp_path / "sweep.py"
    script.write_text(code)
    process = subprocess.Popen([sys.executable, str(script)], env={**ENVIRONMENT, "SWEEP_SCRIPT": str(script)})
    deadline = time.monotonic() + 240
    while (not store.exists() or store.read_bytes().count(b"\n") < 3) and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    time.sleep(2.0)
    assert not worker_processes(str(script)), "workers outlive the process that started them"
    kept = len(Store(store).results)
    assert 3 <= kept < 2000
    finished = []
    specs = [trial(run) for run in range(kept + 2)]
    results = run_all(specs, store=store, progress=finished.append)
    assert finished[0] == kept
    assert results[0]["rmse"] == run_trial(trial(0))["rmse"]


def test_a_line_that_was_cut_off_is_run_again(tmp_path):
    store = tmp_path / "trials.jsonl"
    run_all(TRIALS[:2], store=store)
    whole = store.read_bytes()
    store.write_bytes(whole[:-20])
    assert len(Store(store).results) == 1
    run_all(TRIALS[:2], store=store)
    assert len(store.read_bytes().splitlines()) == 2
    assert len(Store(store).results) == 2


@pytest.mark.parametrize("text", ["a,b\n1,2\n", '{"key": "a", "result": {"rmse": "much"}}\n'])
def test_a_store_that_is_none_is_refused(tmp_path, text):
    path = tmp_path / "trials.jsonl"
    path.write_text(text)
    with pytest.raises(InputError, match="line 1: is no finished trial"):
        run_all(TRIALS[:1], store=path)


def test_a_trial_that_fails_is_named_and_the_others_are_kept(tmp_path):
    store = tmp_path / "trials.jsonl"
    with pytest.raises(TrialError, match=r"1 of 3 trials failed; the first is trial 1 .*run=7.*skip fewer"):
        run_all([TRIALS[0], trial(7, skip=10), TRIALS[1]], store=store)
    assert len(Store(store).results) == 2


def test_a_trial_is_described_by_what_tells_it_from_the_others_and_leaves_no_empty_store(tmp_path):
    store = tmp_path / "trials.jsonl"
    with pytest.raises(TrialError, match=r"the first is trial 0 \(run=7\): "):
        run_all([trial(7, skip=10), trial(8, skip=10)], store=store)
    assert not store.exists()


def test_keys_tell_trials_apart():
    assert key_of(trial()) == key_of(dict(reversed(trial().items())))
    assert len({key_of(t) for t in (trial(), trial(1), trial(skip=1), trial(seed=4))}) == 4


def lowest(spec):
    return {"value": min(spec["values"])}


def highest(spec):
    return {"value": max(spec["values"])}


def test_equal_descriptions_for_different_functions_are_different_trials(tmp_path):
    store, spec = tmp_path / "trials.jsonl", {"values": [2.0, 5.0]}
    for run, value in ((lowest, 2.0), (highest, 5.0), (lowest, 2.0)):
        assert run_all([spec], store=store, run=run) == [{"value": value}]
    assert len(Store(store).results) == 2


def test_progress_counts_every_trial_once():
    reported = []
    run_all([TRIALS[0], TRIALS[0], TRIALS[1]], progress=reported.append)
    assert sum(reported) == 3


def test_the_store_can_be_in_a_folder_that_is_not_there_yet(tmp_path):
    run_all(TRIALS[:1], store=tmp_path / "new" / "trials.jsonl")
    assert Path(tmp_path / "new" / "trials.jsonl").exists()


def test_usage_error_is_a_kind_of_failure():
    with pytest.raises(TrialError, match="no sensor"):
        run_all([trial(cameras=["z"])])
    assert issubclass(UsageError, Exception)


class Full(io.BytesIO):
    """A file on a disk that is full: what it could not write it tries again when it is closed."""

    def flush(self) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    def close(self) -> None:
        super().close()
        raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_is_one_error(tmp_path):
    store = Store(tmp_path / "trials.jsonl")
    with pytest.raises(OutputError, match=r"trials\.jsonl: cannot be written: No space left"), store:
        store._file.close()
        store._file = Full()
        store.add("a", {"rmse": 1.0})
    store = Store(tmp_path / "trials.jsonl")
    with pytest.raises(OutputError, match=r"trials\.jsonl: cannot be written: No space left"), store:
        store._file.close()
        store._file = Full()


def test_two_sweeps_do_not_write_into_one_store(tmp_path: Path) -> None:
    first, second = Store(tmp_path / "trials.jsonl"), Store(tmp_path / "trials.jsonl")
    with first:
        first.add("a", {"rmse": 1.0})
        with pytest.raises(UsageError, match="is in use by another `occlog sweep`"), second:
            pass
    with second:  # what the other has added since it was opened stays
        second.add("b", {"rmse": 2.0})
    assert Store(tmp_path / "trials.jsonl").results == {"a": {"rmse": 1.0}, "b": {"rmse": 2.0}}
