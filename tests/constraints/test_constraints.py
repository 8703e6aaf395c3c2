"""Constraints as objects and as text, their short forms in options, and their records."""

import pickle
from dataclasses import dataclass, replace

import astropy.units as u
import numpy as np
import pytest
from raising import refused

import rfpsurvey as rs
from rfpsurvey._assignment.constraints.constraint import AS_GOAL, EXACTLY, ONLY_CHECKED, Abilities
from rfpsurvey._assignment.constraints.text import BUILT_IN, find_constraints
from rfpsurvey.constraints import as_constraints

CIRCLE = rs.Region.parse("cap 95 23 0.01")


@dataclass(frozen=True)
class Faint(rs.constraints.Constraint):
    limit: float
    column: str = "mag"

    name = "faint"

    def excluded(self, field):
        return field.column(self.column) < self.limit


WRITTEN_FORMS = [
    ("sky=20/spectrograph", rs.Requirement),
    ("required 4711", rs.Required),
    ("required 'star 7' b", rs.Required),
    ("keep_out 95.0 23.0 0.01", rs.KeepOut),
    ("keep_out 95.0 23.0 0.01 96.5 -23.0 0.02", rs.KeepOut),
]


@pytest.mark.parametrize(("text", "kind"), WRITTEN_FORMS)
def test_constraints_are_read_as_they_are_written(text, kind):
    (one,) = as_constraints(text)
    assert (type(one), str(one)) == (kind, text)
    (again,) = as_constraints([one])
    assert again is one
    assert str(pickle.loads(pickle.dumps(one))) == text
    assert str(as_constraints("keep_out 95.0,23.0,0.01")[0]) == "keep_out 95.0 23.0 0.01"


def test_a_category_may_have_the_name_of_a_constraint():
    for given in ({"requirements": "required=3"}, {"constraints": "'required'=3"}):
        (one,) = rs.AllocationOptions(**given).requirements
        assert (one.what, one.minimum, str(one)) == ("required", 3, "'required'=3")
    (one,) = as_constraints("required a=5 b@c=6")  # identifiers can contain these signs
    assert one.ids == ("a=5", "b@c=6")


@pytest.mark.parametrize("what", ["QSO/LyA", "a=b", "a@b", "keep_out", "two words", "required a", "z<2", "it's"])
@pytest.mark.parametrize("others", [{}, {"fiber_type": "BOSS"}, {"per": "spectrograph", "maximum": 7}])
def test_the_text_of_a_requirement_is_read_again(what, others):
    """Regression: the text of a category with special characters could not be read again."""
    one = rs.Requirement(what, 3, **others)
    (again,) = as_constraints(str(one))
    assert again == one


@pytest.mark.parametrize("empty", [None, [], ()])
def test_constraints_without_an_argument_are_refused(empty):
    """Regression: the text of these constraints could not be read again."""
    refused("required targets must have at least one identifier, got", rs.Required, empty)
    refused("keep_out must contain at least one circle, got", rs.KeepOut, empty)


WRONG_FORMS = [
    ("keep_out 95 23", "keep_out must have the form 'keep_out RA DEC RADIUS'"),
    ("keep_out", "keep_out must have the form 'keep_out RA DEC RADIUS'"),
    ("keep_out 95 99 1", "declinations must lie between -90 and 90 deg"),
    ("keep_out a b c", "keep_out must have the form"),
    ("required", "required must have the form 'required ID ...'"),
    ("required 'a", "No closing quotation"),
    ("keepout 95 23 1", f"unknown constraint 'keepout'; choose one of: {', '.join(sorted(BUILT_IN)[:2])},"),
    ("sky", "unknown constraint 'sky'"),
    ("", "unknown constraint ''"),
    ("sky=x", "a requirement must have a form such as"),
    ("required=1003", "the constraint 'required' must have a space after its name, got 'required=1003'"),
    ("keep_out@BOSS=3-7/spectrograph", "the text of the constraint 'keep_out' must have a space after its name"),
    ("required=star7", "the text of the constraint 'required' must have a space after its name"),
    ([3], "a constraint must be a Constraint or text"),
    (3, "constraints must be a list of constraints or text, got 3"),
]


@pytest.mark.parametrize(("wrong", "words"), WRONG_FORMS)
def test_anything_else_causes_an_error(wrong, words):
    refused(words, rs.AllocationOptions, constraints=wrong)


def test_fields_of_a_constraint_are_read_with_their_types():
    assert (Faint.parse("17.5"), Faint.parse("17 'g mag'")) == (Faint(17.5), Faint(17.0, "g mag"))
    assert str(Faint(17.0, "g mag")) == "faint 17.0 'g mag'"
    for text in ("", "x", "1 a b", "1 'a"):
        refused("must have the form 'faint LIMIT COLUMN', got", Faint.parse, text)


def test_short_forms_and_constraints_are_the_same_options():
    texts = ["sky=2", "required 7 8", "keep_out 95.0 23.0 0.01"]
    short = rs.AllocationOptions("optimal", requirements="sky=2", required=["7", "8"], keep_out=CIRCLE)
    full = rs.AllocationOptions("optimal", constraints=texts)
    assert full.record == short.record
    assert "constraints" not in full.record
    assert [str(one) for one in full.all_constraints] == [str(one) for one in short.all_constraints] == texts
    assert full.requirements == full.counts == (rs.Requirement("sky", 2),)
    assert full.required == full.required_ids == ("7", "8")
    both = rs.AllocationOptions("optimal", requirements="standard=1", constraints=texts)
    assert [str(one) for one in both.counts] == ["standard=1", "sky=2"]


def test_replaced_options_keep_or_drop_each_constraint_once():
    options = rs.AllocationOptions("optimal", constraints=["sky=2", "keep_out 95 23 0.01", Faint(17)])
    assert (options.record["constraints"], options.record["requirements"]) == (["faint 17 mag"], ["sky=2"])
    assert replace(options, allocator="lamost_rule").all_constraints == options.all_constraints
    assert replace(options, keep_out=()).all_constraints == (rs.Requirement("sky", 2), Faint(17))
    assert replace(options, requirements=()).counts == ()
    assert options.without("counts").all_constraints[-1] == Faint(17)
    assert replace(options, constraints="sky=3").counts == (rs.Requirement("sky", 2), rs.Requirement("sky", 3))
    lamost = rs.Instrument.preset("lamost")
    options = rs.AllocationOptions(requirements="instrument", constraints="standard=3").for_instrument(lamost)
    assert [str(one) for one in options.requirements] == [*lamost.requirements, "standard=3"]


@pytest.mark.parametrize("one", ["required 4", "keep_out 95 23 1", Faint(17)])
def test_constraints_on_the_sky_require_a_catalog(one):
    plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm))
    with pytest.raises(rs.InputError, match="can be used only with .*; use plan_tile"):
        rs.allocate(plane, [[1, 1]] * u.mm, allocator=rs.AllocationOptions(constraints=one))


def test_a_constraint_states_how_methods_honor_it():
    able = Abilities(EXACTLY, AS_GOAL, ONLY_CHECKED)
    keep_out, required, count = as_constraints(["keep_out 95 23 1", "required 4", "sky=1"])
    assert [one.honored(able) for one in (keep_out, required, count)] == [EXACTLY, AS_GOAL, ONLY_CHECKED]
    assert Faint(17).honored(Abilities()) == EXACTLY


def test_a_file_in_the_package_is_all_that_a_constraint_requires(tmp_path, monkeypatch):
    (tmp_path / "rules").mkdir()
    (tmp_path / "rules" / "one.py").write_text(
        "from rfpsurvey.constraints import Constraint, KeepOut\nclass One(Constraint):\n    name = 'one'\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert [*find_constraints("rules", tmp_path / "rules")] == ["one"]
    assert BUILT_IN["keep_out"] is rs.KeepOut
    assert all(getattr(rs.constraints, kind.__name__) is kind for kind in BUILT_IN.values())
    assert {"keep_out", "magnitude", "motion", "required"} <= {*BUILT_IN}
    for name, constraint in BUILT_IN.items():
        assert name == constraint.name
        assert getattr(rs.constraints, constraint.__name__) is constraint


def test_targets_near_directions_are_found():
    vectors, none = np.array([[1, 0, 0], [np.cos(0.1), np.sin(0.1), 0], [np.nan] * 3]), np.zeros(3)
    field = rs.constraints.ConstraintField(None, None, vectors, none, none, none, none, none, none, {})
    assert field.is_near(vectors[:1], 0.11).tolist() == [True, True, False]
    assert field.is_near(vectors[:1], 0.09).tolist() == [True, False, False]
    assert field.is_near(vectors[2:], 1).tolist() == [False] * 3
    assert field.is_near(vectors[:0], 1).tolist() == [False] * 3
    refused("the catalog must have the column 'mag', but its further columns are", field.column, "mag")
