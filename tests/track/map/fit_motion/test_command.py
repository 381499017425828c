"""`occlog fit-motion` on files: truth, tracks, recordings, options, bad input."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.models.motion_models import read_motion
from occlog.records.tables import Tracks, Truth, Views

pytestmark = pytest.mark.jit
STEP_NS = 250_000_000


def places(seed: int, n: int = 200) -> np.ndarray:
    """Velocity disturbed by 0.2 a step, position by 0.02; measured to 0.05."""
    rng = np.random.default_rng(seed)
    v = np.array([1.0, 0.5]) + np.cumsum(0.2 * rng.standard_normal((n, 2)), axis=0)
    xy = np.cumsum(0.25 * v + 0.02 * rng.standard_normal((n, 2)), axis=0)
    return xy + 0.05 * rng.standard_normal((n, 2))


def truth(ids: tuple[int, ...] = (1, 2), n: int = 200, role: str = "target") -> Truth:
    xy = np.stack([places(i, n) for i in ids], axis=1).reshape(-1, 2)  # by time, then object
    rows = len(xy)
    return Truth.of(
        t_ns=np.repeat(np.arange(n) * STEP_NS, len(ids)),
        target_id=np.tile(ids, n).astype(np.int32),
        role=[role] * rows,
        x=xy[:, 0],
        y=xy[:, 1],
        z=np.full(rows, np.nan),
    )


def tracks(n: int = 200) -> Tracks:
    xy, nan = places(1, n), np.full(n, np.nan)
    return Tracks.of(
        t_ns=np.arange(n) * STEP_NS,
        target_id=np.ones(n, np.int32),
        x=xy[:, 0],
        y=xy[:, 1],
        vx=nan,
        vy=nan,
        cov_xx=np.full(n, 0.0025),
        cov_xy=np.zeros(n),
        cov_yy=np.full(n, 0.0025),
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = Provenance("ingest")
    write_table(tmp_path / "truth.parquet", truth(), made)
    write_table(tmp_path / "others.parquet", truth((3, 4), role="occluder"), made)
    write_table(tmp_path / "feet.parquet", truth((5,)), made, length_unit="ft")
    write_table(tmp_path / "short.parquet", truth((1,), 6), made)
    write_table(tmp_path / "tracks.parquet", tracks(), made)
    return tmp_path


def fit(folder: Path, *args: str, output: str = "motion.json") -> int:
    known = [str(folder / a) if a.endswith((".parquet", ".mcap")) else a for a in args]
    return run(["fit-motion", *known, "-o", str(folder / output), "-q"])


def test_truth_gives_a_model_with_its_errors(folder: Path, capsys) -> None:
    assert fit(folder, "truth.parquet", "--json") == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    assert summary["transitions"] == 2 * 199
    assert summary["measurements"] == 400
    assert summary["converged"] is True
    assert summary["spectral_radius"] == 1.0
    motion = read_motion(folder / "motion.json")
    assert (motion.step_s, motion.length_unit) == (0.25, "m")
    assert motion.A.tolist() == np.kron(np.eye(2), [[1, 0.25], [0, 1]]).tolist()
    values = json.loads((folder / "motion.json").read_text())
    value, error = motion.sigma[1, 1], values["sigma_error"][1][1]
    assert abs(np.log(value / 0.04)) < 4 * error / value < 1.0
    assert values["noise"] == pytest.approx(0.05, abs=3 * values["fit"]["errors"]["noise"])
    assert values["fit"]["log_likelihood"] == summary["log_likelihood"]
    made = values["_provenance"]
    assert made["inputs"][0]["name"] == "truth.parquet"
    assert made["parameters"]["step_s"] == 0.25


def test_same_input_gives_the_same_bytes(folder: Path) -> None:
    for name in ("one.json", "two.json"):
        assert fit(folder, "truth.parquet", "--form", "damped", output=name) == ExitCode.DONE
    assert (folder / "one.json").read_bytes() == (folder / "two.json").read_bytes()


@pytest.mark.parametrize(
    "args",
    [
        ("--form", "full", "--process-noise-form", "diagonal"),
        ("--form", "damped", "--process-noise-axes", "each"),
        ("--method", "differences", "--process-noise-form", "full"),
        ("--measurement-noise", "0.05", "--step", "0.5", "--max-gap", "2"),
        ("--target", "2"),
    ],
)
def test_options_give_a_model_that_is_read(folder: Path, args: tuple[str, ...]) -> None:
    assert fit(folder, "truth.parquet", *args) == ExitCode.DONE
    assert read_motion(folder / "motion.json").step_s == (0.5 if "--step" in args else 0.25)


def test_a_longer_step_skips_positions_between(folder: Path, capsys) -> None:
    assert fit(folder, "truth.parquet", "--step", "0.5", "--json") == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    assert summary["measurements"] + summary["skipped"] == 400
    assert summary["skipped"] > 150


def test_tracks_with_their_covariance_are_as_stated_noise(folder: Path) -> None:
    assert fit(folder, "tracks.parquet", "--measurement-noise", "covariance", output="a.json") == ExitCode.DONE
    assert fit(folder, "tracks.parquet", "--measurement-noise", "0.05", output="b.json") == ExitCode.DONE
    a, b = read_motion(folder / "a.json"), read_motion(folder / "b.json")
    np.testing.assert_allclose(a.sigma, b.sigma, rtol=1e-6)


def test_occluders_are_used_when_they_are_named(folder: Path, capsys) -> None:
    assert fit(folder, "truth.parquet", "others.parquet", "--json") == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["objects"] == 2
    assert fit(folder, "others.parquet", "--target", "3", output="o.json") == ExitCode.DONE
    assert fit(folder, "others.parquet", output="none.json") == ExitCode.BAD_INPUT
    assert "no positions of a target" in capsys.readouterr().err


def test_a_recording_with_truth(folder: Path) -> None:
    (folder / "room.yaml").write_text(
        "occlog_scene: 1\nroom: [[0, 0], [8, 0], [8, 6], [0, 6]]\ncameras:\n"
        "- {name: a, position: [0, 0], yaw_deg: 40, focal_px: 300, fov_deg: 100, noise: {measurement_noise_px: 2}}\n"
    )
    made = ["simulate", str(folder / "room.yaml"), "-o", str(folder / "room.mcap"), "--steps", "80", "-q"]
    assert run([*made, "--seed", "3"]) == ExitCode.DONE
    assert fit(folder, "room.mcap") == ExitCode.DONE
    assert read_motion(folder / "motion.json").length_unit == "m"


@pytest.mark.parametrize(
    ("args", "code", "says"),
    [
        (("short.parquet",), ExitCode.BAD_INPUT, "6 positions are too few for 3 parameters"),
        (("short.parquet", "--method", "differences"), ExitCode.BAD_INPUT, "3 transitions are too few"),
        (("truth.parquet", "feet.parquet"), ExitCode.BAD_INPUT, "lengths are in ft, but in m"),
        (("truth.parquet", "--target", "9"), ExitCode.BAD_INPUT, "no positions of target 9"),
        (("truth.parquet", "--measurement-noise", "covariance"), ExitCode.USAGE, "truth has no covariance"),
        (("truth.parquet", "--measurement-noise", "-1"), ExitCode.USAGE, "--measurement-noise -1"),
        (("truth.parquet", "--measurement-noise", "nan"), ExitCode.USAGE, "--measurement-noise nan"),
        (("truth.parquet", "--measurement-noise", "1e308"), ExitCode.USAGE, "--measurement-noise 1e308"),
        (
            ("truth.parquet", "--measurement-noise", "0.1", "--method", "differences"),
            ExitCode.USAGE,
            "must be estimated unless the method is em",
        ),
        (("truth.parquet", "--step", "0.001"), ExitCode.BAD_INPUT, "give a larger --step"),
        (("truth.parquet", "--step", "inf"), ExitCode.USAGE, "finite"),
        (("truth.parquet", "--max-gap", "0.1"), ExitCode.BAD_INPUT, "give a larger --max-gap"),
        (("truth.parquet", "--step", "1000", "--max-gap", "2000"), ExitCode.BAD_INPUT, "too few"),
        (("missing.parquet",), ExitCode.BAD_INPUT, "missing.parquet"),
        ((), ExitCode.USAGE, "POSITIONS"),
    ],
)
def test_bad_input_is_one_line(folder: Path, capsys, args: tuple[str, ...], code: ExitCode, says: str) -> None:
    assert fit(folder, *args) == code
    message = capsys.readouterr().err
    assert says in message
    assert message.count("\n") == 1
    assert not (folder / "motion.json").exists()


def test_other_tables_are_refused(folder: Path, capsys) -> None:
    write_table(folder / "views.parquet", Views.empty(), Provenance("detect"))
    assert fit(folder, "views.parquet") == ExitCode.BAD_INPUT
    assert "holds views" in capsys.readouterr().err


def test_who_stands_still_has_no_motion(folder: Path, capsys) -> None:
    still = truth((1,))
    still = Truth.of(
        **{c.name: getattr(still, c.name) for c in Truth.columns() if c.name not in "xy"},
        x=np.ones(200),
        y=np.ones(200),
    )
    write_table(folder / "still.parquet", still, Provenance("ingest"))
    assert fit(folder, "still.parquet") == ExitCode.BAD_INPUT
    assert "nothing moves" in capsys.readouterr().err


def test_an_unstable_model_is_warned_of(folder: Path, capsys) -> None:
    t = np.arange(60)
    rng = np.random.default_rng(0)
    grown = 1.08**t + 0.01 * rng.standard_normal(60)
    rows = truth((1,), 60)
    rows = Truth.of(t_ns=rows.t_ns, target_id=rows.target_id, role=rows.role, z=rows.z, x=grown, y=2 * grown)
    write_table(folder / "grown.parquet", rows, Provenance("ingest"))
    args = ["fit-motion", str(folder / "grown.parquet"), "-o", str(folder / "motion.json"), "--form", "damped"]
    assert run(args) == ExitCode.DONE
    assert "unstable: spectral radius 1.0" in capsys.readouterr().err


def test_outputs_are_not_replaced_by_chance(folder: Path) -> None:
    assert fit(folder, "truth.parquet") == ExitCode.DONE
    assert fit(folder, "truth.parquet") == ExitCode.EXISTS
    assert fit(folder, "truth.parquet", "--overwrite") == ExitCode.DONE


def test_tables_of_others_are_brought_to_the_unit_of_the_first(folder: Path) -> None:
    def noise(unit: str, scale: float) -> float:
        rows = truth(ids=(3,))
        cells = zip(rows.t_ns, scale * rows.x, scale * rows.y, strict=True)
        text = "".join(f"{t},3,{float(x)!r},{float(y)!r}\n" for t, x, y in cells)
        (folder / "other.csv").write_text(f"t_ns,id,x_{unit},y_{unit}\n{text}")
        assert fit(folder, "truth.parquet", str(folder / "other.csv"), "--overwrite") == ExitCode.DONE
        return float(json.loads((folder / "motion.json").read_text())["noise"])

    assert noise("cm", 100.0) == pytest.approx(noise("m", 1.0), rel=1e-6)
