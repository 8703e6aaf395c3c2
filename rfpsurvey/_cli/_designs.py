"""Functions of the command ``design`` that parse the parameters of a scan and print a summary."""

import astropy.units as u
import numpy as np
from astropy.table import vstack

import rfpsurvey as rs
from rfpsurvey._cli._print import files, print_text
from rfpsurvey._readers import parse_number
from rfpsurvey.design import AXES

__all__ = ["axes", "finish"]

MOST_ROWS = 30
USUAL, NODES = {"central_arm": "8.25", "ratio": "1:2", "pitch": "24:34", "clearance": "2.25"}, 6
"""Default values and limits of the parameters of a scan, and the default number of grid nodes per parameter."""
COLUMNS = (
    "central_arm",
    "ratio",
    "pitch",
    "clearance",
    "collision_type",
    "coverage",
    "loss",
    "loss_error",
    "usable",
    "method",
)


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
        _print_rows(front[:MOST_ROWS], table)
        if len(front) > MOST_ROWS:
            print(f"and {len(front) - MOST_ROWS} more designs on the front")
        if "instrument" in table.colnames:
            _print_improvements(table)
        try:
            found = rs.design.design_sensitivities(table)
        except rs.InputError as error:  # there are too few designs
            print_text(f"no sensitivities: {error}")
        else:
            print_text(
                "sensitivities: figure is the name of a result; share is the fraction of the variance of this result "
                "that a parameter explains; slope is the change of this result in percent if the parameter grows by "
                "one percent:"
            )
            print("\n".join(found.pformat(max_lines=-1, max_width=-1)))
        if output.path is not None:
            print(f"wrote {output.path}")


def _print_rows(front, table) -> None:
    """Print the designs on the Pareto front, followed by the instrument's own design if it is not on the front."""
    columns = [*COLUMNS, *table.meta["objectives"]]
    if "instrument" in table.colnames:
        columns = ["instrument", *columns]
        own = table[(table["instrument"] != "") & ~table["pareto"]]
        front = vstack([front, own], metadata_conflicts="silent") if len(own) else front
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
    own, objectives = table[table["instrument"] != ""][0], table.meta["objectives"]
    print(f"{own['instrument']}: {', '.join(f'{_words(name)} {own[name]:.5g}' for name in AXES)}")
    try:
        found = rs.design.design_improvements(table)
    except rs.InputError as error:
        print_text(f"  no comparison: {error}", "    ")
        return
    print("  " + ", ".join(f"{_words(row['objective'])} {row['value']:.5g}" for row in found))
    for row, other in zip(found, reversed(list(objectives)), strict=True):
        aim = "largest" if objectives[row["objective"]] == "max" else "smallest"
        limit = "at least" if objectives[other] == "max" else "at most"
        text = f"  {aim} {_words(row['objective'])} with {limit} this {_words(other)}: "
        changes = ", ".join(filter(None, (_change(name, own[name], row[name], table[name]) for name in AXES)))
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
