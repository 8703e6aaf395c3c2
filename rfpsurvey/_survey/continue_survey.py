"""The function `continue_survey`, which plans the rest of a survey from its folder alone."""

import os
import warnings
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path

from astropy.time import Time

from rfpsurvey._common.files import to_path
from rfpsurvey._instruments.instrument import Instrument
from rfpsurvey._instruments.states import instruments_at
from rfpsurvey._survey import key_objects
from rfpsurvey._survey.cadences import Cadences
from rfpsurvey._survey.plan import plan_survey, prepare_request
from rfpsurvey._survey.plan_file import call_of, keys_in
from rfpsurvey._survey.request import Request
from rfpsurvey._survey.survey import Survey
from rfpsurvey._survey.tiling.tiling import Tiling
from rfpsurvey.errors import InputError, RfpsurveyWarning, listed


def continue_survey(
    folder: str | os.PathLike, *, executor: Executor | None = None, progress: bool | Callable = False, **changes: object
) -> Survey:
    """Plan the rest of the survey in a folder, which was interrupted, or whose observations were recorded.

    The targets, the instrument, the tiles and all options are those in the plan file of the folder, ``plan.toml``.

    Parameters
    ----------
    folder : str or path-like
        The folder of the survey.
    executor, progress : optional
        As in `~rfpsurvey.plan_survey`.
    **changes : object
        Parameters of `~rfpsurvey.plan_survey` with other values than in the first plan: an ``instrument`` in which
        other positioners are broken, or more ``tiles``. The parameter ``rule`` is a `~rfpsurvey.survey.VisitRule`.
        Also, parameters that the plan file cannot contain, such as a function as ``allocator``.

    Returns
    -------
    Survey
        The survey.

    Raises
    ------
    InputError
        As `~rfpsurvey.plan_survey`, and if a parameter that the plan file cannot contain is not given.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> from tempfile import TemporaryDirectory
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.3 * u.deg, n_targets=4000, rng=1)
    >>> with TemporaryDirectory() as folder:
    ...     survey = rs.plan_survey(sky, "desi", SkyCoord(["6h20m"], ["+23d"]), folder=f"{folder}/survey")
    ...     said = survey.record([{"tile": 0, "state": "bad"}])
    ...     survey = rs.survey.continue_survey(f"{folder}/survey")
    >>> len(survey)
    1
    """
    if folder is None:
        raise InputError("the rest of a survey can be planned only in its folder, got a survey without a folder")
    folder = to_path(folder)
    call = call_in(folder, **changes)
    return plan_survey(**call, folder=folder, resume=True, executor=executor, progress=progress)


def call_in(folder: Path, **given: object) -> dict:
    """Return the parameters of `plan_survey` for the rest of the survey in a folder; ``given`` replaces some."""
    keys = keys_in(folder, given)
    return call_of(replace(keys, output=replace(keys.output, replan=True)), **given)


def request_in(folder: Path, **given: object) -> Request:
    """Return the request of the rest of the survey in a folder, without the warnings of its plan."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RfpsurveyWarning)
        return prepare_request(**call_in(folder, **given), executor=None)


def cadences_in(folder: Path) -> Cadences:
    """Return the cadences of the targets of a survey."""
    return Cadences(keys_in(folder, {"allocator", "instrument", "tiles", "visits", "rule"}).cadences)


def tiling_in(folder: Path) -> Tiling | None:
    """Return the tiles of the survey in a folder; None if they have no table."""
    return key_objects.tiling_of(keys_in(folder, {"allocator", "instrument", "visits", "rule"}))


def instruments_in(folder: Path, times: Time) -> list[Instrument]:
    """Return the instrument of the survey in a folder, with the states of its positioners at each of several times."""
    keys = keys_in(folder, {"allocator", "tiles", "visits", "rule"})
    return instruments_at(key_objects.model_of(keys.instrument, lambda: times), times)


def groups_in(folder: Path, column: str) -> dict[str, str]:
    """Return the group of each positioner in a column of the instrument, such as its petal, as text."""
    keys = keys_in(folder, {"allocator", "tiles", "visits", "rule"})
    plane = key_objects.model_of(keys.instrument, key_objects.any_time).focal_plane
    groups = {name.lower(): numbers for name, numbers in (plane.groups or {}).items()}
    if column.lower() not in groups and (column.lower() != "spectrograph" or len(groups) != 1):
        text = f"a column of spectrographs must be a group of the positioners of the instrument ({listed(groups)})"
        raise InputError(f"{text}, got the column {column!r}")
    numbers = groups.get(column.lower(), next(iter(groups.values())))
    return dict(zip(plane.id.astype(str).tolist(), numbers.astype(str).tolist(), strict=True))
