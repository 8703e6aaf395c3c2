"""Target allocation and static-collision scoring for theta-phi robotic fiber positioners.

The names below are the whole public interface; the way data flows is catalog, projection, reach, allocation,
arms, collisions, tile score.
"""

from importlib import import_module

from rfpsurvey.allocation import (
    Allocation,
    AllocationAnswer,
    AllocationOptions,
    AllocationProblem,
    Requirement,
    allocate,
)
from rfpsurvey.catalog import Catalog, PartitionedCatalog, partition_catalog, synthetic_catalog
from rfpsurvey.collision import CollisionCounts, CollisionReport, count_collisions, find_collisions
from rfpsurvey.errors import InputError, RfpsurveyWarning
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.instrument import Instrument, available_instruments
from rfpsurvey.positioner import Positioner
from rfpsurvey.projection import RadialMap, TangentPlane
from rfpsurvey.region import Region
from rfpsurvey.tile import Tile, plan_tile, score_tile

try:
    from rfpsurvey._version import version as __version__
except ImportError:  # a source tree that was never built
    __version__ = "0+unknown"

__all__ = [
    "Allocation",
    "AllocationAnswer",
    "AllocationOptions",
    "AllocationProblem",
    "Catalog",
    "CollisionCounts",
    "CollisionReport",
    "Estimate",
    "FocalPlane",
    "InputError",
    "Instrument",
    "PartitionedCatalog",
    "PolynomialFit",
    "Positioner",
    "ProbabilityQuestion",
    "RadialMap",
    "Region",
    "Requirement",
    "RfpsurveyWarning",
    "Survey",
    "TangentPlane",
    "Tile",
    "Tiling",
    "__version__",
    "allocate",
    "available_instruments",
    "benchmark_batches",
    "benchmark_collisions",
    "benchmark_densities",
    "benchmark_probability",
    "collision_probability",
    "compare_allocators",
    "compare_instruments",
    "count_collisions",
    "design_sensitivities",
    "explore_designs",
    "find_collisions",
    "fit_polynomial",
    "partition_catalog",
    "place_tiles",
    "plan_survey",
    "plan_tile",
    "plot_allocators",
    "plot_collision_map",
    "plot_completeness",
    "plot_coverage",
    "plot_designs",
    "plot_focal_plane",
    "plot_instruments",
    "plot_probability",
    "plot_probability_accuracy",
    "plot_residuals",
    "plot_speed_accuracy",
    "plot_tiling",
    "reproduce",
    "score_tile",
    "surrogate_probability",
    "synthetic_catalog",
    "write_report",
]

_IMPORTED_ON_USE = {  # a script that plans a tile does not wait for these packages
    "benchmark": ("benchmark_batches", "benchmark_collisions", "benchmark_densities", "benchmark_probability"),
    "compare": ("compare_allocators", "compare_instruments"),
    "design": ("design_sensitivities", "explore_designs"),
    "plot": (
        "plot_allocators",
        "plot_collision_map",
        "plot_completeness",
        "plot_coverage",
        "plot_designs",
        "plot_focal_plane",
        "plot_instruments",
        "plot_probability",
        "plot_probability_accuracy",
        "plot_residuals",
        "plot_speed_accuracy",
        "plot_tiling",
    ),
    "probability": (
        "Estimate",
        "PolynomialFit",
        "ProbabilityQuestion",
        "collision_probability",
        "fit_polynomial",
        "surrogate_probability",
    ),
    "report": ("write_report",),
    "reproduction": ("reproduce",),
    "survey": ("Survey", "plan_survey"),
    "tiling": ("Tiling", "place_tiles"),
}


def __getattr__(name):
    for package, names in _IMPORTED_ON_USE.items():
        if name == package:
            return import_module(f"rfpsurvey.{package}")
        if name in names:
            value = globals()[name] = getattr(import_module(f"rfpsurvey.{package}"), name)
            return value
    raise AttributeError(f"module 'rfpsurvey' has no attribute {name!r}")


def __dir__():
    return sorted({*globals(), *__all__, *_IMPORTED_ON_USE})
