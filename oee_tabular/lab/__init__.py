"""What measures and reproduces: the bench, the paper's experiments and more, the robots' studies.

The core never imports it. An ``Experiment`` (registry) is a function from a cell of its settings to rows; one runner (run)
computes cells, on this machine or on a cluster; one store (store) keeps them; table, page and figure are made of them
(output, panels).
"""

__all__ = ["bench", "experiments", "robots"]
