"""Reproduction of the experiments of Chen et al. (2024)."""

from reproduction._reproduce import EXPERIMENTS, reproduce

__all__ = ["EXPERIMENTS", "reproduce"]
