"""Compare planners of fibers on the same scenes: ``python tests/benchmarks/planners/compare.py [NAME ...]``.

Every program plans every scene, and the judge counts what its plan observes. The command prints the results, and draws
them with ``--plot``. With ``--output``, the results replace the rows of the same scenes and programs in a table, and
its other rows stay. Programs that are not installed are left out, with the reason. ``README.rst`` describes the scenes,
the judge and the settings of each program.
"""

import argparse
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import results
from astropy.table import Table, vstack
from judge import judge
from scene import SCENES, Scene, make

OURS = ("nearest", "lamost_rule", "network_flow", "repair", "optimal", "joint")
"""Allocators of rfpsurvey; ``joint`` plans the tiles of a scene together."""
RANDOM = ("repair random", "optimal random")
"""Allocators with random subpriorities, which run only if ``--program`` names them."""
PEERS = ("cpsat", "desi_fiberassign", "pfs_netflow", "sdss_kaiju", "sdss_robostrategy", "recorded")
"""Modules with a function ``plan`` that returns a plan, its processor time (s) and facts.

``PLANS`` contains the function of each setting, and ``VERSION`` the version of the program. ``JOINT`` is true if the
function plans the tiles of a scene together.
"""


def programs(only: list[str], seconds: float) -> Iterator[tuple[str, str, Callable]]:
    """Yield the label, the version and the function of each program.

    The function returns the plan of a scene, the processor time (s) and facts.
    """
    ours = import_module("ours")
    for name in (*OURS, *RANDOM):
        if name in only:
            plan = ours.plan_together if name == "joint" else tile_by_tile(ours.plan)
            yield name, ours.VERSION, lambda scene, plan=plan, name=name: plan(scene, seconds, allocator=name)
    for name in PEERS:
        if name not in only:
            continue
        try:
            peer = import_module(name)
        except ImportError as error:
            print(f"{name}: skipped, {error}", flush=True)
            continue
        for label, plan in peer.PLANS.items():
            used = plan if getattr(peer, "JOINT", False) else tile_by_tile(plan)
            yield label, peer.VERSION, lambda scene, used=used: used(scene, seconds)


def tile_by_tile(plan: Callable) -> Callable:
    """Return a function that plans one tile after the other; targets with a fiber are removed from later tiles."""

    def plans(scene: Scene, seconds: float, **options) -> tuple[Table, float, dict]:
        if not scene.n_tiles:
            return plan(scene, seconds, **options)
        found, spent, seen = [], 0.0, set()
        for k in range(scene.n_tiles):
            part, own, _ = plan(scene.tile(k, without=seen), seconds / scene.n_tiles, **options)
            part["tile"] = k
            found.append(part)
            spent += own
            seen |= set(np.asarray(part["target"]).tolist())
        return vstack(found, metadata_conflicts="silent"), spent, {}

    return plans


def measure(scene: Scene, function: Callable, repeats: int) -> dict:
    """Return the counts of the judge, the least processor time (s) and the gap of a program on a scene."""
    plan, seconds, facts = function(scene)
    for _ in range(repeats - 1):
        seconds = min(seconds, function(scene)[1])
    parts = scene.positioners, scene.targets, scene.settings
    found = judge(parts, plan)
    alone = judge(parts, plan, idle=False) if found["colliding"] else found
    return {
        "science": found["science"],
        "by_class": " ".join(map(str, found["by_priority"])),
        **{name: found[name] for name in ("standard", "sky", "missing", "colliding", "doubles")},
        "science_without_idle": alone["science"],
        "wrong": sum(found["wrong"].values()),
        "seconds": seconds,
        "gap": facts.get("gap", ""),
    }


def main() -> None:
    """Print, write and plot the comparison."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"scenes, or scene files: {', '.join(SCENES)}")
    parser.add_argument("--program", action="append", help="run only these programs")
    parser.add_argument("--limit", type=float, default=60.0, help="time limit of each search (s)")
    parser.add_argument("--repeats", type=int, default=3, help="runs of each program; the shortest time counts")
    parser.add_argument("--output", type=Path, help="replace the rows of these scenes and programs in a table (.ecsv)")
    parser.add_argument("--plot", type=Path, help="draw the number of targets against the time")
    given = parser.parse_args()
    known = {*OURS, *RANDOM, *PEERS}
    if unknown := set(given.program or ()) - known:
        parser.error(f"--program must be one of {', '.join(sorted(known))}, got {', '.join(sorted(unknown))}")
    if unknown := [one for one in given.names if one not in SCENES and not one.endswith(".fits")]:
        parser.error(f"the scene must be a file (.fits) or one of {', '.join(SCENES)}, got {', '.join(unknown)}")
    asked = given.program or [*OURS, *PEERS]
    groups = [[one for one in asked if one not in PEERS], *([one] for one in asked if one in PEERS)]
    groups = [group for group in groups if group]
    with TemporaryDirectory() as folder:
        path = given.output or Path(folder) / "results.ecsv"
        options = f"--limit={given.limit}", f"--repeats={given.repeats}", f"--output={path}"
        if len(groups) == 1:
            run(given.names, groups[0], given.limit, given.repeats, path)
        else:  # OR-tools and highspy cannot be imported by the same process
            for group in groups:
                only = [f"--program={one}" for one in group]
                subprocess.run([sys.executable, __file__, *given.names, *only, *options], check=True)
        if given.plot:
            draw(results.read(path), given.plot)


def run(names: list[str], only: list[str], limit: float, repeats: int, path: Path) -> None:
    """Run programs on scenes, print the results and write them to a table."""
    where = {"limit": limit, "machine": results.machine(), "date": results.today()}
    every = list(programs(only, limit))
    for name, scene in make(names) if every else ():
        for label, version, function in every:
            try:
                if label.split()[0] in OURS:
                    function(scene)  # compile
                found = measure(scene, function, repeats)
            except NotImplementedError as error:
                print(f"{name:14} {label:17} left out: {error}", flush=True)
                continue
            print(
                f"{name:14} {label:17} science {found['science']:6} by class {found['by_class']:16} standard "
                f"{found['standard']:4} sky {found['sky']:4} missing {found['missing']:4} colliding "
                f"{found['colliding']:4} without idle {found['science_without_idle']:6} {found['seconds']:8.3f} s  "
                f"gap {found['gap'] or '-'} wrong {found['wrong']} doubles {found['doubles']}",
                flush=True,
            )
            row = {"scene": name, "program": label, "version": version, **found, **where}
            results.write(results.merge(results.read(path), [row], list(SCENES)), path)


def draw(rows: Table, path: Path) -> None:
    """Draw the number of observed targets against the time, one panel for each scene."""
    import matplotlib.pyplot as plt

    rows = [dict(zip(rows.colnames, row, strict=True)) for row in rows]
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
