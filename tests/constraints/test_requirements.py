"""Requirements given as text and as fields, and the sentences on missing fibers."""

import astropy.units as u
import pytest
from hypothesis import given
from hypothesis import strategies as st
from raising import refused

import flat
import rfpsurvey as rs
from rfpsurvey._assignment.constraints.counts import Shortfall, sentences

names = st.text(st.characters(codec="utf-8", exclude_characters="@=/<>\n", exclude_categories=("C", "Z")), min_size=1)


@st.composite
def requirements(draw):
    low = draw(st.integers(0, 10**6))
    high = draw(st.none() | st.integers(low, 10**6 + 1))
    per = draw(st.sampled_from(["tile", "spectrograph"]))
    return rs.Requirement(draw(names), low, high, per, draw(st.just("") | names))


@given(requirements())
def test_a_requirement_is_read_as_it_is_written(one):
    assert (rs.Requirement.parse(str(one)), rs.Requirement.parse(f"  {one} ")) == (one, one)
    assert repr(one) == f"Requirement({str(one)!r})"


TEXTS = [
    ("sky=20", ("sky", 20, None, "tile", "")),
    ("sky=20/spectrograph", ("sky", 20, None, "spectrograph", "")),
    ("sky=20/tile", ("sky", 20, None, "tile", "")),
    ("standard@BOSS=50-70", ("standard", 50, 70, "tile", "BOSS")),
    ("sky_boss=-300", ("sky_boss", 0, 300, "tile", "")),
    ("my own @x=007-7/spectrograph", ("my own", 7, 7, "spectrograph", "x")),
    (" sky = 3 - 4 / spectrograph", ("sky", 3, 4, "spectrograph", "")),
]


@pytest.mark.parametrize(("text", "fields"), TEXTS)
def test_text_says_what_the_fields_say(text, fields):
    one = rs.Requirement.parse(text)
    assert (one.what, one.minimum, one.maximum, one.per, one.fiber_type) == fields


OTHER_FORMS = ["", "sky", "sky=", "=3", " =3", "@BOSS=3", "sky=-", "sky=x", "sky=3.5", "sky=--3", "sky=3-4-5", "sky@=3"]
OTHER_FORMS += ["sky@a@b=3", "sky=3/", "a/b=3", "a=b=3", "sky=1e3", "sky=+3", "sky=3/spectrograph/x/", "sky=3-", 5]


@pytest.mark.parametrize("text", [*OTHER_FORMS, "sky=" + 5000 * "9"])
def test_text_of_another_form_is_an_error(text):
    form = "a requirement must have a form such as sky=20/spectrograph, standard@BOSS=50 or sky_boss=100-300, got "
    found = refused("", rs.Requirement.parse, text)
    assert found == form + repr(text) or (len(repr(text)) > 99 and found.startswith(form))


@pytest.mark.parametrize("text", ["science+standard=5/spectrograph", "Standard + science=5"])
def test_a_requirement_on_several_roles_is_an_error(text):
    """It was reported as missing, although there are such targets."""
    refused("must contain one role, got .*, such as science=5 and standard=5", rs.Requirement.parse, text)


WHAT = "a requirement must contain the name of a kind or category of targets, got"
PER = "per of 'sky' must be 'tile', 'spectrograph' or the name of a column, got"
IMPOSSIBLE_FIELDS = [
    *(((what,), f"{WHAT} {what!r}") for what in ("", " ", None)),
    *((("sky", n), f"minimum of 'sky' must be a whole number from 0 to 10^9, got {n}") for n in (-1, 1.0, True, None)),
    *((("sky", 0, n), f"maximum of 'sky' must be a whole number from 0 to 10^9, got {n!r}") for n in (-1, "9")),
    (("sky", 5, 4), "the minimum of the requirement on 'sky' must not exceed its maximum 4, got 5"),
    *((("sky", 5, None, per), f"{PER} {per!r}") for per in ("a/b", " ", None)),
]


@pytest.mark.parametrize(("arguments", "message"), IMPOSSIBLE_FIELDS)
def test_impossible_fields_are_named(arguments, message):
    assert refused("", rs.Requirement, *arguments) == message


def short(what="sky", place=None, requested=5, found=2, possible=9, **options):
    return Shortfall(what and rs.Requirement(what, 5, **options), place, requested, found, possible)


SHORTFALLS = [
    (short(), "sky targets: 2 of 5, 3 missing"),
    (short(possible=5), "sky targets: 2 of 5, 3 missing"),
    (short(possible=4), "sky targets: 2 of 5, 3 missing; only 4 are in reach"),
    (short(possible=1, found=1), "sky targets: 1 of 5, 4 missing; only 1 is in reach"),
    (short(possible=0, found=0), "sky targets: 0 of 5, 5 missing; none is in reach"),
    (short(found=7, place=3), "sky targets in spectrograph 3: 7, 2 more than the maximum of 5"),
    (short(fiber_type="BOSS", place=0), "sky targets for BOSS in spectrograph 0: 2 of 5, 3 missing"),
    (short(None, requested=3), "required targets: 2 of 3, 1 missing"),
]


@pytest.mark.parametrize(("one", "sentence"), SHORTFALLS)
def test_a_shortfall_is_a_sentence(one, sentence):
    assert str(one) == sentence
    assert sentences([one]) == [sentence]


def test_sentences_put_spectrographs_together():
    rows = [short(place=k, per="spectrograph") for k in range(16)]
    numbers, head = ", ".join(map(str, range(16))), "sky targets, 5 in each spectrograph:"
    assert sentences(rows) == [f"{head} 48 missing in 16 spectrographs ({numbers})"]
    rows.append(short(place=16, per="spectrograph"))
    assert sentences(rows) == [f"{head} 51 missing in 17 spectrographs ({numbers}, ...)"]
    few = [short(place=k, possible=2, per="spectrograph") for k in (4, 8)]
    assert sentences(few) == [f"{head} 6 missing in 2 spectrographs (4, 8); only 4 are in reach there"]
    none = [short(place=k, possible=0, found=0, per="spectrograph") for k in (4, 8)]
    assert sentences(none) == [f"{head} 10 missing in 2 spectrographs (4, 8); none is in reach there"]
    mixed = [short("standard"), *few, short(None)]
    assert sentences(mixed) == [str(mixed[0]), *sentences(few), str(mixed[-1])]
    much = [short(place=k, found=6, per="spectrograph") for k in (1, 2)]
    assert sentences([*much, *few]) == [*map(str, much), *sentences(few)]
    assert sentences([]) == []


@pytest.mark.parametrize(("what", "hint"), [("brihgt", "; did you mean 'bright'?"), ("sky", ""), ("zzz", "")])
def test_a_name_that_no_target_has_is_guessed_at(what, hint):
    plane = rs.FocalPlane([[0, 0]] * u.mm, rs.Positioner(8 * u.mm, 8 * u.mm, 2 * u.mm))
    found = flat.allocate(plane, [[1, 2]] * u.mm, "balanced", requirements=f"{what}=3", category=["bright"])
    assert [str(one) for one in found.unmet] == [f"{what} targets: 0 of 3, 3 missing; none is in reach{hint}"]
