"""The scene of an ingested recording: calibrated cameras, arrays, and additions of a scene file.

A camera with frames of another size than its calibration is scaled, cropped or refused. The world of a calibration is
levelled: z up, the ground at z = 0, since azimuths, fields of view and heights of people require an upright world.
Calibrations of stereo rigs and with boards often have the world frame at a camera or at the board.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.geometry.camera import turn_upright, vertical
from occlog.errors import InputError, UsageError, option
from occlog.io.files.names import check_meaning, match_sensor, safe_name
from occlog.io.files.texts.csv_rows import first_line
from occlog.io.formats.boxes.reader import BoxSurvey
from occlog.io.formats.calibration.common import CALIBRATION, mirror_matrix
from occlog.io.formats.calibration.reader import CalibrationFile, read_calibration
from occlog.io.formats.sound.formats import read_arrays
from occlog.io.formats.tags import read_readers
from occlog.io.frames.camera_source import CameraSource
from occlog.io.open import load_scene
from occlog.records.messages import listed
from occlog.records.names import first_double
from occlog.records.scene import HEIGHT_SLACK, Camera, MicrophoneArray, Scene, camera_fov, camera_rotation
from occlog.records.tables import Truth
from occlog.records.verdicts import Check, outcome

from .plan import IngestPlan
from .rig import AUTO, axis_vector, describe, pose_checks, scene_checks, world_checks


class Turn(NamedTuple):
    """Transform that levels a calibration's world: p -> R p - (0, 0, ground).

    The ground then is at z = 0. R has a reflection (determinant -1) if the calibration's world is left-handed.
    """

    rotation: Floats  # (3, 3), of determinant -1 with a reflection
    ground: float  # height of the ground after the rotation

    def positions(self, xyz: Floats) -> Floats:
        """(N, 3) positions in the levelled world of positions `xyz` (N, 3) in the calibration's world."""
        return np.asarray(xyz @ self.rotation.T - [0.0, 0.0, self.ground])

    def camera(self, camera: Camera) -> Camera:
        """Copy of a camera in the levelled world: position, rotation and field of view.

        A height of 0 up to rounding becomes exactly 0, which means unknown.
        """
        # A camera of a left-handed world has behind it what it sees: its axes are turned round
        rotation = np.sign(np.linalg.det(self.rotation)) * self.rotation @ camera.rotation
        fov = camera.fov
        if camera.image_size is not None:
            fov = camera_fov(
                camera.image_size,
                camera.focal_px,
                camera.principal_px,
                distortion=camera.distortion,
                model=camera.distortion_model,
                rotation=rotation,
            )
        position = self.positions(camera.position[None])[0]
        if abs(position[2]) <= HEIGHT_SLACK:
            # At the ground but for the rounding of the calibration: its height is unknown
            position[2] = 0.0
        return replace(camera, position=position, rotation=rotation, fov=fov)

    def truth(self, truth: Truth, path: Path) -> Truth:
        """Copy of true positions in the levelled world; unknown heights stay NaN.

        `path` is their file, for the message.

        Raises:
            InputError: heights are missing, and the rotation is not about the vertical alone, so that they are needed.
        """
        unknown = np.isnan(truth.z)
        if unknown.any() and self.rotation[:2, 2].any():
            raise InputError(
                f"{path}: has no heights, without which true positions cannot be rotated so that z is up; add z",
                id="missing-value",
            )
        x, y, z = self.positions(np.column_stack([truth.x, truth.y, np.where(unknown, 0.0, truth.z)])).T
        z = np.where(unknown, np.nan, z)
        columns = {c.name: getattr(truth, c.name) for c in Truth.columns()}
        return Truth(**(columns | {"x": x.copy(), "y": y.copy(), "z": z.copy()}))

    def parameters(self) -> dict[str, object]:
        """Rotation matrix and ground height for the provenance of the recording."""
        return {"turned_by": self.rotation.tolist(), "ground": self.ground}


def find_turn(
    cameras: Sequence[Camera],
    up: str | None,
    ground: float | None,
    note: Callable[[str], None],
    mirror: str | None = None,
) -> Turn | None:
    """Find the rotation, and reflection, that levels the world of calibrated cameras; None: nothing to change.

    Args:
        cameras: as calibrated.
        up: vertical of the calibration's world: `auto` (by the horizons of the cameras), a signed axis, three numbers,
            or None: z.
        ground: height of the ground along `up`, in the calibration's world; None: 0.
        note: called with remarks on the change.
        mirror: axis `x`, `y` or `z` to negate, of a left-handed world; None: right-handed.

    Raises:
        UsageError: `up` is none of these.
    """
    if mirror is not None:
        axes = mirror_matrix(mirror)
        note(f"world mirrored: {mirror} has the other sign, in tracks and true positions, too")
        mirrored = [Turn(axes, 0.0).camera(c) for c in cameras]
        turned = up if up in (None, AUTO) else ",".join(map(repr, (axes @ read_up(str(up))).tolist()))
        after = find_turn(mirrored, turned, ground, note)
        return Turn(axes, 0.0) if after is None else Turn(after.rotation @ axes, after.ground)
    if up is None:
        return None if ground is None else Turn(np.eye(3), ground)
    rotations = np.array([c.rotation for c in cameras]).reshape(-1, 3, 3)
    direction = vertical(rotations).up if up == AUTO else read_up(up)
    turn = Turn(turn_upright(direction), 0.0 if ground is None else ground)
    text = ", ".join(f"{v:.3f}" for v in direction / np.linalg.norm(direction))
    zero = "at the calibration's origin" if ground is None else f"{ground:g} m along it"
    note(f"world turned upright: up was ({text}), the ground is {zero}")
    return turn


def read_up(text: str) -> Floats:
    """Parse the direction `up` into a vector (3,), not normalised: an axis with its sign (`-y`), or X,Y,Z.

    Raises:
        UsageError: the text is neither, or the vector is 0.
    """
    sign, axis = (-1.0, text[1:]) if text.startswith("-") else (1.0, text.removeprefix("+"))
    if axis in ("x", "y", "z"):
        return sign * axis_vector(axis)
    try:
        found = np.array([float(v) for v in text.split(",")])
    except ValueError:
        found = np.zeros(0)
    if found.shape != (3,) or not np.isfinite(found).all() or not found.any():
        raise UsageError(f"{option('up')} {text}: expected auto, an axis with its sign (for example -y), or X,Y,Z")
    return found


CROP_PX = 16
"""Video codecs cut or pad to multiples of 16 px; a difference up to this is not a change of scale."""
SHAPE_SLACK, PIXEL_SLACK = 0.01, 0.03
"""Relative differences of aspect ratios that agree, and where pixels are not square: 704 or 720 columns of PAL and NTSC
are shown as 768 or 640."""
MIN_BAR_PX = 2.0
BAR_SLACK_PX = 1.5

Bars = tuple[int, int, int, int]


class Sized(NamedTuple):
    """Frame size of a camera, and what its files state of the frames.

    Attributes:
        size: width and height [px].
        bars: widths of black bars at left, top, right and bottom [px].
        unturned: command that removes the rotation or mirror that was applied as metadata ask; empty: there is none.
        pixel: width of a pixel relative to its height.
    """

    size: tuple[int, int]
    bars: Bars = (0, 0, 0, 0)
    unturned: str = ""
    pixel: float = 1.0


def sized(source: CameraSource) -> Sized:
    """Frame size of a camera with a video or images, and what these state of the frames."""
    facts = dict(source.decoder.facts)
    across, down = (float(facts.get("pixels-not-square", {}).get(key, 1.0)) for key in ("across", "down"))
    images = f"exiftool -Orientation= {source.path.name}"
    undo = images if source.path.is_dir() else f"ffmpeg -display_rotation 0 -i {source.path.name} -c copy OUT"
    turned = "pictures-turned" in facts
    return Sized(source.decoder.size, source.decoder.bars, undo if turned else "", across / down)


def with_stated_sizes(
    frames: Mapping[str, Sized], survey: BoxSurvey | None, scene: Scene, given: tuple[int, int] | None
) -> dict[str, Sized]:
    """Frame sizes by camera: those of images, else those that box files state, else the size that the user gives.

    Args:
        frames: sizes of images, by camera.
        survey: of the box files; None: there are none.
        scene: has the cameras.
        given: width and height that the user gives [px]; None: not given.

    Raises:
        InputError: boxes are of images of another size than the frames, or the given size is that of neither the frames
            nor the calibration.
    """
    stated = {} if survey is None else survey.sizes
    for name, size in stated.items():
        if name in frames and frames[name].size != size:
            raise InputError(
                f"camera {name}: boxes are of images of {size[0]} x {size[1]} px, but its frames have "
                f"{frames[name].size[0]} x {frames[name].size[1]}; give boxes of these frames",
                id="image-size-mismatch",
            )
    known = {**{name: Sized(size) for name, size in stated.items()}, **frames}
    if given is None:
        return known
    for camera in scene.cameras:
        found = known.setdefault(camera.name, Sized(given))
        # A calibration that states no size is for images of the given one, and scaled to those that there are
        if found.size != given and camera.placed and camera.image_size != given:
            what = "boxes are of images" if camera.name not in frames else "frames"
            raise InputError(
                f"camera {camera.name}: {what} of {found.size[0]} x {found.size[1]} px, but {option('image_size')} is "
                f"{given[0]}x{given[1]}; leave it out",
                id="image-size-mismatch",
            )
    return known


def fit_sizes(scene: Scene, frames: Mapping[str, Sized], note: Callable[[str], None]) -> Scene:
    """Copy of the scene with calibrations adapted to the frame sizes; `frames` has them by camera.

    `note` is called with the assumptions made. InputError if frames have another aspect ratio than the calibration.
    """
    cameras = tuple(fit_size(c, frames[c.name], note) if c.name in frames else c for c in scene.cameras)
    return replace(scene, cameras=cameras)


def fit_size(camera: Camera, frames: Sized, note: Callable[[str], None]) -> Camera:
    """Adapt a camera's intrinsics to frames of another size than that of its calibration, and return the new camera.

    Frames with black bars as wide as a change of scale makes them: scaled and centred. Frames up to 16 px smaller or
    larger: cut or padded at the right and lower edge, so that pixels keep their position. Frames of the same aspect
    ratio: scaled. Frames with pixels that are not square, calibrated as stretched to square ones: scaled in x and y.

    Args:
        camera: as calibrated; one without image size or pose only gets the size.
        frames: size of the frames, and what their file states of them.
        note: called with the assumption made.

    Raises:
        InputError: the frames have another aspect ratio.
    """
    size = frames.size
    if camera.image_size is None or camera.image_size == size or not camera.placed:
        return replace(camera, image_size=size)
    old, new = np.array(camera.image_size, dtype=np.float64), np.array(size, dtype=np.float64)
    change = f"camera {camera.name}: frames of {size[0]} x {size[1]} px, calibrated for {int(old[0])} x {int(old[1])}"
    scale = float((new / old).min())
    margin = (new - old * scale) / 2
    if margin.max() >= MIN_BAR_PX and _has_bars(frames.bars, margin):
        note(f"{change}: assumed to be scaled by {scale:.4g}, between black bars")
        return _scaled(camera, size, np.array([scale, scale]), margin)
    if np.abs(new - old).max() <= CROP_PX:
        note(f"{change}: assumed to be cropped or padded at the right and lower edge")
        return _scaled(camera, size, np.ones(2), np.zeros(2))
    across, down = (new / old).tolist()
    if abs(across / down - 1) > SHAPE_SLACK:
        if frames.pixel != 1.0 and abs(across / down * frames.pixel - 1) < PIXEL_SLACK:
            note(f"{change}: assumed to be stretched to square pixels")
            return _scaled(camera, size, new / old, np.zeros(2))
        raise InputError(f"camera {camera.name}: {_misfit(camera, frames)}", id="image-size-mismatch")
    note(f"{change}: assumed to be scaled by {scale:.4g}")
    return _scaled(camera, size, new / old, np.zeros(2))


def _misfit(camera: Camera, frames: Sized) -> str:
    """Cause and remedy, for an error, of frames of another aspect ratio than the calibration of the camera."""
    given, stated = (f"{width} x {height}" for width, height in (frames.size, camera.image_size or (0, 0)))
    if camera.image_size is None or not _exchanged(frames.size, camera.image_size):
        return (
            f"frames of {given} px differ in aspect ratio from the calibration ({stated}); give the calibration of "
            "these frames, or frames of its size"
        )
    if frames.unturned:
        return f"metadata rotate its frames to {given} px, and the calibration is for {stated}; undo: {frames.unturned}"
    return (
        f"frames of {given} px, calibration for {stated}: one is of images rotated by 90 degrees; give the calibration "
        "of these frames, or rotate them"
    )


def _exchanged(one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether two sizes (width, height) have one aspect ratio if width and height of one are exchanged."""
    return abs(one[0] * other[0] / (one[1] * other[1]) - 1) < SHAPE_SLACK


def _has_bars(bars: Bars, margin: np.ndarray) -> bool:
    """Whether black bars (left, top, right, bottom) [px] are about as wide as the margins (x, y) [px] on both sides.

    Margins below `MIN_BAR_PX` are not compared.
    """
    wanted = np.array([margin[0], margin[1], margin[0], margin[1]])
    there = wanted >= MIN_BAR_PX
    return bool((np.abs(np.array(bars) - wanted)[there] <= BAR_SLACK_PX).all())


def _scaled(camera: Camera, size: tuple[int, int], scale: np.ndarray, margin: np.ndarray) -> Camera:
    focal = camera.focal_px * scale
    # The centre of the first pixel is (0, 0), so the image's corner is at -0.5.
    principal = (camera.principal_px + 0.5) * scale - 0.5 + margin
    fov = camera_fov(
        size, focal, principal, distortion=camera.distortion, model=camera.distortion_model, rotation=camera.rotation
    )
    return replace(camera, focal_px=focal, principal_px=principal, image_size=size, fov=fov)


Note = Callable[[str], None]


class IngestScene(NamedTuple):
    """A scene, the transform that levelled its calibration's world (None: unchanged), and checks of the calibration."""

    scene: Scene
    turn: Turn | None
    checks: tuple[Check, ...]


def add_bag_cameras(
    scene: Scene, cameras: tuple[Camera, ...], world: str | None, found: Sequence[Check], plan: IngestPlan, note: Note
) -> IngestScene:
    """Add the cameras of a bag to the scene, after the world is levelled; also return that transform, and checks.

    Args:
        scene: without them.
        cameras: of the bag; empty: the scene is unchanged.
        world: name of their world frame.
        found: findings of their calibration.
        plan: options of the user.
        note: called with remarks for the user.

    Raises:
        InputError: lengths of the scene are not in metres.
    """
    if not cameras:
        return IngestScene(scene, None, world_checks((), None, ground_stated=False))
    if scene.length_unit != "m":
        raise InputError(
            f"{plan.scene}: lengths are in {scene.length_unit}, but those of the bag in m; convert the scene to m",
            id="unit-mismatch",
        )
    note(describe(CalibrationFile(cameras, f"camera_info and transforms of the bag, world {world!r}", "m")))
    turn = find_turn(cameras, plan.up, plan.ground_height, note, plan.mirror)
    placed = cameras if turn is None else tuple(turn.camera(c) for c in cameras)
    checks = (
        *outcome(CALIBRATION, found),
        *_world_checks(placed, plan, turn),
    )
    return IngestScene(replace(scene, cameras=(*scene.cameras, *placed)), turn, checks)


def base_scene(plan: IngestPlan, note: Note) -> IngestScene:
    """Scene from the scene file, the calibration and the tables of arrays and readers, with the calibration levelled.

    Scene file and tables are in the levelled world already. Also returned are the transform of the calibration's world,
    and checks of it. `note` is called with remarks for the user.

    Raises:
        InputError: inputs are in different length units.
        UsageError: a sensor is in two of the inputs.
    """
    turn: Turn | None = None
    checks = world_checks((), None, ground_stated=False)
    scene = load_scene(plan.scene, None, plan.output) if plan.scene is not None else Scene()
    of_scene = scene_checks(scene.cameras)
    cameras = list(scene.cameras)
    if plan.calibration:
        options = plan.calibration_options()
        calibration = read_calibration(plan.calibration, plan.calibration_format, options)
        note(describe(calibration))
        for reported in calibration.notes:
            note(f"calibration: {reported}")
        if scene.length_unit != "m":
            raise InputError(
                f"{plan.scene}: lengths are in {scene.length_unit}, but those of the calibration in m; convert "
                "one of them",
                id="unit-mismatch",
            )
        double = next((c.name for c in calibration.cameras if c.name in {k.name for k in cameras}), None)
        if double is not None:
            raise UsageError(
                f"camera {double}: is both in {plan.scene} and in the calibration; keep one", id="duplicate-name"
            )
        turn = find_turn(calibration.cameras, plan.up, plan.ground_height, note, plan.mirror)
        placed = calibration.cameras if turn is None else tuple(turn.camera(c) for c in calibration.cameras)
        checks = (*calibration.checks, *_world_checks(placed, plan, turn))
        cameras += placed
    check_metres(plan, scene.length_unit)
    arrays = [*scene.arrays, *(a for name, path in plan.arrays for a in _arrays(path, name, note))]
    readers = scene.readers if plan.readers is None else (*scene.readers, *read_readers(plan.readers))
    found = replace(scene, cameras=tuple(cameras), arrays=tuple(arrays), readers=readers)
    _check_names(plan, [s.name for s in found.sensors])
    return IngestScene(found, turn, (*of_scene, *checks, *pose_checks(cameras)))


def _world_checks(placed: Sequence[Camera], plan: IngestPlan, turn: Turn | None) -> tuple[Check, ...]:
    """Outcomes of the checks of the world of cameras that `turn` mirrored and turned."""
    return world_checks(
        placed,
        plan.up,
        ground_stated=plan.ground_height is not None,
        mirror=plan.mirror,
        turned_by=None if turn is None else turn.rotation,
    )


def check_metres(plan: IngestPlan, unit: str) -> None:
    """InputError if a table of the plan is in metres, and the scene's `unit` of length is another.

    Tables of arrays are always in metres, those of truth and readers if their column names end in `_m`.
    """
    if unit == "m":
        return
    named = [path for _, path in plan.truth] + ([] if plan.readers is None else [plan.readers])
    reported = [path for path in named if path.is_file() and _says_metres(path)]
    in_metres = next(iter((*(path for _, path in plan.arrays), *reported)), None)
    if in_metres is not None:
        raise InputError(
            f"{in_metres}: lengths are in m, but those of {plan.scene} in {unit}; convert one of them",
            id="unit-mismatch",
        )


def _says_metres(path: Path) -> bool:
    """Whether the first line of a table has a column `x_m`, `y_m`, `z_m` or `range_m`; False if it cannot be read."""
    try:
        names = {cell.lower() for cell in first_line(path, "a table")}
    except InputError:  # whoever reads it states it
        return False
    return bool(names & {"x_m", "y_m", "z_m", "range_m"})


def _check_names(plan: IngestPlan, names: Sequence[str]) -> None:
    """UsageError if a reader of the table has the name of another sensor; `names` are those of all sensors."""
    if plan.readers is not None and (double := first_double(names)) is not None:
        raise UsageError(
            f"{plan.readers}: reader {double} has the name of another sensor; rename one of them", id="duplicate-name"
        )


def _arrays(path: Path, name: str | None, note: Note) -> tuple[MicrophoneArray, ...]:
    arrays = read_arrays(path, name)
    first = arrays[0]
    what = f"{len(first.microphones)} microphones" if len(first.microphones) else "no microphones"
    location = ", ".join(f"{v:.2f}" for v in first.position)
    note(f"arrays: {len(arrays)} from {path.name}, m; first: {first.name} at ({location}), {what}")
    return arrays


def match_cameras(
    scene: Scene, wanted: Sequence[str], plan: IngestPlan, reasons: Mapping[str, str], note: Note
) -> Scene:
    """Copy of the scene with the cameras that have data, named as the user names them.

    Calibrations are matched by similar names. Calibrated cameras without data are removed and noted, except those of a
    scene file.

    Args:
        scene: with the calibrated cameras.
        wanted: names of cameras with data.
        plan: options of the user.
        reasons: why cameras of a bag have no pose, by name.
        note: called with a line of text.

    Raises:
        InputError: a camera has no calibration, and the plan does not allow it.
    """
    kept = {c.name: c for c in scene.cameras}
    # An entry with the exact name of another camera is of that one
    free = [name for name in kept if name not in wanted]
    meant: dict[str, str] = {}
    out: list[Camera] = []
    for name in wanted:
        # A camera of a bag is called as its topic, which may end in a number that means another camera.
        found = name if name in kept else None if name in reasons else _find(name, free)
        if found is not None:
            check_meaning(meant, name, found, "calibration")
        if found is None and not plan.allow_uncalibrated:
            known = ", ".join(c.name for c in scene.cameras) or "none"
            others = [each for each in kept if each not in wanted] if name not in reasons else []
            renamed = f"name its files as there ({others[0]}=FILE), " if others else ""
            file = next(iter(plan.bags if name in reasons else plan.calibration), plan.scene)
            raise InputError(
                f"{f'{file}: ' if file else ''}"
                f"camera {name}: has no calibration ({reasons.get(name, f'calibrated: {known}')}); {renamed}add it to "
                f"the calibration or the scene, or give {option('allow_uncalibrated')} (tracked in its images only)",
                id="missing-pose",
            )
        out.append(replace(kept.pop(found), name=name) if found is not None else _unplaced(name, plan))
    named = set() if plan.scene is None else {c.name for c in load_scene(plan.scene, None, plan.output).cameras}
    out += [c for c in kept.values() if c.name in named]
    unused = [c.name for c in kept.values() if c.name not in named]
    if unused and wanted:
        note(f"calibration: no boxes or images of {listed(unused)}, which the recording does not contain")
    return replace(scene, cameras=tuple(out))


def _find(name: str, names: Sequence[str]) -> str | None:
    try:
        return match_sensor(name, names, "calibration")
    except InputError:
        return None


def _unplaced(name: str, plan: IngestPlan) -> Camera:
    """A camera without calibration (`placed` False); position, rotation and focal length are placeholders."""
    width = float(plan.image_size[0]) if plan.image_size else 1000.0
    return Camera(
        name=safe_name(name),
        position=np.zeros(3),
        rotation=camera_rotation(0.0, 0.0, 0.0),
        focal_px=np.array([width, width]),
        principal_px=np.zeros(2),
        image_size=plan.image_size,
        placed=False,
    )
