"""Parts of pages that depend on the request: requirements, required targets, circles, and priorities."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from matplotlib.figure import Figure

import rfpsurvey as rs
from pages import Reader
from rfpsurvey.report import _survey, _tables, _tile
from rfpsurvey.tile import tile_facts

CENTER = SkyCoord(95, 23, unit="deg")


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


def text_of(found):
    return " ".join(text for _, text in found.texts)


def test_the_page_of_a_tile_has_its_requirements_and_constraints(small, catalog, tmp_path):
    near = np.argsort(catalog.coord[:40].separation(CENTER))[:2]
    options = {"sky_separation": 2 * u.mm, "keep_out": [rs.Region.cap(CENTER, 0.01 * u.deg)]}
    asked = rs.AllocationOptions("repair", requirements=["standard=3", "sky=2"], required=near.tolist(), **options)
    tile = rs.plan_tile(catalog, small, CENTER, allocator=asked)
    assert not tile.summary.get("unmet")
    found = page(tile, tmp_path)
    facts = found.facts()
    ids = " ".join(map(str, near))
    assert facts["constraints"] == f"standard=3, sky=2, required {ids}, keep_out 95.0 23.0 0.01"
    assert facts["minimum distance of sky positions from targets"] == "2 mm"
    assert "All constraints are met." in text_of(found)
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
        found = text_of(page(result, tmp_path / str(k)))
        assert "All constraints are met." not in found
        assert "not checkable" in found
    assert "Number of tiles with each verdict, for each constraint." in found


def test_the_page_of_a_survey_has_unobserved_required_targets_and_priorities(small, catalog, tmp_path):
    far = rs.Catalog(CENTER.directional_offset_by(0 * u.deg, [0.1, 20] * u.deg), priority=[0, 1])
    with pytest.warns(rs.RfpsurveyWarning, match="required targets never observed, in no field: 1"):
        survey = rs.plan_survey(far, small, SkyCoord([CENTER]), allocator=rs.AllocationOptions(required=[0, 1]))
    found = text_of(page(survey, tmp_path))
    assert survey.summary["unmet"][0] in found
    assert "Dotted lines connect the completeness of each priority" in found
    one = rs.plan_survey(catalog.coord, small, SkyCoord([CENTER]))
    (tmp_path / "one").mkdir()
    assert "Dotted lines" not in text_of(page(one, tmp_path / "one"))


def test_the_page_of_a_comparison_has_requirements_that_are_not_met(small, catalog, tmp_path):
    options = rs.AllocationOptions(requirements=["standard=3"])
    with pytest.warns(rs.RfpsurveyWarning, match="no target of the catalog is 'standard'"):
        table = rs.compare_allocators(catalog[:40], small, CENTER, allocators=["repair"], options=options)
    found = text_of(page(table, tmp_path))
    (text,) = table.meta["unmet"]["repair"]
    assert "standard" in text
    assert f"repair: {text}" in found
