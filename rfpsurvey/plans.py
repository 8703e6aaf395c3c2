"""Read and write plans of other programs, in the file formats of observatories."""

from rfpsurvey._field.plan_files import as_plan, is_plan, read_plan, recognize_plan, write_plan

__all__ = ["as_plan", "is_plan", "read_plan", "recognize_plan", "write_plan"]
