"""Target allocation and static-collision scoring for theta-phi robotic fiber positioners.

The names below are the whole public interface; the way data flows is catalog, projection, reach, allocation,
arms, collisions, tile score.
"""

from rfpsurvey.allocation import Allocation, AllocationProblem, Requirement, allocate
from rfpsurvey.benchmark import (
    benchmark_batches,
    benchmark_collisions,
    benchmark_densities,
    benchmark_probability,
)  # fmt: skip
from rfpsurvey.catalog import Catalog, PartitionedCatalog, partition_catalog, synthetic_catalog
from rfpsurvey.collision import CollisionCounts, CollisionReport, count_collisions, find_collisions
from rfpsurvey.compare import compare_allocators, compare_instruments
from rfpsurvey.design import design_sensitivities, explore_designs
from rfpsurvey.errors import InputError, RfpsurveyWarning
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.instrument import Instrument, available_instruments
from rfpsurvey.plot import (
    plot_allocators,
    plot_collision_map,
    plot_completeness,
    plot_coverage,
    plot_designs,
    plot_focal_plane,
    plot_instruments,
    plot_probability,
    plot_probability_accuracy,
    plot_residuals,
    plot_speed_accuracy,
    plot_tiling,
)  # fmt: skip
from rfpsurvey.positioner import Positioner
from rfpsurvey.probability import (
    Estimate,
    PolynomialFit,
    ProbabilityQuestion,
    collision_probability,
    fit_polynomial,
    surrogate_probability,
)  # fmt: skip
from rfpsurvey.projection import RadialMap, TangentPlane
from rfpsurvey.region import Region
from rfpsurvey.report import write_report
from rfpsurvey.reproduction import reproduce
from rfpsurvey.survey import Survey, plan_survey
from rfpsurvey.tile import Tile, plan_tile, score_tile
from rfpsurvey.tiling import Tiling, place_tiles

try:
    from rfpsurvey._version import version as __version__
except ImportError:  # a source tree that was never built
    __version__ = "0+unknown"

__all__ = [
    "Allocation",
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
