"""The catalogue of effects beyond rigid bodies, rotors and linear springs, and effects in a model."""

from zygos.effects.catalogue import CATALOGUE, ENTRIES, OFFSET, Catalogue, laws, load_laws
from zygos.effects.effect import (
    Effect,
    EffectColumn,
    column_name,
    column_named,
    columns_at,
    effect,
    estimated,
    is_column,
    sensed,
    spoken,
)
from zygos.effects.kind import PLACES, SLOWEST_RATE, UNKNOWN, Kind, Motion, Place, smooth_sign

__all__ = [
    "CATALOGUE",
    "ENTRIES",
    "OFFSET",
    "PLACES",
    "SLOWEST_RATE",
    "UNKNOWN",
    "Catalogue",
    "Effect",
    "EffectColumn",
    "Kind",
    "Motion",
    "Place",
    "column_name",
    "column_named",
    "columns_at",
    "effect",
    "estimated",
    "is_column",
    "laws",
    "load_laws",
    "sensed",
    "smooth_sign",
    "spoken",
]
