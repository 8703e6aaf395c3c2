"""Target allocation and static-collision scoring for theta-phi robotic fiber positioners.

The public interface consists of the names in ``__all__`` and of the public names of the subpackages that ``dir`` lists.
From a catalog, the package computes the positions of the targets on the focal plane, the targets in reach of each
positioner, the allocation, the poses of the arms, the collisions, and the score of a tile, in this order.
"""

from rfpsurvey._common.lazy import importer

# these imports are for type checkers and editors, which replace False by True
TYPE_CHECKING = False
if TYPE_CHECKING:
    from rfpsurvey import (
        allocation,
        benchmark,
        catalog,
        collision,
        compare,
        constraints,
        design,
        errors,
        focal_plane,
        instrument,
        night,
        observing,
        plans,
        plot,
        positioner,
        probability,
        projection,
        region,
        report,
        selection,
        survey,
        tile,
        tiling,
    )
    from rfpsurvey.allocation import AllocationOptions, allocate
    from rfpsurvey.catalog import Catalog, example_catalog, synthetic_catalog
    from rfpsurvey.collision import find_collisions
    from rfpsurvey.compare import compare_allocators, compare_instruments
    from rfpsurvey.constraints import KeepOut, Required, Requirement
    from rfpsurvey.errors import InputError, InputTypeError, InputUnitsError, RfpsurveyWarning
    from rfpsurvey.focal_plane import FocalPlane, Margins
    from rfpsurvey.instrument import Instrument, available_instruments
    from rfpsurvey.observing import ObservingConditions
    from rfpsurvey.positioner import Positioner
    from rfpsurvey.probability import collision_probability
    from rfpsurvey.region import Region
    from rfpsurvey.report import write_report
    from rfpsurvey.selection import SelectionProbabilities, selection_probabilities
    from rfpsurvey.survey import JointOptions, Survey, plan_survey
    from rfpsurvey.tile import Tile, plan_tile, score_tile
    from rfpsurvey.tiling import Tiling, place_tiles

try:
    from rfpsurvey._version import version as __version__
except ImportError:  # the source tree has not been built
    __version__ = "0+unknown"

__all__ = [
    "AllocationOptions",
    "Catalog",
    "FocalPlane",
    "InputError",
    "InputTypeError",
    "InputUnitsError",
    "Instrument",
    "JointOptions",
    "KeepOut",
    "Margins",
    "ObservingConditions",
    "Positioner",
    "Region",
    "Required",
    "Requirement",
    "RfpsurveyWarning",
    "SelectionProbabilities",
    "Survey",
    "Tile",
    "Tiling",
    "__version__",
    "allocate",
    "available_instruments",
    "collision_probability",
    "compare_allocators",
    "compare_instruments",
    "example_catalog",
    "find_collisions",
    "place_tiles",
    "plan_survey",
    "plan_tile",
    "score_tile",
    "selection_probabilities",
    "synthetic_catalog",
    "write_report",
]

_IMPORTED_ON_USE = {
    "allocation": ("AllocationOptions", "allocate"),
    "benchmark": (),
    "catalog": ("Catalog", "example_catalog", "synthetic_catalog"),
    "collision": ("find_collisions",),
    "compare": ("compare_allocators", "compare_instruments"),
    "constraints": ("KeepOut", "Required", "Requirement"),
    "design": (),
    "errors": ("InputError", "InputTypeError", "InputUnitsError", "RfpsurveyWarning"),
    "focal_plane": ("FocalPlane", "Margins"),
    "instrument": ("Instrument", "available_instruments"),
    "night": (),
    "observing": ("ObservingConditions",),
    "plans": (),
    "plot": (),
    "positioner": ("Positioner",),
    "probability": ("collision_probability",),
    "projection": (),
    "region": ("Region",),
    "report": ("write_report",),
    "selection": ("SelectionProbabilities", "selection_probabilities"),
    "survey": ("JointOptions", "Survey", "plan_survey"),
    "tile": ("Tile", "plan_tile", "score_tile"),
    "tiling": ("Tiling", "place_tiles"),
}
__getattr__ = importer(__name__, _IMPORTED_ON_USE)


def __dir__():
    # All other subpackages only contain the implementation of public names, and are therefore not listed.
    public = {
        "allocation",
        "benchmark",
        "collision",
        "constraints",
        "design",
        "night",
        "observing",
        "plans",
        "plot",
        "probability",
    }
    return sorted({*__all__, *public, "tiling"})
