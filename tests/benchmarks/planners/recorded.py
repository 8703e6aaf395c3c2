"""The plan of the survey's own planner, for scenes of fields that were published with their plans.

The plan of ``field_a`` is that of the file, which robostrategy made with the positioners as built. The judge places the
nominal positioners of the scene. The time is not known.
"""

from astropy.table import Table


def plan(scene, seconds: float) -> tuple[Table, float, dict]:
    """Return the recorded plan of a scene."""
    if "recorded" not in scene.settings:
        raise NotImplementedError("the scene contains no recorded plan")
    return Table(rows=scene.settings["recorded"], names=("positioner", "target")), float("nan"), {}


VERSION = ""
PLANS = {"recorded": plan}
"""Label and function of each setting."""
