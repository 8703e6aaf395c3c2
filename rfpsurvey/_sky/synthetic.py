"""Synthetic catalogs of random points in a circle on the sky."""

from inspect import signature
from numbers import Number

import astropy.units as u
import numpy as np
import scipy  # its subpackages are imported on first use
from astropy.coordinates import SkyCoord

from rfpsurvey._common.units import to_center, to_generator, to_lonlat, to_scalar, to_unit, to_vectors
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.catalog_files import EXAMPLES, PREFIX
from rfpsurvey.errors import INCONVERTIBLE, InputError, check_choice, check_keywords, is_real, refusal, warn_no_effect

CLUSTER_SIZE = 10.0
MOST = 1e9  # largest number of targets, because larger catalogs would not fit into memory


@check_keywords
def synthetic_catalog(
    kind: str,
    center: SkyCoord | str,
    radius: u.Quantity,
    *,
    n_targets: int | None = None,
    density: u.Quantity | None = None,
    min_separation: u.Quantity | None = None,
    cluster_size: float = CLUSTER_SIZE,
    cluster_scale: u.Quantity | None = None,
    rng: int | np.random.Generator | None = None,
) -> Catalog:
    """Make a catalog of random targets in a circle on the sky.

    Parameters
    ----------
    kind : {"uniform", "poisson", "poisson_disc", "clustered"}
        ``uniform``: a fixed number of independent points. ``poisson``: a Poisson point process, in which the number of
        points is also random. ``poisson_disc``: random sequential addition of points that are at least
        ``min_separation`` apart. If neither ``n_targets`` nor ``density`` is given, points are added until fewer than
        one in a thousand random points is accepted. ``clustered``: a Thomas process, in which the number of clusters
        and the number of targets in each cluster are Poisson distributed, and each cluster has a Gaussian profile.
    center : SkyCoord or str
        Center of the circle; text is read as in `plan_tile`.
    radius : Quantity
        Angular radius of the circle, at most 180 deg.
    n_targets : int, optional
        Number of targets; for ``poisson`` and ``clustered``, the expected number of targets.
    density : Quantity, optional
        Number of targets per solid angle, as an alternative to ``n_targets``.
    min_separation : Quantity, optional
        Smallest angular distance between two targets (``poisson_disc``).
    cluster_size : float, optional
        Expected number of targets in a cluster (``clustered``).
    cluster_scale : Quantity, optional
        Standard deviation, as an angle, of the Gaussian profile of each cluster along each axis (``clustered``).
    rng : int, Generator or None, optional
        Seed or random number generator. With None, each call makes a different catalog.

    Returns
    -------
    Catalog
        The targets, numbered from 0.

    Raises
    ------
    InputError
        If a parameter is missing or out of range, or if the targets do not fit into the circle.

    References
    ----------
    Thomas, M. 1949, Biometrika, 36, 18 (clusters).

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> pole = SkyCoord(0 * u.deg, 90 * u.deg)
    >>> len(rs.synthetic_catalog("uniform", pole, 2 * u.deg, n_targets=500, rng=1))
    500
    """
    check_choice(kind, _MAKERS, "kind of synthetic catalog")
    cap = to_scalar(radius, u.deg, "radius", low=0, high=180.000001)
    cap = np.deg2rad(min(cap, 180.0))
    center = to_center(center)
    expected = _expected_number(kind, cap, n_targets, density)
    rng = to_generator(rng)
    options = {"min_separation": min_separation, "cluster_size": cluster_size, "cluster_scale": cluster_scale}
    used, usual = signature(_MAKERS[kind]).parameters, {"cluster_size": CLUSTER_SIZE}
    for name, value in options.items():
        if name not in used and value != usual.get(name):
            warn_no_effect(name, f"with the kind {kind!r}")
    local = _MAKERS[kind](rng, cap, expected, **options)
    xyz = local @ _basis(center)
    lon, lat = to_lonlat(xyz)
    meta = {"synthetic": kind, "radius_deg": float(np.rad2deg(cap))}
    return Catalog(SkyCoord(lon * u.rad, lat * u.rad, frame="icrs"), meta=meta)


def _expected_number(kind, cap, n_targets, density):
    """Return the expected number of targets, or None if the circle is filled with as many targets as possible."""
    if n_targets is not None and density is not None:
        raise InputError("give either n_targets or density, but not both")
    if density is not None:
        number = to_unit(density, u.sr**-1, "density") * _area(cap)
    elif n_targets is not None:
        number = n_targets
    elif kind == "poisson_disc":
        return None
    else:
        raise InputError(f"n_targets or density must be given for a {kind} catalog")
    try:
        number = float(number)
    except INCONVERTIBLE:
        raise refusal("the number of targets must be a single number", number, str) from None
    if not 0 <= number <= MOST:
        raise InputError(f"the number of targets must be from 0 to {MOST:.0e}, got {number:g}")
    return number


def _area(cap):
    """Return the solid angle (sr) of a circle on the sky with the angular radius ``cap`` (rad)."""
    return 4 * np.pi * np.sin(cap / 2) ** 2


def _points(rng, cap, n):
    """Return n independent random points, uniformly distributed in a circle of radius ``cap`` (rad) around +z."""
    # for points that are uniform in a circle, sin^2(distance from the center / 2) is uniform
    half = np.sin(cap / 2) * np.sqrt(rng.random(n))
    azimuth = 2 * np.pi * rng.random(n)
    sine = 2 * half * np.sqrt(1 - half**2)
    return np.column_stack([sine * np.cos(azimuth), sine * np.sin(azimuth), 1 - 2 * half**2])


def _uniform(rng, cap, expected, **_):
    return _points(rng, cap, round(expected))


def _poisson(rng, cap, expected, **_):
    return _points(rng, cap, rng.poisson(expected))


def _poisson_disc(rng, cap, expected, *, min_separation, **_):
    if min_separation is None:
        raise InputError("min_separation must be given for a poisson_disc catalog")
    separation = to_scalar(min_separation, u.rad, "min_separation", low=0, high=np.pi)
    chord = 2 * np.sin(separation / 2)
    wanted = np.inf if expected is None else round(expected)
    points = np.empty((0, 3))
    # The number of trials per round is about the area of the circle divided by the area of a disc whose diameter is the
    # minimum separation. With random sequential addition, such discs cover at most about 0.547 of the circle.
    batch = int(min(max(_area(cap) / (np.pi * (separation / 2) ** 2), 4096), 200_000))
    enough = batch / 1000 if expected is None else 0
    idle = 0
    while len(points) < wanted and idle < 20:
        darts = _points(rng, cap, batch)
        if len(points):
            darts = darts[scipy.spatial.cKDTree(points).query(darts)[0] >= chord]
        darts = _thin(darts, chord)
        points = np.vstack([points, darts])
        idle = idle + 1 if len(darts) == 0 else 0
        if len(darts) < enough:
            break
    if expected is None:
        return points
    if len(points) < wanted:
        raise InputError(
            f"{wanted} targets at least {min_separation} apart do not fit into the circle; "
            f"about {len(points)} targets fit"
        )
    return points[: int(wanted)]


def _thin(points, chord):
    """Remove each point that is closer than ``chord`` to an earlier point that was not removed."""
    alive = np.ones(len(points), dtype=bool)
    if len(points):
        pairs = scipy.spatial.cKDTree(points).query_pairs(chord, output_type="ndarray")
        pairs = pairs[np.sum((points[pairs[:, 0]] - points[pairs[:, 1]]) ** 2, axis=1) < chord**2]
        for i, j in pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]:
            alive[j] &= not alive[i]
    return points[alive]


def _clustered(rng, cap, expected, *, cluster_size, cluster_scale, **_):
    if cluster_scale is None:
        raise InputError("cluster_scale must be given for a clustered catalog")
    sigma = np.deg2rad(to_scalar(cluster_scale, u.deg, "cluster_scale", low=0, high=28))
    if not is_real(cluster_size) or not 1e-3 <= cluster_size <= MOST:
        raise refusal(f"cluster_size must be from 0.001 to {MOST:.0e}", cluster_size, Number)
    # Clusters with centers outside the circle also have members inside the circle. A margin of 6 sigma omits a fraction
    # of 1e-8 of these members.
    wide = min(cap + 6 * sigma, np.pi)
    parents = _points(rng, wide, rng.poisson(expected / cluster_size * _area(wide) / _area(cap)))
    parents = np.repeat(parents, rng.poisson(cluster_size, len(parents)), axis=0)
    distance = sigma * np.sqrt(-2 * np.log1p(-rng.random(len(parents))))
    azimuth = 2 * np.pi * rng.random(len(parents))
    # The azimuth is uniform and can therefore be measured from any direction perpendicular to the cluster center.
    helper = np.where(np.abs(parents[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]])
    across = np.cross(parents, helper)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    perpendicular = np.cross(parents, across)
    direction = np.cos(azimuth)[:, None] * across + np.sin(azimuth)[:, None] * perpendicular
    points = np.cos(distance)[:, None] * parents + np.sin(distance)[:, None] * direction
    inside = np.sum((points - [0, 0, 1]) ** 2, axis=1) <= (2 * np.sin(cap / 2)) ** 2
    return points[inside]


def _basis(center):
    """Return three ICRS unit vectors as rows: two perpendicular to the direction of the center, and this direction."""
    z = to_vectors(center)[0]
    helper = np.eye(3)[np.argmin(np.abs(z))]
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z])


_MAKERS = {"uniform": _uniform, "poisson": _poisson, "poisson_disc": _poisson_disc, "clustered": _clustered}


@check_keywords
def example_catalog(name: str = "anticenter") -> Catalog:
    """Return one of the catalogs of real stars that come with the package.

    ``Catalog.read("example:anticenter")`` reads the same stars and has further parameters. On the command line,
    ``example:anticenter`` can be given instead of the name of a file.

    Parameters
    ----------
    name : {"anticenter"}, optional
        ``anticenter``: the 8830 stars of the Tycho-2 main catalog within 5 deg of ICRS (95, +23) deg. This
        field lies near the Galactic anticenter and contains the cluster M35.

    Returns
    -------
    Catalog
        The stars, with positions and proper motions at the epoch J2000 and with the magnitudes ``bt_mag`` and
        ``vt_mag`` in ``extra``; ``meta`` contains the source, selection, license and limitations of the data.

    Raises
    ------
    InputError
        If there is no example catalog with this name.

    References
    ----------
    Hog, E. et al. 2000, A&A, 355, L27 (Tycho-2).

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> stars = rs.example_catalog("anticenter")
    >>> stars
    <Catalog of 8830 targets with epoch, bt_mag, vt_mag>
    """
    check_choice(name, EXAMPLES, "example catalog")
    return Catalog.read(f"{PREFIX}{name}", keep=["bt_mag", "vt_mag"])
