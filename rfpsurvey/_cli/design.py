"""The command ``rfpsurvey design``."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import astropy.units as u
import numpy as np
from astropy.table import vstack

import rfpsurvey as rs
from rfpsurvey._cli import command as _app
from rfpsurvey._cli import process as _process
from rfpsurvey._cli import results as _results
from rfpsurvey._cli.command import command
from rfpsurvey._cli.results import files, is_verbose, print_text
from rfpsurvey._common.read_tables import parse_number
from rfpsurvey._studies.design import LossOptions
from rfpsurvey._studies.design_rows import AXES
from rfpsurvey._survey import key_groups
from rfpsurvey._survey.key_types import Located, Part

BRIEF = 6
"""Largest number of designs that are printed without --verbose."""
MOST_ROWS = 30
USUAL, NODES = {"central_arm": "8.25", "ratio": "1:2", "pitch": "24:34", "clearance": "2.25"}, 6
"""Default values and limits of the parameters of a scan, and the default number of grid nodes per parameter."""
COLUMNS = (*AXES, "collision_type", "coverage", "loss", "loss_error", "usable", "method")


@dataclass(frozen=True)
class DesignInstrumentKeys(key_groups.StateTimeKeys):
    """The instrument around whose design a scan is made.

    Parameters
    ----------
    name : str, optional
        Instrument (preset or TOML file) whose design is varied. The values of this design replace the default values of
        the parameters.
    """

    name: Annotated[str | None, Located] = None
    arm_model = broken = margins = None


@dataclass(frozen=True)
class DesignOutputKeys(key_groups.OutputKeys):
    """The files that the command writes.

    Parameters
    ----------
    path : Path, optional
        Write the finished designs to this file (.fits or .ecsv).
    resume : bool, optional
        Continue the unfinished scan in the output file.
    plot : Path, optional
        Plot the Pareto front (.png, .pdf or .svg).
    """

    path: Path | None = None
    resume: bool = False


@dataclass(frozen=True, kw_only=True)
class DesignKeys:
    """The keys of the command.

    Parameters
    ----------
    spread : float, optional
        With an instrument, vary the central arm, the ratio of the arms and the pitch by up to this fraction of their
        values. By default, 0.15.
    central_arm : str, optional
        Length of the central arm (mm): a number such as 8.25, a list such as 7,8,9, a grid such as 7:9:5 (five values
        from 7 to 9), or limits LOW:HIGH with n_designs. By default, 8.25.
    ratio : str, optional
        Ratio of the length of the eccentric arm to the length of the central arm, in one of the forms of central_arm.
        The default range is 1 to 2.
    pitch : str, optional
        Distance between the centers of adjacent positioners (mm), in one of the forms of central_arm. The default range
        is 24 to 34.
    clearance : str, optional
        Clearance, which is the width of the margin around each eccentric arm (mm), in one of the forms of central_arm.
        By default, 2.25.
    n_designs : int, optional
        Number of designs, which are Sobol points between the limits LOW and HIGH of each parameter. By default, a grid
        is scanned.
    objectives : dict[str, str], optional
        Objectives of the Pareto front, two columns with max or min. By default, coverage=max and loss=min.
    """

    instrument: DesignInstrumentKeys
    loss: Annotated[dict, Part(LossOptions)]
    output: DesignOutputKeys
    spread: float | None = None
    central_arm: str | None = None
    ratio: str | None = None
    pitch: str | None = None
    clearance: str | None = None
    n_designs: int | None = None
    objectives: dict[str, str] | None = None
    rng: key_groups.Seed = 0
    workers: key_groups.Workers = 1
    processes: key_groups.Processes = False


@command(
    DesignKeys,
    "instrument.name spread central_arm ratio pitch clearance n_designs loss.estimand loss.method "
    "loss.targets_per_positioner objectives rng workers output.path output.resume output.plot output.report "
    "output.overwrite",
)
def design(keys: DesignKeys) -> None:
    r"""Scan designs of positioners, optionally around the design of an instrument, and find the best designs.

    Examples
    --------
    rfpsurvey design --ratio 1:2:5 --pitch 22:30:9
    rfpsurvey design --instrument mine.toml --plot mine.png
    rfpsurvey design --instrument lamost --spread 0.3 --pitch 24:32:9
    rfpsurvey design --central-arm 7.25:14.5 --ratio 1:2 --pitch 24.6:35 \
        --n-designs 4096 --plot front.png
    rfpsurvey design --ratio 1:2:5 --estimand allocated --output designs.ecsv \
        --workers 2
    rfpsurvey design --ratio 1,1.5 --pitch 25:35:5 --estimand collision_free \
        --targets-per-positioner 1 --workers 2
    """
    output, around = keys.output, keys.instrument.name is not None
    _app.check_outputs(output, [keys.instrument.name], writable=None)
    if keys.spread is not None and not around:
        raise rs.InputError(
            "--spread must be used with --instrument, which names the instrument whose design is varied; "
            "got no --instrument"
        )
    parameters = {name: getattr(keys, name) for name in AXES}
    scan = axes(keys.n_designs, around=around, **parameters)
    scan |= {"loss": LossOptions(**keys.loss), "objectives": keys.objectives, "n_designs": keys.n_designs}
    scan |= {"rng": keys.rng, "progress": sys.stderr.isatty()}
    scan |= {"path": output.path, "resume": output.resume, "overwrite": output.overwrite}
    kept = (
        "no designs were stored, because --output was not given"
        if output.path is None
        else f"the finished designs are stored in {output.path}; continue with --resume"
    )
    _process.tell_if_interrupted(kept)
    with _results.workers(keys) as executor:
        if around:
            scan |= {} if keys.spread is None else {"spread": keys.spread}
            table = rs.design.explore_around(_app.model_of(keys.instrument), executor=executor, **scan)
        else:
            table = rs.design.explore_designs(executor=executor, **scan)
    finish(table, output)


def axes(n_designs: int | None, *, around: bool = False, **texts: str | None) -> dict:
    """Convert texts such as 8.25, or 7,8,9, or 22:30:9, or 22:30 to the parameters of a scan; lengths are in mm.

    Parameters that are not given have default values or, in a scan ``around`` an instrument, the values of the
    instrument.
    """
    texts = {name: text for name, text in texts.items() if not (around and text is None)}
    return {name: _axis(name, text, n_designs) * (1 if name == "ratio" else u.mm) for name, text in texts.items()}


def _axis(name, text, n_designs):
    option = "--" + name.replace("_", "-")
    if text is None:
        text = f"{USUAL[name]}:{NODES}" if ":" in USUAL[name] and n_designs is None else USUAL[name]
    words = text.split(":") if ":" in text else text.split(",")
    try:
        numbers = [parse_number(word) for word in (words[:2] if ":" in text else words)]
        nodes = parse_number(words[2], int) if ":" in text and len(words) == 3 else None
        if ":" in text and len(words) > 3:
            raise ValueError
    except ValueError:
        raise rs.InputError(
            f"{option} must be a number, several numbers such as 7,8,9, or LOW:HIGH:NODES, or LOW:HIGH with "
            f"--n-designs, got {text!r}"
        ) from None
    if ":" not in text:
        return np.array(numbers)
    if n_designs is not None and nodes is not None:
        raise rs.InputError(f"{option} {text}: with --n-designs, give only limits, such as {words[0]}:{words[1]}")
    if n_designs is None and (nodes is None or nodes < 2):
        raise rs.InputError(f"{option} {text}: a grid needs at least two nodes, such as {words[0]}:{words[1]}:5")
    return np.array(numbers) if nodes is None else np.linspace(*numbers, nodes)


def finish(table, output) -> None:
    """Print the best designs (the Pareto front) and their sensitivities; write the plot and the report if requested."""
    page = {"title": f"{len(table)} designs", "data": output.path}
    with files(output, draw=lambda: rs.plot.plot_designs(table).figure, report=(table, page)):
        front = table[table["pareto"]]
        wanted = ", ".join(f"{name} {aim}" for name, aim in table.meta["objectives"].items())
        print_text(
            f"{len(table)} designs, definition of the loss (fraction of lost fibers): {table['estimand'][0]}; "
            f"on the Pareto front ({wanted}): {len(front)}"
        )
        front.sort(next(iter(table.meta["objectives"])), reverse=True)
        most = MOST_ROWS if is_verbose() else BRIEF
        _print_rows(front[:most], table)
        if len(front) > most:
            print(f"and {len(front) - most} more designs on the front")
        if "instrument" in table.colnames:
            _print_improvements(table)
        if not is_verbose():
            if output.path is not None:
                print(f"wrote {output.path}")
            return
        try:
            sensitivities = rs.design.design_sensitivities(table)
        except rs.InputError as error:  # there are too few designs
            print_text(f"no sensitivities: {error}")
        else:
            print_text(
                "sensitivities: figure is the name of a result; share is the fraction of the variance of this result "
                "that a parameter explains; slope is the change of this result in percent if the parameter grows by "
                "one percent:"
            )
            print("\n".join(sensitivities.pformat(max_lines=-1, max_width=-1)))
        if output.path is not None:
            print(f"wrote {output.path}")


def _print_rows(front, table) -> None:
    """Print the designs on the Pareto front, followed by the instrument's own design if it is not on the front."""
    columns = [*COLUMNS, *table.meta["objectives"]]
    if "instrument" in table.colnames:
        columns = ["instrument", *columns]
        missing = table[(table["instrument"] != "") & ~table["pareto"]]
        front = vstack([front, missing], metadata_conflicts="silent") if len(missing) else front
    front = front[list(dict.fromkeys(columns))]
    for name in front.colnames:
        if front[name].dtype.kind == "f":
            _format(front[name])
    print("\n".join(front.pformat(max_lines=-1, max_width=-1)))


def _format(column) -> None:
    """Set the format of a column so that different numbers are printed differently, with at most 12 digits."""
    values = np.asarray(column, dtype=float)
    n_different = len({f"{value:.12g}" for value in values.tolist()})
    for form in (column.info.format or ".4g", *(f".{digits}g" for digits in range(5, 13))):
        column.info.format = form
        if len(set(column.info.iter_str_vals())) == n_different:
            break


def _print_improvements(table) -> None:
    """Print a comparison of the best designs of a scan with the instrument around which the designs vary."""
    start, objectives = table[table["instrument"] != ""][0], table.meta["objectives"]
    print(f"{start['instrument']}: {', '.join(f'{_words(name)} {start[name]:.5g}' for name in AXES)}")
    try:
        improvements = rs.design.design_improvements(table)
    except rs.InputError as error:
        print_text(f"  no comparison: {error}", "    ")
        return
    print("  " + ", ".join(f"{_words(row['objective'])} {row['value']:.5g}" for row in improvements))
    for row, bounded in zip(improvements, reversed(list(objectives)), strict=True):
        aim = "largest" if objectives[row["objective"]] == "max" else "smallest"
        limit = "at least" if objectives[bounded] == "max" else "at most"
        text = f"  {aim} {_words(row['objective'])} with {limit} this {_words(bounded)}: "
        changes = ", ".join(filter(None, (_change(name, start[name], row[name], table[name]) for name in AXES)))
        print_text(
            text
            + (f"{row['best']:.5g} ({row['change']:+.2g}) by {changes}" if changes else "the value of this instrument"),
            "    ",
        )


def _change(name, before, after, scanned) -> str:
    """Return text with the new value of a parameter and its change in percent, or empty text if it is unchanged."""
    if abs(after - before) <= 1e-9 * abs(before):
        return ""
    edge = ", at the edge of the scan" if after in (scanned.min(), scanned.max()) else ""
    percent = f"{100 * float(after / before - 1):+.0f} %" if before > 0 * before else "from 0"
    return f"{_words(name)} {after:.5g} ({percent}{edge})"


def _words(name: str) -> str:
    return name.replace("_", " ")
