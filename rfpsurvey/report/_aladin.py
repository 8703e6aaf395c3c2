"""The page that shows the fields of tiles on images of the sky, with Aladin Lite."""

import os

import numpy as np
from astropy.coordinates import SkyCoord

from rfpsurvey._common.io import writing_to
from rfpsurvey._survey.footprints import COLORS, fields_of
from rfpsurvey._survey.history.state import SurveyState
from rfpsurvey._survey.survey import Survey
from rfpsurvey.report._blocks import json_of
from rfpsurvey.report._html import asset
from rfpsurvey.report._write import ENDINGS, check_report


def write_aladin(survey: Survey | SurveyState, path: str | os.PathLike, *, overwrite: bool = False) -> None:
    """Write an HTML page that shows the fields of tiles on images of the sky, with Aladin Lite.

    Unlike reports, the page requires a network: it loads Aladin Lite and images from the servers of CDS.

    Parameters
    ----------
    survey : Survey or SurveyState
        The survey, as for `rfpsurvey.survey.to_regions`.
    path : str or path-like
        Path that ends in ``.html`` or ``.htm``.
    overwrite : bool, optional
        Whether to replace an existing file.

    Raises
    ------
    InputError
        If the path does not end in ``.html`` or ``.htm``, if the file exists and ``overwrite`` is False, or if
        ``survey`` is another object.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from astropy.coordinates import SkyCoord
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.3 * u.deg, n_targets=200, rng=1)
    >>> survey = rs.plan_survey(sky, "moons", SkyCoord(["6h20m"], ["+23d"]))
    >>> with TemporaryDirectory() as folder:
    ...     rs.report.write_aladin(survey, Path(folder) / "sky.html")
    ...     "requires a network" in (Path(folder) / "sky.html").read_text()
    True
    """
    path = check_report(path, overwrite=overwrite)
    centers, radius, _, words = fields_of(survey)
    middle = SkyCoord(*centers.cartesian.xyz.value.mean(axis=1), representation_type="cartesian").spherical
    size = min(2 * (centers.separation(SkyCoord(middle.lon, middle.lat)).deg.max() + radius), 180)
    places = np.round(np.transpose([centers.ra.deg, centers.dec.deg]), 6)
    own = [[word, COLORS.get(word, "gray"), places[words == word].tolist()] for word in np.unique(words).tolist()]
    target = f"{middle.lon.deg:.6f} {middle.lat.deg:+.6f}"
    text = json_of({"radius": radius, "target": target, "fov": size, "groups": own})
    with writing_to(path, ENDINGS, overwrite=overwrite) as temporary:
        temporary.write_text(asset("page.aladin.html").replace(">{}<", f">{text}<", 1), encoding="utf-8")
