"""Places of people on the floor and chains of them, without cameras."""

import numpy as np

from occlog.track.methods.jipda.association_features import feature_likelihood
from occlog.track.methods.jipda.batch.appearance import AppearanceVectors, no_sums
from occlog.track.methods.jipda.batch.mcmc_association import NO_NODE, MarkovChainState, TrackletNodes, WalkModel

WALK = WalkModel(
    drift=np.array([[0.06, 1e-3, 1e-3], [1.0, 1e-3, 1e-3], [1.0, 0.5, 0.2]]),
    often=np.zeros(3),
    prior=np.array([0.0, 0.0, 1.2, 1.2, 60.0, 70.0]),
    mean=np.array([0.0, 0.0, 0.0, 0.0, 1.7, 0.5]),
    speed=2.7,
    slack=0.6,
    reach=2,
    stay=20.0,
    hiding=np.zeros((1, 2)),
)


def places_at(moment, at, worth, observations=None, sums=None):
    """Places that a body of average size makes, with a constant that their boxes are worth, and how these look."""
    n = len(moment)
    observations = (np.zeros((n, 0)), np.zeros(n)) if observations is None else observations
    J = np.zeros((n, 6, 6))
    J[:] = np.diag([40.0, 40.0, 0.0, 0.0, 100.0, 100.0])
    state = np.column_stack([at, np.zeros((n, 2)), np.full(n, 1.7), np.full(n, 0.5)])
    h = np.einsum("nij,nj->ni", J, state)
    c = np.asarray(worth) - 0.5 * np.einsum("ni,ni->n", h, state)
    return TrackletNodes(
        step=np.asarray(moment),
        time=0.5 * np.asarray(moment),
        at=np.asarray(at, dtype=float),
        J=J,
        h=h,
        c=c,
        miss=np.full((n, 1), -0.7),
        birth=np.full(n, -3.0),
        death=np.full(n, -2.0),
        hint=np.full((n, 2), NO_NODE),
        life=np.zeros((0, 2)),
        similar=AppearanceVectors(*observations, feature_likelihood(np.zeros((2, 3)) if sums is None else sums)),
    )


def chain_with(after, used, K=0):
    n = len(after)
    before = np.full(n, NO_NODE)
    for i, j in enumerate(after):
        if j != NO_NODE:
            before[j] = i
    return MarkovChainState(
        np.array(after), before, np.array(used), np.zeros(n, dtype=np.int64), np.zeros((n, 6)), np.zeros((n, 6, 6)),
        np.zeros(n), np.zeros((n, 6, 6)), np.zeros((n, 6)), np.zeros(n), np.zeros(n, dtype=np.int64),
        np.zeros(n, dtype=np.int64), no_sums(AppearanceVectors(np.zeros((n, K)), np.zeros(n), None)),
    )  # fmt: skip
