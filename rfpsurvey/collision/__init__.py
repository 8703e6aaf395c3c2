"""Static collisions: the poses of arms, and the pairs of arms that are closer than the minimum separation."""

from rfpsurvey.collision._arms import Arms, check_plane, nearest_distance, place_arms
from rfpsurvey.collision._count import (
    CollisionCounts,
    count_collisions,
    count_poses,
    count_tips,
    draw_poses,
    make_setup,
    queue_segments,
)
from rfpsurvey.collision._exact_arithmetic import arms_closer_exactly, closer_exactly, distance_exactly
from rfpsurvey.collision._find import collisions_of, find_collisions, obstacle_tests, touching
from rfpsurvey.collision._methods import (
    DEFAULT_METHOD,
    METHODS,
    CollisionMethod,
    Configuration,
    Found,
    keep_closer,
    near_pairs,
)
from rfpsurvey.collision._motion import LAWS, MotionReport, find_motion, plan_moves
from rfpsurvey.collision._moves import (
    Folded,
    Turning,
    idle_moves,
    joined,
    solve_moves,
    stays_folded,
    turn_idle_arms,
    unfolding_obstacles,
)
from rfpsurvey.collision._report import CollisionReport

__all__ = [
    "DEFAULT_METHOD",
    "LAWS",
    "METHODS",
    "Arms",
    "CollisionCounts",
    "CollisionMethod",
    "CollisionReport",
    "Configuration",
    "Folded",
    "Found",
    "MotionReport",
    "Turning",
    "arms_closer_exactly",
    "check_plane",
    "closer_exactly",
    "collisions_of",
    "count_collisions",
    "count_poses",
    "count_tips",
    "distance_exactly",
    "draw_poses",
    "find_collisions",
    "find_motion",
    "idle_moves",
    "joined",
    "keep_closer",
    "make_setup",
    "near_pairs",
    "nearest_distance",
    "obstacle_tests",
    "place_arms",
    "plan_moves",
    "queue_segments",
    "solve_moves",
    "stays_folded",
    "touching",
    "turn_idle_arms",
    "unfolding_obstacles",
]
