"""Finite Markov decision processes and policies: the data everything else is computed from."""

from oee_tabular.mdp.finite_mdp import FiniteMDP
from oee_tabular.mdp.policies import check_policy, mix, uniform_policy
from oee_tabular.mdp.rows import displacements

__all__ = ["FiniteMDP", "check_policy", "displacements", "mix", "uniform_policy"]
