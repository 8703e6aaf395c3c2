"""What commands print, and the files that they write when the work is done."""

from pathlib import Path

import numpy as np
from astropy.table import QTable

import rfpsurvey as rs
from rfpsurvey._io import output_path, write_table
from rfpsurvey.report import estimate_facts, tile_aims, tile_facts

__all__ = [
    "PICTURES", "finish", "finish_comparison", "finish_estimate", "finish_report", "finish_table", "finish_tiling",
    "print_table", "write_figure",
]  # fmt: skip

PICTURES = (".png", ".pdf", ".svg")
MOST_AIMS = 12


def finish(tile: "rs.Tile", output: Path | None, plot: Path | None, report: Path | None, *, overwrite: bool) -> None:
    """Write the table and the picture where asked, and print the summary."""
    if output is not None:
        tile.write(output, overwrite=overwrite)
    if plot is not None:
        write_figure(lambda: rs.plot_focal_plane(tile).figure, plot, overwrite=overwrite)
    print_summary(tile)
    for path in filter(None, (output, plot)):
        print(f"wrote {path}")
    finish_report(tile, report, overwrite=overwrite, data=output)


def finish_tiling(
    tiling: "rs.Tiling", output: Path | None, plot: Path | None, report: Path | None, *, overwrite: bool
) -> None:
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
    finish_report(tiling, report, overwrite=overwrite, data=output)


def finish_comparison(table, output: Path | None, report: Path | None, *, overwrite: bool) -> None:
    """Print methods side by side, and write the table where asked."""
    print(f"{table.meta['instrument']}; {table.meta['blind_science']} science targets if arms could pass each other")
    print_table(table)
    for name, sentences in table.meta["unmet"].items():
        for sentence in sentences:
            print(f"{name}: not met: {sentence}")
    if output is not None:
        write_table(table, output, overwrite=overwrite)
        print(f"wrote {output}")
    finish_report(table, report, overwrite=overwrite, data=output)


def finish_estimate(
    estimate, model: "rs.Instrument", output: Path | None, report: Path | None, *, overwrite: bool
) -> None:
    """Print an estimate, a line a figure, and write its map where asked."""
    print(f"{model.name}, {estimate.method}, {estimate.estimand} targets")
    for label, value in estimate_facts(estimate).items():
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
    title = f"Collision probability of {model.name}"
    finish_report(estimate, report, overwrite=overwrite, title=title)


def finish_table(table, draw, output: Path, plot: Path, report: Path | None, *, overwrite: bool) -> None:
    """Print a table of results, write it, draw its chart, and write a page where asked."""
    print_table(table)
    write_table(table, output, overwrite=overwrite)
    write_figure(lambda: _first(draw(table)).figure, plot, overwrite=overwrite)
    print(f"wrote {output}\nwrote {plot}")
    if report is not None:
        chart = {f"Time against error, on {table.meta['instrument']}.": _first(draw(table))}
        title = f"Benchmark: {table.meta['instrument']}"
        finish_report(table, report, overwrite=overwrite, title=title, figures=chart, data=output)


def _first(axes):
    return np.atleast_1d(axes)[0]


def print_summary(tile: "rs.Tile") -> None:
    """Print what came out, a line a figure."""
    name, values = tile.provenance["instrument"]["name"], tile.provenance["parameters"]
    print(f"{name}, allocator {values['allocator']}")
    if "ra_deg" in values:
        turn = f"position angle {values['position_angle_deg']:g} deg from the north of {values['north_of']}"
        where = f"center {values['ra_deg']:.6f} {values['dec_deg']:+.6f} deg"
        print(f"{where}, {turn}, epoch {values['epoch'] or 'as given'}")
    for label, value in tile_facts(tile).items():
        print(f"{label:<34}{value:>10.4f}" if isinstance(value, float) else f"{label:<34}{value:>10}")
    _print_aims(tile)
    seconds = tile.summary["seconds"]
    print(f"{'seconds':<34}{sum(seconds.values()):>10.3f}  " + ", ".join(f"{k} {v:.3f}" for k, v in seconds.items()))


def _print_aims(tile: "rs.Tile") -> None:
    """Print the classes of targets, whether the plan is proven, and what it lacks."""
    summary, aims = tile.summary, tile_aims(tile)
    for name, value, proof in aims[:MOST_AIMS]:
        print(f"{'  ' + name:<34}{value:>10}  {proof}".rstrip())
    if len(aims) > MOST_AIMS:
        print(f"  and {len(aims) - MOST_AIMS} more classes")
    if summary.get("gap") is not None:
        model = summary["search"].get("model", "")
        print(f"{'gap to the best plan':<34}{summary['gap']:>10.4f}  {model}")
    for sentence in summary.get("unmet", []):
        print(f"not met: {sentence}")


def print_table(table) -> None:
    """Print a table of results with four digits."""
    table = table.copy()
    for column in table.columns.values():
        if column.dtype.kind == "f":
            column.info.format = ".4g"
    print("\n".join(table.pformat(max_lines=-1, max_width=-1)))


def finish_report(result, path: Path | None, **options) -> None:
    """Write a page on a result where asked."""
    if path is not None:
        rs.write_report(result, path, **options)
        print(f"wrote {path}")


def write_figure(make_figure, path: Path, *, overwrite: bool) -> None:
    """Write the figure that a function makes."""
    with output_path(path, PICTURES, overwrite=overwrite) as temporary:
        make_figure().savefig(temporary, dpi=200, format=path.suffix[1:].lower())
