"""A finite MDP (S, A, P, r, mu_0, gamma), the model of the paper's eq. 3.4, on sparse
rows s*A + a.
"""

from __future__ import annotations

import os
from functools import cached_property, partial
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from oee_tabular import _checks, _files, _printing
from oee_tabular._checks import freeze
from oee_tabular._sparse import align, align_to, row_of_entry
from oee_tabular.mdp.arrays import (
    CsrArrays,
    check_layout,
    check_rewards,
    check_terminal_state,
    check_transitions,
    name_transition,
)
from oee_tabular.mdp.empirical import Sampling, env_arguments, log_arguments
from oee_tabular.mdp.files import constructor_arguments, file_arrays
from oee_tabular.mdp.gymnasium_table import read_table
from oee_tabular.mdp.naming import (
    Name,
    Names,
    check_names,
    coordinates,
    initial_distribution,
)
from oee_tabular.mdp.support import add_action_noise, add_support
from oee_tabular.typing import Array, BoolArray, IntArray

KIND = "finite_mdp"


class FiniteMDP:
    """A finite Markov decision process, checked when it is made and immutable
    afterwards.

    Parameters
    ----------
    transitions : (S, A, S) array, or sparse of shape (S*A, S)
        P(s' | s, a), in row ``s*A + a`` of the sparse form; nonnegative, rows sum to 1
        (tolerance 1e-8; those of a dense single-precision array are scaled). A terminal
        state leads to itself with reward 0.
    rewards : (S,), (S, A) or (S, A, S) array, or sparse of shape (S*A, S)
        r(s), r(s, a) or r(s, a, s'), finite. In a dense r(s, a, s') a nan outside the
        support of P means "undefined". In a sparse one an absent entry is 0 on the
        support and undefined elsewhere.
    initial : (S,) array
        Distribution mu_0 of the first state; or one state, by number or name, or a
        mapping state -> probability.
    discount : float in [0, 1]
        gamma. At 1 an infinite horizon is defined only for policies that are absorbed
        in states without reward.
    terminal_state : (S0,) integers, optional
        terminal_state[s] is the state that a transition which *terminates* on entering
        s goes to, for s < S0, the number of the environment's own states. By default s
        itself.
    layout : (S,) or (S, c) array, or a grid's shape (height, width), optional
        Finite coordinates of the states, for displacements (``mdp.displacements``) and
        maps ((row, column) if c = 2). With a shape, whose product is S, state s lies in
        row s // width. None: the coordinates in ``state_names`` if all are tuples of
        numbers of one length, (3, 4); else none.
    sampling : Sampling, optional
        The sample sizes of an MDP made of samples; ``from_log`` and ``from_env`` give
        it, and intervals widen by it.
    state_names, action_names : S, A texts or tuples of texts and numbers, optional
        Distinct names of the states and the actions; none reads as a number. Logs and
        policies may use them.

    Attributes
    ----------
    n_states, n_actions : int
    transitions : csr_array of shape (S*A, S), without explicit zeros
    rewards : (S, A) expected reward
    transition_rewards : csr_array of shape (S*A, S), an entry wherever r(s, a, s') is
        defined, or None
    initial, discount, terminal_state, layout ((S, c) or None), state_names,
        action_names (tuples or None), sampling (or None)
    csr : the arrays of ``transitions`` (indptr, indices, data, shape); scipy's matrix
        is made when it is first asked for
    reward_data : r(s, a, s') on the entries of ``transitions`` (aligned with
        ``transitions.data``), None for r(s, a)
    names : both, for sentences (``mdp.naming``)

    Raises
    ------
    ValueError
        With the argument, the place, the rule and the value.

    Examples
    --------
    >>> import numpy as np
    >>> P = np.array([[[0.9, 0.1], [0.2, 0.8]], [[0.0, 1.0], [0.0, 1.0]]])
    >>> mdp = FiniteMDP(P, np.array([1.0, 0.0]), np.array([1.0, 0.0]), 0.9)
    >>> mdp
    FiniteMDP(2 states, 2 actions, 6 transitions, rewards r(s, a), discount 0.9)
    """

    n_states: int
    n_actions: int
    csr: CsrArrays
    rewards: Array
    reward_data: Array | None
    initial: Array
    discount: float
    terminal_state: IntArray
    layout: Array | None
    state_names: tuple[Name, ...] | None
    action_names: tuple[Name, ...] | None
    sampling: Sampling | None
    # csr, or dense (S, A, S) with nan where r(s, a, s') is undefined
    _reward_table: Any
    _own_layout: Array | None  # as given, without the names' coordinates

    def __init__(
        self,
        transitions: object,
        rewards: object,
        initial: object,
        discount: float,
        *,
        terminal_state: object = None,
        layout: ArrayLike | None = None,
        state_names: object = None,
        action_names: object = None,
        sampling: Sampling | None = None,
    ) -> None:
        csr, n_states, n_actions = check_transitions(transitions)
        expected, data, table = check_rewards(rewards, csr, n_actions)
        names = (
            None
            if state_names is None
            else check_names(state_names, "state_names", n_states)
        )
        start = initial_distribution(initial, names, n_states)
        own = None if layout is None else check_layout(layout, n_states)
        terminal = (
            np.arange(n_states)
            if terminal_state is None
            else check_terminal_state(terminal_state, n_states)
        )
        vars(self).update(
            n_states=n_states,
            n_actions=n_actions,
            csr=csr,
            rewards=expected,
            reward_data=data,
            initial=freeze(_checks.distribution(start, "initial", (n_states,))),
            discount=_checks.number_in(discount, "discount", 0.0, 1.0),
            terminal_state=freeze(terminal),
            layout=coordinates(names) if own is None else own,
            state_names=names,
            action_names=(
                None
                if action_names is None
                else check_names(action_names, "action_names", n_actions)
            ),
            sampling=sampling,
            _reward_table=table,
            _own_layout=own,
        )

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(
            f"FiniteMDP is immutable; cannot set {name!r} (make a new one)"
        )

    def __delattr__(self, name: str) -> None:
        raise AttributeError(f"FiniteMDP is immutable; cannot delete {name!r}")

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(type(self), **self._arguments()), ()

    def __repr__(self) -> str:
        sizes = (
            f"{self.n_states} states, {self.n_actions} actions, {self.csr.nnz}"
            " transitions"
        )
        return (
            f"FiniteMDP({sizes}, rewards {self._reward_form}, discount"
            f" {self.discount:g})"
        )

    def _repr_html_(self) -> str:
        values = self.rewards if self.reward_data is None else self.reward_data
        rows = [
            ("states", self.n_states),
            ("actions", self.n_actions),
            ("transitions", self.csr.nnz),
            (
                "rewards",
                (
                    f"{self._reward_form}, {values.min() + 0.0:.4g} to"
                    f" {values.max() + 0.0:.4g}"
                ),
            ),
            ("discount", f"{self.discount:g}"),
            ("first states", int((self.initial > 0).sum())),
            ("terminal states", int(self.absorbing().sum())),
        ]
        return _printing.facts("FiniteMDP: rewards in units of the return", rows)

    @property
    def _reward_form(self) -> str:
        return "r(s, a)" if self.reward_data is None else "r(s, a, s')"

    @cached_property
    def transitions(self) -> sparse.csr_array:
        """P(s' | s, a): csr of shape (S*A, S), sorted, without explicit zeros,
        read-only.
        """
        return self.csr.to_matrix()

    @cached_property
    def transition_rewards(self) -> sparse.csr_array | None:
        """r(s, a, s') as csr of shape (S*A, S), an entry wherever it is defined; None
        for r(s, a).
        """
        if not isinstance(self._reward_table, np.ndarray):
            return self._reward_table
        rows = self._reward_table.reshape(self.csr.shape)
        return align_to(
            CsrArrays.from_dense(rows, ~np.isnan(rows)).to_matrix(), self.csr
        )[0]

    @property
    def names(self) -> Names:
        """The names of states and actions for sentences, which use numbers where there
        are none.
        """
        return Names(self.state_names, self.action_names)

    def absorbing(self) -> BoolArray:
        """(S,) mask of the terminal states: closed, with reward 0."""
        return np.asarray(self.closed() & (self.rewards == 0.0).all(axis=1))

    def closed(self) -> BoolArray:
        """(S,) mask of the states that every action leads back to."""
        state = row_of_entry(self.csr) // self.n_actions
        leaves = np.zeros(self.n_states, dtype=np.bool_)
        leaves[state[self.csr.indices != state]] = True
        return ~leaves

    def with_transitions(self, new: object) -> Self:
        """The same MDP under other dynamics (eq. 3.4); r(s, a, s') is averaged again.

        Raises ValueError where ``new`` has a transition for which r(s, a, s') is not
        defined.
        """
        try:
            csr, *sizes = check_transitions(new)
        except ValueError as error:
            raise ValueError(f"new {error}") from None
        if tuple(sizes) != self.rewards.shape:
            own = "{} states and {} actions".format(*self.rewards.shape)
            raise ValueError(
                f"new transitions must be for {own}; they are for {sizes[0]} and"
                f" {sizes[1]}"
            )
        if self.reward_data is not None:
            undefined = np.flatnonzero(~align(self.transition_rewards, csr)[1])
            if undefined.size:
                first = "; ".join(
                    name_transition(csr, k, self.n_actions, self.names)
                    for k in undefined[:3]
                )
                rule = "new transitions must stay where r(s, a, s') is defined"
                raise ValueError(
                    f"{rule}; {undefined.size} transitions do not, the first: {first}"
                )
        return self._replace(transitions=csr, sampling=None)

    def with_rewards(self, rewards: object) -> Self:
        """The same dynamics with other rewards, in any of the constructor's forms."""
        return self._replace(
            rewards=rewards,
            sampling=self.sampling and self.sampling._replace(reward_error=None),
        )

    def with_discount(self, discount: float) -> Self:
        """The same MDP with another discount."""
        return self._replace(discount=discount)

    def with_initial(self, initial: object) -> Self:
        """The same MDP with another first state, or another distribution of it, in any
        of the constructor's forms.
        """
        return self._replace(
            initial=initial,
            sampling=self.sampling and self.sampling._replace(starts=np.inf),
        )

    def with_layout(self, layout: ArrayLike | None) -> Self:
        """The same MDP with other coordinates of its states; None: those in its names,
        or none.
        """
        return self._replace(layout=layout)

    def with_names(
        self, state_names: object = None, action_names: object = None
    ) -> Self:
        """The same MDP with these names of its states and of its actions; None: with
        none.
        """
        return self._replace(state_names=state_names, action_names=action_names)

    def with_action_noise(self, epsilon: float) -> Self:
        """With probability epsilon the action is replaced by a uniform one (which may
        be the same).

        P_eps(. | s, a) = (1 - eps) P(. | s, a) + eps mean_b P(. | s, b), and the
        rewards are those of the action that was carried out: r_eps(s, a, s') = E[r(s,
        b, s') | s, a, s'], or r_eps(s, a) = E[r(s, b) | s, a] where rewards do not
        depend on s'. It gives a too deterministic simulator the support that a ratio
        needs.
        A state's value under (P_eps, policy) is its value under (P, (1 - eps) policy +
        eps uniform).
        """
        return self._replace(**add_action_noise(self, epsilon))

    def with_support_of(self, log: object, epsilon: float) -> Self:
        """The same MDP with the log's impossible transitions made possible: P' = (1 -
        eps) P + eps U in their pairs.

        U is uniform over the log's transitions from (s, a) that P gives probability 0;
        other pairs stay as they are. A new transition has the log's mean reward for it,
        or r(s, a) if the log has none.

        Parameters
        ----------
        log : Transitions, or counts of shape (S*A, S)
        epsilon : in (0, 1)

        Examples
        --------
        >>> import oee_tabular as oee
        >>> line = oee.FiniteMDP([[[0.5, 0.5, 0]], [[0, 0, 1]], [[0, 0, 1]]], [1, 1, 0], 0, 0.9)
        >>> line.with_support_of(oee.Transitions([0, 1], [0, 0], [2, 2]), 0.1).transitions.toarray().tolist()
        [[0.45, 0.45, 0.1], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]
        """
        return self._replace(**add_support(self, log, epsilon))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an npz of plain arrays; a failed save leaves no file."""
        _files.save_npz(path, KIND, self.arrays())

    def arrays(self) -> dict[str, Any]:
        """The arrays of a file."""
        return file_arrays(self, self._own_layout)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read what ``save`` wrote; the same checks as in the constructor."""
        hint = (
            "make one with FiniteMDP(transitions, rewards, initial,"
            " discount).save(path)"
        )
        stored = _files.load_npz(path, KIND, hint=hint)
        with _files.parts_of(path, "a FiniteMDP"):
            return cls(**constructor_arguments(stored))

    @classmethod
    def from_gymnasium(cls, env: object, discount: float = 0.99) -> Self:
        """The MDP of a Gymnasium environment with a toy-text table ``env.unwrapped.P``
        (FrozenLake, CliffWalking, Taxi).

        State numbers stay Gymnasium's. A state that is only entered by termination
        becomes terminal itself; otherwise a terminal twin is appended, and
        ``terminal_state[s]`` says where a terminated transition into s leads. Outcomes
        of one (s, a) that enter the same s' are merged: r(s, a, s') is their mean. Time
        limits are not part of the table: they are the ``horizon`` of an evaluation. Of
        an environment on a map (``desc`` or ``shape``, a cell for each state)
        ``layout`` has row and column. Names are the environment's ``state_names``,
        ``action_names`` or ``get_action_meanings()``, else its module's (LEFT = 0).

        Raises
        ------
        ValueError
            Without such a table (Blackjack), or where the dynamics are not in it: a
            fickle Taxi passenger, a wrapper that changes actions, observations or
            rewards.
        """
        return cls(**read_table(env), discount=discount)

    @classmethod
    def from_log(
        cls,
        log: object,
        rewards: object = None,
        *,
        discount: float = 0.99,
        initial: object = None,
        n_states: int | None = None,
        n_actions: int | None = None,
        state_names: object = None,
        action_names: object = None,
        layout: object = None,
    ) -> Self:
        """The MDP of a log's frequencies, P(s' | s, a) = n(s, a, s') / n(s, a): a
        simulator from its own log.

        An action never recorded in a state gets the mean distribution of those recorded
        there, weighted by their counts; a state without recorded actions is absorbing
        with reward 0. A warning says how many such pairs there are. States in which
        transitions terminated are terminal, as in ``from_gymnasium``.

        Parameters
        ----------
        log : Transitions
        rewards : (S,), (S, A) or (S, A, S), S the log's own states; None: the log's
            mean for each transition
        initial : (S,), a state, or a mapping; None: how often episodes began in each
            state (without episodes: all states)
        n_states, n_actions : default one more than the largest of the log, or as many
            as there are names
        state_names, action_names : default the log's; given ones also order its numbers
        discount, layout : as in the constructor

        Raises
        ------
        ValueError
            No log; no rewards at all; a state or an action outside the given numbers or
            names; the constructor's errors.

        Examples
        --------
        >>> import oee_tabular as oee
        >>> log = oee.Transitions([0, 0, 1], [0, 0, 0], [0, 1, 1], [0.0, 1.0, 0.0], terminated=[0, 0, 1])
        >>> oee.FiniteMDP.from_log(log, discount=0.9).transitions.toarray().tolist()  # 2: where 1 -> 1 ended it
        [[0.5, 0.5, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]
        """
        sizes = (n_states, n_actions)
        names = (state_names, action_names)
        return cls(
            **log_arguments(log, rewards, initial, sizes, names, layout),
            discount=discount,
        )

    @classmethod
    def from_env(
        cls,
        env: Any,
        *,
        samples_per_pair: int,
        seed: Any = None,
        discount: float = 0.99,
        max_steps: int = 1_000_000,
    ) -> Self:
        """The MDP of the frequencies of a Gymnasium environment that can only be
        stepped.

        Episodes go to the nearest state-action pair with too few samples, by value
        iteration on the transitions so far (``mdp.empirical``), until every action of
        every state reached has been taken ``samples_per_pair`` times; an episode that
        cannot lead there is ended by ``env.reset``. Observations that are not Discrete
        (tuples, integer arrays, texts) become the states' names. States that no episode
        reached are absorbing with reward 0. ``sampling`` keeps the numbers of samples:
        intervals widen by it.

        Parameters
        ----------
        env : with discrete observations and Discrete actions; it is stepped and reset,
            not closed
        samples_per_pair : positive int
        seed : anything that ``numpy.random.default_rng`` takes; of the first
            ``env.reset`` and of the actions
        discount : gamma
        max_steps : positive int, the most steps; a warning gives the number of pairs
            with fewer samples, and names three

        Raises
        ------
        ValueError
            Continuous observations or actions; bad arguments.

        Examples
        --------
        >>> from oee_tabular.tasks import make_environment
        >>> lake = make_environment("FrozenLake-v1", is_slippery=False)
        >>> sampled = FiniteMDP.from_env(lake, samples_per_pair=1, seed=0)
        >>> bool(abs(sampled.transitions - FiniteMDP.from_gymnasium(lake).transitions).max() == 0)
        True
        """
        return cls(
            **env_arguments(env, samples_per_pair, seed, max_steps), discount=discount
        )

    def _arguments(self) -> dict[str, Any]:
        """The arguments of the constructor that make it."""
        same = (
            "initial",
            "discount",
            "terminal_state",
            "state_names",
            "action_names",
            "sampling",
        )
        return {
            "transitions": self.csr,
            "rewards": (
                self.rewards if self._reward_table is None else self._reward_table
            ),
            "layout": self._own_layout,
        } | {name: getattr(self, name) for name in same}

    def _replace(self, **changes: object) -> Self:
        """The same MDP with other arguments of the constructor."""
        return type(self)(**self._arguments() | changes)
