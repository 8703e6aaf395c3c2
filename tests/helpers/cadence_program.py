"""Random small surveys with cadences, and an integer program of all sequences of visits."""

from copy import deepcopy
from dataclasses import replace
from itertools import combinations

import astropy.units as u
import living
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table
from joint_program import SCALE, JointProgram
from naive_cadences import NAMES, TABLE, Naive

import rfpsurvey as rs
from rfpsurvey.survey import Cadences
from scenes import random_plane

CENTER = SkyCoord(10 * u.deg, 40 * u.deg)


def random_survey(seed, n_tiles=7):
    """Return an instrument with few positioners, dated tiles in random order, targets with cadences, and options."""
    rng = np.random.default_rng(seed)
    plane = random_plane(rng)
    instrument = rs.Instrument("small", plane, plate_scale=SCALE)
    m = int(rng.integers(4, 25))
    sky = CENTER.spherical_offsets_by(*(rng.uniform(-25, 25, (2, m)) * u.mm / SCALE))
    columns = {"priority": rng.integers(0, 2, m), "extra": QTable({"cadence": rng.choice([*NAMES, ""], m)})}
    if plane.fiber_types != ("",):
        columns["fiber_type"] = rng.choice(["", *plane.fiber_types], m)
    night = np.sort(rng.integers(0, 8, n_tiles))
    place = CENTER.spherical_offsets_by(*(rng.uniform(-4, 4, (2, n_tiles)) * u.mm / SCALE))
    table = QTable({"ra": place.ra, "dec": place.dec, "mjd": 60000 + night + np.arange(n_tiles) / 50})
    table["skybrightness"] = rng.choice([0.2, 1.0], n_tiles)
    table["pass"] = np.arange(n_tiles)
    tiling = rs.Tiling.from_table(table[rng.permutation(n_tiles)])
    return instrument, tiling, rs.Catalog(sky, **columns), rs.AllocationOptions("optimal", parked_obstacles=False)


def sequences(before, tiles, days, brightness):
    """Yield each list of tiles that completes epochs only, the visits of these epochs, and whether they are the last.

    ``before`` is the target with its earlier visits.
    """
    n = len(before.starts)
    for number in range(1, len(tiles) + 1):
        for some in combinations(tiles, number):
            target = deepcopy(before)
            for tile in some:
                if not target.allows(days[tile], brightness[tile])[0]:
                    break
                target.observe(days[tile])
            else:
                visits = int(sum(one[2] for one in target.epochs[n : len(target.starts)]))
                began = before.now[:1] if before.now and days[some[0]] - before.now[0] <= 0.5 else []
                if len(target.starts) > n and not target.now and visits == number + len(began and before.now):
                    yield some, visits, len(target.starts) == len(target.epochs)


def with_sequences(instrument, tiling, catalog, before=None, planned=None):
    """Return the integer program, and the weights of visits and of complete cadences of each class.

    ``before`` are the targets with their earlier visits, and ``planned`` the rows of the tiles that can be used.
    """
    before = [Naive(str(name)) for name in catalog.extra["cadence"]] if before is None else before
    planned = range(len(tiling)) if planned is None else planned
    plain = replace(catalog, kind=None, extra=None, visits=np.full(len(catalog), len(tiling)))
    program = JointProgram(instrument, tiling.coord, plain, False)
    days, brightness = (np.asarray(tiling.table[name]) for name in ("mjd", "skybrightness"))
    n = len(program.target)
    target, tile, found = program.target.copy(), program.tile.copy(), []
    science = science_targets(catalog)
    for t in np.flatnonzero(science).tolist():
        tiles = [k for k in np.argsort(days).tolist() if k in planned and ((target == t) & (tile == k)).any()]
        some = list(sequences(before[t], tiles, days, brightness))
        index = program.extend(len(some))
        if some:
            program.add(index, 1)
        for k in tiles:
            mine, uses = np.flatnonzero((target == t) & (tile == k)), index[[k in one[0] for one in some]]
            values = np.append(np.ones(len(mine)), -np.ones(len(uses)))
            program.add(np.append(mine, uses), 0, 0, values)
        found += [(t, visits, whole) for _, visits, whole in some]
    rows = np.array(found, dtype=int).reshape(-1, 3)
    classes = np.unique(catalog.priority[science])[::-1]
    weights = np.zeros((len(classes), 2, len(program.target)))
    for k, value in enumerate(classes):
        mine = catalog.priority[rows[:, 0]] == value
        weights[k, 0, n:], weights[k, 1, n:] = rows[:, 2] * mine, rows[:, 1] * mine
    return program, weights


def science_targets(catalog):
    return np.ones(len(catalog), bool) if catalog.kind is None else np.char.find(catalog.kind, "science") >= 0


def counts_of(survey, catalog):
    """Return the complete cadences and the visits of each class, class by class."""
    science = science_targets(catalog)
    whole = np.asarray(survey.outcomes["observed"] == survey.outcomes["requested"])[science]
    visits, priority = np.asarray(survey.outcomes["observed"])[science], catalog.priority[science]
    classes = np.unique(priority)[::-1]
    return [[int(one[priority == value].sum()) for one in (whole, visits)] for value in classes]


def check_windows(survey, tiling, catalog):
    """Check that every visit is allowed, completes an epoch, and collides with no other arm."""
    targets = [Naive(str(name)) for name in catalog.extra["cadence"]]
    days, brightness = (np.asarray(tiling.table[name]) for name in ("mjd", "skybrightness"))
    for tile in np.argsort(days).tolist():
        visits = survey._visits(tile)
        assert not np.asarray(visits["in_collision"]).any()
        rows = np.asarray(visits["target_row"])
        others = set()
        if catalog.kind is not None:
            others = {*rows[np.char.find(np.asarray(visits["kind"]).astype(str), "science") < 0].tolist()}
        for row in rows[rows >= 0].tolist():
            if row in others:
                continue
            assert targets[row].allows(days[tile], brightness[tile])[0]
            targets[row].observe(days[tile])


def scene(seed, n=80, n_tiles=40):
    """Return targets with cadences, and tiles in random order; nights have up to three tiles."""
    rng = np.random.default_rng(seed)
    sky = rs.synthetic_catalog("uniform", living.CENTER, 0.2 * u.deg, n_targets=n, rng=seed)
    extra = QTable({"cadence": rng.choice([*NAMES, ""], n), "kind_of": rng.integers(0, 9, n)})
    catalog = rs.Catalog(sky.coord, id=1000 + np.arange(n), priority=rng.integers(1, 3, n), extra=extra)
    night = np.sort(rng.integers(0, n_tiles, n_tiles))
    table = QTable({"tile": np.arange(n_tiles), "mjd": 60000 + night + rng.permutation(n_tiles) / 100})
    offset = [living.CENTER.spherical_offsets_by(*(rng.uniform(-0.02, 0.02, 2) * u.deg)) for _ in range(n_tiles)]
    table["ra"], table["dec"] = [[getattr(one, name).deg for one in offset] * u.deg for name in ("ra", "dec")]
    table["skybrightness"] = rng.choice([0.2, 1.0], n_tiles)
    return catalog, rs.Tiling.from_table(table[rng.permutation(n_tiles)])


def plan(catalog, tiling, model=None, visits=TABLE, **options):
    """Plan a survey with cadences, or with numbers of visits, with the allocator ``nearest``."""
    visits, options = Cadences(visits) if isinstance(visits, Table) else visits, {"allocator": "nearest", **options}
    return rs.plan_survey(catalog, model or living.instrument(), tiling, visits=visits, **options)


def with_columns(tiling, **columns):
    table = tiling.table.copy()
    for name, value in columns.items():
        table[name] = value
    return rs.Tiling(table)
