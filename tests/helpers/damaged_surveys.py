"""Ways to damage the folder of a survey with recorded events, and what reading the damaged folder gives.

For any damage, a function that reads the folder must return the same result as for the undamaged folder, issue a
warning, or raise an InputError. It must not return another result without a warning, or raise another error.
"""

import json
import shutil
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from astropy.io import fits
from living import content, events, instrument, sha, targets, tiling

import rfpsurvey as rs
from rfpsurvey._survey.history.event_files import read_events
from rfpsurvey.survey import SurveyState, survey_status

SKY, TINY, TILES = targets(), instrument(), tiling()
SKY = replace(SKY, visits=np.where(SKY.id == 1005, 0, SKY.visits))  # one visit is requested, because it is required
CASE = SKY, TINY, TILES
ALLOCATOR = rs.AllocationOptions("nearest", required=["1005"])
OPTIONS = {"allocator": replace(ALLOCATOR, subpriority=1)}
JOINT = {"allocator": rs.JointOptions(iterations=2)}


def replan(folder: Path) -> rs.Survey:
    return rs.plan_survey(SKY, TINY, TILES, folder=folder, visits=SurveyState.read(folder, SKY), resume=True, **OPTIONS)


def make_survey(folder: Path) -> Path:
    """Write a survey with five files of events, two tables of targets and a copy of a plan, and return its folder."""
    survey = rs.plan_survey(SKY, TINY, TILES, folder=folder, **OPTIONS)
    name = str(survey.tile(11)["positioner"][0])
    survey.record(events(tile=11, date="2026-01-03", positioner=["", name]))
    survey.record(events(tile=[12, 13], date="2026-01-03", state=["partly", "bad"]))
    dropped = survey.tile(13)["target_id"][:2].tolist()  # so that the next plan of tile 13 is another plan
    survey.record(events(target=dropped, state="dropped"))
    replan(folder).record(events(tile=[12, 14], date="2999-01-05"), allow_future=True)
    survey.record(events(target=5000, visits=2, ra=120.1, dec=30.0, priority=2))
    replan(folder)
    return folder


FILES = {
    "request": "survey.json",
    "index": "index.csv",
    "planned tile": "tiles/000/000005.fits",
    "observed tile": "tiles/000/000000.fits",
    "table of tiles": "tiles.fits",
    "completeness": "completeness.ecsv",
    "outcomes": "outcomes.fits",
    "first event": "events/000001.json",
    "middle event": "events/000003.json",
    "last event": "events/000005.json",
    "table of targets": "events/000003-*.fits",
    "rows of a table": "events/000001-*.csv",
    "kept plan": "events/plans/*.fits",
    "dates of plans": "events/plans.csv",
    "checkpoint": "events/state.npz",
}
UNUSED = ("events/plans.csv", "events/generations.csv", "events/records.txt", "events/state.npz")
"""Files that do not determine the plan, and that are not written if the survey is planned already."""
OTHERS = ("notes.txt", "tiles/000/000700.fits", "events/000009-0.fits")


def path_of(folder: Path, name: str) -> Path:
    paths = [*folder.glob(FILES.get(name, name))]
    if name == "kept plan":  # that of an observation
        used = [f"{plan}.fits" for _, plan in read_events(folder).plans]
        paths = [path for path in paths if path.name in used]
    (path,) = paths
    return path


def on(name: str, change: Callable[[Path], object]) -> Callable[[Path], object]:
    """Return a function of the folder that calls ``change`` with the path of a file."""
    return lambda folder: change(path_of(folder, name))


def cut(path: Path, fraction: float = 1.0) -> None:
    body = path.read_bytes()
    path.write_bytes(body[: int(fraction * len(body)) - 5])


def flip(path: Path, place: float = 0.63) -> None:
    """Change one bit at a fraction of the length of a file."""
    body = bytearray(path.read_bytes())
    body[int(place * len(body))] ^= 1
    path.write_bytes(bytes(body))


def become_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def become_loop(path: Path) -> None:
    path.unlink()
    path.symlink_to(path.name)


def exchanged(one: str, other: str, *, index: bool = False) -> Callable:
    """Return a function that exchanges two files, and adapts the index if ``index`` is true."""

    def damage(folder):
        paths = path_of(folder, one), path_of(folder, other)
        bodies = [path.read_bytes() for path in paths]
        for path, body in zip(paths, bodies[::-1], strict=True):
            path.write_bytes(body)
            if index:
                adapt_index(folder, path)

    return damage


def lines(name: str, change: Callable[[list[str], int], list[str]]) -> Callable:
    """Return a function that edits the index; ``change`` receives its lines, and the number of the line of a file."""

    def damage(folder):
        head, *found = (folder / "index.csv").read_text().splitlines(keepends=True)
        row = next(k for k, line in enumerate(found) if line.startswith(f"{FILES.get(name, name)},"))
        (folder / "index.csv").write_text(head + "".join(change(found, row)))

    return damage


def line(change: Callable[[str], str]) -> Callable:
    """Return the parameter ``change`` of `lines` that replaces the line of the file."""
    return lambda found, row: [*found[:row], change(found[row]), *found[row + 1 :]]


def adapt_index(folder: Path, path: Path) -> None:
    """Write the present checksum of a file to the index."""
    name, body = str(path.relative_to(folder)), path.read_bytes()
    lines(name, line(lambda _: f"{name},{len(body)},{sha(body)}\n"))(folder)


def cell(name: str, column: str, row: int, value: object) -> Callable:
    """Return a function that changes a value of a table, and adapts the index."""

    def damage(folder):
        path = path_of(folder, name)
        with fits.open(path) as units:
            units[1].data[column][row] = value
            units.writeto(path, overwrite=True)
        adapt_index(folder, path)

    return damage


def request(change: Callable[[dict], object]) -> Callable:
    """Return a function that edits the request."""

    def damage(folder):
        found = json.loads((folder / "survey.json").read_text())
        change(found)
        (folder / "survey.json").write_text(json.dumps(found, indent=1, sort_keys=True) + "\n")

    return damage


def entries(**values: object) -> Callable:
    """Return a function that replaces entries of the request; None removes an entry."""

    def change(found):
        found.update(values)
        for name in [name for name, value in values.items() if value is None]:
            del found[name]

    return request(change)


def event(name: str, *, digest: bool = True, **values: object) -> Callable:
    """Return a function that replaces values of a file of events or of its first tile, and adapts its digest."""

    def damage(folder):
        path = path_of(folder, name)
        found = json.loads(path.read_text())
        about = found["events"]
        (about["tiles"][0] if "date" in values else about).update(values)
        body = json.dumps(about, separators=(",", ":"), sort_keys=True)
        path.write_text(f'{{"digest": "{sha(body.encode()) if digest else found["digest"]}", "events":\n{body}\n}}\n')

    return damage


def event_with_all_digests(**values: object) -> Callable:
    """Return a function that changes a tile in the fourth file of events, and adapts all digests."""

    def damage(folder):
        event("events/000004.json", **{"date": "2999-01-05", **values})(folder)
        digests = [json.loads(path.read_text())["digest"] for path in sorted((folder / "events").glob("*.json"))]
        event("last event", previous=digests[3])(folder)
        digest = json.loads(path_of(folder, "last event").read_text())["digest"]
        request(lambda found: found["events"].update(digest=digest))(folder)

    return damage


def without_events(*numbers: int, renamed: bool = False) -> Callable:
    def damage(folder):
        for number in numbers:
            (folder / f"events/{number:06d}.json").unlink()
        for k, path in enumerate(sorted((folder / "events").glob("*.json")), 1) if renamed else ():
            path.rename(path.with_name(f"{k:06d}.json"))

    return damage


def one_after_the_other(*damages: Callable) -> Callable:
    return lambda folder: [damage(folder) for damage in damages]


CHANGES = {
    "cut": cut,
    "half": lambda path: cut(path, 0.5),
    "one bit": flip,
    "one bit at the begin": lambda path: flip(path, 0.05),
    "empty": lambda path: path.write_bytes(b""),
    "missing": Path.unlink,
    "a folder": become_folder,
    "a loop of links": become_loop,
}
WRONG_REQUESTS = {
    "no events": {"events": None},
    "fewer events": {"events": {"n_files": 4, "digest": "0" * 64}},
    "events are a number": {"events": 5},
    "their number is text": {"events": {"n_files": "five", "digest": "0" * 64}},
    "their number is negative": {"events": {"n_files": -1, "digest": "0" * 64}},
    "no required targets": {"required_ids": None},
    "other required targets": {"required_ids": ["1007"]},
    "required targets are a number": {"required_ids": 5},
    "another seed": {"rng": 1},
    "another catalog": {"given": "60 targets, digest 1"},
    "no catalog": {"given": None},
    "columns are a number": {"columns": 5},
    "another column": {"columns": {"visits": "1"}},
    "first is a number": {"first": 5},
    "no tiles": {"tiles": None},
    "other tiles": {"tiles": "9999999999999 tiles, digest 1"},
    "software is a number": {"software": 5},
    "another instrument": {"instrument": "tiny, digest 1"},
    "planned is a number": {"planned": 5},
}
WRONG_EVENTS = {
    "no such row": {"row": 700, "tile": "700"},
    "a negative row": {"row": -1},
    "a row as text": {"row": "1"},
    "a number as state": {"state": 5},
    "a list as date": {"date": [1]},
    "a list of failures": {"failed": [1]},
    "a dropped tile that does not exist": {"row": 700, "state": "dropped", "plan": ""},
    "an added tile without a place": {"row": 6, "tile": "17", "state": "added", "place": [1]},
}
DAMAGES = {
    **{
        f"{name}: {words}": on(name, change)
        for words, change in CHANGES.items()
        for name in (FILES if words in ("cut", "one bit", "missing") else ("observed tile", "first event", "index"))
    },
    "planned tile: that of another tile": exchanged("planned tile", "tiles/000/000004.fits"),
    "observed tile: that of another tile": exchanged("observed tile", "planned tile"),
    "kept plan: that of another tile": exchanged("kept plan", "planned tile"),
    "tables: exchanged": exchanged("table of tiles", "outcomes"),
    "tables: exchanged with the index": exchanged("table of tiles", "outcomes", index=True),
    "events: exchanged": exchanged("first event", "middle event"),
    "tables of targets: exchanged": exchanged("table of targets", "events/000005-*.fits"),
    "tiles: exchanged with the index": exchanged("planned tile", "tiles/000/000004.fits", index=True),
    "tiles: an observed one exchanged with the index": exchanged("observed tile", "planned tile", index=True),
    "planned tile: text with its checksum": one_after_the_other(
        on("planned tile", lambda path: path.write_bytes(b"nothing")),
        lambda folder: adapt_index(folder, path_of(folder, "planned tile")),
    ),
    **{
        f"index: without the line of the {name}": lines(name, lambda found, row: found[:row] + found[row + 1 :])
        for name in ("planned tile", "observed tile", "table of tiles", "completeness", "outcomes")
    },
    **{
        f"index: another checksum of the {name}": lines(name, line(lambda old: f"{old[:-65]}{'0' * 64}\n"))
        for name in ("planned tile", "observed tile", "outcomes")
    },
    "index: a line twice": lines("planned tile", lambda found, row: [*found[: row + 1], *found[row:]]),
    **{
        f"index: another size of the {name}": lines(name, line(lambda old: old.replace(",", ",1", 1)))
        for name in ("table of tiles", "planned tile", "observed tile")
    },
    "index: other text": lines("planned tile", line(lambda old: f"\ufffd junk\n{old}")),
    "index: reversed": lines("planned tile", lambda found, _: found[::-1]),
    "index: a further file": lines("planned tile", line(lambda old: f"{old}tiles/000/000900.fits,5,{'0' * 64}\n")),
    "index: no header": on("index", lambda path: path.write_bytes(path.read_bytes().partition(b"\n")[2])),
    "events: without the first": without_events(1),
    "events: without the first, renamed": without_events(1, renamed=True),
    "events: without one in the middle": without_events(3),
    "events: without one in the middle, renamed": without_events(3, renamed=True),
    "events: without the last": without_events(5),
    "events: all missing": without_events(1, 2, 3, 4, 5),
    "events: the last one again": on("last event", lambda path: shutil.copy(path, path.with_name("000006.json"))),
    "events: another name": on("last event", lambda path: path.rename(path.with_name("5.json"))),
    "first event: edited": event("first event", digest=False, date="2026-01-02"),
    "first event: edited with its digest": event("first event", date="2026-01-02"),
    "last event: edited with its digest": event("last event", n_targets=59),
    "middle event: other version": event("middle event", version=3),
    "middle event: other targets": event("middle event", targets="../../x.fits"),
    "first event: tiles are a number": event("first event", tiles=5),
    "request: a list": on("request", lambda path: path.write_text("[]")),
    "request: no events, and the last one is missing": one_after_the_other(entries(events=None), without_events(5)),
    **{f"request: {words}": entries(**values) for words, values in WRONG_REQUESTS.items()},
    "dates of plans: other text": on("dates of plans", lambda path: path.write_text("a,b,c\nx,y\n")),
    "other files": lambda folder: [(folder / name).write_text("notes") for name in OTHERS],
    "no tiles": lambda folder: shutil.rmtree(folder / "tiles"),
    "no folder of events": lambda folder: shutil.rmtree(folder / "events"),
}
"""Damages that no reader may overlook."""
FORGERIES = {
    "planned tile: a visit failed": cell("planned tile", "observed", 0, False),
    "planned tile: another target": cell("planned tile", "target_row", 0, 3),
    "planned tile: no such target": cell("planned tile", "target_row", 0, 3000),
    "observed tile: a visit failed": cell("observed tile", "observed", 0, False),
    "outcomes: another number": cell("outcomes", "observed", 7, 250),
    "table of tiles: another state": cell("table of tiles", "state", 4, "done"),
    **{f"events: {words}": event_with_all_digests(**values) for words, values in WRONG_EVENTS.items()},
}
"""Files that were changed together with their checksums, which only the verification of all files must find."""
JOINT_DAMAGES = {
    f"{name}: {words}": on(name, change)
    for name in ("joint.ecsv", "joint/state.npz")
    for words, change in CHANGES.items()
}


def plain(table) -> list:
    return [(name, np.asarray(table[name]).tolist()) for name in table.colnames]


def read(folder: Path) -> list:
    survey = rs.Survey.read(folder)
    joint = [] if survey.joint is None else [survey.joint]
    return [survey.summary, *map(plain, (survey.tiles, survey.completeness, survey.outcomes, *joint, *survey))]


def read_state(folder: Path) -> list:
    state = SurveyState.read(folder, SKY)
    return [plain(state.table), state.summary, *sorted(state.kept.items())]


def plan_again(folder: Path) -> list:
    survey, rows = replan(folder), FILES["rows of a table"]
    files = {name: body for name, body in content(folder).items() if name not in (*UNUSED, *OTHERS)}
    files = {name: body for name, body in files.items() if not Path(name).match(rows)}
    request = json.loads(files.pop("survey.json"))
    del request["generation"]  # a request with another value causes a new generation with the same plans
    return [survey.summary, request, files]


def plan_together_again(folder: Path) -> list:
    survey = rs.plan_survey(SKY, TINY, TILES, folder=folder, resume=True, **JOINT)
    return [survey.summary, content(folder)]


def select(folder: Path) -> list:
    found = rs.selection_probabilities(SurveyState.read(folder, SKY), TINY, TILES, 2, allocator=ALLOCATOR)
    return [plain(found.table), found.summary]


def status(folder: Path) -> list:
    survey = rs.Survey.read(folder)
    found = survey_status(survey, survey.state(SKY))
    return [plain(found), found.meta]


def record(folder: Path) -> list:
    said = rs.Survey.read(folder).record(events(tile=16, date="2999-01-09"), allow_future=True)
    return [said, (folder / "events/000006.json").read_bytes()]


READERS = (read, read_state, plan_again, select, status, record)


def outcome(reader: Callable, folder: Path, expected: list) -> tuple[str, str]:
    """Return a word for what reading a damaged folder gives, and the messages."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            found = reader(folder)
        except rs.InputError as error:
            is_short = "\n" not in str(error) and len(str(error)) < 600 + len(str(folder))
            return "error" if is_short else "long sentence", str(error)
        except Exception as error:
            return "traceback", f"{type(error).__name__}: {error}"
    strange = [one.message for one in told if not issubclass(one.category, rs.RfpsurveyWarning)]
    if strange:
        return "foreign warning", str(strange[0])
    if repr(found) == repr(expected):
        return "right", ""
    return "told" if told else "wrong", "; ".join(str(one.message) for one in told)
