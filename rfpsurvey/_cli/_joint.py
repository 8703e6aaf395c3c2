"""Command-line options of joint plans, and the text that is printed before the search for a joint plan."""

import sys
from typing import Annotated

import astropy.units as u
import typer

import rfpsurvey as rs
from rfpsurvey.errors import warn_no_effect

__all__ = ["FixedOption", "GapOption", "IterationsOption", "JointTimeOption", "joint_order"]

GapOption = Annotated[
    float | None,
    typer.Option(
        "--joint-gap",
        help="With --order joint: end the search when the number of visits is at most this fraction below its "
        "upper bound.",
    ),
]
IterationsOption = Annotated[
    int | None, typer.Option("--joint-iterations", help="With --order joint: largest number of iterations.")
]
JointTimeOption = Annotated[
    float | None, typer.Option("--joint-time", help="With --order joint: time limit of the search (s).")
]
FixedOption = Annotated[
    str | None,
    typer.Option(
        "--fixed",
        help="With --order joint: folder of a survey whose tiles were already observed. The plans of these tiles "
        "do not change.",
    ),
]
# If the search can increase the number of visits by less than this fraction, the text advises against a long search.
LITTLE = 0.001


def joint_order(order: str, gap: float | None, iterations: int | None, seconds: float | None, fixed: str | None):
    """Convert command-line options to the parameter ``order`` of `plan_survey`."""
    given = {"gap": gap, "iterations": iterations, "fixed": fixed}
    given["time_limit"] = None if seconds is None else seconds * u.s
    given = {name: value for name, value in given.items() if value is not None}
    if order == "joint":
        return rs.JointOptions(**given, inform=_print_gain)
    names = {"gap": "--joint-gap", "iterations": "--joint-iterations", "fixed": "--fixed", "time_limit": "--joint-time"}
    for name in given:
        warn_no_effect(names[name], "without --order joint")
    return order


def _print_gain(state: dict) -> None:
    """Print the number of visits before the search, and the largest number of visits that the search can reach."""
    before, visits, bound = state["visits_before"][-1], state["visits"][-1], int(state["bound"][-1])
    more = max(bound - visits, 0)
    part = more / max(visits, 1)
    text = (
        f"visits: {before} with tiles planned one after the other; {visits} after visits were moved between tiles; "
        f"at most {max(bound, visits)} with any plan\n"
    )
    several = any(int(b) > v for v, b in zip(state["visits"][:-1], state["bound"][:-1], strict=True))
    if more == 0 and not several:
        text += "the search cannot add visits"
    elif part < LITTLE and not several:
        text += f"the search can add at most {more} visits ({part:.2%}); a long search is not worthwhile"
    else:
        text += f"the search can add at most {more} visits ({part:.2%})"
        text += ", or move visits from targets of lower priority to targets of higher priority" if several else ""
    print(text, file=sys.stderr)
