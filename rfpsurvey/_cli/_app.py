"""The application, and what all commands share."""

import os
import signal
import sys
import warnings
from concurrent.futures import BrokenExecutor
from pathlib import Path
from typing import Annotated

import astropy.units as u
import numpy as np
import typer
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs
from rfpsurvey._io import WRITABLE, check_output, output_path, read_table, write_table
from rfpsurvey.catalog import UNITS, as_catalog

__all__ = [
    "app", "check_chart", "check_outputs", "finish", "finish_comparison", "finish_estimate", "finish_table",
    "finish_tiling", "instrument_of", "load_instrument", "main", "parse_center", "parse_pairs", "plan_options",
    "print_table", "read_assignment", "read_catalog", "read_targets", "targets_and_center", "to_mm", "units_of",
    "write_figure",
]  # fmt: skip

PICTURES = (".png", ".pdf", ".svg")
MOST_AIMS = 12
DEFAULT_CENTER = "06h20m00s +23d00m00s"

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
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # let outputs that are half written be removed
    try:
        app()
    except BrokenPipeError:  # the reader of the output has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)
    except (rs.InputError, OSError, BrokenExecutor) as error:
        print(f"rfpsurvey: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)


def parse_center(text: str):
    """Return a SkyCoord from text such as "06h20m00s +23d00m00s" or "95.0 23.0" (degrees)."""
    words = text.replace(",", " ").split()
    try:
        if len(words) == 2 and all(_is_number(word) for word in words):
            return SkyCoord(float(words[0]), float(words[1]), unit="deg")
        return SkyCoord(" ".join(words), unit=("hourangle", "deg"))
    except Exception as error:  # astropy's parsers raise what they like
        raise rs.InputError(
            f"--center must be coordinates such as '06h20m00s +23d00m00s' or '95.0 23.0', got {text!r} ({error})"
        ) from None


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


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


def instrument_of(table, name: str | None) -> "rs.Instrument":
    """Return the instrument asked for, or that of a tile of ours."""
    provenance = table.meta.get("provenance")
    own = provenance.get("instrument", {}).get("name") if isinstance(provenance, dict) else None
    if name is None and own is None:
        known = ", ".join(rs.available_instruments())
        raise rs.InputError(f"--instrument must say what the assignment was made for: {known}, or a TOML file")
    instrument = load_instrument(name or own)
    if own is not None and own != instrument.name:
        raise rs.InputError(f"the tile was made for {own}, and cannot be scored for {instrument.name}")
    return instrument


def read_catalog(path: Path, column, unit, frame: str):
    """Return the catalog of a file, or of a folder of partitions."""
    read = rs.PartitionedCatalog if path.is_dir() else rs.Catalog.read
    return read(path, columns=parse_pairs(column, "--column"), units=parse_pairs(unit, "--unit"), frame=frame)


def targets_and_center(path, center, model, seed, column, unit, frame):
    """Return the catalog of a file, or a synthetic one, and the field center."""
    field = None if center is None else parse_center(center)
    if path is None:
        field = parse_center(DEFAULT_CENTER) if field is None else field
        return rs.synthetic_catalog("poisson", field, model.field_radius, density=model.target_density, rng=seed), field
    targets = as_catalog(read_catalog(path, column, unit, frame))
    if field is None and len(targets) == 0:
        field = parse_center(DEFAULT_CENTER)
    elif field is None:
        field = targets._middle
    return targets, field


def plan_options(pa, equinox, epoch, require, required, sky_separation, objective, time_limit) -> dict:
    """Return the arguments of plan_tile that options stand for."""
    own = require is not None and "instrument" in require
    if own and len(require) > 1:
        raise rs.InputError("--require instrument stands for all requirements of the instrument: give no others")
    if sky_separation is not None:
        sky_separation = sky_separation * u.arcsec
    return {
        "position_angle": pa * u.deg, "equinox": equinox, "epoch": epoch, "required": required or None,
        "requirements": "instrument" if own else require, "sky_separation": sky_separation, "objective": objective,
        "time_limit": time_limit * u.s,
    }  # fmt: skip


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
        "n_idle": "  idle, giving way",
        "n_colliding": "  in collision",
        "n_colliding_pairs": "colliding pairs",
        "n_obstacle_collisions": "collisions with obstacles",
        "collision_rate": "collision rate",
        "collision_rate_assigned": "  of assigned positioners",
    }
    name, values = tile.provenance["instrument"]["name"], tile.provenance["parameters"]
    print(f"{name}, allocator {values['allocator']}")
    if "ra_deg" in values:
        turn = f"position angle {values['position_angle_deg']:g} deg from the north of {values['north_of']}"
        where = f"center {values['ra_deg']:.6f} {values['dec_deg']:+.6f} deg"
        print(f"{where}, {turn}, epoch {values['epoch'] or 'as given'}")
    for key, label in labels.items():
        value = tile.summary.get(key, 0)
        if value or key in ("n_colliding", "n_colliding_pairs", "collision_rate"):
            print(f"{label:<34}{value:>10.4f}" if isinstance(value, float) else f"{label:<34}{value:>10}")
    _print_aims(tile.summary)
    seconds = tile.summary["seconds"]
    print(f"{'seconds':<34}{sum(seconds.values()):>10.3f}  " + ", ".join(f"{k} {v:.3f}" for k, v in seconds.items()))


def _print_aims(summary) -> None:
    """Print the classes of targets, whether the plan is proven, and what it lacks."""
    aims = summary.get("aims", [])
    if len(aims) > 1:
        for name, value, bound in aims[:MOST_AIMS]:
            label = "  missing of the requirements" if name == "requirements" else f"  {name}"
            proof = "" if bound in (None, value) else f"  at most {abs(bound):.0f}"
            print(f"{label:<34}{abs(value):>10.0f}{proof}")
        if len(aims) > MOST_AIMS:
            print(f"  and {len(aims) - MOST_AIMS} more classes")
    if summary.get("gap") is not None:
        model = summary["search"].get("model", "")
        print(f"{'gap to the best plan':<34}{summary['gap']:>10.4f}  {model}")
    for sentence in summary.get("unmet", []):
        print(f"not met: {sentence}")


def finish_comparison(table, output: Path | None, *, overwrite: bool) -> None:
    """Print methods side by side, and write the table where asked."""
    print(f"{table.meta['instrument']}; {table.meta['blind_science']} science targets if arms could pass each other")
    print_table(table)
    for name, sentences in table.meta["unmet"].items():
        for sentence in sentences:
            print(f"{name}: not met: {sentence}")
    if output is not None:
        write_table(table, output, overwrite=overwrite)
        print(f"wrote {output}")


def read_assignment(path: Path, select: list[str] | None):
    """Read a table, and keep the rows whose columns have the given values, compared as text."""
    table = read_table(path)
    for name, value in parse_pairs(select, "--select").items():
        if name not in table.colnames:
            raise rs.InputError(f"--select: there is no column {name!r}; the columns are: {', '.join(table.colnames)}")
        table = table[[str(getattr(v, "value", v)) == value for v in table[name]]]
        if len(table) == 0:
            raise rs.InputError(f"--select {name}={value} leaves no row")
    table.meta.update(file=path.name, select=", ".join(select or []))
    return table


def units_of(path: Path, unit: list[str] | None) -> dict[str, str]:
    """Return the units that were given, after the usual ones of a CSV file, which carries none."""
    usual = {role: str(u) for role, u in UNITS.items()} if path.suffix.lower() == ".csv" else {}
    return {**usual, **parse_pairs(unit, "--unit")}


def to_mm(value: float | None):
    """Return a length, if there is one."""
    return None if value is None else value * u.mm


def read_targets(name: str):
    """Return a catalog from a file, or the name of a kind of random targets as it is."""
    return rs.Catalog.read(name) if Path(name).suffix else name


def check_outputs(output: Path | None, plot: Path | None, *, overwrite: bool) -> None:
    """Refuse an output that cannot be written before any work is done."""
    if output is not None:
        check_output(output, WRITABLE, overwrite=overwrite)
    if plot is not None:
        check_output(plot, PICTURES, overwrite=overwrite)


def check_chart(plot: Path, *, overwrite: bool) -> Path:
    """Return where the table goes that belongs to a chart, if both can be written."""
    check_output(plot, PICTURES, overwrite=overwrite)
    return check_output(plot.with_suffix(".ecsv"), WRITABLE, overwrite=overwrite)


def finish(tile: "rs.Tile", output: Path | None, plot: Path | None, *, overwrite: bool) -> None:
    """Write the table and the picture where asked, and print the summary."""
    if output is not None:
        tile.write(output, overwrite=overwrite)
    if plot is not None:
        write_figure(lambda: rs.plot_focal_plane(tile).figure, plot, overwrite=overwrite)
    print_summary(tile)
    for path in (output, plot):
        if path is not None:
            print(f"wrote {path}")


def finish_tiling(tiling: "rs.Tiling", output: Path | None, plot: Path | None, *, overwrite: bool) -> None:
    """Print how a tiling was made, and write and draw it where asked."""
    for name, value in tiling.summary.items():
        if value != "":
            print(f"{name.replace('_', ' '):<24}{value:>14{'.4f' if isinstance(value, float) else ''}}")
    if output is not None:
        tiling.write(output, overwrite=overwrite)
    if plot is not None:
        write_figure(lambda: rs.plot_tiling(tiling).figure, plot, overwrite=overwrite)
    for path in filter(None, (output, plot)):
        print(f"wrote {path}")


def finish_estimate(estimate, model: "rs.Instrument", output: Path | None, *, overwrite: bool) -> None:
    """Print an estimate, a line a figure, and write its map where asked."""
    formula = np.isnan(estimate.low)
    interval = "no error is known" if formula else f"{estimate.low:.5f} to {estimate.high:.5f}"
    print(f"{model.name}, {estimate.method}, {estimate.estimand} targets")
    lines = {
        "collision probability": f"{estimate.value:.5f}",
        f"  {100 * estimate.meta['confidence']:g} % interval": interval,
        "  standard error": "" if formula else f"{estimate.standard_error:.2g}",
        "  of assigned positioners": f"{estimate.value_assigned:.5f}",
        "colliding pairs per positioner": "" if formula else f"{estimate.pairs_per_positioner:.5f}",
        "iterations": estimate.n or "",
        "effective trials": "" if formula else f"{estimate.n_effective:.0f}",
        "seconds": f"{estimate.seconds:.3f}",
    }
    for label, value in lines.items():
        if value not in ("", "nan"):
            print(f"{label:<34}{value}")
    meta = {k: v for k, v in estimate.meta.items() if k not in ("confidence", "interval")}
    print(", ".join(f"{k} {v:.6g}" if isinstance(v, float) else f"{k} {v}" for k, v in meta.items()))
    if output is not None:
        xy = model.focal_plane.xy
        table = QTable(
            {"id": model.focal_plane.id, "x": xy[:, 0], "y": xy[:, 1], "probability": estimate.per_positioner}
        )
        table.meta.update(estimate.meta, instrument=model.name, method=estimate.method, value=estimate.value)
        write_table(table, output, overwrite=overwrite)
        print(f"wrote {output}")


def print_table(table) -> None:
    """Print a table of results with four digits."""
    table = table.copy()
    for column in table.columns.values():
        if column.dtype.kind == "f":
            column.info.format = ".4g"
    print("\n".join(table.pformat(max_lines=-1, max_width=-1)))


def finish_table(table, draw, output: Path, plot: Path, *, overwrite: bool) -> None:
    """Print a table of results, write it, and draw its chart."""
    print_table(table)
    write_table(table, output, overwrite=overwrite)
    write_figure(lambda: np.atleast_1d(draw(table))[0].figure, plot, overwrite=overwrite)
    print(f"wrote {output}\nwrote {plot}")


def write_figure(make_figure, path: Path, *, overwrite: bool) -> None:
    """Write the figure that a function makes."""
    with output_path(path, PICTURES, overwrite=overwrite) as temporary:
        make_figure().savefig(temporary, dpi=200, format=path.suffix[1:].lower())
