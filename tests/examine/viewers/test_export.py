"""`occlog export` for viewers: what messages say, by the published schemas, against the rows they show."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from mcap_protobuf.schema import build_file_descriptor_set
from viewer_runs import CAMERA, MADE, NS, fill, scene, view_tracks

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.examine.viewers.series import SCHEMA
from occlog.io.files.tables.table_writer import write_table
from occlog.io.recording.reader import open_recording
from occlog.io.recording.writer import RecordingWriter
from occlog.records.tables import Boxes, Occluders, Particles
from occlog.report.drawing import target_colour

SCHEMAS: dict[str, Any] = {
    kind.DESCRIPTOR.full_name: kind
    for kind in (
        CameraCalibration, CompressedImage, FrameTransforms, ImageAnnotations, Log, PointCloud, SceneUpdate,
    )
}  # fmt: skip
DRAWN_BY_RERUN = {
    "foxglove.CameraCalibration", "foxglove.CompressedImage", "foxglove.FrameTransforms", "foxglove.Log",
    "foxglove.PointCloud",
}  # fmt: skip


def read(path: Path) -> tuple[dict[str, list[tuple[int, Any]]], dict[str, Any]]:
    """Messages (time, message) and schemas by topic; those of ROS 2 as their bytes."""
    messages: dict[str, list[tuple[int, Any]]] = {}
    schemas: dict[str, Any] = {}
    factory = DecoderFactory()
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            decode = factory.decoder_for(channel.message_encoding, schema)
            decoded = message.data if decode is None else decode(message.data)
            messages.setdefault(channel.topic, []).append((message.log_time, decoded))
            schemas[channel.topic] = schema
            if schema.name in SCHEMAS:  # the published message reads the bytes, and knows every field
                known = SCHEMAS[schema.name].FromString(message.data)
                assert known.SerializeToString(deterministic=True) == message.data
    return messages, schemas


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Messages of the formats for some viewers of one folder, and the layout."""
    folder = fill(tmp_path_factory.mktemp("viewers"))
    layout = ["--layout", str(folder / "layout.json"), "--to", "foxglove"]
    assert run(["export", str(folder), "-o", str(folder / "f.mcap"), "-q", *layout]) == ExitCode.DONE
    assert run(["export", str(folder), "-o", str(folder / "r.mcap"), "--to", "rerun", "-q"]) == ExitCode.DONE
    foxglove, schemas = read(folder / "f.mcap")
    rerun, points = read(folder / "r.mcap")
    text = json.loads((folder / "layout.json").read_text())
    return {"foxglove": foxglove, "schemas": schemas, "rerun": rerun, "points": points, "layout": text, "in": folder}


def entities(update: Any) -> dict[str, Any]:
    return {entity.id: entity for entity in update.entities}


def places(points: Any) -> np.ndarray:
    return np.array([[p.x, p.y, p.z] for p in points])


def cloud(message: Any) -> tuple[np.ndarray, np.ndarray]:
    """Points and colours of a cloud."""
    rows = np.frombuffer(message.data, dtype=[("xyz", "<f4", 3), ("rgba", "u1", 4)])
    assert message.point_stride == rows.dtype.itemsize
    return rows["xyz"].astype(float), rows["rgba"]


def test_every_message_has_the_published_schema(shown: dict[str, Any]) -> None:
    for schemas in (shown["schemas"], shown["points"]):
        for topic, schema in schemas.items():
            assert schema.encoding == ("ros2msg" if schema.name == SCHEMA else "protobuf"), topic
            if schema.name.startswith("foxglove."):
                published = build_file_descriptor_set(SCHEMAS[schema.name])
                assert {f.name: f for f in FileDescriptorSet.FromString(schema.data).file} == {
                    f.name: f for f in published.file
                }
            else:
                assert schema.name == SCHEMA or schema.name.startswith("occlog."), topic


def test_frames_of_reference_are_those_of_the_transforms(shown: dict[str, Any]) -> None:
    # A sensor is called as the world usually is, so that the world has another name
    ((_, tree),) = shown["foxglove"]["/tf"]
    frames = {entry.child_frame_id for entry in tree.transforms} | {entry.parent_frame_id for entry in tree.transforms}
    assert frames == {"world_", "world", "east"}
    for messages in (shown["foxglove"], shown["rerun"]):
        for rows in messages.values():
            for _, message in rows:
                named = [message.frame_id] if hasattr(message, "frame_id") else []
                named += [entity.frame_id for entity in getattr(message, "entities", ())]
                assert frames.issuperset(named)


def test_transform_and_calibration_project_as_the_camera_does(shown: dict[str, Any]) -> None:
    ((_, tree),) = shown["foxglove"]["/tf"]
    (pose,) = [entry for entry in tree.transforms if entry.child_frame_id == "east"]
    x, y, z, w = (getattr(pose.rotation, n) for n in "xyzw")
    turn = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    position = np.array([getattr(pose.translation, n) for n in "xyz"])
    ((_, seen),) = shown["foxglove"]["/camera/east/calibration"]
    point = np.array([2.0, 1.3, 0.4])
    ahead = np.array(seen.P).reshape(3, 4) @ np.append(turn.T @ (point - position), 1.0)
    np.testing.assert_allclose(ahead[:2] / ahead[2], CAMERA.project(point[None])[0], atol=1e-9)
    assert (seen.width, seen.height, list(seen.K)[:3]) == (64, 48, [60.0, 0.0, 31.5])


def test_images_are_the_bytes_of_the_recording(shown: dict[str, Any]) -> None:
    frames = shown["foxglove"]["/camera/east/image"]
    kept = [frame.encoded for frame in open_recording(shown["in"] / "recording.mcap").frames()]
    assert [message.data for _, message in frames] == kept
    assert [(t_ns, message.format) for t_ns, message in frames] == [(NS, "png"), (2 * NS, "png")]
    again = open_recording(shown["in"] / "f.mcap")
    assert [(frame.t_ns, frame.index) for frame in again.frames()] == [(NS, 0), (2 * NS, 1)]
    assert again.scene is None  # it is to point at: nothing that measures may take it for the recording


def test_people_stand_where_tracks_say_in_the_colours_of_the_report(shown: dict[str, Any]) -> None:
    first, second = (entities(message) for _, message in shown["foxglove"]["/targets"])
    assert set(first) == {"target 3", "target 7"}
    for n, (name, xy) in enumerate({"target 3": (2.5, 1.0), "target 7": (1.0, 2.5)}.items()):
        (body,) = second[name].cylinders
        assert (body.pose.position.x, body.pose.position.y, body.pose.orientation.w) == (*xy, 1.0)
        rgb = f"#{''.join(f'{round(255 * c):02x}' for c in (body.color.r, body.color.g, body.color.b))}"
        assert rgb == target_colour(n)
    assert (second["target 3"].cylinders[0].size.z, second["target 7"].cylinders[0].size.z) == (1.8, 1.7)
    assert [each[name].texts[0].text for each in (first, second) for name in each] == ["3", "7", "3?", "7?"]
    sure, unsure = first["target 3"].lines[0], second["target 7"].lines[0]
    assert (sure.type, unsure.type) == (LinePrimitive.Type.LINE_STRIP, LinePrimitive.Type.LINE_LIST)
    # 95 % of a Gaussian in the plane is within 2.4477 standard deviations
    np.testing.assert_allclose(np.ptp(places(sure.points)[:, :2], axis=0), 2 * 2.4477 * np.array([0.2, 0.1]), rtol=1e-4)
    np.testing.assert_allclose(places(second["target 7"].lines[1].points)[:, :2], [[1, 2], [1, 2.5]])  # its trail


def test_a_message_says_all_of_its_topic(shown: dict[str, Any]) -> None:
    topics = [topic for topic in shown["foxglove"] if shown["schemas"][topic].name == "foxglove.SceneUpdate"]
    assert topics
    for topic in topics:
        for t_ns, message in shown["foxglove"][topic]:
            (gone,) = message.deletions
            assert gone.type == SceneEntityDeletion.Type.ALL
            assert gone.timestamp.ToNanoseconds() == t_ns
            assert all(entity.timestamp.ToNanoseconds() == t_ns for entity in message.entities)


def test_sight_lines_end_at_targets(shown: dict[str, Any]) -> None:
    (_, first), (_, second) = shown["foxglove"]["/sight_lines/east"]
    lines = [places(entity.lines[0].points) for entity in first.entities]
    np.testing.assert_allclose([line[0] for line in lines], [[6.0, 1.0, 2.5]] * 2)
    np.testing.assert_allclose(lines[0][1], [2.0, 1.0, 0.9], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(lines[1][1][:2] - [6, 1]), np.hypot(5.0, 1.0))
    (missed,) = second.entities  # looked for and not seen: dashed, to where the target was thought to be
    assert missed.lines[0].type == LinePrimitive.Type.LINE_LIST
    ((_, heard),) = shown["foxglove"]["/sight_lines/world"]
    np.testing.assert_allclose(places(heard.entities[0].lines[0].points)[:, 0], 3.0)


def test_plan_truth_selection_and_shadows_are_drawn(shown: dict[str, Any]) -> None:
    ((_, drawn),) = shown["foxglove"]["/plan"]
    assert set(entities(drawn)) == {"room", "occluder pillar", "sensor east", "sensor world"}
    corners = places(entities(drawn)["occluder pillar"].triangles[0].points)
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], [[1, 3, 0], [1.5, 3.5, 2]])
    ((_, true),) = shown["foxglove"]["/truth"]
    assert set(entities(true)) == {"true 3", "true 9"}
    (_, chosen), (_, none) = shown["foxglove"]["/selected"]
    assert (set(entities(chosen)), len(none.entities)) == ({"selected east"}, 0)
    (_, dark), _ = shown["foxglove"]["/shadows"]
    x = np.concatenate([places(fill.points) for entity in dark.entities for fill in entity.triangles])[:, 0]
    assert x.min() == 0.0  # up to the wall behind them
    assert x.max() < 2.3


def test_ellipses_over_an_image_are_those_of_the_rows(shown: dict[str, Any]) -> None:
    (_, first), (_, second) = shown["foxglove"]["/camera/east/image/annotations"]
    outline, hidden = first.points
    assert (outline.type, hidden.type) == (PointsAnnotation.Type.LINE_STRIP, PointsAnnotation.Type.LINE_LIST)
    xy = np.array([[p.x, p.y] for p in outline.points]) - 0.5  # there pixels begin at whole numbers
    np.testing.assert_allclose([xy.min(axis=0), xy.max(axis=0)], [[16, 15], [24, 35]], atol=1e-9)
    assert [text.text for text in first.texts] == ["3", "7"]
    assert not second.points  # nothing is known of the second frame


def test_boxes_lie_over_images_on_topics_of_their_own(tmp_path: Path) -> None:
    folder = fill(tmp_path)
    some = {"t_ns": [NS, 2 * NS], "sensor": ["east"] * 2, "frame": [0, 1], "box": [0, -1], "target_id": [-1, -1]}
    place = {"left_px": [9.5, np.nan], "top_px": [4.5, np.nan], "width_px": [10, np.nan], "height_px": [20, np.nan]}
    boxes = Boxes.of(**some, **place, confidence=[0.5, np.nan])
    write_table(folder / "boxes.parquet", boxes, MADE)
    layout = folder / "l.json"
    assert run(["export", str(folder), "-o", str(folder / "f.mcap"), "-q", "--layout", str(layout)]) == ExitCode.DONE
    messages, _ = read(folder / "f.mcap")
    (_, first), (_, second) = messages["/camera/east/image/boxes"]
    xy = np.array([[p.x, p.y] for p in first.points[0].points])
    np.testing.assert_allclose([xy.min(axis=0), xy.max(axis=0)], [[10, 5], [20, 25]])
    assert not second.points  # the detector looked and found nothing: the box goes
    shown = json.loads(layout.read_text())["configById"]["Image!east"]["imageMode"]["annotations"]
    assert shown == {
        "/camera/east/image/annotations": {"visible": True},
        "/camera/east/image/boxes": {"visible": False},
    }


def test_world_tracks_are_projected_where_nothing_was_tracked_in_images(tmp_path: Path) -> None:
    folder = fill(tmp_path)
    (folder / "view_tracks.parquet").unlink()
    assert run(["export", str(folder), "-o", str(folder / "f.mcap"), "-q"]) == ExitCode.DONE
    messages, _ = read(folder / "f.mcap")
    (_, first), (_, second) = messages["/camera/east/image/annotations"]
    box = np.array([[p.x, p.y] for p in first.points[0].points]) - 0.5
    middle = CAMERA.project(np.array([[2.0, 1.0, 0.0], [2.0, 1.0, 1.8]]))
    assert box[:, 0].min() < middle[0, 0] < box[:, 0].max()
    # The rims of feet and head are a little in front of and behind the middle
    assert abs(box[:, 1].max() - middle[0, 1]) < 3
    assert abs(box[:, 1].min() - middle[1, 1]) < 3
    # The filter of one began again, no one sees the other
    assert {line.type for line in first.points} == {PointsAnnotation.Type.LINE_STRIP}
    assert {line.type for line in second.points} == {PointsAnnotation.Type.LINE_LIST}


def test_rerun_gets_what_it_draws_alone(shown: dict[str, Any]) -> None:
    names = {schema.name for schema in shown["points"].values()}
    assert names == DRAWN_BY_RERUN | {SCHEMA}
    assert set(shown["rerun"]) == set(shown["foxglove"])
    points, colours = cloud(shown["rerun"]["/targets"][0][1])
    assert {f"#{bytes(c[:3]).hex()}" for c in colours} == {target_colour(0), target_colour(1)}
    near = np.linalg.norm(points[:, None, :2] - [[2.0, 1.0], [1.0, 2.0]], axis=2).min(axis=1)
    assert near.max() < 0.5


def test_the_file_for_all_viewers_holds_what_those_for_some_hold(shown: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "all.mcap"
    layout = ["--layout", str(tmp_path / "layout.json")]
    assert run(["export", str(shown["in"]), "-o", str(path), "-q", *layout]) == ExitCode.DONE
    both, _ = read(path)
    lines = {topic: rows for topic, rows in both.items() if topic.startswith("/")}
    assert {t: as_bytes(rows) for t, rows in lines.items()} == {t: as_bytes(r) for t, r in shown["foxglove"].items()}
    for topic, rows in shown["rerun"].items():
        twin = both.get(topic.removeprefix("/"), lines[topic])
        assert as_bytes(twin) == as_bytes(rows), topic
    # Rerun makes one entity of two topics that differ in a slash; the other viewers show those that a layout names
    assert {f"/{topic.removeprefix('/')}" for topic in both} == set(shown["rerun"])
    assert json.loads((tmp_path / "layout.json").read_text()) == shown["layout"]


def as_bytes(rows: list[tuple[int, Any]]) -> list[tuple[int, bytes]]:
    return [(t_ns, m if isinstance(m, bytes) else m.SerializeToString(deterministic=True)) for t_ns, m in rows]


def test_points_stand_where_lines_and_areas_are(shown: dict[str, Any]) -> None:
    drawn = [t for t, schema in shown["schemas"].items() if schema.name == "foxglove.SceneUpdate"]
    wanted = {"/plan", "/static_shadows", "/targets", "/truth", "/selected", "/shadows", "/sight_lines/east"}
    assert wanted <= set(drawn)
    for topic in drawn:
        for (t_ns, update), (at_ns, message) in zip(shown["foxglove"][topic], shown["rerun"][topic], strict=True):
            points, _ = cloud(message)
            assert (t_ns, bool(update.entities)) == (at_ns, bool(len(points))), topic
            corners = [places(line.points) for entity in update.entities for line in entity.lines]
            corners += [places(fill_.points) for entity in update.entities for fill_ in entity.triangles]
            if corners:  # each corner of what is drawn has a point, dashes and areas as well
                away = [np.linalg.norm(points - corner, axis=1).min() for corner in np.concatenate(corners)]
                assert max(away) < 0.05, topic


def test_clouds_over_images_fall_on_the_ellipses(shown: dict[str, Any]) -> None:
    points, _ = cloud(shown["rerun"]["/camera/east/image/annotations"][0][1])
    u, v = (points[:, :2] / points[:, 2:] * CAMERA.focal_px + CAMERA.principal_px).T
    on = np.minimum(np.hypot((u - 20) / 4, (v - 25) / 10), np.hypot((u - 40) / 3, (v - 20) / 8))
    np.testing.assert_allclose(on, 1.0, atol=0.08)  # dashes are straight


def test_numbers_and_log_say_what_the_rows_say(shown: dict[str, Any]) -> None:
    rows = shown["foxglove"]["/diagnostics/3"]
    assert [(t_ns, message.n_detected) for t_ns, message in rows] == [(NS, 1.0), (2 * NS, 0.0)]
    assert rows[0][1].ess == 80.5
    assert np.isnan(rows[1][1].ess)
    assert [m.x for _, m in shown["foxglove"]["/tracks/7"]] == [1.0, 1.0]
    reported = [(t_ns, m.level, m.name, m.message) for t_ns, m in shown["foxglove"]["/log"]]
    warn = Log.Level.WARNING
    assert reported == [
        (NS, warn, "target 7", "possible_switch with 3, probability 0.25"),
        (2 * NS, warn, "target 3", "restart"),
    ]


def test_the_layout_names_panels_and_topics_that_there_are(shown: dict[str, Any]) -> None:
    layout = shown["layout"]

    def panels(node: Any) -> list[str]:
        return [node] if isinstance(node, str) else panels(node["first"]) + panels(node["second"])

    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
    image = layout["configById"]["Image!east"]["imageMode"]
    named = [image["imageTopic"], image["calibrationTopic"], *image["annotations"]]
    named += layout["configById"]["3D!space"]["topics"]
    named += [path["value"].rpartition(".")[0] for path in layout["configById"]["Plot!0"]["paths"]]
    assert set(named) <= set(shown["foxglove"])


def test_other_units_become_metres(tmp_path: Path) -> None:
    folder = fill(tmp_path, "ft")
    assert run(["export", str(folder), "-o", str(folder / "f.mcap"), "-q"]) == ExitCode.DONE
    messages, _ = read(folder / "f.mcap")
    body = entities(messages["/targets"][0][1])["target 3"].cylinders[0]
    assert body.pose.position.x == pytest.approx(2 * 0.3048)
    assert body.size.z == pytest.approx(1.8 * 0.3048)


def test_images_are_made_smaller_with_all_that_lies_over_them(tmp_path: Path) -> None:
    folder = fill(tmp_path)
    assert run(["export", str(folder), "-o", str(folder / "f.mcap"), "-q", "--height", "24"]) == ExitCode.DONE
    messages, _ = read(folder / "f.mcap")
    image = cv2.imdecode(np.frombuffer(messages["/camera/east/image"][0][1].data, np.uint8), cv2.IMREAD_COLOR)
    seen = messages["/camera/east/calibration"][0][1]
    assert (image.shape, seen.width, seen.height) == ((24, 32, 3), 32, 24)
    # The middle between four pixels is the middle of one
    assert list(seen.K) == [30.0, 0.0, 15.5, 0.0, 31.0, 11.5, 0.0, 0.0, 1.0]
    xy = np.array([[p.x, p.y] for p in messages["/camera/east/image/annotations"][0][1].points[0].points])
    np.testing.assert_allclose(
        [xy.min(axis=0), xy.max(axis=0)], 0.5 * (np.array([[16, 15], [24, 35]]) + 0.5), atol=1e-9
    )


def test_what_has_ended_is_no_longer_shown(tmp_path: Path) -> None:
    folder = fill(tmp_path)
    with RecordingWriter(folder / "long.mcap", scene(), MADE) as out:
        png = cv2.imencode(".png", np.zeros((48, 64), dtype=np.uint8))[1].tobytes()
        for k in range(10):
            out.image("east", (k + 1) * NS, k, png, "png")
    words = ["--recording", str(folder / "long.mcap"), "-q"]
    for to in ("foxglove", "rerun"):
        path = folder / f"{to}.mcap"
        assert run(["export", str(folder), "--to", to, "-o", str(path), *words]) == ExitCode.DONE
        messages, _ = read(path)
        for topic in ("/targets", "/sight_lines/east", "/shadows"):
            t_ns, last = messages[topic][-1]
            # The last rows are of 2 s, a second after those before them
            assert t_ns == 4.5 * NS
            assert not (last.data if to == "rerun" else last.entities)


def test_moving_occluders_go_when_there_are_none(tmp_path: Path) -> None:
    folder, nothing = fill(tmp_path), np.nan
    there = {"x": [1.0, nothing], "y": [1.0, nothing], "cov_xx": [0.1, nothing], "cov_yy": [0.1, nothing]}
    rows = Occluders.of(t_ns=[NS, 2 * NS], occluder_id=[0, -1], cov_xy=[0.0, nothing], **there)
    write_table(folder / "occluders.parquet", rows, MADE, length_unit="m")
    assert run(["export", str(folder), "-o", str(folder / "f.mcap"), "-q"]) == ExitCode.DONE
    messages, _ = read(folder / "f.mcap")
    assert [(t_ns, len(m.entities)) for t_ns, m in messages["/occluders"]] == [(NS, 1), (2 * NS, 0)]


def test_a_damaged_image_is_a_loss(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = fill(tmp_path, broken=True)
    assert run(["export", str(folder), "-o", str(folder / "f.mcap"), "-q", "--json"]) == ExitCode.LOSSY
    result = json.loads(capsys.readouterr().out)
    assert (result["frames"], result["losses"][0]["place"]) == (1, "frame 1")
    assert open_recording(folder / "f.mcap").losses[0].what.startswith("camera east: cut short")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--target", "3"], "--target: format viewers shows everything"),
        (["--to", "rerun", "--layout", "x.json"], "--layout: format rerun takes none"),
        (["--to", "csv", "--quality", "50"], "--quality: is for viewers' formats only"),
    ],
)
def test_options_that_do_not_fit_are_refused(
    shown: dict[str, Any], arguments: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["export", str(shown["in"]), "-o", str(shown["in"] / "new.mcap"), *arguments]) == ExitCode.USAGE
    assert expected in capsys.readouterr().err
    assert not (shown["in"] / "new.mcap").exists()


def test_tracks_in_images_without_images_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_table(tmp_path / "v.parquet", view_tracks(), MADE)
    assert run(["export", str(tmp_path / "v.parquet"), "-q", "-o", str(tmp_path / "new.mcap")]) == ExitCode.BAD_INPUT
    assert "tracks and boxes in images need --recording" in capsys.readouterr().err
    assert not (tmp_path / "new.mcap").exists()


def test_a_folder_without_a_run_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["export", str(tmp_path), "-o", str(tmp_path / "new.mcap")]) == ExitCode.BAD_INPUT
    assert "not the folder of a run" in capsys.readouterr().err


@pytest.mark.parametrize("to", ["viewers", "foxglove", "rerun"])
def test_particles_are_points_in_the_colour_of_their_target(tmp_path: Path, to: str) -> None:
    folder = fill(tmp_path)
    rows = Particles.of(
        t_ns=[NS, NS, NS], target_id=[3, 3, 7], particle=[0, 1, 0], x=[2.0, 2.5, 1.0], y=[1.0, 1.5, 2.0],
        weight=[0.5, 0.5, 1.0],
    )  # fmt: skip
    write_table(folder / "particles.parquet", rows, MADE, length_unit="m")
    out, layout = tmp_path / "out.mcap", tmp_path / "layout.json"
    arguments = ["--to", to, *(() if to == "rerun" else ("--layout", str(layout)))]
    assert run(["export", str(folder), "-o", str(out), "-q", *arguments]) == ExitCode.DONE
    messages, schemas = read(out)
    assert schemas["/particles"].name == "foxglove.PointCloud"
    assert "particles" not in messages
    ((t_ns, shown),) = messages["/particles"]
    assert t_ns == NS
    dots = np.frombuffer(shown.data, np.dtype([("xyz", "<f4", 3), ("rgba", "u1", 4)]))
    np.testing.assert_allclose(dots["xyz"][:, :2], [[2.0, 1.0], [2.5, 1.5], [1.0, 2.0]])
    assert len({tuple(colour) for colour in dots["rgba"].tolist()}) == 2
    if to != "rerun":
        assert "/particles" in layout.read_text()
