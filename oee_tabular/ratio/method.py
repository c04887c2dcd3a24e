"""What a way from counts to zeta is: an object with its options, ``fit`` to a log and its ``limit`` with infinite data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular._threads import one_thread
from oee_tabular.data import Transitions
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.horizons import optional_steps
from oee_tabular.ratio.population import Population
from oee_tabular.ratio.result import TransitionRatio
from oee_tabular.ratio.support import aligned_counts

SimulatorData = Transitions | str | None


@dataclass(frozen=True, eq=False)
class Given:
    """What there is to go by, checked: ``observed`` are the counts on the simulator's entries."""

    observed: Array
    simulator: FiniteMDP
    log: Transitions | None = None
    discount: float | None = None
    policies: tuple[Array, ...] = ()
    horizon: int | None = None
    simulator_data: SimulatorData = None
    behavior_policy: Array | None = None
    seed: Any = None


class Method:
    """A way from counts to zeta. Subclasses are frozen dataclasses whose fields are the options; they define ``_fit``.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = oee.tasks.gridworld(3, slip=0.3), oee.tasks.gridworld(3, slip=0.1)
    >>> log = oee.sample_episodes(target, oee.uniform_policy(target), 50, horizon=30, seed=0)
    >>> ways = [oee.ratio.Conditional(), oee.ratio.Quotient(normalized=False), oee.ratio.Joint()]
    >>> [way.fit(log, simulator, seed=0).method for way in ways]
    ['conditional', 'ratio_of_ratios', 'joint']
    """

    HEEDS: ClassVar[frozenset[str]] = frozenset()  # beside the log: values_of, horizon, simulator_data, behavior_policy

    @property
    def uses(self) -> frozenset[str]:
        """What ``fit`` heeds beside the log with these options."""
        return self.HEEDS

    @property
    def _name(self) -> str:
        """As errors and results call it."""
        return type(self).__name__

    @property
    def refuses(self) -> str:
        """What is said of the others."""
        return f"must not be given with method {self._name!r}, which does not use it"

    @one_thread
    def fit(
        self,
        log_or_counts: Transitions | sparse.csr_array,
        simulator: FiniteMDP,
        *,
        discount: float | None = None,
        values_of: Any = None,
        horizon: int | None = None,
        simulator_data: SimulatorData = None,
        behavior_policy: Any = None,
        seed: Any = None,
    ) -> TransitionRatio:
        """zeta from a log of the target, or from counts, csr (S*A, S); the rest is as in ``transition_ratio``.

        What the method has no use for is not looked at.
        """
        _checks.instance(simulator, FiniteMDP, "simulator")
        behavior = None
        if behavior_policy is not None:
            behavior = check_policy(behavior_policy, simulator, name="behavior_policy")
        given = Given(
            observed=_observed(log_or_counts, simulator, discount),
            simulator=simulator,
            log=log_or_counts if isinstance(log_or_counts, Transitions) else None,
            discount=discount,
            policies=_policies(values_of, simulator),
            horizon=optional_steps(horizon, simulator),
            simulator_data=simulator_data,
            behavior_policy=behavior,
            seed=seed,
        )
        return self._fit(given)

    def limit(self, population: Population) -> TransitionRatio | sparse.csr_array:
        """zeta as the number of moves grows, recorded as ``population`` says."""
        return self.fit(
            population.counts(),
            population.simulator,
            values_of=population.policy,
            horizon=population.horizon,
            simulator_data="exact",
            behavior_policy=population.behavior,
        )

    def _fit(self, given: Given) -> TransitionRatio:
        raise NotImplementedError


def _policies(values_of: Any, simulator: FiniteMDP) -> tuple[Array, ...]:
    """The policy or policies given, checked."""
    if values_of is None:
        return ()
    several = isinstance(values_of, list | tuple) and len(values_of) > 0 and np.ndim(values_of[0]) == 2
    given = list(values_of) if several else [values_of]
    names = [f"values_of[{k}]" for k in range(len(given))] if several else ["values_of"]
    return tuple(check_policy(policy, simulator, name=name) for policy, name in zip(given, names, strict=True))


def _observed(log_or_counts: Any, simulator: FiniteMDP, discount: float | None) -> Array:
    """Counts on the simulator's entries, weighted by discount^timestep where a discount is given."""
    if isinstance(log_or_counts, Transitions):
        counts = log_or_counts.counts(simulator.n_states, simulator.n_actions, discount=discount)
    elif sparse.issparse(log_or_counts):
        if discount is not None:
            raise ValueError("discount must be left out where counts are given: they have no timesteps")
        counts = log_or_counts
    else:
        raise ValueError(f"log_or_counts must be Transitions or sparse counts; got {type(log_or_counts).__name__}")
    observed = aligned_counts(counts, simulator)
    if not observed.sum() > 0:
        raise ValueError("log_or_counts must have at least one move; it has none")
    return observed
