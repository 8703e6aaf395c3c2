"""Classes of settings: records, copies, equality, messages and help follow from the descriptions of their options."""

import copy
import json
import math
import pickle
from dataclasses import dataclass, replace
from types import NoneType

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table
from astropy.time import Time
from hypothesis import given, settings
from hypothesis import strategies as st

import rfpsurvey as rs
from rfpsurvey._common.settings import Checked, Settings, help_texts, option, options_of
from rfpsurvey._sky.conditions import SITES
from rfpsurvey._survey.key_types import Key, keys_of
from rfpsurvey.night import NightLimits

MM, DEG, S, UM = u.mm, u.deg, u.s, u.um
RULE = Table({"class": ["star", "any"], "last": ["bad", ""], "priority": [3.0, np.nan], "visits": [np.nan, 2]})


def numbers(low, high):
    return st.floats(low, high, allow_nan=False)


def lengths(low, high, *units):
    return st.builds(lambda value, unit: (value * units[0]).to(unit), numbers(low, high), st.sampled_from(units))


def choices(*names):
    return st.sampled_from(names)


SECONDS = lengths(0.1, 1e4, S, u.min, u.ms)
MARGIN = lengths(0, 10, MM, UM)
CONSTRAINTS = ("magnitude g 10 20.5", "motion fold", "keep_out 95 23 0.1", "required 'a b' 12", "sky=3-5/spectrograph")
WAVES = lengths(0.2, 2, UM, u.nm)
# valid values of options; every option of every class has one
VALUES = {
    rs.AllocationOptions: {
        "allocator": choices("repair", "optimal", "nearest", "balanced", "network_flow", "lamost_rule"),
        "requirements": choices("instrument", [], "sky=2", ["sky=20/spectrograph", "standard=1-3"]),
        "sky_separation": lengths(1, 20, u.arcsec, u.deg) | lengths(0.1, 1, MM, UM),
        "objective": choices("priority", "count"),
        "time_limit": SECONDS,
        "start": choices("lamost_rule", "nearest"),
        "parked_obstacles": st.booleans() | choices(0, np.True_),
        "required": st.lists(st.integers(0, 2**60), max_size=3) | choices(["a", "b c"], "x", 7, None),
        "keep_out": choices(None, rs.Region.parse("cap 95.1 23 0.3"), [rs.Region.parse("cap 1 2 0.01")]),
        "subpriority": st.integers(0, 2**62) | choices("SUBPRIORITY"),
        "constraints": st.lists(st.sampled_from(CONSTRAINTS), max_size=2),
        "rules": choices("dark_monit"),
        "moves": choices("ejection", "exchange"),
        "programs": st.none() | st.integers(0, 1000),
    },
    rs.JointOptions: {
        "gap": numbers(0, 0.99) | choices(0, np.float32(0.5)),
        "iterations": st.integers(0, 1000) | choices(np.int64(3)),
        "time_limit": SECONDS,
        "fixed": st.none(),
        "inform": choices(print),
        "patch_size": st.integers(10, 1000),
        "allocator": st.just("optimal"),
        "early": st.booleans(),
        "objective": choices("finished"),
        "share": st.none(),
    },
    NightLimits: {
        "min_altitude": st.none() | lengths(-90, 30, DEG),
        "max_airmass": st.none(),
        "max_altitude": lengths(30.1, 90, DEG),
        "hour_angle": lengths(0, 12, u.hourangle),
        "sun_altitude": lengths(-90, 90, DEG),
        "moon_separation": lengths(0, 180, DEG),
        "moon_illumination": numbers(0, 1),
        "moon_altitude": lengths(-90, 90, DEG),
        "horizon": choices(None, [[0, 10], [90, 20.5]], QTable({"azimuth": [1.0] * DEG, "altitude": [5.0] * DEG})),
    },
    rs.survey.VisitRule: {
        "visits": st.integers(0, 255),
        "after_success": st.integers(1, 255),
        "table": choices(RULE, RULE[:1], Table({"visits": [1, 2], "observed": [-1, 3]})),
        "function": st.none(),
        "retries": st.integers(0, 255),
    },
    rs.Margins: {
        **dict.fromkeys(("outer", "inner", "arms", "broken"), MARGIN),
        "broken_factor": numbers(0, 5),
        "hidden_factor": numbers(1, 5) | st.integers(1, 5),
    },
    rs.probability.RandomTargets: {
        "kind": choices("uniform", "poisson"),
        "number": numbers(0, 1e6) | st.integers(0, 10**6),
        "radius": lengths(1, 1e6, MM, u.m),
        "min_separation": st.none(),
    },
    rs.probability.Precision: {
        "standard_error": numbers(1e-9, 0.99),
        "max_iterations": st.integers(1, 10**6),
        "confidence": numbers(0.1, 0.99),
        "interval": choices("wilson", "bootstrap"),
        "stop": choices("interval", "convergence"),
        "estimator": choices("mean", "midpoint"),
    },
    rs.tiling.Fibers: {
        "number": st.integers(1, 10**6),
        "min_separation": lengths(1e-9, 3, u.rad, u.arcsec),
        "lost_in_collision": st.booleans(),
    },
    rs.design.LossOptions: {
        "estimand": choices("independent", "allocated"),
        "method": st.just("auto"),
        "targets_per_positioner": numbers(0.1, 1000),
        "target_density": st.none(),
        "n_skies": st.integers(2, 100),
        "time_limit": SECONDS,
    },
    rs.ObservingConditions: {
        "site": choices("paranal", "Kitt Peak"),
        "time": st.none(),
        "hour_angle": lengths(-23, 23, u.hourangle, u.deg),
        "date": st.none() | choices(Time("2025-05-01"), "2041-01-01"),
        "wavelength": st.none() | WAVES | st.dictionaries(choices("a", "b"), WAVES, min_size=1),
        "guide_wavelength": st.none() | WAVES,
        "compensator": choices("instrument", "none", "ideal"),
        "pressure": lengths(0, 1100, u.hPa, u.bar),
        "temperature": numbers(-50, 50).map(lambda value: value * u.deg_C) | choices(280 * u.K),
        "humidity": numbers(0, 1) | choices(0, 40 * u.percent),
        "exposure_time": lengths(0, 4e4, S, u.hour),
        "tolerance": lengths(0.001, 1, MM, UM),
        "scale": numbers(0.9, 1.1),
        "projection": choices("auto", "full", "radial"),
    },
}
# the values of options that records contain only in part
NEEDED = {rs.JointOptions: ("allocator", "inform")}
REQUIRED = {rs.ObservingConditions: ("site", "hour_angle")}
CLASSES = pytest.mark.parametrize("cls", VALUES, ids=lambda cls: cls.__name__)
OPTIONS = pytest.mark.parametrize(
    ("cls", "one"), [(cls, one) for cls in VALUES for one in options_of(cls)], ids=lambda x: getattr(x, "name", None)
)


@st.composite
def objects(draw, cls):
    names = [one for one in VALUES[cls] if one in REQUIRED.get(cls, ()) or draw(st.booleans())]
    return cls(**{name: draw(VALUES[cls][name]) for name in names})


def subclasses(cls):
    return {cls}.union(*map(subclasses, cls.__subclasses__()))


def test_every_class_of_settings_is_tested():
    assert subclasses(Settings) - {Settings} == {*VALUES}
    for cls, values in VALUES.items():
        assert [one.name for one in options_of(cls)] == [*values]


@CLASSES
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_records_and_copies_are_equal_to_their_object(cls, data):
    value = data.draw(objects(cls))
    record = json.loads(json.dumps(value.record))
    others = {name: getattr(value, name) for name in NEEDED.get(cls, ())}
    for same in (pickle.loads(pickle.dumps(value)), cls.from_record(record, **others)):
        assert (same, hash(same), same.record) == (value, hash(value), value.record)


def differ(value, other):
    """Whether two values of records differ by more than rounding errors of conversions of units."""
    if isinstance(value, dict) and isinstance(other, dict):
        return value.keys() != other.keys() or any(differ(value[name], other[name]) for name in value)
    if isinstance(value, float) and isinstance(other, float):
        return not math.isclose(value, other, rel_tol=1e-11)
    return value != other


@CLASSES
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_objects_with_different_records_differ(cls, data):
    value, other = data.draw(objects(cls)), data.draw(objects(cls))
    if value.record.keys() != other.record.keys() or any(map(differ, value.record.values(), other.record.values())):
        assert value != other


def test_conditions_at_every_site_and_at_a_time_follow_from_their_record():
    for site in SITES:
        for moment in ({"hour_angle": 30 * u.deg}, {"time": "2026-07-01T06:30:00"}):
            value = rs.ObservingConditions(site, **moment)
            assert rs.ObservingConditions.from_record(value.record) == value


def test_records_that_do_not_determine_an_option_are_refused():
    def visit_twice(targets):
        return {"visits": np.full(len(targets), 2)}

    cases = [
        (rs.survey.VisitRule(function=visit_twice), "function must be given as an argument of from_record"),
        (rs.AllocationOptions(visit_twice), "allocator must be given as an argument of from_record"),
        (rs.AllocationOptions(required=range(2000)), "contains all texts of a list, got 2000 in all"),
    ]
    for value, message in cases:
        with pytest.raises(rs.InputError, match=message):
            type(value).from_record(value.record)
    with pytest.raises(rs.InputError, match="start must be given as an argument of from_record"):
        rs.AllocationOptions.from_record({"start": "an allocation"})
    with pytest.raises(rs.InputError, match="fixed must be given as an argument of from_record"):
        rs.JointOptions.from_record({"fixed": "0123"})
    with pytest.raises(rs.InputError, match="a record of Precision must be a dict"):
        rs.probability.Precision.from_record("wilson")


def test_damaged_records_are_refused():
    rule, conditions = rs.survey.VisitRule, rs.ObservingConditions("paranal", hour_angle=0 * u.deg).record
    without = [{k: v for k, v in conditions.items() if k != name} for name in ("humidity", "height_m")]
    for cls, record in (
        *((rule, {"table": rows}) for rows in ([["a", 1]], 3)),
        *((rs.AllocationOptions, one) for one in ({"required": 3}, {"keep_out": [3]}, {"allocator": ["a"]})),
        *((rs.ObservingConditions, one) for one in without),
    ):
        with pytest.raises(rs.InputError):
            cls.from_record(record)
    empty = rule(table=Table({"class": np.array([], dtype=str), "visits": np.array([], dtype=int)}))
    assert rule.from_record(empty.record) == empty


def test_equal_values_in_other_units_are_equal():
    """Conversions have rounding errors: 3 ms are 0.003 s, but 0.003 is not 3 times 0.001."""
    for k in range(1, 200):
        assert rs.tiling.Fibers(min_separation=k * u.arcmin) == rs.tiling.Fibers(min_separation=60 * k * u.arcsec)
        assert rs.AllocationOptions(time_limit=k * u.ms) == rs.AllocationOptions(time_limit=k / 1000 * u.s)
    assert rs.Margins(outer=1 * u.um) != rs.Margins(outer=1.001 * u.um)
    one, other = (
        rs.ObservingConditions("paranal", hour_angle=0 * u.deg, guide_wavelength=wavelength * u.um)
        for wavelength in (0.54, 0.5400001)
    )
    assert one != other


@OPTIONS
def test_every_option_has_a_help_text(cls, one):
    assert len(help_texts(cls)[one.name]) > 20


@CLASSES
def test_keys_of_commands_are_the_options(cls):
    """Options that only Python can give, such as functions, have no keys."""
    keys = {name: key for name, key in keys_of(cls).items() if isinstance(key, Key)}
    assert {one.name for one in options_of(cls)} - {*keys} <= {"inform"}
    for name, key in keys.items():
        (field,) = [one for one in options_of(cls) if one.name == name]
        assert key.field is field
        assert key.text == help_texts(cls)[name]


WRONG = [
    np.nan,
    float("inf"),
    -7,
    10**400,
    1 + 2j,
    object(),
    b"text",
    {"a": object()},
    -3 * u.K,
    np.nan * u.mm,
    [np.nan],
]


@OPTIONS
def test_wrong_values_are_refused_with_one_sentence(cls, one):
    usual, n = {} if cls is not rs.ObservingConditions else {"site": "paranal", "hour_angle": 0 * u.deg}, 0
    for value in WRONG:
        try:
            cls(**{**usual, **({"hour_angle": None} if one.name == "time" else {}), one.name: value})
        except rs.InputError as error:
            n += 1
            text = str(error)
            assert "\n" not in text
            assert len(text) < 500
            words = {one.name, one.name[:-1], *one.named.split(), one.name.replace("_", " ")}
            assert any(word in text for word in words), text
    assert n >= 2 if {*one.kinds} - {NoneType} == {bool} else n >= 5


@dataclass(frozen=True)
class Tilt(Checked):
    angle: u.Quantity[u.deg] = option(low=0, high=90)
    offset: u.Quantity[u.mm] = option(0 * u.mm, high=2)
    name: str = option("a")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"angle": 90.1 * u.deg}, "angle must be one finite value from 0 to 90 deg, got 90.1 deg"),
        ({"angle": 2 * u.rad}, "angle must be one finite value from 0 to 90 deg, got 2.0 rad"),
        ({"angle": np.nan * u.deg}, "angle must be one finite value from 0 to 90 deg, got nan deg"),
        ({"angle": [1, 2] * u.deg}, r"angle must be one value, got the shape \(2,\)"),
        ({"offset": 3 * u.mm}, "offset must be one finite value up to 2 mm, got 3.0 mm"),
        ({"name": " "}, "name must be text, got ' '"),
        ({"name": 3}, "name must be text, got 3"),
    ],
)
def test_limits_of_quantities_and_empty_text_are_refused(options, message):
    with pytest.raises(rs.InputError, match=message):
        Tilt(**{"angle": 0 * u.deg, **options})


def test_quantities_can_equal_their_limits():
    assert (Tilt(90 * u.deg, 2 * u.mm).offset, Tilt(0 * u.rad, -5 * u.m).angle) == (2 * u.mm, 0 * u.rad)


@OPTIONS
def test_numbers_outside_the_limits_are_refused(cls, one):
    option, unit = one.option, one.units[0] if one.units else 1
    usual = {} if cls is not rs.ObservingConditions else {"site": "paranal", "hour_angle": 0 * u.deg}
    limits = ((option.above, 0), (option.below, 0), (option.low, -0.01), (option.high, 1.01))
    for limit in (limit + step for limit, step in limits if limit is not None):
        with pytest.raises(rs.InputError, match="must be"):
            cls(**{**usual, one.name: limit * unit})


CENTERS = QTable({"ra": [1, 2] * DEG, "dec": [3, 4] * DEG})
TRIANGLE = [[0, 0], [4, 0], [0, 1]]


def arms(length, **others):
    return rs.Positioner(length * MM, 8 * MM, 1 * MM, **others)


def plane(ra, **others):
    return rs.projection.TangentPlane(SkyCoord(ra, 23, unit=DEG, **others), 200 * MM / DEG)


PAIRS = {
    "Positioner": (arms(8), arms(9)),
    "Positioner with arrays": (arms(8, home=[0, 180] * DEG), arms(8, home=[1, 180] * DEG)),
    "ArmOutline": tuple(rs.positioner.ArmOutline([np.array(TRIANGLE) * k * MM]) for k in (1, 2)),
    "circle": (rs.Region.parse("cap 1 2 3"), rs.Region.parse("cap 1 2 4")),
    "box": (rs.Region.parse("box 0 10 0 10"), rs.Region.parse("box 0 10 0 11")),
    "polygon": (rs.Region.parse("polygon 0 0 10 0 10 10"), rs.Region.parse("polygon 0 0 10 0 10 11")),
    "pixels": (rs.Region.healpix([1, 2], 4), rs.Region.healpix([1, 2], 2)),
    "KeepOut": (rs.KeepOut.parse("95 23 0.1"), rs.KeepOut.parse("95 23 0.2")),
    "Required": (rs.Required([1, 2]), rs.Required([1, 3])),
    "Requirement": (rs.Requirement.parse("sky=2"), rs.Requirement.parse("sky=3")),
    "TangentPlane": (plane(95), plane(96)),
    "TangentPlane of a frame": (plane(95, frame="fk5"), plane(95, frame="fk5", equinox="J2026")),
    "RadialMap": tuple(rs.projection.RadialMap("theta", [k], max_angle=1 * DEG) for k in (1.0, 2.0)),
    "Centers": (rs.tiling.Centers(CENTERS), rs.tiling.Centers(CENTERS[:1])),
}


@pytest.mark.parametrize("name", PAIRS)
def test_settings_are_equal_to_their_copies(name):
    """Regression: objects with arrays were compared by identity, so that equal options of two processes differed."""
    value, other = PAIRS[name]
    for same in (pickle.loads(pickle.dumps(value)), copy.deepcopy(value), replace(value)):
        assert (same, hash(same)) == (value, hash(value))
    assert value != other
    assert value != "another type"


def test_a_circle_is_equal_however_it_is_given():
    parsed, made = rs.Region.parse("cap 95.5 23 0.1"), rs.Region.cap(SkyCoord(95.5, 23, unit=DEG), 0.1 * DEG)
    assert (parsed, len({parsed, made})) == (made, 1)
