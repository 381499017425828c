"""Tables over all recordings: what they say of losses."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.tables.parquet import read_provenance
from occlog.pipeline.batch.recording import RecordingOutcome
from occlog.pipeline.batch.run import MAX_LOSSES, gather
from occlog.pipeline.run.stages import Config
from occlog.records.losses import Loss


def test_many_losses_stand_in_the_table_of_runs_and_not_all_in_the_metadata_of_each(tmp_path: Path) -> None:
    """A million of them made files that no library reads."""
    config = Config(tmp_path / "batch.yaml", {})
    config.path.touch()
    lost = tuple(Loss("camera a", f"frame {n}", "is damaged", 2) for n in range(MAX_LOSSES + 5))
    outcomes = [
        RecordingOutcome(name, f"{name}.mcap", "0" * 64, ExitCode.LOSSY, losses=lost) for name in ("hall", "yard")
    ]
    gather(tmp_path, tmp_path / "runs", outcomes, [], config)
    for name in ("runs.parquet", "metrics.parquet"):
        parameters = read_provenance(tmp_path / name).losses
        assert len(parameters) == 2 * (MAX_LOSSES + 1)
        assert parameters[0] == Loss("hall: camera a", "frame 0", "is damaged", 2)
        assert parameters[-1] == Loss("yard", "other positions", "5 more losses; runs.parquet lists them", 10)
        assert run(["doctor", str(tmp_path / name)]) == ExitCode.DONE, "it was said to be of a newer version"
    assert all(len(row["losses"]) == len(lost) for row in pq.read_table(tmp_path / "runs.parquet").to_pylist())
