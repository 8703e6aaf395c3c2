"""Masked values of all inputs are missing values, whatever type the input has."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import MaskedColumn, QTable
from astropy.time import Time
from astropy.utils.masked import Masked
from raising import refused, warned

import rfpsurvey as rs

N = 40
MISSING = np.arange(N) % 2 == 0
RNG = np.random.default_rng(1)
RA, DEC = (150 + RNG.uniform(-1, 1, N)) * u.deg, (30 + RNG.uniform(-1, 1, N)) * u.deg
SPEED = np.full(N, 5.0) * u.mas / u.yr
START = Time(2016.0, format="jyear")
CENTER = SkyCoord(150, 30, unit="deg")
MASKS = [np.ma.array, MaskedColumn, Masked]


def hide(values):
    return Masked(values, mask=MISSING)


def moving(motion, epoch=START):
    return SkyCoord(RA, DEC, pm_ra_cosdec=motion, pm_dec=motion, obstime=epoch)


@pytest.mark.parametrize("change", [lambda c: c, lambda c: c.galactic])
def test_targets_with_masked_proper_motions_keep_their_positions(presets, change):
    """Targets with a masked proper motion were removed from the catalog."""
    coord = moving(hide(SPEED))
    catalog, same = (rs.Catalog(change(moving(motion))) for motion in (hide(SPEED), np.where(MISSING, np.nan, SPEED)))
    assert (len(catalog), catalog.n_dropped) == (N, 0)
    moved = catalog.at_epoch(2026).coord.icrs
    shift = moved.separation(SkyCoord(RA, DEC)).mas
    assert shift[MISSING] == pytest.approx(0, abs=1e-4)
    assert shift[~MISSING] == pytest.approx(50 * np.sqrt(2), rel=1e-3)
    assert (moved.ra == same.at_epoch(2026).coord.icrs.ra).all()
    tile = rs.plan_tile(change(coord), presets["sdss_apo"], CENTER, epoch=2026.5)
    assert tile.summary["n_in_field"] == N
    assert len(rs.Catalog.from_table(QTable({"coord": coord, "id": np.arange(N)}))) == N


def test_targets_with_masked_positions_are_removed(presets):
    for coord in (
        SkyCoord(hide(RA), DEC),
        SkyCoord(x=hide(np.ones(N)), y=np.ones(N), z=np.ones(N), representation_type="cartesian"),
    ):
        catalog = warned("20 of 40 targets have no finite coordinates", rs.Catalog, coord)
        assert catalog.id.tolist() == np.flatnonzero(~MISSING).tolist()
        assert not isinstance(catalog.coord.data.lon, Masked)
    assert len(rs.Catalog(SkyCoord(RA, DEC, distance=hide(np.ones(N)) * u.pc))) == N


MASKED_EPOCHS = [
    Time(hide(np.full(N, 2016.0)), format="jyear"),
    hide(np.full(N, 2016.0) * u.yr),
    *(mask(np.full(N, 2016.0), mask=MISSING) for mask in MASKS),
]


@pytest.mark.parametrize("epoch", MASKED_EPOCHS)
def test_masked_epochs_are_not_used(epoch):
    """The values under the mask were used."""
    text = r"epoch must be a time for every target with a proper motion, but 20 of 40 rows \(rows 1, 3, 5, ...\)"
    refused(text, lambda: rs.Catalog(moving(SPEED, None), epoch=epoch))
    if isinstance(epoch, Time):
        refused(text, lambda: rs.Catalog(moving(SPEED, epoch)))
        with pytest.raises(rs.InputError, match=text):
            rs.Catalog.from_table(QTable({"ra": RA, "dec": DEC, "pmra": SPEED, "pmdec": SPEED, "epoch": epoch}))
    catalog = rs.Catalog(moving(np.where(MISSING, np.nan, SPEED), None), epoch=epoch)
    assert np.isfinite(catalog.epoch.jyear).all()
    assert catalog.at_epoch(2026).coord.separation(SkyCoord(RA, DEC)).mas[~MISSING] == pytest.approx(70.7, rel=1e-3)


def test_masked_times_are_refused(presets):
    catalog, nothing = rs.Catalog(moving(SPEED)), Time(Masked(2026.0, mask=True), format="jyear")
    for epoch in (nothing, Masked(2026.5, mask=True), np.ma.masked):
        text = "epoch must not have masked values"
        refused(text, rs.plan_tile, catalog, presets["sdss_apo"], CENTER, epoch=epoch)
    text = "time must be a date and time .*, got a masked value"
    refused(text, rs.ObservingConditions, "apache point", time=nothing)
    refused("time must not have masked values", catalog.at_epoch, Time(hide(np.full(N, 2026.0)), format="jyear"))


@pytest.mark.parametrize("mask", MASKS)
@pytest.mark.parametrize("kind", [int, float])
@pytest.mark.parametrize("name", ["priority", "visits", "id", "subpriority"])
def test_masked_numbers_are_refused(name, kind, mask):
    refused(f"{name} must be", lambda: rs.Catalog(SkyCoord(RA, DEC), **{name: mask(np.ones(N, kind), mask=MISSING)}))


@pytest.mark.parametrize("mask", MASKS)
def test_masked_text_is_empty(mask):
    text = mask(np.full(N, "sky"), mask=MISSING)
    found = rs.Catalog(SkyCoord(RA, DEC), category=text, fiber_type=text, id=text, extra={"a": text})
    for values in (found.category, found.fiber_type, found.id, found.extra["a"]):
        assert values[:2].tolist() == ["", "sky"]
    refused("kind must be science, standard or sky, .* got ''", lambda: rs.Catalog(SkyCoord(RA, DEC), kind=text))


def test_centers_without_finite_coordinates_are_refused(presets):
    """A circle with a masked center, which no arm may cover, had no effect."""
    catalog = rs.Catalog(SkyCoord(RA, DEC))
    for ra in (Masked(150 * u.deg, mask=True), np.nan * u.deg):
        center = SkyCoord(ra, 30 * u.deg)
        for use in (
            lambda c: rs.Region.cap(c, 1 * u.deg),
            lambda c: catalog.within(c, 1 * u.deg),
            lambda c: rs.plan_tile(catalog, presets["sdss_apo"], c),
        ):
            refused("center must have finite coordinates", use, center)


def test_masked_spectrographs_are_refused(presets):
    """Masked spectrographs became NaN, so that no requirement per spectrograph counted their fibers."""
    plane = presets["sdss_apo"].focal_plane
    spectrograph = np.ma.array(np.ones(len(plane), int), mask=np.arange(len(plane)) == 3)
    with pytest.raises(rs.InputError, match=r"spectrograph must be integers or text for every row, but 1 of 500 rows"):
        rs.FocalPlane(plane.xy, plane.positioner, spectrograph=spectrograph)


def test_masked_positions_on_the_focal_plane_are_not_assigned(presets):
    plane = presets["sdss_apo"].focal_plane
    xy, missing = plane.xy[:N] + 1 * u.mm, np.column_stack([MISSING, MISSING])
    plans = [
        rs.allocate(plane, values, allocator="balanced")
        for values in (Masked(xy, mask=missing), np.where(missing, np.nan, xy))
    ]
    assert plans[0].target_of_positioner.tolist() == plans[1].target_of_positioner.tolist()
    assert plans[0].n_assigned == np.count_nonzero(~MISSING)
