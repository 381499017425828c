"""Objects that walk by potential fields: no one walks through anybody, through a wall, or into standing people."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from places import EXAMPLES
from scipy.spatial.distance import pdist

from occlog.cli.main import run
from occlog.core.navigation.obstacles import MovingObstacleTracks, StepClock
from occlog.core.plane import distance_to_boundary, inside_polygon, line_of_sight_blocked
from occlog.errors import ExitCode, InputError
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.recording.reader import open_recording
from occlog.records.losses import Loss
from occlog.records.scene import Occluder, Scene
from occlog.records.tables import Tracks, Truth
from occlog.settings import configure
from occlog.simulate.config import START_NS, FieldConfig, WorldConfig
from occlog.simulate.stage import simulate_truth

SQUARE = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 6.0], [0.0, 6.0]])
L_ROOM = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 3.0], [3.0, 3.0], [3.0, 8.0], [0.0, 8.0]])
PILLAR = Occluder("pillar", np.array([[3.6, 2.5], [4.2, 2.5], [4.2, 3.1], [3.6, 3.1]]))
ROOMS = {"pillar": Scene(room=SQUARE, occluders=(PILLAR,)), "corner": Scene(room=L_ROOM)}
STEP_NS = 100_000_000


def walked(scene: Scene, seed: int, people: MovingObstacleTracks | None = None, **values: object) -> np.ndarray:
    """(T, n, 2) places of all objects."""
    config = configure(WorldConfig.in_unit("m"), {"motion": "field", "targets": 4, "steps": 200, **values})
    rows = Truth.concat(simulate_truth(scene, config, seed, people=people))
    return np.column_stack([rows.x, rows.y]).reshape(config.steps, config.targets, 2)


def people(xy: np.ndarray) -> MovingObstacleTracks:
    """One person at (T, 2) places, and a step before and after."""
    whole = np.concatenate([xy[:1], xy, xy[-1:]])
    t_ns = START_NS + np.arange(-1, len(xy) + 1) * STEP_NS
    rows = np.column_stack([whole, np.full(len(whole), 0.25)])
    return MovingObstacleTracks(
        t_ns, np.zeros(len(whole), np.int32), rows, StepClock(START_NS, 0.1), limit_ns=2 * STEP_NS
    )


@pytest.mark.jit
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("room", sorted(ROOMS))
def test_no_one_walks_through_anybody_or_through_a_wall(room: str, seed: int):
    scene = ROOMS[room]
    path = walked(scene, seed)
    flat = path.reshape(-1, 2)
    assert scene.room is not None
    assert inside_polygon(flat, scene.room).all()
    assert min(distance_to_boundary(x, y, scene.room) for x, y in flat) >= 0.25 * (1 - 1e-12)
    for occluder in scene.occluders:
        assert min(distance_to_boundary(x, y, occluder.polygon) for x, y in flat) >= 0.25 * (1 - 1e-12)
        for i in range(path.shape[1]):
            hidden = [
                line_of_sight_blocked(a, b[None], occluder.polygon)[0]
                for a, b in zip(path[:-1, i], path[1:, i], strict=True)
            ]
            assert not any(hidden)
    assert min(pdist(places).min() for places in path) >= 0.5 * (1 - 1e-12)


@pytest.mark.jit
def test_objects_keep_their_speed_and_get_about():
    path = walked(ROOMS["pillar"], 1, process_noise_position=0.0)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=2)
    # A step is turned or halved where others are in the way
    assert np.median(steps) == pytest.approx(0.12)
    assert steps.max() <= 0.12 * (1 + 1e-9)
    assert (np.ptp(path, axis=0).max(axis=1) > 2.0).all()


@pytest.mark.jit
def test_objects_keep_farther_apart_than_by_waypoints():
    closest = {}
    for motion in ("field", "waypoints"):
        gaps = [pdist(places).min() for seed in range(3) for places in walked(ROOMS["pillar"], seed, motion=motion)]
        closest[motion] = np.quantile(gaps, 0.02)
    assert closest["field"] > 1.05 * closest["waypoints"]


@pytest.mark.jit
def test_a_longer_walk_begins_like_a_shorter_one_and_a_seed_gives_the_same():
    scene = ROOMS["pillar"]
    short, long = walked(scene, 3, steps=20), walked(scene, 3, steps=300)
    np.testing.assert_array_equal(long[:20], short)
    assert (walked(scene, 4, steps=20) != short).any()


@pytest.mark.jit
@pytest.mark.parametrize("seed", range(2))
def test_no_one_walks_into_a_person_who_stands(seed: int):
    place = np.array([2.0, 3.0])
    path = walked(ROOMS["pillar"], seed, people(np.tile(place, (200, 1))))
    assert np.hypot(*(path - place).reshape(-1, 2).T).min() >= 0.5 * (1 - 1e-12)


@pytest.mark.jit
def test_a_person_who_walks_slowly_is_left_alone():
    line = np.column_stack([np.linspace(1.0, 6.5, 200), np.full(200, 4.5)])
    for seed in range(3):
        path = walked(ROOMS["pillar"], seed, people(line))
        assert np.linalg.norm(path - line[:, None], axis=2).min() >= 0.5 * (1 - 1e-12)


@pytest.mark.jit
def test_a_floor_full_of_people_is_refused():
    room = Scene(room=np.array([[0.0, 0.0], [1.2, 0.0], [1.2, 1.2], [0.0, 1.2]]))
    with pytest.raises(InputError, match="no positions found for 1 objects next to 1 people"):
        walked(room, 0, people(np.full((20, 2), 0.6)), targets=1, steps=10)


def test_waypoints_know_nothing_of_fields():
    assert WorldConfig().motion == "waypoints"
    assert FieldConfig.in_unit("m").attraction_power == 1


@pytest.mark.jit
def test_what_was_lost_of_the_people_to_avoid_is_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    tracks, out, lost = tmp_path / "walk.parquet", tmp_path / "among.mcap", Loss("cam1.mp4", "frame 7", "is cut", 1)
    one = {n: [1.0] for n in ("x", "y", "vx", "vy", "cov_xx", "cov_xy", "cov_yy")}
    someone = Tracks.of(t_ns=[1_577_836_800 * 10**9], target_id=np.zeros(1, np.int32), **one)
    write_table(tracks, someone, Provenance("track", losses=(lost,)))
    args = ["--motion", "field", "--avoid", str(tracks), "--seconds", "1"]
    assert run(["simulate", str(EXAMPLES / "room.yaml"), "-o", str(out), *args]) == ExitCode.DONE
    assert open_recording(out).losses == (lost,)
    assert "cam1.mp4: frame 7" in capsys.readouterr().err


@pytest.mark.jit
def test_a_recording_of_walkers_that_avoid_people_says_how_often_they_were_walked_into(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    room, walk, among = str(EXAMPLES / "room.yaml"), tmp_path / "walk.mcap", tmp_path / "among.mcap"
    short = ["--seconds", "4", "--json", "-q"]
    assert run(["simulate", room, "-o", str(walk), *short, "--occluders", "2"]) == ExitCode.DONE
    assert "motion" not in open_recording(walk).provenance.parameters["world"]  # as before there was a choice
    capsys.readouterr()
    args = ["--motion", "field", "--avoid", str(walk), "--influence-distance", "1.2", "--seed", "3"]
    assert run(["simulate", room, "-o", str(among), *short, *args]) == ExitCode.DONE
    result = json.loads(capsys.readouterr().out)
    assert result["people_avoided"] == 3
    assert result["collisions"] >= 0
    made = open_recording(among).provenance
    assert made.parameters["world"]["motion"] == "field"
    assert made.parameters["field"]["influence_distance"] == 1.2
    assert [name for name, _ in made.inputs] == ["room.yaml", "walk.mcap"]


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (
            ["--influence-distance", "2"],
            "--influence-distance applies to walkers that avoid obstacles; add --motion field",
        ),
        (["--avoid", "walk.mcap"], "--avoid applies to walkers that avoid obstacles; add --motion field"),
        (["--motion", "straight"], "--motion"),
    ],
)
def test_options_of_the_field_want_the_field(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], args: list[str], words: str
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "walk.mcap").touch()
    code = run(["simulate", str(EXAMPLES / "room.yaml"), "-o", str(tmp_path / "x.mcap"), *args])
    assert code == ExitCode.USAGE
    assert words in capsys.readouterr().err
