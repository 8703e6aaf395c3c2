"""Error messages are sentences, and errors have the types that users of astropy and of the standard library expect."""

import inspect
import pickle
import warnings
from types import SimpleNamespace

import astropy.units as u
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
from rfpsurvey import errors
from rfpsurvey._common.descriptions import Method, table_of
from rfpsurvey.errors import short, warn, warn_of_unused

ROBOT = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
PLANE = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, ROBOT)
WRONG_TYPES = [
    lambda: rs.Positioner(8.25, 8.25 * u.mm, 2.25 * u.mm),
    lambda: rs.allocate("lamost", [[0, 0]] * u.mm),
    lambda: rs.allocate(PLANE, [[0, 0]]),
    lambda: rs.plan_tile(SkyCoord([0] * u.deg, [0] * u.deg), 5, SkyCoord("0h 0d")),
    lambda: rs.plan_tile(SkyCoord([0] * u.deg, [0] * u.deg), "lamost", (0, 0)),
    lambda: rs.place_tiles(5, "lamost"),
]
WRONG_UNITS = [
    lambda: rs.Positioner(8.25 * u.s, 8.25 * u.mm, 2.25 * u.mm),
    lambda: rs.allocate(PLANE, [[0, 0]] * u.deg),
    lambda: rs.AllocationOptions(time_limit=5 * u.mm),
]


@pytest.mark.parametrize(
    ("call", "kind"), [*((call, TypeError) for call in WRONG_TYPES), *((call, u.UnitsError) for call in WRONG_UNITS)]
)
def test_wrong_types_and_units_are_type_errors_and_units_errors_too(call, kind):
    with pytest.raises(rs.InputError) as told:
        call()
    assert isinstance(told.value, kind)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: rs.plan_tile(allokator=1), "plan_tile has no parameter 'allokator'; did you mean 'allocator'?"),
        (lambda: rs.Catalog.read("a", columnz={}), "Catalog.read has no parameter 'columnz'; did you mean 'columns'?"),
        (lambda: rs.AllocationOptions(timelimit=1), "AllocationOptions has no parameter 'timelimit'; did you mean"),
        (lambda: rs.allocate(method="lamost"), "allocate has no parameter 'method'; write allocator=..."),
        (lambda: rs.design.explore_designs(l1=1), "explore_designs has no parameter 'l1'; write central_arm=..."),
        (
            lambda: rs.plan_survey(sky_separation=1),
            "plan_survey has no parameter 'sky_separation'; write allocator=All",
        ),
        (lambda: rs.Requirement(zzz=1), "Requirement has no parameter 'zzz'; its parameters are: what, minimum, "),
        (lambda: rs.plan_survey(tiling=1), "plan_survey has no parameter 'tiling'; write tiles="),
        (lambda: rs.plan_tile(tiling=1), "plan_tile has no parameter 'tiling'"),
    ],
)
def test_unknown_keywords_name_the_parameter_that_was_meant(call, message):
    with pytest.raises(TypeError) as told:
        call()
    assert str(told.value).startswith(message)
    assert isinstance(told.value, rs.InputError)


def test_functions_that_check_keywords_keep_their_signature():
    assert list(inspect.signature(rs.plan_tile).parameters)[:3] == ["catalog", "instrument", "center"]
    assert next(iter(inspect.signature(rs.AllocationOptions).parameters)) == "allocator"
    assert pickle.loads(pickle.dumps(rs.plan_tile)) is rs.plan_tile


def test_warnings_point_to_the_caller_of_the_package():
    center = SkyCoord(95 * u.deg, 23 * u.deg)
    stars = rs.Catalog(SkyCoord([95.3, 95.4] * u.deg, [23.4, 23.3] * u.deg), id=[1, 1])
    with pytest.warns(rs.RfpsurveyWarning, match="with the same id as another target") as caught:
        rs.plan_tile(stars, "sdss_apo", center)
    assert [one.filename for one in caught] == [__file__]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn("directly")
    assert caught[0].filename == __file__


def test_tables_are_never_pasted_into_errors():
    assert (short(PLANE.to_table()), short("a")) == ("a QTable of 2 rows", "'a'")
    assert "\n" not in short("a\nb" * 50)
    assert len(short("a" * 500)) < 60


def test_messages_have_one_line_without_control_characters():
    """Text of a file could bring escape sequences, line breaks and thousands of characters into a message."""
    assert str(rs.InputError("a\x1b[2J\r\n  b" + 99 * " " + "c")) == "a\\x1b[2J b c"
    text = str(rs.InputError(f"/data/a.csv must hold numbers, got {'7' * 5000}, in row 1"))
    assert text.startswith("/data/a.csv must hold numbers, got 777")
    assert text.endswith("777, in row 1")
    assert len(text) < 300
    assert short(10**5000) == "int with too many digits"
    path = "/data" + "/folder_with_a_name" * 30
    assert path in str(rs.InputError(f"{path}: there is no such file"))


OPTIONS = {"slow": ("effort", "seed"), "exact": ("effort",), "fast": (), "of a plugin": None}


@pytest.mark.parametrize(
    ("given", "chosen", "expected"),
    [
        (["effort"], ["fast"], ["effort has no effect with the method 'fast'; only slow and exact use it"]),
        (["seed"], ["exact", "fast"], ["seed has no effect with the methods 'exact' and 'fast'; only slow uses it"]),
        (["effort", "seed"], ["exact", "slow"], []),
        (["effort"], ["of a plugin", "fast"], []),
        ([], ["fast"], []),
    ],
)
def test_each_option_that_no_method_uses_causes_a_warning(given, chosen, expected):
    methods = table_of(*(Method(name, len, options) for name, options in OPTIONS.items()))
    chosen = [methods[name] for name in chosen]
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        errors.warn_of_unused(given, chosen, methods.values(), "method")
        with errors.used_elsewhere():
            errors.warn_of_unused(given, chosen, methods.values(), "method")
        with errors.used_elsewhere("effort", "seed"):
            errors.warn_of_unused(given, chosen, methods.values(), "method")
    assert [str(one.message) for one in told] == expected


def test_an_option_that_no_method_names_applies_to_all_methods():
    methods = [SimpleNamespace(name=name, options=("first",), uses=lambda _: False) for name in "ab"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_unused(["second"], methods[:1], methods, "method")
    with pytest.warns(rs.RfpsurveyWarning, match="first has no effect with the method 'a'; only a and b use it"):
        warn_of_unused(["first"], methods[:1], methods, "method")
