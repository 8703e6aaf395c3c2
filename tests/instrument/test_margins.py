from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from raising import refused

import rfpsurvey as rs

CENTER = SkyCoord("6h20m +23d")
TOML = """
name = "mine"
inherits = "lamost"

[margins]
outer = { value = 250, unit = "um", status = "assumed", source = "a study" }
broken_factor = { value = 0.5, status = "assumed", source = "a study" }
"""


def small(name):
    """Return an instrument with the positioners of a preset that are nearest to the axis."""
    model = rs.Instrument.preset(name)
    xy = model.focal_plane.xy.value
    plane = rs.FocalPlane(xy[np.argsort(np.hypot(*xy.T))[:60]] * u.mm, model.focal_plane.positioner)
    return replace(model, focal_plane=plane, plate_scale=None)


def test_published_margins():
    """The values of the sources: fiberassign, and programs of PFS."""
    published = {name: rs.Instrument.preset(name).published_margins.record for name in rs.available_instruments()}
    assert published["desi"] == {"outer_mm": 0.2, "inner_mm": 0.1, "arms_mm": 0.05}
    assert published["pfs"] == {"outer_mm": 0.1, "inner_mm": 0.1, "broken_factor": 1.0, "hidden_factor": 1.65}
    assert not any(published[name] for name in ("lamost", "moons", "sdss_apo", "sdss_lco"))
    for name, entry in rs.Instrument.preset("desi").values.items():
        assert not name.startswith("margins.") or entry["status"] == "published"


def test_margins_are_off_by_default():
    model = rs.Instrument.preset("desi")
    assert not model.focal_plane.margins
    assert "margins" not in model.provenance
    assert not any(name.startswith("margins") for name in model.provenance["values"])
    without = replace(model, values={k: v for k, v in model.values.items() if not k.startswith("margins")})
    assert without.provenance == model.provenance


def test_margins_of_an_instrument():
    model = rs.Instrument.preset("desi")
    on, own = model.with_margins(), model.with_margins(outer=0.2 * u.mm, inner=0.1 * u.mm, arms=0.05 * u.mm)
    assert on.focal_plane.margins == own.focal_plane.margins == model.published_margins
    assert on.provenance == own.provenance
    assert on.provenance["digest"] != model.provenance["digest"]
    assert on.provenance["margins"] == {"outer_mm": 0.2, "inner_mm": 0.1, "arms_mm": 0.05}
    assert on.facts()["min_separation"] == 0.1 * u.mm
    assert on.facts()["coverage"] < model.facts()["coverage"]
    assert on.with_margins(outer=0 * u.mm).provenance == model.provenance
    assert on.with_arm_model("elbow_to_tip").focal_plane.margins == own.focal_plane.margins
    refused("must contain margins, got none for lamost", lambda: rs.Instrument.preset("lamost").with_margins())


def test_margins_in_a_description(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(TOML)
    model = rs.Instrument.read(path)
    assert not model.focal_plane.margins
    assert model.with_margins().focal_plane.margins.record == {"outer_mm": 0.25, "broken_factor": 0.5}
    path.write_text(TOML.replace("250", "-1"))
    refused("margins.outer must be a length of at least 0, got -1 um", rs.Instrument.read, path)


def test_a_tile_states_its_margins(tmp_path):
    model = small("desi")
    sky = rs.synthetic_catalog("uniform", CENTER, model.field_radius, n_targets=300, rng=1)
    plain, tile = (rs.plan_tile(sky, one, CENTER, allocator="repair") for one in (model, model.with_margins()))
    assert tile.summary["margins"] == "outer 0.2 mm, inner 0.1 mm, arms 0.05 mm"
    assert tile.summary["model"].endswith(
        "Margins: 0.2 mm from the outer edges of patrol areas, 0.1 mm from the inner edges of patrol areas, 0.05 mm "
        "around each arm."
    )
    assert "margins" not in plain.summary
    assert "Margins" not in plain.summary["model"]
    assert tile.summary["n_reachable"] < plain.summary["n_reachable"]
    assert tile.provenance["instrument"]["margins"] == {"outer_mm": 0.2, "inner_mm": 0.1, "arms_mm": 0.05}
    tile.write(tmp_path / "tile.fits")
    assert rs.Tile.read(tmp_path / "tile.fits").summary == tile.summary
    rs.write_report(tile, tmp_path / "tile.html")
    assert "outer 0.2 mm, inner 0.1 mm, arms 0.05 mm" in (tmp_path / "tile.html").read_text()


def test_a_score_counts_the_targets_within_the_margins():
    """The count is that of the targets nearer to an edge than the margin, from their distances in the table."""
    model = small("desi")
    sky = rs.synthetic_catalog("uniform", CENTER, model.field_radius, n_targets=300, rng=1)
    tile = rs.plan_tile(sky, model, CENTER, allocator="nearest")
    used = tile.table[tile.table["status"] == "assigned"]
    r = np.hypot(used["tip_x"] - used["x"], used["tip_y"] - used["y"]).to_value(u.mm)
    n_near = int(((r > 6 - 0.4) | (r < 0.8)).sum())
    scored = rs.score_tile(tile.table, model.with_margins(outer=0.4 * u.mm, inner=0.8 * u.mm), positions="focal_plane")
    assert scored.summary["n_within_margins"] == n_near > 2
    assert scored.summary["n_assigned"] == len(used)
    assert "n_within_margins" not in rs.score_tile(tile.table, model, positions="focal_plane").summary


def test_surveys_and_tilings_state_their_margins(tmp_path):
    model = small("desi")
    margined = model.with_margins(outer=0.5 * u.mm)
    sky = rs.synthetic_catalog("uniform", CENTER, 1.2 * model.field_radius, n_targets=400, rng=1)
    tiles = SkyCoord([CENTER, CENTER.directional_offset_by(30 * u.deg, 0.05 * u.deg)])
    plain, survey = (rs.plan_survey(sky, one, tiles) for one in (model, margined))
    assert survey.summary["margins"] == "outer 0.5 mm"
    assert "margins" not in plain.summary
    assert survey.summary["n_visits_observed"] < plain.summary["n_visits_observed"]
    joint = rs.plan_survey(sky, margined, tiles, allocator="joint")
    assert joint.summary["margins"] == "outer 0.5 mm"
    assert survey.summary["n_visits_observed"] <= joint.summary["n_visits_observed"]
    for k, center in enumerate(tiles):
        visits = joint.tile(k)
        xy = sky[np.searchsorted(sky.id, visits["target_id"])].coord
        tips = margined.projection(center).to_focal_plane(xy)
        rows = np.searchsorted(margined.focal_plane.id, visits["positioner"])
        assert np.hypot(*(tips - margined.focal_plane.xy[rows]).T).max() <= 5.5 * u.mm
    chances = rs.selection_probabilities(sky, margined, tiles, 8)
    assert "Margins: 0.5 mm from the outer edges" in chances.summary["model"]
    tiling = rs.place_tiles(sky, margined, allocator="lamost_rule", method="max_density", n_tiles=1)
    assert tiling.summary["margins"] == "outer 0.5 mm"


def test_a_survey_with_other_margins_is_not_resumed(tmp_path):
    model = small("desi")
    sky = rs.synthetic_catalog("uniform", CENTER, model.field_radius, n_targets=100, rng=1)
    rs.plan_survey(sky, model, SkyCoord([CENTER]), folder=tmp_path / "survey")
    with pytest.raises(rs.InputError, match="instrument"):
        rs.plan_survey(sky, model.with_margins(), SkyCoord([CENTER]), folder=tmp_path / "survey", resume=True)


def test_as_built_instruments_keep_the_published_margins(real_data):
    built = rs.Instrument.read(real_data("desi/fp-metrology.csv.gz"))
    assert built.with_margins().focal_plane.margins == rs.Instrument.preset("desi").published_margins
    pfs = rs.Instrument.read(real_data("pfs/black_dots_mm-2024-11-05.csv.gz"))
    pfs, plane = pfs.with_margins(), pfs.focal_plane
    dots = plane.hidden.to_value(u.mm)
    edge = dots[:, :2] + np.column_stack([dots[:, 2] * 1.6, 0 * dots[:, 2]])
    assert pfs.focal_plane.arrays.is_hidden(edge).all()
    assert plane.arrays.is_hidden(edge).mean() < 0.01
