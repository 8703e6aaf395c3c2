"""Tiles of a list observe the same targets in `place_tiles` as in `plan_survey`, for random catalogs and options."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from astropy.time import Time

import rfpsurvey as rs
from rfpsurvey.allocation import METHODS
from rfpsurvey.tiling._problem import TilingState

MM = u.mm
CENTER = SkyCoord(10 * u.deg, 40 * u.deg)
N_CASES = 3


def choose(rng, n, *values):
    """Return a column with a random value for each of n targets."""
    return rng.choice(np.array(values), n)


def make_instrument():
    """Return an instrument with fibers of two types."""
    positioner = rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM)
    types = np.resize(["A+B", "A", "A+B", "B"], 19)
    plane = rs.FocalPlane.hexagonal(positioner, rings=2, pitch=17 * MM, fiber_type=types)
    return rs.Instrument("small", plane, plate_scale=200 * MM / u.deg)


def make_tiles(rng, when):
    """Return overlapping tiles with random position angles, and with hour angles or times if ``when`` names them."""
    where = CENTER.spherical_offsets_by(*rng.uniform(-0.12, 0.12, (2, 5)) * u.deg)
    angles = rng.uniform(-180, 180, 5) * u.deg
    table = QTable({"tile": [f"t{k}" for k in range(5)], "ra": where.ra, "dec": where.dec, "position_angle": angles})
    if when == "time":
        table["time"] = [f"20{18 + k}-10-01T08:00:00" for k in rng.permutation(5)]
    tiling = rs.Tiling.from_table(table)
    if when is not None:
        tiling = tiling.with_conditions(rs.ObservingConditions("apache point", hour_angle=3 * u.hourangle))
    return tiling


def make_case(seed):
    """Return a catalog with random columns, tiles, options of the allocation, and the epoch of the survey."""
    rng = np.random.default_rng([29, seed])
    n = 150
    some = dict.fromkeys(
        ("kind", "visits", "priority", "fiber_type", "moving", "required", "needs", "blank", "circles", "subpriority")
    )
    some = {name: bool(rng.random() < 0.6) for name in some}
    where = CENTER.spherical_offsets_by(*rng.uniform(-0.35, 0.35, (2, n)) * u.deg)
    columns = {
        "kind": choose(rng, n, "science", "science", "science", "standard", "sky"),
        "visits": rng.integers(0, 3, n),
        "priority": rng.integers(0, 3, n),
        "fiber_type": choose(rng, n, "", "", "A", "B"),
        "subpriority": rng.random(n),
    }
    columns = {name: column for name, column in columns.items() if some[name]}
    if some["moving"]:
        motion = rng.uniform(-3, 3, (2, n)) * u.arcsec / u.yr
        where = SkyCoord(where.ra, where.dec, pm_ra_cosdec=motion[0], pm_dec=motion[1], obstime=Time("J2000"))
    names = np.array([f"s{k}" for k in rng.permutation(n)])
    catalog = rs.Catalog(where, id=names, extra={"first": rng.permutation(n)}, **columns)
    options = {}
    if some["required"]:
        options["required"] = rng.choice(names, 25, replace=False).tolist()
    if some["needs"]:
        options["requirements"] = ["standard=2", "sky=4"]
        if some["blank"]:
            options["sky_separation"] = 0.5 * MM
    if some["circles"]:
        options["keep_out"] = [rs.Region.cap(one, 0.01 * u.deg) for one in where[:10]]
    if (subpriority := rng.integers(3)) > 0:
        options["subpriority"] = ("first", 5)[subpriority - 1]
    when = rng.choice(np.array([None, "hour_angle", "time"]))
    return catalog, make_tiles(rng, when), options, 2026.5 if some["moving"] and when != "time" else None


def observed_by_tiling(monkeypatch, catalog, *args, **options):
    """Return the rows of the targets that each tile observes, and the tiling."""
    found, observe = [], TilingState.observe

    def record(state, *rest, **more):
        found.append(np.sort(state.problem.index.order[observe(state, *rest, **more)]).tolist())

    with monkeypatch.context() as patch:
        patch.setattr(TilingState, "observe", record)
        tiling = rs.place_tiles(catalog, *args, **options)
    return found, tiling


def observed_by_survey(catalog, *args, **options):
    """Return the rows of the science targets that each tile observes, and the survey."""
    survey = rs.plan_survey(catalog, *args, order="given", **options)
    found = []
    for visits in survey:
        rows = np.asarray(visits["target_row"][visits["observed"] & (visits["target_row"] >= 0)])
        found.append(np.sort(rows if catalog.kind is None else rows[catalog.kind[rows] == "science"]).tolist())
    return found, survey


@pytest.mark.few(6)
@pytest.mark.parametrize("first", range(0, 9, N_CASES))
@pytest.mark.parametrize("allocator", METHODS)
@pytest.mark.filterwarnings("ignore:required targets", "ignore:no target", "ignore:no tile", "ignore:requirement")
@pytest.mark.filterwarnings("ignore:constraint keep_out")
def test_a_list_of_tiles_observes_the_targets_of_a_survey(allocator, first, monkeypatch):
    """Regression: tiles of `place_tiles` did not observe required standards without a requirement, for example."""
    instrument, total = make_instrument(), 0
    for seed in range(first, first + N_CASES):
        catalog, tiles, options, epoch = make_case(seed)
        asked = rs.AllocationOptions(allocator, **options)
        lost = bool(seed % 3)
        expected, survey = observed_by_survey(
            catalog, instrument, tiles, allocator=asked, epoch=epoch, lost_in_collision=lost, rng=seed
        )
        moved = catalog if epoch is None else catalog.at_epoch(epoch)
        fibers = rs.tiling.Fibers(lost_in_collision=lost)
        given = {"method": "given", "centers": tiles, "allocator": asked, "fibers": fibers, "rng": seed}
        found, tiling = observed_by_tiling(monkeypatch, moved, instrument, **given)
        assert found == expected, seed
        assert tiling.table["n_new"].tolist() == survey.tiles["n_observed"].tolist()
        assert tiling.summary["n_requested"] == survey.summary["n_visits_requested"]
        assert tiling.summary["n_observed"] == survey.summary["n_visits_observed"]
        total += survey.summary["n_visits_observed"]
    assert total > 25 * N_CASES


@pytest.mark.few(1)
@pytest.mark.parametrize("factor", [0.6, 1.3])
def test_positioners_observe_the_field_of_the_instrument_for_every_radius_of_the_tiles(factor, monkeypatch):
    """Regression: with a smaller radius, tiles observed only the targets in this radius, unlike in a survey."""
    instrument, (catalog, tiles, *_) = make_instrument(), make_case(2)
    expected, _ = observed_by_survey(catalog, instrument, tiles, allocator="lamost_rule")
    radius = factor * instrument.field_radius
    found, _ = observed_by_tiling(
        monkeypatch, catalog, instrument, method="given", centers=tiles, allocator="lamost_rule", radius=radius
    )
    assert found == expected
    for method in ("max_density", "network_flow"):
        tiling = rs.place_tiles(catalog, instrument, method=method, n_tiles=3, allocator="lamost_rule", radius=radius)
        with pytest.warns(rs.RfpsurveyWarning, match="the tiles were placed for"):
            _, survey = observed_by_survey(catalog, instrument, tiling, allocator="lamost_rule")
        assert tiling.table["n_new"].tolist() == survey.tiles["n_observed"].tolist()


def test_centers_without_a_table_are_the_centers_of_a_survey():
    """Regression: the centers were converted to unit vectors and back, which changed the last digits."""
    centers = CENTER.spherical_offsets_by(*np.random.default_rng(1).uniform(-3, 3, (2, 50)) * u.deg)
    tiling = rs.place_tiles(rs.Region.cap(CENTER, 3 * u.deg), radius=2 * u.deg, method="given", centers=centers)
    assert tiling.table["ra"].value.tolist() == centers.ra.deg.tolist()
    assert tiling.table["dec"].value.tolist() == centers.dec.deg.tolist()
