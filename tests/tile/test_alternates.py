"""Alternates of fibers, against a search that moves one arm at a time and computes the collisions of all arms."""

import pickle

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from raising import refused

import rfpsurvey as rs
from scenes import random_plane

CENTER = SkyCoord(95, 23, unit="deg")
ROLES = ["science", "standard", "sky", "science+standard"]


def scene(seed):
    """Return an instrument with a random focal plane, and targets with priorities, roles and magnitudes."""
    rng = np.random.default_rng(seed)
    plane = random_plane(rng)
    n = int(rng.integers(30, 60))
    sky = rs.synthetic_catalog("uniform", CENTER, 0.2 * u.deg, n_targets=n, rng=seed)
    types = rng.choice([*plane.fiber_types, ""], n) if plane.fiber_types != ("",) else None
    numbers = {"priority": rng.integers(1, 3, n), "subpriority": rng.choice([0.2, 0.4], n), "id": 700 + np.arange(n)}
    catalog = rs.Catalog(
        sky.coord, kind=rng.choice(ROLES, n), fiber_type=types, extra={"bright": rng.uniform(10, 16, n)}, **numbers
    )
    return rs.Instrument("tiny", plane, plate_scale=200 * u.mm / u.deg), catalog


def poses(tile, model):
    """Return the tips (mm), hands and fiber types of the planned arms; tips are NaN without a target."""
    plane, table = model.focal_plane, tile.table
    tips, elbow = (np.column_stack([table[f"{name}_{axis}"].value for axis in "xy"]) for name in ("tip", "elbow"))
    tips[table["status"] != "assigned"] = np.nan
    (ax, ay), (bx, by) = (elbow - plane.arrays.xy).T, (tips - plane.arrays.xy).T
    is_right = (ax * by - ay * bx >= 0) if plane.positioner.handedness == "both" else np.full(len(plane), True)
    types = np.asarray(table["fiber_type"]) if "fiber_type" in table.colnames else None
    return tips, np.where(is_right, "right", "left"), types


def is_free(model, tips, hands, types, *, row, point, hand, fiber):
    """Return whether the arm in a row collides with nothing after it moved to a point; None if no pose is possible."""
    tips, hands, types = tips.copy(), hands.copy(), None if types is None else types.copy()
    tips[row], hands[row] = point, hand
    if types is not None:
        types[row] = fiber
    try:
        report = rs.find_collisions(model.focal_plane, tips * u.mm, handedness=hands, fiber_type=types)
    except rs.InputError:
        return None
    return not report.in_collision[row]


def search(tile, model, catalog, brightest):
    """Return the alternates of each positioner in their order, and the number of targets in reach that collide."""
    plane, table, outcomes = model.focal_plane, tile.table, tile.outcomes
    points = np.column_stack([outcomes[name].to_value(u.mm) for name in ("x", "y")])
    row_of = {name: k for k, name in enumerate(catalog.id.tolist())}
    rows = [row_of[name] for name in outcomes["target_id"].tolist()]
    fibers = np.full(len(rows), "") if catalog.fiber_type is None else catalog.fiber_type[rows]
    planned = poses(tile, model)
    has_target = np.isfinite(planned[0][:, 0])
    used = set(outcomes["target_id"][~np.ma.getmaskarray(outcomes["positioner"])].tolist())
    can = plane.reachable(points * u.mm, None if catalog.fiber_type is None else fibers).toarray()
    hands = ("right", "left") if plane.positioner.handedness == "both" else ("right",)
    lists, n_blocked = {}, 0
    for i, name in enumerate(plane.id.tolist()):
        roles = set(table["kind"][i].split("+")) if has_target[i] else {"science"}
        place, each = planned[0][i] if has_target[i] else plane.arrays.xy[i], []
        for t in np.flatnonzero(can[i]).tolist():
            row, target = rows[t], int(catalog.id[rows[t]])
            kinds = set(str(catalog.kind[row]).split("+")) - (
                {"standard"} if catalog.extra["bright"][row] < brightest else set()
            )
            if target in used or not kinds & roles:
                continue
            where = {"row": i, "point": points[t], "fiber": fibers[t]}
            if any(is_free(model, *planned, hand=hand, **where) for hand in hands):
                each.append((-catalog.priority[row], -catalog.subpriority[row], np.hypot(*(points[t] - place)), target))
            else:
                n_blocked += 1
        lists[name] = [target for *_, target in sorted(each)]
    return lists, n_blocked


def listed(table):
    """Return the targets of each positioner in a table of alternates."""
    lists = {}
    for name, rank, target in zip(
        table["positioner"].tolist(), table["rank"].tolist(), table["target_id"].tolist(), strict=True
    ):
        lists.setdefault(name, []).append(target)
        assert rank == len(lists[name])
    return lists


@pytest.mark.filterwarnings("ignore")
def test_alternates_are_those_of_a_search_over_single_moves():
    numbers = np.zeros(3, dtype=int)
    for seed in range(60):
        model, catalog = scene(seed)
        constraints = ["standard=1", "sky=1", "magnitude bright 12 20 standard"]
        options = rs.AllocationOptions(("repair", "nearest")[seed % 2], constraints=constraints)
        if not model.focal_plane.arrays.usable.any():
            continue
        tile = rs.plan_tile(catalog, model, CENTER, allocator=options)
        expected, n_blocked = search(tile, model, catalog, 12)
        table = tile.alternates(99)
        assert listed(table) == {name: targets for name, targets in expected.items() if targets}, seed
        for n in (1, 2):
            assert listed(tile.alternates(n)) == {name: targets[:n] for name, targets in expected.items() if targets}
        planned, ids = poses(tile, model), model.focal_plane.id.tolist()
        for row in table if "handedness" in table.colnames else ():
            where = {"row": ids.index(row["positioner"]), "point": [row["x"].value, row["y"].value], "fiber": ""}
            assert is_free(model, *planned, hand=row["handedness"], **where)
        numbers += len(table), n_blocked, "handedness" in table.colnames
    assert (numbers > [400, 200, 3]).all(), numbers


@pytest.mark.filterwarnings("ignore:.*does not prove that folded arms can turn")
def test_arms_unfold_to_alternates_without_collisions():
    unit = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    plane = rs.FocalPlane.hexagonal(unit, rings=2, pitch=19 * u.mm)
    model, n_moving, n_resting = rs.Instrument("tiny", plane, plate_scale=200 * u.mm / u.deg), 0, 0
    for seed in range(6):
        sky = rs.synthetic_catalog("uniform", CENTER, 0.25 * u.deg, n_targets=60, rng=seed)
        law = ("same_duration", "same_speed")[seed % 2]
        options = rs.AllocationOptions("repair", constraints=[f"motion fold {law}"])
        tile = rs.plan_tile(sky, model, CENTER, allocator=options)
        table, (tips, _, _) = tile.alternates(99), poses(tile, model)
        listed_pairs = {*zip(table["positioner"].tolist(), table["target_id"].tolist(), strict=True)}
        resting = rs.plan_tile(
            sky,
            model,
            CENTER,
            allocator=lambda _, plan=tile.field_targets.plan: (
                plan.allocation.target_of_positioner,
                plan.allocation.handedness,
            ),
        ).alternates(99)
        points = {row["target_id"]: (row["x"].value, row["y"].value) for row in resting}
        pairs = {*zip(resting["positioner"].tolist(), resting["target_id"].tolist(), strict=True)}
        assert listed_pairs <= pairs
        for i, target in pairs:
            moved = tips.copy()
            moved[i] = points[target]
            report = rs.collision.find_motion(plane, moved * u.mm, law=law)
            assert ((i, target) not in listed_pairs) == (report.blocked[i] or i in report.pairs)
        n_moving, n_resting = n_moving + len(listed_pairs), n_resting + len(pairs)
    assert 0 < n_moving < n_resting


def test_tiles_without_a_plan_in_memory_have_no_alternates(tmp_path):
    model, catalog = scene(1)
    tile = rs.plan_tile(catalog, model, CENTER, allocator="repair")
    assert (
        pickle.loads(pickle.dumps(tile.field_targets)).plan.targets.id.tolist()
        == tile.field_targets.plan.targets.id.tolist()
    )
    refused("alternates must be a whole number of at least 1", tile.alternates, 0)
    tile.write(tmp_path / "tile.fits")
    refused("alternates need a tile that plan_tile returned", rs.Tile.read(tmp_path / "tile.fits").alternates)
