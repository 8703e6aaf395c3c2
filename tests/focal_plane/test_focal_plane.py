import re
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable, Table
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from raising import refused, warned

import rfpsurvey as rs
from oracles import in_annulus
from strategies import lengths, points

MM = u.mm


def robot(l1=8.25, l2=8.25, **options):
    return rs.Positioner(l1 * MM, l2 * MM, 2.25 * MM, **options)


def brute_force(plane, xy):
    return np.array(
        [
            [in_annulus(t, c, l1, l2) for t in xy]
            for c, l1, l2 in zip(plane.arrays.xy, plane.arrays.central_arm, plane.arrays.eccentric_arm, strict=True)
        ]
    ).reshape(len(plane), len(xy))


@pytest.mark.parametrize("rings", [0, 1, 13])
def test_rings(rings):
    plane = rs.FocalPlane.hexagonal(robot(), rings=rings, pitch=25.6 * MM)
    assert len(plane) == 3 * rings * (rings + 1) + 1
    assert np.hypot(*plane.xy.value.T).max() == pytest.approx(rings * 25.6)


def test_count_takes_the_nearest_cells():
    plane = rs.FocalPlane.hexagonal(robot(), count=4000, pitch=25.6 * MM)
    r = np.sort(np.hypot(*rs.FocalPlane.hexagonal(robot(), rings=50, pitch=25.6 * MM).xy.value.T))
    assert len(plane) == 4000
    np.testing.assert_allclose(np.sort(np.hypot(*plane.xy.value.T)), r[:4000])
    assert r[3999] < 848.7 + 0.1


def test_radius_inner_radius_and_vacant_cells():
    plane = rs.FocalPlane.hexagonal(
        robot(), radius=60 * MM, inner_radius=20 * MM, pitch=25.6 * MM, vacant=[(1, 0), (2, 0)]
    )
    r = np.hypot(*plane.xy.value.T)
    assert r.min() >= 20
    assert r.max() <= 60
    assert len(plane) == 19 - 1 - 2  # two rings within 60 mm, without the center and the vacant cells
    with pytest.raises(rs.InputError, match="vacant cell .9, 9. is not on the lattice"):
        rs.FocalPlane.hexagonal(robot(), rings=2, pitch=25.6 * MM, vacant=[(9, 9)])


def test_rows_along_y_are_rows_along_x_with_the_axes_exchanged():
    x, y = (rs.FocalPlane.hexagonal(robot(), rings=3, pitch=8 * MM, rows_along=a) for a in "xy")
    np.testing.assert_allclose(x.xy.value, y.xy.value[:, ::-1])


@pytest.mark.parametrize("size", [{}, {"rings": 2, "count": 3}, {"rings": 1.5}, {"count": 0}, {"rings": -1}])
def test_size_must_be_said_once(size):
    with pytest.raises(rs.InputError, match=r"either rings or count|must be a whole number"):
        rs.FocalPlane.hexagonal(robot(), pitch=25.6 * MM, **size)
    with pytest.raises(rs.InputError, match="pitch must be one finite value above 0 mm"):
        rs.FocalPlane.hexagonal(robot(), pitch=0 * MM, rings=1)
    refused("fewer than count", lambda: rs.FocalPlane.hexagonal(robot(), pitch=25.6 * MM, count=50, radius=30 * MM))


@pytest.mark.parametrize(("pitch", "kind"), [(40, 1), (37.5, 1), (37.4, 2), (25.6, 2), (20, 3)])
def test_collision_type(pitch, kind):
    """Only positioners with centers nearer than 2 (l1 + l2) + D = 37.5 mm can collide."""
    assert rs.FocalPlane.hexagonal(robot(), rings=4, pitch=pitch * MM).collision_type == kind


def test_neighbor_pairs_are_those_of_brute_force(rng):
    xy, arms = rng.uniform(-100, 100, (120, 2)), rng.uniform(3, 12, (120, 2))
    plane = rs.FocalPlane(xy * MM, robot(), central_arm=arms[:, 0] * MM, eccentric_arm=arms[:, 1] * MM)
    reach = arms.sum(axis=1)
    expected = [
        (i, j) for i in range(120) for j in range(i + 1, 120) if np.hypot(*(xy[i] - xy[j])) < reach[i] + reach[j] + 4.5
    ]
    assert [tuple(p) for p in plane.neighbor_pairs()] == expected


@given(
    arrays(float, (7, 2), elements=st.integers(-20, 20).map(lambda k: 2.5 * k), unique=True),
    points(30),
    lengths,
    lengths,
)
def test_reach_is_exact(centers, xy, l1, l2):
    """Compare with exact rational numbers, for targets that are often exactly on the edges."""
    if len(np.unique(centers, axis=0)) < 7:
        return
    plane = rs.FocalPlane(centers * MM, robot(l1, l2))
    edges = centers + (l1 + l2) * np.array([[1, 0], [0, 1], [-1, 0], [0, -1], [0.6, 0.8], [0.8, -0.6], [1, 0]])
    inner = centers + abs(l1 - l2) * np.array([[1, 0], [0, 1], [-1, 0], [0, -1], [0.6, 0.8], [0.8, -0.6], [1, 0]])
    xy = np.vstack([xy, edges, inner, centers, [[np.nan, 0], [np.inf, 0], [1e9, 1e9]]])
    got = plane.reachable(xy * MM)
    np.testing.assert_array_equal(got.toarray(), np.hstack([brute_force(plane, xy[:-3]), np.zeros((7, 3), bool)]))
    assert got.has_sorted_indices


def test_edges_of_the_patrol_area_belong_to_it():
    plane = rs.FocalPlane([[0, 0], [100, 0]] * MM, robot(7.4, 15.0))
    inside = [[22.4, 0], [0, -22.4], [100, 7.6], [92.4, 0]]
    outside = [[np.nextafter(22.4, 23), 0], [0, np.nextafter(7.6, 0)]]
    got = plane.reachable((inside + outside) * MM).toarray()
    np.testing.assert_array_equal(got, brute_force(plane, np.array(inside + outside, dtype=float)))
    assert not got[:, -2:].any()


def test_reach_on_a_large_and_on_a_far_and_on_a_scattered_focal_plane(rng):
    for centers in (
        rng.uniform(-300, 300, (200, 2)),
        rng.uniform(-300, 300, (200, 2)) + 1e6,
        np.array([[0, 0], [1e7, 1e7], [-1e7, 3.0]]),
        np.column_stack([np.arange(50) * 10.0, np.zeros(50)]),
    ):
        plane = rs.FocalPlane(centers * MM, robot(7.4, 15.0))
        xy = np.vstack([c + rng.uniform(-30, 30, (8, 2)) for c in centers])
        d = np.hypot(*(xy[None] - centers[:, None]).transpose(2, 0, 1))
        np.testing.assert_array_equal(plane.reachable(xy * MM).toarray(), (d >= 7.6) & (d <= 22.4))


def test_reach_respects_fiber_types_disabled_and_stuck_units():
    plane = rs.FocalPlane([[0, 0], [10, 0]] * MM, robot(), fiber_type=["BOSS+APOGEE", "BOSS"])
    assert plane.fiber_types == ("BOSS", "APOGEE")
    xy = [[5, 0], [5, 1], [5, 2]] * MM
    got = plane.reachable(xy, ["APOGEE", "BOSS", ""]).toarray()
    np.testing.assert_array_equal(got, [[True, True, True], [False, True, True]])
    assert not replace(plane, disabled=[False, True]).reachable(xy).toarray()[1].any()
    stuck = [[np.nan, np.nan], [30, 90]] * u.deg
    assert not replace(plane, stuck=stuck).reachable(xy).toarray()[1].any()
    refused("fiber_type must be one of BOSS, APOGEE or empty, got HERMES", plane.reachable, xy, ["HERMES", "", ""])


@pytest.mark.parametrize("hand", ["right", "left", "both"])
def test_reach_respects_joint_limits(hand, rng):
    limits = {"theta_range": [-30, 120] * u.deg, "phi_range": [-150, 150] * u.deg, "handedness": hand}
    unit = robot(7.4, 15.0, **limits)
    plane, xy = rs.FocalPlane([[3, 4]] * MM, unit), rng.uniform(-25, 25, (400, 2)) + [3, 4]
    expected = np.isfinite(unit.inverse((xy - [3, 4]) * MM)[0].value)
    np.testing.assert_array_equal(plane.reachable(xy * MM).toarray()[0], expected)
    assert 0 < expected.sum() < brute_force(plane, xy).sum()


ARMS = {"central_arm": [8.2, 8.25, 8.3] * MM, "eccentric_arm": [8.25, 8.25, 8.2] * MM, "id": ["A", "B", "C"]}
ARMS |= {"spectrograph": [1, 1, 2], "disabled": [True, False, False]}
ARMS["stuck"] = [[np.nan, np.nan], [10, 170], [np.nan, np.nan]] * u.deg
FIBERS = {"fiber_type": ["A", "B"], "zero_points": [[0, 1], [2, 3]] * u.deg}
FIBERS |= {"theta_range": [[0, 350], [5, 360]] * u.deg, "phi_range": [[0, 180], [10, 170]] * u.deg}
FIBERS["fiber_xy"] = {"A": [[8.25, 0], [8.2, 0.1]] * MM, "B": [[8.0, -0.2], [8.1, 0.3]] * MM}


@pytest.mark.parametrize("columns", [ARMS, FIBERS])
def test_table_round_trip(tmp_path, columns):
    xy, path = [[0, 0], [25.6, 0], [0, 30]][: 3 if columns is ARMS else 2] * MM, tmp_path / "plane.ecsv"
    plane = rs.FocalPlane(xy, robot(), obstacles=[[50, 50, 3]] * MM, **columns)
    plane.to_table().write(path)
    back = rs.FocalPlane.from_table(QTable.read(path))
    for name in ("xy", "obstacles", *set(columns) - {"fiber_xy"}):
        given = getattr(plane, name)
        if columns is FIBERS and name in ("zero_points", "theta_range", "phi_range"):
            np.testing.assert_allclose(getattr(back, name), given, rtol=0, atol=1e-12 * u.deg)
        else:
            np.testing.assert_array_equal(getattr(back, name), given)
    assert set(back.fiber_xy or ()) == set(plane.fiber_xy or ())
    for name, places in (plane.fiber_xy or {}).items():
        np.testing.assert_array_equal(back.fiber_xy[name], places)
    assert back.positioner.min_separation == plane.positioner.min_separation
    table = Table({"x": [0, 1] * u.cm, "y": [0, 0] * u.cm, "fiber_id": [3, 4], "comment": ["a", "b"]})
    assert rs.FocalPlane.from_table(table, robot()).xy[1, 0] == 10 * MM


BAD_TABLES = [
    ({"x": [0] * MM}, "there is no column 'y'; the columns are: x"),
    ({"x": [0.0], "y": [0] * MM}, "column 'x' must have a unit convertible to mm, got none"),
    ({"x": [0] * u.deg, "y": [0] * MM}, "column 'x' must have a unit convertible to mm, got deg"),
    ({"x": [0] * MM, "y": [0] * MM}, "without the argument positioner, the meta of the table must have an entry"),
]


@pytest.mark.parametrize(("table", "message"), BAD_TABLES)
def test_bad_tables_are_named(table, message):
    refused(message, lambda: rs.FocalPlane.from_table(QTable(table)))


IGNORED_COLUMNS = [
    ("disable", "the column 'disable' is ignored; did you mean 'disabled'?"),
    ("Central_Arm", "the column 'Central_Arm' is ignored; did you mean 'central_arm'?"),
    ("stuck_theta", "the column 'stuck_theta' is ignored, because there is no column 'stuck_phi'"),
    ("phi_max", "the column 'phi_max' is ignored, because there is no column 'phi_min'"),
    ("fiber_x_A", "the column 'fiber_x_A' is ignored, because there is no column 'fiber_y_A'"),
    ("fiber_y", "the column 'fiber_y' is ignored, because there is no column 'fiber_x'"),
]


@pytest.mark.parametrize(("name", "message"), IGNORED_COLUMNS)
def test_ignored_columns_of_tables_are_named(name, message):
    """A misspelled column of disabled positioners made these positioners usable without a message."""
    table = QTable({"x": [0, 30] * MM, "y": [0, 0] * MM, name: [1, 0]})
    warned(re.escape(message), lambda: rs.FocalPlane.from_table(table, robot()))


BAD_INPUT = [
    ({"xy": [[0, 0], [0, 0]] * MM}, "two positioners have the same center"),
    ({"xy": np.empty((0, 2)) * MM}, "at least one positioner"),
    ({"xy": [[0, np.nan], [0, 1]] * MM}, "xy must be finite, got 1 rows"),
    ({"xy": [0, 1] * MM}, r"xy must have the shape \(n, 2\)"),
    ({"id": [1, 1]}, "id must be unique, but .*1.* occurs more than once"),
    ({"id": [1]}, "id must have one value per positioner"),
    ({"id": ["a b", "c"]}, "id must be text without blanks, because tables separate ids by blanks, got 'a b'"),
    ({"central_arm": [8.2] * MM}, r"central_arm must be 2 positive lengths, got the shape \(1,\)"),
    ({"central_arm": [1, -1] * MM}, "central_arm must be 2 positive lengths"),
    ({"stuck": [1, 2] * u.deg}, r"stuck must have the shape \(2, 2\)"),
    ({"obstacles": [[1, 2]] * MM}, "obstacles must have rows"),
    ({"spectrograph": [[0, 1], [0, 1]]}, "spectrograph must have the shape"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD_INPUT)
def test_bad_input_is_named(arguments, message):
    good = {"xy": [[0, 0], [30, 0]] * MM, "positioner": robot()}
    refused(message, lambda: rs.FocalPlane(**{**good, **arguments}))


def test_fiber_types_are_names_between_plus_signs():
    """Regression: repeated names set the bit of another fiber type, and blank names defined new types."""
    plane = rs.FocalPlane([[0, 0], [20, 0]] * MM, robot(), fiber_type=["A + A", "B"])
    assert plane.fiber_types == ("A", "B")
    got = plane.reachable([[10, 0], [10, 0]] * MM, ["A", "B"]).toarray()
    np.testing.assert_array_equal(got, [[True, False], [False, True]])
    with pytest.raises(
        rs.InputError, match="fiber_type must contain a type for every positioner, or for no positioner"
    ):
        rs.FocalPlane([[0, 0], [20, 0]] * MM, robot(), fiber_type=["A", ""])
    with pytest.raises(rs.InputError, match="central_arm must be 2 positive lengths"):
        rs.FocalPlane([[0, 0], [20, 0]] * MM, robot(), central_arm=[np.inf, 1] * MM)


def test_nearest_cells_with_equal_radius_are_taken_by_angle():
    """The first ring has six cells at equal radius. Cells next to +x are first, and the order is counter-clockwise."""
    plane = rs.FocalPlane.hexagonal(robot(), count=4, pitch=10 * MM)
    angle = np.sort(np.rad2deg(np.arctan2(*plane.xy.value[np.hypot(*plane.xy.value.T) > 1].T[::-1])))
    np.testing.assert_allclose(angle, [0, 60, 120])
    with pytest.raises(rs.InputError, match="rows_along must be 'x' or 'y'"):
        rs.FocalPlane.hexagonal(robot(), count=4, pitch=10 * MM, rows_along="z")


@pytest.mark.parametrize("n", [0, 1, 255, 256, 257, 600])
def test_the_pairs_of_many_targets_are_those_of_single_targets(n, rng):
    """The kernel looks up the cells of 256 targets at a time."""
    plane = rs.FocalPlane.hexagonal(rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM), rings=4, pitch=20 * MM)
    points = rng.uniform(-130, 130, (n, 2))  # some are outside of the grid
    points[::7] = np.nan
    together = plane.arrays.reach(points)
    assert len(together.indptr) == n + 1
    for t in range(n):
        alone = plane.arrays.reach(points[t : t + 1])
        rows = slice(together.indptr[t], together.indptr[t + 1])
        np.testing.assert_array_equal(together.owner[rows], alone.owner)
        np.testing.assert_array_equal(together.r2[rows], alone.r2)
