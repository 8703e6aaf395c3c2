"""The plot and the report of selection probabilities."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
from pages import Reader, full

CENTER = SkyCoord(95, 23, unit="deg")


@pytest.fixture(scope="module")
def found(small):
    sky = rs.synthetic_catalog("poisson", CENTER, 0.8 * u.deg, density=600 / u.deg**2, rng=3)
    visits = np.ones(len(sky), dtype=int)
    visits[:5] = 0
    catalog = rs.Catalog(sky.coord, visits=visits)
    tiles = SkyCoord([94.9, 95.1, 95.0] * u.deg, [23, 23, 23.1] * u.deg)
    return rs.selection_probabilities(catalog, small, tiles, 40, allocator="nearest", rng=2)


def test_the_bars_contain_the_requested_targets_in_reach(found):
    ax = rs.plot.plot_selection(found)
    used = (found.requested > 0) & ~found.unreachable
    heights = np.zeros(20)
    for bar in ax.patches:
        heights[round(bar.get_x() * 20)] += bar.get_height()
    expected = np.histogram(found.probability[used], np.arange(21) / 20)[0]
    np.testing.assert_array_equal(heights, expected)
    assert f"{found.summary['n_always_observed']} always observed" in ax.get_title()
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == [f"{n} tile{'s' * (n > 1)}: {(found.n_tiles[used] == n).sum()}" for n in (1, 2, 3)]


def test_the_page_shows_the_probabilities_of_the_table(found, tmp_path):
    rs.write_report(found, tmp_path / "page.html", data="selection.fits")
    page = Reader((tmp_path / "page.html").read_text())
    assert page.facts()["targets with requested visits"] == str(found.summary["n_targets"])
    names, rows = page.table("Targets in the order")
    k = names.index("probability")
    assert len(rows) == min(len(found), 1000)
    np.testing.assert_allclose([full(row[k]) for row in rows], found.probability[: len(rows)], rtol=1e-6)
    assert len(page.table("Realizations.")[1]) == 40


def test_other_objects_are_refused():
    with pytest.raises(rs.InputTypeError, match="found must be SelectionProbabilities, got int"):
        rs.plot.plot_selection(3)
