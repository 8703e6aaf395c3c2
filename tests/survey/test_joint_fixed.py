"""Tiles of an earlier survey in a joint plan: their counterparts in the tiling, differences, and the cost of checks."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from astropy.time import Time

import rfpsurvey as rs
from rfpsurvey._survey.bookkeeping import Bookkeeping

MM = u.mm
CENTER = SkyCoord(10 * u.deg, 40 * u.deg)
OPTIONS = {"iterations": 1, "patch_size": 60}


@pytest.fixture(scope="module")
def instrument():
    plane = rs.FocalPlane.hexagonal(rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM), rings=2, pitch=17 * MM)
    return rs.Instrument("small", plane, plate_scale=200 * MM / u.deg)


@pytest.fixture(scope="module")
def catalog():
    rng = np.random.default_rng(5)
    sky = CENTER.spherical_offsets_by(*rng.uniform(-0.3, 0.3, (2, 130)) * u.deg)
    motion = rng.uniform(-50, 50, (2, 130)) * u.mas / u.yr
    moving = SkyCoord(sky.ra, sky.dec, pm_ra_cosdec=motion[0], pm_dec=motion[1], obstime=Time("J2016"))
    return rs.Catalog(moving, priority=rng.integers(1, 3, 130), visits=rng.integers(1, 3, 130))


def tiles_at(n, names=None, turn=0.0, shift=0.0, passes=None):
    """Return n overlapping tiles; the first m of them are always the same."""
    rng = np.random.default_rng(3)
    where = CENTER.spherical_offsets_by(*(rng.uniform(-0.12, 0.12, (8, 2)).T[:, :n] + shift) * u.deg)
    columns = {"ra": where.ra, "dec": where.dec, "position_angle": np.full(n, 20.0 + turn) * u.deg}
    columns["tile"] = np.arange(n) if names is None else names
    columns["pass"] = np.ones(n, dtype=int) if passes is None else passes
    return rs.Tiling.from_table(QTable(columns))


def plan(catalog, instrument, tiling, fixed=None, **options):
    joint = rs.JointOptions(**OPTIONS, fixed=fixed, allocator=options.pop("allocator", "optimal"))
    return rs.plan_survey(catalog, instrument, tiling, allocator=joint, **{"epoch": 2026, **options})


def rows_of(survey):
    return [np.asarray(part["target_row"]).tolist() for part in survey]


@pytest.fixture(scope="module")
def before(catalog, instrument):
    return rs.plan_survey(catalog, instrument, tiles_at(3), allocator="lamost_rule", epoch="J2026")


def test_observed_tiles_are_found_by_their_centers(catalog, instrument, before):
    """Regression: tiles were matched by identifiers only; other identifiers of the same tiles caused an IndexError."""
    everything = tiles_at(6)
    same = plan(catalog, instrument, everything, before)
    order = [4, 2, 5, 0, 1, 3]
    table = everything.table[order]
    table["tile"] = np.arange(6)
    other = plan(catalog, instrument, rs.Tiling(table), before)
    place = [order.index(k) for k in range(3)]
    found = rows_of(other)
    assert [found[k] for k in place] == rows_of(same)[:3] == rows_of(before)
    named = plan(catalog, instrument, tiles_at(6, names=[f"t{k}" for k in range(6)]), before)
    assert rows_of(named) == rows_of(same)


def test_identifiers_distinguish_tiles_at_the_same_place(catalog, instrument):
    """The same tile is planned in two passes; each tile of the earlier survey keeps its own identifier."""
    table = tiles_at(2, passes=[1, 1]).table
    table = QTable({name: np.append(table[name].value, table[name].value) for name in table.colnames})
    table["tile"], table["pass"] = ["a", "b", "c", "d"], [1, 1, 2, 2]
    tiling = rs.Tiling.from_table(table, units={"ra": "deg", "dec": "deg"})
    before = rs.plan_survey(catalog, instrument, rs.Tiling(tiling.table[[2, 3]]), allocator="lamost_rule", epoch=2026)
    found = plan(catalog, instrument, tiling, before)
    assert rows_of(found)[2:] == rows_of(before)
    renamed = tiling.table.copy()
    renamed["tile"] = ["e", "f", "g", "h"]
    found = plan(catalog, instrument, rs.Tiling(renamed), before)
    assert rows_of(found)[:2] == rows_of(before)
    with pytest.raises(rs.InputError, match=r"fixed must contain only tiles of the tiling, got tile d at "):
        plan(catalog, instrument, rs.Tiling(tiling.table[:1]), before)


def test_a_tile_without_a_counterpart_is_named(catalog, instrument, before):
    """Regression: a rotated list of tiles caused an error about an internal class; missing tiles were ignored."""
    turned = "tile 0 at .* the tile 0 of the tiling is at .* position angle 25 deg; .* other tiles .*: 2"
    for changes, message in (
        ({"turn": 5}, turned),
        ({"shift": 1e-4}, "tile 0 at .* position angle 20 deg, but the tile 0 of the tiling is at"),
        ({"turn": 5, "names": list("abcdef")}, "tile 0 at .*; add this tile to the tiling"),
    ):
        with pytest.raises(rs.InputError, match=f"fixed must contain only tiles of the tiling, got {message}"):
            plan(catalog, instrument, tiles_at(6, **changes), before)


def test_a_fixed_survey_has_the_same_options(catalog, instrument, before):
    """Regression: the collisions of the observed tiles were computed anew, for other positions of the targets."""
    circles = rs.AllocationOptions("optimal", keep_out=[rs.Region.cap(CENTER, 0.01 * u.deg)])
    for options, message in (
        ({"epoch": 2027}, "epoch '2027', got one with the epoch 'J2026'"),
        ({"epoch": None}, "epoch None, got one with the epoch 'J2026'"),
        ({"lost_in_collision": False}, "lost_in_collision False, got one with the lost_in_collision True"),
        ({"allocator": circles}, "keep_out .* got one with the keep_out"),
    ):
        with pytest.raises(rs.InputError, match=f"fixed must be a survey with the {message}"):
            plan(catalog, instrument, tiles_at(6), before, **options)


def test_a_fixed_survey_has_the_same_observing_conditions(catalog, instrument):
    table = tiles_at(4).table
    table["hour_angle"] = [1.0, 1.5, 2.0, 2.5] * u.hourangle
    conditions = rs.ObservingConditions("apache point", hour_angle=0 * u.hourangle)
    tiling = rs.Tiling(table).with_conditions(conditions)
    before = rs.plan_survey(catalog, instrument, rs.Tiling(tiling.table[:2]), allocator="lamost_rule", epoch=2026)
    assert rows_of(plan(catalog, instrument, tiling, before))[:2] == rows_of(before)
    with pytest.raises(rs.InputError, match="fixed must be a survey with the conditions None, got one with the cond"):
        plan(catalog, instrument, tiling.with_conditions(None), before)
    later = tiling.table.copy()
    later["hour_angle"] = [1.0, 3.0, 2.0, 2.5] * u.hourangle
    with pytest.raises(rs.InputError, match="must have the hour_angle of the tiling, got another value for tile 1"):
        plan(catalog, instrument, rs.Tiling(later), before)


def test_a_reordered_catalog_is_refused(catalog, instrument, before):
    """Regression: if identifiers are row numbers, a catalog in another order passed the comparison of identifiers."""
    order = np.random.default_rng(1).permutation(len(catalog))
    columns = {"priority": catalog.priority[order], "visits": catalog.visits[order], "epoch": catalog.epoch}
    again = rs.Catalog(catalog.coord[order], **columns)
    with pytest.raises(rs.InputError, match="targets of this catalog, got other targets or positions in tile 0"):
        plan(again, instrument, tiles_at(6), before)


def test_the_state_of_all_targets_is_made_once_per_stage(catalog, instrument, monkeypatch):
    """Regression: the state of all targets was made twice for every tile of the fixed survey."""
    make, calls = Bookkeeping.__init__, []

    def count(*args, **options):
        calls.append(1)
        make(*args, **options)

    def number_of_calls(n):
        before = rs.plan_survey(catalog, instrument, tiles_at(n), allocator="lamost_rule", epoch=2026)
        with monkeypatch.context() as patch:
            patch.setattr(Bookkeeping, "__init__", count)
            calls.clear()
            plan(catalog, instrument, tiles_at(8), before)
        return len(calls)

    assert number_of_calls(2) == number_of_calls(6) <= 3
