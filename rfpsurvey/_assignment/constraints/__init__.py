"""The built-in constraints, and the interface of constraints."""
