"""Plans of other programs: read and write the native files of observatories."""

from rfpsurvey.plans._plan import (
    as_plan,
    is_plan,
    native_format,
    plan_roles,
    read_plan,
    recognize_plan,
    write_plan,
)

__all__ = ["as_plan", "is_plan", "native_format", "plan_roles", "read_plan", "recognize_plan", "write_plan"]
