"""Each entry of an instrument's description: its type, range and unit."""

import re

import pytest

import rfpsurvey as rs
from rfpsurvey.instrument._entries import ENTRIES, NEED, check_description
from rfpsurvey.positioner import Positioner

BASE = """
schema = 1
name = "mine"
[positioner]
central_arm = { value = 3.0, unit = "mm", status = "assumed", source = "s" }
eccentric_arm = { value = 5.0, unit = "mm", status = "assumed", source = "s" }
clearance = { value = 1.0, unit = "mm", status = "assumed", source = "s" }
[layout]
rings = { value = 2, status = "assumed", source = "s" }
pitch = { value = 12.0, unit = "mm", status = "assumed", source = "s" }
[optics]
plate_scale = { value = 60.0, unit = "um / arcsec", status = "assumed", source = "s" }
[observing]
targets_per_fiber = { value = 2.0, status = "assumed", source = "s" }
"""


def with_entry(section, name, text):
    """Return the description with another entry."""
    lines = [line for line in BASE.splitlines() if not line.startswith(f"{name} =")]
    where = lines.index(f"[{section}]") if section else 0
    return "\n".join([*lines[: where + 1], f"{name} = {text}", *lines[where + 1 :]])


def refused(folder, text):
    path = folder / "mine.toml"
    path.write_text(text)
    with pytest.raises(rs.InputError) as caught:
        rs.Instrument.read(path)
    assert str(caught.value).startswith(f"{path}: ")
    return str(caught.value).removeprefix(f"{path}: ")


def figure(value, unit=None):
    unit = f', unit = "{unit}"' if unit else ""
    return f'{{ value = {value}{unit}, status = "assumed", source = "s" }}'


def test_the_base_is_good(tmp_path):
    (tmp_path / "mine.toml").write_text(BASE)
    assert len(rs.Instrument.read(tmp_path / "mine.toml").focal_plane) == 19


@pytest.mark.parametrize(
    ("entry", "text", "message"),
    [
        ("layout.pitch", figure("true", "mm"), "layout.pitch must be a length above 0, got True mm"),
        ("layout.pitch", figure("inf", "mm"), "layout.pitch must be a length above 0, got inf mm"),
        ("layout.pitch", figure("12.0"), "the unit of layout.pitch must be convertible to mm, got no such entry"),
        ("layout.pitch", figure("12.0", "deg"), "the unit of layout.pitch must be convertible to mm, got 'deg'"),
        ("layout.pitch", "3", "layout.pitch must be a table with value, status and source, got 3"),
        ("layout.pitch", "{ value = 3 }", "layout.pitch must have a status, got only value"),
        ("layout.pitch", figure("12.0", "mm")[:-1] + ", note = 1 }", "unknown part of layout.pitch 'note'"),
        ("layout.spectrographs", figure(-1), "spectrographs must be a whole number from 1 to 1000000, or 'one a"),
        ("layout.spectrographs", figure("true"), "layout.spectrographs must be a whole number"),
        ("layout.rings", figure("true"), "layout.rings must be a whole number from 0 to 500, got True"),
        ("layout.rings", figure(2, "mm"), "layout.rings must have no unit, got 'mm'"),
        ("layout.count", figure("1e3"), "layout.count must be a whole number from 1 to 1000000, got 1000.0"),
        ("layout.vacant_cells", figure("[[1]]"), "must be a list of pairs of whole numbers, got [[1]]"),
        ("layout.vacant_cells", figure("[[1, 2.0]]"), "must be a list of pairs of whole numbers"),
        ("layout.fiber_types", figure("[1]"), "layout.fiber_types must be a list of names, got [1]"),
        ("layout.fiber_types", figure('"A"'), "layout.fiber_types must be a list of names, got 'A'"),
        ("layout.rows_along", figure('"z"'), "layout.rows_along must be one of x, y, got 'z'"),
        ("layout.names", figure("1"), "layout.names must be one of row and column, got 1"),
        ("layout.table", figure("1"), "layout.table must be text, got 1"),
        ("positioner.home", figure("[1.0]", "deg"), "positioner.home must be two angles, got [1.0] deg"),
        ("positioner.home", figure("3", "deg"), "positioner.home must be two angles, got 3 deg"),
        ("positioner.handedness", figure("[]"), "positioner.handedness must be one of right, left, both, got []"),
        ("positioner.arm_angle", figure("{ A = true }", "deg"), "an angle, or a table of a fiber type to an angle"),
        ("positioner.central_arm", figure('"3"', "mm"), "positioner.central_arm must be a length above 0, got '3' mm"),
        ("positioner.clearance", figure(-1, "mm"), "positioner.clearance must be a length of at least 0, got -1 mm"),
        ("optics.radial_map", figure("3"), "optics.radial_map must be a table of a fiber type, or any, to a table"),
        ("optics.radial_map", figure("{ any = { form = 1, coefficients = [1] } }"), "radial_map must be a table"),
        ("optics.radial_map", figure('{ any = { form = "theta", coefficients = 1 } }'), "optics.radial_map must be"),
        ("optics.factor", figure(0), "optics.factor must be a number above 0, got 0"),
        ("optics.max_angle", figure("true", "deg"), "optics.max_angle must be an angle above 0, got True deg"),
        ("observing.targets_per_fiber", figure("-1"), "observing.targets_per_fiber must be a number above 0, got -1"),
        ("observing.sky", figure("2.5"), "observing.sky must be a whole number from 0 to 1000000, got 2.5"),
        ("observing.skies", figure("2"), "unknown entry of [observing] 'skies'"),
        (".schema", "true", "schema must be 1, the only one that this version reads, got True"),
        (".name", "3", "name must be text, got 3"),
        (".title", "3", "title must be text, got 3"),
        (".notes", "[]", "notes must be text, got []"),
        (".inherits", "3", "inherits must be the name of another description, got 3"),
        (".sources", "3", "sources must be a table of texts, got 3"),
    ],
)
def test_an_entry_that_is_not_what_it_must_be(tmp_path, entry, text, message):
    """The sentence was "lacks or misuses 'int' object is not iterable", or the value was taken."""
    section, _, name = entry.rpartition(".")
    assert message in refused(tmp_path, with_entry(section, name, text))


@pytest.mark.parametrize("name", [*ENTRIES, "observing.boss_sky_per_spectrograph"])
@pytest.mark.parametrize("value", ["true", "nan", '""', "[]", "{}", "-1e300", "[[true]]", "2026-01-01"])
def test_no_entry_takes_what_is_of_another_kind(tmp_path, name, value):
    """Each entry, with values that hardly any of them may have."""
    section, _, own = name.rpartition(".")
    if value == "[]" and name.endswith("_cells"):
        return  # an empty list of cells is one
    unit = getattr(ENTRIES.get(name), "unit", None)
    assert own in refused(tmp_path, with_entry(section, own, figure(value, unit)))


@pytest.mark.parametrize("section", ["positioner", "layout", "optics", "observing"])
def test_a_section_must_be_a_table(section):
    with pytest.raises(rs.InputError, match=f"{section} must be a table, got 3"):
        check_description({"name": "a", section: 3})


def test_the_table_of_entries_is_complete():
    """Each argument of a positioner can be described."""
    own = {name.partition(".")[2] for name in ENTRIES if name.startswith("positioner.")}
    assert own == set(Positioner.__dataclass_fields__)
    assert NEED.fullmatch("observing.boss_sky")
    assert all(re.fullmatch(r"[a-z]+\.[a-z_]+", name) for name in ENTRIES)
