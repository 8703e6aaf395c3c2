"""Fields of surveys as regions of DS9, as coverage maps, and on a page with Aladin Lite, which a stub replaces."""

import json

import astropy.units as u
import living
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
from pages import Reader
from rfpsurvey._survey import footprints

STATES = {"11": "observed", "12": "partly observed", "13": "bad", "14": "dropped"}
STUB = """
window.calls = [];
const overlay = (options) => ({ add: (circle) => calls.push([options.name, options.color, ...circle]) });
window.A = { init: Promise.resolve(), aladin: (...all) => { calls.push(all); return { addOverlay: () => {} }; },
  graphicOverlay: overlay, circle: (...all) => all };
"""


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    """Return a survey of six tiles, of which four have events."""
    folder = tmp_path_factory.mktemp("footprints") / "plan"
    tiling = living.tiling()
    tiling.table["tile"] = tiling.table["tile"].astype(str)
    survey = rs.plan_survey(living.targets(), living.instrument(), tiling, allocator="nearest", folder=folder)
    states = ["done", "partly", "bad", "dropped"]
    survey.record(living.events(tile=list(STATES), date="2025-12-03", state=states))
    return survey


def test_regions_have_the_places_and_the_states_of_the_tiles(survey, tmp_path):
    regions = pytest.importorskip("regions")
    rs.survey.to_regions(survey.state()).write(tmp_path / "tiles.reg", format="ds9")
    found = regions.Regions.read(tmp_path / "tiles.reg", format="ds9")
    names = survey.tiles["tile"].tolist()
    assert [one.meta["text"] for one in found] == [f"{name} {STATES.get(name, 'planned')}" for name in names]
    places = SkyCoord([one.center for one in found])
    assert places.separation(SkyCoord(survey.tiles["ra"], survey.tiles["dec"])).max() < 1e-3 * u.arcsec
    radius = survey.provenance["parameters"]["radius_deg"] * u.deg
    assert all(abs(one.radius - radius) < 1e-3 * u.arcsec for one in found)
    assert len({one.visual["facecolor"] for one in found}) == 5
    words = [one.meta["text"].split()[1] for one in rs.survey.to_regions(survey)]  # the plan knows no observations
    assert words == ["planned"] * 6


def test_names_cannot_end_the_text_of_a_region(survey, monkeypatch):
    regions = pytest.importorskip("regions")
    fields = footprints.fields_of(survey)
    names = np.array(["a} color=red", "{b", "c\ncircle(1,2,3)", "d # e", "<script>", '"; f'])
    monkeypatch.setattr(footprints, "fields_of", lambda _: (*fields[:2], names, fields[3]))
    found = regions.Regions.parse(rs.survey.to_regions(survey).serialize(format="ds9"), format="ds9")
    assert [one.meta["text"] for one in found] == [f"{n.translate(footprints.BRACES)} planned" for n in names]


def test_the_coverage_map_contains_the_fields(survey):
    pytest.importorskip("mocpy")
    state, radius = survey.state(), survey.provenance["parameters"]["radius_deg"]
    points = rs.synthetic_catalog("uniform", living.CENTER, 1 * u.deg, n_targets=3000, rng=1).coord
    words = np.array([STATES.get(name, "planned") for name in survey.tiles["tile"]])
    centers = SkyCoord(survey.tiles["ra"], survey.tiles["dec"])
    for word in ("planned", "observed", "dropped"):
        apart = points[:, None].separation(centers[words == word]).deg.min(axis=1)
        inside = rs.survey.to_moc(state, word, max_depth=12).contains_skycoords(points)
        sure = np.abs(apart - radius) > 0.03  # the size of a pixel
        np.testing.assert_array_equal(inside[sure], (apart < radius)[sure])
        assert 0 < inside.sum() < len(points)
    with pytest.raises(rs.InputError, match="unknown state 'done'; choose one of: .*planned"):
        rs.survey.to_moc(state, "done")
    with pytest.raises(rs.InputError, match="max_depth must be a whole number from 0 to 29, got 30"):
        rs.survey.to_moc(state, max_depth=30)


@pytest.mark.parametrize("name", ["regions", "mocpy"])
def test_a_missing_package_is_named(survey, monkeypatch, name):
    monkeypatch.setitem(__import__("sys").modules, name, None)
    function = rs.survey.to_regions if name == "regions" else rs.survey.to_moc
    with pytest.raises(rs.InputError, match=rf"the package {name} is required: pip install 'rfpsurvey\[regions\]'"):
        function(survey)


@pytest.mark.parametrize("function", [rs.survey.to_regions, rs.survey.to_moc])
def test_other_objects_are_refused(function):
    for package in ("regions", "mocpy"):
        pytest.importorskip(package)
    with pytest.raises(rs.InputTypeError, match="survey must be a Survey or a SurveyState, got 3"):
        function(3)


def test_the_page_for_aladin_lite_draws_all_fields(survey, tmp_path, visit):
    rs.report.write_aladin(survey.state(), tmp_path / "sky.html")
    text = (tmp_path / "sky.html").read_text()
    assert "This page requires a network" in " ".join(Reader(text).text("p"))
    (tmp_path / "stub.html").write_text(
        text.replace(' src="https://aladin.cds.unistra.fr/', f'>{STUB}</script><script data-src="')
    )
    page = visit(tmp_path / "stub.html")
    page.wait_for_timeout(200)
    (_, options), *circles = page.evaluate("calls")
    words = page.locator("#legend").inner_text()
    radius = survey.provenance["parameters"]["radius_deg"]
    states = [STATES.get(name, "planned") for name in survey.tiles["tile"]]
    assert sorted(state for state, *_ in circles) == sorted(states)
    assert all(f"{state}: {states.count(state)}" in words for state in states)
    for state, color, ra, dec, size in circles:
        apart = SkyCoord(ra, dec, unit="deg").separation(SkyCoord(survey.tiles["ra"], survey.tiles["dec"]))
        assert (states[apart.argmin()], apart.min() < 0.1 * u.arcsec, size) == (state, True, radius)
        assert color == footprints.COLORS.get(state, "gray")
    target = SkyCoord(options["target"], unit="deg")
    assert (
        target.separation(SkyCoord(survey.tiles["ra"], survey.tiles["dec"])).max().deg + radius
        <= options["fov"] / 2 + 1e-5
    )
    with pytest.raises(rs.InputError, match="exists"):
        rs.report.write_aladin(survey, tmp_path / "sky.html")


def test_hostile_states_stay_text(survey, tmp_path, monkeypatch):
    hostile, path = "</script><img src=x onerror=alert(1)>", tmp_path / "sky.html"
    centers, radius, names, words = footprints.fields_of(survey)
    monkeypatch.setattr(
        "rfpsurvey.report._aladin.fields_of", lambda _: (centers, radius, names, np.full(len(words), hostile))
    )
    rs.report.write_aladin(survey, path)
    page = Reader(path.read_text())
    assert not page.all("img")
    assert json.loads(page.text("script")[0])["groups"][0][0] == hostile
