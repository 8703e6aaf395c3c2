"""Descriptions in TOML files that inherit from a preset and select another published shape of its arms."""

import pytest
from raising import refused

import rfpsurvey as rs

TOP = 'name = "mine"\nstatus = "assumed"\nsource = "own"\n'
OWN = '[positioner.outline]\nunit = "mm"\nvalue.eccentric = [{ vertices = [[-1, -1], [8, -1], [8, 1], [-1, 1]] }]\n'


def mine(tmp_path, parent, name="mine", extra="", **entries):
    """Read a description that inherits from another one; ``entries`` are entries of the positioner as TOML."""
    lines = "".join(f"{key} = {{ {value} }}\n" for key, value in entries.items())
    path = tmp_path / f"{name}.toml"
    path.write_text(f'{TOP}inherits = "{parent}"\n[positioner]\n{lines}{extra}')
    return rs.Instrument.read(path)


def shape_of(instrument):
    """Return everything that determines the collisions of an arm."""
    unit = instrument.focal_plane.positioner
    outline = None if unit.outline is None else unit.outline.to_dict()
    angle = unit.arm_angle and {name: str(value) for name, value in unit.arm_angle.items()}
    return unit.arm_model, str(unit.min_separation), unit.clearance.to_value("mm"), unit.arm_length, angle, outline


REPLACED_MODELS = [
    ("desi", "outline"),
    ("desi", "elbow_to_tip"),
    ("desi", "fiber_tip"),
    ("sdss_apo", "capsule"),
    ("sdss_apo", "elbow_to_tip"),
    ("sdss_apo", "fiber_tip"),
    ("lamost", "fiber_tip"),
]


@pytest.mark.parametrize(("preset", "model"), REPLACED_MODELS)
def test_the_arm_model_of_a_preset_is_replaced_as_in_python(tmp_path, presets, preset, model):
    found = mine(tmp_path, preset, arm_model=f'value = "{model}"')
    assert shape_of(found) == shape_of(presets[preset].with_arm_model(model))
    assert found.values["positioner.arm_model"] == {"value": model, "status": "assumed", "source": "own"}
    assert set(found.arm_models) == set(presets[preset].with_arm_model(model).arm_models)


def test_entries_of_the_file_have_precedence(tmp_path, presets):
    length = 'value = 1.2, unit = "mm"'
    for name in ("clearance", "segment_clearance"):
        found = mine(tmp_path, "desi", arm_model='value = "elbow_to_tip"', **{name: length})
        assert found.focal_plane.positioner.clearance.to_value("mm") == 1.2
    found = mine(tmp_path, "desi", arm_model='value = "capsule"', arm_length='value = 3.5, unit = "mm"')
    assert shape_of(found)[:4] == ("capsule", "1.98 mm", 0.99, found.focal_plane.positioner.arm_length)
    found = mine(tmp_path, "sdss_apo", arm_model='value = "outline"', extra=OWN)
    assert found.focal_plane.positioner.outline.n_eccentric == 1
    assert found.focal_plane.positioner.clearance.to_value("mm") == 2


def test_a_chain_of_files_can_return_to_the_outline(tmp_path, presets):
    mine(tmp_path, "desi", "segments", arm_model='value = "elbow_to_tip"', clearance='value = 1.2, unit = "mm"')
    found = mine(tmp_path, "segments", "again", arm_model='value = "outline"')
    assert shape_of(found) == shape_of(presets["desi"])
    assert found.with_arm_model("fiber_tip").focal_plane.positioner.clearance.to_value("mm") == 1.2


MISSING_SHAPES = [
    ("lamost", "outline", "outline must be given for the arm model 'outline'"),
    ("desi", "capsule", "arm_length must be given for the arm model 'capsule'"),
    ("desi", "square", "positioner.arm_model must be one of elbow_to_tip, .*, outline, got 'square'"),
]


@pytest.mark.parametrize(("preset", "model", "text"), MISSING_SHAPES)
def test_shapes_that_are_not_there_are_refused(tmp_path, preset, model, text):
    refused(rf"mine\.toml: {text}", mine, tmp_path, preset, arm_model=f'value = "{model}"')


@pytest.mark.parametrize("entry", ["3", '"outline"', "{ status = 'assumed' }", "[]"])
def test_a_malformed_entry_is_refused(tmp_path, entry):
    path = tmp_path / "mine.toml"
    path.write_text(f'{TOP}inherits = "desi"\n[positioner]\narm_model = {entry}\n')
    refused(r"mine\.toml: positioner\.arm_model must", rs.Instrument.read, path)
