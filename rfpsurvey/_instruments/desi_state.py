"""Read the state, the exclusion polygons and the outlines of a focal plane of desimodel."""

import json
import re
from datetime import UTC, datetime
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.time import Time

from rfpsurvey._common.read_documents import check_size, content_of, entries_of, reading
from rfpsurvey._common.read_tables import read_table
from rfpsurvey._common.units import to_plain
from rfpsurvey._instruments.as_built import MOST_ANGLE, is_missing, number_rows, numbers, some, whole
from rfpsurvey._instruments.outline import ArmOutline, divide_polygon
from rfpsurvey.errors import InputError, number_of, refusing, warn

STATE = ("TIME", "LOCATION", "STATE")
POSE = ("POS_T", "POS_P")
LIMITS = ("MIN_T", "MAX_T", "MIN_P", "MAX_P")
STUCK, BROKEN, RESTRICTED = 2, 4, 8  # bits of the column STATE
NAME = re.compile(r"desi-(focalplane|state|exclusion)_(.+?)\.(?:ecsv|yaml|json)(?:\.gz)?")
MOST_YAML, MOST_JSON = 2**22, 2**26
"""Largest number of bytes of a file; YAML is slow to read, and only small files are in this format."""
MOST_VALUES = 5_000_000
MOST_WIDTH = 10


def moment_of(value: object, what: str) -> datetime:
    """Convert a Time, or text in ISO 8601, to a datetime; text without a time zone is UTC."""
    with refusing(f"{what} must be a Time or text such as '2021-05-14T00:00:00'", value, str, Time):
        if isinstance(value, Time):
            if value.scale == "local":  # cannot be converted to UTC
                raise ValueError
            return value.utc.to_datetime(timezone=UTC)
        moment = datetime.fromisoformat(value)
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)


def find_latest(folder: Path, moment: datetime | None) -> tuple[Path, dict[str, Path]]:
    """Return the file of the latest focal plane that was valid at a time, and the other files with the same date."""
    by_date = {}
    for file in entries_of(folder):
        if match := NAME.fullmatch(file.name):
            date = moment_of(match[2], f"{file}: the date in the name")
            by_date.setdefault(date, {})[match[1]] = file
    dates = sorted(date for date, files in by_date.items() if "focalplane" in files)
    if not dates:
        raise InputError(f"{folder}: the folder must have a file desi-focalplane_DATE.ecsv, got none")
    valid = dates if moment is None else [date for date in dates if date <= moment]
    if not valid:
        raise InputError(
            f"{folder}: time must not be before the first focal plane, {dates[0].isoformat()}, got {moment.isoformat()}"
        )
    files = by_date[valid[-1]]
    return files.pop("focalplane"), files


def find_conditions(path: Path, ids: np.ndarray, moment: datetime | None):
    """Return columns of the focal plane, joint limits (NaN: unknown), names of polygons, and a note for a given time.

    The last value is the number of positioners with impossible values.
    The table is a log of events. The state of a positioner is its state after the last event at or before the time.
    """
    table, times, location, when = _read_log(path)
    past = {text for text, date in when.items() if moment is None or date <= moment}
    rows = np.flatnonzero(np.isin(times, list(past)))
    if len(rows) == 0:
        raise InputError(
            f"{path}: time must not be before the first event, {min(when.values()).isoformat()}, got "
            f"{moment.isoformat()}"
        )
    last = dict(zip(location[rows].tolist(), rows.tolist(), strict=True))  # for repeated keys, the last value is kept
    row = np.array([last.get(name, -1) for name in ids.tolist()])
    known = row >= 0
    if not known.all():
        warn(f"{path}: {some(ids, ~known)} of the focal plane have no state and count as working")
    state, odd, lost, doubtful, pose, values, polygons = _parse(table[row[known]], known, ids, path)
    counts = {
        "stuck": (state & STUCK) != 0,
        "with a broken fiber": (state & BROKEN) != 0,
        "with restricted reach": (state & RESTRICTED) != 0,
        "stuck or broken without a known pose, and thus parked": lost,
    }
    parts = ", ".join(f"{np.count_nonzero(mask)} {what}" for what, mask in counts.items() if mask.any())
    text = (
        f"The state is taken from {path.name}, after the event of {max(when[text] for text in past).isoformat()}: "
        f"{parts or 'all positioners work'}."
    )
    n_unused = len(set(location.tolist()) - set(ids.tolist()))
    if n_unused:
        text += f" The events of {number_of(n_unused, 'other device')} are not used."
    columns = {"disabled": (state & BROKEN).astype(bool) | odd | lost, "stuck": pose * u.deg}
    limits = {name: column for name, column in values.items() if name in LIMITS}
    return columns, limits, polygons, text, np.count_nonzero(doubtful)


def find_events(path: Path, ids: np.ndarray, first: datetime, last: datetime) -> tuple:
    """Return the events after ``first`` and until ``last``, as columns with an element for each event.

    The columns are the row of the positioner, the moments at which its state begins and ends (None: no end), whether it
    is disabled, its pose (NaN: none) in degrees, and a dict of joint limits (NaN: unknown).
    """
    table, times, location, when = _read_log(path)
    row_of, spans, later = {name: k for k, name in enumerate(ids.tolist())}, [], {}
    for event in reversed(range(len(table))):  # events that are later in the log replace those before them
        name, begin = location[event], when[times[event]]
        end = later.get(name)
        if name in row_of and first < begin <= last and (end is None or begin < end):
            spans.append((event, row_of[name], begin, end))
        later[name] = begin if end is None else min(begin, end)
    events, rows, begins, ends = zip(*spans, strict=True) if spans else ([],) * 4
    known = np.ones(len(events), dtype=bool)
    chosen = table[np.array(events, dtype=int)]
    state, odd, lost, _, pose, limits, _ = _parse(chosen, known, ids[np.array(rows, dtype=int)], path)
    return rows, begins, ends, (state & BROKEN).astype(bool) | odd | lost, pose, limits


def _read_log(path: Path) -> tuple:
    """Return the table of a log, the time and location of each event, and a dict of the moment of each time."""
    table = read_table(path)
    number_rows(table, STATE, path)
    times = np.char.strip(to_plain(table["TIME"], f"{path}: column 'TIME'").astype(str))
    when = {text: moment_of(text, f"{path}: column 'TIME'") for text in np.unique(times).tolist()}
    return table, times, whole(table, "LOCATION", path), when


def _parse(events, known: np.ndarray, ids: np.ndarray, path: Path) -> tuple:
    """Return the values of events; ``known`` states which of the positioners ``ids`` have an event."""
    state = np.zeros(len(ids), dtype=np.int64)
    state[known] = whole(events, "STATE", path)
    odd = (state & ~(STUCK | BROKEN | RESTRICTED)) != 0
    if odd.any():
        warn(f"{path}: {some(ids, odd)} have unknown bits in their STATE and are disabled")
    fixed = (state & (STUCK | BROKEN)) != 0
    values = {name: np.full(len(ids), np.nan) for name in (*POSE, *LIMITS) if name in events.colnames}
    doubtful = odd | ~known
    for name, column in values.items():
        most = MOST_ANGLE if name in LIMITS else np.inf
        column[known] = numbers(events, name, u.deg, path, most)
        wrong = is_missing(column, -MOST_ANGLE, MOST_ANGLE, codes=name in POSE)
        doubtful |= wrong & ~np.isnan(column) & (fixed | (name in LIMITS))
        column[wrong] = np.nan
    # the focal plane is the mirror image of that in CS5, so that angles have the opposite signs
    pose = -np.column_stack([values[name] if name in values else np.full(len(ids), np.nan) for name in POSE])
    pose[~fixed] = np.nan
    lost = fixed & np.isnan(pose).any(axis=1)
    pose[lost] = np.nan
    polygons = np.full(len(ids), "default", dtype=object)
    if "EXCLUSION" in events.colnames:
        polygons[known] = np.char.strip(to_plain(events["EXCLUSION"], f"{path}: column 'EXCLUSION'").astype(str))
    return state, odd, lost, doubtful, pose, values, polygons.astype(str)


def read_polygons(path: Path, names: np.ndarray | None, n: int) -> tuple[float, ArmOutline | None, str]:
    """Return the median half width (mm) of the phi polygons of n positioners, their common outline, and a note.

    The outline, in CS5, consists of the most common polygons. It is None if these polygons form no outline.
    """
    polygons = _load(path)
    names = np.full(n, "default") if names is None else names
    different, counts = np.unique(names, return_counts=True)
    widths = {}
    for name in different.tolist():
        if name not in polygons:
            raise InputError(f"{path}: there must be polygons with the name {name!r}, got none")
        widths[name] = _half_width(polygons[name], f"{path}: the phi polygon {name!r}")
    half_widths = np.array([widths[name] for name in names.tolist()])
    text = (
        f"The clearance of segments is the median of the half widths of the phi polygons in {path.name}, which range "
        f"from {half_widths.min():.3f} to {half_widths.max():.3f} mm."
    )
    most, n_replaced = str(different[np.argmax(counts)]), n - int(counts.max())
    try:
        outline = find_outline(polygons[most])
    except (InputError, KeyError, IndexError, TypeError, ValueError):
        text += f" The polygons with the name {most!r} do not form a valid outline; segments replace the outlines."
        return float(np.median(half_widths)), None, text
    text += f" The outline of each positioner consists of the polygons with the name {most!r}"
    text += f", which also replace other polygons of {number_of(n_replaced, 'positioner')}." if n_replaced else "."
    return float(np.median(half_widths)), outline, text


def _half_width(polygon: object, what: str) -> float:
    """Return the largest distance of the outline from the axis of the arm, which is the x axis."""
    try:
        outline = polygon["phi"]
        points = [point for segment in outline["segments"] for point in segment]
        reach = [abs(float(y)) for _, y in points]
        reach += [abs(float(center[1])) + float(radius) for center, radius in outline["circles"]]
        width = max(reach)
    except (KeyError, IndexError, TypeError, ValueError):
        raise InputError(f"{what} must be lists of segments (x, y) and circles, got a different structure") from None
    if not 0 < width < MOST_WIDTH:
        raise InputError(f"{what} must have a half width above 0 and below {MOST_WIDTH} mm, got {width:g}")
    return width


def _load(path: Path) -> dict:
    """Return the content of a file in JSON or YAML, which may be compressed."""
    is_yaml = ".yaml" in path.name
    content = content_of(path, most=MOST_YAML if is_yaml else MOST_JSON)
    with reading(path, "YAML" if is_yaml else "JSON"):
        if is_yaml:
            import yaml  # a dependency of astropy

            polygons = yaml.load(content, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        else:
            polygons = json.loads(content)
    if not isinstance(polygons, dict):
        raise InputError(f"{path}: the file must contain a dict of polygons, got {type(polygons).__name__}")
    check_size(polygons, path, most_values=MOST_VALUES)
    return polygons


def find_outline(polygons: dict) -> ArmOutline:
    """Return the outline of a positioner from its exclusion polygons in CS5.

    The polygons ``phi`` are in the frame of the eccentric arm, and the polygons ``theta`` are in the frame of the
    central arm. Circles become discs. The lines of the polygons need not be closed, because the program fiberassign
    tests only whether lines intersect. Here, all lines that are not closed are connected at their nearest ends to form
    one closed polygon.
    """
    return ArmOutline(_parts(polygons["phi"]), _parts(polygons.get("theta", {"segments": [], "circles": []})))


def _parts(shape: dict) -> list:
    """Return the convex parts of a shape that consists of lines and circles."""
    lines = [np.array(line, dtype=float).reshape(-1, 2) for line in shape["segments"] if len(line)]
    closed = [line for line in lines if len(line) > 3 and np.allclose(line[0], line[-1])]
    open_lines = [line for line in lines if not any(line is ring for ring in closed)]
    rings = [line[:-1] for line in closed] + ([_joined(open_lines)] if open_lines else [])
    parts = [part for ring in rings for part in ((ring * u.mm,) if len(ring) < 3 else divide_polygon(ring * u.mm))]
    return parts + [
        (np.array([center], dtype=float) * u.mm, float(radius) * u.mm) for center, radius in shape["circles"]
    ]


def _joined(lines: list[np.ndarray]) -> np.ndarray:
    """Return the vertices of all lines as one sequence; each line starts near the end of the preceding line."""
    joined, *remaining = lines
    while remaining:
        gaps = [[np.hypot(*(line[end] - joined[-1])) for end in (0, -1)] for line in remaining]
        k, end = np.unravel_index(np.argmin(gaps), (len(remaining), 2))
        line = remaining.pop(k)
        joined = np.concatenate([joined, line[::-1] if end else line])
    return joined
