"""Options of joint plans on the command line, and the text that is printed before the search."""

import sys
from typing import Annotated

import astropy.units as u
import typer

import rfpsurvey as rs
from rfpsurvey.errors import warn

__all__ = ["FixedOption", "GapOption", "IterationsOption", "JointTimeOption", "joint_order"]

GapOption = Annotated[
    float | None,
    typer.Option("--joint-gap", help="With --order joint: end when at most this fraction of the visits is missing."),
]
IterationsOption = Annotated[
    int | None, typer.Option("--joint-iterations", help="With --order joint: largest number of iterations.")
]
JointTimeOption = Annotated[
    float | None, typer.Option("--joint-time", help="With --order joint: time limit of all iterations (s).")
]
FixedOption = Annotated[
    str | None,
    typer.Option("--fixed", help="With --order joint: folder of a survey whose tiles were already observed."),
]
# Below this fraction of additional visits, the text says that a joint plan is not worth the time.
LITTLE = 0.001


def joint_order(order: str, gap: float | None, iterations: int | None, seconds: float | None, fixed: str | None):
    """Return the parameter ``order`` of `plan_survey`."""
    given = {"gap": gap, "iterations": iterations, "fixed": fixed}
    given["time_limit"] = None if seconds is None else seconds * u.s
    given = {name: value for name, value in given.items() if value is not None}
    if order == "joint":
        return rs.JointOptions(**given, inform=_print_gain)
    if given:
        warn("--joint-gap, --joint-iterations, --joint-time and --fixed have no effect without --order joint")
    return order


def _print_gain(state: dict) -> None:
    """Print how many visits a joint plan can add."""
    visits, bound = state["visits"][-1], int(state["bound"][-1])
    more = bound - visits
    part = more / max(visits, 1)
    text = f"tiles one after the other: {visits} visits; a matching without collisions: {bound} visits"
    several = any(int(b) > v for v, b in zip(state["visits"][:-1], state["bound"][:-1], strict=True))
    if part < LITTLE and not several:
        text += f"; a joint plan can add at most {more} visits ({part:.2%}), which is not worth much time"
    else:
        text += f"; a joint plan can add at most {more} visits ({part:.1%})"
    print(text, file=sys.stderr)
