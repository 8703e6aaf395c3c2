"""Random catalogs, against a search over tiles and positioners point by point."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import Table
from raising import refused

import rfpsurvey as rs

CENTERS = SkyCoord([95.0, 95.15, 95.05] * u.deg, [23.0, 23.05, 23.12] * u.deg)
DENSITY = 3000 / u.deg**2
VETO = rs.Region.parse("cap 95.05 23.02 0.05")


@pytest.fixture(scope="module")
def case(presets, tmp_path_factory):
    """Return the targets, the instrument, and a survey of three tiles of MOONS."""
    sky = rs.synthetic_catalog("uniform", CENTERS[0], 0.45 * u.deg, n_targets=2500, rng=3)
    rng = np.random.default_rng(1)
    kind = rng.choice(["science", "sky"], len(sky), p=[0.9, 0.1])
    sky = rs.Catalog(sky.coord, kind=kind, visits=rng.integers(0, 3, len(sky)))
    folder = tmp_path_factory.mktemp("random") / "plan"
    return sky, presets["moons"], rs.plan_survey(sky, presets["moons"], CENTERS, allocator="lamost_rule", folder=folder)


def sets_of_tiles(coord, model, survey):
    """Return for each position the tiles in which a positioner that keeps its target reaches it."""
    sets = [set() for _ in range(len(coord))]
    for tile in survey.tiles["tile"]:
        visits = survey.tile(tile)
        lost = visits["positioner"][np.asarray(visits["in_collision"])]
        center = CENTERS[int(tile)]
        near = np.flatnonzero(coord.separation(center) <= model.field_radius)
        can = model.focal_plane.reachable(model.projection(center).to_focal_plane(coord[near])).toarray()
        can[np.isin(model.focal_plane.id, lost)] = False
        for k in near[can.any(axis=0)]:
            sets[k].add(int(tile))
    return sets


def test_points_and_completeness_are_those_of_a_search(case):
    sky, model, survey = case
    table = rs.selection.random_catalog(sky, model, CENTERS, density=DENSITY, survey=survey, veto=VETO, rng=2)
    coord = SkyCoord(table["ra"], table["dec"])
    assert not VETO.contains(coord).any()
    points, targets = (sets_of_tiles(c, model, survey) for c in (coord, sky.coord))
    assert [len(s) for s in points] == table["n_tiles"].tolist()
    assert min(map(len, points)) == 1
    observed = {int(row) for visits in survey for row in visits["target_row"][visits["observed"]]}
    asked, made = {}, {}
    for k, tiles in enumerate(targets):
        if sky.kind[k] == "science" and sky.visits[k]:
            key = tuple(sorted(tiles))
            asked[key], made[key] = asked.get(key, 0) + 1, made.get(key, 0) + (k in observed)
    for row, tiles in zip(table, points, strict=True):
        key = tuple(sorted(tiles))
        assert row["n_targets"] == asked[key]
        assert row["completeness"] == pytest.approx(made[key] / asked[key])
    meta = table.meta
    assert meta["n_drawn"] - meta["n_vetoed"] - meta["n_out_of_reach"] == len(table)
    assert meta["n_vetoed"] > 10


def test_points_are_uniform_in_the_union_of_the_fields(presets):
    """Counts in quarters of a field, and in an area that three fields share, are those of a Poisson process."""
    model, numbers = presets["moons"], []
    inside = [rs.Region.parse(f"cap {ra} {dec} 0.04") for ra, dec in ((95.06, 23.05), (94.9, 22.95), (95.25, 23.1))]
    for seed in range(40):
        table = rs.selection.random_catalog(CENTERS[:1], model, CENTERS, density=DENSITY, rng=seed)
        coord = SkyCoord(table["ra"], table["dec"])
        numbers.append([region.contains(coord).sum() for region in inside])
        assert "completeness" not in table.colnames
    expected = 3000 * 2 * np.pi * (1 - np.cos(np.deg2rad(0.04))) * (180 / np.pi) ** 2
    assert np.all(np.abs(np.mean(numbers, axis=0) - expected) < 4 * np.sqrt(expected / 40))


def test_wrong_values(case, presets):
    sky, model, survey = case
    call = rs.selection.random_catalog
    refused("density .* must be a number above 0", call, sky, model, CENTERS, density=0 / u.deg**2)
    refused("veto must be a list of Region, got 3", call, sky, model, CENTERS, density=DENSITY, veto=[3])
    everywhere = [rs.Region.parse("cap 95 23 5")]
    refused("no point of .* is left", call, sky, model, CENTERS, density=DENSITY, veto=everywhere)
    refused("catalog must be that of the survey", call, sky[:10], model, CENTERS, density=DENSITY, survey=survey)


def test_the_command_writes_the_catalog(case, run, tmp_path):
    sky, _, survey = case
    sky.write(tmp_path / "targets.fits")
    words = ["potential", tmp_path / "targets.fits", "--instrument", "moons", "--survey", survey.folder]
    code, out, err = run(*words, "--density", 3000, "--veto", "cap 95.05 23.02 0.05", "--output", tmp_path / "r.fits")
    assert code == 0, err
    table = Table.read(tmp_path / "r.fits")
    assert f"points{len(table):>40}" in out
    assert {"ra", "dec", "n_tiles", "n_targets", "completeness"} == {*table.colnames}
    code, _, err = run(*words, "--veto", "cap 95 23 1")
    assert code == 2
    assert "--veto must be used with --density" in err or "veto must be used with --density" in err
