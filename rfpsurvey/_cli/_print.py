"""What commands print, and the files that they write when the work is done."""

from pathlib import Path

import numpy as np
from astropy.table import QTable

import rfpsurvey as rs
from rfpsurvey._io import output_path, write_table

__all__ = [
    "PICTURES", "finish", "finish_comparison", "finish_estimate", "finish_table", "finish_tiling", "print_table",
    "write_figure",
]  # fmt: skip

PICTURES = (".png", ".pdf", ".svg")
MOST_AIMS = 12


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
        if value != "":
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


def finish_table(table, draw, output: Path, plot: Path, *, overwrite: bool) -> None:
    """Print a table of results, write it, and draw its chart."""
    print_table(table)
    write_table(table, output, overwrite=overwrite)
    write_figure(lambda: np.atleast_1d(draw(table))[0].figure, plot, overwrite=overwrite)
    print(f"wrote {output}\nwrote {plot}")


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


def print_table(table) -> None:
    """Print a table of results with four digits."""
    table = table.copy()
    for column in table.columns.values():
        if column.dtype.kind == "f":
            column.info.format = ".4g"
    print("\n".join(table.pformat(max_lines=-1, max_width=-1)))


def write_figure(make_figure, path: Path, *, overwrite: bool) -> None:
    """Write the figure that a function makes."""
    with output_path(path, PICTURES, overwrite=overwrite) as temporary:
        make_figure().savefig(temporary, dpi=200, format=path.suffix[1:].lower())
