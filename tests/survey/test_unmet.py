"""Requirements that the tiles of a survey do not meet."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs

CENTER = SkyCoord("6h20m +23d")
REQUIREMENTS = ["sky=4", "science=0-6", "standard=3/spectrograph"]


@pytest.fixture(scope="module")
def case():
    """Return a catalog with sky positions in one half of the field, and eight tiles."""
    coord = rs.synthetic_catalog("uniform", CENTER, 1.2 * u.deg, n_targets=900, rng=2).coord
    kind = np.where(np.arange(900) % 9 == 0, "standard", "science")
    kind[(np.arange(900) % 5 == 0) & (coord.ra > CENTER.ra)] = "sky"
    tiles = SkyCoord(CENTER.directional_offset_by(np.arange(8) * 45 * u.deg, 0.8 * u.deg))
    return rs.Catalog(coord, kind=kind), tiles


def plan(case, **options):
    asked = rs.AllocationOptions("lamost_rule", requirements=REQUIREMENTS, required=[1, 2])
    with pytest.warns(rs.RfpsurveyWarning) as told:
        survey = rs.plan_survey(case[0], "moons", case[1], allocator=asked, **options)
    return survey, [str(one.message) for one in told]


def test_the_table_and_the_summary_state_requirements_tiles_and_numbers(case, tmp_path):
    """Only the number of requirements was stated, without the tiles and the missing targets."""
    survey, told = plan(case, folder=tmp_path / "survey")
    lacks = np.maximum(4 - survey.tiles["n_sky"], 0)
    excess = np.maximum(survey.tiles["n_science"] - 6, 0)
    assert 0 < np.count_nonzero(lacks) < 8
    assert (excess > 0).sum() > 5
    for row, text in enumerate(survey.tiles["unmet"].tolist()):
        parts = dict(part.split(": ") for part in text.split(", ")) if text else {}
        assert parts.get("sky=4") == (f"{lacks[row]} missing" if lacks[row] else None)
        assert parts.get("science=0-6") == (f"{excess[row]} too many" if excess[row] else None)
        assert len(parts) <= survey.tiles["n_unmet"][row]
    unmet = survey.summary["unmet"]
    said, stated = ([text for text in texts if text.startswith("requirement")] for texts in (told, unmet))
    assert said == stated
    rows = np.flatnonzero(lacks)
    first = ", ".join(str(row) for row in rows[:5]) + (f" and {len(rows) - 5} more" if len(rows) > 5 else "")
    assert unmet[0] == f"requirement sky=4: {lacks.sum()} missing in {len(rows)} of 8 tiles ({first})"
    rows = np.flatnonzero(excess)
    first = f"{', '.join(str(row) for row in rows[:5])} and {len(rows) - 5} more"
    assert unmet[1] == f"requirement science=0-6: {excess.sum()} too many in {len(rows)} of 8 tiles ({first})"


def test_a_continued_survey_and_its_files_state_the_same(case, tmp_path):
    whole, _ = plan(case)
    folder = tmp_path / "survey"
    plan(case, folder=folder)
    (folder / "tiles.fits").unlink()
    again, _ = plan(case, folder=folder, resume=True)
    stored = rs.Survey.read(folder)
    for survey in (again, stored):
        assert survey.summary["unmet"] == whole.summary["unmet"]
        assert survey.tiles["unmet"].tolist() == whole.tiles["unmet"].tolist()


def test_the_command_and_the_report_state_them(case, tmp_path, run):
    case[0].write(tmp_path / "stars.fits")
    QTable({"ra": case[1].ra, "dec": case[1].dec}).write(tmp_path / "tiles.ecsv")
    words = "survey", tmp_path / "stars.fits", "--tiles", tmp_path / "tiles.ecsv", "--instrument", "moons"
    code, _, err = run(*words, "--constraint", "sky=4", "--report", tmp_path / "page.html")
    assert code == 0
    (line,) = [line for line in err.splitlines() if "requirement" in line]
    assert line.startswith("rfpsurvey: warning: requirement sky=4: ")
    assert line.removeprefix("rfpsurvey: warning: ") in (tmp_path / "page.html").read_text()
