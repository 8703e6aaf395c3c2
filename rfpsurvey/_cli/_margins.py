"""The command-line option of margins."""

from dataclasses import replace
from typing import Annotated

import typer

import rfpsurvey as rs

__all__ = ["MarginsOption", "check_use", "parse_margins", "with_margins"]

MarginsOption = Annotated[
    str | None,
    typer.Option(
        help="Margins that plans keep from mechanical limits and broken positioners: instrument (the published "
        "margins), off, or NAME=VALUE, separated by commas, such as outer=0.2,inner=0.1 or instrument,broken=0.3. The "
        "names are outer, inner, arms and broken (mm), broken_factor and hidden_factor. By default, there are no "
        "margins."
    ),
]


def parse_margins(text: str, published: "rs.Margins | None") -> "rs.Margins":
    """Return the margins for the text of --margins; ``published`` are the margins of the instrument, if it has any."""
    first, *rest = parts = [part.strip() for part in text.split(",")]
    margins = rs.Margins()
    if first in ("off", "instrument"):
        parts = rest
        if first == "instrument":
            if not published:
                raise rs.InputError(
                    "--margins must give values, such as outer=0.1, because the description of the instrument has no "
                    f"margins, got {text!r}"
                )
            margins = published
    given = {}
    for part in parts:
        name, _, value = part.partition("=")
        try:
            number = float(value)
        except ValueError:
            number = None
        if number is None or name in given or first == "off":
            raise rs.InputError(
                "--margins must be off, instrument, or NAME=VALUE with different names, separated by commas, such as "
                f"outer=0.2,inner=0.1 (lengths in mm), got {text!r}"
            )
        given[name] = number
    own = rs.Margins.from_numbers(given)
    return replace(margins, **{name: getattr(own, name) for name in given})


def with_margins(model: "rs.Instrument", text: str | None) -> "rs.Instrument":
    """Return an instrument with the margins of --margins or, without this option, with its own margins."""
    return model if text is None else model.use_margins(parse_margins(text, model.published_margins))


def check_use(margins: str | None, *, by_positioners: bool) -> None:
    """Raise an error if --margins is given, but tiles are placed without the positioners of an instrument."""
    if margins is not None and not by_positioners:
        raise rs.InputError(
            "--margins must be given only if positioners observe the targets of a catalog; add --allocator, and leave "
            "out --fibers and --radius"
        )
