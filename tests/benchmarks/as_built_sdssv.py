"""Numbers on the page on instruments as built, for SDSS-V: out of reach and colliding, with nominal and measured arms.

Run ``RFPSURVEY_TEST_DATA=... python tests/benchmarks/as_built_sdssv.py``, which takes some seconds.
"""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from astropy.table import QTable

import rfpsurvey as rs

FOLDER = Path(os.environ["RFPSURVEY_TEST_DATA"])
CALIBRATIONS = ("sdssv_apo_2021", "sdssv_apo_2024")
DESIGNS = {21636: "APO", 21637: "APO", 50323: "APO"}
LCO = (502706, 503246, 503247, 505253, 505254)


def instruments():
    """Return the nominal instrument and those as built, by name."""
    return {"nominal": rs.Instrument.preset("sdss_apo"), **{n: rs.Instrument.read(FOLDER / n) for n in CALIBRATIONS}}


def line(what, name, tile):
    s = tile.summary
    keys = ("n_assigned", "n_out_of_reach", "n_wrong_fiber", "n_colliding_pairs", "n_obstacle_collisions")
    print(f"{what:<28}{name:<16}" + "".join(f"{s[key]:>10}" for key in keys))


def plans(models):
    """Print the numbers for each plan and each instrument."""
    heads = ("assigned", "no reach", "no fiber", "pairs", "obstacles")
    print(f"{'plan':<28}{'instrument':<16}" + "".join(f"{head:>10}" for head in heads))
    designs = QTable.read(FOLDER / "sdssv_eight_designs.ecsv")
    for design in (*DESIGNS, *LCO):
        table = designs[designs["design_id"] == design]
        if design in LCO:
            line(f"design {design}", "nominal, LCO", rs.score_tile(table, "sdss_lco", equinox="J2022.0"))
            continue
        for name, model in models.items():
            line(f"design {design}", name, rs.score_tile(table, model, equinox="J2022.0"))
    field = QTable.read(FOLDER / "sdssv_robostrategy_field_a.ecsv")
    for name, model in models.items():
        line("field a", name, rs.score_tile(field, model))
    for file in (
        "sdssv_apo_2024/confSummary-test",
        "sdssv_apo_2021/confSummary-998",
        "sdssv_apo_2021/confSummaryF-998",
    ):
        plan = rs.plans.read_plan(FOLDER / f"{file}.par.gz")
        for name, model in models.items():
            line(file.split("/")[1], name, rs.score_tile(plan, model))


def arm_models(models):
    """Print the collisions of the configuration of 2024 by arm model, for the robots that have joint angles."""
    plan = rs.plans.read_plan(FOLDER / "sdssv_apo_2024/confSummary-test.par.gz")
    plan = plan[plan["assigned"] & np.isfinite(plan["theta"])]
    print(f"\n{'arm model':<16}{'instrument':<16}{'pairs':>8}{'obstacles':>11}  smallest clearance of a pair (mm)")
    for shape in ("capsule", "elbow_to_tip", "fiber_tip"):
        for name, model in models.items():
            plane = model.focal_plane
            own = {} if shape == "capsule" else {"arm_length": None, "arm_angle": None}
            robot = replace(plane.positioner, arm_model=shape, **own)
            tile = rs.score_tile(plan, replace(model, focal_plane=replace(plane, positioner=robot)))
            s = tile.summary
            clearance = np.nanmin(tile["clearance"].value)
            print(f"{shape:<16}{name:<16}{s['n_colliding_pairs']:>8}{s['n_obstacle_collisions']:>11}  {clearance:.3f}")


def positions(models):
    """Print the distances between the fibers of the configurations and those computed from their joint angles."""
    print(f"\n{'configuration':<28}{'rows':>6}{'compared':>10}{'median (mm)':>14}{'largest (mm)':>14}")
    for folder, file in (
        ("sdssv_apo_2024", "confSummary-test"),
        ("sdssv_apo_2021", "confSummary-998"),
        ("sdssv_apo_2021", "confSummaryF-998"),
    ):
        plan = rs.plans.read_plan(FOLDER / folder / f"{file}.par.gz")
        plane, apart = models[folder].focal_plane, []
        for name in ("BOSS", "APOGEE", "METROLOGY"):
            rows = plan[plan["fiber_type"] == name]
            order = {hole: k for k, hole in enumerate(rows["positioner"].tolist())}
            rows = rows[[order[hole] for hole in plane.id.tolist()]]
            xy = plane.forward(rows["theta"], rows["phi"], name).value
            apart.append(np.hypot(xy[:, 0] - rows["x"].value, xy[:, 1] - rows["y"].value))
        apart = np.concatenate(apart)
        good = apart[np.isfinite(apart)]
        print(f"{file:<28}{len(plan):>6}{len(good):>10}{np.median(good):>14.2g}{good.max():>14.2g}")


if __name__ == "__main__":
    models = instruments()
    plans(models)
    arm_models(models)
    positions(models)
