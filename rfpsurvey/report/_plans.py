"""Figures and tables that show several plans of one tile on paper, and in browsers that run no scripts."""

from collections.abc import Callable, Mapping

import numpy as np
from astropy.table import QTable

from rfpsurvey.errors import listed
from rfpsurvey.report._blocks import Picture, Rows, Text
from rfpsurvey.tile import Tile

MOST_DRAWN = 20_000
"""Largest number of positioners in the figures of all further plans, because each figure takes time and space."""


def blocks_of_plans(plans: Mapping[str, Tile], draw: Callable, drawn: int = 0) -> list:
    """Return a table of the differences between the first plan and each plan, and a figure of each plan.

    ``draw`` returns the figure of a plan; the page has figures of the first ``drawn`` plans already.
    """
    if len(plans) < 2:
        return []
    names = list(plans)
    end = max(drawn, MOST_DRAWN // len(plans[names[0]]))
    blocks = [Rows(f"Differences of the plans from the plan {names[0]}.", differences(plans))]
    for name in names[drawn:end]:
        axes = draw(plans[name])
        for artist in (*axes.collections, *axes.lines):
            artist.set_rasterized(True)  # a page with several plans would be large
        blocks.append(Picture(f"The whole focal plane in the plan {name}.", axes))
    if names[end:]:
        blocks.append(
            Text(f"There are no figures of the plans {listed(names[end:])}; the interactive view shows them.")
        )
    return blocks


def differences(plans: Mapping[str, Tile]) -> QTable:
    """Return a table with a row for each plan, which is compared with the first plan."""
    first, rows = None, []
    for name, tile in plans.items():
        own = np.ma.filled(np.ma.asarray(tile.table["target_id"]).astype(str), "")
        first = own if first is None else first
        same, before, now = own == first, first != "", own != ""
        counts = (now, same & now, ~same & before & now, ~same & before & ~now, ~same & ~before & now)
        rows.append((name, *(int(np.count_nonzero(one)) for one in counts), tile.summary["n_colliding"]))
    names = ("plan", "with a target", "same target", "different target", "target only in the first plan")
    return QTable(rows=rows, names=(*names, "target only in this plan", "in collision"))
