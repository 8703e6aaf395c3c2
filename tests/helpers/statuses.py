"""A table with the status of a survey of three nights, with invented numbers."""

from astropy.table import QTable


def status_table():
    """Return a table such as `rfpsurvey.survey.survey_status` returns."""
    names = ("n_targets", "n_complete", "n_requested", "n_observed", "n_failed", "n_left")
    names += ("n_planned", "n_not_assigned", "n_lost", "n_impossible")
    rows = [
        ("all", "all", 900, 380, 1200, 500, 20, 700, 450, 150, 60, 40),
        ("2", "all", 400, 250, 500, 300, 9, 200, 150, 30, 10, 10),
        ("1", "all", 500, 130, 700, 200, 11, 500, 300, 120, 50, 30),
        ("all", "galaxies", 600, 250, 800, 350, 12, 450, 300, 90, 40, 20),
        ("all", "stars", 300, 130, 400, 150, 8, 250, 150, 60, 20, 20),
    ]
    table = QTable(rows=rows, names=("priority", "category", *names))
    states = {"observed": 6, "partly observed": 1, "bad": 0, "dropped": 1, "planned": 4}
    table.meta = {
        "made_by": "survey_status",
        "instrument": "mine",
        "areas": [{"ra": "90 to 100", "dec": "20 to 30", "n_requested": 500, "n_observed": 200, "n_planned": 100}],
        "tiles": [{"pass": 1, **states}, {"pass": 2, **dict.fromkeys(states, 0), "planned": 12}],
        "progress": {
            "date": ["", "2026-01-03", "2026-01-04", "2026-01-17"],
            "n_tiles": [1, 3, 4, 6],
            "n_observed": {"all": [90, 250, 340, 500], "2": [60, 150, 200, 300], "1": [30, 100, 140, 200]},
        },
        "failures": [{"positioner": "17", "n_failed": 3, "reasons": "broken fiber"}],
        "generation": 1,
        "is_planned": True,
        "events": {"n_files": 4},
    }
    return table
