"""A theta-phi positioner: its two arms, their joints, and the part that can collide."""

from rfpsurvey.positioner._numbers import PositionerNumbers
from rfpsurvey.positioner._positioner import ARM_MODELS, HANDEDNESS, Positioner

__all__ = ["ARM_MODELS", "HANDEDNESS", "Positioner", "PositionerNumbers"]
