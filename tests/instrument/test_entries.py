"""Types, ranges and units of all entries in the description of an instrument."""

import re

import pytest

import rfpsurvey as rs
from rfpsurvey._instruments.entries import ENTRIES, NEED, check_description
from rfpsurvey.positioner import JointMotion, Positioner

BASE = """
schema = 1
name = "mine"
[positioner]
central_arm = { value = 3.0, unit = "mm", status = "assumed", source = "s" }
eccentric_arm = { value = 5.0, unit = "mm", status = "assumed", source = "s" }
clearance = { value = 1.0, unit = "mm", status = "assumed", source = "s" }
[margins]
outer = { value = 0.2, unit = "mm", status = "assumed", source = "s" }
[motion]
theta_speed = { value = 12.0, unit = "deg / s", status = "assumed", source = "s" }
[layout]
rings = { value = 2, status = "assumed", source = "s" }
pitch = { value = 12.0, unit = "mm", status = "assumed", source = "s" }
[optics]
plate_scale = { value = 60.0, unit = "um / arcsec", status = "assumed", source = "s" }
[observing]
targets_per_fiber = { value = 2.0, status = "assumed", source = "s" }
[light]
band = { value = [0.4, 1.0], unit = "um", status = "assumed", source = "s" }
[night]
overhead = { value = 100.0, unit = "s", status = "assumed", source = "s" }
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


WRONG_ENTRIES = [
    ("layout.pitch", figure("true", "mm"), "layout.pitch must be a length above 0, got True mm"),
    ("layout.pitch", figure("inf", "mm"), "layout.pitch must be a length above 0, got inf mm"),
    ("layout.pitch", figure("12.0"), 'the unit of layout.pitch must be convertible to mm, got none; write unit = "mm"'),
    ("layout.pitch", figure("12.0", "deg"), "the unit of layout.pitch must be convertible to mm, got 'deg'"),
    ("layout.pitch", "3", "layout.pitch must be a table with value, status and source, got 3"),
    ("layout.pitch", "{ value = 3 }", "layout.pitch must have a status, got only value"),
    ("layout.pitch", figure("12.0", "mm")[:-1] + ", note = 1 }", "unknown key of layout.pitch 'note'"),
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
    ("layout.names", figure("1"), "layout.names must be one of row and column, cobra, got 1"),
    ("layout.table", figure("1"), "layout.table must be text, got 1"),
    ("positioner.home", figure("[1.0]", "deg"), "positioner.home must be two angles, got [1.0] deg"),
    ("positioner.home", figure("3", "deg"), "positioner.home must be two angles, got 3 deg"),
    ("motion.phi_range", figure("[180, 0]", "deg"), "first is below the second, got [180, 0] deg"),
    ("motion.theta_range", figure("[0, 0]", "deg"), "motion.theta_range must be two angles, of which the first is"),
    ("motion.theta_range", figure("[0, 1]", "mm"), "motion.theta_range must be convertible to rad, got 'mm'"),
    ("motion.theta_speed", figure("0", "deg / s"), "motion.theta_speed must be an angular speed above 0, got 0 deg"),
    ("motion.theta_speed", figure("nan", "deg / s"), "motion.theta_speed must be an angular speed above 0, got nan"),
    ("motion.phi_speed", figure("-1", "deg / s"), "motion.phi_speed must be an angular speed above 0, got -1 deg / s"),
    ("motion.phi_speed", figure("12", "deg"), "the unit of motion.phi_speed must be convertible to rad / s, got 'deg'"),
    ("motion.speed", figure("12", "deg / s"), "unknown entry of [motion] 'speed'"),
    ("positioner.handedness", figure("[]"), "positioner.handedness must be one of right, left, both, got []"),
    ("positioner.arm_angle", figure("{ A = true }", "deg"), "an angle, or a table with an angle for each fiber"),
    ("positioner.central_arm", figure('"3"', "mm"), "positioner.central_arm must be a length above 0, got '3' mm"),
    ("positioner.clearance", figure(-1, "mm"), "positioner.clearance must be a length of at least 0, got -1 mm"),
    ("optics.radial_map", figure("3"), "radial_map must be a table whose keys are fiber types "),
    ("optics.radial_map", figure("{ any = { form = 1, coefficients = [1] } }"), "radial_map must be a table"),
    ("optics.radial_map", figure('{ any = { form = "theta", coefficients = 1 } }'), "optics.radial_map must be"),
    ("optics.factor", figure(0), "optics.factor must be a number above 0, got 0"),
    ("optics.max_angle", figure("true", "deg"), "optics.max_angle must be an angle above 0, got True deg"),
    ("observing.targets_per_fiber", figure("-1"), "observing.targets_per_fiber must be a number above 0, got -1"),
    ("observing.sky", figure("2.5"), "observing.sky must be a whole number from 0 to 1000000, got 2.5"),
    ("layout.rings", "12", 'write { value = 12, status = "assumed", source = "..." }'),
    ("positioner.pitch", figure("12.0", "mm"), "must not have the entry 'pitch', which belongs in [layout]"),
    ("positioner.source", '"s"', "the entry 'source', which belongs at the top of the file, before all sections"),
    ("observing.sky_per_spectograph", figure("2"), "Did you mean 'sky_per_spectrograph'?"),
    (".sourse", '"s"', "Did you mean 'source'?"),
    (".status", '"rumored"', "status must be one of published, derived, assumed, got 'rumored'"),
    ("observing.skies", figure("2"), "unknown entry of [observing] 'skies'"),
    (".schema", "true", "schema must be 1, the only schema that this version of rfpsurvey reads, got True"),
    ("optics.radial_map", figure('{ any = { form = "theta", coefs = [1] } }'), "optics.radial_map must be"),
    (
        "layout.spectrographs",
        figure("20"),
        "spectrographs must be a number from 1 to the number of positioners, got 20",
    ),
    ("layout.rings", '{ value = 2, status = "assumed", source = 3 }', "the source of layout.rings must be text, got 3"),
    (".name", "3", "name must be text, got 3"),
    (".title", "3", "title must be text, got 3"),
    (".notes", "[]", "notes must be text, got []"),
    (".inherits", "3", "inherits must be the name of another description, got 3"),
    (
        ".sources",
        "3",
        "sources must be a table whose values are text (for a single text, write source instead of sources), got 3",
    ),
]


@pytest.mark.parametrize(("entry", "text", "message"), WRONG_ENTRIES)
def test_an_entry_that_is_not_what_it_must_be(tmp_path, entry, text, message):
    """Regression: the error message did not name the entry, or the invalid value was accepted."""
    section, _, name = entry.rpartition(".")
    assert message in refused(tmp_path, with_entry(section, name, text))


@pytest.mark.parametrize("name", [*ENTRIES, "observing.boss_sky_per_spectrograph"])
@pytest.mark.parametrize("value", ["true", "nan", '""', "[]", "{}", "-1e300", "[[true]]", "2026-01-01"])
def test_no_entry_takes_what_is_of_another_kind(tmp_path, name, value):
    """Give each entry values of types that few entries accept."""
    section, _, own = name.rpartition(".")
    if value == "[]" and name.endswith("_cells"):
        return  # an empty list is a valid list of cells
    unit = getattr(ENTRIES.get(name), "unit", None)
    assert own in refused(tmp_path, with_entry(section, own, figure(value, unit)))


def test_entries_that_every_description_must_have(tmp_path):
    without_name = "\n".join(line for line in BASE.splitlines() if not line.startswith("name"))
    assert refused(tmp_path, without_name) == "name must be text, got no such entry"
    without_arm = "\n".join(line for line in BASE.splitlines() if not line.startswith(("central_arm", "clearance")))
    assert refused(tmp_path, without_arm) == "[positioner] lacks central_arm, clearance"


@pytest.mark.parametrize("section", ["positioner", "margins", "motion", "layout", "optics", "observing"])
def test_a_section_must_be_a_table(section):
    with pytest.raises(rs.InputError, match=f"{section} must be a table, got 3"):
        check_description({"name": "a", section: 3})


def test_the_table_of_entries_is_complete():
    """The description can contain every argument of a positioner and of the motion of joints."""
    motion = {name.partition(".")[2] for name in ENTRIES if name.startswith("motion.")}
    assert motion == {*JointMotion.__dataclass_fields__}
    own = {name.partition(".")[2] for name in ENTRIES if name.startswith("positioner.")}
    assert own == {*Positioner.__dataclass_fields__, "full_outline", "segment_clearance"}
    assert NEED.fullmatch("observing.boss_sky")
    assert all(re.fullmatch(r"[a-z]+\.[a-z_]+", name) for name in ENTRIES)


SHORT = """
name = "mine"
source = "report"
status = "assumed"
[sources]
report = "Design report v3"
[positioner]
central_arm = { value = 3.0, unit = "mm" }
eccentric_arm = { value = 5.0, unit = "mm", status = "derived" }
clearance = { value = 1.0, unit = "mm", source = "the vendor" }
[layout]
rings = { value = 2 }
pitch = { value = 12.0, unit = "mm" }
[optics]
plate_scale = { value = 60.0, unit = "um / arcsec" }
"""


def test_one_source_and_one_status_hold_for_all_values_without_their_own(tmp_path):
    (tmp_path / "mine.toml").write_text(SHORT)
    values = rs.Instrument.read(tmp_path / "mine.toml").values
    assert {v["source"] for name, v in values.items() if name != "positioner.clearance"} == {"Design report v3"}
    assert values["positioner.clearance"]["source"] == "the vendor"
    assert {name for name, v in values.items() if v["status"] != "assumed"} == {"positioner.eccentric_arm"}
    assert values["positioner.eccentric_arm"]["status"] == "derived"


def test_without_a_source_the_message_says_that_one_at_the_top_is_enough(tmp_path):
    message = refused(tmp_path, SHORT.replace('source = "report"\n', ""))
    assert message.startswith("positioner.central_arm must have a source, got only ")
    assert message.endswith('; source = "..." at the top of the file applies to all entries without a source')


def test_the_source_of_a_file_does_not_hold_for_a_file_that_inherits_from_it(tmp_path):
    (tmp_path / "mine.toml").write_text(SHORT)
    text = 'name = "wider"\ninherits = "mine"\n[layout]\nrings = { value = 3 }\n'
    (tmp_path / "wider.toml").write_text(text)
    with pytest.raises(rs.InputError, match="layout.rings must have a status, got only value"):
        rs.Instrument.read(tmp_path / "wider.toml")
    (tmp_path / "wider.toml").write_text(f'source = "me"\nstatus = "derived"\n{text}')
    wider = rs.Instrument.read(tmp_path / "wider.toml")
    assert (len(wider.focal_plane), wider.values["layout.rings"]["source"]) == (37, "me")
    assert wider.values["layout.pitch"]["source"] == "Design report v3"
    assert wider.values["layout.pitch"]["status"] == "assumed"


def test_a_preset_can_be_inherited_from(tmp_path):
    text = 'name = "wide"\ninherits = "lamost"\nsource = "me"\nstatus = "assumed"\n'
    (tmp_path / "wide.toml").write_text(text + '[layout]\npitch = { value = 28, unit = "mm" }\n')
    wide = rs.Instrument.read(tmp_path / "wide.toml")
    assert (len(wide.focal_plane), wide.facts()["pitch"].value) == (4000, 28)
    (tmp_path / "wide.toml").write_text(text.replace('"lamost"', '"lamst"'))
    with pytest.raises(rs.InputError, match="inherits in .*: 'lamst'; choose one of: .* Did you mean 'lamost'"):
        rs.Instrument.read(tmp_path / "wide.toml")


def test_optics_and_layout_say_what_is_missing(tmp_path):
    assert refused(tmp_path, SHORT.split("[optics]")[0]).startswith("[optics] must have a plate_scale, or a radial_map")
    assert refused(tmp_path, SHORT.replace("rings = { value = 2 }", "")).startswith("[layout] must have a table, or a")
