"""A detector and a tracker of one camera of one's own for occlog."""

from dataclasses import dataclass

import cv2
import numpy as np

from occlog.plugins.interface import Detected, Settings, setting


@dataclass(frozen=True)
class BrightSettings(Settings):
    OWNER = "bright"
    threshold: int = setting(128, "Least brightness of a pixel.", at_least=1, at_most=255)
    least_px: int = setting(30, "Least pixels of a region.", at_least=1)


class BrightRegions:
    summary = "connected bright regions"
    settings = BrightSettings

    def __init__(self, settings, rng):
        self.settings_ = settings

    def detect(self, image):
        bright = np.uint8(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) >= self.settings_.threshold)
        stats = cv2.connectedComponentsWithStats(bright)[2][1:]  # the first one is the background
        stats = stats[stats[:, 4] >= self.settings_.least_px].astype(float)
        boxes = stats[:, :4] - [0.5, 0.5, 0.0, 0.0]  # edges lie half a pixel before the first centres
        return Detected(boxes, stats[:, 4] / (stats[:, 2] * stats[:, 3]))


class OverlapTracker:
    summary = "who overlaps most with a box of the frame before is the same"
    settings = Settings

    def __init__(self, settings, rng):
        self.boxes, self.ids, self.next = np.zeros((0, 4)), np.zeros(0, int), 0

    def step(self, found):
        near = np.minimum(found.boxes[:, None, :2] + found.boxes[:, None, 2:], self.boxes[:, :2] + self.boxes[:, 2:])
        sides = np.maximum(near - np.maximum(found.boxes[:, None, :2], self.boxes[:, :2]), 0.0)
        shared, ids = sides.prod(axis=2), np.full(len(found.boxes), -1)
        while shared.size and shared.max() > 0:
            new, old = np.unravel_index(shared.argmax(), shared.shape)
            ids[new], shared[new], shared[:, old] = self.ids[old], 0.0, 0.0
        for new in np.flatnonzero(ids < 0):
            ids[new], self.next = self.next, self.next + 1
        self.boxes, self.ids = found.boxes.copy(), ids
        return ids.copy()
