"""From the rows of a frame to its drawing: estimates, interactions, failures, and true positions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.geometry.fundamental import epipolar_lines
from occlog.core.geometry.lens import distort
from occlog.measure.epipolar.from_scene import ideal_pixels
from occlog.measure.epipolar.views import TrackedView, ViewGeometry
from occlog.records.declared.people import GROUND, PREDICTED
from occlog.records.declared.views import Failures, ViewTracks
from occlog.records.scene import Camera
from occlog.records.tables import TruthBoxes
from occlog.track.methods.images.initiation.births import anchors

from .draw import FrameDrawing, Outline, TruePosition

BENT = 65
"""Points of a line that lens distortion bends."""


class OverlayFrameRows(NamedTuple):
    """Rows of each table for one frame of one camera; None for missing tables.

    Attributes:
        tracks: tracks in images.
        truth: true boxes.
        failures: failures of the tracks.
    """

    tracks: ViewTracks | None
    truth: TruthBoxes | None
    failures: Failures | None


class OverlayRig(NamedTuple):
    """Views that are drawn, with their epipolar geometry.

    Attributes:
        views: the views.
        cameras: camera of each view in the scene, for lens distortion; None: unknown.
        geometry: epipolar geometry; None: no epipolar lines are drawn.
        numbered: a tracker has the number of its target; otherwise the two numbers are unrelated.
        bottom: epipolar lines are those of the lowest points of ellipses (feet); otherwise of their centres.
    """

    views: Sequence[TrackedView]
    cameras: Sequence[Camera | None]  # of the scene, for lens distortion
    geometry: ViewGeometry | None  # None: no epipolar lines are drawn
    numbered: bool = True  # a tracker has the number of its target; else the two have nothing in common
    bottom: bool = False  # lines are of the lowest points of ellipses, at people's feet; else of their centres


def frame_shot(view: int, frame: int, rows: Sequence[OverlayFrameRows], rig: OverlayRig) -> FrameDrawing:
    """Return the drawings over one frame of a view.

    Estimates are dashed while only neighbours act on them, or where the view has no box of the person; strong with help
    from other views, with the epipolar lines of these estimates. Drawn are also links of estimates that touch, true
    positions, and failures.

    Args:
        view: index of the view.
        frame: number of the frame in the camera's stream.
        rows: for each view, the rows of its latest frame.
        rig: the views.
    """
    tracks, truth, failures = rows[view]
    labels = _label_failures(failures) if rig.numbered else {}
    missed = _missed(failures)
    positions = [] if truth is None else _places(truth, missed, rig.numbered or tracks is None)
    drawn = {position.target_id for position in positions}
    return FrameDrawing(
        title=f"{rig.views[view].name}   frame {frame}",
        outlines=[] if tracks is None else _outlines(tracks, labels),
        links=[] if tracks is None else _links(tracks),
        lines=[] if tracks is None or rig.geometry is None else _lines(view, tracks, rows, rig, rig.geometry),
        positions=positions,
        boxed=tracks is None,
        notes=[f"target {target}: no tracker" for target in sorted(missed - drawn)] + _others(failures, rig.numbered),
    )


def _label_failures(failures: Failures | None) -> dict[int, int]:
    """Return the target that a tracker is on, by its assigned target, for label failures."""
    if failures is None:
        return {}
    rows = np.flatnonzero(failures.kind == "label")
    return dict(zip(failures.target_id[rows].tolist(), failures.other_id[rows].tolist(), strict=True))


def _others(failures: Failures | None, numbered: bool) -> list[str]:
    """Return texts about label failures of trackers; empty if trackers have the numbers of targets (`numbered`)."""
    if failures is None or numbered:
        return []
    rows = np.flatnonzero(failures.kind == "label")
    pairs = sorted(set(zip(failures.target_id[rows].tolist(), failures.other_id[rows].tolist(), strict=True)))
    return [f"a tracker of {f'target {own}' if own >= 0 else 'no target'} is on target {on}" for own, on in pairs]


def _missed(failures: Failures | None) -> set[int]:
    return set() if failures is None else set(failures.target_id[failures.kind == "position"].tolist())


def _outlines(tracks: ViewTracks, labels: Mapping[int, int]) -> list[Outline]:
    ellipses = np.column_stack([tracks.x_px, tracks.y_px, tracks.a_px, tracks.b_px, tracks.rho])
    helped = tracks.assisting_views != ""
    dashed = ((tracks.neighbours != "") & ~helped) | np.isin(tracks.likelihood_mode, (GROUND, PREDICTED))
    return [
        Outline(
            ellipses[k], target, bool(dashed[k]), bool(helped[k]), f"on {labels[target]}" if target in labels else ""
        )
        for k, target in enumerate(tracks.target_id.tolist())
    ]


def _links(tracks: ViewTracks) -> list[Floats]:
    """Return the centres (2, 2) [px] of each pair of targets that touch, each pair once."""
    centres = np.column_stack([tracks.x_px, tracks.y_px])
    row = {target: k for k, target in enumerate(tracks.target_id.tolist())}
    pairs = {
        (min(k, row[int(other)]), max(k, row[int(other)]))
        for k, others in enumerate(tracks.neighbours.tolist())
        for other in filter(None, others.split(","))
        if int(other) in row
    }
    return [centres[list(pair)] for pair in sorted(pairs)]


def _places(truth: TruthBoxes, missed: set[int], coloured: bool) -> list[TruePosition]:
    boxes = np.column_stack([truth.left_px, truth.top_px, truth.width_px, truth.height_px])
    return [
        TruePosition(boxes[k], target, float(truth.visible[k]), target in missed, coloured)
        for k, target in enumerate(truth.target_id.tolist())
        if truth.box[k] >= 0
    ]


def _lines(
    view: int, tracks: ViewTracks, rows: Sequence[OverlayFrameRows], rig: OverlayRig, geometry: ViewGeometry
) -> list[tuple[int, Floats]]:
    """Return (target, points (k, 2) [px]) of the epipolar lines in a view, from other views that constrain its targets.

    Args:
        view: index of the view.
        tracks: its rows.
        rows: rows of each view at this time.
        rig: views and cameras.
        geometry: fundamental matrices.
    """
    numbers = {v.name: n for n, v in enumerate(rig.views)}
    out = []
    for target, names in zip(tracks.target_id.tolist(), tracks.assisting_views.tolist(), strict=True):
        for helper in (numbers[name] for name in filter(None, names.split(",")) if name in numbers):
            points = _line(target, helper, view, rows[helper].tracks, rig, geometry)
            if points is not None:
                out.append((target, points))
    return out


def _line(
    target: int, helper: int, view: int, tracks: ViewTracks | None, rig: OverlayRig, geometry: ViewGeometry
) -> Floats | None:
    """Return the points (k, 2) [px] of the epipolar line of a target's estimate in another view.

    Lens distortion bends it. None without an estimate or line, or if it misses the image.

    Args:
        target: identity of the target.
        helper: index of the view of the estimate.
        view: index of the view of the line.
        tracks: rows of the helper view; None: none.
        rig: views and cameras.
        geometry: fundamental matrices.
    """
    rows = np.flatnonzero(tracks.target_id == target) if tracks is not None else np.zeros(0, dtype=np.int64)
    if tracks is None or not len(rows):
        return None
    k = rows[0]
    ellipse = [tracks.x_px[k], tracks.y_px[k], tracks.a_px[k], tracks.b_px[k], tracks.rho[k]]
    point = anchors(np.array([ellipse]), rig.bottom)
    ideal = geometry.ideal[helper]
    line = epipolar_lines(geometry.fundamental[helper, view], point if ideal is None else ideal(point))[0]
    if not np.isfinite(line).all():
        return None
    return line_in_image(line, rig.views[view], rig.cameras[view] if geometry.ideal[view] is not None else None)


def line_in_image(line: Floats, view: TrackedView, camera: Camera | None) -> Floats | None:
    """Return pixels (k, 2) of the recorded image along a line of the undistorted image; None if it misses the image.

    Args:
        line: (3,) l1 u + l2 v + l3 = 0 in undistorted pixels, with l1^2 + l2^2 = 1.
        view: with the image's size.
        camera: its lens distortion bends the line; None: it is straight.
    """
    size = np.array([view.width, view.height], dtype=np.float64)
    middle, reach = 0.5 * (size - 1.0), float(np.hypot(*size)) * (0.5 if camera is None else 1.0)
    offset = float(line[:2] @ middle + line[2])
    if abs(offset) > reach:
        return None
    foot, half = middle - offset * line[:2], float(np.sqrt(reach**2 - offset**2))
    along = np.linspace(-half, half, 2 if camera is None else BENT)[:, None]
    points: Floats = foot + along * np.array([-line[1], line[0]])
    if camera is None:
        return points
    ideal = (points - camera.principal_px) / camera.focal_px
    bent = distort(ideal, camera.distortion, camera.distortion_model) * camera.focal_px + camera.principal_px
    # Far outside, distortion folds the plane back into the image; there it cannot be undone.
    kept = ((bent > -size) & (bent < 2 * size)).all(axis=1)
    kept &= np.abs(ideal_pixels(camera, bent) - points).max(axis=1) < 1.0
    return bent[kept] if kept.sum() > 1 else None
