"""The experiments on the example of [Rahimi] Sec. 6."""

from __future__ import annotations

from . import sparse_results, sparse_search, sparse_trust

EXPERIMENTS = (
    sparse_search.FIG3, sparse_results.FIG4, sparse_results.FIG5, sparse_trust.FALSE, sparse_trust.COVARIANCE,
)  # fmt: skip
