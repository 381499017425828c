"""The experiments of [Lee] Ch. 3."""

from __future__ import annotations

from . import cooperation_field, cooperation_room

EXPERIMENTS = (*cooperation_field.EXPERIMENTS, *cooperation_room.EXPERIMENTS)
