"""Selection probabilities of targets from many realizations of a survey, and potential assignments of random points."""

from rfpsurvey._survey.selection.potential import PotentialAssignments, potential_assignments
from rfpsurvey._survey.selection.probabilities import SelectionProbabilities
from rfpsurvey._survey.selection.random_catalog import random_catalog
from rfpsurvey._survey.selection.select import selection_probabilities

__all__ = [
    "PotentialAssignments",
    "SelectionProbabilities",
    "potential_assignments",
    "random_catalog",
    "selection_probabilities",
]
