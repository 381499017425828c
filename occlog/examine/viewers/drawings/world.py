"""Static parts of a scene, sensor poses and calibrations, and observations of sensors, for viewers.

Floor, walls, static occluders with their shadows, names of sensors; lines of sight, selected cameras, and what people
hide from cameras.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

from occlog.array_types import Floats
from occlog.io.formats.calibration.readers.ros import rotation_quaternion
from occlog.records.scene import Camera, MicrophoneArray, Occluder, Scene

from .people import Palette, PeopleDrawing, PersonEstimate
from .shapes import (
    CHOSEN,
    FLOOR,
    GREY,
    PILLAR,
    SHADOW,
    WALL,
    Cylinder,
    DrawingGroup,
    Fill,
    Polyline,
    Text,
    at_height,
    faded,
    fan,
    rim,
    triangles,
)

if TYPE_CHECKING:
    from shapely import Polygon


WORLD = "world"
MODELS = {"brown": ("plumb_bob", 5), "opencv": ("rational_polynomial", 8), "equidistant": ("kannala_brandt", 4)}
"""Models of distortion by our names: the viewers' name, and how many coefficients it has."""


def world_of(scene: Scene | None) -> str:
    """Return the name of the world's coordinate frame.

    It differs from the names of sensors, which name their frames.
    """
    names = () if scene is None else [sensor.name for sensor in scene.sensors]
    return WORLD if WORLD not in names else f"{WORLD}_"


def placed(scene: Scene) -> list[Camera | MicrophoneArray]:
    """Return the cameras of the scene that have poses, then its microphone arrays."""
    return [*(camera for camera in scene.cameras if camera.placed), *scene.arrays]


def frame_transforms(scene: Scene, t_ns: int, metres: float) -> bytes:
    """Return an encoded `foxglove.FrameTransforms` with the pose of each placed sensor in the world.

    Args:
        scene: the sensors.
        t_ns: time [ns].
        metres: metres per length unit of the scene.
    """
    message = FrameTransforms()
    for sensor in placed(scene):
        entry = message.transforms.add(parent_frame_id=world_of(scene), child_frame_id=sensor.name)
        entry.timestamp.FromNanoseconds(t_ns)
        position, turn = entry.translation, entry.rotation
        position.x, position.y, position.z = (metres * sensor.position).tolist()
        turn.x, turn.y, turn.z, turn.w = rotation_quaternion(sensor.rotation).tolist()
    data: bytes = message.SerializeToString(deterministic=True)
    return data


def camera_calibration(camera: Camera, size: tuple[int, int], t_ns: int) -> bytes:
    """Return an encoded `foxglove.CameraCalibration` for images of `size` (width, height) [px] at the time `t_ns` [ns].

    Distortion models that viewers do not support (`tsai`, thin prism, tilted sensor) are omitted, so that their
    projections are inaccurate towards the image edges.
    """
    intrinsics = camera.intrinsic_matrix
    model, count = MODELS.get(camera.distortion_model, ("", 0))
    if camera.distortion[8:].any():
        model, count = "", 0
    message = CameraCalibration(
        frame_id=camera.name,
        width=size[0],
        height=size[1],
        distortion_model=model,
        D=camera.distortion[:count].tolist(),
        K=intrinsics.ravel().tolist(),
        R=[1, 0, 0, 0, 1, 0, 0, 0, 1],
        P=np.column_stack([intrinsics, np.zeros(3)]).ravel().tolist(),
    )
    message.timestamp.FromNanoseconds(t_ns)
    data: bytes = message.SerializeToString(deterministic=True)
    return data


def smaller_camera(camera: Camera, shrunk: float) -> Camera:
    """Return the camera for images reduced by the factor `shrunk` (at most 1), without an image size."""
    return replace(
        camera,
        focal_px=shrunk * camera.focal_px,
        principal_px=shrunk * (camera.principal_px + 0.5) - 0.5,
        image_size=None,
    )


NAME_SIZE = 0.25
"""Height of the name of a sensor or an occluder [m]."""
REACH = 60.0
"""Length of shadows without a room [m]."""
LIFTED = 0.01
"""Shadows are this far above the floor, so that viewers draw them over it [m]."""


def plan(scene: Scene, metres: float) -> list[DrawingGroup]:
    """Return the shapes of the floor plan [m]: room, static occluders, and sensors with a known pose.

    `metres`: metres per length unit of the scene.
    """
    things: list[DrawingGroup] = []
    if scene.room is not None:
        room = metres * scene.room
        things.append(DrawingGroup("room", lines=[_outline(room, 0.0)], fills=[Fill(triangles(room, 0.0), FLOOR)]))
    things += [_prism(occluder, metres) for occluder in scene.occluders]
    for sensor in placed(scene):
        position = metres * sensor.position
        foot = np.array([[*position[:2], 0.0], position])
        lines = [Polyline(foot, GREY, 1.0, dashed=True)] if position[2] > 0 else []
        name = Text(position + np.array([0.0, 0.0, NAME_SIZE]), sensor.name, NAME_SIZE, WALL)
        things.append(DrawingGroup(f"sensor {sensor.name}", lines=lines, texts=[name]))
    return things


def _outline(polygon: Floats, z: float) -> Polyline:
    return Polyline(at_height(np.vstack([polygon, polygon[:1]]), z), WALL, 2.0)


def _prism(occluder: Occluder, metres: float) -> DrawingGroup:
    base, height = metres * occluder.polygon, metres * occluder.height
    ring = np.vstack([base, base[:1]])
    walls = []
    for a, b in itertools.pairwise(ring):
        low, high = at_height(np.array([a, b]), 0.0), at_height(np.array([a, b]), height)
        walls += [low[0], low[1], high[1], low[0], high[1], high[0]]
    posts = [Polyline(np.array([[*corner, 0.0], [*corner, height]]), WALL, 1.0) for corner in base]
    lines = [_outline(base, 0.0), _outline(base, height), *posts]
    name = Text(np.array([*base.mean(axis=0), height + NAME_SIZE]), occluder.name, NAME_SIZE, WALL)
    fills = [Fill(np.array(walls), PILLAR), Fill(triangles(base, height), PILLAR)]
    return DrawingGroup(f"occluder {occluder.name}", lines, fills=fills, texts=[name])


def static_shadows(scene: Scene, metres: float) -> list[DrawingGroup]:
    """Return the parts of the floor [m] that static occluders hide, as filled shapes, one group for each camera.

    `metres`: metres per length unit of the scene.
    """
    things = []
    room = walls(scene, metres)
    for camera in (c for c in scene.cameras if c.placed):
        eye = (metres * camera.position)[None]
        found = [shadows(eye, metres * o.polygon[None], metres * np.array([o.height]), room) for o in scene.occluders]
        fills = [Fill(fan(shape, LIFTED), SHADOW) for (shape,) in found if shape is not None]
        if fills:
            things.append(DrawingGroup(f"static {camera.name}", fills=fills))
    return things


def walls(scene: Scene, metres: float) -> Polygon | None:
    """Return the boundary at which shadows end: the convex hull of the room [m]; None without a room.

    `metres`: metres per length unit of the scene.
    """
    import shapely

    return None if scene.room is None else shapely.convex_hull(shapely.MultiPoint(metres * scene.room))


def shadows(eyes: Floats, bases: Floats, heights: Floats, room: Polygon | None) -> list[Floats | None]:
    """Return the part of the floor [m] that each upright prism hides from a camera, base included, as a convex polygon.

    A prism at least as high as the camera hides everything behind it, up to the walls; a lower one up to where the
    floor is visible over its top. One polygon (k, 2) for each of n pairs of camera and prism; None if nothing is
    hidden.

    Args:
        eyes: (n, 3) positions of the cameras.
        bases: (n, K, 2) base of each prism; its convex hull counts.
        heights: (n,) of the prisms, > 0.
        room: boundary of the shadows (see `walls`); None: none.
    """
    import shapely

    feet, polygon = eyes[:, None, :2], shapely.GeometryType.POLYGON
    hulls = shapely.convex_hull(shapely.multipoints(shapely.points(bases)))
    there = (shapely.get_type_id(hulls) == polygon) & ~shapely.contains(hulls, shapely.points(eyes[:, :2]))
    away = bases - feet
    grown = REACH / np.maximum(np.linalg.norm(away, axis=2), 1e-9)
    over = eyes[:, 2] > heights
    seen_again = eyes[over, 2] / (eyes[over, 2] - heights[over])
    grown[over] = np.minimum(grown[over], seen_again[:, None])
    both = np.concatenate([bases, feet + np.maximum(grown, 1.0)[:, :, None] * away], axis=1)
    areas = shapely.convex_hull(shapely.multipoints(shapely.points(both)))
    if room is not None:
        areas = shapely.intersection(areas, room)
    there &= (shapely.get_type_id(areas) == polygon) & ~shapely.is_empty(areas)
    rings = shapely.get_exterior_ring(areas)
    return [shapely.get_coordinates(ring)[:-1] if ok else None for ring, ok in zip(rings, there.tolist(), strict=True)]


MIDDLE = 0.5
"""Lines of sight end at this share of a person's height."""
UNKNOWN_REACH = 8.0
"""Length of a line of sight that is of no target with known position [m]."""
MARK = 0.3
"""Diameter of the mark of a camera that was selected [m]."""
_TURNS = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
AROUND = np.column_stack([np.cos(_TURNS), np.sin(_TURNS)])
"""(8, 2) corners of a person that throws a shadow, of radius 1."""


class SightDrawing:
    """Makes shapes of what the sensors of a scene observe: lines of sight, selected cameras, shadows of people."""

    def __init__(self, scene: Scene, metres: float, palette: Palette, crowd: PeopleDrawing) -> None:
        """Create a drawing for the sensors of a scene.

        Args:
            scene: the scene.
            metres: metres per length unit of the scene.
            palette: colours of the targets.
            crowd: current positions of the targets, shared and updated elsewhere.
        """
        self._scene, self._metres, self._palette, self._crowd = scene, metres, palette, crowd
        self._sensors: Mapping[str, Camera | MicrophoneArray] = {sensor.name: sensor for sensor in placed(scene)}
        self._walls = walls(scene, metres)

    def lines(self, sensor: str, targets: Sequence[int], azimuths: Sequence[float]) -> list[DrawingGroup] | None:
        """Return the lines of sight of one sensor at one time; None if the sensor has no pose in the scene.

        They end at the target; a dashed grey line leads to a target that the sensor did not detect.

        Args:
            sensor: its name.
            targets: identity of each target; -1: unknown.
            azimuths: bearing of each in the world [rad]; NaN: not detected.
        """
        known = self._sensors.get(sensor)
        if known is None:
            return None
        eye = self._metres * known.position
        things = []
        for n, (target, azimuth) in enumerate(zip(targets, azimuths, strict=True)):
            person = self._crowd.find(target)
            line = _missed(eye, person) if math.isnan(azimuth) else _seen(eye, azimuth, person, self._palette)
            if line is not None:
                things.append(DrawingGroup(f"{sensor} {n}", lines=[line]))
        return things

    def chosen(self, names: Iterable[str]) -> list[DrawingGroup]:
        """Return marks at the cameras with these names, as selected by the tracker; unknown names are omitted."""
        things = []
        for name in names:
            if name in self._sensors:
                foot = self._metres * self._sensors[name].position - [0, 0, 0.5 * MARK]
                things.append(DrawingGroup(f"selected {name}", columns=[Cylinder(foot, MARK, MARK, CHOSEN)]))
        return things

    def shadows(self, t_ns: int) -> list[DrawingGroup]:
        """Return the parts of the floor [m] that people hide from each camera at the time `t_ns` [ns], as areas."""
        people = self._crowd.at(t_ns)
        cameras = [c for c in self._scene.cameras if c.placed]
        if not people or not cameras:
            return []
        middles = np.array([person.xy for person in people])
        radii = 0.5 * np.array([person.width for person in people])
        bases = middles[:, None] + radii[:, None, None] * AROUND
        heights = np.array([person.height for person in people])
        eyes = np.array([self._metres * camera.position for camera in cameras])
        n, m = len(cameras), len(people)
        shapes = shadows(np.repeat(eyes, m, axis=0), np.tile(bases, (n, 1, 1)), np.tile(heights, n), self._walls)
        things = []
        for k, camera in enumerate(cameras):
            own = [shape for shape in shapes[k * m : (k + 1) * m] if shape is not None]
            fills = [Fill(fan(shape, LIFTED), faded(SHADOW, 0.2)) for shape in own]
            if fills:
                things.append(DrawingGroup(f"behind people, from {camera.name}", fills=fills))
        return things


def _seen(eye: Floats, azimuth: float, person: PersonEstimate | None, palette: Palette) -> Polyline:
    reach = UNKNOWN_REACH if person is None else float(np.linalg.norm(person.xy - eye[:2]))
    tip = eye[:2] + reach * np.array([np.cos(azimuth), np.sin(azimuth)])
    height = float(eye[2]) if person is None else MIDDLE * person.height
    colour = GREY if person is None else palette(person.target)
    return Polyline(np.array([eye, [*tip, height]]), faded(colour, 0.8), 1.5)


def _missed(eye: Floats, person: PersonEstimate | None) -> Polyline | None:
    if person is None:
        return None
    return Polyline(np.array([eye, [*person.xy, MIDDLE * person.height]]), faded(GREY, 0.6), 1.0, dashed=True)


def moving_occluders(middles: Floats, covariances: Floats, metres: float) -> list[DrawingGroup]:
    """Return the 95 % ellipses of the tracker's Gaussian priors of moving occluders, as shapes [m].

    Args:
        middles: (n, 2) means.
        covariances: (n, 2, 2).
        metres: metres per length unit of both.
    """
    things = []
    for k, (middle, covariance) in enumerate(zip(middles, covariances, strict=True)):
        ring = rim(metres * middle, metres**2 * covariance)
        things.append(DrawingGroup(f"occluder {k}", lines=[Polyline(at_height(ring, 0.02), GREY, 1.5, dashed=True)]))
    return things
