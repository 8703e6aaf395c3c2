"""Scans of designs: geometry compared with shapely, losses compared with probabilities and brute force, front,
checkpoints.
"""

from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from itertools import product
from multiprocessing import get_context

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from hypothesis import given
from hypothesis import strategies as st

import flat
import rfpsurvey as rs
from oracles import annuli_coverage
from rfpsurvey._studies import design_rows as _checkpoint
from rfpsurvey._studies.design import Task
from rfpsurvey._studies.design_rows import on_front
from rfpsurvey._studies.losses import METHODS, _gap

MM = u.mm
LAMOST = {"central_arm": 8.25 * MM, "ratio": 1.0, "pitch": 25.6 * MM, "clearance": 2.25 * MM}
GRID = {"central_arm": [7.25, 9] * MM, "ratio": [1, 1.8], "pitch": [25.6, 31] * MM, "clearance": 2.25 * MM}


def explore(**changes):
    return flat.explore_designs(**{**LAMOST, **changes})


@pytest.mark.parametrize(("central_arm", "eccentric_arm"), [(8.25, 8.25), (8.0, 17.0), (3.0, 3.0)])
def test_coverage_is_that_of_an_exact_overlay_of_a_cell(central_arm, eccentric_arm):
    row = explore(central_arm=central_arm * MM, ratio=eccentric_arm / central_arm)[0]
    plane = rs.FocalPlane.hexagonal(
        rs.Positioner(central_arm * MM, eccentric_arm * MM, 2 * MM), rings=3, pitch=25.6 * MM
    )
    corners = 25.6 / np.sqrt(3) * np.exp(1j * np.pi * (1 / 6 + np.arange(6) / 3))
    truth = annuli_coverage(plane, np.column_stack([corners.real, corners.imag]))
    got = [row[f"reach_{k}"] for k in range(4)]
    np.testing.assert_allclose(got, [*truth[:3], truth[3:].sum()], atol=3e-4)
    assert (sum(got), row["coverage"]) == (pytest.approx(1), pytest.approx(1 - got[0]))
    assert row["multiplicity"] == pytest.approx(truth @ np.arange(len(truth)), abs=1e-3)


def test_multiplicity_and_empty_patrol_areas_are_those_of_the_literature():
    """The multiplicity is m = 4 pi central_arm eccentric_arm / cell, and exp(-t m) of the positioners have no target in
    reach.
    """
    table = explore(central_arm=[8.25, 8] * MM, targets_per_positioner=4)
    assert table["multiplicity"][0] == pytest.approx(1.5070, abs=1e-4)
    assert table["empty"][0] == pytest.approx(0.00241, abs=1e-5)
    moons = explore(central_arm=8 * MM, ratio=17 / 8, pitch=25.058 * MM, targets_per_positioner=1)
    assert moons["empty"][0] == pytest.approx(0.0432, abs=1e-4)


@pytest.mark.parametrize(("ratio", "pitch"), [(1, 25.6), (1, 37.5), (1, 37.4), (2, 31.2), (2, 31.1), (2, 25.6)])
def test_collision_types_are_those_of_a_focal_plane(ratio, pitch):
    unit = rs.Positioner(8.25 * MM, ratio * 8.25 * MM, 2.25 * MM)
    plane = rs.FocalPlane.hexagonal(unit, rings=3, pitch=pitch * MM)
    assert explore(ratio=ratio, pitch=pitch * MM)["collision_type"][0] == plane.collision_type


def test_the_safe_distance_is_that_of_a_positioner():
    row = explore(central_arm=7.4 * MM, ratio=15 / 7.4, clearance=2.5 * MM, step=0.1 * u.deg)[0]
    assert row["min_separation"].value == pytest.approx(5.0782, abs=1e-4)
    assert row["eccentric_arm"].value == pytest.approx(15)


def test_independent_losses_are_probabilities_in_the_middle_of_a_large_array():
    table = explore(ratio=[0.9, 1.0, 1.6], method="auto")
    assert table["method"].tolist() == ["quadrature", "surrogate", "surrogate"]
    for row in table:
        unit = rs.Positioner(row["central_arm"], row["eccentric_arm"], row["clearance"])
        plane = rs.FocalPlane.hexagonal(unit, rings=4, pitch=row["pitch"])
        truth = flat.collision_probability(plane, method="quadrature", max_iterations=512).per_positioner
        assert row["loss"] == pytest.approx(truth[len(plane) // 2], abs=0.002)
        assert row["loss"] == pytest.approx(truth[len(plane) // 2], abs=6 * row["loss_error"] + 5e-4)
        assert row["usable"] == 1 - row["loss"]


@pytest.mark.exhaustive
@pytest.mark.parametrize("each", [0.5])
def test_allocated_losses_are_those_of_a_plain_simulation_of_a_large_array(rng, each):
    """Compare with one configuration for each sky. Parked arms are obstacles, but lose no target."""
    row = explore(central_arm=11 * MM, estimand="allocated", n_skies=200, targets_per_positioner=each)[0]
    unit = rs.Positioner(11 * MM, 11 * MM, 2.25 * MM)
    plane = rs.FocalPlane.hexagonal(unit, rings=9, pitch=25.6 * MM)
    middle = np.hypot(*plane.xy.to_value("mm").T) < 6 * 25.6
    radius = 9 * 25.6 + 22
    lost = np.zeros((300, 2))
    for counts in lost:
        n = rng.poisson(each * np.pi * radius**2 / (np.sqrt(3) / 2 * 25.6**2))
        r, alpha = radius * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
        xy = np.column_stack([r * np.cos(alpha), r * np.sin(alpha)]) * MM
        plan = rs.allocate(plane, xy, rng=rng, allocator="balanced")
        assigned = middle & (plan.target_of_positioner >= 0)
        counts[:] = assigned.sum(), rs.find_collisions(plane, plan).in_collision[assigned].sum()
    truth = lost[:, 1].sum() / lost[:, 0].sum()
    error = (lost[:, 1] / lost[:, 0]).std() / np.sqrt(len(lost))
    assert row["loss"] == pytest.approx(truth, abs=4 * np.hypot(row["loss_error"], error))
    assert 0 < row["loss_error"] < 0.006
    assert row["assigned"] == pytest.approx(lost[:, 0].mean() / middle.sum(), abs=0.02)


def test_collision_free_losses_are_counted_in_two_plans():
    """Compare the best plans with and without collisions.

    If no arms can touch, they are equal, and repair loses at least as many targets as the optimum.
    """
    far = explore(pitch=38 * MM, estimand="collision_free", targets_per_positioner=1)[0]
    assert (far["collision_type"], far["loss"], far["loss_error"]) == (1, 0, 0)
    # without competition, every positioner with a target in reach has a target
    alone = explore(central_arm=4 * MM, estimand="collision_free", n_skies=40, targets_per_positioner=1)[0]
    assert alone["multiplicity"] < 1
    assert alone["assigned"] == pytest.approx(1 - alone["empty"], abs=0.03)
    options = {"ratio": 1.5, "pitch": 24.6 * MM, "targets_per_positioner": 1, "n_skies": 4}
    best, repaired = (explore(method=name, **options)[0] for name in ("optimal", "repair"))
    assert best["assigned"] == repaired["assigned"]
    assert 0 < best["loss"] < repaired["loss"]
    assert best["usable"] == pytest.approx(best["assigned"] * (1 - best["loss"]))


def test_searches_that_are_cut_short_are_counted():
    design = {"central_arm": 14 * MM, "ratio": 1.6, "estimand": "collision_free", "n_skies": 2}
    design["targets_per_positioner"] = 1
    words = "ended searches for 1 of 1 designs; the true loss of these designs can be smaller"
    with pytest.warns(rs.RfpsurveyWarning, match=words):
        row = explore(**design, time_limit=1 * u.ms)[0]
    assert row["n_unproven"] == 2
    assert 0 < row["loss_gap"] < 1
    proven = explore(**{**design, "central_arm": 9 * MM}, time_limit=60 * u.s)[0]
    assert proven["n_unproven"] == proven["loss_gap"] == 0


def test_the_gap_of_a_search_that_is_cut_short_contains_the_optimum(rng):
    unit = rs.Positioner(12 * MM, 18 * MM, 2.25 * MM)
    plane = rs.FocalPlane.hexagonal(unit, rings=5, pitch=25.6 * MM)
    for _ in range(4):
        points = rng.uniform(-150, 150, (90, 2)) * MM
        blind = rs.allocate(plane, points, allocator="network_flow")
        cut, best = (
            rs.allocate(plane, points, allocator=rs.AllocationOptions("optimal", time_limit=limit))
            for limit in (1 * u.ms, 60 * u.s)
        )
        more = best.levels[0].value - cut.levels[0].value
        assert 0 <= more / blind.levels[0].value <= _gap(blind, cut) + 1e-12
        assert best.gap == 0


def test_errors_are_the_scatter_between_scans():
    options = {"estimand": "allocated", "targets_per_positioner": 2, "n_skies": 4}
    scans = [explore(rng=seed, **options)[0] for seed in range(30)]
    said = np.sqrt(np.mean([row["loss_error"] ** 2 for row in scans]))
    assert said == pytest.approx(np.std([row["loss"] for row in scans]), rel=0.4)


def test_targets_by_area_leave_more_to_each_fiber_of_a_wide_pitch():
    table = explore(pitch=[20, 40] * MM, target_density=0.002 / MM**2)
    np.testing.assert_allclose(table["targets"], 0.002 * np.sqrt(3) / 2 * np.array([400, 1600]))
    np.testing.assert_allclose(table["usable_per_area"], table["usable"] * table["positioners_per_area"])
    assert table["positioners_per_area"].to_value(u.mm**-2)[0] == pytest.approx(2 / np.sqrt(3) / 400)


def test_a_grid_has_all_combinations_and_sobol_points_fill_the_box():
    grid = flat.explore_designs(**GRID)
    designs = zip(grid["central_arm"].value, grid["ratio"], grid["pitch"].value, strict=True)
    assert {tuple(map(float, one)) for one in designs} == {*product((7.25, 9), (1, 1.8), (25.6, 31))}
    more, fewer = (flat.explore_designs(**GRID, n_designs=n, rng=3) for n in (64, 40))
    assert (fewer["loss"] == more["loss"][:40]).all()
    for name, (low, high) in {"central_arm": (7.25, 9), "ratio": (1, 1.8), "pitch": (25.6, 31)}.items():
        values = np.asarray(getattr(more[name], "value", more[name]))
        halves = np.bincount(((values - low) / (high - low) * 64).astype(int), minlength=64)
        assert halves.tolist() == [1] * 64  # each of the 64 slices contains one design, as for a digital net
    assert (more["clearance"] == 2.25 * MM).all()


@given(st.lists(st.tuples(*[st.sampled_from([0.0, 1.0, 2.0, 3.0, np.nan])] * 2), max_size=12), st.booleans())
def test_the_front_is_what_no_row_beats(rows, largest):
    table = QTable(np.array(rows).reshape(-1, 2), names=("coverage", "loss"))
    front = on_front(table, {"coverage": "max" if largest else "min", "loss": "min"})
    sign = -1 if largest else 1
    values = [(sign * a, b) for a, b in rows]
    for (a, b), found in zip(values, front, strict=True):
        beaten = any(c <= a and d <= b and (c, d) != (a, b) for c, d in values)
        assert found == (a == a and b == b and not beaten)


def test_objectives_can_be_chosen_and_rows_without_figures_are_not_on_the_front():
    reason = "the centers of neighboring positioners are closer than the minimum separation"
    with pytest.warns(rs.RfpsurveyWarning, match=f"1 of 3 designs have no values; .* such as: {reason}"):
        table = explore(pitch=[4, 25.6, 30] * MM, objectives={"usable_per_area": "max", "loss": "min"})
    assert table["reason"].tolist() == [reason, "", ""]
    assert np.isnan(table["loss"][0])
    assert table["pareto"].tolist() == [False, True, True]
    for words, column, options in (
        ("the reach of the arms exceeds 4 times the pitch", "coverage", {"ratio": 20}),
        ("outside the range of the method 'surrogate'", "loss", {"ratio": 3.2, "method": "surrogate"}),
        ("the number of targets per positioner exceeds 1000", "loss", {"target_density": 2 / MM**2}),
        ("no fiber has a target", "loss", {"estimand": "allocated", "targets_per_positioner": 1e-9}),
    ):
        with pytest.warns(rs.RfpsurveyWarning, match=words):
            assert np.isnan(explore(**options)[column][0])


def test_each_design_has_random_numbers_of_its_own():
    """The random numbers depend on the number of the design in the scan, and not on other designs of the same task."""
    task = Task("allocated", "conditional", 0.0, 2.0, False, 2, 1.0, 5)
    same = np.tile([8.25, 1.0, 25.6, 2.25], (4, 1))
    rows = task(0, same)
    assert len(set(rows["loss"])) == 4
    assert (task(2, same[2:]) == rows[2:]).all()


def test_nothing_depends_on_the_executor():
    options = {**GRID, "n_designs": 12, "estimand": "allocated", "n_skies": 2}
    alone = flat.explore_designs(**options)
    for pool in (ProcessPoolExecutor(1, get_context("spawn")), ThreadPoolExecutor(2)):
        with pool:
            assert (flat.explore_designs(executor=pool, **options) == alone).all()


@pytest.mark.parametrize("ending", ["ecsv", pytest.param("fits", marks=pytest.mark.exhaustive)])
def test_a_scan_that_was_stopped_ends_with_the_same_bytes(tmp_path, monkeypatch, ending):
    """The file always contains the finished designs, and a resumed scan does not repeat them."""
    options = {**GRID, "n_designs": 30, "rng": 5}
    whole, path = tmp_path / f"whole.{ending}", tmp_path / f"stopped.{ending}"
    expected = flat.explore_designs(path=whole, **options)
    calls, method = [], METHODS["surrogate"].function

    def stop(*arguments):
        calls.append(1)
        if len(calls) == 20:
            assert len(QTable.read(path)) > 0  # an interruption loses at most the last task
            raise KeyboardInterrupt
        return method(*arguments)

    monkeypatch.setattr(_checkpoint, "EVERY", -1.0)
    monkeypatch.setitem(METHODS, "surrogate", replace(METHODS["surrogate"], function=stop))
    with pytest.raises(KeyboardInterrupt):
        flat.explore_designs(path=path, **options)
    done = len(QTable.read(path))
    assert 0 < done < 30
    calls[:] = [0] * 100
    found = flat.explore_designs(path=path, resume=True, **options)
    assert len(calls) == 100 + np.count_nonzero(expected["method"][done:] == "surrogate")
    assert (found == expected).all()
    assert path.read_bytes() == whole.read_bytes()
    again = flat.explore_designs(path=path, resume=True, objectives={"usable": "max", "coverage": "max"}, **options)
    assert len(calls) == 100 + np.count_nonzero(expected["method"][done:] == "surrogate")
    assert again["pareto"].sum() > 0


def test_a_file_of_another_scan_is_not_continued(tmp_path):
    path = tmp_path / "scan.ecsv"
    explore(path=path)
    for options, words in (
        ({}, "exists; continue the scan"),
        ({"resume": True, "rng": 1}, "holds another scan: seed differ"),
        ({"resume": True, "ratio": 2.0}, "ratio differ"),
    ):
        with pytest.raises(rs.InputError, match=words):
            explore(path=path, **options)
    explore(path=path, overwrite=True, ratio=2.0)
    table = QTable.read(path)
    assert table["ratio"][0] == 2
    table["pitch"] *= 1.01
    table.write(path, overwrite=True)
    with pytest.raises(rs.InputError, match="is damaged: its designs differ from the designs"):
        explore(path=path, resume=True, ratio=2.0)
    QTable({"a": [1]}).write(path, overwrite=True)
    with pytest.raises(rs.InputError, match="must contain a scan of designs"):
        explore(path=path, resume=True)


def test_a_scan_by_other_software_is_continued_with_a_warning(tmp_path):
    path = tmp_path / "scan.ecsv"
    table = explore(path=path)
    table.meta["software"]["numpy"] = "0"
    table.write(path, overwrite=True)
    with pytest.warns(rs.RfpsurveyWarning, match="other versions of the software"):
        explore(path=path, resume=True)


BAD = {
    "central_arm must be a Quantity": {"central_arm": 8.25},
    "central_arm must be finite and above 0, got -1": {"central_arm": [8, -1] * MM},
    r"pitch must be one value or a one-dimensional array, got the shape \(1, 2\)": {"pitch": [[25, 26]] * MM},
    "clearance must be finite and at least 0, got nan": {"clearance": np.nan * MM},
    "ratio .* must be one or several numbers": {"ratio": "two"},
    "the values of ratio must differ from each other": {"ratio": [1, 1]},
    r"ratio must be one value or two limits \(low, high\)": {"ratio": [1, 2, 3], "n_designs": 8},
    "ratio must be one value or two limits": {"ratio": [2, 1], "n_designs": 8},
    "n_designs must be a whole number from 1": {"n_designs": 0},
    "a grid must have at most 1e.07 designs": {"ratio": np.arange(1, 9999), "pitch": np.arange(1, 9999) * MM},
    "unknown estimand 'optimal'": {"estimand": "optimal"},
    "unknown method of design studies 'best'": {"method": "best"},
    "must be 'collision_free' for the method 'optimal', got 'allocated'": {
        "method": "optimal",
        "estimand": "allocated",
    },
    "targets_per_positioner must be a number above 0": {"targets_per_positioner": 0},
    "but not both": {"target_density": 1 / MM**2, "targets_per_positioner": 4},
    "target_density must have a unit convertible to": {"target_density": 1 * MM},
    "n_skies must be a whole number of at least 2": {"n_skies": 1},
    "time_limit must be one finite value above 0": {"time_limit": 0 * u.s},
    "objectives must be two columns": {"objectives": {"loss": "min"}},
    "unknown column for an objective 'color'": {"objectives": {"loss": "min", "color": "max"}},
    "unknown direction of loss 'least'": {"objectives": {"loss": "least", "coverage": "max"}},
    "executor must be a concurrent.futures.Executor": {"executor": 2},
    "resume requires the path": {"resume": True},
    "must end in .fits or .ecsv": {"path": "scan.csv"},
}


def test_bad_input_is_a_sentence():
    for words, change in BAD.items():
        with pytest.raises(rs.InputError, match=words):
            explore(**change)


def scan(figure, **axes):
    """Return a table like that of a scan, with an additional column."""
    names = ("central_arm", "ratio", "pitch", "clearance")
    grid = np.stack(np.meshgrid(*(axes.get(name, [1.0]) for name in names), indexing="ij"), axis=-1).reshape(-1, 4)
    return QTable({**dict(zip(names, grid.T, strict=True)), "loss": figure(*grid.T)})


def test_shares_of_a_grid_are_those_of_the_analysis_of_variance(rng):
    """The shares are the variances of marginal means, for a column of random numbers on a grid."""
    table = scan(
        lambda *a: rng.random(a[0].size), central_arm=[7, 8, 10.0], ratio=[1, 1.1, 1.5, 2.0], pitch=[20.0, 30.0]
    )
    found = rs.design.design_sensitivities(table, figures="loss")
    cube = np.asarray(table["loss"]).reshape(3, 4, 2)
    main = [cube.mean(axis=axes).var() / cube.var() for axes in ((1, 2), (0, 2), (0, 1))]
    np.testing.assert_allclose(found["share"], [*main, 1 - sum(main)], rtol=1e-9)


def test_shares_and_slopes_of_known_functions():
    axes = {"central_arm": np.linspace(7, 9, 9), "pitch": np.linspace(20, 30, 9)}
    sum_of_two = rs.design.design_sensitivities(scan(lambda a, b, c, d: 3 * a + 0.5 * c, **axes), figures=["loss"])
    # variances are 9 and 0.25 times those of the axes; slopes are computed by hand at (8, 25)
    want = np.array([9 * axes["central_arm"].var(), 0.25 * axes["pitch"].var()])
    np.testing.assert_allclose(sum_of_two["share"], [*want / want.sum(), 0], atol=1e-12)
    np.testing.assert_allclose(sum_of_two["slope"][:2], [24 / 36.5, 12.5 / 36.5])
    product = rs.design.design_sensitivities(scan(lambda a, b, c, d: (a - 8) * (c - 25), **axes), figures=["loss"])
    np.testing.assert_allclose(product["share"], [0, 0, 1], atol=1e-12)
    flat = rs.design.design_sensitivities(scan(lambda a, b, c, d: 0 * a + 1, **axes), figures=["loss"])
    assert np.isnan(flat["share"]).all()


def test_sensitivities_that_make_no_sense_are_refused():
    for table, words in (
        (5, "must be a table that explore_designs returned"),
        (scan(lambda a, b, c, d: a), "at least one of central_arm, ratio, pitch and clearance must vary"),
        (scan(lambda a, b, c, d: a, central_arm=[1.0, 2.0]), "more than 2 designs with values, got 2"),
    ):
        with pytest.raises(rs.InputError, match=words):
            rs.design.design_sensitivities(table, figures=["loss"])
        with pytest.raises(rs.InputError, match=r"unknown column of designs|must be a table that"):
            rs.design.design_sensitivities(table, figures=["reason"])


def test_few_fibers_without_a_loss_are_no_proof_of_none():
    """Regression: a dozen fibers without a collision had a loss and an error of 0, and were on the front."""
    scan = {"central_arm": np.linspace(8, 10, 8) * u.mm, "ratio": 2.0, "pitch": 25 * u.mm, "clearance": 0.5 * u.mm}
    found = flat.explore_designs(**scan, targets_per_positioner=0.1, estimand="allocated")
    assert (found["loss"] == 0).any()
    assert (found["loss_error"] > 0).all()


def test_a_sky_that_nobody_reaches_is_a_sky_like_others():
    scan = {"central_arm": 7 * u.mm, "ratio": 1.5, "pitch": 25 * u.mm, "clearance": 2 * u.mm}
    (row,) = flat.explore_designs(**scan, targets_per_positioner=1e-3, estimand="allocated")
    assert row["reason"] in ("", "no fiber has a target")


def test_rivals_of_neighbors_compete_too():
    """Regression: neighbors at the edge of the patch had no competitors, and losses were too small by 1.4 percent."""
    scan = {"central_arm": 7.4 * u.mm, "ratio": 2.0, "pitch": 22.4 * u.mm, "clearance": 1.5 * u.mm}
    (row,) = flat.explore_designs(**scan, estimand="allocated", n_skies=100, rng=2)
    robot = rs.Positioner(7.4 * u.mm, 14.8 * u.mm, 1.5 * u.mm)
    wide = rs.FocalPlane.hexagonal(robot, rings=18, pitch=22.4 * u.mm)
    middle = np.hypot(*wide.xy.value.T) < 10 * 22.4
    cells = np.pi * (18 * 22.4 + 22.2) ** 2 / (np.sqrt(3) / 2 * 22.4**2)
    kinds = {"targets": "poisson", "n_targets": 4 * cells, "target_radius": (18 * 22.4 + 22.2) * u.mm}
    truth = flat.collision_probability(wide, max_iterations=24, **kinds, rng=5).per_positioner[middle].mean()
    assert row["loss"] == pytest.approx(truth, abs=3 * np.hypot(row["loss_error"], 0.0007))
