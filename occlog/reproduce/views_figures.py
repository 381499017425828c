"""The experiments on [Qu]."""

from __future__ import annotations

from . import views_fig7, views_growth, views_loop, views_results, views_times, views_variants

EXPERIMENTS = (
    views_times.TABLE1, views_growth.TABLE2, views_results.TABLE3, views_fig7.FIG7, *views_variants.VARIANTS,
    views_loop.LOOP,
)  # fmt: skip
