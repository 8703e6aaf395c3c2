"""Example catalogs of real stars that come with the package."""

from rfpsurvey.catalog._catalog import Catalog
from rfpsurvey.catalog._example_files import EXAMPLES, PREFIX
from rfpsurvey.errors import check_choice, check_keywords


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
