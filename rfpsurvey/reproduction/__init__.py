"""Reproduction of the experiments of Chen et al. (2024)."""

from rfpsurvey.reproduction._reproduce import EXPERIMENTS, TABLES, reproduce

__all__ = ["EXPERIMENTS", "TABLES", "reproduce"]
