"""All arguments of all public functions refuse objects of a wrong type; messages do not contain the whole object."""

import inspect
import warnings
from decimal import Decimal

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from astropy.time import Time

import rfpsurvey as rs

MM, DEG = u.mm, u.deg
CENTER = SkyCoord(95, 23, unit="deg")
TWO = SkyCoord([95, 95.01] * DEG, [23, 23] * DEG)
ROBOT = rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM)
PLANE = rs.FocalPlane([[0, 0], [25.6, 0], [0, 25.6]] * MM, ROBOT)
SMALL = rs.Instrument("small", PLANE, plate_scale=200 * MM / DEG)
SKY = rs.Catalog(TWO)
XY = [[1, 2], [25, 1]] * MM
TABLE = QTable({"ra": [95.0, 96.0] * DEG, "dec": [23.0, 23.0] * DEG})
SCORED = QTable({"positioner": [0, 1], "x": [1.0, 25.0] * MM, "y": [0.0, 1.0] * MM})
TILING = rs.Tiling.from_table(TABLE)

EXPLORED = {"central_arm": 8 * MM, "ratio": 1, "pitch": 26 * MM, "clearance": 2 * MM}
EXPLORED["loss"] = rs.design.LossOptions(method="surrogate")

# valid arguments, of which each test replaces one
CALLS = [
    (rs.Positioner, {"central_arm": 8 * MM, "eccentric_arm": 8 * MM, "clearance": 2 * MM}),
    (rs.FocalPlane, {"xy": PLANE.xy, "positioner": ROBOT}),
    (rs.FocalPlane.hexagonal, {"positioner": ROBOT, "pitch": 25.6 * MM, "rings": 1}),
    (rs.FocalPlane.from_table, {"table": PLANE.to_table()}),
    (PLANE.reachable, {"xy": XY}),
    (PLANE.multiplicity, {"xy": XY}),
    (PLANE.coverage, {"n_points": 100}),
    (rs.Instrument, {"name": "small", "focal_plane": PLANE, "plate_scale": 200 * MM / DEG}),
    (rs.Instrument.preset, {"name": "lamost"}),
    (rs.Instrument.read, {"path": "x.toml"}),
    (SMALL.projection, {"center": CENTER}),
    (rs.projection.RadialMap, {"form": "theta", "coefficients": [1.0], "max_angle": 1 * DEG}),
    (rs.projection.TangentPlane, {"center": CENTER, "plate_scale": 200 * MM / DEG}),
    (rs.projection.TangentPlane.from_focal_length, {"center": CENTER, "focal_length": 2 * u.m}),
    (rs.Region.cap, {"center": CENTER, "radius": 1 * DEG}),
    (rs.Region.box, {"ra": (0 * DEG, 1 * DEG), "dec": (0 * DEG, 1 * DEG)}),
    (rs.Region.polygon, {"vertices": SkyCoord([0, 1, 0] * DEG, [0, 0, 1] * DEG)}),
    (rs.Region.healpix, {"pixels": [1], "nside": 1}),
    (rs.Region.cap(CENTER, 1 * DEG).contains, {"coord": TWO}),
    (rs.Catalog, {"coord": TWO}),
    (rs.Catalog.from_table, {"table": TABLE}),
    (rs.Catalog.read, {"path": "x.fits"}),
    (SKY.within, {"center": CENTER, "radius": 1 * DEG}),
    (SKY.at_epoch, {"time": 2026}),
    (rs.synthetic_catalog, {"kind": "uniform", "center": CENTER, "radius": 1 * DEG, "n_targets": 3}),
    (rs.Requirement, {"what": "sky", "minimum": 1}),
    (rs.AllocationOptions, {}),
    (rs.allocate, {"focal_plane": PLANE, "xy": XY}),
    (rs.find_collisions, {"focal_plane": PLANE, "tips": PLANE.xy}),
    (rs.collision_probability, {"instrument": PLANE}),
    (rs.probability.RandomTargets, {}),
    (rs.probability.Precision, {}),
    (rs.plan_tile, {"catalog": SKY, "instrument": SMALL, "center": CENTER}),
    (rs.score_tile, {"table": SCORED, "instrument": SMALL}),
    (rs.place_tiles, {"catalog": rs.Region.cap(CENTER, 1 * DEG), "instrument": SMALL}),
    (rs.tiling.Fibers, {}),
    (rs.Tiling.from_table, {"table": TABLE}),
    (rs.plan_survey, {"catalog": SKY, "instrument": SMALL, "tiles": TILING}),
    (rs.selection_probabilities, {"catalog": SKY, "instrument": SMALL, "tiles": TILING, "n_realizations": 1}),
    (rs.selection.potential_assignments, {"catalog": SKY, "instrument": SMALL, "tiles": TILING}),
    (rs.compare_allocators, {"catalog": SKY, "instrument": SMALL, "center": CENTER}),
    (rs.compare_instruments, {"catalog": SKY, "instruments": [SMALL], "allocators": ["nearest"]}),
    (rs.design.LossOptions, {}),
    (rs.design.explore_designs, EXPLORED),
    (rs.ObservingConditions, {"site": "paranal", "hour_angle": 1 * u.hourangle}),
    (rs.JointOptions, {}),
    (rs.Margins, {}),
    (rs.positioner.JointMotion, {}),
    (rs.survey.VisitRule, {}),
    (rs.KeepOut, {"circles": rs.Region.cap(CENTER, 1 * DEG)}),
    (rs.Required, {"ids": [1]}),
    (rs.tiling.Centers, {}),
    (PLANE.inverse, {"xy": PLANE.xy}),
    (rs.write_report, {"path": "x.html", "result": TILING}),
]

MOVING = rs.Catalog(
    SkyCoord([95] * DEG, [23] * DEG, pm_ra_cosdec=[1] * u.mas / u.yr, pm_dec=[1] * u.mas / u.yr), epoch="J2016"
)
SCORED_ON_SKY = QTable(
    {"positioner": [0], "ra": [95.0] * DEG, "dec": [23.0] * DEG}, meta={"racen": 95.0, "deccen": 23.0, "pa": 0.0}
)
SCORE = {"table": SCORED_ON_SKY, "positions": "sky"}
CLUSTERED = {"kind": "clustered", "cluster_size": 3, "cluster_scale": 0.1 * DEG}
SERVED = {"catalog": SKY, "method": "max_density"}
POISSON = {"catalog": "poisson", "n_realizations": 1}
# arguments that have no effect on the result of these calls
NOT_LOOKED_AT = {
    *(f"Catalog.read-{name}" for name in ("columns", "units", "frame", "fill", "keep", "select")),
    *("FocalPlane.reachable-fiber_type", "allocate-fiber_type"),  # the focal plane has no fiber types
}
# further arguments that are necessary for an argument to have an effect
ALSO = {
    "Positioner-arm_angle": {"arm_model": "capsule", "arm_length": 9 * MM},
    "FocalPlane.hexagonal-count": {"rings": None},
    "FocalPlane.hexagonal-vacant": {"rings": 1},
    "RadialMap-radius": {"form": "sine"},
    "synthetic_catalog-density": {"n_targets": None},
    "synthetic_catalog-min_separation": {"kind": "poisson_disc"},
    **{f"synthetic_catalog-cluster_{name}": CLUSTERED for name in ("size", "scale")},
    "explore_designs-overwrite": {"path": "x.ecsv"},
    "ObservingConditions-time": {"hour_angle": None},
    "find_collisions-theta": {"tips": None, "phi": [0, 0, 0] * DEG},
    "find_collisions-phi": {"tips": None, "theta": [0, 0, 0] * DEG},
    "collision_probability-center": {"instrument": SMALL, "targets": SKY},
    "collision_probability-density": {"method": "quadrature"},
    "collision_probability-variant": {"method": "closed_form"},
    "RandomTargets-min_separation": {"kind": "poisson_disc"},
    **{f"{name}-epoch": {"catalog": MOVING} for name in ("plan_tile", "plan_survey", "potential_assignments")},
    "selection_probabilities-epoch": {"catalog": MOVING},
    **{f"score_tile-{name}": SCORE for name in ("center", "position_angle", "equinox", "epoch")},
    **{f"compare_instruments-{name}": POISSON for name in ("targets_per_positioner", "density", "n_realizations")},
    **{f"place_tiles-{name}": SERVED for name in ("n_tiles", "completeness", "allocator", "visits", "rng")},
}


class Strange:
    """An object that is not valid anywhere, and whose text is long."""

    def __repr__(self):
        return "strange " * 200


def cases(once=()):
    """Return calls and the names of their arguments, and only one call for each of the names ``once``."""
    found, seen = [], set()
    for call, given in CALLS:
        for name, parameter in inspect.signature(call).parameters.items():
            key = f"{call.__qualname__}-{name}"
            variable = parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
            if not variable and key not in NOT_LOOKED_AT and name not in seen:
                found.append(pytest.param(call, {**given, **ALSO.get(key, {})}, name, id=key))
                seen.update({name} & {*once})
    return pytest.mark.parametrize(("call", "given", "name"), found)


@cases()
def test_an_object_of_a_wrong_type_is_a_type_error(monkeypatch, tmp_path, call, given, name):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(rs.InputTypeError) as told:
        call(**{**given, name: Strange()})
    assert len(str(told.value)) < 400


# integers that are too large for floats, a length, lists of different lengths, a number with an underscore
VALUES = [10**400, [10**400], 3 * MM, np.arange(3), [[1], [2, 3]], "1_0"]
FURTHER = [
    *(np.nan, True, b"x", "", (), {}, 1j, {1, 2}, [[]], Decimal("1.5"), np.ma.masked, Time("J2020"), MM, TWO, TABLE),
    *([] * DEG, np.ones((2, 2)), np.array(3), np.array(["a", "b"]), np.array([None, {}], dtype=object)),
    *(np.longdouble("1e4000"), 1.7e308, np.nan * MM, 3 * u.def_unit("mine"), lambda *_: None),
    *("a\0b", "\ud800", "9" * 5000),  # text with a null character, half of a pair of characters, long text
]


def refuse_or_accept(call, given, name, values):
    for value in values:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                call(**{**given, name: value})
            except rs.InputError as error:
                told = str(error)
            else:
                continue
        assert told.isprintable()
        assert len(told) < 1000


@cases()
def test_odd_values_are_accepted_or_refused_in_a_sentence(monkeypatch, tmp_path, call, given, name):
    """Regression: for such values, functions ended in errors of Python, NumPy and astropy."""
    monkeypatch.chdir(tmp_path)
    refuse_or_accept(call, given, name, VALUES)


@pytest.mark.exhaustive
@cases(once=("rng", "progress", "executor"))  # one function checks these arguments of all functions
def test_further_odd_values_are_accepted_or_refused_in_a_sentence(monkeypatch, tmp_path, call, given, name):
    monkeypatch.chdir(tmp_path)
    refuse_or_accept(call, given, name, FURTHER)


@pytest.mark.parametrize(
    "call",
    [
        lambda value: rs.plan_tile(value, SMALL, CENTER),
        lambda value: rs.plan_tile(SKY, value, CENTER),
        lambda value: rs.plan_tile(SKY, SMALL, value),
        lambda value: rs.collision_probability(value),
        lambda value: rs.AllocationOptions(value),
        lambda value: rs.AllocationOptions(start=value),
        lambda value: rs.projection.TangentPlane(value, 200 * MM / DEG),
        lambda value: rs.tiling.Fibers(value),
        lambda value: rs.place_tiles(value, SMALL),
        lambda value: rs.plan_survey(SKY, SMALL, value),
    ],
)
@pytest.mark.parametrize("kind", ["frame", "dict", "text"])
def test_no_message_pastes_what_was_given(call, kind):
    """Regression: the message contained all rows of a DataFrame that was given as a catalog."""
    rows = {name: np.arange(2000.0) for name in ("alpha", "beta")}
    value = {"frame": lambda: pytest.importorskip("pandas").DataFrame(rows), "dict": lambda: rows, "text": Strange}
    with pytest.raises(rs.InputError) as told:  # a DataFrame is a valid catalog
        call(value[kind]())
    assert kind == "frame" or isinstance(told.value, TypeError)
    assert len(str(told.value)) < 400
    assert "\n" not in str(told.value)
