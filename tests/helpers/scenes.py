"""Focal planes with all properties that make instruments difficult, and options for scoring them."""

from dataclasses import replace

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord

import rfpsurvey as rs

MM = u.mm
CENTER = SkyCoord(95, 23, unit="deg")
SEPARATE_HOME = {"home": [40, 180] * u.deg}
CAPSULE = {"arm_model": "capsule", "arm_length": 14.5 * MM, "arm_angle": {"B": 2 * u.deg, "A": -3 * u.deg}}


def lamost_like(rings=3, **options):
    unit = rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM, **options)
    return rs.FocalPlane.hexagonal(unit, rings=rings, pitch=25.6 * MM)


def sdss_like(rings=3, l2=15.0, **options):
    unit = rs.Positioner(7.4 * MM, l2 * MM, 2.5 * MM, step=0.1 * u.deg, **options)
    return rs.FocalPlane.hexagonal(unit, rings=rings, pitch=22.4 * MM)


def two_fibers():
    unit = rs.Positioner(7.4 * MM, 15 * MM, 2 * MM, **CAPSULE)
    return rs.FocalPlane.hexagonal(unit, rings=3, pitch=22.4 * MM, fiber_type=["B+A"] * 20 + ["A+B"] * 17)


def with_troubles(plane):
    """Return a focal plane with stuck, disabled and different positioners, and with obstacles."""
    n = len(plane)
    stuck = np.full((n, 2), np.nan)
    stuck[[7, 18]] = [30, 40], [-100, 90]
    return replace(
        plane,
        stuck=stuck * u.deg,
        disabled=np.arange(n) % 11 == 5,
        eccentric_arm=(plane.arrays.eccentric_arm - np.where(np.arange(n) % 2, 0.5, 0)) * MM,
        obstacles=[[11.2, 6.5, 2], [-40, 1, 3], [30, -20, 1]] * MM,
    )


def both_hands():
    unit = rs.Positioner(8 * MM, 8 * MM, 2 * MM, handedness="both", theta_range=[-120, 150] * u.deg)
    return rs.FocalPlane.hexagonal(unit, rings=3, pitch=25 * MM)


SCENES = {
    "equal arms": (lamost_like(), {}),
    "parked arms ignored": (lamost_like(), {"parked_obstacles": False}),
    "home elsewhere": (lamost_like(**SEPARATE_HOME), {}),
    "unequal arms": (sdss_like(), {}),
    "long central arms": (sdss_like(l2=6.0), {}),
    "left": (sdss_like(), {"handedness": "left"}),
    "left positioners": (lamost_like(handedness="left"), {}),
    "capsules": (two_fibers(), {"fiber_type": np.array(["A"] * 10 + ["B"] * 20 + [""] * 7)}),
    "first fibers": (two_fibers(), {}),
    "troubles": (with_troubles(sdss_like()), {}),
    "troubles of equal arms": (with_troubles(lamost_like()), {}),
    "fiber tips": (sdss_like(arm_model="fiber_tip"), {}),
    "both hands": (both_hands(), {}),
}


def random_tips(plane, rng, part=1.0):
    """Return tips in mm, uniform in each patrol area and within joint limits.

    Some are exactly at the center, and some are NaN.
    """
    inner, outer, n = plane.arrays.inner_radius, plane.arrays.outer_radius, len(plane)
    r = np.maximum(np.sqrt(rng.uniform(inner**2, outer**2)) * (1 - 1e-12), inner)
    r[(inner == 0) & (rng.random(n) < 0.05)] = 0
    alpha = rng.uniform(0, 2 * np.pi, n)
    tips = plane.arrays.xy + r[:, None] * np.column_stack([np.cos(alpha), np.sin(alpha)])
    tips[rng.random(n) > part] = np.nan
    if not plane.positioner.numbers.joints_free:
        reach = np.diag(plane.reachable(np.nan_to_num(tips, nan=1e6) * MM).toarray())
        tips[~reach] = np.nan
    return tips * MM


def many_tips(plane, rng, m, part=0.8):
    return np.stack([random_tips(plane, rng, part).value for _ in range(m)]) * MM


def random_plane(rng):
    """Return two to seven positioners of all kinds that are close to each other."""
    kind = rng.choice(["equal", "unequal", "both", "fibers", "thick"])
    unit = {
        "equal": lambda: rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM),
        "thick": lambda: rs.Positioner(8.25 * MM, 8.25 * MM, 6 * MM),
        "unequal": lambda: rs.Positioner(7.4 * MM, 15 * MM, 2.5 * MM, step=0.1 * u.deg),
        "both": lambda: rs.Positioner(8 * MM, 8 * MM, 3 * MM, handedness="both", theta_range=[-120, 150] * u.deg),
        "fibers": lambda: rs.Positioner(7.4 * MM, 15 * MM, 2 * MM, **CAPSULE),
    }[kind]()
    pitch = 17.0 if kind in ("equal", "thick", "both") else 20.0
    plane = rs.FocalPlane.hexagonal(unit, rings=1, pitch=pitch * MM)
    rows = np.sort(rng.choice(7, rng.integers(2, 8), replace=False))
    n = len(rows)
    columns = {"spectrograph": rng.integers(0, 2, n)}
    if kind == "fibers":
        columns["fiber_type"] = rng.choice(["B+A", "B"], n)
        columns["fiber_type"][0] = "B+A"
        if rng.random() < 0.5:
            columns["spectrograph"] = np.tile(np.arange(len(set("+".join(columns["fiber_type"]).split("+")))), (n, 1))
    if rng.random() < 0.3:
        columns["disabled"] = np.arange(n) == rng.integers(n)
    if rng.random() < 0.3:
        stuck = np.full((n, 2), np.nan)
        stuck[rng.integers(n)] = rng.uniform(-180, 180), rng.uniform(20, 180)
        columns["stuck"] = stuck * u.deg
    if rng.random() < 0.3:
        columns["obstacles"] = [[*rng.uniform(-15, 15, 2), 2.0]] * MM
    return rs.FocalPlane(plane.xy[rows], unit, **columns)


def few(n=20, **columns):
    angle, radius = np.linspace(0, 340, n), np.linspace(0.02, 0.4, n)
    return rs.Catalog(CENTER.directional_offset_by(angle * u.deg, radius * u.deg), **columns)


def touching_arms(plane, rng):
    """Return the focal plane with one or two pairs of stuck positioners whose arms point at each other."""
    stuck = np.full((len(plane), 2), np.nan)
    pairs = plane.neighbor_pairs()
    for i, j in pairs[rng.choice(len(pairs), int(rng.integers(1, 3)), replace=False)]:
        dx, dy = plane.arrays.xy[j] - plane.arrays.xy[i]
        angle = np.degrees(np.arctan2(dy, dx))
        if np.isnan(stuck[[i, j]]).all():
            stuck[i], stuck[j] = [angle, 0], [angle + 180, 0]
    return replace(plane, stuck=stuck * u.deg)


KINDS = ("science", "science", "science", "standard", "sky")
SEVERAL = (
    "science",
    "science",
    "science+standard",
    "science+standard",
    "standard",
    "sky",
    "science+sky",
    "standard+sky",
)


def random_scene(seed, kinds=KINDS):
    """Return a focal plane with idle arms that touch, positions of targets, and their columns and requirements."""
    rng = np.random.default_rng(seed)
    unit = rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM)
    if seed % 3:
        plane = touching_arms(rs.FocalPlane.hexagonal(unit, rings=2, pitch=25.6 * MM), rng)
    else:  # parked arms touch each other, so that a plan can avoid their collisions
        places = np.column_stack([12.2 * np.arange(6), rng.normal(0, 0.5, 6)])
        plane = rs.FocalPlane(places * MM, unit)
    m = int(rng.integers(1, 40))
    xy = plane.arrays.xy[rng.integers(len(plane), size=m)] + rng.uniform(-16, 16, (m, 2))
    names = rng.choice(["sky", "standard", "good", "poor"], rng.integers(0, 3), replace=False)
    requirements = []
    for what in names:
        low = int(rng.integers(0, 6))
        most = None if rng.random() < 0.6 else low + int(rng.integers(0, 3))
        requirements.append(rs.Requirement(str(what), low, most))
    options = {
        "priority": rng.integers(0, rng.integers(1, 4), m).astype(float),
        "kind": rng.choice(kinds, m),
        "category": rng.choice(["good", "poor", "odd"], m),
        "requirements": requirements,
        "required": np.flatnonzero(rng.random(m) < 0.15) if rng.random() < 0.4 else np.empty(0, dtype=int),
    }
    return plane, xy, options, rng
