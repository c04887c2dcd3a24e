"""Bench of estimators, and the experiments of the paper and more.

The experiments are on numbered states and on the paper's robots. The core never imports
this room. An ``Experiment`` (``experiment``) is a function from a cell of its settings
to rows; tables, pages and figures are made of the rows. One runner (``run``) computes
cells, here or on a cluster, and keeps them in a folder.
"""

__all__ = ["bench", "experiments"]
