"""Compute the results of a set of designs, possibly in another process."""

from dataclasses import dataclass

import numpy as np

from rfpsurvey.design._lattice import make_lattice
from rfpsurvey.design._losses import METHODS, Skies, cheapest, in_box
from rfpsurvey.design._rows import blank

MOST_TARGETS = 1000.0


@dataclass(frozen=True)
class Task:
    """The settings of a scan that are the same for all designs; quantities are numbers without units."""

    estimand: str
    method: str
    step: float
    """Motor step, in radians."""
    targets: float
    """Number of targets: per mm^2 if ``by_area`` is true, otherwise per positioner."""
    by_area: bool
    n_skies: int
    time_limit: float
    seed: int

    def __call__(self, first: int, designs: np.ndarray) -> np.ndarray:
        """Return the records of consecutive designs; ``first`` is the index of the first design."""
        rows = blank(designs, self.estimand)
        for number, row in enumerate(rows, first):
            self._fill(row, np.random.default_rng([self.seed, number]))
        return rows

    def _fill(self, row, rng):
        lattice, reason = make_lattice(row["central_arm"], row["ratio"], row["pitch"], row["clearance"], self.step)
        if lattice is None:
            row["reason"] = reason
            return
        row["min_separation"], row["collision_type"] = lattice.unit.numbers.separation, lattice.collision_type
        row["multiplicity"], row["positioners_per_area"] = lattice.multiplicity, 100 / lattice.cell
        for depth, part in enumerate(lattice.coverage()):
            row[f"reach_{depth}"] = part
        row["coverage"] = 1 - row["reach_0"]
        each = self.targets * (lattice.cell if self.by_area else 1.0)
        row["targets"], row["empty"] = each, np.exp(-each * lattice.multiplicity)
        if each > MOST_TARGETS:
            row["reason"] = f"the number of targets per positioner exceeds {MOST_TARGETS:g}"
            return
        method = cheapest(self.estimand, lattice) if self.method == "auto" else self.method
        if METHODS[method].limited and not in_box(lattice):
            row["reason"] = f"the parameters are outside the range of the method {method!r}"
            return
        loss = METHODS[method].function(lattice, Skies(each, self.n_skies, rng, self.time_limit))
        row["method"] = method
        row["assigned"], row["loss"], row["loss_error"], row["n_unproven"], row["loss_gap"] = loss
        row["usable"] = loss.assigned * (1 - loss.loss)
        row["usable_per_area"] = row["usable"] * row["positioners_per_area"]
        if np.isnan(loss.loss):
            row["reason"] = "no fiber has a target"
