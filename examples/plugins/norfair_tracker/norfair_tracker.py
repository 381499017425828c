"""The tracker of norfair as a tracking method of occlog for the boxes of each camera."""

from dataclasses import dataclass

import numpy as np
from norfair import Detection, Tracker

from occlog.plugins.interface import BoxesInFrame, Settings, setting


@dataclass(frozen=True)
class NorfairSettings(Settings):
    """Settings of the tracker."""

    OWNER = "norfair"
    distance: float = setting(
        0.7, "1 - IoU up to which a box is of a track.", above=0.0, at_most=1.0, option="--distance"
    )
    remember: int = setting(25, "Frames in which a track may be without a box.", at_least=1, option="--remember")
    begin: int = setting(2, "Frames with a box after which a track begins.", at_least=0)


class NorfairTracker:
    """A Kalman filter for the corners of each box, and the nearest pairs by intersection over union."""

    summary = "norfair: Kalman filters of boxes, paired by their overlap"
    settings = NorfairSettings

    def __init__(self, settings: NorfairSettings, rng: np.random.Generator) -> None:
        self.tracker = Tracker(
            distance_function="iou",
            distance_threshold=settings.distance,
            hit_counter_max=max(settings.remember, settings.begin + 1),
            initialization_delay=settings.begin,
            past_detections_length=0,
        )
        self.frame: int | None = None

    def step(self, found: BoxesInFrame) -> np.ndarray:
        # Frames that are not there count as frames without a box
        passed = 1 if self.frame is None else max(found.frame - self.frame, 1)
        self.frame = found.frame
        corners = np.stack([found.boxes[:, :2], found.boxes[:, :2] + found.boxes[:, 2:]], axis=1)
        boxes = [Detection(points=points, data=n) for n, points in enumerate(corners)]
        ids = np.full(len(boxes), -1)
        for track in self.tracker.update(boxes, period=passed):
            if any(track.last_detection is box for box in boxes):
                ids[track.last_detection.data] = track.id
        return ids
