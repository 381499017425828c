"""Calibrations of messages (`sensor_msgs/CameraInfo`) to intrinsic parameters that occlog's cameras have.

Raw images have the matrix K and the distortion D; rectified ones the matrix P, no distortion, and are turned by R.
`binning` and `roi` scale and shift them (REP 104).

Images of messages: compressed ones unchanged, raw pixels of any common encoding as grey or BGR. Table rows from
messages: true positions, boxes, directions of arrival. The transform tree of a bag, and poses of static frames: of each
pair of frames the first pose is kept, and the largest deviation of later ones.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError, abridged, option
from occlog.io.files.geodetic import has_heights, note_unused_heights, positions_on_earth
from occlog.io.formats.calibration.lenses import Lens
from occlog.io.formats.calibration.readers.ros import STILL_M, STILL_RAD, apart, lens_of, region_of, two_poses
from occlog.io.frames.codec import encode_image, image_damage, image_kind, shown_size
from occlog.io.frames.decoders.subprocess_video import decode_apart
from occlog.io.frames.limits import MAX_PIXELS
from occlog.records.frames import Image
from occlog.records.scene import MicrophoneArray
from occlog.records.tables import Boxes, Doa, Truth

from .kinds import BoxMessage, DirectionMessage, ImageMessage, InfoMessage, PoseMessage, TransformMessage
from .video_stream import OTHER_CODECS, is_video


class Intrinsics(NamedTuple):
    """Intrinsics of a camera's images by its calibration message, without a pose.

    Attributes:
        focal_px: (2,) focal lengths.
        principal_px: (2,) principal point.
        size: width and height of the images [px].
        lens: distortion as stated; none for rectified images.
        turn: (3, 3) rotation from the camera's frame to that of the (rectified) images.
        shift: offset [m] of the camera to the right of the frame that a stereo pair shares, by its matrix P.
        binned_aspect: ratio of the focal lengths y and x that binning makes of equal ones.
    """

    focal_px: Floats
    principal_px: Floats
    size: tuple[int, int]
    lens: Lens
    turn: Floats
    shift: float
    binned_aspect: float = 1.0


def intrinsics(info: InfoMessage, *, rectified: bool, where: str) -> Intrinsics | None:
    """Intrinsics from a calibration message; None if it states that the camera is not calibrated (fx 0).

    Args:
        info: calibration message.
        rectified: images are rectified: the projection matrix P applies, and no distortion; else K and the distortion.
        where: topic, for messages.

    Raises:
        InputError: a matrix, the lens model or the region of the sensor cannot be used.
    """
    matrix = info.p[:, :3] if rectified else info.k
    if not matrix[0, 0]:
        return None
    if (
        not np.isfinite(matrix).all()
        or matrix[0, 1]
        or matrix[1, 0]
        or matrix[2].tolist() != [0, 0, 1]
        or not (matrix[0, 0] > 0 < matrix[1, 1])
    ):
        raise InputError(
            f"{where}: its matrix {matrix.tolist()} is not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]; give a calibration "
            "file or a scene",
            id="invalid-calibration",
        )
    region = region_of(info.size, info.binning, info.roi, where)
    focal, principal = region.intrinsics(np.array([matrix[0, 0], matrix[1, 1]]), matrix[:2, 2])
    binned = float(region.scale[1] / region.scale[0])
    if rectified:
        turn = info.r if info.r.any() else np.eye(3)
        with np.errstate(over="ignore", invalid="ignore"):
            rotates = np.isfinite(turn).all() and np.abs(turn @ turn.T - np.eye(3)).max() <= 1e-3
        if not rotates or np.linalg.det(turn) < 0:
            raise InputError(
                f"{where}: its matrix R is not a rotation; give a calibration file or a scene", id="invalid-calibration"
            )
        shift = -float(info.p[0, 3]) / float(matrix[0, 0])
        return Intrinsics(focal, principal, region.size, Lens(), turn, shift, binned)
    if not np.isfinite(info.distortion).all():
        raise InputError(
            f"{where}: its distortion {info.distortion.tolist()} is not finite; give a calibration file or a scene",
            id="invalid-calibration",
        )
    lens = lens_of(info.model, info.distortion, where)
    return Intrinsics(focal, principal, region.size, lens, np.eye(3), 0.0, binned)


_GREY = ("mono8", "8UC1")
_COLOURS: dict[str, tuple[int, int | None]] = {
    "bgr8": (3, None),
    "8UC3": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "8UC4": (4, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    # ROS names a pattern by its first row from the left, OpenCV by the second row from the second pixel on.
    "bayer_rggb8": (1, cv2.COLOR_BayerBG2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerRG2BGR),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGR2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGB2BGR),
    "yuv422": (2, cv2.COLOR_YUV2BGR_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2BGR_YUY2),
    "yuyv": (2, cv2.COLOR_YUV2BGR_YUY2),
}
"""Encodings of 8 bits: bytes a pixel, and how OpenCV makes BGR of them."""
ENCODINGS = (*_GREY, *_COLOURS)


class Stored(NamedTuple):
    """An image as stored in a recording: compressed bytes, their kind (`png` or `jpeg`), width and height [px]."""

    data: bytes
    kind: str
    size: tuple[int, int]


def is_picture(message: ImageMessage) -> bool:
    """Whether a message holds visible light (a camera image or video), not depth and the like."""
    if message.size is not None:
        return message.encoding in ENCODINGS
    if is_video(message.encoding):
        return True
    words = message.encoding.lower()
    return not any(word in words for word in ("compresseddepth", "16uc1", "32fc1", "mono16"))


def stored(message: ImageMessage, where: str, store: str | None, quality: int) -> Stored:
    """Compressed form of a message's image for the recording.

    Args:
        message: the image.
        where: name of the image in messages.
        store: `png` or `jpeg`; None: compressed images of these kinds as they are, all else as JPEG.
        quality: of JPEG.

    Raises:
        InputError: the image is damaged or of an encoding that cannot be read.
    """
    kind = None if message.size is not None else image_kind(message.data)
    size = shown_size(message.data) if kind is not None else None
    if kind is not None and size is not None and store in (None, kind):
        damage = image_damage(message.data)
        if damage is None and size[0] * size[1] > MAX_PIXELS:
            damage = f"{size[0]} x {size[1]} px; the limit is {MAX_PIXELS} pixels"
        if damage is not None:
            raise InputError(f"{where}: {damage}")
        return Stored(message.data, kind, size)
    image = pixels(message, where)
    kind = store or "jpeg"
    return Stored(encode_image(image, kind, quality), kind, (image.shape[1], image.shape[0]))


def pixels(message: ImageMessage, where: str) -> Image:
    """Decode the image of a message: (h, w, 3) BGR or (h, w) grey; `where` is its name in messages.

    Raises:
        InputError: it is damaged, of an unknown encoding, or a picture of a video stream.
    """
    if message.size is None and is_video(message.encoding):
        raise InputError(
            f"{where}: a picture of a video stream, which cannot be decoded without the pictures before it",
            id="unsupported-format",
        )
    if message.size is None and message.encoding.lower() in OTHER_CODECS:
        raise InputError(
            f"{where}: video as {message.encoding} is not read (h264 and h265 are); write it to a file, its times to "
            f"another, and give {option('video')} and {option('timestamps')}",
            id="unsupported-format",
        )
    if message.size is None:
        return decode_apart(message.data, f"{where} ({message.encoding})")
    (width, height), encoding = message.size, message.encoding
    if not is_picture(message):
        raise InputError(
            f"{where}: pixels of encoding {encoding!r} cannot be read; known: {', '.join(ENCODINGS)}",
            id="unsupported-format",
        )
    each, code = (1, None) if encoding in _GREY else _COLOURS[encoding]
    step = message.step or width * each
    if not (0 < width * height <= MAX_PIXELS and step >= width * each and len(message.data) >= step * height):
        raise InputError(
            f"{where}: {len(message.data)} bytes are not {width} x {height} pixels of {encoding} with {step} bytes a "
            "row; it is damaged",
            id="damaged-file",
        )
    rows = np.frombuffer(message.data, np.uint8, count=step * height).reshape(height, step)[:, : width * each]
    image = np.ascontiguousarray(rows if each == 1 else rows.reshape(height, width, each))
    try:
        return image if code is None else cv2.cvtColor(image, code)
    except cv2.error as error:
        reason = " ".join(str(error.err).split())[:100]
        raise InputError(
            f"{where}: pixels of {encoding} cannot be converted ({reason}); record them as bgr8 or mono8",
            id="unsupported-format",
        ) from None


UNIT_SLACK = 0.01
MAX_DEPTH = 200


@dataclass
class Edge:
    """Pose of a frame in its parent, by the first transform, and the largest change since.

    Attributes:
        parent: name of the parent frame.
        rotation: (3, 3) parent-from-child.
        translation: (3,) [m].
        messages: number of transforms.
        moved: largest difference of the position [m].
        turned: largest difference of the orientation [rad].
        conflict: text on two static transforms that differ; empty: there are none.
    """

    parent: str
    rotation: Floats  # (3, 3) parent-from-child
    translation: Floats
    messages: int = 1
    moved: float = 0.0
    turned: float = 0.0
    conflict: str = ""

    @property
    def still(self) -> bool:
        """Whether the frame never moved in its parent by more than `STILL_M` and `STILL_RAD` (taken for noise)."""
        return self.moved <= STILL_M and self.turned <= STILL_RAD


class FramePose(NamedTuple):
    """Pose of a frame in another one: x_other = rotation (3, 3) x + translation (3,) [m]."""

    rotation: Floats
    translation: Floats


class Transforms:
    """Tree of the transforms between the coordinate frames of a bag.

    Attributes:
        edges: pose of each frame in its parent.
        faults: by frame, why its pose cannot be used.
        exchanged: by frame that was a second parent, the name of its child.
    """

    def __init__(self) -> None:
        """Start without transforms."""
        self.edges: dict[str, Edge] = {}
        self.faults: dict[str, str] = {}
        self.exchanged: dict[str, str] = {}

    def add(self, message: TransformMessage, *, static: bool = False) -> None:
        """Add a transform: the first one of a frame is kept, later ones only extend its largest change.

        An invalid one, or another parent, is a fault, which is raised when the frame is needed. `static`: it holds for
        all times, so that another one contradicts it.
        """
        try:
            rotation = rotation_of(message)
        except InputError as error:
            self.faults.setdefault(message.child, str(error))
            return
        old = self.edges.get(message.child)
        if old is None:
            self.edges[message.child] = Edge(message.parent, rotation, message.translation)
            return
        if old.parent != message.parent:
            text = f"frame {message.child!r} has two parents, {old.parent!r} and {message.parent!r}"
            self.faults.setdefault(message.child, text)
            self.exchanged.setdefault(message.parent, message.child)
            return
        old.messages += 1
        first, new = (old.rotation, old.translation), (rotation, message.translation)
        moved, turned = apart(first, new)
        old.moved, old.turned = max(old.moved, moved), max(old.turned, turned)
        if static and not old.still and not old.conflict:
            old.conflict = two_poses(message.child, message.parent, first, new)

    @property
    def frames(self) -> list[str]:
        """Names of all coordinate frames, sorted."""
        return sorted({*self.edges, *(edge.parent for edge in self.edges.values())})

    def knows(self, frame: str) -> bool:
        """Whether a coordinate frame is in the tree, as child or parent."""
        return frame in self.edges or any(edge.parent == frame for edge in self.edges.values())

    def chain(self, frame: str) -> list[str]:
        """The frame, its parent, and so on up to the root; InputError for a cycle."""
        out = [frame]
        while out[-1] in self.edges:
            parent = self.edges[out[-1]].parent
            if parent in out or len(out) > MAX_DEPTH:
                raise InputError(
                    f"transforms: frame {parent!r} is its own parent; the tree has no root", id="invalid-calibration"
                )
            out.append(parent)
        return out

    def still_root(self, frame: str) -> str:
        """Farthest ancestor of a coordinate frame in which it does not move.

        If it moves in its parent, the frame itself.
        """
        for above in self.chain(frame):
            if above not in self.edges or not self.edges[above].still:
                return above
        raise AssertionError(f"transforms: no frame above {frame!r} is without a parent; please report this")

    def placed(self, frame: str, world: str) -> FramePose:
        """Pose of a frame in the frame `world`.

        Raises:
            InputError: the frames are not connected, or a frame between them moves, has two parents, or an invalid
                pose.
        """
        up, down = self.chain(frame), self.chain(world)
        common = next((name for name in up if name in down), None)
        if common is None:
            raise InputError(f"no transforms lead from frame {world!r} to {frame!r}", id="missing-pose")
        path = [*up[: up.index(common)], *down[: down.index(common)]]
        for name in path:
            edge = self.edges[name]
            if name in self.faults:
                raise InputError(self.faults[name])
            if edge.conflict:
                raise InputError(edge.conflict, id="invalid-calibration")
            if not edge.still:
                raise InputError(
                    f"frame {frame!r} moves in {world!r}: {name!r} in {edge.parent!r} by {edge.moved:.3g} m and "
                    f"{math.degrees(edge.turned):.3g} degrees; a static frame was expected",
                    id="invalid-calibration",
                )
        a, b = self._to(frame, common), self._to(world, common)
        return FramePose(b.rotation.T @ a.rotation, b.rotation.T @ (a.translation - b.translation))

    def _to(self, frame: str, above: str) -> FramePose:
        """Pose of a coordinate frame in its ancestor `above`."""
        rotation, translation = np.eye(3), np.zeros(3)
        while frame != above:
            edge = self.edges[frame]
            rotation, translation = edge.rotation @ rotation, edge.rotation @ translation + edge.translation
            frame = edge.parent
        return FramePose(rotation, translation)


def rotation_of(message: TransformMessage) -> Floats:
    """(3, 3) rotation matrix of a transform's quaternion (x, y, z, w).

    InputError if that is not of unit length to 0.01, or if the translation is not finite.
    """
    if not np.isfinite(message.translation).all():
        raise InputError(
            f"transform of frame {message.child!r}: its translation has values that are not finite",
            id="invalid-calibration",
        )
    with np.errstate(over="ignore", invalid="ignore"):  # infinite values and NaN are refused
        length = float(np.linalg.norm(message.quaternion))
    if not abs(length - 1) <= UNIT_SLACK:
        raise InputError(
            f"transform of frame {message.child!r}: a quaternion of length {length:.4g}; it must be 1 to within "
            f"{UNIT_SLACK}",
            id="invalid-calibration",
        )
    x, y, z, w = message.quaternion / length
    # fmt: off
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])
    # fmt: on


LENGTHS = (0.9, 1.1)
"""Limits of the length of a direction vector."""


def truth_rows(message: PoseMessage, t_ns: int, first: int, placed: FramePose) -> Truth:
    """True positions of one message in the world, as rows of `Truth`.

    Geodetic positions are converted to the scene by the origin that the user states.

    Args:
        message: positions at one time.
        t_ns: the time [ns].
        first: number of the first target; the others follow.
        placed: world-from-frame pose of the frame of the message.

    Raises:
        InputError: a position is not finite.
    """
    if message.on_earth:
        return _truth_on_earth(message, t_ns, first)
    if not np.isfinite(message.positions).all():
        raise InputError("a true position is not finite")
    positions = message.positions @ placed.rotation.T + placed.translation
    n = len(positions)
    x, y, z = positions.T
    return Truth.of(
        t_ns=np.full(n, t_ns), target_id=first + np.arange(n), role=np.full(n, "target"), x=x, y=y, z=z.copy()
    )


def _truth_on_earth(message: PoseMessage, t_ns: int, first: int) -> Truth:
    """Geodetic true positions of one message, converted to the scene, as rows of `Truth`.

    Heights are used if the user's origin has a height; InputError if they are missing then. Without, z is NaN.

    Args:
        message: longitudes, latitudes [deg] and heights [m] at one time.
        t_ns: the time [ns].
        first: number of the first target; the others follow.
    """
    degrees, heights = message.positions[:, :2], message.positions[:, 2]
    known = has_heights()
    if known and not np.isfinite(heights).all():
        raise InputError(
            f"a position without a height, but the origin has one; leave the height out of {option('origin')}",
            id="missing-value",
        )
    x, y, z = positions_on_earth(degrees, heights if known else None, "a position on the earth").T
    if np.isfinite(heights).all():
        note_unused_heights("positions on the earth")
    n = len(degrees)
    return Truth.of(
        t_ns=np.full(n, t_ns), target_id=first + np.arange(n), role=np.full(n, "target"), x=x, y=y,
        z=z.copy() if known else np.full(n, np.nan),
    )  # fmt: skip


class MessageBoxRows:
    """Converts box messages of one camera to rows of `Boxes`, and counts its frames and class labels."""

    def __init__(self, camera: str, classes: Collection[str], scale: float) -> None:
        """Start at frame 0.

        Args:
            camera: its name.
            classes: labels of the boxes that are kept; empty: all, which must have one label.
            scale: by which scores are divided.
        """
        self.camera, self.classes, self.scale = camera, classes, scale
        self.frames = 0
        self.labels: Counter[str] = Counter()
        self._numbers: dict[str, int] = {}
        self._owners: dict[int, str] = {}

    def rows(self, message: BoxMessage, t_ns: int) -> Boxes:
        """Rows of one message, the next frame, at `t_ns` [ns]; a frame without boxes is one row with `box` -1.

        Raises:
            InputError: boxes have several labels and none is selected, or a box or score is impossible.
        """
        kept = [b for b in message.boxes if not self.classes or b.label in self.classes]
        self.labels.update(b.label for b in message.boxes)
        if not self.classes and len(self.labels) > 1:
            raise InputError(
                f"boxes of classes {abridged(map(repr, self.labels))}; choose one ({option('class')} NAME)",
                id="ambiguous-input",
            )
        frame, self.frames = self.frames, self.frames + 1
        edges = np.array([b[:4] for b in kept], dtype=np.float64).reshape(-1, 4)
        score = np.array([b.score for b in kept], dtype=np.float64) / self.scale
        if not (np.isfinite(edges).all() and (edges[:, 2:] > 0).all()):
            raise InputError(f"frame {frame}: width and height of a box must be above 0, and its edges finite")
        if ((score < 0) | (score > 1)).any():
            raise InputError(f"frame {frame}: a confidence of {score[(score < 0) | (score > 1)][0]:g}; expected 0 to 1")
        n = max(len(kept), 1)
        blank = np.full((1, 4), np.nan)
        left, top, width, height = (edges if len(kept) else blank).T.copy()
        return Boxes.of(
            t_ns=np.full(n, t_ns),
            sensor=np.full(n, self.camera),
            frame=np.full(n, frame),
            box=np.arange(n) if kept else np.array([-1]),
            target_id=np.array([self._identity(b.id) for b in kept] or [-1]),
            left_px=left,
            top_px=top,
            width_px=width,
            height_px=height,
            confidence=score if kept else np.array([np.nan]),
        )

    def _identity(self, text: str) -> int:
        """Identity for the track name of a detector: the number itself if it is one, else the next free number.

        -1 for an empty text. InputError if two names get one number.
        """
        if not text:
            return -1
        known = self._numbers.get(text)
        if known is not None:
            return known
        own = text.isascii() and text.isdigit() and len(text) <= 10 and int(text) < 2**31
        number = int(text) if own else len(self._numbers)
        if number in self._owners:
            raise InputError(
                f"tracks {self._owners[number]!r} and {text!r} would both be number {number}: some are named by "
                "numbers, some otherwise; name all in one way"
            )
        self._numbers[text], self._owners[number] = number, text
        return number


def direction_rows(message: DirectionMessage, t_ns: int, array: MicrophoneArray) -> Doa:
    """Directions of arrival of one message, at `t_ns` [ns], in the world, as rows of `Doa`.

    Empty slots (id 0, or no direction) are skipped. `array` has the pose. InputError for a vector that is not of unit
    length.
    """
    heard = [s for s in message.sources if s.id != 0 and any(s.vector)]
    vectors: Floats = np.array([s.vector for s in heard], dtype=np.float64).reshape(-1, 3)
    with np.errstate(over="ignore"):  # infinite values are refused
        length = np.linalg.norm(vectors, axis=1)
    bad = ~((length >= LENGTHS[0]) & (length <= LENGTHS[1]))
    if bad.any():
        raise InputError(
            f"a direction {vectors[bad][0].tolist()} of length {length[bad][0]:.3g}; expected a unit vector"
        )
    rays = vectors @ array.rotation.T
    n = len(heard)
    azimuth = np.arctan2(rays[:, 1], rays[:, 0])
    rows = Doa.of(
        t_ns=np.full(n, t_ns),
        sensor=np.full(n, array.name),
        source_id=np.array([s.id for s in heard]),
        azimuth=np.where(azimuth >= np.pi, -np.pi, azimuth),
        elevation=np.arctan2(rays[:, 2], np.hypot(rays[:, 0], rays[:, 1])),
        sigma_azimuth=np.full(n, np.nan),
        sigma_elevation=np.full(n, np.nan),
        confidence=np.clip(np.array([s.strength for s in heard], dtype=np.float64), 0.0, 1.0),
    )
    return rows.sorted()
