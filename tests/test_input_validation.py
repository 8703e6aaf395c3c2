"""Public functions refuse invalid input with a sentence that states what is required and what was given."""

from dataclasses import replace
from functools import partial

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import MaskedColumn, QTable, Table
from astropy.time import Time

import rfpsurvey as rs
from rfpsurvey.collision import place_arms
from scenes import few

MM, DEG = u.mm, u.deg
CENTER = SkyCoord(95, 23, unit="deg")
TWO = SkyCoord([95, 96] * DEG, [23, 23] * DEG)
CIRCLE, TRIANGLE = rs.Region.parse("cap 1 2 0.5"), rs.Region.parse("polygon 1 1 2 1 2 2")
ROBOT = rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM)
PLANE = rs.FocalPlane([[0, 0], [25.6, 0], [0, 25.6]] * MM, ROBOT)
TYPED = replace(PLANE, fiber_type=["A", "B", "A+B"])
XY = [[1, 2], [25, 1]] * MM
PLAN = rs.allocate(PLANE, XY, allocator="balanced")
SCALE = {"plate_scale": 200 * MM / DEG}
SMALL = rs.Instrument("small", PLANE, **SCALE)
TABLE = QTable({"ra": [10.0, 20.0] * DEG, "dec": [1.0, 2.0] * DEG})
GRID = SkyCoord([[1, 2]], [[1, 2]], unit="deg")
options, tiling, uniform = rs.AllocationOptions, rs.Tiling.from_table, partial(rs.synthetic_catalog, "uniform", CENTER)
plane, plan, tips = partial(replace, PLANE), partial(rs.plan_tile, few(), SMALL, CENTER), PLANE.xy
allocate, find, coordinates = partial(rs.allocate, PLANE, XY), partial(rs.find_collisions, PLANE), rs.Catalog.from_table


def required(ids):
    return options(required=ids)


def plane_with(**positioner):
    table = PLANE.to_table()
    table.meta["positioner"] = {**table.meta["positioner"], **positioner}
    return rs.FocalPlane.from_table(table)


def speed():
    columns = {"method": ["exact"], "n_points": [0], "time": [1] * u.ms, "n_colliding_true": [1]}
    return QTable({**columns, "misclassified": [0], "max_error": [0] * MM})


CALLS = {
    "focal_length must be one finite value above 0 mm, got nan mm": lambda: (
        rs.projection.TangentPlane.from_focal_length(CENTER, np.nan * MM)
    ),
    "position_angle must be one finite value above -3600 deg and below 3600 deg, got nan deg": lambda: SMALL.projection(
        CENTER, np.nan * DEG
    ),
    "rng must be a seed from 0 to 2^128 - 1, a numpy Generator or None, got -1": lambda: rs.place_tiles(
        CIRCLE, "moons", rng=-1
    ),
    "rng must be a seed from 0 to 2^128 - 1, a numpy Generator or None, got 'x'": lambda: plan(rng="x"),
    "fixed must be a Survey or the path of its folder, got 3": lambda: rs.JointOptions(fixed=3),
    "the allocator must be a name or a function, got the class AllocationOptions": lambda: options(options),
    "the method of collision probability must be a name or a function, got the class Precision": lambda: (
        rs.collision_probability(PLANE, method=rs.probability.Precision)
    ),
    "of a Generator that returns such a Quantity, got the class RandomTargets": lambda: rs.collision_probability(
        PLANE, targets=rs.probability.RandomTargets
    ),
    "coord must have the shape (n,), got (1, 2)": lambda: rs.Catalog(GRID),
    "coord must have the shape ": lambda: SMALL.projection(CENTER).to_focal_plane(GRID),
    "epoch must be one time or have the shape (2,), got (3,)": lambda: rs.Catalog(
        TWO, epoch=Time([2000, 2001, 2002], format="jyear")
    ),
    "id must be integers or text for every row, but 1 of 2 rows (row 2) have none": lambda: rs.Catalog(
        TWO, id=MaskedColumn([1, 2], mask=[False, True])
    ),
    "columns must be a dict from role to column, got ['ra']": lambda: coordinates(TABLE, columns=["ra"]),
    "the value of columns for ra must be the name of a column, got 3": lambda: coordinates(TABLE, columns={"ra": 3}),
    "table must be an astropy Table, a QTable or a DataFrame, got {'ra': [1], 'dec': [1]}": lambda: coordinates(
        {"ra": [1], "dec": [1]}
    ),
    "must lie between -360 and 360 deg, got 400.0 deg": lambda: coordinates(
        QTable({"ra": [400.0] * DEG, "dec": [1.0] * DEG})
    ),
    "cluster_size must be from 0.001 to 1e+09, got 0": lambda: rs.synthetic_catalog(
        "clustered", CENTER, 1 * DEG, density=1 / DEG**2, cluster_size=0, cluster_scale=0.1 * DEG
    ),
    "the number of targets must be a single": lambda: uniform(1 * DEG, n_targets="ten"),
    "radius must be one value": lambda: uniform([1, 2] * DEG, n_targets=1),
    "from 0 to 1e+09": lambda: uniform(1 * DEG, n_targets=1e30),
    "radius must be one finite value of at least 0 rad": lambda: few().within(CENTER, -1 * DEG),
    "a Julian year from 1700 to 2300": lambda: few().at_epoch(57388),
    "positioner must be a Positioner, got int": lambda: rs.FocalPlane(XY, 3),
    "fiber_type must have at most 62 types, got 63": lambda: rs.FocalPlane(
        np.arange(126.0).reshape(63, 2) * 50 * MM, ROBOT, fiber_type=[f"t{k}" for k in range(63)]
    ),
    "id must be unique, but 'a' occurs more than once": lambda: plane(id=["a", "b", "a"]),
    "id must have one value per positioner": lambda: plane(id=3),
    "stuck must contain both theta": lambda: plane(stuck=np.full((3, 2), [30, np.nan]) * DEG),
    "obstacles must have rows": lambda: plane(obstacles=[[np.nan, 0, 1]] * MM),
    "radius must": lambda: rs.FocalPlane.hexagonal(ROBOT, radius=np.nan * MM, pitch=8 * MM),
    "n_points must be so large that at least one point is in the footprint, got 1": lambda: rs.FocalPlane(
        [[0, 0], [100, 0], [0, 100], [1, 1]] * MM, ROBOT
    ).coverage(n_points=1, rng=1),
    "fiber_type must have the shape (2,), got (1,)": lambda: TYPED.reachable(XY, ["A"]),
    "fiber_type must be one of A, B or empty, got C": lambda: TYPED.reachable(XY, ["A", "C"]),
    "table must be an astropy Table or QTable, got list": lambda: rs.FocalPlane.from_table([]),
    "the positioner in the table's meta has unknown entries: color": lambda: plane_with(color=1),
    "the positioner in the table's meta cannot be read:": lambda: plane_with(clearance="far"),
    "focal_plane must be a FocalPlane, got str": lambda: rs.Instrument("a", "b", plate_scale=1 * MM / DEG),
    "targets_per_fiber must be a positive number, got 0": lambda: replace(SMALL, targets_per_fiber=0),
    "factor must be a number, got [[1], 'x']": lambda: rs.projection.RadialMap(
        "theta", [1.0], max_angle=1 * DEG, factor=[[1], "x"]
    ),
    "the vertices of a polygon must be finite": lambda: rs.Region.polygon(
        SkyCoord([0, 1, np.nan] * DEG, [0, 1, 0] * DEG)
    ),
    "handedness must be one name or have the shape (3,), got (1,)": lambda: find(tips, handedness=["left"]),
    "handedness can be given only with tips": lambda: place_arms(
        PLANE, theta=[0, 0, 0] * DEG, phi=[0, 0, 0] * DEG, handedness="left"
    ),
    "fiber_type must have the shape (3,), got (2,)": lambda: rs.find_collisions(TYPED, tips, fiber_type=["A", "B"]),
    "unknown fiber type 'A': the positioners have no fiber types": lambda: find(tips, fiber_type=["", "A", ""]),
    "an Allocation or Arms already determines the poses": lambda: find(PLAN, handedness="left"),
    "either tips, or both": lambda: find(tips, theta=np.zeros(3) * DEG),
    "the arms must belong to the 3 positioners of the focal plane, got the arms of 1": lambda: find(
        place_arms(rs.FocalPlane([[0, 0]] * MM, ROBOT), [[1, 0]] * MM)
    ),
    "got Instrument; use the attribute focal_plane": lambda: PLAN.place_arms(SMALL),
    "priority must be numbers: ": lambda: allocate(priority=["high", "low"]),
    "priority must be numbers": lambda: few(2, priority=["a", "b"]),
    "required must hold numbers or text, got": lambda: allocate(required=[object(), {}]),
    "required must contain ids of targets (integers or text), got booleans": lambda: required([True, False]),
    "required must be a one-dimensional list of target ids, got the shape (1, 2)": lambda: required([[1, 2]]),
    "required must be integers or text for every row, got numbers such as 1.5": lambda: required(1.5),
    "ids of required targets can be used only with a catalog, got 4, 5 (2 in all); use plan_tile": lambda: allocate(
        allocator=required([4, 5])
    ),
    "keep_out can be used only with positions on the sky, got 1 circles; use plan_tile": lambda: allocate(
        allocator=options(keep_out=CIRCLE)
    ),
    "required must hold ids of the catalog, got 7 (1 of 2 unknown)": lambda: rs.plan_tile(
        rs.Catalog(TWO), "moons", CENTER, allocator=required(["1", "7"])
    ),
    "required must hold ids of the catalog, got 01 (1 of 1 unknown)": lambda: rs.plan_survey(
        rs.Catalog(TWO), "moons", TWO, allocator=required("01")
    ),
    "required must hold ids of the catalog, got star (1 of 1 unknown)": lambda: rs.place_tiles(
        rs.Catalog(TWO), "moons", method="max_density", allocator=required("star")
    ),
    "required targets can be used only with a catalog, got synthetic targets of the kind 'poisson'": lambda: (
        rs.compare_instruments("poisson", ["moons"], options=required(3))
    ),
    "allocator must have no required targets and no other constraints": lambda: rs.collision_probability(
        PLANE, allocator=options(keep_out=[CIRCLE])
    ),
    "keep_out must be one or more circles made by Region.cap, got dict": lambda: options(keep_out={}),
    "keep_out must be one or more circles made by Region.cap, got <Region polygon": lambda: options(
        keep_out=[CIRCLE, TRIANGLE]
    ),
    "forbidden must be pairs (positioner, target) of row numbers, got [[0], [1, 2]]": lambda: allocate(
        forbidden=[[0], [1, 2]]
    ),
    "fiber_type of 'sky' must be a name, got 3": lambda: rs.Requirement("sky", 1, fiber_type=3),
    "the allocators to compare must be given as allocators=, got the argument allocator": lambda: rs.compare_allocators(
        rs.Catalog(TWO), "moons", CENTER, allocator="lamost_rule"
    ),
    "axes must be two Axes, got 1": lambda: rs.plot.plot_speed_accuracy(speed(), axes=[None]),
    "table must be a QTable, got Table": lambda: rs.Tiling(Table()),
    "table must be an astropy Table, a QTable or a DataFrame, got 3": lambda: tiling(3),
    "units must be a dict from role to unit, got 'deg'": lambda: tiling(TABLE, units="deg"),
    "columns must be a dict from role to column, got 'ra'": lambda: tiling(TABLE, columns="ra"),
    "pass must be a whole number for every tile, got text such as 'first'": lambda: tiling(
        QTable({**TABLE, "pass": ["first", "second"]})
    ),
    "table must be a QTable, got dict": lambda: rs.Tile({}),
    "the table does not describe a tile: it lacks ": lambda: rs.Tile(QTable({"id": [1]})),
    "center must be one direction, got the shape (2,)": lambda: rs.plan_tile(rs.Catalog(TWO), "moons", TWO),
    "instrument must be an Instrument, the name of a preset or the path of a TOML file, got 5": lambda: rs.plan_tile(
        few(), 5, CENTER
    ),
    "position_angle must be one value": lambda: plan(position_angle=[1, 2] * DEG),
    "position_angle must be one finite": lambda: plan(position_angle=np.nan * DEG),
    "the survey has no tile nine; its tiles have names such as ": lambda: rs.plan_survey(
        rs.Catalog(TWO), SMALL, CENTER
    ).tile("nine"),
}


@pytest.mark.parametrize("message", CALLS)
def test_a_wrong_argument_is_a_sentence(message):
    """Regression: such input raised exceptions of other packages, or gave wrong results."""
    with pytest.raises(rs.InputError) as caught:
        CALLS[message]()
    assert message in str(caught.value)


def test_a_wrong_path_is_a_sentence(tmp_path):
    catalog = rs.Catalog(TWO)
    (tmp_path / "here.fits").mkdir()
    for call, message in (
        (lambda: rs.Catalog.read(3), "a path must be text or a Path object, got 3"),
        (lambda: catalog.write(tmp_path / "here.fits"), "is a folder; an output must be a file"),
        (lambda: rs.catalog.partition_catalog(catalog, tmp_path / "no" / "stars"), "no does not exist"),
        (lambda: rs.Survey.read(tmp_path), "does not hold a survey: there is no survey.json"),
    ):
        with pytest.raises(rs.InputError) as caught:
            call()
        assert message in str(caught.value)


def test_fiber_types_that_fits_cannot_hold_are_named(tmp_path):
    """Regression: the error message asked for other target identifiers."""
    instrument = rs.Instrument("small", plane(fiber_type=["Ä"] * 3), **SCALE)
    with pytest.raises(rs.InputError, match="only ASCII text, but the column 'fiber_type' has other"):
        rs.plan_survey(rs.Catalog(TWO), instrument, CENTER, folder=tmp_path / "survey")
