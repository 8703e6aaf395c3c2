"""The pipeline that plans a field: project the targets, assign them, place the arms, and find the collisions.

Positions and angles in the pipeline are arrays without units, in mm and radians. `plan_tile` calls the pipeline once,
and `plan_survey` and `place_tiles` call it for each tile. The calculation of collision probabilities uses the first
steps of the pipeline.
"""

from rfpsurvey.pipeline._constraints import Applied, apply_constraints, early_violations, project_field
from rfpsurvey.pipeline._field import (
    BlankIds,
    FieldPlan,
    FieldReach,
    FieldTargets,
    field_radius_rad,
    find_all_collisions,
    find_reach,
    plan_field,
)
from rfpsurvey.pipeline._outcomes import OUTCOMES, Outcome, category_classes, outcome_codes, priority_classes
from rfpsurvey.pipeline._targets import (
    PLANNED_COLUMNS,
    CatalogTargets,
    FieldBuilder,
    FieldRows,
    SelectedRows,
    separation_rad,
)
