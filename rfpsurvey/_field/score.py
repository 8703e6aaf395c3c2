"""The function that finds the collisions in assignments that another program planned."""

from dataclasses import replace
from time import perf_counter

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import Table
from astropy.time import Time

from rfpsurvey._assignment.constraints.constraint import Constraint
from rfpsurvey._assignment.constraints.targets import KeepOut
from rfpsurvey._assignment.constraints.text import as_constraints
from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._assignment.plugin import warn_of_parked
from rfpsurvey._common.units import rows_of, to_flags, to_plain, to_radian
from rfpsurvey._field.facts import build_tile
from rfpsurvey._field.plan import find_all_collisions
from rfpsurvey._field.plan_files import format_of, is_plan, plan_roles
from rfpsurvey._field.plan_values import recorded_instrument, survey_entry
from rfpsurvey._field.recorded import find_recorded, on_focal_plane, project_rows, read_positions, sentence_of
from rfpsurvey._field.table import TableOfTile, status_of
from rfpsurvey._field.tile import Tile
from rfpsurvey._field.verdicts import find_constraints
from rfpsurvey._instruments.arms import place_arms
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.instrument import Instrument, as_instrument
from rfpsurvey._instruments.reach import accepted_types
from rfpsurvey._sky.columns import UNITS, Finder
from rfpsurvey._sky.conditions import ObservingConditions, check_conditions
from rfpsurvey._sky.frames import as_table
from rfpsurvey.errors import InputError, check_choice, check_keywords, check_switch, listed, warn

MOST_OUT_OF_REACH = 0.2
"""Fraction of targets out of reach from which on a warning states that plan and instrument do not match."""


@check_keywords
def score_tile(
    table: Table | Tile,
    instrument: Instrument | str | None = None,
    *,
    center: SkyCoord | str | None = None,
    position_angle: u.Quantity | None = None,
    equinox: str | None = None,
    epoch: Time | str | float | None = None,
    positions: str | None = None,
    conditions: ObservingConditions | None = None,
    columns: dict | None = None,
    units: dict | None = None,
    parked_obstacles: bool | None = None,
    missing: str = "refuse",
    constraints: list | Constraint | str | None = None,
) -> Tile:
    """Find the collisions in assignments that another program planned.

    If a target is out of reach, the arm of its positioner is stretched toward the target as far as possible, and is
    counted in the collision rate. Arms without a target are in the pose that a plan records: at its joint angles
    ``theta`` and ``phi`` or, if it has none, at its fiber positions. Poses that are not recorded are assumed.

    Parameters
    ----------
    table : Table, QTable, DataFrame or Tile
        A tile, or a table with a row for each assigned fiber. The columns contain the identifier of the positioner
        (``positioner``, ``hole_id``, ``robot_id``, ...), and the position of its target on the focal plane (``x`` and
        ``y``, ``x_wok``, ``tip_x``, ...) or on the sky. Rows without a positioner, and rows with 0 in the column
        ``assigned``, are ignored. The column names of plans that `~rfpsurvey.plans.read_plan` returned are recognized.
    instrument : Instrument or str, optional
        Instrument, name of a preset, or path of a TOML file. By default, the preset with which a `Tile` was made, or
        the instrument in the file beside a plan that `Survey.export` wrote; any other instrument must be given.
    center : SkyCoord or str, optional
        Field center, as in `plan_tile`; by default it is read from the columns or meta entries ``racen`` and
        ``deccen`` of the table.
    position_angle : Quantity, optional
        Position angle of the +y axis of the focal plane, measured from north in the frame of the center; by default it
        is read from the column or meta entry ``position_angle`` or ``field_pa`` of the table.
    equinox : str, optional
        Equinox that defines north for position angles, such as ``"J2026.0"``; by default, north is that of ICRS, or of
        the frame that a plan records with its position angle.
        ``equinox`` is not allowed together with ``center``, because the frame of ``center`` defines north.
    epoch : Time, str or float, optional
        Epoch to which sky positions are moved by their proper motions. By default, they are moved to the epoch of the
        observation if the plan is a file of SDSS-V that records it, and are not moved otherwise, because the positions
        of many plans already refer to the observation; the entry ``epoch`` of the summary states this.
    positions : {"focal_plane", "sky"}, optional
        Whether to use the target positions on the focal plane or on the sky. By default, the positions on the focal
        plane are used if the table contains them, except for a tile with ``constraints`` and for plans that
        `Survey.export` wrote, whose positions on the sky have more digits.
    conditions : ObservingConditions, optional
        Observing conditions, from which the refraction of positions on the sky is computed. By default, the conditions
        and the model of the projection that a tile or a plan of this package records are used; without recorded
        conditions, refraction is neglected.
    columns, units : dict, optional
        Names and units of columns, as in `Catalog.from_table`; ``columns`` can also contain the keys ``positioner``,
        ``x`` and ``y``. The columns of a DataFrame are in mm and deg unless ``units`` specifies other units.
    parked_obstacles : bool, optional
        Whether positioners without a target are obstacles for other arms: in their recorded pose or, if it is unknown
        and both arms have equal lengths, in the parked pose. The default is True, or the value with which the survey of
        an exported plan was planned.
    missing : {"refuse", "skip"}, optional
        What to do if assigned rows have no position. By default, an error names these rows. With ``"skip"``, the other
        rows are scored, their positioners have no target, and a warning names the skipped rows.
    constraints : list of Constraint or str, optional
        Constraints that are checked, as in `AllocationOptions`. Their obstacles count in the collisions. The keep-out
        circles that an exported plan records are always checked.

    Returns
    -------
    Tile
        The tile, which has no table of outcomes. Its summary also contains ``n_out_of_reach``, ``n_wrong_fiber``
        (number of positioners without the fiber type that their target requires), ``n_unusable`` (number of rows for
        disabled or stuck positioners, which are not scored), ``n_skipped`` (number of assigned rows without a position;
        only with ``missing="skip"``), ``n_recorded`` (number of usable positioners without a
        target in a recorded pose) and ``poses_without_target`` (a sentence on recorded and assumed poses). If there are
        ``constraints``, it also contains ``n_constraints`` and ``n_unmet`` (the numbers of constraints that were
        checked, and that are not met), ``requirements`` (for the text of each requirement, a list with the number of
        targets that have a fiber, in the tile or in each spectrograph), ``n_also_science`` (number of science targets
        that also meet requirements on standard stars or sky positions, if there are any), ``unmet`` (sentences on the
        constraints that are not met) and ``rules`` (the verdict on each constraint, see `Tile.rules`).

    Raises
    ------
    InputError
        If a positioner is unknown or occurs twice, if the instrument or the field center is missing, or if positions
        are missing and ``missing`` is ``"refuse"``.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.table import QTable
    >>> import rfpsurvey as rs
    >>> lamost = rs.Instrument.preset("lamost")
    >>> x, y = lamost.focal_plane.xy[:2].T
    >>> plan = QTable({"positioner": [0, 1], "x": x + 5 * u.mm, "y": y})
    >>> rs.score_tile(plan, lamost).summary["n_assigned"]
    2
    """
    start = perf_counter()
    check_conditions(conditions, optional=True)
    check_choice(missing, ("refuse", "skip"), "treatment of rows without a position")
    instrument = preset_of(table) if instrument is None else as_instrument(instrument)
    knows_field = isinstance(table, Tile)
    table, is_plain = as_table(table.table if knows_field else table, index_as_id=False)
    survey = survey_entry(table)
    if parked_obstacles is None:
        parked_obstacles = survey.get("parked_obstacles") != "False"
    parked_obstacles = check_switch(parked_obstacles, "parked_obstacles")
    if isinstance(circles := survey.get("keep_out"), dict):
        constraints = [*as_constraints(constraints), KeepOut.parse(" ".join(map(str, circles.values())))]
    columns, units = ({} if option is None else option for option in (columns, units))
    if is_plain and isinstance(units, dict):
        units = {**{role: str(unit) for role, unit in UNITS.items()}, **units}
    if center is not None and equinox is not None:
        raise InputError(
            "equinox must be left out if center is given, because the frame of center defines north: give "
            f'center.transform_to(FK5(equinox="{equinox}"))'
        )
    roles = plan_roles(table)
    columns = {**roles, **columns} if isinstance(columns, dict) else columns
    plane = instrument.focal_plane
    full = Finder(table, columns, units)
    owner, rows, name = _positioners(full, instrument)
    who = owner[rows]
    if len(rows) == 0:
        raise InputError("the table must assign at least one positioner, got none")
    part = table[rows]
    find = Finder(part, columns, units)
    xy_names = [find.name_of(role) for role in ("x", "y")]
    if positions is None:
        is_of_sky = None in xy_names or bool(survey) or (knows_field and constraints is not None)
        positions = "sky" if is_of_sky else "focal_plane"
    check_choice(positions, ("focal_plane", "sky"), "kind of positions")
    fibers, others = _fibers(find, plane, who), _without(find, name)
    ids = np.arange(len(part)) if (ids := others.labels("id")) is None else ids
    parameters = {"allocator": "scored", "positions": positions, "parked_obstacles": parked_obstacles}
    given = {"center": center, "position_angle": position_angle, "equinox": equinox, "epoch": epoch}
    given |= {"conditions": conditions}
    for text in format_of(part).neglected(part, positions == "sky"):
        warn(text)
    if positions == "sky":
        xy, sky_deg, plain, moved, more = project_rows(find, instrument, fibers, columns, units, **given)
    else:
        xy, sky_deg, plain, moved, more = read_positions(find, xy_names, who, len(plane), given)
    parameters |= more
    n, n_rows = len(plane), len(rows)
    has_places = positions == "focal_plane" or is_plan(table) or _is_ours(table)
    recorded_xy = on_focal_plane(find, xy_names if has_places else [None], n, who)
    keep = _placed(np.isfinite(xy).all(axis=1), rows, part[name], len(table), skip=missing == "skip")
    part, rows, who, ids, fibers, xy = part[keep], rows[keep], who[keep], ids[keep], fibers[keep], xy[keep]
    sky_deg = sky_deg[:, keep]
    if constraints is not None:
        checked = find_constraints(constraints, instrument, plain, others, keep, ids, sky_deg, xy, fibers)
        instrument, plane = checked.applied.instrument, checked.applied.instrument.focal_plane
        parameters["constraints"] = [str(constraint) for constraint in checked.options.all_constraints]
    tips, target_of, types = _by_positioner(plane, who, xy, fibers)
    wrong = sum(t not in row.split("+") for t, row in zip(fibers, plane.fiber_type[who], strict=True))
    has_target = np.isin(np.arange(len(table)), rows)
    angles, elbows, by_angles = find_recorded(full, owner, has_target, instrument, recorded_xy, types, tips)
    if not (parked_obstacles or np.isfinite(angles).any()):
        warn_of_parked(plane)
    stuck = np.empty(0, dtype=int)
    if (_is_ours(table) or is_plan(table)) and "kind" in table.colnames:  # fibers of stuck positioners can observe sky
        stuck = np.setdiff1d(owner[(to_plain(table["kind"]) == "sky") & (owner >= 0)], who)
        stuck = stuck[(plane.arrays.is_stuck & ~plane.disabled)[stuck]]
    options = {"parked_obstacles": parked_obstacles, "clip": True, "idle_angles": angles}
    posed = place_arms(plane, tips * u.mm, handedness=elbows, fiber_type=types, **options)
    if _is_ours(part):  # arms that were already stretched when this tile was made remain out of reach
        posed.clipped[who] |= to_plain(part["status"]) == "out_of_reach"
    n_out = int(posed.clipped.sum())
    if n_out >= MOST_OUT_OF_REACH * len(part):
        warn(
            f"{n_out} of {len(part)} targets are out of reach of their positioners: plan and instrument do not match; "
            "check instrument, calibration, field center, position angle and units"
        )
    options = AllocationOptions(parked_obstacles=parked_obstacles) if constraints is None else checked.options
    options = replace(options, parked_obstacles=parked_obstacles)
    report = find_all_collisions(plane, posed, options, instrument.motion)
    summary = {
        "n_targets": len(part),
        "n_rows_ignored": len(table) - n_rows,
        **({"n_skipped": n_rows - len(part)} if missing == "skip" else {}),
        "n_out_of_reach": n_out,
        **({"n_within_margins": _within_margins(plane, who, xy, fibers, posed)} if plane.margins else {}),
        "n_wrong_fiber": int(wrong),
        "n_unusable": int((~plane.arrays.usable[who]).sum()),
        "epoch": moved,
        "n_recorded": int((status_of(plane, posed) == "recorded").sum()),
        "poses_without_target": sentence_of(posed, by_angles, status_of(plane, posed)),
        **({} if constraints is None else checked.summary(report, posed, target_of, who, fibers, stuck)),
        "seconds": {"total": round(perf_counter() - start, 6)},
    }
    meta = {k: v for k, v in table.meta.items() if isinstance(v, str | int | float | bool)}
    used = ("ra", "dec", "pmra", "pmdec", "epoch") if positions == "sky" else ("x", "y")
    meta["columns"] = f"positioner: {name}, {others.statement(('id', 'fiber_type', *used))}"
    tile = TableOfTile(instrument, ids, sky_deg, target_of, types, posed, report)
    return build_tile(tile, summary, parameters, meta)


def preset_of(tile: object) -> Instrument:
    """Return the instrument that a tile or a plan records; raise an error if it is not known."""
    table = tile.table if isinstance(tile, Tile) else tile
    if isinstance(table, Table) and (name := recorded_instrument(table)) is not None:
        return as_instrument(name)
    if not isinstance(tile, Tile):
        raise InputError("instrument must be given, because a table does not contain its instrument, got none")
    raise InputError(
        "instrument must be given, because the tile was not made with an unchanged preset, but with the "
        f"instrument {tile.instrument!r}, got none"
    )


def _fibers(find: Finder, plane: FocalPlane, who: np.ndarray) -> np.ndarray:
    """Return the fiber type of each assigned row; by default, it is the first fiber type of the positioner."""
    asked = find.labels("fiber_type") if plane.fiber_types != ("",) else None
    accepted_types(plane, asked, len(who))
    fibers = plane.arrays.first_type[who]
    return fibers if asked is None else np.where(asked == "", fibers, asked)


def _by_positioner(plane: FocalPlane, who: np.ndarray, xy: np.ndarray, fibers: np.ndarray) -> tuple:
    """Return the tip, the row of the target, and the fiber type of each positioner."""
    n = len(plane)
    tips, target_of = np.full((n, 2), np.nan), np.full(n, -1)
    tips[who], target_of[who] = xy, np.arange(len(who))
    types = plane.arrays.first_type.astype(f"U{max(len(t) for t in plane.fiber_types) + 1}")
    types[who] = fibers
    return tips, target_of, types


def _within_margins(plane, who, xy, fibers, posed) -> int:
    """Return the number of targets that their positioners reach, but that a plan with margins would not assign."""
    pairs = [limited.arrays.reach(xy, fibers) for limited in (plane, replace(plane, margins=None))]
    key = np.arange(len(who)) * len(plane) + who
    kept, reached = (np.isin(key, reach.target * len(plane) + reach.owner) for reach in pairs)
    return int((reached & ~kept & ~posed.clipped[who]).sum())


def _positioners(find: Finder, instrument: Instrument):
    """Return the assignments of a table.

    The returned tuple contains the index of the positioner of each row (-1: none), the rows that assign a positioner,
    and the name of the column with the identifiers of the positioners.
    """
    plane = instrument.focal_plane
    name = find.name_of("positioner")
    if name is None:
        raise find.missing("positioner")
    values = to_plain(find.table[name])
    if values.ndim != 1:
        raise InputError(f"column {name!r} must have one value per row, got the shape {values.shape}")
    if values.dtype.kind == "f":  # integers become floats in a column with missing values
        values = np.array(["" if np.isnan(v) else f"{v:.15g}" for v in values])
    names = np.char.strip(values.astype(str))
    if plane.id.dtype.kind == "i":  # columns of CSV files can have leading zeros
        names = np.array([str(int(v)) if v.isdecimal() else v for v in names.tolist()], dtype=str)
    index = {str(i): k for k, i in enumerate(plane.id)}
    # a row assigns no positioner if the identifier is blank, or is -1 and no positioner has the identifier -1
    rows = np.flatnonzero(_assigned(find.table) & (names != "") & ((names != "-1") | ("-1" in index)))
    owner = np.array([index.get(v, -1) for v in names.tolist()], dtype=int)
    unknown = names[rows[owner[rows] < 0]].tolist()
    if unknown:
        nominal = is_plan(find.table) and instrument.layout == "nominal"
        hint = "; use the instrument as built, because its positioners have the ids of this plan" if nominal else ""
        raise InputError(
            f"column {name!r} names positioners that the instrument does not have: "
            f"{', '.join(dict.fromkeys(unknown[:3]))} ({len(unknown)} of {len(rows)} rows); "
            f"examples of its ids are {plane.id[0]} and {plane.id[-1]}{hint}"
        )
    twice, counts = np.unique(owner[rows], return_counts=True)
    if (counts > 1).any():
        raise InputError(
            f"positioner {plane.id[twice[counts > 1][0]]} is assigned more than once; "
            f"if the table holds several fields, score one field at a time, for example with --select COLUMN=VALUE"
        )
    return owner, rows, name


def _is_ours(table) -> bool:
    """Return whether a table describes a tile made by this package."""
    return {"in_collision", "status"} <= set(table.colnames)


def _assigned(table) -> np.ndarray:
    """Return which rows of a table assign a fiber.

    The column ``status`` marks these rows in tiles of this package, and the column ``assigned`` in other tables. If
    another table has no column ``assigned``, all of its rows assign a fiber.
    """
    if _is_ours(table):
        return np.isin(to_plain(table["status"]), ("assigned", "out_of_reach"))
    if "assigned" not in table.colnames:
        return np.ones(len(table), dtype=bool)
    return to_flags(table["assigned"], "column 'assigned'")


def _without(find: Finder, positioner_column: str) -> Finder:
    """Return a finder that ignores the column with the identifiers of positioners."""
    names = [c for c in find.table.colnames if c != positioner_column]
    columns = {role: name for role, name in find.columns.items() if name.removeprefix("-") in names}
    return Finder(find.table[names], columns)


def _placed(has_place: np.ndarray, rows: np.ndarray, positioners, n: int, *, skip: bool) -> np.ndarray:
    """Return the assigned rows that have a position; raise an error if others have none or, with ``skip``, warn.

    ``rows`` are the numbers of the assigned rows in a table of ``n`` rows.
    """
    if not has_place.all():
        where = rows_of(np.isin(np.arange(n), rows[~has_place]))
        names = to_plain(positioners)[~has_place].tolist()
        who = f"(positioner{'s' if len(names) > 1 else ''} {listed(names, 3)})"
        if not has_place.any():
            raise InputError(f"at least one assigned row must have a finite position, but {where} have none {who}")
        if not skip:
            raise InputError(
                f"every assigned row must have a finite position, but {where} have none {who}; correct these rows, or "
                'use missing="skip" (or --missing skip)'
            )
        warn(f"{where} have no finite position and are skipped {who}")
    return np.flatnonzero(has_place)


def paths_of(tile: Tile, instrument: Instrument | str | None, **options: object) -> object:
    """Return the paths to the poses of a tile; see `Tile.paths`."""
    from rfpsurvey._instruments.path_report import paths_to  # most scripts plan no paths

    instrument = preset_of(tile) if instrument is None else as_instrument(instrument)
    plane, table = instrument.focal_plane, tile.table
    if not np.array_equal(np.asarray(table["id"]).astype(str), plane.id.astype(str)):
        raise InputError(f"the tile must belong to the {len(plane)} positioners of {instrument.name}, got other ids")
    status, angles = to_plain(table["status"]), [to_radian(table[name], name) for name in ("theta", "phi")]
    posed = np.isin(status, ("assigned", "out_of_reach"))
    given = (np.where(posed, angle, np.nan) << u.rad for angle in angles)
    types = {"fiber_type": table["fiber_type"]} if "fiber_type" in table.colnames else {}
    idle = np.where(posed, np.nan, angles)
    arms = place_arms(plane, **dict(zip(("theta", "phi"), given, strict=True)), **types, idle_angles=idle)
    return paths_to(plane, arms, instrument.motion, refuse=True, **options)
