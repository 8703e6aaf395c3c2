"""The format of numbers and text on pages, labels that state what is counted, and parts that depend on the request."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

import rfpsurvey as rs
from pages import Reader, full
from rfpsurvey._field.facts import tile_facts
from rfpsurvey._survey.columns import survey_facts
from rfpsurvey.report import _tables, _tile
from rfpsurvey.report import _write as _survey
from rfpsurvey.report._blocks import column_texts, estimate_facts, text_of
from rfpsurvey.report._tile import _asked


@given(st.lists(st.floats(-1e300, 1e300), min_size=1, max_size=5))
def test_numbers_keep_four_digits(values):
    for value, text in zip(values, column_texts(np.array(values)), strict=True):
        assert abs(float(text) - value) <= 0.5001e-3 * abs(value)


def test_numbers_of_a_column_have_the_same_decimals():
    assert column_texts(np.array([1.5, 12.25, 3.0])) == ["1.50", "12.25", "3.00"]
    assert column_texts(np.array([0.1234567, 1.0])) == ["0.1235", "1.0000"]
    assert column_texts(np.array([1e-7, 12345678.0, 12345.6])) == ["1.000e-07", "1.235e+07", "12346"]
    assert column_texts(np.array([True, False])) == ["yes", "no"]


def test_text_of_any_language_stays_as_it_is():
    """No-break spaces, ideographic spaces and joiners are kept.

    Characters that change the direction of text are replaced.
    """
    words = ["a\u00a0b", "\u65e5\u672c\u3000\u8a9e", "x\u200dy", "1\u202f000"]
    for word in words:
        assert text_of(word) == word
    assert (text_of("a\r\nb\tc"), text_of("a\x00b\u202ec\ud800")) == ("a\nb\tc", "a\ufffdb\ufffdc\ufffd")


def test_small_probabilities_keep_their_digits(presets):
    estimate = rs.collision_probability(presets["desi"].with_arm_model("elbow_to_tip"), method="closed_form")
    facts = estimate_facts(replace(estimate, value=3.2e-7, low=2.8e-7, high=3.6e-7, standard_error=2e-8))
    assert facts["collision probability"].startswith("0.00000032")
    assert "0.00000028 to 0.00000036" in "".join(facts.values()).replace("280 ", "28 ").replace("360", "36")


CENTER = SkyCoord(95, 23, unit="deg")


@pytest.fixture(scope="module")
def sky(presets):
    return rs.synthetic_catalog("uniform", CENTER, 0.5 * presets["lamost"].field_radius, n_targets=900, rng=1)


def test_the_collision_rate_of_assigned_arms_comes_first(presets, sky):
    """Regression: with many parked arms, the collision rate was 0.0000 although many targets were lost."""
    tile = rs.plan_tile(sky, presets["lamost"], CENTER, allocator="balanced")
    facts, t = tile_facts(tile), tile.table
    names = [name for name in facts if "rate" in name or "and parked" in name]
    assert names == ["collision rate of assigned arms", "  of assigned and parked arms"]
    lost = np.asarray(t["in_collision"])[np.asarray(t["status"]) == "assigned"].sum()
    assert facts[names[0]] == lost / tile.summary["n_assigned"] > 3 * facts[names[1]] > 0


def test_one_rate_is_shown_if_no_arm_is_parked(presets):
    sky = rs.synthetic_catalog("uniform", CENTER, presets["moons"].field_radius, n_targets=900, rng=1)
    facts = tile_facts(rs.plan_tile(sky, presets["moons"], CENTER, allocator="balanced"))
    assert facts["collision rate of assigned arms"] > 0
    assert "  of assigned and parked arms" not in facts


@pytest.mark.parametrize("folder", [False, True])
def test_a_survey_states_how_many_assigned_arms_collide(presets, sky, tmp_path, folder):
    place = {"folder": tmp_path / "survey"} if folder else {}
    survey = rs.plan_survey(sky, presets["lamost"], CENTER.reshape(1), allocator="balanced", **place)
    if folder:  # the numbers of finished tiles are read from their files
        (tmp_path / "survey" / "tiles.fits").unlink()
        survey = rs.plan_survey(sky, presets["lamost"], CENTER.reshape(1), allocator="balanced", resume=True, **place)
    lost = int(survey.targets["in_collision"].sum())
    assert 0 < lost == survey.tiles["n_colliding_assigned"].sum() == survey.summary["n_colliding_assigned"]
    facts = survey_facts(survey)
    assert facts["  in collision"] == lost
    assert facts["  collision rate of assigned arms"] == pytest.approx(lost / survey.summary["n_assigned"])
    names = list(facts)
    assert names.index("  collision rate of assigned arms") < names.index("  fraction of assigned and parked")


def test_surveys_of_earlier_versions_have_no_rate_of_assigned_arms(presets, sky):
    survey = rs.plan_survey(sky, presets["lamost"], CENTER.reshape(1))
    for name in ("n_colliding_assigned", "collision_rate_assigned"):
        del survey.summary[name]
    del survey.tiles["n_colliding_assigned"]
    assert "  in collision" not in survey_facts(survey)
    assert "assigned and parked arms" in rs.plot.plot_quality(survey)[3].get_legend().get_texts()[1].get_text()


@pytest.mark.parametrize(("parked", "expected"), [(True, "those that are parked"), (False, "none")])
def test_idle_arms_that_are_no_obstacles_are_not_called_obstacles(presets, sky, parked, expected):
    """Regression: "idle arms are obstacles: yes" stood beside "idle, not as obstacles: 2"."""
    tile = rs.plan_tile(sky, presets["lamost"], CENTER, allocator=rs.AllocationOptions(parked_obstacles=parked))
    asked = _asked(tile)
    assert "idle arms are obstacles" not in asked
    assert asked["idle arms that are obstacles"].startswith(expected)


def test_kinds_without_a_fiber_are_shown_with_0(presets, sky):
    """Regression: the numbers of fibers on standard stars and on sky were not shown if they were 0."""
    kind = np.array(["science", "standard", "sky"])[np.arange(len(sky)) % 3]
    facts = tile_facts(rs.plan_tile(rs.Catalog(sky.coord, kind=kind), presets["lamost"], CENTER))
    assert facts["    to science targets"] > 0
    assert facts["    to standard stars"] == facts["    to sky"] == 0


@pytest.fixture(scope="module")
def catalog():
    sky = rs.synthetic_catalog("uniform", CENTER, 0.5 * u.deg, n_targets=60, rng=1)
    kind, priority = np.repeat(["science", "standard"], [40, 20]), np.arange(60) % 3
    return rs.Catalog(sky.coord, kind=kind, priority=priority)


@pytest.fixture(autouse=True)
def empty_figures(monkeypatch):
    """Replace the figures, which take most of the time and which other tests check."""
    for name in ("_pictures", "_collisions"):
        monkeypatch.setattr(_tile, name, lambda *_: [])
    for module, names in ((_survey, ("plot_tiling", "plot_completeness")), (_tables, ("plot_allocators",))):
        for name in names:
            assert hasattr(module, name)
            monkeypatch.setattr(module, name, lambda *_, **__: Figure().add_subplot())


def page(result, folder):
    path = folder / "page.html"
    rs.write_report(result, path)
    return Reader(path.read_text())


def whole_text(found):
    return " ".join(text for _, text in found.texts)


def test_the_page_of_a_tile_has_its_requirements_and_constraints(small, catalog, tmp_path):
    near = np.argsort(catalog.coord[:40].separation(CENTER))[:2]
    options = {"sky_separation": 2 * u.mm, "keep_out": [rs.Region.cap(CENTER, 0.01 * u.deg)]}
    asked = rs.AllocationOptions("repair", requirements=["standard=3", "sky=2"], required=near.tolist(), **options)
    tile = rs.plan_tile(catalog, small, CENTER, allocator=asked)
    assert not tile.summary.get("unmet")
    found = page(tile, tmp_path)
    facts, ids = found.facts(), " ".join(map(str, near))
    assert facts["constraints"] == f"standard=3, sky=2, required {ids}, keep_out 95.0 23.0 0.01"
    assert facts["minimum distance of sky positions from targets"] == "2 mm"
    assert "All constraints are met." in whole_text(found)
    assigned = tile.table["kind"][tile.table["status"] == "assigned"].tolist()
    labels = {"science": "to science targets", "standard": "to standard stars", "sky": "to sky"}
    counts = {f"    {label}": assigned.count(kind) for kind, label in labels.items()}
    assert min(counts.values()) > 0
    names = list(tile_facts(tile))
    begin = names.index("  assigned") + 1
    assert {name: tile_facts(tile)[name] for name in names[begin : begin + 3]} == counts


@pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")
def test_pages_do_not_count_a_rule_that_is_not_checkable_as_met(small, catalog, tmp_path):
    """Regression: the page of a tile stated that all constraints are met if none was checkable."""
    sky = rs.Catalog(catalog.coord, extra=QTable({"mag": np.full(len(catalog), np.nan)}))
    allocator = rs.AllocationOptions("nearest", constraints="magnitude mag 12 20")
    for k, result in enumerate(
        [
            rs.plan_tile(sky, small, CENTER, allocator=allocator),
            rs.plan_survey(sky, small, SkyCoord([CENTER]), allocator=allocator),
        ]
    ):
        (tmp_path / str(k)).mkdir()
        found = whole_text(page(result, tmp_path / str(k)))
        assert "All constraints are met." not in found
        assert "not checkable" in found
    assert "Number of tiles with each verdict, for each constraint." in found


def test_the_page_of_a_survey_has_unobserved_required_targets_and_priorities(small, catalog, tmp_path):
    far = rs.Catalog(CENTER.directional_offset_by(0 * u.deg, [0.1, 20] * u.deg), priority=[0, 1])
    with pytest.warns(rs.RfpsurveyWarning, match="required targets never observed, in no field: 1"):
        survey = rs.plan_survey(far, small, SkyCoord([CENTER]), allocator=rs.AllocationOptions(required=[0, 1]))
    found = whole_text(page(survey, tmp_path))
    assert survey.summary["unmet"][0] in found
    assert "Dotted lines connect the completeness of each priority" in found
    one = rs.plan_survey(catalog.coord, small, SkyCoord([CENTER]))
    (tmp_path / "one").mkdir()
    assert "Dotted lines" not in whole_text(page(one, tmp_path / "one"))


def test_the_page_of_a_comparison_has_requirements_that_are_not_met(small, catalog, tmp_path):
    options = rs.AllocationOptions(requirements=["standard=3"])
    with pytest.warns(rs.RfpsurveyWarning, match="no target of the catalog is 'standard'"):
        table = rs.compare_allocators(catalog[:40], small, CENTER, allocators=["repair"], options=options)
    found = whole_text(page(table, tmp_path))
    (text,) = table.meta["unmet"]["repair"]
    assert "standard" in text
    assert f"repair: {text}" in found


@pytest.fixture(scope="module")
def selected(small):
    sky = rs.synthetic_catalog("poisson", CENTER, 0.8 * u.deg, density=600 / u.deg**2, rng=3)
    visits = np.ones(len(sky), dtype=int)
    visits[:5] = 0
    catalog = rs.Catalog(sky.coord, visits=visits)
    tiles = SkyCoord([94.9, 95.1, 95.0] * u.deg, [23, 23, 23.1] * u.deg)
    return rs.selection_probabilities(catalog, small, tiles, 40, allocator="nearest", rng=2)


def test_the_bars_contain_the_requested_targets_in_reach(selected):
    ax, used = rs.plot.plot_selection(selected), (selected.requested > 0) & ~selected.unreachable
    heights = np.zeros(20)
    for bar in ax.patches:
        heights[round(bar.get_x() * 20)] += bar.get_height()
    np.testing.assert_array_equal(heights, np.histogram(selected.probability[used], np.arange(21) / 20)[0])
    assert f"{selected.summary['n_always_observed']} always observed" in ax.get_title()
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == [f"{n} tile{'s' * (n > 1)}: {(selected.n_tiles[used] == n).sum()}" for n in (1, 2, 3)]


def test_the_page_shows_the_probabilities_of_the_table(selected, tmp_path):
    rs.write_report(selected, tmp_path / "page.html", data="selection.fits")
    page = Reader((tmp_path / "page.html").read_text())
    assert page.facts()["targets with requested visits"] == str(selected.summary["n_targets"])
    names, rows = page.table("Targets in the order")
    k = names.index("probability")
    assert len(rows) == min(len(selected), 1000)
    np.testing.assert_allclose([full(row[k]) for row in rows], selected.probability[: len(rows)], rtol=1e-6)
    assert len(page.table("Realizations.")[1]) == 40


def test_other_objects_are_refused():
    with pytest.raises(rs.InputTypeError, match="found must be SelectionProbabilities, got int"):
        rs.plot.plot_selection(3)
