"""Path files: what they say, defaults, and one line for what does not fit."""

import math
import re

import pytest
from places import ROOT

from occlog.errors import InputError
from occlog.io.formats.scenes.paths import paths_from_yaml, read_paths
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.records.scene import Segment

EXAMPLES = ROOT / "examples"
WHOLE = """
occlog_paths: 1
length_unit: ft
seconds: 12
rate_hz: 5
targets:
- id: 7
  position: [1, 2, 3]
  velocity: [0.5, 0]
  from_s: 1
  until_s: 11.5
  noise_density: 0.01
  segments:
  - {lateral: 0.2, plane: zx, until_s: 3}
  - {acceleration: [0, 1]}
  - {from_s: 6, until_s: 8, velocity: [1, 1, 1], lateral: -1}
  silent: [[2, 3], [5, 7.5]]
- {id: 2, role: occluder, position: [4, 5]}
"""


def target(line: str) -> str:
    return f"occlog_paths: 1\ntargets:\n- {{id: 3, position: [1, 2], {line}}}\n"


def test_everything_that_a_file_can_say() -> None:
    script = paths_from_yaml(WHOLE, "x.yaml")
    assert (script.length_unit, script.seconds, script.rate_hz, script.heights) == ("ft", 12.0, 5.0, True)
    other, one = script.targets
    assert (other.id, other.role, other.velocity, other.until_s) == (2, "occluder", (0.0, 0.0, 0.0), math.inf)
    assert other.position[:2] == (4.0, 5.0)
    assert math.isnan(other.position[2])
    assert (one.position, one.velocity, one.from_s, one.until_s) == ((1.0, 2.0, 3.0), (0.5, 0.0, 0.0), 1.0, 11.5)
    assert (one.noise_density, one.silent) == (0.01, ((2.0, 3.0), (5.0, 7.5)))
    assert one.segments == (
        Segment(1.0, 3.0, 0.2, "zx"),
        Segment(3.0, 6.0, acceleration=(0.0, 1.0, 0.0)),
        Segment(6.0, 8.0, -1.0, velocity=(1.0, 1.0, 1.0)),
    )


@pytest.mark.parametrize("name", sorted(p.name for p in EXAMPLES.glob("*_paths.yaml")))
def test_examples_are_read(name: str) -> None:
    assert read_paths(EXAMPLES / name).targets


def test_what_the_documentation_shows_is_read() -> None:
    page, scenes = (
        (ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("how-to/simulate.md", "reference/scenes.md")
    )
    (block,) = re.findall(r"```yaml\n(occlog_paths.*?)```", page, re.DOTALL)
    assert len(paths_from_yaml(block, "x").targets[0].segments) == 3
    (block,) = re.findall(r"```yaml\n(occlog_scene.*?)```", scenes, re.DOTALL)
    assert math.isclose(scene_from_yaml(block, "x").arrays[0].resolution, math.radians(5))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("occlog_paths: 1\ntargets: []", "targets: expected `array` of length >= 1"),
        ("targets: [{id: 1, position: [1, 2]}]", "missing required field `occlog_paths`"),
        ("occlog_paths: 2\ntargets: []", "occlog_paths: 2 is none of 1"),
        ("[1, 2]", "expected keys and values at the top level"),
        (target("speed: 1"), r"line 3: unknown key 'speed' in targets\[0\]; valid keys: from_s, id,"),
        (target("velocty: [1, 1]"), "did you mean 'velocity'?"),
        (target("velocity: [1]"), "velocity: expected `array` of length >= 2"),
        (target("velocity: [1, 2, 3]"), "target 3: velocity: has 3 numbers, but position has 2"),
        (target("velocity: [1e12, 0]"), "velocity.0.: expected `float` <= 1000000000.0"),
        (target("velocity: [.nan, 0]"), "nan is not a finite number"),
        (target("role: dancer"), "role: 'dancer' is none of occluder, target"),
        (target("until_s: 1, from_s: 2"), "target 3: until_s is 1, before from_s 2"),
        (target("from_s: -1"), "from_s: expected `float` >= 0.0"),
        (target("noise_density: -1"), "noise_density: expected `float` >= 0.0"),
        (target("silent: [[2, 2]]"), r"target 3: silent: \[2, 2\] must go from an earlier time to a later one"),
        (target("silent: [[2]]"), "silent.0.: expected `array` of length 2"),
        (target("segments: [{lateral: 1, acceleration: [1, 1]}]"), r"segments\[0\]: both lateral and acceleration"),
        (target("segments: [{plane: xy}]"), "plane is only for a turn; give its acceleration"),
        (target("segments: [{plane: zx, lateral: 1}]"), "the plane zx needs a target with a height"),
        (target("segments: [{plane: yx, lateral: 1}]"), "plane: 'yx' is none of "),
        (target("segments: [{acceleration: [1, 1, 1]}]"), r"segments\[0\]: acceleration: has 3 numbers"),
        (target("from_s: 5, segments: [{from_s: 4}]"), "starts at 4 s, but the target starts at 5 s"),
        (target("segments: [{until_s: 4}, {from_s: 3}]"), r"\[1\]: starts at 3 s, but the segment before ends at 4 s"),
        (target("segments: [{from_s: 4, until_s: 4}]"), "ends at 4 s, must be after its start at 4 s"),
        (target("segments: [{lateral: 1}, {lateral: 2}]"), r"segments\[1\]: give from_s, or until_s of the segment"),
        (
            "occlog_paths: 1\ntargets:\n- {id: 3, position: [1, 2]}\n- {id: 3, position: [1, 2]}",
            "two targets have the id 3",
        ),
        ("occlog_paths: 1\ntargets:\n- {id: -3, position: [1, 2]}", "id: expected `int` >= 0"),
        ("occlog_paths: 1\nrate_hz: 0\ntargets:\n- {id: 3, position: [1, 2]}", "rate_hz: expected `float` > 0"),
    ],
)
def test_what_does_not_fit_is_one_line(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        paths_from_yaml(text, "x.yaml")
    assert str(caught.value).startswith("x.yaml: ")
    assert "\n" not in str(caught.value)
    assert re.search(message, str(caught.value)), str(caught.value)
