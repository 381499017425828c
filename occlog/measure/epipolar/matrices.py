"""Fundamental matrices of the views of a command, from a file, a scene or the recording, with their sources."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.errors import InputError, abridged
from occlog.io.formats.models.fundamental_matrices import attached_epipolar, read_epipolar
from occlog.io.recording.reader import McapRecording
from occlog.records.scene import Scene
from occlog.records.view_pairs import ViewPairs

from .geometry import view_geometry
from .views import TrackedView, ViewGeometry


class KnownGeometry(NamedTuple):
    """Epipolar geometry of the views, with its sources.

    `sources` names the source of each pair (`view1-view2`): file name, `recording`, `poses` or `none`; `notes` are
    messages to the user about the file.
    """

    geometry: ViewGeometry
    sources: dict[str, str]  # by pair (`view1-view2`): file name, `recording`, `poses` or `none`
    notes: tuple[str, ...]  # lines for whoever gave the file


def known_geometry(
    views: Sequence[TrackedView], recording: McapRecording, given: Scene | None, file: Path | None
) -> KnownGeometry:
    """Epipolar geometry of some views, from the first source that has a pair.

    The sources are: the file; poses of the given scene; the recording's matrices, unless a file is given; poses of the
    recording's scene, unless one is given.

    Args:
        views: views that are used.
        recording: recording of the views.
        given: scene instead of the recording's.
        file: file with fundamental matrices.

    Raises:
        InputError: no pair of the file is of two of the views.
    """
    pairs = read_epipolar(file) if file is not None else None
    notes = _check_pairs(pairs, views, file) if pairs is not None and file is not None else ()
    attached = attached_epipolar(recording) if pairs is None else None
    if given is not None and attached is not None:
        attached = _without_posed(attached, given)
    used = pairs if pairs is not None else attached
    geometry = view_geometry(views, given if given is not None else recording.scene, used)
    name = file.name if file is not None else "recording"
    sources = {}
    for (a, one), (b, other) in combinations(enumerate(views), 2):
        described = used is not None and used.find(one.name, other.name) is not None
        poses = "poses" if np.isfinite(geometry.fundamental[a, b]).all() else "none"
        sources[f"{one.name}-{other.name}"] = name if described else poses
    return KnownGeometry(geometry, sources, notes)


def _without_posed(pairs: ViewPairs, scene: Scene) -> ViewPairs:
    """Select the pairs with a camera that has no pose in the scene."""
    placed = [camera.name for camera in scene.cameras if camera.placed]
    return ViewPairs(tuple(p for p in pairs.pairs if not (p.a in placed and p.b in placed)))


def _check_pairs(pairs: ViewPairs, views: Sequence[TrackedView], file: Path) -> tuple[str, ...]:
    """Notes on pairs of the file that are not of two of the views; InputError if all are."""
    names = [view.name for view in views]
    others = [f"{p.a}-{p.b}" for p in pairs.pairs if p.a not in names or p.b not in names]
    if len(others) == len(pairs.pairs):
        raise InputError(
            f"{file}: none of its pairs ({abridged(others)}) is of two of the views used ({abridged(names)}); "
            "give matrices of these views, or none",
            id="disjoint-inputs",
        )
    return (f"{file}: not used: {', '.join(others)}; the views are {', '.join(names)}",) if others else ()
