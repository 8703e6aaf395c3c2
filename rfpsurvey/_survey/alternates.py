"""Alternates of the fibers of tiles of a survey, with the visits that remain if all tiles are observed as planned."""

from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._assignment.rules import FEWEST_FIRST
from rfpsurvey._common.units import from_lonlat
from rfpsurvey._field.alternates import PlannedField, find_alternates
from rfpsurvey._field.plan import with_subpriorities
from rfpsurvey._instruments.arms import place_arms
from rfpsurvey._sky.arrays import has_role
from rfpsurvey._survey.continue_survey import request_in
from rfpsurvey._survey.folder import read_visits
from rfpsurvey._survey.history.status import count_planned
from rfpsurvey._survey.survey import Survey
from rfpsurvey._survey.work import projection_of, reach_of
from rfpsurvey.errors import InputError


class SurveyAlternates:
    """The alternates of the tiles of a survey, for the catalog and the options in its folder.

    ``given`` contains parameters that the plan file of the folder does not determine.
    """

    def __init__(self, survey: Survey, **given: object):
        self._survey, self._request = survey, request_in(survey.folder, **given)
        self._state = self._request.open_state()

    @cached_property
    def _planned(self) -> np.ndarray:
        """Number of visits of each target in the tiles that will be observed, in the order of the catalog."""
        return count_planned(self._survey, self._request.state, is_planned=False)

    def of_tile(self, row: int, n: int) -> QTable:
        """Return a table of at most n alternates of each fiber of the tile in a row, as `find_alternates` does."""
        survey, request = self._survey, self._request
        name = survey.tiles["tile"][row]
        visits, cards = read_visits(survey.folder, row, survey._known, name)
        job = self._state.open_job(request, row)
        if not np.allclose([cards[axis] for axis in ("RA", "DEC", "POSANG")], request.places[row], rtol=0, atol=1e-9):
            raise InputError(f"tile {name} must have its planned position for alternates, got a tile that was moved")
        reach, options, columns = reach_of(job), request.options, visits.dtype.names
        plane, has_types = reach.applied.instrument.focal_plane, "fiber_type" in columns
        row_of = {str(positioner): k for k, positioner in enumerate(plane.id.tolist())}
        owner = np.array([row_of[str(positioner)] for positioner in visits["positioner"].tolist()])
        vectors = from_lonlat(np.deg2rad(visits["ra"]), np.deg2rad(visits["dec"]))
        tips, types = np.full((len(plane), 2), np.nan), None
        tips[owner] = projection_of(job).project(vectors, visits["fiber_type"] if has_types else None)
        tips[~plane.arrays.usable] = np.nan
        if has_types:
            types = plane.arrays.first_type.astype(np.promote_types(visits["fiber_type"].dtype, "U1"))
            types[owner] = visits["fiber_type"]
        parked = options.parked_obstacles
        arms = place_arms(plane, tips * u.mm, fiber_type=types, parked_obstacles=parked, clip=True)
        targets = job.field.targets._replace(columns=job.field.targets.columns._replace(kind=reach.applied.kind))
        if options.subpriority == FEWEST_FIRST:  # here, the most remaining visits come first
            targets = targets._replace(columns=targets.columns._replace(subpriority=None))
        else:
            targets = with_subpriorities(targets, options)
        catalog_row, kind = job.field.row, targets.columns.kind
        pairs = reach.allowed.where(~np.isin(catalog_row, visits["target_row"])[reach.allowed.target])
        planned = self._planned[catalog_row].astype(int)
        left = np.maximum(request.builder.left[job.field.slot] - planned, 0)
        if kind is not None:  # standards and sky positions can be observed any number of times
            left = np.where(has_role(kind, "science"), left, 1)
        roles = visits["kind"] if "kind" in columns else np.full(len(visits), "science")
        about = targets, reach.xy, reach.fiber_type, pairs, owner, visits["target_id"], roles, vectors
        table = find_alternates(PlannedField(plane, arms, options.motion_law, parked, *about), n, left, planned)
        table.add_column(np.full(len(table), name), name="tile", index=0)
        return table
