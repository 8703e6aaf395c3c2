"""Joint plans: all tiles of a survey are planned together."""

from rfpsurvey.survey._joint._options import JOINT, JointOptions, as_joint
from rfpsurvey.survey._joint._plan import plan_together

__all__ = ["JOINT", "JointOptions", "as_joint", "plan_together"]
