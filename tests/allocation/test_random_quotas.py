"""Requirements, limits, required targets and forbidden pairs of random scenes, compared with direct counts."""

import astropy.units as u
import numpy as np
import pytest

import flat
import rfpsurvey as rs
from scenes import two_fibers

MM = u.mm
FILLING = ["lamost_rule", "network_flow", "optimal", "repair"]


def held(one, plane, pairs, kind, category, fiber, place=None):
    """Count the pairs that a requirement counts, by the fiber that observes each target."""
    n = 0
    for i, t in pairs:
        group = category if one.what in set(category) else kind
        first, column = plane.fiber_type[i].split("+")[0], plane.spectrograph[i]
        if np.ndim(column):
            column = column[plane.fiber_types.index(fiber[t] or first)]
        n += group[t] == one.what and one.fiber_type in ("", fiber[t] or first) and place in (None, column)
    return n


def random_case(seed):
    """Return a plane of two fiber types with crowded targets, standards and sky positions, and limits of all kinds."""
    rng, plane = np.random.default_rng(seed), two_fibers()
    spectrograph = rng.integers(0, 3, (37, 2) if seed % 2 else 37)
    plane = rs.FocalPlane(plane.xy, plane.positioner, fiber_type=plane.fiber_type, spectrograph=spectrograph)
    n = 160
    options = {
        "kind": rng.choice(["science", "science", "standard", "sky"], n),
        "category": rng.choice(["faint", "bright", ""], n),
        "fiber_type": rng.choice(["A", "B", ""], n),
        "priority": rng.integers(0, 3, n),
        "required": np.flatnonzero(rng.random(n) < 0.04),
        "requirements": [
            rs.Requirement("standard", 3, 3, "spectrograph"),
            rs.Requirement("sky", 4, 6, "tile", "A"),
            rs.Requirement("faint", 0, int(rng.integers(4, 9))),
            rs.Requirement("science", 1, 5, "spectrograph"),
            rs.Requirement("bright", int(rng.integers(3, 30))),
        ],
        "forbidden": np.column_stack([rng.integers(0, 37, 200), rng.integers(0, n, 200)]),
    }
    return plane, rng.uniform(-75, 75, (n, 2)), options


def counts_of(plane, found, options):
    """Return each requirement, the spectrograph to which it applies, and its count."""
    pairs = [(i, t) for i, t in enumerate(found.target_of_positioner) if t >= 0]
    columns = options["kind"], options["category"], options["fiber_type"]
    for one in options["requirements"]:
        for place in [None] if one.per == "tile" else np.unique(plane.spectrograph):
            yield one, place, held(one, plane, pairs, *columns, place=place)


@pytest.mark.few(4)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("method", FILLING)
def test_unmet_is_what_a_count_by_hand_finds(method, seed):
    """No maximum is exceeded, except by ``lamost_rule``."""
    plane, xy, options = random_case(seed)
    found = flat.allocate(plane, xy * MM, allocator=method, **options)
    lacking, n_full = {}, 0
    for one, place, n in counts_of(plane, found, options):
        if n < one.minimum or (one.maximum is not None and n > one.maximum):
            assert n < one.minimum or method == "lamost_rule"
            lacking[one, place] = (one.minimum if n < one.minimum else one.maximum, n)
        n_full += n == one.maximum
    assert n_full > 1 or method == "lamost_rule"
    by_name = {(s.requirement, s.spectrograph): (s.requested, s.found) for s in found.unmet if s.requirement}
    assert by_name == lacking
    can = plane.reachable(xy * MM, options["fiber_type"]).toarray()
    can[tuple(options["forbidden"].T)] = False
    for s in found.unmet:
        if s.requirement is None:
            required = options["required"]
            n, possible = np.isin(required, found.target_of_positioner).sum(), can.any(axis=0)[required].sum()
            assert (s.requested, s.found, s.possible) == (len(required), n, possible)
            continue
        columns = options["kind"], options["category"], options["fiber_type"]
        counted = {t for i, t in np.argwhere(can) if held(s.requirement, plane, [(i, t)], *columns, s.spectrograph)}
        assert s.possible == len(counted)
    assert not any(found.target_of_positioner[i] == t for i, t in options["forbidden"])


@pytest.mark.parametrize("method", ["network_flow", "optimal"])
def test_a_plan_out_of_time_is_a_plan_all_the_same(method):
    for seed in range(6):
        plane, xy, options = random_case(seed)
        found = flat.allocate(plane, xy * MM, allocator=method, time_limit=1e-9 * u.s, **options)
        counts = counts_of(plane, found, options)
        assert not any(n > one.maximum for one, _, n in counts if one.maximum is not None)
    plane, xy, options = random_case(1)
    found, best = (
        flat.allocate(plane, xy * MM, allocator=method, **limit, **options)
        for limit in ({"time_limit": 1e-9 * u.s}, {})
    )
    assert 10 < found.n_assigned <= 37
    assert found.gap > 0 == best.gap
    lacks = [
        sum(s.requested - s.found for s in plan.unmet if s.requirement and s.requested > s.found)
        for plan in (found, best)
    ]
    assert lacks[0] >= lacks[1]
