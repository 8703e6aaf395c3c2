"""Static collisions: the poses of arms, and the pairs of arms that are closer than the minimum separation."""

from rfpsurvey._instruments.arms import Arms, place_arms
from rfpsurvey._instruments.collision_methods import METHODS
from rfpsurvey._instruments.count_collisions import CollisionCounts, count_collisions
from rfpsurvey._instruments.find_collisions import find_collisions
from rfpsurvey._instruments.find_paths import find_paths
from rfpsurvey._instruments.motion import LAWS, CollisionReport, MotionReport, find_motion
from rfpsurvey._instruments.path_report import PathReport
from rfpsurvey._instruments.paths import Paths

__all__ = [
    "LAWS",
    "METHODS",
    "Arms",
    "CollisionCounts",
    "CollisionReport",
    "MotionReport",
    "PathReport",
    "Paths",
    "count_collisions",
    "find_collisions",
    "find_motion",
    "find_paths",
    "place_arms",
]
