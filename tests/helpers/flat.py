"""Functions that take options as separate keywords, for tests that vary them."""

from dataclasses import fields

import rfpsurvey as rs
from rfpsurvey.probability import Precision, RandomTargets

PRECISION = {field.name for field in fields(Precision)} - {"standard_error"}
RANDOM = {"n_targets": "number", "target_radius": "radius", "min_separation": "min_separation"}
NAMES = {field.name for field in fields(rs.AllocationOptions)} - {"allocator"}


def split(allocator, options, names=NAMES):
    """Return the options of an allocation, and all other options."""
    allocator = options.pop("method", allocator)
    own = {name: options.pop(name) for name in list(options) if name in names}
    return rs.AllocationOptions(allocator, **own), options


def allocate(plane, xy, allocator="balanced", **options):
    # these options contain row numbers of targets, not identifiers
    allocator, others = split(allocator, options, NAMES - {"required", "keep_out"})
    return rs.allocate(plane, xy, allocator=allocator, **others)


def plan_tile(catalog, instrument, center, allocator="lamost_rule", **options):
    allocator, others = split(allocator, options)
    return rs.plan_tile(catalog, instrument, center, allocator=allocator, **others)


def plan_survey(catalog, instrument, tiling, allocator="lamost_rule", **options):
    allocator, others = split(allocator, options)
    return rs.plan_survey(catalog, instrument, tiling, allocator=allocator, **others)


def explore_designs(**options):
    own = {field.name: options.pop(field.name) for field in fields(rs.design.LossOptions) if field.name in options}
    return rs.design.explore_designs(loss=rs.design.LossOptions(**own), **options)


def collision_probability(focal_plane, *, allocator="balanced", precision=None, targets="uniform", **options):
    """Estimate a probability; options of targets, of the precision and of allocation are keywords."""
    if "parked_obstacles" in options:
        allocator = rs.AllocationOptions(allocator, parked_obstacles=options.pop("parked_obstacles"))
    own = {name: options.pop(name) for name in list(options) if name in PRECISION}
    random = {RANDOM[name]: options.pop(name) for name in list(options) if name in RANDOM}
    targets = RandomTargets(targets, **random) if random else targets
    return rs.collision_probability(
        focal_plane, allocator=allocator, precision=Precision(precision, **own), targets=targets, **options
    )
