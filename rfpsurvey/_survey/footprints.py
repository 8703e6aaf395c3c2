"""The fields of tiles as regions of DS9 and as coverage maps (MOC), which require optional packages."""

from importlib import import_module
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord

from rfpsurvey._survey.history.events import WORDS, places_of
from rfpsurvey._survey.history.nights import History
from rfpsurvey._survey.history.state import SurveyState
from rfpsurvey._survey.survey import Survey
from rfpsurvey.errors import InputError, check_choice, check_whole, refusal

if TYPE_CHECKING:
    from mocpy import MOC
    from regions import Regions

COLORS = {"observed": "#0072B2", "partly observed": "#009E73", "bad": "#D55E00", "planned": "#56B4E9"}
"""Colors of the states of tiles; tiles with another state are gray."""


def fields_of(survey: Survey | SurveyState) -> tuple[SkyCoord, float, np.ndarray, np.ndarray]:
    """Return the centers, the radius (deg), the names and the states of the fields of all tiles."""
    if isinstance(survey, SurveyState):
        history = History(plan := Survey.read(survey.folder), survey)
        names, places = zip(*history.tiles.values(), strict=True)
        words = [history.states[row][-1][1] for row in history.tiles]
    elif isinstance(plan := survey, Survey):
        names, places = survey.tiles["tile"].astype(str), places_of(survey.tiles)
        words = [WORDS.get(state, state) for state in survey._states]
    else:
        raise refusal("survey must be a Survey or a SurveyState", survey, Survey)
    radius = plan.provenance["parameters"]["radius_deg"]
    return SkyCoord(np.array(places)[:, :2], unit="deg"), radius, np.array(names), np.array(words)


def _package(name: str):
    try:
        return import_module(name)
    except ImportError as error:
        raise InputError(f"the package {name} is required: pip install 'rfpsurvey[regions]' ({error})") from error


def to_regions(survey: Survey | SurveyState) -> "Regions":
    """Return the fields of tiles as circles on the sky, whose colors show the states of the tiles.

    Each circle contains all positioners. This function requires the package regions (``rfpsurvey[regions]``).

    Parameters
    ----------
    survey : Survey or SurveyState
        The survey. `Survey.state <rfpsurvey.Survey.state>` returns the state after all recorded observations; in a
        survey, the states of tiles are those of the last plan.

    Returns
    -------
    regions.Regions
        The circles (ICRS); the text of each is the identifier and the state of the tile. For example,
        ``to_regions(survey).write("tiles.reg", format="ds9")`` writes a file for DS9.

    Raises
    ------
    InputError
        If the package regions is missing, or if ``survey`` is another object.

    Examples
    --------
    >>> from astropy.coordinates import SkyCoord
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.3 * u.deg, n_targets=200, rng=1)
    >>> survey = rs.plan_survey(sky, "moons", SkyCoord(["6h20m"], ["+23d"]))
    >>> rs.survey.to_regions(survey).serialize(format="ds9").splitlines()[-1]  # doctest: +SKIP
    'circle(95.00000000,23.00000000,0.20833333) # text={0 planned} color=#56B4E9'
    """
    regions = _package("regions")
    centers, radius, names, words = fields_of(survey)
    circles = []
    for center, name, word in zip(centers, names.tolist(), words.tolist(), strict=True):
        look = {"meta": {"text": f"{name} {word}".translate(BRACES)}, "visual": {"color": COLORS.get(word, "gray")}}
        circles.append(regions.CircleSkyRegion(center, radius * u.deg, **look))
    return regions.Regions(circles)


BRACES = str.maketrans("{}\n\r", "()  ")
"""Characters that would end the text of a region in a file for DS9, and their replacements."""


def to_moc(survey: Survey | SurveyState, state: str = "planned", *, max_depth: int = 10) -> "MOC":
    """Return the area on the sky that the fields of tiles with a state cover, as a coverage map (MOC).

    This function requires the package mocpy (``rfpsurvey[regions]``).

    Parameters
    ----------
    survey : Survey or SurveyState
        The survey, as for `to_regions`.
    state : str, optional
        State of the tiles: ``planned``, ``observed``, ``partly observed``, ``bad``, ``dropped`` or ``past``.
    max_depth : int, optional
        Largest order of the HEALPix pixels, from 0 to 29. Pixels of the order 10 have a side of 3.4 arcmin.

    Returns
    -------
    mocpy.MOC
        The area; ``to_moc(survey, "observed").save("observed.fits", format="fits")`` writes a file.

    Raises
    ------
    InputError
        If the package mocpy is missing, if no tile has the state, or if ``max_depth`` is not valid.

    Examples
    --------
    >>> from astropy.coordinates import SkyCoord
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.3 * u.deg, n_targets=200, rng=1)
    >>> survey = rs.plan_survey(sky, "moons", SkyCoord(["6h20m"], ["+23d"]))
    >>> rs.survey.to_moc(survey, "planned").sky_fraction < 4e-6  # doctest: +SKIP
    True
    """
    centers, radius, _, words = fields_of(survey)
    centers = centers[words == check_choice(state, np.unique(words).tolist(), "state")]
    options = {"radius": radius * u.deg, "max_depth": check_whole(max_depth, "max_depth", 0, 29)}
    return _package("mocpy").MOC.from_cones(lon=centers.ra, lat=centers.dec, **options, union_strategy="large_cones")
