"""Collision probabilities, designs of instruments, comparisons, and benchmarks."""
