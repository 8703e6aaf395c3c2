"""Joint plans: all tiles of a survey are planned together."""

from rfpsurvey.survey._joint._options import JointOptions, as_joint, check_joint
from rfpsurvey.survey._joint._plan import plan_together

__all__ = ["JointOptions", "as_joint", "check_joint", "plan_together"]
