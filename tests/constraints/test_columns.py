"""Requirements that count fibers for each value of an integer column of the focal plane, such as the petal."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from raising import refused, warned

import rfpsurvey as rs

CENTER = SkyCoord("6h20m +23d")


def quadrant(xy):
    return 2 * (xy[:, 0] > 0).astype(int) + (xy[:, 1] > 0)


@pytest.fixture(scope="module")
def petals(small):
    """Return an instrument whose focal plane has the columns ``petal`` and ``block``."""
    groups = {"petal": quadrant(small.focal_plane.arrays.xy), "block": np.arange(len(small.focal_plane)) % 2}
    return replace(small, focal_plane=replace(small.focal_plane, groups=groups))


@pytest.fixture(scope="module")
def sky(small):
    sky = rs.synthetic_catalog("uniform", CENTER, small.field_radius, n_targets=400, rng=3)
    rng, fraction = np.random.default_rng(4), np.where(sky.coord.ra > CENTER.ra, 0.5, 0.08)
    return rs.Catalog(sky.coord, kind=np.where(rng.random(400) < fraction, "sky", "science"))


@pytest.mark.parametrize("allocator", ["lamost_rule", "network_flow", "optimal", "repair"])
def test_every_petal_and_block_has_its_sky_fibers(sky, petals, allocator):
    asked = rs.AllocationOptions(allocator, requirements=["sky=2-4/petal", "sky=6/block"])
    tile = rs.plan_tile(sky, petals, CENTER, allocator=asked)
    has_sky, groups = np.asarray(tile.table["kind"]) == "sky", petals.focal_plane.groups
    in_petal, in_block = (np.bincount(groups[name][has_sky], minlength=2) for name in ("petal", "block"))
    assert (in_petal >= 2).all()
    assert (in_block >= 6).all()
    assert allocator == "lamost_rule" or (in_petal <= 4).all()  # lamost_rule ignores maxima
    rows = [(one["rule"], one["number"], one["note"]) for one in tile.rules]
    assert rows[:4] == [("sky=2-4/petal", n, f"petal {k}") for k, n in enumerate(in_petal)]
    assert rows[4:] == [("sky=6/block", n, f"block {k}") for k, n in enumerate(in_block)]
    scored = rs.score_tile(tile.table, petals, constraints=["sky=2-4/petal", "sky=6/block"])
    assert scored.summary["requirements"] == {"sky=2-4/petal": in_petal.tolist(), "sky=6/block": in_block.tolist()}


def test_missing_fibers_of_petals_are_named_in_plans_and_surveys(sky, petals):
    few = sky[np.flatnonzero((sky.kind == "science") | (sky.coord.ra.deg > CENTER.ra.deg + 0.15))]
    asked = rs.AllocationOptions("optimal", requirements="sky=3/petal")
    tile = rs.plan_tile(few, petals, CENTER, allocator=asked)
    place = petals.focal_plane.groups["petal"][np.asarray(tile.table["kind"]) == "sky"]
    lacking = [k for k in range(4) if (place == k).sum() < 3]
    missing = sum(3 - (place == k).sum() for k in lacking)
    assert len(lacking) > 1
    where = f"in each petal: {missing} missing in {len(lacking)} petals ({', '.join(map(str, lacking))})"
    assert tile.summary["unmet"][0].startswith(f"sky targets, 3 {where}")
    survey = warned(f"sky=3/petal: {missing} missing", rs.plan_survey, few, petals, CENTER, allocator=asked)
    assert survey.tiles["unmet"].tolist() == [f"sky=3/petal: {missing} missing"]


def test_text_and_object_of_a_requirement_per_column_are_the_same():
    one = rs.Requirement("sky", 2, 4, per="petal", fiber_type="BOSS")
    assert str(one) == "sky@BOSS=2-4/petal"
    assert rs.Requirement.parse(str(one)) == one
    assert rs.Requirement.parse("sky=1 / slit block").per == "slit block"


def test_integer_columns_of_a_table_are_groups(petals):
    plane = petals.focal_plane
    table = replace(plane, obstacles=[[0, 0, 0.5]] * u.mm).to_table()
    again = rs.FocalPlane.from_table(table)
    assert [*again.groups] == ["petal", "block"]
    for name, values in plane.groups.items():
        np.testing.assert_array_equal(again.groups[name], values)
    table = QTable(table[: len(plane)])
    table["whole"], table["part"], table["word"], table["deg"] = 1.0, 0.5, "a", 2 * u.deg
    table["tile"], table["a/b"] = 1, 1
    assert [*rs.FocalPlane.from_table(table, plane.positioner).groups] == ["petal", "block", "whole"]
    assert plane.to_table().colnames != replace(plane, groups=None).to_table().colnames


def test_an_instrument_is_identified_by_its_groups(small, petals):
    other = replace(petals, focal_plane=replace(petals.focal_plane, groups=None))
    assert other.provenance["digest"] == small.provenance["digest"] != petals.provenance["digest"]


@pytest.mark.parametrize("name", ["petl", "word"])
def test_an_unknown_column_is_an_error_that_lists_the_columns(sky, petals, name):
    asked = rs.AllocationOptions("optimal", constraints=[f"sky=3/{name}"])
    text = f"the requirement 'sky=3/{name}' must name an integer column of the focal plane after '/', one of: "
    text += f"'spectrograph', 'petal', 'block'; got '{name}'" + ("; did you mean 'petal'?" if name == "petl" else "")
    table = QTable({"positioner": petals.focal_plane.id[:1], "x": [0.0] * u.mm, "y": [0.0] * u.mm})
    assert refused("", rs.plan_tile, sky, petals, CENTER, allocator=asked) == text
    assert refused("", rs.plan_survey, sky, petals, CENTER, allocator=asked) == text
    assert refused("", rs.score_tile, table, petals, constraints=f"sky=3/{name}") == text
    assert refused("", rs.allocate, petals.focal_plane, [[0, 0]] * u.mm, allocator=asked) == text


NAMES = "names of groups must be text without / that is not tile or the name of another column, got"
SHAPE = "groups['petal'] must contain an integer for each positioner, shape (2,), got"
WRONG_GROUPS = [
    ([1, 2], "groups must be a dict of arrays of integers, one per positioner, got [1, 2]"),
    ({"petal": [0.5, 1]}, "groups['petal'] must be integers or text for every row, got numbers such as 0.5"),
    *(({"petal": values}, f"{SHAPE} {values}") for values in ([1], ["a", "b"])),
    *(({name: [1, 2]}, f"{NAMES} {name!r}") for name in ("tile", "stuck_phi", "a/b", 3)),
]


@pytest.mark.parametrize(("groups", "message"), WRONG_GROUPS)
def test_groups_of_the_wrong_form_are_errors(groups, message):
    robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    assert refused("", rs.FocalPlane, [[0, 0], [25.6, 0]] * u.mm, robot, groups=groups).startswith(message)


def test_commands_count_fibers_per_column_of_an_instrument_file(sky, petals, tmp_path, run):
    """An unknown column is one sentence, and the exit code is 2."""
    petals.focal_plane.to_table().write(tmp_path / "layout.ecsv")
    (tmp_path / "mine.toml").write_text(
        'name = "mine"\n'
        "[positioner]\n"
        + "".join(
            f'{name} = {{ value = {value}, unit = "mm", status = "assumed", source = "test" }}\n'
            for name, value in (("central_arm", 8.25), ("eccentric_arm", 8.25), ("clearance", 2.25))
        )
        + '[layout]\ntable = { value = "layout.ecsv", status = "assumed", source = "test" }\n'
        '[optics]\nplate_scale = { value = 200, unit = "mm/deg", status = "assumed", source = "test" }\n'
    )
    sky.write(tmp_path / "targets.ecsv")
    arguments = ["plan", tmp_path / "targets.ecsv", "--instrument", tmp_path / "mine.toml", "--center", "95 23"]
    code, _, errors = run(*arguments, "--constraint", "sky=2/petal", "--output", tmp_path / "tile.fits")
    assert code == 0, errors
    assert rs.Tile.read(tmp_path / "tile.fits").rules["note"].tolist() == [f"petal {k}" for k in range(4)]
    code, _, errors = run(*arguments, "--constraint", "sky=2/petl", "--output", tmp_path / "other.fits")
    assert code == 2
    assert "must name an integer column of the focal plane after '/'" in errors
    assert "Traceback" not in errors
