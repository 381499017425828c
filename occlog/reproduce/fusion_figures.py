"""The experiments of [Lee] Ch. 4."""

from __future__ import annotations

from . import fusion_cases, fusion_rates

EXPERIMENTS = (*fusion_cases.EXPERIMENTS, *fusion_rates.EXPERIMENTS)
