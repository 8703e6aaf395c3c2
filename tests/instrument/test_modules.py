"""Instruments whose positioners are arranged in modules: positions, walls, fiber types and bad descriptions."""

import astropy.units as u
import numpy as np
import pytest
import shapely
from astropy.table import Table
from own_instrument import description
from raising import refused
from scipy.spatial import cKDTree

import rfpsurvey as rs

ROBOT = rs.Positioner(1.8 * u.mm, 1.8 * u.mm, clearance=1 * u.mm)
PLACES = [(x + (row - 10) / 2, row) for row in range(11) for x in range(11 - row)]
PLACES = [
    (6.2 * x, 6.2 * np.sqrt(3) / 2 * (row - 10 / 3)) for x, row in PLACES if (x, row) not in ((-5, 0), (5, 0), (0, 10))
]
LATTICE = 'pitch = { value = 6.2, unit = "mm" }\nmodule_rows = { value = 11 }\nmodule_corners = { value = "vacant" }\n'
GROUPS = """
module_side = { value = 73.8, unit = "mm" }
module_gap = { value = 0.3, unit = "mm" }
group_gap = { value = 4.4, unit = "mm" }
"""


def read(folder, text):
    (folder / "mine.toml").write_text(description((1.8, 1.8), 1.0, text))
    return rs.Instrument.read(folder / "mine.toml")


@pytest.mark.parametrize(("name", "n"), [("must", 21_168), ("spec_s5", 8694)])
def test_positions_of_the_layout_tool(presets, real_data, name, n):
    """All positions are those of the list of modules of the project teams, with the untilted places."""
    modules = Table.read(real_data(f"stage5/{name}_modules.csv"))
    sign = np.where(np.asarray(modules["points_up"]) == 1, 1, -1)
    centers = np.column_stack([modules["x"], modules["y"]])
    expected = (centers[:, None, :] + sign[:, None, None] * np.array(PLACES)).reshape(-1, 2)
    plane = presets[name].focal_plane
    apart, row = cKDTree(plane.xy.value).query(expected)
    assert len(plane) == len(expected) == len({*row.tolist()}) == n
    assert apart.max() < 1e-3
    pins = Table.read(real_data(f"stage5/{name}_fiducials.csv"))
    apart, row = cKDTree(plane.arrays.obstacles[:, :2]).query(np.column_stack([pins["x"], pins["y"]]))
    assert len(plane.arrays.obstacles) == len(pins) == len({*row.tolist()})
    assert apart.max() < 1e-3


@pytest.mark.parametrize("name", ["must", "spec_s5"])
def test_no_arm_reaches_a_fiducial_or_a_camera(presets, name):
    plane = presets[name].focal_plane
    assert len(plane.arrays.obstacle_pairs) == 0
    cameras = [shapely.Polygon(one) for one in presets[name].cameras.values()]
    assert [round(one.area) for one in cameras] == [10_000] * 6
    assert min(one.distance(shapely.MultiPoint(plane.xy.value)) for one in cameras) > 3.6 + 1
    away = np.hypot(*(plane.arrays.xy[:, None, :] - plane.arrays.obstacles[None, :8, :2]).transpose(2, 0, 1)).min(
        axis=0
    )
    assert (away > 3.6 + 1 + 1).all()


def test_modules_in_a_list_in_a_file_and_in_groups(tmp_path):
    """One group of four modules, described in three ways."""
    own, shift = 73.8 / np.sqrt(3) + 0.3, (2 * 73.8 + np.sqrt(3) * 5.0) / np.sqrt(3)
    x = [0.0, own * np.cos(np.pi / 6), -own * np.cos(np.pi / 6), 0.0]
    y, up = [shift, shift + own / 2, shift + own / 2, shift - own], [1, 0, 0, 0]
    Table({"x": x, "y": y, "points_up": up}).write(tmp_path / "modules.csv")
    Table({"x": np.divide(x, 1000) * u.m, "y": y * u.mm, "rotation": [0, np.pi, np.pi, np.pi] * u.rad}).write(
        tmp_path / "m.ecsv"
    )
    rows = ", ".join(f"[{float(a)}, {float(b)}, {180.0 * (1 - c)}]" for a, b, c in zip(x, y, up, strict=True))
    found = [
        read(tmp_path, LATTICE + f"modules = {{ value = {value} }}").focal_plane
        for value in ('"modules.csv"', '"m.ecsv"', f"[{rows}]")
    ]
    for plane in found:
        assert (len(plane), plane.id[[0, 62, 63]].tolist()) == (252, [101, 163, 201])
        np.testing.assert_allclose(plane.xy.value, found[0].xy.value, atol=1e-9)
    six = read(tmp_path, LATTICE + GROUPS + 'group_radius = { value = 100, unit = "mm" }').focal_plane
    apart, _ = cKDTree(six.xy.value).query(found[0].xy.value)
    assert len(six) == 6 * 252
    assert apart.max() < 1e-9


def test_a_spherical_surface(tmp_path):
    """Distances from the axis are lengths of arcs on the sphere."""
    flat, curved, points = (
        read(tmp_path, LATTICE + GROUPS + 'group_radius = { value = 300, unit = "mm" }\n' + more).focal_plane
        for more in (
            "",
            'focal_surface = { value = 5000.0, unit = "mm" }',
            "focal_surface = { value = ["
            + ", ".join(f"[{r}, {5000 - np.sqrt(5000.0**2 - r**2)}]" for r in range(0, 400, 2))
            + '], unit = "mm" }',
        )
    )
    centers = [plane.xy.value.reshape(-1, 63, 2).mean(axis=1) for plane in (flat, curved, points)]
    far = np.hypot(*centers[0].T)
    np.testing.assert_allclose(np.hypot(*centers[1].T), 5000 * np.sin(far / 5000), atol=1e-9)
    np.testing.assert_allclose(centers[2], centers[1], atol=1e-4)


def test_walls_are_outside_of_the_outline_of_each_module(rng):
    """Arms collide with a wall if their distance from a strip along the outline is less than the clearance."""
    corner = 73.8 / np.sqrt(3)
    outline = np.array([[corner * np.cos(a), corner * np.sin(a)] for a in np.radians([90, 210, 330])])
    centers = np.array([[0.0, 0.0], [0.0, -43.0]])
    plane = rs.FocalPlane.from_modules(
        ROBOT,
        centers=centers * u.mm,
        rotation=[0, 180] * u.deg,
        places=rs.focal_plane.triangle(6.2 * u.mm, 11, corners=False),
        outline=outline * u.mm,
        wall=0.15 * u.mm,
    )
    assert len(plane.obstacle_polygons) == 6
    modules = [shapely.Polygon(outline * sign + center) for sign, center in zip((1, -1), centers, strict=True)]
    n = 0
    for _ in range(20):
        theta, phi = rng.uniform(0, 360, (2, len(plane))) * u.deg
        report = rs.find_collisions(plane, theta=theta, phi=phi)
        a, b = theta.to_value(u.rad), (theta + phi).to_value(u.rad)
        elbow = plane.xy.value + 1.8 * np.column_stack([np.cos(a), np.sin(a)])
        tip = elbow + 1.8 * np.column_stack([np.cos(b), np.sin(b)])
        arms = [shapely.LineString(pair) for pair in np.stack([elbow, tip], axis=1)]
        touches = {k for k, arm in enumerate(arms) if modules[k // 63].exterior.distance(arm) < 1 - 1e-9}
        assert {*report.obstacle_pairs[:, 0].tolist()} == touches
        n += len(touches)
    assert n > 40


def test_two_fiber_types_with_other_arms(tmp_path):
    text = LATTICE + "modules = { value = [[0, 0, 0], [0, 80, 0]] }\n" + 'spectrographs = { value = "one a module" }\n'
    text += (
        "module_classes = { value = { LR = {}, HR = { places = [1, 5, 63], central_arm = 2.4, eccentric_arm = 2.4 } } }"
    )
    plane = read(tmp_path, text).focal_plane
    is_high = plane.fiber_type == "HR"
    assert np.flatnonzero(is_high).tolist() == [0, 4, 62, 63, 67, 125]
    np.testing.assert_allclose(plane.central_arm.value, np.where(is_high, 2.4, 1.8))
    np.testing.assert_allclose(plane.eccentric_arm.value, np.where(is_high, 2.4, 1.8))
    assert plane.spectrograph.tolist() == [0] * 63 + [1] * 63


@pytest.mark.parametrize("order", [("LR", "HR"), ("HR", "LR")])
def test_the_order_of_classes_does_not_matter(tmp_path, order):
    """Regression: places that no class lists belonged to the first class."""
    classes = {"LR": "LR = {}", "HR": "HR = { places = [1, 5], eccentric_arm = 2.0 }"}
    text = LATTICE + "modules = { value = [[0, 0, 0]] }\nmodule_classes = { value = { %s } }"
    plane = read(tmp_path, text % ", ".join(classes[name] for name in order)).focal_plane
    assert np.flatnonzero(plane.fiber_type == "HR").tolist() == [0, 4]


def test_walls_and_other_obstacles(tmp_path):
    """Regression: other obstacles replaced the walls."""
    text = LATTICE + 'modules = { value = [[0, 0, 0]] }\nmodule_wall = { value = 1, unit = "mm" }\n'
    text += 'module_outline = { value = [[0, 43], [-38, -22], [38, -22]], unit = "mm" }\n'
    text += 'obstacle_polygons = { value = [[[100, 0], [110, 0], [110, 10]]], unit = "mm" }'
    assert len(read(tmp_path, text).focal_plane.obstacle_polygons) == 4


def test_inherited_modules_are_replaced(tmp_path):
    text = 'name = "mine"\ninherits = "must"\nstatus = "assumed"\nsource = "a test"\n[layout]\n'
    for own, n in (
        ('module_radius = { value = 100, unit = "mm" }', 12),
        ("modules = { value = [[0, 0, 0]] }", 1),
        ('group_radius = { value = 100, unit = "mm" }', 24),
    ):
        (tmp_path / "mine.toml").write_text(text + own)
        instrument = rs.Instrument.read(tmp_path / "mine.toml")
        assert len(instrument.focal_plane) == 63 * n
        assert not {"layout.group_radius", "layout.module_radius"} <= {*instrument.values}
    Table({"x": [0, 20] * u.mm, "y": [0, 0] * u.mm}).write(tmp_path / "plane.ecsv")
    (tmp_path / "mine.toml").write_text(text + 'table = { value = "plane.ecsv" }')
    instrument = rs.Instrument.read(tmp_path / "mine.toml")
    assert len(instrument.focal_plane) == 2
    assert "layout.module_gap" not in instrument.values
    (tmp_path / "mine.toml").write_text(text + 'table = { value = "plane.ecsv" }\nmodules = { value = [[0, 0, 0]] }')
    refused("with a table must not have the entry 'modules'", rs.Instrument.read, tmp_path / "mine.toml")


def test_columns_of_a_module(rng):
    """Regression: scalars, dicts and lists of quantities raised errors that were not clear."""
    layout = {"centers": [[0, 0], [0, 80]] * u.mm, "places": rs.focal_plane.triangle(6.2 * u.mm, 3)}
    length = rng.uniform(1.7, 1.9, 6)
    for column in (length * u.mm, [one * u.mm for one in length], np.tile(length, 2) * u.mm):
        plane = rs.FocalPlane.from_modules(ROBOT, central_arm=column, **layout)
        np.testing.assert_allclose(plane.central_arm.value, np.tile(length, 2))
    assert rs.FocalPlane.from_modules(ROBOT, central_arm=None, **layout).central_arm is None
    fiber = {"A": np.column_stack([length, np.zeros(6)]) * u.mm}
    plane = rs.FocalPlane.from_modules(ROBOT, fiber_xy=fiber, fiber_type=["A"] * 6, **layout)
    assert plane.fiber_xy["A"].shape == (12, 2)
    with pytest.raises(rs.InputError, match="central_arm must be 12 positive lengths"):
        rs.FocalPlane.from_modules(ROBOT, central_arm=1.8 * u.mm, **layout)
    for outline, message in (
        ([[0, 9], [-9, -9], [np.nan, -9]], "outline of a module must be finite, got nan"),
        ([[0, 20], [-20, -9], [0, -8], [20, -9]], "outline of a module must be the corners of a convex polygon"),
        ([[0, 5], [-5, -3], [5, -3]], "outline of a module must contain all places, got"),
    ):
        with pytest.raises(rs.InputError, match=message):
            rs.FocalPlane.from_modules(ROBOT, outline=outline * u.mm, **layout)
    with pytest.raises(rs.InputTypeError, match="corners must be"):
        rs.focal_plane.triangle(6.2 * u.mm, 3, corners="used")


MODULES = LATTICE + "modules = { value = %s }"
ONE = MODULES % "[[0, 0, 0]]" + "\n"
RINGS = 'pitch = { value = 6.2, unit = "mm" }\nrings = { value = 2 }\n'
RADIUS = LATTICE + GROUPS + 'group_radius = { value = %d, unit = "mm" }\n'
CLASSES = ONE + "module_classes = { value = { %s } }"
FORM = "layout.modules must be the name of a file, or a list of modules"
FREE = "exactly one class of module_classes must have no"
OVERLAP = "modules must not overlap"


BAD_DESCRIPTIONS = [
    (MODULES % "[[0, 0, 0], [0, 30, 0]]", f"{OVERLAP}, got 1 pair of modules that do, such as modules 1 and 2"),
    (MODULES % "[[0, 0, 0], [0, -43, 90]]", OVERLAP),
    (MODULES % "[[0, 0, nan]]", FORM),
    (MODULES % "[[0, 0]]", FORM),
    (MODULES % '"none.csv"', "none.csv"),
    (MODULES % '"nan.csv"', "centers of modules must be finite, got nan"),
    (MODULES % '"bare.csv"', "bare.csv must have the columns x and y (mm), and rotation (deg) or points_up, got x, y"),
    ("modules = { value = [[0, 0, 0]] }", "[layout] with modules must have module_places, or pitch and module_rows"),
    (LATTICE + GROUPS, "[layout] must have modules, or module_side, module_gap, group_gap and either group_radius or"),
    (LATTICE + 'module_side = { value = 70, unit = "mm" }', "it lacks module_gap, group_gap"),
    (RADIUS % 10, "the modules must have centers within 10 mm"),
    (RADIUS % 300 + 'focal_surface = { value = 100, unit = "mm" }', "the focal surface must extend to all modules"),
    (
        RADIUS % 100 + 'focal_surface = { value = [[1, 0], [2, 0], [300, 1]], unit = "mm" }',
        "the points of the focal surface must begin at R = 0",
    ),
    (ONE + 'module_wall = { value = 1, unit = "mm" }', "walls must be given with the outline of a module"),
    (CLASSES % "LR = {}, HR = { places = [64] }", "places of 'HR' must be numbers from 1 to 63, got 64"),
    (
        CLASSES % "LR = {}, HR = { places = [3] }, X = { places = [3] }",
        "each place of a module must be in one class, got two for the place 3",
    ),
    (ONE + "rings = { value = 3 }", "[layout] with a list of modules must not have the entry 'rings'"),
    (ONE + 'group_radius = { value = 100, unit = "mm" }', "must not have the entry 'group_radius'"),
    (ONE + 'fiducial_radius = { value = 1, unit = "mm" }', "must not have the entry 'fiducial_radius'"),
    (
        RINGS + 'module_wall = { value = 1, unit = "mm" }',
        "[layout] without modules must not have the entry 'module_wall'",
    ),
    (
        RINGS + 'spectrographs = { value = "one a module" }',
        "layout.spectrographs must not be 'one a module' without modules",
    ),
    (CLASSES % "LR = {}, HR = {}", FREE),
    (CLASSES % "HR = { places = [3] }", FREE),
    (MODULES % '"half.csv"', "points_up in half.csv must be 0 or 1"),
    (MODULES % '"both.csv"', "both.csv must have either the column rotation or the column points_up, got both"),
    (ONE.replace("11", "500"), "module_rows must be a whole number from 1"),
]


@pytest.mark.parametrize(("text", "message"), BAD_DESCRIPTIONS)
def test_bad_descriptions(tmp_path, text, message):
    (tmp_path / "nan.csv").write_text("x,y,rotation\n0,nan,0\n")
    (tmp_path / "bare.csv").write_text("x,y\n0,0\n")
    (tmp_path / "half.csv").write_text("x,y,points_up\n0,0,0.5\n")
    (tmp_path / "both.csv").write_text("x,y,points_up,rotation\n0,0,1,0\n")
    found = refused("", read, tmp_path, text)
    assert message in found
    assert "\n" not in found
