"""Read and write plans of other programs, in the file formats of observatories."""

from rfpsurvey.plans._plan import (
    as_plan,
    format_of,
    further_columns,
    is_plan,
    native_format,
    plan_roles,
    read_plan,
    recognize_plan,
    write_plan,
)

__all__ = ["as_plan", "is_plan", "read_plan", "recognize_plan", "write_plan"]
