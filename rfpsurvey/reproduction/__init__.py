"""The paper's own experiments, run again."""

from rfpsurvey.reproduction._reproduce import EXPERIMENTS, reproduce

__all__ = ["EXPERIMENTS", "reproduce"]
