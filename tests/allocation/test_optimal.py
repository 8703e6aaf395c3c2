"""Proven plans, compared with all possible plans."""

import astropy.units as u
import numpy as np
import pytest

import flat
import rfpsurvey as rs
from brute import best_plan, bodies_of, conflicts_of, options_of
from scenes import random_plane

MM = u.mm
CHUNK, EXHAUSTIVE = 25, pytest.mark.exhaustive


def random_case(seed, *, quotas):
    rng = np.random.default_rng(seed)
    plane, m = random_plane(rng), int(rng.integers(1, 10))
    xy = plane.arrays.xy[rng.integers(len(plane), size=m)] + rng.uniform(-16, 16, (m, 2))
    options = {"priority": rng.integers(0, rng.integers(1, 4), m).astype(float)}
    if plane.fiber_types != ("",):
        options["fiber_type"] = rng.choice(["", *plane.fiber_types], m)
    if quotas:
        options["kind"] = rng.choice(["science", "science", "standard", "sky"], m)
        options["category"] = rng.choice(["good", "poor", "odd"], m)
        names = rng.choice(["sky", "standard", "science", "good", "poor", "missing"], rng.integers(1, 4), replace=False)
        options["requirements"] = []
        for what in names:
            low, more = int(rng.integers(0, 4)), int(rng.integers(0, 3))
            most = None if rng.random() < 0.5 else low + more
            per = rng.choice(["tile", "spectrograph"])
            fiber = str(rng.choice(["", *plane.fiber_types]))
            options["requirements"].append(rs.Requirement(str(what), low, most, str(per), fiber))
        if rng.random() < 0.3:
            options["required"] = np.flatnonzero(rng.random(m) < 0.3)
        if rng.random() < 0.3:
            options["objective"] = "count"
        if rng.random() < 0.3:
            options["forbidden"] = np.unique(
                np.column_stack([rng.integers(len(plane), size=3), rng.integers(m, size=3)]), axis=0
            )
    options["parked_obstacles"] = bool(rng.random() < 0.5)
    return plane, xy, options


def judge(plane, xy, options):
    """Return a function that computes the value of a plan as a tuple, or None if the plan exceeds a maximum."""
    m, priority = len(xy), options["priority"]
    kind = options.get("kind", np.full(m, "science"))
    category = options.get("category", np.full(m, ""))
    fibers = options.get("fiber_type", np.full(m, ""))
    required = np.isin(np.arange(m), options.get("required", []))
    first, science = [row.split("+")[0] for row in plane.fiber_type], kind == "science"

    def spectrograph(i, t):
        if plane.spectrograph.ndim == 1:
            return plane.spectrograph[i]
        return plane.spectrograph[i, plane.fiber_types.index(fibers[t] or first[i])]

    def counts(one, i, t):
        named = category[t] == one.what if (category == one.what).any() else kind[t] == one.what
        return named and one.fiber_type in ("", fibers[t] or first[i])

    def value(plan):
        pairs, lack = [(i, option[0]) for i, option in enumerate(plan) if option is not None], 0
        for one in options.get("requirements", ()):
            places = [None] if one.per == "tile" else sorted(set(plane.spectrograph.ravel().tolist()))
            for place in places:
                n = sum(counts(one, i, t) and place in (None, spectrograph(i, t)) for i, t in pairs)
                if one.maximum is not None and n > one.maximum:
                    return None
                lack += max(one.minimum - n, 0)
        targets = [t for _, t in pairs]
        classes = [sum(science[t] and priority[t] == p for t in targets) for p in sorted(set(priority[science]))[::-1]]
        head = [int(required[targets].sum()) if targets else 0, -lack]
        if options.get("objective") == "count":
            head.append(sum(classes))
        return (*head, *classes, len(targets))

    return value


@pytest.mark.few(4)
@pytest.mark.parametrize("quotas", [False, True])
@pytest.mark.parametrize("method", ["network_flow", "optimal"])
@pytest.mark.parametrize("chunk", [0, *(pytest.param(k, marks=EXHAUSTIVE) for k in range(1, 8))])
def test_no_plan_is_better(method, chunk, quotas):
    for seed in range(CHUNK * chunk, CHUNK * (chunk + 1)):
        plane, xy, options = random_case(seed, quotas=quotas)
        collide = method == "optimal"
        forbidden = {tuple(row) for row in options.get("forbidden", np.empty((0, 2), int)).tolist()}
        both = collide and plane.positioner.handedness == "both"
        choices = options_of(plane, xy, options.get("fiber_type"), both, forbidden)
        pairs, barred = set(), set()
        if collide:
            bodies = bodies_of(plane, xy, choices, options.get("fiber_type"), options["parked_obstacles"])
            pairs, barred = conflicts_of(plane, bodies)
        value = judge(plane, xy, options)
        r2 = ((xy[None] - plane.arrays.xy[:, None]) ** 2).sum(axis=2)
        weight = 0.0 if collide else 1.0
        best = best_plan(
            choices,
            pairs,
            barred,
            value,
            lambda plan, r2=r2, w=weight: w * sum(r2[i, o[0]] for i, o in enumerate(plan) if o is not None),
        )
        found = flat.allocate(plane, xy * MM, allocator=method, **options)
        plan = [None if t < 0 else (t, h) for t, h in zip(found.target_of_positioner, found.handedness, strict=True)]
        assert value(plan) == best[0], seed
        assert found.gap == 0, seed
        if not collide:
            cost = sum(r2[i, t] for i, t in enumerate(found.target_of_positioner) if t >= 0)
            assert cost == pytest.approx(-best[1], rel=1e-9, abs=1e-6), seed
        else:
            report = rs.find_collisions(plane, found)
            assert not (found.target_of_positioner[report.pairs] >= 0).any(), seed
            assert not (found.target_of_positioner[report.obstacle_pairs[:, 0]] >= 0).any(), seed
        said = {level.name: level.value for level in found.levels}
        assert said.get("requirements", 0.0) == best[0][1], seed
        assert all(level.value == level.bound for level in found.levels), seed
