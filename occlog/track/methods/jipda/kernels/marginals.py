"""Marginals of the joint data association by loopy belief propagation (Williams and Lau 2014).

A person is detected with at most one box of a frame, and a box is of at most one person.  The messages between people
and boxes are Eqs. 30 and 31 of "Approximate evaluation of marginal association probabilities with belief
propagation", IEEE T-AES 50(4), with the weights of people who may not exist (Musicki and Evans 2004).  They converge
always, and are exact where the graph of people and gated boxes is a tree.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel

MAX_ITERATIONS = 200
CONVERGED = 1e-5


@kernel
def box_messages(weight: Floats) -> Floats:
    """Return messages (N, M) from boxes to people (Williams and Lau 2014, Eq. 31): 0 (taken) to 1 (free).

    The iteration ends at changes below `CONVERGED`, at the latest after `MAX_ITERATIONS`.

    Args:
        weight: (N, M) odds that person i made box j against that i made none and j is of no person; 0: outside the
            gate.
    """
    N, M = weight.shape
    nu = np.ones((N, M))
    mu = np.zeros((N, M))
    for _ in range(MAX_ITERATIONS):
        # From people to boxes: mu_ij = w_ij / (1 + sum_{k != j} w_ik nu_ik)
        for i in range(N):
            total = 1.0
            for j in range(M):
                total += weight[i, j] * nu[i, j]
            for j in range(M):
                if weight[i, j] > 0.0:
                    mu[i, j] = weight[i, j] / max(total - weight[i, j] * nu[i, j], 1.0)
        # From boxes to people: nu_ij = 1 / (1 + sum_{k != i} mu_kj)
        change = 0.0
        for j in range(M):
            total = 1.0
            for i in range(N):
                total += mu[i, j]
            for i in range(N):
                if weight[i, j] > 0.0:
                    new = 1.0 / max(total - mu[i, j], 1.0)
                    change = max(change, abs(new - nu[i, j]))
                    nu[i, j] = new
        if change < CONVERGED:
            break
    return nu
