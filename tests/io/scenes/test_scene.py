"""Scene files are read strictly and written so that they mean the same."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import yaml

from occlog.errors import InputError
from occlog.io.formats.models.schemas import scene_schema
from occlog.io.formats.scenes.scene import read_scene, scene_from_yaml, scene_to_yaml
from occlog.records.scene import Camera, Scene

GOOD = """
occlog_scene: 1
room: [[0, 0], [0, 10], [10, 10], [10, 0]]
static_occluders:
  - {name: pillar, polygon: [[4, 4], [5, 4], [5, 5]]}
cameras:
  - {name: a, position: [0, 0], yaw_deg: 45, focal_px: 70, fov_deg: 90, noise: {position: 1, yaw: 1e-2,
  measurement_noise_px: 2}}
  - name: b
    position: [0, 0, 2]
    yaw_deg: 45
    pitch_deg: -20
    roll_deg: 5
    focal_px: [700, 701]
    image_size_px: [640, 480]
    distortion: {coefficients: [0.1]}
    clock: studio
  - {name: c, focal_px: 500, image_size_px: [320, 240]}
microphone_arrays:
  - {name: m, position: [1, 1], sigma_deg: 3, microphones: [[0, 0, 0], [0.1, 0, 0]]}
clocks:
  - {name: studio, offset_ns: 1500, drift_ppm: 2.5}
common_noise: {center: [5, 4], position: 0.2, yaw_deg: 1, scale: 0.02}
"""


def test_values_arrive() -> None:
    scene = scene_from_yaml(GOOD, "s.yaml")
    a, b, c = scene.cameras
    assert a.yaw == pytest.approx(np.pi / 4)
    assert a.fov == pytest.approx(np.pi / 2)
    assert (a.sigma_position, a.sigma_yaw, a.sigma_read_px) == (1.0, 0.01, 2.0)
    assert b.principal_px.tolist() == [319.5, 239.5]
    assert b.distortion.tolist() == [0.1, 0, 0, 0, 0]
    assert not c.placed
    assert scene.arrays[0].sigma == pytest.approx(np.radians(3))
    assert scene.clocks[0].offset_ns == 1500
    assert scene.room is not None
    x, y = scene.room.T
    assert np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) > 0  # turned counter-clockwise


def test_pose_and_powers_of_an_array() -> None:
    one = scene_from_yaml(GOOD, "s.yaml").arrays[0]
    assert one.upright
    assert (one.resolution, one.sigma_elevation, one.planar) == (0.0, None, False)
    more = "yaw_deg: 30, pitch_deg: -90, roll_deg: 5, sigma_elevation_deg: 6, resolution_deg: 4, planar: true"
    text = GOOD.replace("sigma_deg: 3", f"sigma_deg: 3, {more}")
    for array in (
        scene_from_yaml(text, "s").arrays[0],
        scene_from_yaml(scene_to_yaml(scene_from_yaml(text, "s")), "s").arrays[0],
    ):
        assert np.degrees([array.pitch, array.roll, array.resolution]) == pytest.approx([-90, 5, 4])
        assert array.sigma_elevation == pytest.approx(np.radians(6))
        assert array.planar
        assert not array.upright
        assert array.rotation[:, 0] == pytest.approx([0, 0, -1])  # what was forward is now down


def test_field_of_view_follows_from_the_image_of_a_level_camera() -> None:
    text = GOOD.replace("pitch_deg: -20", "pitch_deg: 0").replace("roll_deg: 5", "roll_deg: 0").replace("[0.1]", "[0]")
    assert scene_from_yaml(text, "s").cameras[1].fov == pytest.approx(2 * np.arctan(320 / 700))


def test_a_pitched_camera_sees_more_azimuths() -> None:
    level = scene_from_yaml(GOOD.replace("pitch_deg: -20", "pitch_deg: 0"), "s").cameras[1].fov
    assert scene_from_yaml(GOOD, "s").cameras[1].fov > level


def test_written_scenes_mean_the_same() -> None:
    text = scene_to_yaml(scene_from_yaml(GOOD, "s"))
    again = scene_from_yaml(text, "again")
    assert scene_to_yaml(again) == text
    for one, two in zip(scene_from_yaml(GOOD, "s").cameras, again.cameras, strict=True):
        assert np.array_equal(one.rotation, two.rotation)
        assert one.fov == two.fov
        assert one.placed == two.placed
    common = again.common_noise
    assert common is not None
    assert (*common.center, common.position, common.yaw, common.scale) == pytest.approx((5, 4, 0.2, np.pi / 180, 0.02))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("yaw_deg: 45,", "yaw_dge: 45,", "line 7: unknown key 'yaw_dge' in cameras[0]; did you mean 'yaw_deg'?"),
        ("yaw_deg: 45,", "yaw_deg: 45, yaw: 1,", "camera a: both yaw and yaw_deg are given; keep one"),
        ("yaw_deg: 45,", "yaw: 45,", "camera a: yaw is 45, more than a turn in radians; if it is in degrees"),
        ("yaw_deg: 45,", "", "camera a: has a position but no yaw_deg; add it"),
        ("position: [0, 0],", "", "camera a: has angles but no position"),
        ("position: [0, 0],", "position: abc,", "line 7: cameras[0].position: expected `array | null`"),
        (
            "measurement_noise_px: 2",
            "measured_noise_px: 2",
            "line 8: unknown key 'measured_noise_px' in cameras[0].noise; did you mean 'measurement_noise_px'?",
        ),
        ("occlog_scene: 1", "occlog_scene: 1\nocluders: []", "line 3: unknown key 'ocluders'"),
        ("occlog_scene: 1", "occlog_scene: 9", "occlog_scene"),
        ("occlog_scene: 1", "length_unit: m", "missing required field `occlog_scene`"),
        ("focal_px: 70", "focal_px: -70", "line 7: cameras[0].focal_px: expected `float` >= 0.001, got -70"),
        ("focal_px: 70", "focal_px: .nan", "line 7: cameras[0].focal_px: nan is not a finite number"),
        ("focal_px: 70", "focal_px: no", "cameras[0].focal_px"),
        ("position: 1,", "position: 1.0e+300,", "line 7: cameras[0].noise.position: expected `float` <= 1000000000000"),
        ("yaw: 1e-2", "yaw: 1.0e+300", "line 7: cameras[0].noise.yaw: expected `float` <= 6.2832"),
        (
            "measurement_noise_px: 2",
            "measurement_noise_px: 1.0e-300",
            "line 8: cameras[0].noise.measurement_noise_px: expected `float` >= 1e-09",
        ),
        (
            "position: [0, 0],",
            "position: [0, 1.0e+150],",
            "line 7: cameras[0].position[1]: expected `float` <= 1000000",
        ),
        ("yaw_deg: 45,", "yaw_deg: 1.0e+17,", "line 7: cameras[0].yaw_deg: expected `float` <= 1000000"),
        ("clock: studio", "rate_hz: 1.0e+300", "cameras[1].rate_hz: expected `float` <= 1000000"),
        ("sigma_deg: 3", "sigma_deg: 1.0e-300", "microphone_arrays[0].sigma_deg: expected `float` >= 1e-13"),
        ("drift_ppm: 2.5", "drift_ppm: 1.0e+6", "clocks[0].drift_ppm: expected `float` < 1000000"),
        (", fov_deg: 90", "", "camera a: give fov_deg, or image_size_px"),
        ("name: b", "name: a", "two sensors are named 'a'"),
        ("clocks:", "clocks:\n  - {name: studio, offset_ns: 0}", "two clocks are named 'studio'"),
        ("clock: studio", "clock: stduio", "b: clock 'stduio' is not defined; define it in clocks, or name"),
        ("room: [[0, 0], [0, 10], [10, 10]", "room: [[0, 0], [10, 10], [0, 10]", "room: not a simple"),
        ("room:", "cameras: []\nroom:", "key 'cameras' appears twice"),
        ("room:", "room: [1\nroom:", "not valid YAML"),
        ("[[4, 4], [5, 4], [5, 5]]", "[[4, 4], [5, 4]]", "polygon: expected `array` of length >= 3"),
        ("rotation", "rotation", ""),
    ],
)
def test_what_is_wrong_is_named(old: str, new: str, message: str) -> None:
    if not message:
        matrix = "rotation: [[1, 0, 0], [0, 1, 0], [0, 0, 2]]"
        old, new, message = "yaw_deg: 45,", matrix + ",", "camera a: rotation is not orthonormal"
    assert old in GOOD
    with pytest.raises(InputError) as caught:
        scene_from_yaml(GOOD.replace(old, new, 1), "s.yaml")
    assert message in str(caught.value)
    assert str(caught.value).startswith("s.yaml: ")
    assert "\n" not in str(caught.value)


def test_a_pile_of_aliases_is_refused() -> None:
    bomb = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n"
    bomb += "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 9))
    with pytest.raises(InputError, match="aliases"):
        scene_from_yaml(bomb, "s.yaml")


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"", "is empty"), (b"\xff\xfe", "not UTF-8"), (b"- 1\n", "expected keys and values"), (None, "no such")],
)
def test_files_that_are_none(tmp_path: Path, content: bytes | None, message: str) -> None:
    path = tmp_path / "s.yaml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_scene(path)


def test_scene_fits_its_published_schema() -> None:
    schema = scene_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(json.loads(json.dumps(yaml.safe_load(GOOD.replace("1e-2", "0.01")))), schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({"occlog_scene": 1, "camera": []}, schema)


def test_numbers_of_numpy_are_written_as_numbers() -> None:
    made = Camera(
        name="c",
        position=np.zeros(3),
        rotation=np.eye(3),
        focal_px=np.full(2, 500.0),
        principal_px=np.array([320.0, 240.0]),
        fov=np.radians(80.0),
    )
    again = scene_from_yaml(scene_to_yaml(Scene(cameras=(made,))), "s")
    assert again.cameras[0].fov == made.fov
