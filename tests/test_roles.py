"""Kinds of targets with several roles."""

from itertools import permutations

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import Table

import rfpsurvey as rs
from rfpsurvey._sky.arrays import count_roles, has_role, last_role, to_kinds, without_role, without_science

ROLES = ("science", "standard", "sky")
KINDS = [kind for n in (1, 2, 3) for kind in permutations(ROLES, n)]


@pytest.mark.parametrize("length", [0, 20])
def test_roles_of_all_kinds(length):
    kind = to_kinds(np.array([" + ".join(roles).title() for roles in KINDS], dtype=f"U{max(length, 30)}"), "kind")
    for roles, found, rest in zip(KINDS, kind.tolist(), without_science(kind).tolist(), strict=True):
        assert found.split("+") == [role for role in ROLES if role in roles]
        if len(roles) > 1:
            assert rest.split("+") == [role for role in ROLES[1:] if role in roles]
    for role in ROLES:
        rest = without_role(kind, role, np.char.find(kind, "+") >= 0).tolist()
        assert [one.split("+") for one in rest] == [
            [own for own in one.split("+") if own != role or "+" not in one] for one in kind.tolist()
        ]
        assert has_role(kind, role).tolist() == [role in roles for roles in KINDS]
    empty = to_kinds([], "kind"), without_science(kind[:0]), without_role(kind[:0], "sky", True)
    assert [one.shape for one in empty] == [(0,)] * 3
    others = np.array(["", "star", "Sky+Science", "standard"])
    assert to_kinds(others, "kind", strict=False).tolist() == ["", "star", "science+sky", "standard"]


def test_the_length_of_the_text_remains_the_same():
    """Equal catalogs have the same digest, which depends on the length of the text."""
    assert to_kinds(np.array(["sky"], dtype="U12"), "kind").dtype == "U12"
    assert to_kinds(np.array(["standard+science"], dtype="U16"), "kind").dtype == "U16"


@pytest.mark.parametrize("kind", ["star", "", "science+star", "science+", "+", 1])
def test_other_kinds_are_refused(kind):
    with pytest.raises(rs.InputError, match="kind must be science, standard or sky, or several of them joined by '.'"):
        rs.Catalog(SkyCoord([90] * u.deg, [0] * u.deg), kind=[kind])


def test_numbers_of_targets_by_roles_are_stated():
    kind = np.array(["science", "science+standard", "sky", "science+standard"])
    assert count_roles(kind) == "roles: 2 science and standard, 1 science, 1 sky"
    assert count_roles(kind[[0, 2]]) == ""


def test_a_tile_states_how_many_required_fibers_are_on_science_targets(small, tmp_path, run):
    sky = rs.synthetic_catalog("uniform", "8h +30d", 0.3 * u.deg, n_targets=90, rng=1)
    kind = np.where(np.arange(90) < 30, "science+standard", np.where(np.arange(90) < 35, "standard", "science"))
    catalog = rs.Catalog(sky.coord, id=np.arange(90), kind=kind)
    options = rs.AllocationOptions("optimal", requirements=["standard=6"])
    tile = rs.plan_tile(catalog, small, "8h +30d", allocator=options)
    kinds = np.asarray(tile.table["kind"]).astype(str)
    both, counts = int((kinds == "science+standard").sum()), tile.summary["kinds"]
    assert counts["standard"]["n_assigned"] == both + (kinds == "standard").sum()
    assert counts["science"]["n_assigned"] == both + (kinds == "science").sum()
    assert counts["standard"]["n_also_science"] == both >= 6
    plain = rs.plan_tile(replace_kind(catalog), small, "8h +30d", allocator="optimal")
    assert counts["science"]["n_assigned"] == plain.summary["n_assigned"]  # the requirement costs no science target
    score = rs.score_tile(tile.table, small, constraints=["standard=6", f"standard=-{both - 1}"])
    assert [one["verdict"] for one in score.rules] == ["pass", "fail"]
    assert score.summary["n_also_science"] == both
    assert "n_also_science" not in rs.score_tile(tile.table, small, constraints=["science=6", "sky=1"]).summary
    assert dict(zip(tile.completeness["kind"], tile.completeness["n_assigned"], strict=True))["standard"] == both
    for ending in (".fits", ".ecsv"):
        tile.write(tmp_path / f"tile{ending}")
        assert np.asarray(rs.Tile.read(tmp_path / f"tile{ending}").table["kind"]).tolist() == kinds.tolist()
        catalog.write(tmp_path / f"catalog{ending}")
        assert rs.Catalog.read(tmp_path / f"catalog{ending}").kind.tolist() == catalog.kind.tolist()
    code, out, err = run("plan", tmp_path / "catalog.ecsv", "--instrument", "sdss_apo", "--constraint", "standard=6")
    assert code == 0, err
    assert "roles: 30 science and standard, 55 science, 5 standard" in " ".join(out.split())
    assert "that are science targets (standard)" in out
    rs.plan_tile(catalog, "sdss_apo", "8h +30d", allocator=options).write(tmp_path / "planned.ecsv")
    given = ["--constraint", "standard=6", "--report", tmp_path / "score.html"]
    code, out, err = run("score", tmp_path / "planned.ecsv", *given)
    assert code == 0, err
    for text in (" ".join(out.split()), (tmp_path / "score.html").read_text()):
        assert "that are also science targets" in text


def test_collision_probabilities_use_science_targets_with_other_roles(small):
    sky = rs.synthetic_catalog("uniform", "8h +30d", 0.3 * u.deg, n_targets=90, rng=1).coord
    kind = np.where(np.arange(90) % 3, "science+standard", "science")
    catalogs = [rs.Catalog(sky, kind=one) for one in (kind, None)]
    one, other = (rs.collision_probability(small, targets=sky, center="8h +30d") for sky in catalogs)
    assert one.value == other.value > 0


def test_unset_visits_of_a_science_target_with_other_roles_have_a_warning():
    table = Table({"ra": [1.0, 2.0], "dec": [0.0, 0.0], "kind": ["sky", "science+standard"], "NUMOBS_INIT": [-1, -1]})
    with pytest.warns(rs.RfpsurveyWarning, match="negative"):
        rs.Catalog.from_table(table)


def test_formats_with_one_role_keep_the_last_one():
    last = last_role(np.array(["science", "science+standard", "standard+sky", ""]))
    assert last.tolist() == ["science", "standard", "sky", ""]


@pytest.mark.parametrize("layout", ["preset", "as built"])
@pytest.mark.parametrize("column", ["DESI_TARGET", "MWS_TARGET"])
def test_a_tile_of_desi_has_ten_standards_per_petal_that_are_also_science_targets(presets, real_data, layout, column):
    n, center, rng = 9000, SkyCoord("10h +30d"), np.random.default_rng(7)
    sky = rs.synthetic_catalog("uniform", center, 1.6 * u.deg, n_targets=n, rng=4).coord
    kind = rng.choice(["science", "standard", "sky"], n, p=[0.78, 0.1, 0.12])
    bits = np.where(kind == "sky", 1 << 32, 1 << 61)  # SKY, MWS_ANY
    table = Table({"TARGETID": np.arange(n), "RA": sky.ra.deg, "DEC": sky.dec.deg, "DESI_TARGET": bits})
    table["MWS_TARGET"] = np.zeros(n, dtype=int)
    table["PRIORITY_INIT"], table["SUBPRIORITY"] = np.where(kind == "sky", -1, 1500), rng.random(n)
    table["NUMOBS_INIT"] = np.where(kind == "sky", -1, 1)
    table[column] |= np.where(kind == "standard", 1 << 35, 0)  # STD_BRIGHT or GAIA_STD_BRIGHT
    desi = presets["desi"] if layout == "preset" else rs.Instrument.from_desi(real_data("desi"))
    options = rs.AllocationOptions("repair", requirements=["standard=10/spectrograph", "sky=40/spectrograph"])
    tile = rs.plan_tile(rs.Catalog.from_table(table), desi, center, allocator=options)
    assert not tile.summary["unmet"]
    used = tile.table[tile.table["status"] == "assigned"]
    spectrograph = dict(zip(desi.focal_plane.id.tolist(), desi.focal_plane.spectrograph.tolist(), strict=True))
    has_bit = np.isin(np.asarray(used["target_id"]), np.flatnonzero(kind == "standard"))
    petals = [spectrograph[name] for name in np.asarray(used["id"])[has_bit].tolist()]
    numbers = np.unique(petals, return_counts=True)[1]
    assert len(numbers) == 10
    assert numbers.min() >= 10
    assert tile.summary["kinds"]["standard"]["n_also_science"] == len(petals)


@pytest.mark.parametrize(("name", "instrument"), [("confSummary-1.par", "sdss_apo"), ("design.fits", "pfs")])
def test_written_files_with_one_role_contain_the_last_one(tmp_path, presets, name, instrument):
    center = SkyCoord("10h +30d")
    sky = rs.synthetic_catalog("uniform", center, 0.6 * u.deg, n_targets=600, rng=2).coord
    kind = np.tile(["science", "science+standard", "science+sky", "standard"], 150)
    catalog = rs.Catalog(sky, id=np.arange(600), kind=kind)
    tile = rs.plan_tile(catalog, presets[instrument], center, allocator="nearest")
    with pytest.warns(rs.RfpsurveyWarning, match="roles? science of targets that have several roles"):
        tile.write(tmp_path / name, format="confsummary" if instrument == "sdss_apo" else "pfsdesign")
    plan = rs.plans.read_plan(tmp_path / name)
    used = plan[np.asarray(plan["assigned"])]
    ids = np.asarray(used["target_id"])
    kinds = np.asarray(used["kind"]).astype(str)[ids >= 0].tolist()
    assert (kinds, {*kinds}) == (last_role(kind[ids[ids >= 0]]).tolist(), {"science", "standard", "sky"})


def replace_kind(catalog):
    """Return the science targets of a catalog, without other roles."""
    return rs.Catalog(catalog.coord[np.char.find(catalog.kind, "science") >= 0])


@pytest.fixture
def sky_and_kinds():
    sky = rs.synthetic_catalog("uniform", "8h +30d", 0.4 * u.deg, n_targets=300, rng=1).coord
    return sky, np.random.default_rng(0).choice(["science", "science+standard", "sky"], 300)


def test_a_rule_on_the_distribution_counts_a_standard_that_is_also_a_science_target_as_its_own_neighbor(
    presets, sky_and_kinds
):
    sky, kind = sky_and_kinds
    options = rs.AllocationOptions("repair", requirements=["standard=8"], constraints=["distribution standard 1 95 60"])
    catalog = rs.Catalog(sky, id=np.arange(300), kind=kind)
    tile = rs.plan_tile(catalog, presets["sdss_apo"], "8h +30d", allocator=options)
    used = tile.table[tile.table["status"] == "assigned"]
    roles, xy = kind[np.asarray(used["target_id"])], np.column_stack([used["tip_x"].value, used["tip_y"].value])
    standards = xy[roles == "science+standard"]
    nearest = np.linalg.norm(xy[:, np.newaxis] - standards, axis=2).min(axis=1)[roles != "sky"]
    rule = tile.rules[-1]
    assert (rule["verdict"], rule["number"]) == ("pass", 100)
    assert f"{np.percentile(nearest, 95):.3f} mm" in rule["note"]


def test_a_tiling_counts_each_target_with_several_roles_once(presets, sky_and_kinds):
    sky, kind = sky_and_kinds
    options = rs.AllocationOptions("repair", requirements=["standard=8"])
    plain = np.where(kind == "sky", "sky", "science")
    tilings = [
        rs.place_tiles(rs.Catalog(sky, kind=one), presets["sdss_apo"], n_tiles=2, allocator=allocator)
        for one, allocator in ((kind, options), (plain, rs.AllocationOptions("repair")))
    ]
    several, alone = (one.summary for one in tilings)
    assert several["n_targets"] == alone["n_targets"] == np.count_nonzero(kind != "sky")
    assert several["n_observed"] == alone["n_observed"] > 50
