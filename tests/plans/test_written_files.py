"""Plans that a format cannot represent are refused, so that each file that is written can be read."""

import desi_files
import numpy as np
import pfs_files
import pytest
from astropy.table import vstack
from raising import refused

import rfpsurvey as rs
import sdssv_files
from rfpsurvey import plans


def fiberassign(path):
    desi_files.tile(path.with_suffix(".fits"), per_petal=2)
    return path.with_suffix(".fits")


def confsummary(path):
    pytest.importorskip("pydl", reason="pydl is not installed")
    return sdssv_files.configuration(path.with_suffix(".par"))


def pfsdesign(path):
    return pfs_files.write_design(path.with_suffix(".fits"))


REPEATED_FIBERS = [
    (fiberassign, "LOCATION must be unique, but 0 occurs more than once"),
    (confsummary, "each fiber must have one row, got several for R-1C13 APOGEE"),
    (pfsdesign, "fiberId must be unique, but 1955 occurs more than once"),
]


@pytest.mark.parametrize(("make", "message"), REPEATED_FIBERS)
def test_plans_with_repeated_fibers_are_not_written(tmp_path, make, message):
    """These plans were written to files that the readers refused."""
    plan = plans.read_plan(make(tmp_path / "plan"))
    twice = vstack([plan, plan[:1]], metadata_conflicts="silent")
    new = tmp_path / f"new{make(tmp_path / 'other').suffix}"
    refused(f"{new}: {message}", plans.write_plan, twice, new)
    assert not new.exists()


def test_a_configuration_without_some_fibers_of_a_robot_is_not_written(tmp_path):
    plan = plans.read_plan(confsummary(tmp_path / "plan"))
    with pytest.raises(rs.InputError, match="every holeId must occur in the same number of rows, got 2 to 3"):
        plans.write_plan(plan[1:], tmp_path / "new.par")


def test_a_plan_of_another_instrument_is_not_written_as_fiberassign(tmp_path):
    """The identifiers of a part of the cobras of PFS are also locations of DESI."""
    plan = plans.read_plan(pfsdesign(tmp_path / "plan"))
    plan = plan[plan["positioner"] > 0]
    assert np.asarray(plan["positioner"]).max() < 542
    with pytest.raises(rs.InputError, match="the instrument of a fiberassign file must be desi, got pfs"):
        plans.write_plan(plan, tmp_path / "new.fits", format="fiberassign")


def test_a_table_whose_name_contains_par_is_a_table(tmp_path):
    """The name decided that this table was a confSummary file."""
    path = tmp_path / "confSummary-7.par.ecsv"
    plans.write_plan(plans.read_plan(pfsdesign(tmp_path / "plan")), path)
    assert (plans.recognize_plan(path), len(plans.read_plan(path))) == ("table", 61)
