"""Kinds of targets with several roles."""

from itertools import permutations

import astropy.units as u
import numpy as np
import pytest
from astropy.table import Table

import rfpsurvey as rs
from rfpsurvey._roles import count_roles, has_role, last_role, to_kinds, without_role, without_science

ROLES = ("science", "standard", "sky")
KINDS = [kind for n in (1, 2, 3) for kind in permutations(ROLES, n)]


@pytest.mark.parametrize("length", [0, 20])
def test_roles_of_all_kinds(length):
    texts = np.array([" + ".join(roles).title() for roles in KINDS], dtype=f"U{max(length, 30)}")
    kind = to_kinds(texts, "kind")
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
    assert (
        to_kinds([], "kind").shape
        == without_science(kind[:0]).shape
        == without_role(kind[:0], "sky", True).shape
        == (0,)
    )
    others = np.array(["", "star", "Sky+Science", "standard"])
    assert to_kinds(others, "kind", strict=False).tolist() == ["", "star", "science+sky", "standard"]


def test_the_length_of_the_text_remains_the_same():
    """Equal catalogs have the same digest, which depends on the length of the text."""
    assert to_kinds(np.array(["sky"], dtype="U12"), "kind").dtype == "U12"
    assert to_kinds(np.array(["standard+science"], dtype="U16"), "kind").dtype == "U16"


@pytest.mark.parametrize("kind", ["star", "", "science+star", "science+", "+", 1])
def test_other_kinds_are_refused(kind):
    with pytest.raises(
        rs.InputError, match=r"kind must be science, standard or sky, or several of them joined by '\+'"
    ):
        rs.Catalog(rs.synthetic_catalog("uniform", "6h +0d", 1 * u.deg, n_targets=1, rng=1).coord, kind=[kind])


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
    both = int((kinds == "science+standard").sum())
    counts = tile.summary["kinds"]
    assert counts["standard"]["n_assigned"] == both + (kinds == "standard").sum()
    assert counts["science"]["n_assigned"] == both + (kinds == "science").sum()
    assert counts["standard"]["n_also_science"] == both >= 6
    plain = rs.plan_tile(replace_kind(catalog), small, "8h +30d", allocator="optimal")
    assert counts["science"]["n_assigned"] == plain.summary["n_assigned"]  # the requirement costs no science target
    score = rs.score_tile(tile.table, small, constraints=["standard=6", f"standard=-{both - 1}"])
    assert [one["verdict"] for one in score.rules] == ["pass", "fail"]
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


def test_collision_probabilities_use_science_targets_with_other_roles(small):
    sky = rs.synthetic_catalog("uniform", "8h +30d", 0.3 * u.deg, n_targets=90, rng=1).coord
    kind = np.where(np.arange(90) % 3, "science+standard", "science")
    found = [
        rs.collision_probability(small, targets=rs.Catalog(sky, kind=one), center="8h +30d") for one in (kind, None)
    ]
    assert found[0].value == found[1].value > 0


def test_unset_visits_of_a_science_target_with_other_roles_have_a_warning():
    table = Table({"ra": [1.0, 2.0], "dec": [0.0, 0.0], "kind": ["sky", "science+standard"], "NUMOBS_INIT": [-1, -1]})
    with pytest.warns(rs.RfpsurveyWarning, match="negative"):
        rs.Catalog.from_table(table)


def test_formats_with_one_role_keep_the_last_one():
    assert last_role(np.array(["science", "science+standard", "standard+sky", ""])).tolist() == [
        *("science", "standard", "sky", "")
    ]


def replace_kind(catalog):
    """Return the science targets of a catalog, without other roles."""
    return rs.Catalog(catalog.coord[np.char.find(catalog.kind, "science") >= 0])
