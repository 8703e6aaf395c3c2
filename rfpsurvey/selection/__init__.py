"""Selection probabilities of targets from many realizations of a survey, and potential assignments of random points."""

from rfpsurvey.selection._potential import PotentialAssignments, potential_assignments
from rfpsurvey.selection._probabilities import SelectionProbabilities, selection_facts
from rfpsurvey.selection._select import select_survey, selection_probabilities

__all__ = [
    "PotentialAssignments",
    "SelectionProbabilities",
    "potential_assignments",
    "select_survey",
    "selection_facts",
    "selection_probabilities",
]
