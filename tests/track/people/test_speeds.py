"""Speeds of people in the verdict: walkers, runners, queues and people who stand; and the same with wrong times."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from occlog.array_types import NS, Floats
from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.records.tables import PeopleTracks
from occlog.track.people.rows import COVARIANCES
from occlog.track.people.speeds import PeopleSpeeds

HEIGHT = 1.7
FPS = 10


def tracks(velocity: Floats, dt_s: float, metre: float = 1.0, ids: int = 0) -> PeopleTracks:
    """Rows of people with these (n, people, 2) velocities [m/s], in a unit of which so many are a metre."""
    n, people, _ = velocity.shape
    position = np.cumsum(velocity, axis=0) * dt_s * metre
    nothing = np.zeros(n * people)
    return PeopleTracks.of(
        t_ns=np.repeat((np.arange(n) * dt_s * NS).astype(np.int64), people),
        target_id=np.tile(np.arange(people) + ids, n),
        x=position[..., 0].ravel(),
        y=position[..., 1].ravel(),
        vx=velocity[..., 0].ravel() * metre,
        vy=velocity[..., 1].ravel() * metre,
        **dict.fromkeys(COVARIANCES, nothing),
        existence_probability=nothing + 1.0,
        height=nothing + HEIGHT * metre,
        width=nothing + 0.5 * metre,
        sd_height=nothing,
        sd_width=nothing,
        seen_by=np.full(n * people, ""),
        quality_flags=np.full(n * people, ""),
    )


def walk(speed: float, seconds: float = 20.0, people: int = 4, seed: int = 0) -> Floats:
    """(n, people, 2) velocities of people who turn as they go, at FPS."""
    rng = np.random.default_rng(seed)
    n = round(seconds * FPS)
    angle = rng.uniform(0, 2 * np.pi, people) + np.cumsum(rng.normal(0.0, 0.1, (n, people)), axis=0)
    pace = speed * np.exp(rng.normal(0.0, 0.1, (n, people)))
    return pace[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def found(*parts: PeopleTracks, height: float = HEIGHT) -> list[str]:
    speeds = PeopleSpeeds(height)
    for part in parts:
        speeds.add(part)
    return [check.id for check in speeds.checks("m") if check.found]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("speed", [0.5, 0.9, 1.4, 3.5, 4.5])
def test_walkers_and_runners_raise_nothing(speed: float, seed: int) -> None:
    velocity = walk(speed, seed=seed)
    assert found(tracks(velocity, 1 / FPS)) == []
    assert found(tracks(velocity, 1 / FPS, metre=100.0), height=100.0 * HEIGHT) == []


def test_people_who_stand_and_a_queue_raise_nothing() -> None:
    assert found(tracks(walk(0.02), 1 / FPS)) == []
    steps = np.zeros((3000, 3, 2))
    for start in range(0, 3000, 200):  # 1.5 s of slow steps every 20 s
        steps[start : start + 15, :, 0] = 0.5
    assert found(tracks(steps, 1 / FPS)) == []


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("speed", [0.6, 0.9, 1.4])
def test_a_frame_rate_ten_times_too_high_or_too_low_is_found(speed: float, seed: int) -> None:
    velocity = walk(speed, seed=seed)
    assert found(tracks(10.0 * velocity, 0.1 / FPS)) == ["speeds-high"]
    assert found(tracks(0.1 * velocity, 10.0 / FPS)) == ["speeds-low"]


def test_fast_people_in_short_tracks_are_found_at_a_lower_speed() -> None:
    velocity = walk(4.0, seconds=0.8)
    parts = [tracks(velocity, 1 / FPS, ids=10 * k) for k in range(5)]
    assert found(*parts) == ["speeds-high"]


def test_nothing_is_stated_of_few_rows() -> None:
    speeds = PeopleSpeeds(HEIGHT)
    speeds.add(tracks(walk(20.0, seconds=1.0, people=1), 1 / FPS))
    (check,) = speeds.checks("m")
    assert check.status == "not applicable"


def test_rows_in_parts_give_what_they_give_at_once() -> None:
    whole = tracks(walk(1.0), 1 / FPS)
    one, many = PeopleSpeeds(HEIGHT), PeopleSpeeds(HEIGHT)
    one.add(whole)
    for rows in np.array_split(np.arange(len(whole)), 9):
        many.add(whole.take(rows))
    assert one.checks("m") == many.checks("m")
    assert one.median == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
def test_a_frame_rate_ten_times_too_high_is_in_the_verdict_of_track(
    shared_cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three people at 0.7 m/s, whom two cameras see at 10 frames a second."""
    case, recording = shared_cases / "v06-time-column-in-ms", tmp_path / "w.mcap"
    args = ["ingest", "-o", str(recording), "--fps", "100"]
    for name in ("left", "right"):
        lines = (case / f"{name}.csv").read_text().splitlines()
        (tmp_path / f"{name}.csv").write_text("\n".join(line.partition(",")[2] for line in lines))
        args += ["--boxes", f"{name}={tmp_path / name}.csv", "--calibration", str(case / f"{name}.yaml")]
    assert run(args) == ExitCode.DONE
    assert run(["track", str(recording), "--method", "jipda", "-o", str(tmp_path / "t.parquet")]) == ExitCode.DONE
    assert "no (track: speeds-high)" in capsys.readouterr().out
