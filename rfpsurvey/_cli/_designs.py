"""What the command ``design`` needs: axes from text, and a summary."""

from pathlib import Path

import astropy.units as u
import numpy as np

import rfpsurvey as rs
from rfpsurvey._cli import _app

__all__ = ["axes", "finish", "loss"]

MOST_ROWS = 30
FIGURE = (
    "The designs. Each point is a design, and its color and marker are the ratio of the arms or the parameter with "
    "most values. Large points with an edge, joined by a line, are the front: no other design is better in both "
    "objectives."
)
USUAL, NODES = {"ratio": "1:2", "pitch": "24:34"}, 6
"""Limits where nothing else is asked, and the nodes of a grid between them."""
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


def axes(n_designs: int | None, **texts: str | None) -> dict:
    """Return the parameters of a scan from text such as 8.25, or 7,8,9, or 22:30:9, or 22:30; lengths in mm."""
    return {name: _axis(name, text, n_designs) * (1 if name == "ratio" else u.mm) for name, text in texts.items()}


def _axis(name, text, n_designs):
    option = "--" + name.replace("_", "-")
    if text is None:
        text = USUAL[name] if n_designs is not None else f"{USUAL[name]}:{NODES}"
    words = text.split(":") if ":" in text else text.split(",")
    try:
        numbers = [float(word) for word in words[:2]] if ":" in text else [float(word) for word in words]
        nodes = int(words[2]) if ":" in text and len(words) == 3 else None
        if ":" in text and len(words) > 3:
            raise ValueError
    except ValueError:
        raise rs.InputError(
            f"{option} must be a number, or several as 7,8,9 or LOW:HIGH:NODES, or LOW:HIGH with --n-designs, got "
            f"{text!r}"
        ) from None
    if ":" not in text:
        return np.array(numbers)
    if n_designs is not None and nodes is not None:
        raise rs.InputError(f"{option} {text}: with --n-designs give limits only, as {words[0]}:{words[1]}")
    if n_designs is None and (nodes is None or nodes < 2):
        raise rs.InputError(f"{option} {text}: a grid needs at least two nodes, as {words[0]}:{words[1]}:5")
    return np.array(numbers) if nodes is None else np.linspace(*numbers, nodes)


def loss(estimand, method, each, density: float | None, n_skies: int, time_limit: float) -> "rs.design.LossOptions":
    """Return the loss that options of the command ask for."""
    return rs.design.LossOptions(
        estimand,
        method,
        targets_per_positioner=each,
        target_density=None if density is None else density / u.mm**2,
        n_skies=n_skies,
        time_limit=time_limit * u.s,
    )


def finish(table, output: Path | None, plot: Path | None, report: Path | None, *, overwrite: bool) -> None:
    """Draw the front and write a page where asked, and print the front and the sensitivities."""
    page = {"title": f"{len(table)} designs", "data": output}
    if report is not None:
        page["figures"] = {FIGURE: rs.plot.plot_designs(table)}
    draw = (plot, lambda: rs.plot.plot_designs(table).figure)
    with _app.files(overwrite=overwrite, plot=draw, report=(report, table, page)):
        front = table[table["pareto"]]
        wanted = ", ".join(f"{name} {aim}" for name, aim in table.meta["objectives"].items())
        print(f"{len(table)} designs, loss of fibers: {table['estimand'][0]}; on the front ({wanted}): {len(front)}")
        front.sort(next(iter(table.meta["objectives"])), reverse=True)
        _app.print_table(front[list(dict.fromkeys([*COLUMNS, *table.meta["objectives"]]))][:MOST_ROWS])
        if len(front) > MOST_ROWS:
            print(f"and {len(front) - MOST_ROWS} more")
        try:
            found = rs.design.design_sensitivities(table)
        except rs.InputError as error:  # one design, or a few
            print(f"no sensitivities: {error}")
        else:
            print(
                "share of the variance that each parameter explains, and percent of change for one percent more of it:"
            )
            _app.print_table(found)
        if output is not None:
            print(f"wrote {output}")
