"""Trials on rendered video of people, through the same stages as a user's: simulate, track, read the tables.

[Qu] Secs. 4.2 and 4.3 have recordings that are not available.  Here people walk in a room of this project in clothes of
their own, filmed by as many cameras and in as many frames as the paper states.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from occlog.array_types import Floats
from occlog.core.metrics.mot.frame_pairs import Objects
from occlog.io.files.provenance import Provenance
from occlog.io.open import open_input
from occlog.io.recording.reader import open_recording
from occlog.pipeline.sweep.trial import Spec, Values
from occlog.records.declared.views import EVENTS, ViewTracks
from occlog.records.tables import TruthBoxes
from occlog.runner import run
from occlog.simulate.request import SimulatePeopleRequest
from occlog.simulate.run import parameters, people_setup, write_recording
from occlog.track.methods.images.interface import MODES
from occlog.track.request import ViewsRequest

from .tracker_runs import TrackerOutput
from .trial import scores, timeline

KIND = "qu-rooms"
SIZE = (320, 240)
"""Size of the images [px]."""


def rooms_spec(seed: int, methods: Mapping[str, Values], people: Values, *, fps: float, grey: bool = False) -> Spec:
    """Specification of a trial for `run_rooms_trial`.

    Args:
        seed: seed of the video and of the trackers.
        methods: by label, each with `method` and, if there are settings, `set`.
        people: fields of `PeopleConfig`.
        fps: frames a second.
        grey: whether the video has no colours.
    """
    return {
        "kind": KIND,
        "seed": seed,
        "people": dict(people),
        "methods": {label: dict(own) for label, own in methods.items()},
        "fps": fps,
        "grey": grey,
    }


def run_rooms_trial(spec: Spec) -> dict[str, float]:
    """Render a video of people, track them from their first true boxes, and score against all true boxes.

    Returns:
        Figures of each method, under its label, a dot and the name: those of `occlog.papers.qu.trial.scores`, and
            `off_0`, `off_1`, `off_end` of its `timeline`: a tracker that has ended is off its target.
    """
    seed = int(spec["seed"])
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "people.mcap"
        request = SimulatePeopleRequest(
            output=recording,
            people={"width": SIZE[0], "height": SIZE[1], **spec["people"]},
            store={"store": "ffv1", "grey": bool(spec["grey"])},
            fps=float(spec["fps"]),
            workers=1,
        )
        setup = people_setup(request)
        assert setup.render is not None
        setup = replace(setup, render=replace(setup.render, identical_targets=False))
        write_recording(setup, Provenance("simulate", parameters(setup), seed), recording, quiet=True)
        names = [camera.name for camera in setup.scene.cameras]
        truth, radius = _truth(open_recording(recording).read(TruthBoxes), names)
        out: dict[str, float] = {}
        for label, own in spec["methods"].items():
            tracks = Path(folder) / "view_tracks.parquet"
            track = ViewsRequest(
                bearings=recording,
                output=tracks,
                method=str(own["method"]),
                settings={"confirmation_frames": 0, **own.get("set", {})},
                initial_ellipses=recording,
                seed=seed,
            )
            run(track, overwrite=True, quiet=True)
            followed = _followed(open_input(tracks).read(ViewTracks), names)
            figures = scores(truth, followed, radius) | timeline(truth, followed, radius, 2)
            out |= {f"{label}.{name}": value for name, value in figures.items()}
    return out


def _truth(boxes: TruthBoxes, names: Sequence[str]) -> tuple[Objects, Floats]:
    """True boxes with their views, indices in `names`, and the radius of each box, half the root of its area [px]."""
    b = boxes.take(boxes.box >= 0)
    view = np.array([names.index(name) for name in b.sensor.tolist()], dtype=np.int64)
    box = np.column_stack([b.left_px, b.top_px, b.width_px, b.height_px])
    radius = 0.5 * np.sqrt(b.width_px * b.height_px)
    return Objects(b.frame, b.target_id.astype(np.int64), box, view), radius


def _followed(tracks: ViewTracks, names: Sequence[str]) -> TrackerOutput:
    """Rows of a table in the form of trials, without times; a view is the index of its camera in `names`."""
    t, n = tracks, len(tracks)
    modes = {name: k for k, name in enumerate(MODES)}
    return TrackerOutput(
        frame=t.frame,
        view=np.array([names.index(name) for name in t.sensor.tolist()], dtype=np.int64),
        target=t.target_id.astype(np.int64),
        ellipse=np.column_stack([t.x_px, t.y_px, t.a_px, t.b_px, t.rho]),
        mode=np.array([modes.get(mode, -1) for mode in t.likelihood_mode.tolist()], dtype=np.int64),
        counterpart=np.zeros(n, dtype=np.int64),
        event=np.array([EVENTS.index(e) for e in t.lifecycle.tolist()], dtype=np.int64),
        ess=t.ess,
        seconds=np.zeros(1),
        parts=np.zeros((0, 3)),
    )
