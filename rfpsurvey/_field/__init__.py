"""The plan of one field: targets, constraints, plan, summary, tables, and plans of other programs."""
