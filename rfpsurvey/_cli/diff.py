"""The command ``rfpsurvey diff``."""

from collections import Counter
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from rfpsurvey._cli import _main, _print
from rfpsurvey._io import write_table
from rfpsurvey._outputs import WRITABLE, check_output
from rfpsurvey.errors import number_of
from rfpsurvey.survey import diff_surveys

MOST_TILES = 40


@_main.app.command(cls=_main.Command)
def diff(
    first: Annotated[Path, typer.Argument(help="Folder of a survey, such as a copy of its first plan.")],
    second: Annotated[Path, typer.Argument(help="Folder of another plan of the survey.")],
    output: Annotated[
        Path | None, typer.Option(help="Write a table with a row for each tile and each fiber that changed.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace existing files.")] = False,
) -> None:
    """List the tiles and fibers that differ between two plans of a survey, and the reasons.

    Examples
    --------
    rfpsurvey diff before plan
    rfpsurvey diff before plan --output changes.ecsv
    """
    if output is not None:
        check_output(output, WRITABLE, overwrite=overwrite)
    table = diff_surveys(first, second)
    if output is not None:
        write_table(table, output, overwrite=overwrite)
    n_tiles = table.meta["n_tiles"]
    if len(table) == 0:
        print(f"the plans are the same: {number_of(n_tiles[0], 'tile')}")
    for folder, n in zip((first, second), table.meta["n_later_files"], strict=True):
        if n:
            _print.print_text(f"events that were recorded in {folder} after its last plan are not compared")
    is_tile = np.asarray(table["positioner"]) == ""
    for what, rows in (("tiles", is_tile), ("fibers", ~is_tile)):
        counts = Counter(np.asarray(table["reason"])[rows].tolist()).most_common()
        _print.print_facts({f"{what}: {reason}": n for reason, n in counts})
    numbers = Counter(np.asarray(table["tile"])[~is_tile].tolist())
    words = {tile: [] for tile in dict.fromkeys(np.asarray(table["tile"]).tolist())}
    for tile, reason in zip(table["tile"][is_tile].tolist(), table["reason"][is_tile].tolist(), strict=True):
        words[tile].append(reason)
    for tile, n in numbers.items():
        words[tile].append(f"{number_of(n, 'fiber')} changed")
    for tile in list(words)[:MOST_TILES]:
        _print.print_text(f"tile {tile}: {', '.join(words[tile])}")
    if len(words) > MOST_TILES:
        print(f"and {number_of(len(words) - MOST_TILES, 'more tile')}")
    if output is not None:
        print(f"wrote {output}")
