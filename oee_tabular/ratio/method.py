"""Methods that estimate zeta: objects with options, a ``fit`` to data and a ``limit``.

``fit`` takes a log or counts; ``limit`` is what a fit converges to as the log grows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Literal, NoReturn, TypeAlias

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._parallel import one_thread
from oee_tabular._sparse import csr_on_pattern, row_of_entry
from oee_tabular.data import Transitions
from oee_tabular.exact import Model, policy_value
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import (
    FiniteMDP,
    Rows,
    check_policy,
    horizon_length,
    split_policies,
)
from oee_tabular.ratio.result import Influence, TransitionRatio
from oee_tabular.ratio.support import checked_counts, supported_counts
from oee_tabular.typing import Array, BoolArray, Csr, PolicyLike, Seed, SparseLike

SimulatorData: TypeAlias = Transitions | Literal["exact"] | None

# The number of transitions with which a fit stands for the limit of infinitely many.
_N_TRANSITIONS_OF_LIMIT = 1e12


@dataclass(frozen=True, eq=False)
class RatioInput:
    """The checked data and settings of a fit.

    Attributes
    ----------
    observed : ndarray of shape (entries,)
        Counts on the entries of the simulator's transitions.
    simulator : FiniteMDP
        The simulator.
    rows : Rows
        The simulator's rows, one for each state-action pair.
    log : Transitions or None
        The log, numbered as the simulator is; None where counts were given.
    discount : float or None
        Base of the transitions' weights discount^timestep.
    policies : tuple of ndarray of shape (S, A)
        The policies whose values matter.
    horizon : int or None
        The horizon of these values.
    simulator_data : Transitions, 'exact' or None
        Data of the simulator.
    behavior_policy : ndarray of shape (S, A) or None
        The behaviour policy of the simulator's data.
    seed : Seed
        The seed of sampling and training.
    cache : dict
        Results that fits to the same counts and simulator share.
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
        """Return the recorded rows, one object for all fits that share a cache."""
        rows: Rows = self.get_or_compute(_visited)
        return rows

    def get_or_compute(self, make: Callable[..., Any]) -> Any:
        """Return ``make(self)``, computed once for all fits that share a cache.

        ``make`` may look at the counts and the simulator alone.
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
        """Return the result of a fit from zeta on the simulator's entries."""
        matrix = self.simulator.transitions
        rows = self.rows
        counts = rows.sums(self.observed).reshape(
            self.simulator.n_states, self.simulator.n_actions
        )
        missed = np.abs(rows.sums(zeta * matrix.data) - 1.0)
        if not self.simulator.has_all_actions:
            missed = missed[self.simulator.available.reshape(-1)]
        parts = _checks.freeze(zeta), matrix.indices, matrix.indptr
        return TransitionRatio(
            values=sparse.csr_array(parts, shape=matrix.shape),
            method=method,
            gap=gap,
            visited=counts > 0,
            row_sum_error=float(missed.max()),
            counts=counts,
            details=details,
            _influence=influence,
        )


def _visited(given: RatioInput) -> Rows:
    """Return the rows of recorded state-action pairs."""
    return given.rows.select(given.rows.sums(given.observed) > 0)


@dataclass(frozen=True, eq=False)
class Population:
    """Two models and the distribution of the data of an infinitely long log.

    Attributes
    ----------
    simulator : FiniteMDP
        The simulator.
    target : FiniteMDP
        The model that the data come from.
    policy : ndarray of shape (S, A)
        The policy to be evaluated.
    distribution : ndarray of shape (S, A)
        Probability of each state-action pair in the data, uniform where the caller
        gives none.
    support : ndarray of shape (S*A,)
        Whether a pair has data.
    behavior : ndarray of shape (S, A) or None
        The behaviour policy of the data.
    horizon : int or None
        The horizon of the value.
    """

    simulator: FiniteMDP
    target: FiniteMDP
    policy: Array
    distribution: Array
    support: BoolArray
    behavior: Array | None
    horizon: int | None

    def counts(self) -> Csr:
        """Return the expected counts of very many transitions, csr (S*A, S)."""
        matrix = self.target.transitions
        weight = (_N_TRANSITIONS_OF_LIMIT * self.distribution.reshape(-1))[
            row_of_entry(matrix)
        ]
        return csr_on_pattern(matrix, weight * matrix.data)

    def model(self, fallback: Csr) -> FiniteMDP:
        """Return the target's rows where there are data, ``fallback``'s elsewhere.

        The rewards are the simulator's.
        """
        keep, rest = (
            sparse.diags_array(mask.astype(np.float64), format="csr")
            for mask in (self.support, ~self.support)
        )
        rows = sparse.csr_array(keep @ self.target.transitions + rest @ fallback)
        return self.simulator.with_transitions(rows)

    def value(self, model: Model) -> float:
        """Return the policy's value J in ``model``."""
        return policy_value(model, self.policy, horizon=self.horizon)


class Method:
    """A method that estimates zeta from a log or from counts.

    Subclasses are frozen dataclasses whose fields are the options; they define
    ``_fit``.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (
    ...     oee.tasks.gridworld(3, slip=0.3),
    ...     oee.tasks.gridworld(3, slip=0.1),
    ... )
    >>> log = oee.sample_episodes(
    ...     target, oee.uniform_policy(target), 50, horizon=30, seed=0
    ... )
    >>> ways = [
    ...     oee.ratio.Conditional(),
    ...     oee.ratio.Quotient(normalized=False),
    ...     oee.ratio.Joint(),
    ... ]
    >>> [way.fit(log, simulator, seed=0).method for way in ways]
    ['conditional', 'ratio_of_ratios', 'joint']
    """

    # Which of values_of, horizon, simulator_data and behavior_policy ``fit`` may use. An
    # estimator gives the log itself only to a method that uses simulator_data; others
    # get its counts, and ``RatioInput.log`` is None.
    USES: ClassVar[frozenset[str]] = frozenset()

    @property
    def uses(self) -> frozenset[str]:
        """Return the inputs of ``fit`` that matter with these options."""
        return self.USES

    @property
    def _name(self) -> str:
        """Return the method's name in errors and results."""
        return type(self).__name__.lower()

    def refuse_unused(self, **inputs: object) -> None:
        """Raise an error for an input that is given and that ``fit`` would not use.

        Parameters
        ----------
        **inputs : object
            ``values_of``, ``horizon``, ``simulator_data`` and ``behavior_policy`` of
            ``fit``; None means that one is not given.

        Raises
        ------
        ValueError
            If one is given that the method does not use; it is named.
        """
        for name, value in inputs.items():
            if value is not None and name not in self.uses:
                raise ArgumentError(
                    name, f"{self._refusal(name)}; got {_checks.show(value)}"
                )

    def _refusal(self, name: str) -> str:
        """Return the rule that an unused input breaks."""
        return f"must not be given with method {self._name!r}, which does not use it"

    def _refuse_words(self, ridge: object) -> None:
        """Raise an error for a ridge that is to be chosen on the data.

        Only the conditional program can choose it.
        """
        if isinstance(ridge, str):
            raise ArgumentError(
                "ridge",
                f"must be a number or a function of n with method {self._name!r}; got"
                f" {_checks.show(ridge)}",
            )

    @one_thread
    def fit(
        self,
        log_or_counts: Transitions | SparseLike,
        simulator: FiniteMDP,
        *,
        discount: float | None = None,
        values_of: PolicyLike | None = None,
        horizon: int | None = None,
        simulator_data: SimulatorData = None,
        behavior_policy: PolicyLike | None = None,
        seed: Seed = None,
        cache: dict[Any, Any] | None = None,
    ) -> TransitionRatio:
        """Estimate zeta from a log of the target or from its counts.

        Parameters
        ----------
        log_or_counts : Transitions or sparse array of shape (S*A, S)
            A log of the target, or the counts of its transitions, row s*A + a and
            column s'.
        simulator : FiniteMDP
            The model whose transition probabilities stand in the denominator.
        discount : float, optional
            Weight of each transition by discount^timestep. None weights all by 1.
        values_of : (S, A) policy, or list of policies, optional
            The policies whose values matter.
        horizon : int, optional
            Number of rewards in these values; None means the infinite discounted sum.
        simulator_data : Transitions, 'exact' or None, optional
            Data of the simulator, as in ``transition_ratio``.
        behavior_policy : (S, A) policy, optional
            Behaviour policy of the simulator's data, instead of the estimated one.
        seed : int, Generator or None, optional
            Seed of the simulator's data, if they are sampled, and of training.
        cache : dict, optional
            A dict for fits to the same log and simulator: what does not depend on the
            other arguments is computed once.

        Returns
        -------
        TransitionRatio
            The ratio on the simulator's transitions, with its certificate.

        Raises
        ------
        ValueError
            If a transition has simulator probability 0, if there are no transitions,
            or if the options make a program that double precision does not hold.

        See Also
        --------
        transition_ratio : The function that also refuses inputs without a use.

        Notes
        -----
        Inputs that the method does not use are ignored.
        """
        _checks.instance(simulator, FiniteMDP, "simulator")
        _checks.generator(seed)  # used by some methods, checked with all
        log = None
        cache = {} if cache is None else _checks.instance(cache, dict, "cache")
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
        policies: tuple[Array, ...] = ()
        if values_of is not None:
            policies = _policies(values_of, simulator)
        if horizon is not None:
            horizon = horizon_length(horizon, simulator)
        behavior = None
        if behavior_policy is not None:
            behavior = check_policy(behavior_policy, simulator, name="behavior_policy")
        given = RatioInput(
            observed=observed,
            simulator=simulator,
            rows=cache[Rows],
            log=log,
            discount=discount,
            policies=policies,
            horizon=horizon,
            simulator_data=simulator_data,
            behavior_policy=behavior,
            seed=seed,
            cache=cache,
        )
        result = self._fit(given)
        if not result.finite:
            self._refuse_options()
        return result

    def _refuse_options(self) -> NoReturn:
        """Raise an error that names the options that are numbers or functions."""
        options = {
            option.name: getattr(self, option.name)
            for option in fields(self)  # type: ignore[arg-type]
        }
        numbers = [
            f"{name} {x:g}" for name, x in options.items() if isinstance(x, int | float)
        ]
        functions = [name for name, x in options.items() if callable(x)]
        raise ValueError(
            f"the options of method {self._name!r} must make a program that double"
            f" precision holds; they are {', '.join(numbers + functions)}"
        )

    def limit(self, population: Population) -> TransitionRatio | Csr:
        """Return what the fit converges to as the number of transitions grows.

        Training and sampling of the simulator's data are no part of the limit.

        Parameters
        ----------
        population : Population
            The two models and the distribution of the data.

        Returns
        -------
        TransitionRatio or sparse array of shape (S*A, S)
            The limit of zeta.
        """
        return self._fit_limit(population)

    def _fit_limit(self, population: Population) -> TransitionRatio:
        """Fit the program with exact data to very many expected transitions."""
        return self._exact().fit(
            population.counts(),
            population.simulator,
            values_of=population.policy,
            horizon=population.horizon,
            simulator_data="exact",
            behavior_policy=population.behavior,
        )

    def _exact(self) -> Method:
        """Return this method with the simulator's exact data and without training."""
        return self

    def _fit(self, given: RatioInput) -> TransitionRatio:
        """Fit zeta to checked data."""
        raise NotImplementedError


def _policies(values_of: PolicyLike, simulator: FiniteMDP) -> tuple[Array, ...]:
    """Return the given policy or policies, checked, each of shape (S, A)."""
    several = None
    if isinstance(values_of, list | tuple):
        several = split_policies(values_of, simulator)
    named: dict[str, Any] = {"values_of": values_of}
    if several:
        named = {f"values_of[{k}]": each for k, each in enumerate(several.values())}
    return tuple(
        check_policy(policy, simulator, name=name) for name, policy in named.items()
    )
