"""Detection in the frames of one camera: decode, subtract the background, find person-sized regions.

Unusable frames become losses. Regions are assigned to targets by appearance, and by the targets' last positions.
"""

from __future__ import annotations

import math
import re
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.camera import is_upright
from occlog.errors import InputError, UsageError, option
from occlog.measure.clusters.merged_silhouettes import SeparateSightings
from occlog.measure.clusters.person_size import Prior, SizeMap, constant_sizes, make_prior, sizes_from_camera
from occlog.measure.clusters.stage import cell_side
from occlog.measure.detections import PERSON_HEIGHT
from occlog.measure.regions.background import Subtractor, foreground, largest_image, make_subtractor
from occlog.measure.regions.regions import (
    ForegroundRegions,
    cluster_regions,
    component_regions,
    downscale,
    downscale_factor,
    downscale_sizes,
    enlarge,
    similarity,
)
from occlog.records.frames import Frame, Image
from occlog.records.losses import Loss
from occlog.records.scene import Camera, Scene
from occlog.records.tables import APPEARANCE_BINS

from ..config import (
    CLEAN_PX,
    COMPONENTS,
    CONTINUITY_BONUS,
    MAX_CLUSTER_RATIO,
    MAX_FOREGROUND,
    MEMORY_S,
    MIN_CLUSTER_RATIO,
    OUTLINES,
    PENALTY,
    STRENGTH,
    DetectConfig,
)
from ..track_feedback import TrackFeedback

MAX_JUMP_WIDTHS = 2.0
"""Distance from its last position at which a target's closeness is exp(-1/2), in spreads of a person's width."""


@dataclass(frozen=True, eq=False)
class Target:
    """A person to search for, with appearances; InputError if a row of `appearances` is not a histogram."""

    target_id: int
    appearances: Floats  # (n, 72) histograms of one person, in several views or lights

    def __post_init__(self) -> None:
        a = self.appearances
        ok = a.ndim == 2 and a.shape[1:] == (APPEARANCE_BINS,) and len(a) > 0 and np.isfinite(a).all()
        if not (ok and (a >= 0).all() and np.allclose(a.sum(axis=1), 1.0, atol=1e-3)):
            raise InputError(
                f"target {self.target_id}: each appearance must be {APPEARANCE_BINS} numbers of at least 0 "
                f"that sum to 1; got an array of shape {a.shape}"
            )


def check_targets(targets: Sequence[Target]) -> None:
    """UsageError where two targets have the same identity."""
    ids = [t.target_id for t in targets]
    if len(set(ids)) < len(ids):
        raise UsageError(
            f"detect: two targets have the same number ({ids}); give each target its own", id="duplicate-name"
        )


@dataclass
class TargetMemory:
    """Last detection of each target in one camera: by the target's index, time [ns], x and y [px]."""

    last: dict[int, tuple[int, float, float]] = field(default_factory=dict)


def similarities(appearance: Floats, targets: Sequence[Target]) -> Floats:
    """(K, T) similarities of K regions' colour histograms (K, 72) to each of T targets, 0 to 1; NaN for NaN rows.

    The Bhattacharyya coefficient with the target's most similar appearance. (K, 0) without targets.
    """
    columns = [similarity(appearance, target.appearances).max(axis=1, initial=-np.inf) for target in targets]
    return np.column_stack(columns) if columns else np.empty((len(appearance), 0))


def choose(
    t_ns: int,
    regions: ForegroundRegions,
    like: Floats,
    memory: TargetMemory,
    similarity_limit: float,
    allowed: Bools | None = None,
) -> Ints:
    """Assign a region to each of T targets in one frame, and update `memory` with their positions.

    With appearances, pairs of target and region are assigned greedily by similarity plus `CONTINUITY_BONUS` times
    closeness to the last position, one region per target, if the similarity is sufficient. Without appearances
    there is one target: the region with the most foreground times 1 + closeness, so that it does not change between
    regions of about the same size. Regions with more than `MAX_CLUSTER_RATIO` times a person's pixels are excluded.

    Args:
        t_ns: time of the frame [ns].
        regions: K regions.
        like: (K, T) similarities; (K, 0) where no appearance is known.
        memory: last positions of the targets in this camera.
        similarity_limit: minimum similarity, 0 to 1.
        allowed: (K, max(T, 1)) mask of regions that may be of each target; None: all.

    Returns:
        (max(T, 1),) index of each target's region, -1 for a target that is not detected.
    """
    n_targets = max(like.shape[1], 1)
    close = np.column_stack([_closeness(t_ns, regions, memory.last.get(n)) for n in range(n_targets)])
    chosen = np.full(n_targets, -1, dtype=np.int64)
    # Gate: omit regions that are much larger than a person.
    plausible = np.repeat((regions.fill <= MAX_CLUSTER_RATIO)[:, None], n_targets, axis=1)
    if allowed is not None:
        plausible &= allowed
    if not plausible.any():
        return chosen
    if not like.shape[1]:
        chosen[0] = int(np.argmax(np.where(plausible[:, 0], regions.mass * (1.0 + close[:, 0]), -np.inf)))
    else:
        # Assign greedily: the pair of region and target with the highest score first.
        good = plausible & (like >= similarity_limit)
        score = np.where(good, like + CONTINUITY_BONUS * close, -np.inf)
        while (best := np.unravel_index(int(np.argmax(score)), score.shape)) and score[best] > -np.inf:
            k, n = int(best[0]), int(best[1])
            chosen[n] = k
            score[k, :] = score[:, n] = -np.inf
    for n in np.flatnonzero(chosen >= 0).tolist():
        x, y = regions.means[chosen[n]].tolist()
        memory.last[n] = (t_ns, x, y)
    return chosen


def _closeness(t_ns: int, regions: ForegroundRegions, last: tuple[int, float, float] | None) -> Floats:
    """(K,) closeness of regions to the target's last position: exp(-d^2 / 2), with the normalised distance d.

    d is in units of `MAX_JUMP_WIDTHS` standard deviations of a person's pixels across. 0 without a last position,
    and after `MEMORY_S`.

    Args:
        t_ns: time of the frame [ns].
        regions: K regions.
        last: time [ns], x and y [px] of the last position; None: unknown.
    """
    if last is None or (t_ns - last[0]) * 1e-9 > MEMORY_S:
        return np.zeros(len(regions.mass))
    widths = np.sqrt(regions.person[:, 0])
    far = np.hypot(regions.means[:, 0] - last[1], regions.means[:, 1] - last[2]) / (MAX_JUMP_WIDTHS * widths)
    closeness: Floats = np.exp(-0.5 * far**2)
    return closeness


UNKNOWN_SIDE_PX = 960  # longer side of shrunk images where the size of people is not known
BLOCK = 16  # codecs cut images at the right and below to whole blocks


@dataclass(frozen=True)
class CameraSetup:
    """Detection in one camera, set up from its first frame.

    Attributes:
        shape: shape of the frames.
        shrink: integer factor by which they are downscaled.
        subtractor: background model of the downscaled images.
        sizes: sizes of people in the downscaled images.
        prior: prior of the clustering there.
        side: side of its cells [px of the downscaled image].
        started: whether the model started from an image of the empty scene.
    """

    shape: tuple[int, ...]
    shrink: int
    subtractor: Subtractor
    sizes: SizeMap
    prior: Prior
    side: int
    started: bool


@dataclass
class CameraState:
    """State of the detection in one camera, updated in place, and used by one thread at a time.

    Attributes:
        camera, scene, config: camera, its scene, and settings.
        empty: learned image of the empty scene; None: not learned.
        sizes: learned sizes of people; None: not learned.
        targets: targets to search for.
        setup: made at the first frame; None before.
        seen: number of frames given to the background model.
        memory: last positions of targets.
        separate: frames in which people are separate.
        near: track feedback that limits the search for targets; None: they are searched for in the whole image.
    """

    camera: Camera
    scene: Scene
    config: DetectConfig
    empty: Image | None = None
    sizes: SizeMap | None = None
    targets: tuple[Target, ...] = ()
    setup: CameraSetup | None = None
    seen: int = 0
    memory: TargetMemory = field(default_factory=TargetMemory)
    separate: SeparateSightings = field(default_factory=SeparateSightings)
    near: TrackFeedback | None = None


@dataclass(frozen=True)
class FrameRegions:
    """Person-sized regions of one frame, with its time `t_ns` [ns] and its number `index`."""

    t_ns: int
    index: int
    regions: ForegroundRegions


@dataclass(frozen=True)
class CameraBatch:
    """Regions and losses of one camera's frames in a batch; `warmup` counts frames that only trained the background."""

    found: tuple[FrameRegions, ...]
    losses: tuple[Loss, ...]
    warmup: int


def process(state: CameraState, frames: list[Frame]) -> CameraBatch:
    """Detect the person-sized regions in a camera's frames, in order; `state` is updated in place.

    Frames that cannot be decoded or used become losses.
    """
    found: list[FrameRegions] = []
    lost: list[tuple[int, str]] = []
    warmup = 0
    for frame in frames:
        try:
            decoded = frame.decode()
        except InputError as error:
            # The message begins with file, camera and frame; without them equal reasons are equal.
            lost.append((frame.index, str(error).rsplit(": ", 1)[-1]))
            continue
        try:
            image = plain_image(decoded, state.config.bit_depth)
        except InputError as error:
            lost.append((frame.index, str(error)))
            continue
        if state.setup is None:
            state.setup = set_up(state, image)
        reason, regions = _regions_of_frame(state, state.setup, frame, image)
        if reason:
            lost.append((frame.index, reason))
        elif regions is None:
            warmup += 1
        else:
            found.append(FrameRegions(frame.t_ns, frame.index, regions))
    return CameraBatch(tuple(found), segments(state.camera.name, lost), warmup)


def _regions_of_frame(
    state: CameraState, setup: CameraSetup, frame: Frame, image: Image
) -> tuple[str, ForegroundRegions | None]:
    """Reason why a frame cannot be used (empty: none), and its regions; no regions during warm-up of the background.

    `image` is the decoded frame. The background model in `setup` and the frame count in `state` are updated.
    """
    if image.shape != setup.shape:
        return f"image is {size_in_words(image.shape)}, the camera's first was {size_in_words(setup.shape)}", None
    c = state.config
    # Subtract the background
    image = downscale(image, setup.shrink)
    mask = foreground(setup.subtractor, image, frame.index, CLEAN_PX)
    state.seen += 1
    if not setup.started and state.seen <= c.warmup:
        return "", None
    # Refuse frames in which too much changed
    share = np.count_nonzero(mask) / mask.size
    if share > MAX_FOREGROUND:
        return f"foreground covers more than {MAX_FOREGROUND:.0%} of the image (light, or the camera moved)", None
    # Find people-sized regions
    if c.method == COMPONENTS:
        regions = component_regions(image, mask, setup.sizes.width_px, setup.prior)
    else:
        separate = state.separate if c.method == OUTLINES else None
        regions = cluster_regions(image, mask, setup.side, setup.prior, separate)
    return "", enlarge(regions, setup.shrink)


def set_up(state: CameraState, image: Image) -> CameraSetup:
    """Create the background model and size map for images like the camera's first (`image`).

    Raises:
        InputError: the image size contradicts the scene or is too large, or the size of people is unknown.
    """
    camera, c = state.camera, state.config
    size = (image.shape[1], image.shape[0])
    check_size(camera, size)
    factor = shrink_of(camera, state.scene, size, c)
    empty = state.empty
    if empty is not None and empty.shape != downscale(image, factor).shape:
        empty = None
    seed = zlib.crc32(camera.name.encode()) >> 1
    subtractor = make_subtractor(c.background, c.history, c.foreground_threshold, c.shadows, empty, seed)
    sizes = state.sizes if state.sizes is not None else known_sizes(camera, state.scene, size, c)
    if sizes is None:
        raise InputError(
            f"camera {camera.name}: the size of people in its images is unknown (no pose in an upright world with a "
            f"known unit); give their height in pixels ({option('person_height_px')})",
            id="missing-unit",
        )
    sizes = downscale_sizes(sizes, factor)
    prior = make_prior(sizes, STRENGTH, PENALTY, MIN_CLUSTER_RATIO)
    return CameraSetup(image.shape, factor, subtractor, sizes, prior, cell_side(sizes), empty is not None)


def known_sizes(camera: Camera, scene: Scene, size: tuple[int, int], config: DetectConfig) -> SizeMap | None:
    """Size map for images of a size (width, height) [px] by the height in `config`, or by the camera's pose.

    None if neither determines it, or in most of the image no person could stand.
    """
    if config.person_height_px is not None:
        return constant_sizes(size, config.person_height_px)
    height = config.person_height or PERSON_HEIGHT.get(scene.length_unit)
    if height is None or not camera.placed or not upright(scene):
        return None
    reach = np.inf
    if scene.room is not None:
        reach = float(np.hypot(*(scene.room - camera.ground).T).max())
    try:
        return sizes_from_camera(camera, size, height, reach)
    except ValueError:  # no person who stands on the ground is in the image
        return None


def upright(scene: Scene) -> bool:
    """Whether the scene's world seems to be upright (z is up), so that camera poses determine the size of people."""
    return is_upright(np.array([c.rotation for c in scene.cameras if c.placed]).reshape(-1, 3, 3))


def shrink_of(camera: Camera, scene: Scene, size: tuple[int, int], config: DetectConfig) -> int:
    """Downscaling factor of a camera's images, from the options or the size of people in them.

    `size` is width and height of the images [px].

    Raises:
        InputError: the downscaled images are too large for a background model.
    """
    sizes = known_sizes(camera, scene, size, config) if config.downscale is None else None
    if config.downscale is not None:
        factor = config.downscale
    elif sizes is not None:
        factor = downscale_factor(sizes.width_px)
    else:
        factor = max(1, round(max(size) / UNKNOWN_SIDE_PX))
    check_background(camera, config.background, size, factor)
    return factor


def check_size(camera: Camera, size: tuple[int, int]) -> None:
    """InputError unless images of a size (width, height) [px] fit the camera's calibration.

    They may be up to `BLOCK` - 1 pixels smaller, as codecs crop; without a stated size all fit.
    """
    if camera.image_size is None:
        return
    cut = np.subtract(camera.image_size, size)
    if (cut < 0).any() or (cut >= BLOCK).any():
        raise InputError(
            f"camera {camera.name}: frames are {size[0]} x {size[1]} px but the scene states "
            f"{camera.image_size[0]} x {camera.image_size[1]}; correct image_size_px, focal_px and "
            "principal_point_px of the camera",
            id="image-size-mismatch",
        )


def check_background(camera: Camera, kind: str, size: tuple[int, int], factor: int) -> None:
    """InputError if images, downscaled by `factor`, are too large for the background model `kind` (`mog2` or `knn`).

    `size` is width and height before downscaling [px].
    """
    pixels, most = size[0] * size[1], largest_image(kind)
    if pixels / factor**2 > most:
        raise InputError(
            f"camera {camera.name}: frames are {size[0]} x {size[1]} px; the background ({kind}) is learnt from "
            f"images of up to {most} pixels; give {option('downscale')} {math.ceil(math.sqrt(pixels / most))} or more",
            id="input-too-large",
        )


def plain_image(image: NDArray[np.integer], bits: int | None) -> Image:
    """Convert a decoded image to 8-bit grey (height, width) or BGR (height, width, 3).

    Args:
        image: integer array (height, width) or (height, width, 1, 3 or 4); a fourth channel is dropped.
        bits: significant bits of 16-bit images, of which the upper 8 are kept; None: such images are refused.

    Raises:
        InputError: another kind of image, or 16 bits without `bits`.
    """
    if image.ndim == 3 and image.shape[2] in (1, 4):
        image = image[:, :, 0] if image.shape[2] == 1 else image[:, :, :3]
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3) or 0 in image.shape:
        raise InputError(
            f"image of shape {image.shape} is neither grey (H, W) nor colour (H, W, 3)", id="unsupported-format"
        )
    if image.dtype == np.uint16:
        if bits is None:
            raise InputError(
                f"16-bit image: give the number of significant bits ({option('bit_depth')}, 8 to 16)",
                id="missing-option",
            )
        image = np.minimum(image >> (bits - 8), 255).astype(np.uint8)
    if image.dtype != np.uint8:
        raise InputError(
            f"image of {image.dtype}: unsigned integers of 8 or 16 bits were expected", id="unsupported-format"
        )
    return np.ascontiguousarray(image)


def size_in_words(shape: tuple[int, ...]) -> str:
    """Size and kind of an image of that shape, for messages: "640 x 480 px grey"."""
    return f"{shape[1]} x {shape[0]} px {'in colour' if len(shape) == 3 else 'grey'}"


def segments(sensor: str, lost: list[tuple[int, str]]) -> tuple[Loss, ...]:
    """Losses of the frames of a sensor, one for each run of consecutive frames with the same reason.

    `lost` has frame number and reason of each frame, in order.
    """
    losses = []
    # Index minus position is constant in a run of consecutive frames.
    for (what, _), group in groupby(enumerate(lost), key=lambda item: (item[1][1], item[1][0] - item[0])):
        numbers = [index for _, (index, _) in group]
        location = f"frame {numbers[0]}" if len(numbers) == 1 else f"frames {numbers[0]} to {numbers[-1]}"
        losses.append(Loss(sensor, location, what, len(numbers)))
    return tuple(losses)


FRAMES = re.compile(r"frames? (\d+)(?: to (\d+))?")
"""Position of a loss that `segments` has made."""


def numbers_of(loss: Loss) -> tuple[int, int] | None:
    """First and last frame number of a loss made by `segments`; None for other losses."""
    found = FRAMES.fullmatch(loss.place)
    return None if found is None else (int(found[1]), int(found[2] or found[1]))


def joined(losses: Iterable[Loss]) -> list[Loss]:
    """Losses in order, in which those made by `segments` that go on in the next batch of frames are one."""
    out: list[Loss] = []
    latest: dict[tuple[str, str], int] = {}
    for loss in losses:
        numbers, k = numbers_of(loss), latest.get((loss.source, loss.what))
        before = None if k is None else numbers_of(out[k])
        if numbers is None or k is None or before is None or numbers[0] != before[1] + 1:
            latest[loss.source, loss.what] = len(out)
            out.append(loss)
        else:
            out[k] = replace(loss, place=f"frames {before[0]} to {numbers[1]}", count=out[k].count + loss.count)
    return out
