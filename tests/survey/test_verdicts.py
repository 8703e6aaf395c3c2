"""Verdicts on the rules of the tiles of a survey: those that fail, and those that are not checkable."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs
from rfpsurvey._survey import columns as _unmet
from rfpsurvey._survey import work as _work

CENTER = SkyCoord("6h20m +23d")
LIMIT, NEAR, COUNT = "magnitude mag 12.0 20.0 standard '' allowed", "distribution sky 1 80.0 20.0 ''", "sky=4"
ORDER = "contrast mag 5.0 '' fiberId"


@pytest.fixture(scope="module")
def case():
    """Return a catalog without standards in the first tile and without sky in the second tile, and three tiles."""
    coord = SkyCoord(CENTER.directional_offset_by(90 * u.deg, [0, 2, 4] * u.deg))
    parts = [rs.synthetic_catalog("uniform", c, 0.4 * u.deg, n_targets=300, rng=k).coord for k, c in enumerate(coord)]
    kind = np.tile(["science", "standard", "sky"], 300)
    kind[:300][kind[:300] == "standard"] = "science"
    kind[300:600][kind[300:600] == "sky"] = "science"
    sky = SkyCoord(np.concatenate([one.ra for one in parts]), np.concatenate([one.dec for one in parts]))
    return rs.Catalog(sky, kind=kind, extra=QTable({"mag": np.random.default_rng(1).uniform(13, 19, 900)})), coord


def plan(case, small, **options):
    allocator = rs.AllocationOptions("repair", constraints=[COUNT, "standard=2", LIMIT, NEAR, ORDER])
    with pytest.warns(rs.RfpsurveyWarning):
        return rs.plan_survey(case[0], small, case[1], allocator=allocator, **options)


@pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")
@pytest.mark.parametrize("way", ["memory", "folder", "resumed", "read"])
def test_each_tile_has_the_verdicts_of_the_same_tile_alone(case, small, way, tmp_path):
    """A rule that is not checkable is neither passed nor failed, also if the survey is continued or read."""
    folder = None if way == "memory" else tmp_path / "survey"
    survey = plan(case, small, folder=folder)
    if way == "resumed":
        for name in ("tiles.fits", "tiles/000/000001.fits"):
            (folder / name).unlink()
        survey = plan(case, small, folder=folder, resume=True)
    if way == "read":
        survey = rs.Survey.read(folder)
    found = {rule: [] for rule in (COUNT, "standard=2", LIMIT, NEAR, ORDER)}
    for k, center in enumerate(case[1]):
        allocator = rs.AllocationOptions("repair", constraints=list(found))
        tile = rs.plan_tile(case[0], small, center, allocator=allocator)
        verdicts = dict(zip(tile.rules["rule"].tolist(), tile.rules["verdict"].tolist(), strict=True))
        for rule, rows in found.items():
            rows.append(verdicts[rule])
        texts = survey.tiles["unmet"][k].split(", ") if survey.tiles["unmet"][k] else []
        failed = [rule for rule in found if verdicts[rule] == "fail"]
        assert [text.partition(":")[0] for text in texts] == failed
        unknown = [rule for rule in found if verdicts[rule] == "not checkable"]
        assert (survey.tiles["not_checkable"][k], survey.tiles["n_unmet"][k]) == (", ".join(unknown), len(failed))
    rules = survey.rules
    assert rules.colnames == ["rule", "pass", "fail", "not checkable", "tiles"]
    for row in rules:
        verdicts, names = found[row["rule"]], ("pass", "fail", "not checkable")
        assert [row[name] for name in names] == [verdicts.count(name) for name in names]
        assert row["tiles"] == ", ".join(str(k) for k, one in enumerate(verdicts) if one == "fail")
    assert (rules["rule"].tolist(), found[LIMIT][0]) == (list(found), "not checkable")
    assert (set(found[ORDER]), found[COUNT][1]) == ({"not checkable"}, "fail")
    assert "pass" in found[LIMIT]


@pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")
def test_tiles_of_earlier_versions_are_not_checkable_if_their_files_do_not_state_it(case, small, tmp_path, monkeypatch):
    """The files of these tiles are kept, and rules that they do not violate do not count as passed."""
    folder, cards = tmp_path / "survey", _unmet.shortfall_cards

    def earlier_cards(options):
        return {name: value for name, value in cards(options).items() if not name.startswith("NOTC")}

    with monkeypatch.context() as earlier:
        for module in (_unmet, _work):
            earlier.setattr(module, "shortfall_cards", earlier_cards)
        plan(case, small, folder=folder)
    (folder / "tiles.fits").unlink()
    before = {path.name: path.read_bytes() for path in folder.rglob("0*.fits")}
    survey = plan(case, small, folder=folder, resume=True)
    assert {path.name: path.read_bytes() for path in folder.rglob("0*.fits")} == before
    rows = {row["rule"]: row for row in survey.rules}
    assert [rows[LIMIT][name] for name in ("pass", "fail", "not checkable")] == [0, 0, 3]
    assert rows[COUNT]["not checkable"] == 0


def test_a_survey_without_constraints_has_no_table_of_rules(case, small):
    survey = rs.plan_survey(case[0], small, case[1], allocator="nearest")
    assert survey.rules is None
    assert not {"unmet", "not_checkable"} & {*survey.tiles.colnames}
