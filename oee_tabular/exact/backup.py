"""Bellman's backup: the values of pairs and of transitions from those of states.

    Q(s, a)        = r(s, a) + gamma sum_s' K(s' | s, a) V(s')
    Q(s, a, s')    = r(s, a, s') + gamma V(s')

Compiled loops that take a step of many at once have a loop of their own: ``finite`` for
a policy's kernel, ``planning`` for the best action, ``solvers.mixing`` for sweeps.
"""

from __future__ import annotations

import numpy as np

from oee_tabular.exact import _system
from oee_tabular.exact.reweighted import Model
from oee_tabular.exact.system import rows_of
from oee_tabular.typing import Array


def back_up_pairs(model: Model, values: Array) -> Array:
    """Compute r(s, a) + gamma sum_s' K(s' | s, a) V(s') of each pair, (S, A)."""
    following = np.empty(model.rewards.size)
    _system.multiply(*rows_of(model.csr), False, values, following)
    return np.asarray(
        model.rewards + model.discount * following.reshape(model.rewards.shape)
    )


def back_up_transitions(model: Model, values: Array) -> Array:
    """Compute r(s, a, s') + gamma V(s') of each transition that is stored, (nnz,).

    The reward is left out where it does not depend on s': it adds the same number to
    each transition of a pair, which neither a variance nor a gradient feels.
    """
    ahead = (model.discount * values)[model.csr.indices]
    if model.reward_data is not None:
        ahead += model.reward_data
    return np.asarray(ahead)
