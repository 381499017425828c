"""Update of tracks by directions of arrival: a speaker keeps the identity where no camera sees the person.

A direction is from at most one person, and a person causes at most one direction of an array at a time: the same
marginals as for boxes (Williams and Lau 2014). A sound initiates no track, and silence is no evidence against a person.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from occlog.array_types import NS
from occlog.core.geometry.camera import wrap_angle
from occlog.records.scene import MicrophoneArray

from .detector_model import gait_variance
from .filter import JipdaState
from .interface import STATE_SIZE, VX, VY, DirectionsOfArrival, X, Y
from .kernels.marginals import box_messages
from .target_set import MIN_EXISTENCE_COMPLEMENT, WALK, update

SPEECH_PROBABILITY = 0.1
"""Probability that a person speaks and is heard, at a time at which the array hears something."""
DOA_CLUTTER_RATE = 0.3
"""Expected number of false directions per array and time, uniform over azimuth."""
GATE_SIGMAS = 4.0
"""Standard deviations beyond which a direction is not a person's."""
MIN_ARRAY_DISTANCE_HEIGHTS = 0.3
"""Minimum distance from the array for a position update, in heights of people."""
MIN_PROBABILITY_HEARD = 0.5
"""Minimum probability of being heard that confirms a person's presence outside camera views."""


def update_by_directions(state: JipdaState, heard: DirectionsOfArrival, array: MicrophoneArray) -> JipdaState:
    """Return the state with all tracks updated by the azimuths that a microphone array heard between two time steps.

    Directions and people are associated by belief propagation (a direction is of at most one person). Position and
    velocity are updated, existence rises, and a person who is probably heard counts as observed at that time.

    Args:
        state: state after the last time step; not changed. The new one has the same time: the people's positions are
            extrapolated to the time of the directions for the comparison only.
        heard: directions at or after the time of the state; world azimuths and standard deviations [rad].
        array: array that heard them; people beyond its range are not associated.
    """
    people = state.people
    if not len(people.key) or not len(heard.bearing) or state.t_ns is None:
        return state
    # Predict the azimuth, its slope and its variance
    delay = max(heard.t_ns - state.t_ns, 0) / NS
    away = people.mean[:, [X, Y]] + delay * people.mean[:, [VX, VY]] - array.position[:2]
    square = np.maximum((away**2).sum(axis=1), (MIN_ARRAY_DISTANCE_HEIGHTS * state.config.person_height) ** 2)
    slope = np.zeros((len(away), STATE_SIZE))
    slope[:, X], slope[:, Y] = -away[:, 1] / square, away[:, 0] / square
    slope[:, VX], slope[:, VY] = delay * slope[:, X], delay * slope[:, Y]
    spread = np.einsum("ni,nij,nj->n", slope, people.covariance, slope)
    difference = wrap_angle(heard.bearing[None] - np.arctan2(away[:, 1], away[:, 0])[:, None])
    variance = spread[:, None] + heard.sigma[None] ** 2
    # Gate, and associate: odds that the direction is the person's against clutter
    density = np.exp(-0.5 * difference**2 / variance) / np.sqrt(2.0 * np.pi * variance)
    there = np.hypot(away[:, 0], away[:, 1]) < array.range
    odds = SPEECH_PROBABILITY / (1.0 - SPEECH_PROBABILITY) * density / (DOA_CLUTTER_RATE / (2.0 * np.pi))
    odds = np.where((difference**2 < GATE_SIGMAS**2 * variance) & there[:, None], odds, 0.0)
    r = people.existence[:, None]
    weight = r * odds / (1.0 - r + r * (1.0 - SPEECH_PROBABILITY)) * (1.0 - SPEECH_PROBABILITY)
    share = weight * box_messages(weight)
    share /= 1.0 + share.sum(axis=1, keepdims=True)
    # Update: each direction is a Gaussian factor of the state, as strong as it is probably the person's
    residual = difference + (slope * people.mean).sum(axis=1)[:, None]
    strength = share / heard.sigma[None] ** 2
    information = np.einsum("nm,ni,nj->nij", strength, slope, slope)
    vector = np.einsum("nm,ni->ni", strength * residual, slope)
    people = update(people, information, vector, gait_variance(state.edges), state.config, WALK)
    known = share.sum(axis=1)
    existence = np.clip(
        people.existence + (1.0 - people.existence) * known, MIN_EXISTENCE_COMPLEMENT, 1.0 - MIN_EXISTENCE_COMPLEMENT
    )
    seen_ns = np.where(known > MIN_PROBABILITY_HEARD, heard.t_ns, people.seen_ns)
    return replace(state, people=replace(people, existence=existence, seen_ns=seen_ns))
