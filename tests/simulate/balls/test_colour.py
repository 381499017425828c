"""Colour likelihood of trackers on the video of balls: it points at the ball, as far as it is visible."""

from dataclasses import replace

import numpy as np
import pytest
from view_reference import bins_of

from occlog.simulate.balls.config import BallsConfig
from occlog.simulate.balls.video import render_balls
from occlog.track.methods.images.kernels.appearance import colour_similarity, colours_in
from occlog.track.methods.images.methods.config import MipfConfig

RING = np.array([[np.cos(t), np.sin(t)] for t in np.linspace(0, 2 * np.pi, 8, endpoint=False)])


@pytest.mark.jit
@pytest.mark.parametrize("step", [1, 2])
def test_the_likelihood_of_a_visible_ball_falls_next_to_it(step):
    frames = list(render_balls(replace(BallsConfig(), frames=40), 4))
    first = frames[0]
    whole = np.zeros(len(first.ellipses[0]), dtype=bool)
    models = [colours_in(bins_of(im), e, whole, 1) for im, e in zip(first.images, first.ellipses, strict=True)]
    better, ratio = [], []
    for frame in frames[10::5]:
        for image, ellipses, share, model in zip(frame.images, frame.ellipses, frame.share, models, strict=True):
            for k in np.flatnonzero(share == 1.0):
                moved = np.repeat(ellipses[k : k + 1], 9, axis=0)
                moved[1:, :2] += 11.0 * RING  # half a radius
                similar = colour_similarity(bins_of(image), moved, np.full(9, k), model, whole, step)
                likelihood = np.exp((similar - 1.0) / (2.0 * MipfConfig().sigma_colour ** 2))
                better.append(similar[0] > similar[1:].max())
                ratio.append(likelihood[1:].mean() / likelihood[0])
    assert len(better) > 40
    assert np.mean(better) > 0.9  # another ball may be on that side
    assert np.median(ratio) < 0.5


@pytest.mark.jit
def test_balls_look_alike_to_the_trackers():
    """That is the point of the video: the histogram of one ball suits every other one."""
    frame = next(render_balls(replace(BallsConfig(), frames=1), 4))
    e = frame.ellipses[0]
    h = colours_in(bins_of(frame.images[0]), e, np.zeros(len(e), dtype=bool), 1)
    assert (np.sqrt(h) @ np.sqrt(h).T).min() > 0.93
