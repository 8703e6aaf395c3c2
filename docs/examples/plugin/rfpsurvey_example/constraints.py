"""A constraint for rfpsurvey: no fiber may be close to a bright star of the catalog."""

from dataclasses import dataclass

import numpy as np

import rfpsurvey as rs


@dataclass(frozen=True)
class AwayFromBright(rs.constraints.Constraint):
    """Exclude targets that are close to a star whose column ``mag`` is smaller than a limit."""

    limit: float
    radius_deg: float

    name = "away_from_bright"

    @property
    def margin_rad(self):
        """Angle up to which stars outside of the field matter."""
        return np.deg2rad(self.radius_deg)

    def excluded(self, field):
        """Return which targets must not be observed."""
        bright = field.column("mag") < self.limit
        return field.is_near(field.vectors[bright], self.margin_rad) & ~bright
