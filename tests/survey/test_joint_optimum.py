"""Joint plans of small surveys, compared with an integer program that contains all tiles."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from scipy.optimize import Bounds, LinearConstraint, milp

import rfpsurvey as rs
from brute import bodies_of, conflicts_of, options_of
from scenes import random_plane

MM = u.mm
N_CASES, CHUNK = 1000, 20
SCALE = 200 * MM / u.deg
EXHAUSTIVE = pytest.mark.exhaustive
pytestmark = pytest.mark.filterwarnings("ignore:no target was observed")


def random_survey(seed):
    """Return an instrument with few positioners, overlapping tiles, targets and options."""
    rng = np.random.default_rng(seed)
    plane = random_plane(rng)
    instrument = rs.Instrument("small", plane, plate_scale=SCALE)
    m, n = int(rng.integers(5, 31)), int(rng.integers(2, 4))
    center = SkyCoord(10 * u.deg, 40 * u.deg)
    xi, eta = rng.uniform(-32, 32, (2, m)) * MM / SCALE
    sky = center.spherical_offsets_by(xi, eta)
    xi, eta = rng.uniform(-14, 14, (2, n)) * MM / SCALE
    tiles = center.spherical_offsets_by(xi, eta)
    columns = {"priority": rng.integers(0, rng.integers(1, 4), m).astype(float), "visits": rng.integers(0, 4, m)}
    if plane.fiber_types != ("",):
        columns["fiber_type"] = rng.choice(["", *plane.fiber_types], m)
    options = rs.AllocationOptions("optimal", parked_obstacles=bool(rng.random() < 0.5))
    return instrument, tiles, rs.Catalog(sky, **columns), options


def best_visits(instrument, tiles, catalog, parked):
    """Return the largest lexicographic numbers of visits by priority, and the largest sums of the first of them."""
    plane = instrument.focal_plane
    both = plane.positioner.handedness == "both"
    row, column, high, low, targets, n, n_rows = [], [], [], [], [], 0, 0

    def add(indices, most, least=-np.inf):
        nonlocal n_rows
        row.extend([n_rows] * len(indices))
        column.extend(indices)
        high.append(most)
        low.append(least)
        n_rows += 1

    of_target = {}
    for tile in tiles:
        place = np.deg2rad([tile.ra.deg, tile.dec.deg, 0.0])
        types = catalog.fiber_type
        xy = instrument.field_projection(*place, None).project(catalog.arrays.vectors, types)
        choices = options_of(plane, xy, types, both)
        pairs, barred = conflicts_of(plane, bodies_of(plane, xy, choices, types, parked))
        index, here = {}, {}
        for i, mine in enumerate(choices):
            for k, option in enumerate(mine):
                index[i, k] = n
                targets.append(-1 if option is None else option[0])
                if option is not None:
                    here.setdefault(option[0], []).append(n)
                n += 1
            add([index[i, k] for k in range(len(mine))], 1, 1)
        for a, b in pairs:
            add([index[a], index[b]], 1)
        for a in barred:
            add([index[a]], 0)
        for t, indices in here.items():
            add(indices, 1)
            of_target.setdefault(t, []).extend(indices)
    for t, indices in of_target.items():
        add(indices, catalog.visits[t])
    matrix = np.zeros((n_rows, n))
    matrix[row, column] = 1.0
    targets = np.array(targets)
    wanted = catalog.priority[catalog.visits > 0]
    classes = np.unique(wanted)[::-1]
    priority = np.append(catalog.priority, np.nan)[targets]
    hits = (priority == classes[:, None]).astype(float)

    def maximize(weights):
        found = milp(-weights, constraints=LinearConstraint(matrix, low, high), integrality=1, bounds=Bounds(0, 1))
        assert found.success
        return np.round(found.x)

    steep = 64.0 ** -np.arange(len(classes))
    best = hits @ maximize(64.0 ** (len(classes) - 1) * steep @ hits)
    sums = [hits[: k + 1].sum(axis=0) @ maximize(hits[: k + 1].sum(axis=0)) for k in range(len(classes))]
    return best, np.array(sums), classes


def visits_by_class(survey, catalog, classes):
    rows = np.concatenate([np.asarray(part["target_row"])[np.asarray(part["observed"])] for part in survey])
    return np.array([(catalog.priority[rows] == p).sum() for p in classes])


@pytest.mark.few(1)
@pytest.mark.parametrize("chunk", [0, 1, *(pytest.param(k, marks=EXHAUSTIVE) for k in range(2, N_CASES // CHUNK))])
def test_no_plan_exceeds_the_bound_and_no_plan_is_worse_than_tile_after_tile(chunk):
    n_best = 0
    for seed in range(CHUNK * chunk, CHUNK * (chunk + 1)):
        instrument, tiles, catalog, options = random_survey(seed)
        if not catalog.visits.any():
            continue
        best, sums, classes = best_visits(instrument, tiles, catalog, options.parked_obstacles)
        first = rs.plan_survey(catalog, instrument, tiles, allocator=options)
        size = [10, 40, 2000][seed % 3]
        joint = rs.JointOptions(iterations=4, patch_size=size, allocator=options)
        survey = rs.plan_survey(catalog, instrument, tiles, allocator=joint)
        visits = visits_by_class(survey, catalog, classes)
        before = visits_by_class(first, catalog, classes)
        assert tuple(visits) >= tuple(before), seed
        assert tuple(visits) <= tuple(best), seed
        levels = survey.summary["joint"]["levels"]
        bounds = np.array([level["bound"] for level in levels])
        assert (bounds >= sums).all(), (seed, bounds, sums)
        assert [level["n_visits"] for level in levels] == np.cumsum(visits).tolist(), seed
        assert [level["n_visits_before"] for level in levels] == np.cumsum(before).tolist(), seed
        check_plan(survey, catalog)
        if size == 2000:  # a single patch contains all positioners
            assert tuple(visits) == tuple(best), seed
            assert (bounds == sums).all(), seed
        n_best += tuple(visits) == tuple(best)
    assert n_best >= 0.75 * CHUNK


def check_plan(survey, catalog):
    """Check that no arm with a target collides, and that no target is observed too often."""
    number = np.zeros(len(catalog), dtype=int)
    for part in survey:
        assert not np.asarray(part["in_collision"]).any()
        rows = np.asarray(part["target_row"])
        assert len(np.unique(rows)) == len(rows)
        number[rows] += 1
    assert (number <= catalog.visits).all()
