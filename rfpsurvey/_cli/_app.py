"""The application, and what all commands share."""

import sys
import warnings
from pathlib import Path
from typing import Annotated

import typer

import rfpsurvey as rs

__all__ = [
    "app", "check_outputs", "finish", "load_instrument", "main", "parse_center", "parse_pairs", "read_table",
    "select_rows",
]  # fmt: skip

PICTURES = (".png", ".pdf", ".svg")

app = typer.Typer(
    help="Assign targets to theta-phi fiber positioners and score the collisions of their arms.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"rfpsurvey {rs.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version and exit.", callback=_print_version, is_eager=True),
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command line; bad input ends with one sentence and the exit code 2."""
    warnings.showwarning = lambda message, *_: print(f"rfpsurvey: warning: {message}", file=sys.stderr)
    warnings.filterwarnings("ignore", module="astropy")
    warnings.simplefilter("always", rs.RfpsurveyWarning)
    try:
        app()
    except (rs.InputError, OSError) as error:
        print(f"rfpsurvey: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)


def parse_center(text: str, equinox: str | None = None):
    """Return a SkyCoord from text such as "06h20m00s +23d00m00s" or "95.0 23.0" (degrees)."""
    from astropy.coordinates import FK5, SkyCoord

    try:
        numbers = len(text.split()) == 2 and all(
            part.lstrip("+-").replace(".", "", 1).isdigit() for part in text.split()
        )
        center = SkyCoord(text, unit="deg") if numbers else SkyCoord(text)
        return center if equinox is None else center.transform_to(FK5(equinox=equinox))
    except Exception as error:  # astropy's parsers raise what they like
        raise rs.InputError(
            f"--center must be coordinates such as '06h20m00s +23d00m00s' or '95.0 23.0', got {text!r} ({error})"
        ) from None


def parse_pairs(pairs: list[str] | None, option: str) -> dict[str, str]:
    """Return a dict from options of the form NAME=VALUE."""
    found = {}
    for pair in pairs or []:
        name, sign, value = pair.partition("=")
        if not sign or not name or not value:
            raise rs.InputError(f"{option} must have the form NAME=VALUE, got {pair!r}")
        found[name] = value
    return found


def load_instrument(name: str) -> "rs.Instrument":
    """Return a preset by name, or the instrument that a TOML file describes."""
    return rs.Instrument.read(name) if name.endswith(".toml") else rs.Instrument.preset(name)


def print_summary(tile: "rs.Tile") -> None:
    """Print what came out, a line a figure."""
    labels = {
        "n_targets": "targets in the catalog",
        "n_dropped": "  dropped, no finite coordinates",
        "n_in_field": "  in the field",
        "n_set_aside": "  set aside (sky, standard)",
        "n_reachable": "  in reach of a positioner",
        "n_rows_ignored": "rows without an assignment",
        "n_positioners": "positioners",
        "n_assigned": "  assigned",
        "n_out_of_reach": "  their target out of reach",
        "n_wrong_fiber": "  without the fiber type asked for",
        "n_unusable": "rows for disabled or stuck positioners",
        "n_parked": "  parked in the way",
        "n_colliding": "  in collision",
        "n_colliding_pairs": "colliding pairs",
        "n_obstacle_collisions": "collisions with obstacles",
        "collision_rate": "collision rate",
        "collision_rate_assigned": "  of assigned positioners",
    }
    name, values = tile.provenance["instrument"]["name"], tile.provenance["parameters"]
    print(f"{name}, allocator {values['allocator']}")
    for key, label in labels.items():
        value = tile.summary.get(key, 0)
        if value or key in ("n_colliding", "n_colliding_pairs", "collision_rate"):
            print(f"{label:<34}{value:>10.4f}" if isinstance(value, float) else f"{label:<34}{value:>10}")
    seconds = tile.summary["seconds"]
    print(f"{'seconds':<34}{sum(seconds.values()):>10.3f}  " + ", ".join(f"{k} {v:.3f}" for k, v in seconds.items()))


def read_table(path: Path):
    """Read a table of any format."""
    from rfpsurvey._io import read_table as read

    return read(path)


def select_rows(table, wanted: dict[str, str]):
    """Return the rows whose columns have the given values, compared as text."""
    for name, value in wanted.items():
        if name not in table.colnames:
            raise rs.InputError(f"--select: there is no column {name!r}; the columns are: {', '.join(table.colnames)}")
        table = table[[str(v) == value for v in table[name]]]
        if len(table) == 0:
            raise rs.InputError(f"--select {name}={value} leaves no row")
    return table


def check_outputs(output: Path | None, plot: Path | None, *, overwrite: bool) -> None:
    """Refuse an output that cannot be written before any work is done."""
    from rfpsurvey._io import WRITABLE, check_output

    if output is not None:
        check_output(output, WRITABLE, overwrite=overwrite)
    if plot is not None:
        check_output(plot, PICTURES, overwrite=overwrite)


def finish(tile: "rs.Tile", output: Path | None, plot: Path | None, *, overwrite: bool) -> None:
    """Print the summary; write the table and the picture where asked."""
    from rfpsurvey._io import output_path

    print_summary(tile)
    if output is not None:
        tile.write(output, overwrite=overwrite)
        print(f"wrote {output}")
    if plot is not None:
        with output_path(plot, PICTURES, overwrite=overwrite) as temporary:
            rs.plot_focal_plane(tile).figure.savefig(temporary, dpi=200, format=plot.suffix[1:].lower())
        print(f"wrote {plot}")
