"""Compare planners of fibers on the same scenes: ``python tests/benchmarks/planners/compare.py [NAME ...]``.

Every program plans every scene, and the judge counts what its plan observes. The command prints a table, and writes it
with ``--output`` and as a chart with ``--plot``. Programs that are not installed are left out, with the reason.
``README.rst`` describes the scenes, the judge and the settings of each program.
"""

import argparse
import platform
from importlib import import_module
from pathlib import Path

import numpy as np
from astropy.table import Table
from judge import judge
from scene import SCENES, Scene, make

OURS = ("nearest", "lamost_rule", "network_flow", "repair", "optimal")
"""Allocators of rfpsurvey."""
RANDOM = ("repair random", "optimal random")
"""Allocators with random subpriorities, which run only if ``--program`` names them."""
PEERS = ("cpsat", "desi_fiberassign", "pfs_netflow", "sdss_kaiju")
"""Modules with a function ``plan`` that returns a plan, its processor time (s) and facts."""


def programs(only: list[str] | None, limits: list[float]):
    """Yield the label and the function of each program."""
    ours = import_module("ours")
    for name in (*OURS, *RANDOM):
        if name in (only or OURS):
            for limit in limits if name == "optimal" else limits[-1:]:
                label = f"{name} {limit:g} s" if name == "optimal" and len(limits) > 1 else name
                yield label, lambda scene, name=name, limit=limit: ours.plan(scene, name, limit)
    for name in PEERS:
        if only and name not in only:
            continue
        try:
            peer = import_module(name)
        except ImportError as error:
            print(f"{name}: skipped, {error}")
            continue
        for label, function in getattr(peer, "PLANS", {name: peer.plan}).items():
            yield label, lambda scene, function=function: function(scene, limits[-1])


def measure(scene: Scene, function, repeats: int) -> dict:
    """Return the counts of the judge, the least processor time (s) and the facts of a program on a scene."""
    plan, seconds, facts = function(scene)
    for _ in range(repeats - 1):
        seconds = min(seconds, function(scene)[1])
    return {**judge((scene.positioners, scene.targets, scene.settings), plan), "seconds": seconds, **facts}


def main() -> None:
    """Print, write and plot the comparison."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"scenes: {', '.join(SCENES)}")
    parser.add_argument("--program", action="append", help="run only these programs")
    parser.add_argument("--limit", type=float, action="append", help="time limits of the optimal allocator (s)")
    parser.add_argument("--repeats", type=int, default=3, help="runs of each program; the shortest time counts")
    parser.add_argument("--output", type=Path, help="write the table (.ecsv)")
    parser.add_argument("--plot", type=Path, help="draw the number of targets against the time")
    given = parser.parse_args()
    rows = []
    for name, scene in make(given.names):
        for label, function in programs(given.program, given.limit or [60.0]):
            try:
                if label.split()[0] in OURS:
                    function(scene)  # compile
                found = measure(scene, function, given.repeats)
            except NotImplementedError as error:
                print(f"{name:14} {label:17} left out: {error}")
                continue
            rows.append({"scene": name, "program": label, **found})
            print(
                f"{name:14} {label:17} science {found['science']:6} {found['by_priority']!s:24} standard "
                f"{found['standard']:4} sky {found['sky']:4} missing {found['missing']:4} colliding "
                f"{found['colliding']:4} {found['seconds']:8.3f} s  gap {found.get('gap')} {found['wrong'] or ''}",
                flush=True,
            )
    table = Table(rows=[{k: str(v) if isinstance(v, list | dict) else v for k, v in row.items()} for row in rows])
    table.meta["machine"] = f"{platform.processor() or platform.machine()}, Python {platform.python_version()}"
    if given.output:
        table.write(given.output, overwrite=True)
    if given.plot:
        draw(rows, given.plot)


def draw(rows: list[dict], path: Path) -> None:
    """Draw the number of observed targets against the time, one panel for each scene."""
    import matplotlib.pyplot as plt

    names = list(dict.fromkeys(row["scene"] for row in rows))
    n = int(np.ceil(np.sqrt(len(names))))
    figure, axes = plt.subplots(-(-len(names) // n), n, figsize=(3.4 * n, 3 * -(-len(names) // n)), squeeze=False)
    for ax, name in zip(axes.flat, names, strict=False):
        some = [row for row in rows if row["scene"] == name]
        mine = [row for row in some if row["program"].split()[0] in OURS]
        mine.sort(key=lambda row: row["seconds"])
        ax.semilogx([row["seconds"] for row in mine], [row["science"] for row in mine], "o-", color="#0072B2")
        for row in some:
            if row not in mine:
                ax.semilogx(row["seconds"], row["science"], "s", color="#D55E00")
            ax.annotate(
                row["program"], (row["seconds"], row["science"]), fontsize=7, xytext=(3, 3), textcoords="offset points"
            )
        ax.set(title=name, xlabel="processor time (s)", ylabel="science targets")
    for ax in axes.flat[len(names) :]:
        ax.remove()
    figure.tight_layout()
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    main()
