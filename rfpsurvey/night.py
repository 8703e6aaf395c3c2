"""When tiles can be observed, and the order in which they are observed in a night."""

from rfpsurvey._survey.night.limits import NightLimits
from rfpsurvey._survey.night.plan import Night, plan_night
from rfpsurvey._survey.night.settings import night_limits
from rfpsurvey._survey.night.windows import REASONS, Windows, observing_windows

__all__ = ["REASONS", "Night", "NightLimits", "Windows", "night_limits", "observing_windows", "plan_night"]
