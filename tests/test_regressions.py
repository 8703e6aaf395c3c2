"""Regression tests; each docstring describes the error that was corrected."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import Column, MaskedColumn, QTable, Table
from astropy.time import Time
from astropy.utils.masked import Masked

import rfpsurvey as rs
from rfpsurvey.collision import place_arms
from scenes import CENTER, MM, few


@pytest.mark.filterwarnings("ignore:.*with the same id as another target")
@pytest.mark.few(2)
@pytest.mark.parametrize("suffix", [".fits", ".ecsv"])
@pytest.mark.parametrize(
    "ids", [[f"star{k}" for k in range(20)], [""] * 20, np.arange(20, dtype=np.uint64), np.arange(20, dtype=np.int8)]
)
def test_scoring_a_written_tile_counts_idle_positioners_as_idle(small, tmp_path, suffix, ids):
    """Blank ids of a FITS table are not masked, and parked arms were counted as assigned.

    Unsigned integers could not be read.
    """
    tile, path = rs.plan_tile(few(id=ids), small, CENTER, allocator="lamost_rule"), tmp_path / f"tile{suffix}"
    tile.write(path)
    assert rs.Tile.read(path) == tile
    plain = QTable.read(path, **({"hdu": "TILE"} if ".fits" in path.name else {}))
    for table in (rs.Tile.read(path).table, plain):
        score = rs.score_tile(table, small)
        for key in ("n_assigned", "n_parked", "n_colliding", "collision_rate_assigned"):
            assert score.summary[key] == tile.summary[key]


def test_a_table_with_both_frames_is_read_in_the_one_asked_for():
    """In a table with both frames, right ascension was read as galactic longitude."""
    c = SkyCoord(266.4, -28.9, unit="deg")
    table = QTable({"ra": [c.ra], "dec": [c.dec], "l": [c.galactic.l], "b": [c.galactic.b]})
    for frame in ("icrs", "galactic"):
        assert rs.Catalog.from_table(table, frame=frame).coord.icrs.separation(c)[0].arcsec < 1e-6
    with pytest.raises(rs.InputError, match="there is no column for lon and lat of the frame 'galactic'"):
        rs.Catalog.from_table(table["ra", "dec"], frame="galactic")


def test_decimal_text_is_not_sexagesimal():
    """Decimal degrees in a text column were read as hours."""
    for table, units in (
        (Table({"ra": ["95.5"], "dec": ["23.0"]}), {"ra": "deg", "dec": "deg"}),
        (Table({"ra": Column(["95.5"], unit="deg"), "dec": Column(["23.0"], unit="deg")}), {}),
    ):
        assert rs.Catalog.from_table(table, units=units).coord.ra[0].deg == pytest.approx(95.5)
    with pytest.warns(rs.RfpsurveyWarning, match="assumed units are ra in deg, dec in deg"):
        catalog = rs.Catalog.from_table(Table({"ra": ["95.5"], "dec": ["23.0"]}))
    assert catalog.coord.ra[0].deg == pytest.approx(95.5)
    table = Table({"l": ["12:00:00"], "b": ["0:30:00"]})
    assert rs.Catalog.from_table(table, frame="galactic").coord.l[0].deg == pytest.approx(12)


def test_a_unit_that_contradicts_the_column_is_an_error():
    """The unit of the option replaced the unit of the column without an error."""
    table = QTable({"ra": [95.5] * u.deg, "dec": [23] * u.deg})
    with pytest.raises(rs.InputError, match="column 'ra' has the unit deg in the table, but the unit rad"):
        rs.Catalog.from_table(table, units={"ra": "rad"})
    with pytest.raises(rs.InputError, match="the value of units for ra must be a unit, got 'foo'"):
        rs.Catalog.from_table(table, units={"ra": "foo"})


def test_both_hands_with_arm_lengths_of_their_own():
    """The elbow was chosen with the arm lengths of the instrument instead of those of the positioner, against joint
    limits.
    """
    unit = rs.Positioner(5 * MM, 5 * MM, 1 * MM, handedness="both", phi_range=[0, 180] * u.deg)
    plane = rs.FocalPlane([[0, 0]] * MM, unit, central_arm=[8] * MM, eccentric_arm=[8] * MM)
    allocation = rs.allocate(plane, [[12, 0]] * MM, allocator="balanced")
    assert allocation.handedness.tolist() == ["right"]
    assert np.rad2deg(allocation.place_arms(plane).phi[0]) == pytest.approx(82.8, abs=0.1)


def test_scoring_chooses_the_elbows_that_planning_chose(small):
    """Scoring ignored joint limits when it chose the elbow of positioners with two possible elbows."""
    unit = replace(small.focal_plane.positioner, handedness="both", theta_range=[0, 200] * u.deg)
    instrument = replace(small, focal_plane=replace(small.focal_plane, positioner=unit))
    tile = rs.plan_tile(few(60), instrument, CENTER)
    without_angles = tile.table.copy()
    without_angles.remove_columns(["theta", "phi"])
    has_target = tile.table["status"] == "assigned"
    for table in (tile.table, without_angles):
        score = rs.score_tile(table, instrument)
        for name in ("theta", "phi"):
            angles = score.table[name].value[has_target], tile.table[name].value[has_target]
            np.testing.assert_allclose(*angles, atol=1e-9)
    assert (tile.table["phi"].value < 0).any()
    theta = np.mod(tile.table["theta"].value, 360)
    assert theta[np.isfinite(theta)].max() <= 200


@pytest.mark.filterwarnings("ignore:.*out of reach of their positioners")
def test_joint_limits_are_looked_at_when_scoring(small):
    """Poses that the joint limits do not allow were accepted as assigned."""
    unit = replace(small.focal_plane.positioner, theta_range=[0, 90] * u.deg)
    plane = replace(small.focal_plane, positioner=unit)
    x, y = plane.xy[0]
    plan = QTable({"positioner": [0], "x": [x - 14 * MM], "y": [y]})
    tile = rs.score_tile(plan, replace(small, focal_plane=plane))
    assert (tile.summary["n_out_of_reach"], tile.table["status"][0]) == (1, "out_of_reach")
    tips = np.full((37, 2), np.nan) * MM
    tips[0] = x - 14 * MM, y
    with pytest.raises(rs.InputError, match="1 tips are beyond the joint limits; the first is the tip of positioner 0"):
        rs.find_collisions(plane, tips)


def test_a_unit_without_a_target_turns_its_arm_as_its_own_fiber_does():
    """The arm angle of stuck positioners was that of the first fiber type of the instrument."""
    unit = rs.Positioner(
        7 * MM, 12 * MM, 1 * MM, arm_model="capsule", arm_length=11 * MM, arm_angle={"A": 10 * u.deg, "B": -10 * u.deg}
    )
    plane = rs.FocalPlane([[0, 0], [100, 0]] * MM, unit, fiber_type=["B", "A"], stuck=[[0, 0], [0, 0]] * u.deg)
    arms = place_arms(plane, np.full((2, 2), np.nan) * MM)
    assert arms.segments[0, 3] < 0 < arms.segments[1, 3]


def test_targets_without_a_type_go_to_the_first_type_where_maps_differ(small):
    """Such targets were projected with the first map, and then assigned to fibers of another type."""
    maps = {
        "A": rs.projection.RadialMap("theta", [349.0], max_angle=2 * u.deg),
        "B": rs.projection.RadialMap("theta", [330.0], max_angle=2 * u.deg),
    }
    plane = rs.FocalPlane([[0, 0], [110, 0]] * MM, small.focal_plane.positioner, fiber_type=["A", "B"])
    instrument = rs.Instrument("two", plane, distortion=maps)
    coord = CENTER.directional_offset_by([90, 90] * u.deg, [0.01, 110 / 349] * u.deg)
    assert rs.plan_tile(rs.Catalog(coord), instrument, CENTER).table["status"].tolist() == ["assigned", "parked"]


def test_masked_values_count_as_missing(small):
    """Masked values were used."""
    with pytest.warns(rs.RfpsurveyWarning, match="1 of 2 targets"):
        assert len(rs.Catalog(SkyCoord(Masked([5, 1] * u.deg, mask=[True, False]), [0, 0] * u.deg))) == 1
    tips = Masked([[3, 0]] * MM, mask=[[True, True]])
    assert not rs.find_collisions(rs.FocalPlane([[0, 0]] * MM, small.focal_plane.positioner), tips).assigned.any()
    with pytest.raises(rs.InputError, match="priority must be a finite number for every target"):
        few(2, priority=np.ma.array([1.0, 2.0], mask=[True, False]))
    x, y = small.focal_plane.xy[:2].T
    plan = QTable({"positioner": [0, 1], "x": x, "y": y, "assigned": MaskedColumn([1, 1], mask=[True, False])})
    assert rs.score_tile(plan, small).summary["n_assigned"] == 1
    plan = QTable({"positioner": MaskedColumn([0, 1], mask=[True, False]), "x": x, "y": y})
    assert rs.score_tile(plan, small).summary["n_assigned"] == 1


def test_rows_for_units_that_cannot_be_used_are_counted(small):
    """Such rows were omitted, and tiles with NaN rates were not equal to themselves."""
    plane = replace(small.focal_plane, disabled=np.arange(37) == 0)
    x, y = plane.xy[:1].T
    tile = rs.score_tile(QTable({"positioner": [0], "x": x, "y": y}), replace(small, focal_plane=plane))
    assert tile.summary["n_unusable"] == 1
    assert np.isnan(tile.summary["collision_rate_assigned"])
    assert tile == rs.Tile(tile.table.copy())


def test_a_focal_plane_keeps_its_physics_in_a_table(presets, tmp_path):
    """Only the clearance was read from the table; other properties of positioners were lost."""
    plane = presets["sdss_apo"].focal_plane
    plane.to_table().write(tmp_path / "plane.ecsv")
    back = rs.FocalPlane.from_table(QTable.read(tmp_path / "plane.ecsv"))
    for name in (
        "min_separation",
        "step",
        "displacement",
        "home",
        "arm_length",
        "arm_model",
        "handedness",
        "clearance",
    ):
        np.testing.assert_array_equal(getattr(back.positioner, name), getattr(plane.positioner, name))
    assert back.positioner.arm_angle == plane.positioner.arm_angle
    np.testing.assert_array_equal(back.id, plane.id)
    np.testing.assert_array_equal(back.obstacles, plane.obstacles)


def test_a_focal_plane_from_fits_has_text_ids(small, tmp_path):
    """The identifiers were bytes."""
    plane = replace(small.focal_plane, id=[f"p{k}" for k in range(37)])
    table = plane.to_table()
    table.meta.clear()
    table.write(tmp_path / "plane.fits")
    back = rs.FocalPlane.from_table(QTable.read(tmp_path / "plane.fits"), plane.positioner)
    assert back.id.tolist() == plane.id.tolist()


def test_a_tile_does_not_make_every_unit_stuck(small):
    """The columns theta and phi of a tile were read as those of stuck positioners."""
    tile = rs.plan_tile(few(), small, CENTER)
    assert rs.FocalPlane.from_table(tile.table, small.focal_plane.positioner).arrays.usable.all()


@pytest.mark.filterwarnings("ignore:the epoch has no effect, because the targets have no proper motions")
def test_catalogs_with_velocities_and_odd_representations(small):
    """Radial velocities without proper motions, cartesian coordinates and distances raised errors of other packages."""
    still = few(3)
    coord = still.coord
    for odd in (
        SkyCoord(coord.ra, coord.dec, radial_velocity=[5, 6, 7] * u.km / u.s),
        SkyCoord(coord, representation_type="cartesian"),
        SkyCoord(coord.galactic.l, coord.galactic.b, distance=[1, np.inf, np.nan] * u.pc, frame="galactic"),
    ):
        catalog = rs.Catalog(odd, epoch=2016.0)
        assert catalog.at_epoch(2026) is catalog
        assert len(catalog.to_table()) == 3
        assert rs.plan_tile(catalog, small, CENTER, epoch=2026).summary["n_assigned"] == 3
    assert rs.plan_tile(still, small, SkyCoord(CENTER, representation_type="cartesian")).summary["n_assigned"] == 3
    assert len(still[1]) == 1


def test_epochs_matter_only_where_something_moves():
    """A single invalid epoch made a catalog unreadable, even without proper motions."""
    deg, pm = u.deg, u.mas / u.yr
    base = {"ra": [1, 2] * deg, "dec": [1, 2] * deg}
    assert rs.Catalog.from_table(QTable({**base, "ref_epoch": [0.0, np.nan]})).epoch is None
    assert rs.Catalog.from_table(QTable({**base, "ref_epoch": ["J2000", "?"]})).epoch.jyear == 2000
    assert rs.Catalog.from_table(QTable({**base, "ref_epoch": ["?", "x"]})).epoch is None
    moving = {**base, "pmra": [5, np.nan] * pm, "pmdec": [5, np.nan] * pm, "ref_epoch": [2015.5, 0.0]}
    assert rs.Catalog.from_table(QTable(moving)).epoch.jyear == pytest.approx(2015.5)
    assert rs.Catalog.from_table(QTable(base, meta={"ref_epoch": ""})).epoch is None
    with pytest.raises(rs.InputError, match="time must be one time or have the shape"):
        rs.Catalog.from_table(QTable(moving)).at_epoch([2016, 2017, 2018] * u.yr)


def test_proper_motions_of_another_frame_are_not_used_without_a_word():
    """The proper motions were ignored without a warning."""
    table = QTable({"l": [1] * u.deg, "b": [2] * u.deg, "pmra": [1] * u.mas / u.yr, "pmdec": [1] * u.mas / u.yr})
    with pytest.warns(rs.RfpsurveyWarning, match="but the coordinates are in another frame"):
        assert not rs.Catalog.from_table(table, frame="galactic").has_proper_motion


def test_ids_are_clean_text(small, tmp_path):
    """Identifiers with leading or trailing blanks, or with newlines, changed when they were written to files."""
    tile = rs.plan_tile(few(3, id=[" a", "b\nc", "d "]), small, CENTER)
    assert sorted(tile.table["target_id"].compressed()) == ["a", "b c", "d"]
    for suffix in (".fits", ".ecsv"):
        tile.write(tmp_path / f"t{suffix}")
        assert rs.Tile.read(tmp_path / f"t{suffix}") == tile


def test_meta_of_any_kind_can_be_written(small, tmp_path):
    """A numpy value in the meta of a catalog raised an error when results were written."""
    catalog = few(3, meta={"value": np.float32(1.5), "array": np.arange(3)})
    tile = rs.plan_tile(catalog, small, CENTER)
    catalog.write(tmp_path / "c.fits")
    tile.write(tmp_path / "t.fits")
    assert rs.Tile.read(tmp_path / "t.fits") == tile
    QTable({"x": [1]}, meta={"RFPSURVY": "{"}).write(tmp_path / "damaged.fits")
    with pytest.raises(rs.InputError, match="the header card RFPSURVY must be an object in JSON"):
        rs.Catalog.read(tmp_path / "damaged.fits")


def test_the_field_of_a_table_has_units(presets):
    """Position angles in radians, and centers in hours, were read as degrees."""
    xy = presets["lamost"].focal_plane.xy[:1] + [3, 4] * MM
    sky = presets["lamost"].projection(CENTER, 40 * u.deg).to_sky(xy)
    for angle, hours in ((40 * u.deg, 95 * u.deg), (np.deg2rad(40) * u.rad, 95 / 15 * u.hourangle)):
        plan = QTable({"positioner": [0], "ra": sky.ra, "dec": sky.dec})  # a column keeps its unit
        plan["position_angle"], plan["racen"], plan["deccen"] = angle, hours, 23 * u.deg
        assert rs.score_tile(plan, presets["lamost"]).summary["n_out_of_reach"] == 0
    plan["racen"] = ["abc"]
    with pytest.raises(rs.InputError, match="racen of the field must be an angle"):
        rs.score_tile(plan, presets["lamost"])


def test_our_own_tile_knows_its_field(small):
    """A center had to be given, although the tile contains it."""
    tile = rs.plan_tile(few(), small, CENTER, position_angle=30 * u.deg)
    score = rs.score_tile(tile.table, small, positions="sky")
    np.testing.assert_allclose(score.table["tip_x"].value, tile.table["tip_x"].value, atol=1e-6)


def test_text_flags_are_read():
    """The text "False" disabled a positioner."""
    unit = rs.Positioner(8 * MM, 8 * MM, 2 * MM)
    plane = rs.FocalPlane([[0, 0], [30, 0]] * MM, unit, disabled=["False", "true"])
    assert plane.disabled.tolist() == [False, True]
    with pytest.raises(rs.InputError, match="disabled must hold booleans or numbers, got text such as 'maybe'"):
        rs.FocalPlane([[0, 0]] * MM, unit, disabled=["maybe"])


def test_a_plan_out_of_reach_and_arguments_without_effect_are_warnings(small):
    """A plan for another field was scored as free of collisions, without a warning."""
    x, y = small.focal_plane.xy[:2].T
    plan = QTable({"positioner": [0, 1], "x": x + 40 * MM, "y": y})
    with pytest.warns(rs.RfpsurveyWarning, match="2 of 2 targets are out of reach"):
        rs.score_tile(plan, small)
    plan["x"] = x
    with pytest.warns(rs.RfpsurveyWarning, match="no effect because the table has positions") as told:
        rs.score_tile(plan, small, center=CENTER, epoch="J2020")
    assert [str(one.message).split()[0] for one in told] == ["center", "epoch"]
    with pytest.warns(rs.RfpsurveyWarning, match="the epoch has no effect, because the targets have no proper motions"):
        rs.plan_tile(few(), small, CENTER, epoch=2030, allocator="lamost_rule")
    with pytest.warns(rs.RfpsurveyWarning, match="the field has 1 target with the same id as another target"):
        rs.plan_tile(few(2, id=[7, 7]), small, CENTER, allocator="lamost_rule")


def test_collisions_with_obstacles_are_named(small):
    """The column that names the other objects of a collision was empty."""
    plane = replace(small.focal_plane, obstacles=[[200, 0, 3], [8, 0, 3]] * MM)
    tile = rs.plan_tile(few(), replace(small, focal_plane=plane), CENTER, allocator="lamost_rule")
    assert "obstacle-1" in " ".join(tile.table["colliding_with"]).split()
    assert tile.summary["n_obstacle_collisions"] > 0


def test_tables_with_mixed_columns_are_read(tmp_path):
    """A column of coordinates or times raised an error when a file was read."""
    coord = SkyCoord([95, 96] * u.deg, [23, 24] * u.deg)
    QTable({"target": coord, "when": Time([2016, 2017], format="jyear")}).write(tmp_path / "t.ecsv")
    np.testing.assert_allclose(rs.Catalog.read(tmp_path / "t.ecsv").coord.ra.deg, [95, 96])


def test_mistakes_in_a_description_are_named(tmp_path):
    """Unknown keys were ignored, and a description that refers to itself caused an infinite loop."""
    (tmp_path / "a.toml").write_text('inherits = "a"\nname = "a"\n')
    with pytest.raises(rs.InputError, match="inherits from itself"):
        rs.Instrument.read(tmp_path / "a.toml")
    (tmp_path / "b.toml").write_text('name = "b"\n[positionr]\n')
    with pytest.raises(rs.InputError, match="unknown section or entry 'positionr'.* Did you mean 'positioner'"):
        rs.Instrument.read(tmp_path / "b.toml")


def test_a_circle_has_one_center():
    """The first of several centers was used."""
    with pytest.raises(rs.InputError, match="center must be one direction, got the shape"):
        few().within(few().coord, 1 * u.deg)


def test_a_description_points_to_a_table_of_positions(small, tmp_path):
    """Tables of positions could not be used from the command line."""
    small.focal_plane.to_table().write(tmp_path / "positions.ecsv")
    rest = 'status = "assumed", source = "a test of mine" }\n'
    arms = "".join(
        f'{name} = {{ value = {value}, unit = "mm", {rest}'
        for name, value in (("central_arm", 8.25), ("eccentric_arm", 8.25), ("clearance", 2.0))
    )
    (tmp_path / "mine.toml").write_text(
        f'name = "mine"\nlayout_is = "as built"\n[positioner]\n{arms}'
        f'[layout]\ntable = {{ value = "positions.ecsv", {rest}'
        f'[optics]\nplate_scale = {{ value = 200, unit = "mm / deg", {rest}'
    )
    mine = rs.Instrument.read(tmp_path / "mine.toml")
    assert (len(mine.focal_plane), mine.focal_plane.positioner.clearance) == (37, 2 * MM)


def test_a_column_in_collision_does_not_make_a_table_ours(small):
    """A table of another planner with this column, but without a status, raised a KeyError."""
    x, y = small.focal_plane.xy[:1].T
    plan = QTable({"positioner": [0], "x": x, "y": y, "in_collision": [False]})
    assert rs.score_tile(plan, small).summary["n_assigned"] == 1
