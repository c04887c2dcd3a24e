"""Policies of continuous tasks that give commands, as probabilities of actions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular.continuous.log.numbering import interpolate_weights
from oee_tabular.continuous.task.base import (
    BadPolicy,
    ask_policy,
)
from oee_tabular.typing import Array


def as_probabilities(policy: Callable[[Array], Any], actions: Array) -> CommandPolicy:
    """Return a policy as one that gives probabilities (n, A).

    The policy may give, for states (n, d), probabilities (n, A); action numbers (n,),
    where the actions are numbers (A,); or commands (n, k), for k = 1 also (n,), where
    the actions are commands (A, k): integers are commands then. A command between those
    of a product grid is shared out among its neighbours so that its mean is kept;
    elsewhere the nearest of ``actions`` (A, k) is taken.

    Examples
    --------
    >>> brake = as_probabilities(
    ...     lambda states: -states, np.array([[-1.0], [0.0], [1.0]])
    ... )
    >>> brake(np.array([[0.25], [4.0]])).tolist()
    [[0.25, 0.75, 0.0], [1.0, 0.0, 0.0]]
    >>> # -0.5 becomes -1 or 0, and -4 is cut to -1: sqrt(0.5^2 / 2)
    >>> brake.rounding(np.array([[0.5], [4.0]]))
    (0.3535533905932738, 0.5)
    """
    _checks.function(policy, "policy")
    if isinstance(policy, CommandPolicy):
        if np.array_equal(policy.actions, actions):
            return policy
        policy = policy.policy  # of a task with other actions
    return CommandPolicy(policy, actions)


@dataclass(frozen=True, eq=False)
class CommandPolicy:
    """A policy of states as probabilities of ``actions``; made by ``as_probabilities``.

    Attributes
    ----------
    policy : function
        The policy as it was given.
    actions : ndarray of shape (A,) or (A, k)
        The task's actions.
    """

    policy: Callable[[Array], Any]
    actions: Array

    def __call__(self, states: Array) -> Array:
        """Return probabilities (n, A).

        What is neither probabilities, numbers nor commands is returned as it is.
        """
        return self._play(states)[0]

    def rounding(self, states: Array) -> tuple[float, float]:
        """Compute how far the actions are from the commands, and the share that is cut.

        The distance is a root mean square, from the commands as they are cut: to the
        range of the actions, where they lie beyond it.
        """
        weights, commands = self._play(states)
        if commands is None:
            return 0.0, 0.0
        actions = self.actions
        inside = np.clip(commands, actions.min(axis=0), actions.max(axis=0))
        # E|a - c|^2 = E|a|^2 + c (c - 2 E a), a the action and c the command, cut
        apart = (inside * (inside - 2.0 * weights @ actions)).sum(axis=1)
        squares = weights @ (actions**2).sum(axis=1) + apart
        distance = float(np.sqrt(max(0.0, squares.mean())))
        return distance, float((commands != inside).any(axis=1).mean())

    def gives_commands(self, states: Array) -> bool:
        """Return whether the policy gives commands, and no probabilities or numbers."""
        return self._play(states)[1] is not None

    def _play(self, states: Array) -> tuple[Array, Array | None]:
        """Return probabilities, and the commands (n, k) where the policy gave such."""
        found = np.asarray(ask_policy(self.policy, states))
        n = len(states)
        actions = self.actions
        if found.shape == (n, len(actions)):
            return found, None
        if actions.ndim == 1 and found.shape == (n,) and found.dtype.kind in "iu":
            bad = np.flatnonzero((found < 0) | (found >= len(actions)))
            if bad.size:
                raise BadPolicy(
                    f"policy(states)[{bad[0]}] must be in 0..{len(actions) - 1}; it is"
                    f" {found[bad[0]]}"
                )
            return np.eye(len(actions))[found], None
        commands = found[:, None] if found.ndim == 1 else found
        if actions.ndim == 1 or commands.shape != (n, actions.shape[1]):
            return found, None
        odd = np.flatnonzero(~np.isfinite(commands).all(axis=1))
        if odd.size:
            raise BadPolicy(
                f"policy(states)[{odd[0]}] must be finite; it is {found[odd[0]]}"
            )
        commands = commands.astype(np.float64)
        return interpolate_weights(commands, actions), commands
