"""A theta-phi positioner: its two arms, their joints, and the parts that can collide."""

from rfpsurvey.positioner._division import divide_polygon
from rfpsurvey.positioner._numbers import PositionerNumbers, within_limits
from rfpsurvey.positioner._outline import (
    ArmOutline,
    convex_hull,
    convex_polygon,
    make_outline,
    orientation,
    with_normals,
)
from rfpsurvey.positioner._positioner import ARM_MODELS, HANDEDNESS, Positioner

__all__ = [
    "ARM_MODELS",
    "HANDEDNESS",
    "ArmOutline",
    "Positioner",
    "PositionerNumbers",
    "convex_hull",
    "convex_polygon",
    "divide_polygon",
    "make_outline",
    "orientation",
    "with_normals",
    "within_limits",
]
