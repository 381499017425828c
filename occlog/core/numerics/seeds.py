"""Random number generators that do not depend on the order or the number of workers."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class RandomStream(IntEnum):
    """Purpose of random numbers (key of a stream); numbers are never reused, so that seeds keep their meaning."""

    WORLD_START = 0  # first positions and destinations
    WORLD_MOTION = 1  # one item an object
    CAMERA_NOISE = 2  # one item a camera, as for all below
    CAMERA_CHANCE = 3  # misses and false alarms
    CAMERA_CALIBRATION = 4
    ARRAY_NOISE = 5
    ARRAY_CHANCE = 6
    RENDER_SENSOR = 7  # image noise: items are (camera, frame)
    RENDER_LIGHT = 8
    RENDER_CLOTHES = 9
    PATH_NOISE = 11  # motion of scripted targets: one item a target
    SILENCE = 12  # when sources sound: one item a source
    ARRAY_FALSE = 13  # false directions: items are (array, numbers or positions)
    TRACK = 16
    PRIORS = 17  # virtual measurements of moving occluders: one item an occluder
    SELECT = 18  # selection of cameras: one item a target
    COOPERATE = 19  # cameras asked by a tracker of sounds
    SMOOTH = 20  # trajectories drawn backwards: one item a target
    READER_NOISE = 21  # of the strengths: one item a reader, as for the next two
    READER_SHADOW = 22
    READER_CHANCE = 23  # which tags are read
    STATION_NOISE = 24  # of ranges, differences and strengths: one item a station, as for the next two
    STATION_CHANCE = 25  # which are missed, false or late
    STATION_SHADOW = 26
    PLAN = 27  # what is expected of planned sensors: walks of the crowd, segments of it, detections


def generator(seed: int, stage: RandomStream, *items: int, run: int = 0) -> np.random.Generator:
    """Return a random generator for one purpose and item of one run, independent of all others with the same seed.

    Args:
        seed: seed of the command.
        stage: purpose of the random numbers.
        items: numbers of object, of sensor, or of sensor and frame.
        run: number of the Monte Carlo run.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(run, int(stage), *items)))
