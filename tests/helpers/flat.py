"""Functions that take the options of an allocation as plain keywords, for tests that vary them."""

from dataclasses import fields

import rfpsurvey as rs

NAMES = {field.name for field in fields(rs.AllocationOptions)} - {"allocator"}


def split(allocator, options):
    """Return the options of an allocation, and the other ones."""
    allocator = options.pop("method", allocator)
    own = {name: options.pop(name) for name in list(options) if name in NAMES}
    return rs.AllocationOptions(allocator, **own), options


def allocate(plane, xy, allocator="balanced", **options):
    allocator, others = split(allocator, options)
    return rs.allocate(plane, xy, allocator=allocator, **others)


def plan_tile(catalog, instrument, center, allocator="lamost", **options):
    allocator, others = split(allocator, options)
    return rs.plan_tile(catalog, instrument, center, allocator=allocator, **others)


def plan_survey(catalog, instrument, tiling, allocator="lamost", **options):
    allocator, others = split(allocator, options)
    return rs.plan_survey(catalog, instrument, tiling, allocator=allocator, **others)
