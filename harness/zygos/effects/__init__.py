# SPDX-License-Identifier: MIT
"""The catalogue of effects beyond rigid bodies, rotors and linear springs, and effects in a model."""

from zygos.effects.catalogue import CATALOGUE, ENTRIES, GAIN, OFFSET, Catalogue, compiled_form, laws, load_laws
from zygos.effects.effect import (
    Effect,
    EffectColumn,
    column_name,
    column_named,
    columns_at,
    effect,
    estimated,
    gains,
    is_column,
    sensed,
    spoken,
    with_gains,
)
from zygos.effects.kind import PLACES, SLOWEST_RATE, Kind, Place, smooth_sign
from zygos.effects.memory import Memory
from zygos.effects.motion import UNKNOWN, Motion

__all__ = [
    "CATALOGUE",
    "ENTRIES",
    "GAIN",
    "OFFSET",
    "PLACES",
    "SLOWEST_RATE",
    "UNKNOWN",
    "Catalogue",
    "Effect",
    "EffectColumn",
    "Kind",
    "Memory",
    "Motion",
    "Place",
    "column_name",
    "column_named",
    "columns_at",
    "compiled_form",
    "effect",
    "estimated",
    "gains",
    "is_column",
    "laws",
    "load_laws",
    "sensed",
    "smooth_sign",
    "spoken",
    "with_gains",
]
