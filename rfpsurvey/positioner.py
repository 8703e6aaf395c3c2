"""A theta-phi positioner: its two arms, their joints, and the parts that can collide."""

from rfpsurvey._instruments.joint_motion import JointMotion
from rfpsurvey._instruments.joints import PositionerNumbers
from rfpsurvey._instruments.outline import ArmOutline, divide_polygon
from rfpsurvey._instruments.positioner import Positioner

__all__ = ["ArmOutline", "JointMotion", "Positioner", "PositionerNumbers", "divide_polygon"]
