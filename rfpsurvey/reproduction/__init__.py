"""The paper's own experiments, run again."""

from rfpsurvey.reproduction._reproduce import EXPERIMENTS, TABLES, reproduce

__all__ = ["EXPERIMENTS", "TABLES", "reproduce"]
