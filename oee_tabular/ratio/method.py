"""Methods for zeta from counts: objects with options, ``fit`` to a log, and the
``limit`` with infinite data.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._parallel import one_thread
from oee_tabular._sparse import csr_on_pattern, row_of_entry
from oee_tabular.data import Transitions
from oee_tabular.exact import Model, policy_value
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.horizons import horizon_length
from oee_tabular.mdp.policies import split_policies
from oee_tabular.mdp.rows import Rows
from oee_tabular.ratio.result import Influence, TransitionRatio
from oee_tabular.ratio.support import checked_counts, supported_counts
from oee_tabular.typing import Array, BoolArray, PolicyLike, Seed

SimulatorData = Transitions | str | None


# moves: a limit's stand-in for infinitely many, where a fit is asked for one
_MANY = 1e12


@dataclass(frozen=True, eq=False)
class RatioInput:
    """What there is to go by, checked: ``observed`` are the counts on the simulator's
    entries.
    """

    observed: Array
    simulator: FiniteMDP
    rows: Rows
    log: Transitions | None = None
    discount: float | None = None
    policies: tuple[Array, ...] = ()
    horizon: int | None = None
    simulator_data: SimulatorData = None
    behavior_policy: Array | None = None
    seed: Seed = None
    cache: dict[Any, Any] = field(default_factory=dict)

    @property
    def visited(self) -> Rows:
        """The rows that the log has, the same object for all fits that share a cache."""
        rows: Rows = self.get_or_compute(_visited)
        return rows

    def get_or_compute(self, make: Callable[..., Any]) -> Any:
        """``make(given)``, which looks at counts and simulator alone, for all fits that
        share a cache.
        """
        if make not in self.cache:
            self.cache[make] = make(self)
        return self.cache[make]

    def ratio(
        self,
        zeta: Array,
        method: str,
        gap: float,
        details: dict[str, Any],
        influence: Influence | None = None,
    ) -> TransitionRatio:
        """What a fit returns, from zeta on the simulator's entries."""
        matrix = self.simulator.transitions
        rows = self.rows
        counts = rows.sums(self.observed).reshape(
            self.simulator.n_states, self.simulator.n_actions
        )
        parts = _checks.freeze(zeta), matrix.indices, matrix.indptr
        return TransitionRatio(
            values=sparse.csr_array(parts, shape=matrix.shape),
            method=method,
            gap=gap,
            visited=counts > 0,
            row_sum_error=float(np.abs(rows.sums(zeta * matrix.data) - 1.0).max()),
            counts=counts,
            details=details,
            _influence=influence,
        )


def _visited(given: RatioInput) -> Rows:
    return given.rows.select(given.rows.sums(given.observed) > 0)


@dataclass(frozen=True, eq=False)
class Population:
    """A pair and the data that an estimator, or a method of ratios, would have
    infinitely many of.

    ``distribution`` (S, A) is how rows of the target are drawn, uniform where the
    caller gives none; ``support`` (S*A,) its support, or all rows.
    """

    simulator: FiniteMDP
    target: FiniteMDP
    policy: Array
    distribution: Array
    support: BoolArray
    behavior: Array | None
    horizon: int | None

    def counts(self) -> sparse.csr_array:
        """Expected counts of very many transitions, csr (S*A, S)."""
        matrix = self.target.transitions
        weight = (_MANY * self.distribution.reshape(-1))[row_of_entry(matrix)]
        return csr_on_pattern(matrix, weight * matrix.data)

    def model(self, fallback: sparse.csr_array) -> FiniteMDP:
        """The target's rows where the data have them, ``fallback``'s elsewhere, with
        the simulator's rewards.
        """
        keep, rest = (
            sparse.diags_array(mask.astype(np.float64), format="csr")
            for mask in (self.support, ~self.support)
        )
        rows = sparse.csr_array(keep @ self.target.transitions + rest @ fallback)
        return self.simulator.with_transitions(rows)

    def value(self, model: Model) -> float:
        """J of the policy in ``model``."""
        return policy_value(model, self.policy, horizon=self.horizon)


class Method:
    """A method for zeta from counts. Subclasses are frozen dataclasses whose fields are
    the options; they define ``_fit``.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = oee.tasks.gridworld(3, slip=0.3), oee.tasks.gridworld(3, slip=0.1)
    >>> log = oee.sample_episodes(target, oee.uniform_policy(target), 50, horizon=30, seed=0)
    >>> ways = [oee.ratio.Conditional(), oee.ratio.Quotient(normalized=False), oee.ratio.Joint()]
    >>> [way.fit(log, simulator, seed=0).method for way in ways]
    ['conditional', 'ratio_of_ratios', 'joint']
    """

    # of values_of, horizon, simulator_data and behavior_policy
    USES: ClassVar[frozenset[str]] = frozenset()

    @property
    def uses(self) -> frozenset[str]:
        """Which of ``USES`` matter with these options."""
        return self.USES

    @property
    def _name(self) -> str:
        """As errors and results call it."""
        return type(self).__name__.lower()

    def refuse_unused(self, **inputs: Any) -> None:
        """ValueError that names an input that is given and that ``fit`` would not look
        at.
        """
        for name, value in inputs.items():
            if value is not None and name not in self.uses:
                raise ValueError(
                    f"{name} {self._refusal(name)}; got {_checks.show(value)}"
                )

    def _refusal(self, name: str) -> str:
        """The rule that an input without a use breaks."""
        return f"must not be given with method {self._name!r}, which does not use it"

    def _refuse_words(self, ridge: object) -> None:
        """A ridge chosen on the data is the conditional program's alone."""
        if isinstance(ridge, str):
            raise ArgumentError(
                "ridge",
                f"must be a number or a function of n with method {self._name!r}; got"
                f" {_checks.show(ridge)}",
            )

    @one_thread
    def fit(
        self,
        log_or_counts: Transitions | sparse.csr_array,
        simulator: FiniteMDP,
        *,
        discount: float | None = None,
        values_of: object = None,
        horizon: int | None = None,
        simulator_data: SimulatorData = None,
        behavior_policy: PolicyLike | None = None,
        seed: Seed = None,
        cache: dict[Any, Any] | None = None,
    ) -> TransitionRatio:
        """zeta from a log of the target, or from counts, csr (S*A, S).

        The rest as in ``transition_ratio``; and ``cache``, a dict for fits to one log
        and simulator: what does not depend on the rest is computed once. What the
        method has no use for is not looked at.
        """
        _checks.instance(simulator, FiniteMDP, "simulator")
        log = None
        cache = {} if cache is None else cache
        if isinstance(log_or_counts, Transitions):
            log = log_or_counts.numbered(simulator)
            counts = log.counts(
                simulator.n_states, simulator.n_actions, discount=discount
            )
        elif not sparse.issparse(log_or_counts):
            raise ArgumentError(
                "log_or_counts",
                "must be Transitions or sparse counts; got"
                f" {type(log_or_counts).__name__}",
            )
        elif discount is not None:
            raise ArgumentError(
                "discount",
                "must be left out where counts are given: they have no timesteps",
            )
        else:
            counts = checked_counts(log_or_counts, simulator)
        if Rows not in cache:
            cache[Rows] = Rows.of(simulator)
        observed = supported_counts(counts, simulator)
        if not observed.sum() > 0:
            raise ArgumentError(
                "log_or_counts", "must have at least one transition; it has none"
            )
        given = RatioInput(
            observed,
            simulator,
            cache[Rows],
            log,
            discount,
            () if values_of is None else _policies(values_of, simulator),
            None if horizon is None else horizon_length(horizon, simulator),
            simulator_data,
            (
                None
                if behavior_policy is None
                else check_policy(behavior_policy, simulator, name="behavior_policy")
            ),
            seed,
            cache,
        )
        result = self._fit(given)
        if not result.finite:
            options = {
                option.name: getattr(self, option.name)
                for option in fields(self)  # type: ignore[arg-type]
            }
            numbers = [
                f"{name} {x:g}"
                for name, x in options.items()
                if isinstance(x, int | float)
            ]
            functions = [name for name, x in options.items() if callable(x)]
            raise ValueError(
                f"the options of method {self._name!r} must make a program that double"
                f" precision holds; they are {', '.join(numbers + functions)}"
            )
        return result

    def limit(self, population: Population) -> TransitionRatio | sparse.csr_array:
        """zeta as the number of transitions grows, recorded as ``population`` says;
        training is no part of it.
        """
        return self._exact().fit(
            population.counts(),
            population.simulator,
            values_of=population.policy,
            horizon=population.horizon,
            simulator_data="exact",
            behavior_policy=population.behavior,
        )

    def _exact(self) -> Method:
        """The same program with exact data of the simulator and without training."""
        return self

    def _fit(self, given: RatioInput) -> TransitionRatio:
        raise NotImplementedError


def _policies(values_of: Any, simulator: FiniteMDP) -> tuple[Array, ...]:
    """The policy or policies given, checked."""
    several = (
        split_policies(values_of, simulator)
        if isinstance(values_of, list | tuple)
        else None
    )
    named = (
        {f"values_of[{k}]": each for k, each in enumerate(several.values())}
        if several
        else {"values_of": values_of}
    )
    return tuple(
        check_policy(policy, simulator, name=name) for name, policy in named.items()
    )
