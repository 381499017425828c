"""Drawings of targets at one time: in space with ellipses, trails and names, and as seen by a camera."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from occlog.array_types import NS, Floats
from occlog.colours import target_rgb
from occlog.core.geometry.camera import wrap_angle
from occlog.examine.viewers.drawings.shapes import (
    GREY,
    WHITE,
    Cylinder,
    DrawingGroup,
    Polyline,
    Rgba,
    Text,
    around,
    at_height,
    faded,
    rim,
)
from occlog.records.declared.people import GROUND, PeopleTracks
from occlog.records.scene import Camera
from occlog.records.tables import Boxes, Diagnostics, Tracks, Truth, TruthBoxes, Views, ViewTracks

HEIGHT, WIDTH = 1.7, 0.5
"""Size of a person without a size in the tracks [m]."""
TRAIL_NS, TRAIL_POINTS = 5 * NS, 60
"""Length of a trail, and the points of it that are drawn."""
STALE_NS = NS
"""An estimate that is older than this is no longer drawn: the target is gone."""
SLACK = 0.1
"""A person with a middle this far outside the field of view may still be in the image in part [rad]."""
HIDDEN = 0.3
"""A target of which less than this share is visible counts as hidden."""
NAME_SIZE, NAME_PX = 0.3, 14.0
"""Height of a name in space [m] and in an image [px]."""


@dataclass(frozen=True, eq=False)
class PersonEstimate:
    """Estimate of a target at one time, for drawing; lengths in metres.

    Attributes:
        t_ns: time [ns].
        target: identity.
        xy: (2,) position on the floor.
        covariance: (2, 2) covariance of the position; NaN: unknown.
        floor: height (z) of the feet.
        height, width: size of the body.
        seen_by: names of the sensors that detect the person; None: unknown.
        quality_flags: reasons why the estimate is unreliable; empty: none.
    """

    t_ns: int
    target: int
    xy: Floats  # (2,)
    covariance: Floats  # (2, 2) NaN: not known
    floor: float  # z of its feet
    height: float
    width: float
    seen_by: frozenset[str] | None  # None: not known
    quality_flags: str  # why it is not reliable

    @property
    def unsure(self) -> bool:
        """Whether the person is drawn dashed: no sensor detects it, or it has a quality flag."""
        return bool(self.quality_flags) or (self.seen_by is not None and not self.seen_by)

    @cached_property
    def rim(self) -> Floats | None:
        """Points (k, 2) of the 95 % ellipse of the position [m]; None if unknown."""
        return rim(self.xy, self.covariance) if np.isfinite(self.covariance).all() else None

    @cached_property
    def body(self) -> Floats:
        """Points (2 n, 3) on n-gons around the feet and around the head [m]."""
        ring = around(self.xy, np.full(2, 0.5 * self.width))
        return np.vstack([at_height(ring, self.floor), at_height(ring, self.floor + self.height)])


class Palette:
    """Colours of targets, assigned by the order of their identities."""

    def __init__(self, targets: Iterable[int]) -> None:
        """Assign colours to all identities `targets`, in order."""
        self._index = {target: n for n, target in enumerate(sorted(set(targets)))}

    def __len__(self) -> int:
        """Return the number of targets."""
        return len(self._index)

    def __call__(self, target: int) -> Rgba:
        """Return the colour of a target; grey for an unknown one."""
        if target not in self._index:
            return GREY
        r, g, b = target_rgb(self._index[target])
        return r / 255, g / 255, b / 255, 1.0


class DiagnosticsDrawing:
    """Latest filter diagnostics of each target: quality flags, and detecting sensors (None: unknown)."""

    def __init__(self) -> None:
        """Create a store without diagnostics."""
        self.quality_flags: dict[int, str] = {}
        self.seen_by: dict[int, frozenset[str] | None] = {}

    def add(self, rows: Diagnostics) -> None:
        """Store quality flags and detecting sensors of each target from the rows of one time."""
        for k, target in enumerate(rows.target_id.tolist()):
            self.quality_flags[target] = str(rows.quality_flags[k]) or str(rows.fallback[k])
            names = frozenset(filter(None, str(rows.seen_by[k]).split(",")))
            # Some methods do not state which sensors saw the target
            self.seen_by[target] = names if names or not rows.n_detected[k] else None


def people_of(rows: Tracks, metres: float, diagnostics: DiagnosticsDrawing | None = None) -> list[PersonEstimate]:
    """Return the estimates of the targets in rows of one time, for drawing.

    Args:
        rows: tracks, one row for each target.
        metres: metres per length unit of the rows.
        diagnostics: used where the rows state no flags or detecting sensors; None: unknown.
    """
    diagnostics = DiagnosticsDrawing() if diagnostics is None else diagnostics
    wide = rows if isinstance(rows, PeopleTracks) else None
    covariance = np.stack([rows.cov_xx, rows.cov_xy, rows.cov_xy, rows.cov_yy], axis=1).reshape(-1, 2, 2) * metres**2
    out = []
    for k, target in enumerate(rows.target_id.tolist()):
        doubt, seen = diagnostics.quality_flags.get(target, ""), diagnostics.seen_by.get(target)
        height, width = np.nan, np.nan
        if wide is not None:
            height, width = metres * float(wide.height[k]), metres * float(wide.width[k])
            doubt = str(wide.quality_flags[k]) or doubt
            # A method that tracks all people states the sensors of each row
            if not np.isnan(wide.existence_probability[k]):
                seen = frozenset(filter(None, str(wide.seen_by[k]).split(",")))
        out.append(
            PersonEstimate(
                t_ns=int(rows.t_ns[k]),
                target=target,
                xy=metres * np.array([rows.x[k], rows.y[k]]),
                covariance=covariance[k],
                floor=0.0,
                height=HEIGHT if np.isnan(height) else height,
                width=WIDTH if np.isnan(width) else width,
                seen_by=seen,
                quality_flags=doubt,
            )
        )
    return out


class PeopleDrawing:
    """Latest estimate of each target, and its trail over the last seconds."""

    def __init__(self, palette: Palette, trail_ns: int = TRAIL_NS) -> None:
        """Create a drawing without targets.

        Args:
            palette: colours of the targets.
            trail_ns: length of the trails in time [ns].
        """
        self._palette, self._trail_ns = palette, trail_ns
        self._people: dict[int, PersonEstimate] = {}
        self._trails: dict[int, deque[tuple[int, Floats]]] = {}

    def add(self, people: Iterable[PersonEstimate]) -> None:
        """Set the current estimates of the targets, all of one time, and extend their trails."""
        for person in people:
            self._people[person.target] = person
            trail = self._trails.setdefault(person.target, deque())
            trail.append((person.t_ns, person.xy))
            while trail[0][0] < person.t_ns - self._trail_ns:
                trail.popleft()

    def at(self, t_ns: int) -> list[PersonEstimate]:
        """Return the current estimates at `t_ns` [ns], by identity; targets without recent ones are dropped."""
        for target in [name for name, person in self._people.items() if person.t_ns < t_ns - STALE_NS]:
            del self._people[target], self._trails[target]
        return [self._people[target] for target in sorted(self._people)]

    def find(self, target: int) -> PersonEstimate | None:
        """Return the latest estimate of a target; None if unknown."""
        return self._people.get(target)

    def trail(self, target: int) -> Floats:
        """Return the trail (k, 2) of a target [m], earliest point first; at most `TRAIL_POINTS`, evenly selected."""
        points = np.array([xy for _, xy in self._trails[target]])
        keep = np.unique(np.linspace(0, len(points) - 1, min(len(points), TRAIL_POINTS)).round().astype(np.int64))
        return np.asarray(points[keep])

    def in_space(self, t_ns: int) -> list[DrawingGroup]:
        """Return the 3-D shapes [m] of all people at the time `t_ns` [ns]."""
        return [self._in_space(person) for person in self.at(t_ns)]

    def _in_space(self, person: PersonEstimate) -> DrawingGroup:
        colour = self._palette(person.target)
        lines = []
        if person.rim is not None:
            lines.append(Polyline(at_height(person.rim, 0.02), colour, 2.0, person.unsure))
        trail = self.trail(person.target)
        if len(trail) > 1:
            lines.append(Polyline(at_height(trail, 0.02), faded(colour, 0.7), 2.0))
        foot = np.array([*person.xy, person.floor])
        body = Cylinder(foot, person.width, person.height, faded(colour, 0.25 if person.unsure else 0.6))
        name = Text(foot + np.array([0, 0, person.height + NAME_SIZE]), name_of(person), NAME_SIZE, colour)
        return DrawingGroup(f"target {person.target}", lines, [body], texts=[name])

    def in_image(self, camera: Camera, metres: float, t_ns: int) -> list[DrawingGroup]:
        """Return shapes over a camera's image: outline and floor ellipse of each target [px].

        They are dashed if the camera does not detect the target. `metres`: metres per length unit of the camera's
        scene; `t_ns`: time [ns].
        """
        things = []
        for person in self.at(t_ns):
            box = body_in_image(person, camera, metres)
            if box is None:
                continue
            unseen = person.unsure or (person.seen_by is not None and camera.name not in person.seen_by)
            colour = self._palette(person.target)
            lines = [Polyline(corners(box), colour, 2.0, unseen)]
            feet = feet_in_image(person, camera, metres)
            if feet is not None:
                lines.append(Polyline(feet, colour, 1.5, unseen))
            words = Text(box[:2], name_of(person), NAME_PX, colour)
            things.append(DrawingGroup(f"target {person.target}", lines, texts=[words]))
        return things


def name_of(person: PersonEstimate) -> str:
    """Return the number of a person's track as text, with a question mark if it has a quality flag."""
    return f"{person.target}?" if person.quality_flags else str(person.target)


def true_in_space(rows: Truth, metres: float) -> list[DrawingGroup]:
    """Return shapes of true positions [m]: a ring and a post, white for targets, grey for occluders.

    Args:
        rows: true positions of one time.
        metres: metres per length unit of the rows.
    """
    things = []
    for role, target, x, y in zip(
        rows.role.tolist(), rows.target_id.tolist(), rows.x.tolist(), rows.y.tolist(), strict=True
    ):
        colour = WHITE if role == "target" else GREY
        foot = metres * np.array([x, y, 0.0])
        ring = at_height(around(foot[:2], np.full(2, 0.1)), 0.03)
        post = np.array([foot, foot + np.array([0, 0, HEIGHT])])
        things.append(DrawingGroup(f"true {target}", lines=[Polyline(ring, colour, 2.0), Polyline(post, colour, 1.0)]))
    return things


def body_in_image(person: PersonEstimate, camera: Camera, metres: float) -> Floats | None:
    """Return left, top, right and bottom (4,) [px] of a person in a camera's image.

    None if not entirely in front of the camera, or outside the image. `metres`: metres per length unit of the camera's
    scene.
    """
    away = person.xy / metres - camera.ground
    aside = float(wrap_angle(np.arctan2(away[1], away[0]) - camera.yaw))
    pixels = camera.project(person.body / metres)
    # Far aside, distortion folds the plane back into the image
    if abs(aside) > 0.5 * camera.fov + SLACK or not np.isfinite(pixels).all():
        return None
    box = np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])
    width, height = camera.image_size or (np.inf, np.inf)
    inside = box[0] < width and box[1] < height and box[2] > 0 and box[3] > 0
    return box if inside else None


def feet_in_image(person: PersonEstimate, camera: Camera, metres: float) -> Floats | None:
    """Return the projected 95 % ellipse (k, 2) of a person's position on the floor [px]; None if not visible.

    `metres`: metres per length unit of the camera's scene.
    """
    if person.rim is None or not camera.above_floor:
        return None
    pixels = camera.project(at_height(person.rim, person.floor) / metres)
    return pixels if np.isfinite(pixels).all() else None


def corners(box: Floats) -> Floats:
    """Return the closed polyline (5, 2) around a box (4,): left, top, right, bottom."""
    left, top, right, bottom = box.tolist()
    return np.array([[left, top], [right, top], [right, bottom], [left, bottom], [left, top]])


def tracked_in_image(rows: ViewTracks, palette: Palette) -> list[DrawingGroup]:
    """Return shapes of tracks in an image, as ellipses [px].

    They are dashed if only neighbours act on them, or if they are predictions without a detection.

    Args:
        rows: ellipses in one image.
        palette: colours of the targets.
    """
    helped = rows.assisting_views != ""
    dashed = ((rows.neighbours != "") & ~helped) | (rows.likelihood_mode == GROUND)
    things = []
    for k, target in enumerate(rows.target_id.tolist()):
        rho = float(rows.rho[k])
        axes = np.array([[np.cos(rho), -np.sin(rho)], [np.sin(rho), np.cos(rho)]])
        outline = around(np.array([rows.x_px[k], rows.y_px[k]]), np.array([rows.a_px[k], rows.b_px[k]]), axes)
        top = outline[outline[:, 1].argmin()]
        colour = palette(target)
        line = Polyline(outline, colour, 3.0 if helped[k] else 2.0, bool(dashed[k]))
        things.append(DrawingGroup(f"target {target}", [line], texts=[Text(top, str(target), NAME_PX, colour)]))
    return things


def boxes_in_image(rows: Boxes | Views | TruthBoxes) -> list[DrawingGroup]:
    """Return shapes [px] of a detector's boxes (grey), or of true boxes (white, dashed if the target is occluded)."""
    true = isinstance(rows, TruthBoxes)
    if isinstance(rows, Boxes):  # a frame without boxes has a row without one
        rows = rows.take(rows.box >= 0)
    box = np.column_stack([rows.left_px, rows.top_px, rows.left_px + rows.width_px, rows.top_px + rows.height_px])
    hidden = rows.visible < HIDDEN if isinstance(rows, TruthBoxes) else np.zeros(len(rows), dtype=np.bool_)
    # The edges are those of pixels, with centres at whole numbers
    lines = [
        Polyline(corners(b), WHITE if true else GREY, 1.0, bool(h)) for b, h in zip(box, hidden.tolist(), strict=True)
    ]
    return [DrawingGroup("true boxes" if true else "boxes", lines)]
