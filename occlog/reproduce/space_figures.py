"""The experiments on [Lee] Ch. 2."""

from __future__ import annotations

from . import space_scenarios, space_tables, space_variances

EXPERIMENTS = (
    space_variances.VARIANCES, *space_tables.TABLES, *space_scenarios.SCENARIOS, space_scenarios.SENSORS,
    space_scenarios.COUNTED,
)  # fmt: skip
