"""Whole paths: the printed example, ends of paths, obstacles of scenes and people who move."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.core.navigation.steering import SteeringState
from occlog.errors import InputError
from occlog.papers.lee.navigation.config import NavigateConfig
from occlog.papers.lee.navigation.obstacle_course import Disc, course_of, people_of
from occlog.papers.lee.navigation.run import RobotVerdict
from occlog.papers.lee.navigation.stage import Drive, End, drive
from occlog.records.scene import Occluder, Scene
from occlog.records.tables import Tracks, Truth
from occlog.scans.occluder_priors import obstacles_of
from occlog.settings import configure

PLANE = Scene(length_unit="unit")
PRINTED = Disc(8.0, 8.0)
SECOND = 1_000_000_000
ROOM = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 6.0], [0.0, 6.0]])
PILLAR = Occluder("pillar", np.array([[3.5, 2.5], [4.5, 2.5], [4.5, 3.5], [3.5, 3.5]]))


def driven(
    scene: Scene = PLANE,
    discs: tuple[Disc, ...] = (PRINTED,),
    start: tuple[float, float] = (12.0, 12.0),
    goal: tuple[float, float] = (6.0, 6.0),
    people: Tracks | Truth | None = None,
    **values: object,
) -> tuple[np.ndarray, Drive, RobotVerdict]:
    """The places of one robot, how it fared, and the verdict."""
    config = configure(NavigateConfig.in_unit(scene.length_unit), values)
    moving = None if people is None else obstacles_of(people, int(people.t_ns[0]), people_of(config))
    course = course_of(scene, discs, moving, config)
    robots = Drive.at(np.array([start], dtype=np.float64))
    steps = list(drive(robots, np.array([goal], dtype=np.float64), course, config))
    positions = np.concatenate([step.xy for step in steps])
    return positions, robots, RobotVerdict(robots, 0, np.array(goal), course.names, config)


def test_with_the_original_force_the_printed_robot_collides_from_9_9():
    positions, robots, verdict = driven(force="original", escape="none")
    np.testing.assert_allclose(positions, [[at, at] for at in (12.0, 11.0, 10.0, 9.0, 8.0)])
    assert robots.end[0] == End.COLLIDED
    assert verdict.words() == "collided with obstacle 1 in step 4"
    assert not verdict.reached
    assert robots.clearance[0] == pytest.approx(0.0, abs=1e-12)


def test_with_the_prevention_the_printed_robot_goes_to_and_fro_for_ever():
    positions, robots, verdict = driven(escape="none")
    np.testing.assert_allclose(positions[3:6], [[9.0, 9.0], [10.0, 10.0], [9.0, 9.0]])
    assert robots.end[0] == End.ENDLESS
    assert not verdict.trap
    assert "oscillates for ever before obstacle 1" in verdict.warning()
    assert robots.clearance[0] == pytest.approx(math.sqrt(2.0))


@pytest.mark.parametrize(
    ("radius", "escape", "steps", "clearance", "end"),
    [
        (0.0, "inside", 8, 1.13720, End.REACHED),
        (0.2, "inside", 8, 1.13720, End.REACHED),
        (0.2, "outside", 9, 0.50786, End.REACHED),
        (0.5, "outside", 6, 0.63960, End.COLLIDED),
        (0.0, "outside", 6, 1.41421, End.ENDLESS),
    ],
)
def test_escapes_of_the_printed_robot(radius: float, escape: str, steps: int, clearance: float, end: End):
    """The distances of centres are those of an independent implementation: 8 steps; .508 in 9; .640 < 1."""
    _, robots, _ = driven(discs=(Disc(8.0, 8.0, radius),), radius=radius, escape=escape)
    assert (robots.end[0], robots.steps[0]) == (end, steps)
    assert robots.clearance[0] + 2.0 * radius == pytest.approx(clearance, abs=1e-5)


def test_both_sides_of_the_printed_line_are_alike():
    left, _, _ = driven(side="left")
    right, _, _ = driven(side="right")
    np.testing.assert_allclose(left, right[:, ::-1], atol=1e-9)


def test_a_robot_on_its_goal_has_reached_it_without_a_step():
    positions, robots, verdict = driven(start=(6.0, 6.5))
    assert len(positions) == 1
    assert (robots.end[0], robots.steps[0]) == (End.REACHED, 0)
    assert verdict.figures()["length"] == 0.0


@pytest.mark.parametrize(("reach", "steps"), [(2.0, 4), (1.999, 5)])
def test_the_goal_is_reached_within_the_distance_that_is_asked_for(reach: float, steps: int):
    _, robots, _ = driven(discs=(), start=(6.0, 0.0), goal=(0.0, 0.0), goal_tolerance=reach, speed=1.0)
    assert robots.steps[0] == steps


def test_a_local_minimum_is_a_trap_and_stated_to_be_one():
    """The thesis leaves this one aside: the forces cancel farther away than a step from the obstacle."""
    _, robots, verdict = driven(Scene(room=ROOM, occluders=(PILLAR,)), (), (1.0, 3.0), (7.0, 3.0))
    assert robots.end[0] == End.ENDLESS
    assert verdict.trap
    assert "a local minimum" in verdict.words()


def test_steps_that_run_out_are_reported_to():
    _, robots, verdict = driven(discs=(), max_steps=3)
    assert (robots.end[0], robots.steps[0]) == (End.STOPPED, 3)
    assert "all 3 steps done, 4.243 from the goal" in verdict.words()


@pytest.mark.parametrize("shape", ["circle", "polygon"])
def test_robots_pass_a_pillar_on_either_side(shape: str):
    scene = Scene(room=ROOM, occluders=(PILLAR,))
    for side, y in ((1.0, 3.6), (-1.0, 2.4)):
        positions, _, verdict = driven(scene, (), (1.0, y), (7.0, y), shape=shape)
        assert verdict.reached, verdict.words()
        beside = positions[np.abs(positions[:, 0] - 4.0) < 0.5, 1] - 3.0
        assert (side * beside > 0.5 + 0.25).all()


def test_a_wall_between_start_and_goal_is_a_collision_without_repulsion():
    wall = Occluder("screen", np.array([[4.0, 0.0], [4.1, 0.0], [4.1, 6.0], [4.0, 6.0]]))
    _, robots, verdict = driven(
        Scene(room=ROOM, occluders=(wall,)),
        (),
        (1.0, 3.0),
        (7.0, 3.0),
        shape="polygon",
        repulsion=0.0,
        collinearity_tolerance=0.0,
        collision_guard=False,
        force="original",
    )
    assert robots.end[0] == End.COLLIDED
    assert "static occluder screen" in verdict.words()


def people(x: np.ndarray, y: float, variance: float = 0.0) -> Tracks:
    """One person on a line."""
    flat = np.zeros(len(x))
    return Tracks.of(
        t_ns=np.arange(len(x)) * SECOND // 10,
        target_id=flat.astype(np.int32),
        x=x,
        y=flat + y,
        vx=flat,
        vy=flat,
        cov_xx=flat + variance,
        cov_xy=flat,
        cov_yy=flat,
    )


def test_people_who_cross_are_passed_and_those_who_do_not_move_aside_are_collisions():
    crossing = people(np.linspace(7.0, 1.0, 80), 3.4)
    _, _, passed = driven(Scene(room=ROOM), (), (1.0, 3.0), (7.0, 3.0), people=crossing)
    assert passed.reached, passed.words()
    _, robots, hit = driven(
        Scene(room=ROOM),
        (),
        (1.0, 3.4),
        (7.0, 3.4),
        people=crossing,
        repulsion=0.0,
        force="original",
        escape="none",
        collision_guard=False,
    )
    assert robots.end[0] == End.COLLIDED
    assert "collided with person 0" in hit.words()


def test_a_person_counts_while_their_track_lasts():
    short = people(np.full(5, 4.0), 3.0)
    _, robots, verdict = driven(Scene(room=ROOM), (), (1.0, 3.0), (7.0, 3.0), people=short)
    assert verdict.reached
    assert robots.clearance[0] > 0.1  # of the walls: the person left long before the robot came


def test_without_anything_in_the_way_there_is_no_clearance():
    gone = people(np.full(3, 4.0), 3.0)
    _, robots, verdict = driven(Scene(), (), (1.0, 3.0), (7.0, 3.0), people=gone, max_gap_s=0.0)
    assert verdict.reached
    assert robots.clearance[0] < 3.0  # while the person was there
    _, robots, verdict = driven(PLANE, ())
    assert verdict.figures()["least_clearance"] is None
    assert verdict.figures()["nearest"] == ""


def test_moving_obstacles_grow_with_their_uncertainty():
    config = configure(NavigateConfig.in_unit("m"), {"inflation_sigmas": 2.0})
    rows = people(np.linspace(1.0, 2.0, 11), 3.0, variance=0.09)
    moment = obstacles_of(rows, 0, people_of(config)).at(5)
    np.testing.assert_allclose(moment.xy, [[1.5, 3.0]])
    np.testing.assert_allclose(moment.move, [[0.1, 0.0]])
    np.testing.assert_allclose(moment.radius, 0.25 + 2.0 * 0.3)


def test_moving_obstacles_are_the_same_in_whichever_order_steps_are_asked_for():
    config = configure(NavigateConfig.in_unit("m"), {})
    rows = people(np.linspace(1.0, 7.0, 600), 3.0)
    forward, back = obstacles_of(rows, 0, people_of(config)), obstacles_of(rows, 0, people_of(config))
    there = [forward.at(k).xy for k in range(590)]
    again = [back.at(k).xy for k in reversed(range(590))][::-1]
    np.testing.assert_array_equal(there, again)


def test_many_robots_fare_as_each_alone():
    config = NavigateConfig(radius=0.2, escape="outside")
    course = course_of(PLANE, (Disc(8.0, 8.0, 0.2),), None, config)
    starts = np.random.default_rng(0).uniform(9.0, 14.0, (40, 2))
    goals = np.full_like(starts, 6.0)
    together = Drive.at(starts)
    for _ in drive(together, goals, course, config):
        pass
    for n in range(len(starts)):
        alone = Drive.at(starts[n : n + 1])
        for _ in drive(alone, goals[:1], course, config):
            pass
        assert (alone.end[0], alone.steps[0]) == (together.end[n], together.steps[n])
        np.testing.assert_allclose(alone.xy[0], together.xy[n])
        assert alone.clearance[0] == pytest.approx(together.clearance[n])


@pytest.mark.parametrize(
    ("what", "position", "words"),
    [
        ("start", (4.0, 3.0), "inside static occluder pillar"),
        ("goal", (4.0, 3.0), "inside static occluder pillar"),
        ("start", (9.0, 3.0), "outside the room"),
        ("start", (0.2, 3.0), "0.2 from wall 4; expected more than the robot's radius 0.25"),
        ("start", (1.0, 1.0), "inside obstacle 1"),
        ("start", (3.35, 3.0), "0.15 from static occluder pillar"),
    ],
)
def test_places_where_no_robot_can_be_are_refused(what: str, position: tuple[float, float], words: str):
    config = NavigateConfig.in_unit("m")
    course = course_of(Scene(room=ROOM, occluders=(PILLAR,)), (Disc(1.0, 1.0, 0.3),), None, config)
    with pytest.raises(InputError, match=words):
        course.check_position(what, np.array(position), config)


def test_a_place_farther_from_a_wall_than_the_robots_radius_is_free():
    config = NavigateConfig.in_unit("m")
    course = course_of(Scene(room=ROOM), (), None, config)
    course.check_position("start", np.array([0.2501, 3.0]), config)
    with pytest.raises(InputError, match="more than the robot's radius"):
        course.check_position("start", np.array([0.25, 3.0]), config)  # it touches, which counts as a collision


def test_a_goal_within_the_circle_about_an_occluder_is_free_where_the_polygon_repels():
    course, config = {}, {}
    for shape in ("circle", "polygon"):
        config[shape] = configure(NavigateConfig.in_unit("m"), {"shape": shape, "radius": 0.05})
        course[shape] = course_of(Scene(room=ROOM, occluders=(PILLAR,)), (), None, config[shape])
    beside = np.array([3.4, 3.0])
    course["polygon"].check_position("goal", beside, config["polygon"])
    with pytest.raises(InputError, match="inside the circle about static occluder pillar, which repels"):
        course["circle"].check_position("goal", beside, config["circle"])


@pytest.mark.parametrize("position", [(1.0, 3.0), (1.0, 1.0), (4.0, 5.5), (7.5, 5.5)])
def test_a_guarded_robot_does_not_collide_with_what_stands_even_without_forces(position: tuple[float, float]):
    scene = Scene(room=ROOM, occluders=(PILLAR,))
    for goal in ((7.0, 3.0), (0.3, 0.3), (4.0, 0.5)):
        for speed in (1.0, 4.0):
            _, robots, _ = driven(
                scene, (Disc(2.0, 2.0, 0.2),), position, goal, repulsion=0.0, speed=speed, max_steps=100
            )
            assert robots.end[0] != End.COLLIDED
            assert robots.clearance[0] > 0.0


def test_a_guarded_robot_lets_a_person_pass_and_says_where_the_guard_acted():
    crossing = people(np.linspace(7.0, 1.0, 80), 3.4)
    _, _, verdict = driven(Scene(room=ROOM), (), (1.0, 3.4), (7.0, 3.4), people=crossing, repulsion=0.0)
    assert verdict.reached
    assert verdict.figures()["states"]["guarded"] > 0


def test_the_guard_leaves_steps_alone_that_do_not_collide():
    scene = Scene(room=ROOM, occluders=(PILLAR,))
    plain, _, _ = driven(scene, (), (1.0, 3.6), (7.0, 3.6), collision_guard=False)
    guarded, robots, _ = driven(scene, (), (1.0, 3.6), (7.0, 3.6))
    np.testing.assert_array_equal(plain, guarded)
    assert robots.states[0, SteeringState.GUARDED] == 0


def test_a_robot_that_the_guard_holds_back_says_so_and_counts_no_way_that_it_did_not_go():
    corridor = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 0.6], [0.0, 0.6]])
    screen = Occluder("screen", np.array([[4.0, 0.0], [4.1, 0.0], [4.1, 0.6], [4.0, 0.6]]))
    scene, forces = (
        Scene(room=corridor, occluders=(screen,)),
        {"repulsion": 0.0, "force": "original", "shape": "polygon"},
    )
    positions, robots, verdict = driven(scene, (), (1.0, 0.3), (7.0, 0.3), max_steps=150, **forces)
    assert robots.end[0] in (End.ENDLESS, End.STOPPED)
    assert "where the guard holds it back" in verdict.words()
    assert verdict.trap
    assert verdict.figures()["length"] == pytest.approx(np.hypot(*np.diff(positions, axis=0).T).sum())
