"""Slow and simple reference results: brute force, exact rational numbers, other packages."""

import itertools
from fractions import Fraction

import numpy as np
import shapely
from astropy.wcs import WCS
from shapely.ops import polygonize, unary_union


def segment_distances(segments, pairs):
    """Return the distances of pairs of segments, computed by shapely."""
    first, second = (shapely.linestrings(segments[pairs[:, k]].reshape(-1, 2, 2)) for k in (0, 1))
    return shapely.distance(first, second)


def annuli_coverage(plane, corners):
    """Return the fractions of a convex polygon that are covered by 0, 1, ... patrol areas, from shapely's overlay of
    all circles.
    """
    centers = plane.xy.value
    discs = [shapely.Point(c).buffer(plane.positioner.outer_radius.value, quad_segs=256) for c in centers]
    holes = [shapely.Point(c).buffer(max(plane.positioner.inner_radius.value, 1e-9), quad_segs=256) for c in centers]
    hull = shapely.MultiPoint(corners).convex_hull
    faces = polygonize(unary_union([hull.exterior, *(shape.exterior for shape in discs + holes)]))
    area = np.zeros(20)
    for face in faces:
        middle = face.representative_point()
        if hull.contains(middle):
            within = sum(d.contains(middle) and not h.contains(middle) for d, h in zip(discs, holes, strict=True))
            area[within] += face.area
    return area / hull.area


def closer_than(a, b, separation):
    """Return whether two segments are closer than ``separation``, in exact rational arithmetic."""
    return squared_distance(a, b) < Fraction(float(separation)) ** 2


def squared_distance(a, b):
    """Return the squared distance of two segments as an exact rational number."""
    a, b = [Fraction(float(v)) for v in a], [Fraction(float(v)) for v in b]
    p, q, r, s = (a[0], a[1]), (a[2], a[3]), (b[0], b[1]), (b[2], b[3])

    def turn(u, v, w):
        return (v[0] - u[0]) * (w[1] - u[1]) - (v[1] - u[1]) * (w[0] - u[0])

    if turn(p, q, r) * turn(p, q, s) < 0 and turn(r, s, p) * turn(r, s, q) < 0:
        return Fraction(0)
    return min(_to_segment(p, r, s), _to_segment(q, r, s), _to_segment(r, p, q), _to_segment(s, p, q))


def _to_segment(p, a, b):
    u, v = (b[0] - a[0], b[1] - a[1]), (p[0] - a[0], p[1] - a[1])
    length2 = u[0] ** 2 + u[1] ** 2
    t = Fraction(0) if length2 == 0 else min(max((u[0] * v[0] + u[1] * v[1]) / length2, Fraction(0)), Fraction(1))
    return (v[0] - t * u[0]) ** 2 + (v[1] - t * u[1]) ** 2


def in_annulus(point, center, l1, l2):
    """Return whether a point is in the closed patrol area, in exact rational arithmetic."""
    r2 = sum((Fraction(float(p)) - Fraction(float(c))) ** 2 for p, c in zip(point, center, strict=True))
    inner = 0 if abs(l1 - l2) < 1e-9 else abs(Fraction(l1) - Fraction(l2))
    return inner**2 <= r2 <= (Fraction(l1) + Fraction(l2)) ** 2


def tip_and_elbow(center, l1, l2, theta, phi):
    """Return the tip and the elbow of two arms as complex numbers; angles are in radians."""
    elbow = complex(*center) + l1 * np.exp(1j * theta)
    return elbow + l2 * np.exp(1j * (theta + phi)), elbow


def balanced_owner(xy, centers, reaches):
    """Return the owner of each target by a literal implementation of ``balanced``; ``reaches[i][t]`` states whether
    positioner i reaches target t.
    """
    count = [0] * len(centers)
    owner = []
    for t in range(len(xy)):
        candidates = [i for i in range(len(centers)) if reaches[i][t]]
        best = min(candidates, key=lambda i: (count[i], squared_apart(xy[t], centers[i]), i), default=-1)
        owner.append(best)
        if best >= 0:
            count[best] += 1
    return owner


def lamost_target(xy, centers, reaches, priority, place=None):
    """Return the target of each positioner by a literal implementation of ``lamost_rule``.

    A positioner nominates the target with the smallest ``place``; without it, the nearest target.
    """
    n, m = len(centers), len(xy)
    target, taken = [-1] * n, [False] * m
    for value in sorted(set(priority), reverse=True):
        while True:
            nominations = {}
            for i in range(n):
                mine = [t for t in range(m) if reaches[i][t] and not taken[t] and priority[t] == value]
                if target[i] < 0 and mine:
                    if place is None:
                        first = min(mine, key=lambda t: (squared_apart(xy[t], centers[i]), t))
                    else:
                        first = min(mine, key=lambda t: place[t])
                    nominations.setdefault(first, []).append(i)
            if not nominations:
                break
            choices = [sum(reaches[i][t] and not taken[t] for t in range(m)) for i in range(n)]
            for t, rivals in nominations.items():
                winner = min(rivals, key=lambda i: (choices[i], squared_apart(xy[t], centers[i]), i))
                target[winner] = t
                taken[t] = True
    return target


def squared_apart(a, b):
    return (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2


def tangent_plane_mm(coord, center, mm_per_deg, position_angle_deg):
    """Return gnomonic positions computed by astropy's WCS; the axes point east and north at position angle 0."""
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---TAN", "DEC--TAN"]
    wcs.wcs.crval = [center.ra.deg, center.dec.deg]
    wcs.wcs.crpix = [1, 1]
    wcs.wcs.lonpole = 180  # north is defined at the pole as at all other positions
    pa = np.deg2rad(position_angle_deg)
    # intermediate world coordinates (east, north) of one mm along +x and +y
    wcs.wcs.cd = np.array([[np.cos(pa), np.sin(pa)], [-np.sin(pa), np.cos(pa)]]) / mm_per_deg
    return np.column_stack(wcs.wcs_world2pix(coord.ra.deg, coord.dec.deg, 0))


def standing_arms(plane, tips, handedness=None, fiber_type=None, parked_obstacles=True):
    """Return the poses of all arms, computed for one positioner at a time with complex numbers: segment (or None),
    assigned, counted.
    """
    unit = plane.positioner
    nominal = unit.central_arm == unit.eccentric_arm
    arms, assigned, counted = [], [], []
    for i, (x, y) in enumerate(plane.xy.to_value("mm").tolist()):
        center = complex(x, y)
        l1 = (unit.central_arm if plane.central_arm is None else plane.central_arm[i]).to_value("mm")
        l2 = (unit.eccentric_arm if plane.eccentric_arm is None else plane.eccentric_arm[i]).to_value("mm")
        home = (0.0, np.pi) if unit.home is None else unit.home.to_value("rad").tolist()
        stuck = None if plane.stuck is None else plane.stuck[i].to_value("rad")
        tip = complex(*tips[i])
        pose, takes = None, False
        if stuck is not None and np.isfinite(stuck).all():
            pose = stuck
        elif plane.disabled[i]:
            pose = home
        elif np.isfinite(tip.real) and np.isfinite(tip.imag):
            takes = True
            sides = [handedness] if isinstance(handedness, str) else list(_HANDS[unit.handedness])
            poses = [_two_arms(tip - center, l1, l2, home[0], -1 if side == "left" else 1) for side in sides]
            allowed = [p for p in poses if _within(p[0], unit.theta_range) and _within(p[1], unit.phi_range)]
            pose = (allowed or poses)[0]
        elif parked_obstacles and (abs(l1 - l2) < 1e-9 or (nominal and abs(l1 - l2) <= 0.05 * (l1 + l2))):
            pose = home
        assigned.append(takes)
        counted.append(takes or (pose is home and not plane.disabled[i]))
        arms.append(None if pose is None else _body(plane, i, center, l1, l2, *pose, fiber_type))
    return arms, np.array(assigned), np.array(counted)


_HANDS = {"right": ("right",), "left": ("left",), "both": ("right", "left")}


def _two_arms(tip, l1, l2, home_theta, side):
    """Return the joint angles by the law of cosines."""
    r = abs(tip)
    if r == 0:
        return home_theta, side * np.pi
    at_center = np.arccos(np.clip((l1**2 + r**2 - l2**2) / (2 * l1 * r), -1, 1))
    theta = np.angle(tip) - side * at_center
    return theta, np.angle((tip - l1 * np.exp(1j * theta)) / np.exp(1j * theta))


def _within(angle, limits):
    if limits is None:
        return True
    low, high = limits.to_value("rad")
    return any(low - 1e-9 <= angle + 2 * np.pi * k <= high + 1e-9 for k in (-2, -1, 0, 1, 2))


def _body(plane, i, center, l1, l2, theta, phi, fiber_type):
    unit = plane.positioner
    elbow = center + l1 * np.exp(1j * theta)
    direction = np.exp(1j * (theta + phi))
    if unit.arm_model == "fiber_tip":
        return elbow + l2 * direction, elbow + l2 * direction
    if unit.arm_model == "capsule":
        used = str(plane.fiber_type[i]).split("+")[0] if fiber_type is None or not fiber_type[i] else fiber_type[i]
        angle = unit.arm_angle[used] if isinstance(unit.arm_angle, dict) else unit.arm_angle
        turn = 0.0 if angle is None else angle.to_value("rad")
        return elbow, elbow + unit.arm_length.to_value("mm") * direction * np.exp(1j * turn)
    return elbow, elbow + l2 * direction


def collisions_of(plane, arms):
    """Return colliding pairs, and pairs with obstacles, by testing every arm against all other arms with shapely."""
    there = [i for i, arm in enumerate(arms) if arm is not None]
    lines = {i: shapely.linestrings([(z.real, z.imag) for z in arms[i]]) for i in there}
    separation, clearance = plane.positioner.min_separation.to_value("mm"), plane.positioner.clearance.to_value("mm")
    pairs = [[i, j] for i in there for j in there if i < j and shapely.distance(lines[i], lines[j]) < separation]
    circles = [] if plane.obstacles is None else plane.obstacles.to_value("mm").tolist()
    hits = [
        [i, k]
        for i in there
        for k, (x, y, r) in enumerate(circles)
        if shapely.distance(lines[i], shapely.points(x, y)) - r < clearance
    ]
    return pairs, hits


def expectation(plane, queues, types=None, parked_obstacles=True):
    """Return exact expected values over all configurations, if one target of each queue is drawn with equal
    probabilities.

    Returns the value, the value of assigned positioners, the number of pairs divided by that of counted positioners,
    and the value of each positioner.
    """
    n = len(plane)
    rates, assigned_rates, pair_rates, times, counts = [], [], [], np.zeros(n), np.zeros(n)
    for choice in itertools.product(*(range(max(1, len(q))) for q in queues)):
        tips = [q[k] if len(q) else (np.nan, np.nan) for q, k in zip(queues, choice, strict=True)]
        used = [""] * n if types is None else [t[k] if len(t) else "" for t, k in zip(types, choice, strict=True)]
        arms, assigned, counted = standing_arms(plane, tips, fiber_type=used, parked_obstacles=parked_obstacles)
        pairs, hits = collisions_of(plane, arms)
        colliding = np.isin(np.arange(n), [i for pair in pairs for i in pair] + [i for i, _ in hits])
        times += colliding & counted
        counts += counted
        if counted.any():
            rates.append((colliding & counted).sum() / counted.sum())
            pair_rates.append(len(pairs) / counted.sum())
        if assigned.any():
            assigned_rates.append((colliding & assigned).sum() / assigned.sum())
    per_positioner = np.divide(times, counts, out=np.full(n, np.nan), where=counts > 0)
    return np.mean(rates), np.mean(assigned_rates) if assigned_rates else np.nan, np.mean(pair_rates), per_positioner


def balanced_queues(xy, centers, reaches):
    """Return the queues of ``balanced`` as a list of points for each positioner."""
    owner = np.array(balanced_owner(xy, centers, reaches), dtype=int)
    return [[tuple(p) for p in np.asarray(xy)[owner == i]] for i in range(len(centers))]


def closest_pairs_first(xy, centers, can, priority):
    """Assign the closest of all remaining pairs, one class after the other."""
    target_of = [-1] * len(centers)
    for value in sorted(set(priority), reverse=True):
        while True:
            left = [
                (squared_apart(xy[t], centers[i]), i, t)
                for t in range(len(xy))
                for i in range(len(centers))
                if can[i, t] and priority[t] == value and target_of[i] < 0 and t not in target_of
            ]
            if not left:
                break
            _, i, t = min(left)
            target_of[i] = t
    return target_of


def targets_in_order(xy, centers, can, order):
    """Assign each target, in the given order, to the closest free positioner that reaches it."""
    target_of = [-1] * len(centers)
    for t in order:
        free = [i for i in range(len(centers)) if can[i, t] and target_of[i] < 0]
        if free:
            target_of[min(free, key=lambda i: (squared_apart(xy[t], centers[i]), i))] = int(t)
    return target_of


def fewest_circles(catalog, radius):
    """Return the smallest number of circles that contain all targets.

    All circles through two targets, and around one target, are tried.
    """
    vectors = catalog.arrays.vectors
    centers = [*vectors]
    for a, b in itertools.combinations(vectors, 2):
        middle = (a + b) / np.linalg.norm(a + b)
        half = np.arccos(np.clip(a @ middle, -1, 1))
        if half <= radius:
            side = np.cross(a, b) / np.linalg.norm(np.cross(a, b))
            h = np.arccos(np.cos(radius) / np.cos(half)) * (1 - 1e-9)
            centers += [np.cos(h) * middle + np.sin(h) * side, np.cos(h) * middle - np.sin(h) * side]
    inside = np.array(centers) @ vectors.T >= np.cos(radius) - 1e-12
    sets = {int(sum(1 << int(k) for k in np.flatnonzero(row))) for row in inside}
    sets = [s for s in sets if not any(s != t and s & t == s for t in sets)]
    for n in range(1, 7):
        for some in itertools.combinations(sets, n):
            union = 0
            for one in some:
                union |= one
            if union == (1 << len(catalog)) - 1:
                return n
    raise AssertionError
