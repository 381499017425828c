"""Small images of the cameras next to the plan, with tracks drawn over them.

Time steps are evenly spaced; their number is limited by `MAX_TIME_STEPS`, and by the user's limit of total size,
estimated from the first time step.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import NS, Ints
from occlog.errors import InputError, option
from occlog.io.frames.codec import encode_image
from occlog.io.recording.reader import McapRecording, open_recording
from occlog.records.losses import Loss
from occlog.report.overlay.draw import FrameDrawing, LineDrawing, draw_shot
from occlog.report.overlay.pictures import NO_IMAGE, FrameOverlay, LostFrames
from occlog.report.overlay.plan import GroundTrackPositions, OverlayTables
from occlog.settings import METRES

from .steps import packed

WIDTH, WIDTH_ALONE = 240, 480
"""Width of a thumbnail next to a plan, and of one without a plan [px]."""
QUALITY = 70
MAX_TIME_STEPS = 2000
MARGIN = 0.85
"""Share of the limit that images of the size of the first ones may fill: later ones may be larger."""
BASE64 = 4 / 3
TRAIL_S = 2.0
"""Length of the trail behind each target."""


class ImageTables(NamedTuple):
    """Files with tables in images that are drawn over them: tracks, and true boxes (None: missing)."""

    tracks: Path
    truth: Path | None = None


@dataclass
class Thumbnails:
    """Small images of the cameras for the page.

    Attributes:
        cameras: time [ns] and JPEG of each image, by name of the camera.
        n_steps: number of time steps chosen for images.
        of: number of time steps in the recording.
        losses: chosen frames that cannot be decoded.
    """

    cameras: dict[str, list[tuple[int, bytes]]] = field(default_factory=dict)
    n_steps: int = 0
    of: int = 0
    losses: tuple[Loss, ...] = ()

    @property
    def words(self) -> str:
        """Sentence that states how many of the time steps have images; empty if all have."""
        return f"Images: {self.n_steps:,} of {self.of:,} time steps." if self.of > self.n_steps else ""

    @property
    def times(self) -> Ints:
        """Distinct times (N,) of all images [ns]."""
        return np.unique(np.array([t for images in self.cameras.values() for t, _ in images], dtype=np.int64))

    def packed(self, start_ns: int) -> list[dict[str, Any]]:
        """Return the images and their times [s] after `start_ns`, encoded for the page's script."""
        return [
            {
                "index": index,
                "name": name,
                "times": packed("f8", (np.array([t for t, _ in images], dtype=np.int64) - start_ns) / NS),
                "data": [base64.b64encode(data).decode("ascii") for _, data in images],
            }
            for index, (name, images) in enumerate(self.cameras.items())
        ]


def thumbnails(
    recording: Path, sources: OverlayTables | ImageTables | None, targets: Sequence[int], limit: int
) -> Thumbnails:
    """Return small images of a recording, with tracks drawn over them, at evenly spaced times.

    Tracks on the ground are drawn into the images of cameras with poses.

    Args:
        recording: with images or videos.
        sources: files of the tracks, in any unit of lengths; None: nothing is drawn.
        targets: identities, in the order of their colours.
        limit: bytes that all images together may take in the page.

    Raises:
        InputError: there are no images, or an occlog table has another unit of lengths than the recording's scene.
    """
    opened = open_recording(recording)
    if isinstance(sources, OverlayTables) and opened.scene is not None:
        sources = sources._replace(unit=opened.scene.length_unit)
    known: dict[str, list[int]] = {}
    for frame in opened.frames():
        known.setdefault(frame.sensor, []).append(frame.t_ns)
    if not known:
        raise InputError(f"{recording}: holds no images; omit {option('images')}", id="wrong-content")
    times = np.unique(np.concatenate(list(known.values())))
    size = _size(opened, known, sources, targets) * BASE64
    if not size:
        raise InputError(f"{recording}: no image of it can be decoded; omit {option('images')}", id="damaged-file")
    count = max(min(int(MARGIN * limit // size), MAX_TIME_STEPS, len(times)), 1)
    chosen_ns = times[np.unique(np.linspace(0, len(times) - 1, count).round().astype(np.int64))]
    chosen = {name: _before(np.array(own, dtype=np.int64), chosen_ns) for name, own in known.items()}
    out = Thumbnails({name: [] for name in sorted(known)}, len(chosen_ns), len(times))
    lost = LostFrames()
    for name, t_ns, data in _drawn(opened, chosen, sources, targets, lost):
        out.cameras[name].append((t_ns, data))
    out.losses = lost.losses
    return out


def _size(
    opened: McapRecording,
    known: Mapping[str, Sequence[int]],
    sources: OverlayTables | ImageTables | None,
    targets: Sequence[int],
) -> int:
    """Return the total size [bytes] of the first decodable image of each camera, as JPEG with its drawings.

    Args:
        opened: the recording.
        known: times of the frames by camera [ns].
        sources: tables that are drawn; None: none.
        targets: identities, in the order of their colours.
    """
    wanted = {name: set(own) for name, own in known.items()}
    size = 0
    for name, _, data in _drawn(opened, wanted, sources, targets, LostFrames()):
        size += len(data)
        wanted[name] = set()
        if not any(wanted.values()):
            break
    return size


def _before(times: Ints, chosen_ns: Ints) -> set[int]:
    """Return those of the sorted `times` (n,) that are the latest at or before one of `chosen_ns` (k,) [ns]."""
    at = np.searchsorted(times, chosen_ns, side="right") - 1
    return set(times[at[at >= 0]].tolist())


def _drawn(
    opened: McapRecording,
    chosen: Mapping[str, set[int]],
    sources: OverlayTables | ImageTables | None,
    targets: Sequence[int],
    lost: LostFrames,
) -> Iterator[tuple[str, int, bytes]]:
    """Generate camera, time [ns] and JPEG of each chosen frame, with its drawings.

    A frame that cannot be decoded is black, or omitted if it precedes the camera's first decodable one.

    Args:
        opened: the recording.
        chosen: times of the frames by camera [ns].
        sources: tables that are drawn; None: none.
        targets: identities, in the order of their colours.
        lost: records frames that cannot be decoded.
    """
    scene = opened.scene
    metres = 1.0 if scene is None else METRES.get(scene.length_unit, 1.0)
    ranks = {target: rank for rank, target in enumerate(targets)}
    world = GroundTrackPositions(sources, metres, ranks, TRAIL_S) if isinstance(sources, OverlayTables) else None
    drawn = FrameOverlay(sources.tracks, sources.truth, TRAIL_S) if isinstance(sources, ImageTables) else None
    width = WIDTH if drawn is None else WIDTH_ALONE
    placed = {} if scene is None else {c.name: c for c in scene.cameras if c.placed}
    shapes: dict[str, tuple[int, ...]] = {}
    for frame in opened.frames():
        over = None if drawn is None else drawn.shot(frame)
        if frame.t_ns not in chosen[frame.sensor]:
            continue
        ways: list[LineDrawing] = []
        if world is not None and frame.sensor in placed:
            world.move(frame.t_ns)
            ways = world.ways(placed[frame.sensor], frame.t_ns)
        image, notes = lost.image(frame), []
        if image is None:
            lost.miss(frame.sensor, frame.index)
            if frame.sensor not in shapes:
                continue
            image, notes = np.zeros(shapes[frame.sensor], dtype=np.uint8), [NO_IMAGE]
        shapes[frame.sensor] = image.shape
        shot = FrameDrawing(frame.sensor, ways=ways, ranks=ranks, notes=notes)
        if over is not None:
            shot = over._replace(ranks=ranks, notes=notes)
        picture = draw_shot(image, shot, width / image.shape[1])
        yield frame.sensor, frame.t_ns, encode_image(picture, "jpeg", QUALITY)
