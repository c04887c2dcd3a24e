"""The finite Markov decision process of the paper's eq. 3.4, (S, A, P, r, mu_0, gamma).

Its transitions are sparse rows s*A + a.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Mapping
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Self, TypeAlias

import numpy as np

from oee_tabular import _checks, _files, _printing
from oee_tabular._checks import freeze
from oee_tabular._keywords import suggest_keywords
from oee_tabular._sparse import align, align_to, row_of_entry
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp.arrays import (
    Available,
    CsrArrays,
    check_available,
    check_layout,
    check_rewards,
    check_terminal_state,
    check_transitions,
    name_transition,
)
from oee_tabular.mdp.empirical import Sampling, frequency_arguments, log_arguments
from oee_tabular.mdp.files import constructor_arguments, file_arrays
from oee_tabular.mdp.gymnasium_table import read_table
from oee_tabular.mdp.logs import LogLike
from oee_tabular.mdp.naming import (
    Name,
    Names,
    NamesLike,
    check_names,
    coordinates,
    initial_distribution,
)
from oee_tabular.mdp.support import add_action_noise, add_support
from oee_tabular.typing import (
    Array,
    BoolArray,
    Csr,
    IntArray,
    IntArrayLike,
    RealArrayLike,
    Seed,
    SparseLike,
)

if TYPE_CHECKING:
    from gymnasium import Env

    from oee_tabular.mdp.env import FiniteMDPEnv

UMB_SUFFIX = ".umb"  # PRISM's and Storm's format
KIND = "finite_mdp"

# a sparse matrix (S*A, S), or one (S, S) for each action
MatrixLike: TypeAlias = SparseLike | list[SparseLike] | tuple[SparseLike, ...]

# a distribution of states, one state by number or name, or a mapping from states to
# probabilities
InitialLike: TypeAlias = RealArrayLike | str | tuple[Any, ...] | Mapping[Any, float]


@suggest_keywords
class FiniteMDP:
    """Describe a finite Markov decision process (S, A, P, r, mu_0, gamma).

    S is the number of states and A the number of actions, both counted from 0. The
    arrays are checked when the object is made, and are read-only afterwards. A
    simulator, and a target if it is known, are given in this form.

    Parameters
    ----------
    transitions : array_like of shape (S, A, S), or sparse of shape (S*A, S)
        The probabilities P(s' | s, a), in row ``s*A + a`` of the sparse form; or a list
        of A sparse matrices of shape (S, S), one an action. They are nonnegative and
        each row sums to 1 (tolerance 1e-8; rows in single precision are scaled).
        Repeated entries of a sparse matrix add up. A terminal state leads to itself
        with reward 0.
    rewards : array_like of shape (S,), (S, A) or (S, A, S), or sparse of shape (S*A, S)
        The finite rewards r(s), r(s, a) or r(s, a, s'). In a dense r(s, a, s') a nan
        outside the support of P means "undefined". In a sparse one, or a list of A
        sparse matrices of shape (S, S), an absent entry is 0 on the support and
        undefined elsewhere. Repeated entries do not add up: equal ones count once,
        others are averaged by the probabilities in the same repeated places of
        ``transitions``. SciPy's ``csr_array((data, (row, column)))`` adds them before
        they come here; ``coo_array`` does not.
    initial : array_like of shape (S,), int, name, or mapping
        The distribution mu_0 of the first state; or one state, by number or name; or a
        mapping from states to probabilities.
    discount : float
        The discount gamma in [0, 1]. At 1 an infinite horizon is defined only for
        policies that are absorbed in states without reward.
    terminal_state : array_like of int of shape (S0,), optional
        Where terminated transitions lead. A transition that enters state s and
        terminates leads to ``terminal_state[s]``; None means s itself. S0 <= S is the
        number of the environment's own states, without the terminal twins that
        ``from_gymnasium`` and ``from_log`` append.
    layout : array_like of shape (S,) or (S, c), or tuple (height, width), optional
        Finite coordinates of the states, for displacements (``mdp.displacements``) and
        maps ((row, column) if c = 2). With a grid's shape, whose product is S, state s
        lies in row s // width. None means the coordinates in ``state_names`` if all
        names are tuples of numbers of one length, such as (3, 4), and otherwise no
        layout.
    state_names : sequence of S str or tuple, optional
        Distinct names of the states, texts or tuples of texts and numbers; none reads
        as a number. Logs and policies may use them.
    action_names : sequence of A str or tuple, optional
        Distinct names of the actions, by the same rules.
    sampling : Sampling, optional
        The numbers of samples that the probabilities and rewards were estimated from
        (``mdp.empirical.Sampling``). ``from_log`` and ``from_env`` set it, and
        intervals are wider for it. None means that the model is known exactly.
    available : array_like of bool of shape (S, A), optional
        Which actions can be taken in each state, at least one in each. Where one
        cannot, its row of ``transitions`` is empty (zeros) and its reward is ignored;
        a policy or a log that takes it is an error. None means all of them.

    Attributes
    ----------
    n_states : int
        The number S of states.
    n_actions : int
        The number A of actions.
    transitions : csr_array of shape (S*A, S)
        The probabilities P(s' | s, a), without explicit zeros. scipy's matrix is made
        when it is first asked for.
    csr : CsrArrays
        The arrays of ``transitions`` (indptr, indices, data, shape), which compiled
        loops read: the same memory, without scipy's matrix.
    rewards : ndarray of shape (S, A)
        The expected rewards r(s, a).
    transition_rewards : csr_array of shape (S*A, S), or None
        The rewards r(s, a, s'), with an entry wherever they are defined.
    reward_data : ndarray of shape (nnz,), or None
        The rewards r(s, a, s') on the nnz positive entries of ``transitions``, aligned
        with ``transitions.data``; None if rewards are r(s, a). Where
        ``transition_rewards`` has no other entries, it is the same memory.
    initial : ndarray of shape (S,)
        The distribution of the first state.
    discount : float
        The discount gamma.
    terminal_state : ndarray of int of shape (S0,)
        The state that a transition which terminates on entering s leads to.
    layout : ndarray of shape (S, c), or None
        The coordinates of the states.
    state_names : tuple of length S, or None
        The names of the states.
    action_names : tuple of length A, or None
        The names of the actions.
    sampling : Sampling, or None
        The sample sizes that the model rests on.
    available : ndarray of bool of shape (S, A)
        Which actions can be taken in each state.
    has_all_actions : bool
        Whether all actions can be taken in all states.

    Raises
    ------
    ValueError
        If an argument breaks its rule; the error names the argument, the place, the
        rule and the value.

    See Also
    --------
    oee_tabular.tasks : Ready-made models, such as ``gridworld``.

    Examples
    --------
    >>> import numpy as np
    >>> P = np.array([[[0.9, 0.1], [0.2, 0.8]], [[0.0, 1.0], [0.0, 1.0]]])
    >>> mdp = FiniteMDP(P, np.array([1.0, 0.0]), np.array([1.0, 0.0]), 0.9)
    >>> mdp
    FiniteMDP(2 states, 2 actions, 6 transitions, rewards r(s, a), discount 0.9)

    In state 1 only the second action can be taken:

    >>> P[1, 0] = 0.0
    >>> can = [[True, True], [False, True]]
    >>> FiniteMDP(P, [1.0, 0.0], [1.0, 0.0], 0.9, available=can).csr.nnz
    5
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
    has_all_actions: bool
    # csr, or dense (S, A, S) with nan where r(s, a, s') is undefined; None for r(s, a)
    _reward_table: Array | Csr | None
    _own_layout: Array | None  # as given, without the names' coordinates
    _available: BoolArray | None  # None where all actions can be taken

    def __init__(
        self,
        transitions: RealArrayLike | MatrixLike,
        rewards: RealArrayLike | MatrixLike,
        initial: InitialLike,
        discount: float,
        *,
        terminal_state: IntArrayLike | None = None,
        layout: RealArrayLike | None = None,
        state_names: NamesLike | None = None,
        action_names: NamesLike | None = None,
        sampling: Sampling | None = None,
        available: IntArrayLike | None = None,
    ) -> None:
        checked: Available | None = None
        mask: BoolArray | None = None
        if available is not None:
            checked = check_available(available, state_names, action_names)
            mask = None if checked.mask.all() else checked.mask
        csr, n_states, n_actions = check_transitions(transitions, checked)
        expected, data, table = check_rewards(
            rewards, csr, n_actions, transitions, mask
        )
        states = None
        if state_names is not None:
            states = check_names(state_names, "state_names", n_states)
        actions = None
        if action_names is not None:
            actions = check_names(action_names, "action_names", n_actions)
        start = initial_distribution(initial, states, n_states)
        own = None if layout is None else check_layout(layout, n_states)
        if sampling is not None:
            _checks.instance(sampling, Sampling, "sampling")
        terminal = np.arange(n_states)
        if terminal_state is not None:
            terminal = check_terminal_state(terminal_state, n_states)
        vars(self).update(
            n_states=n_states,
            n_actions=n_actions,
            csr=csr,
            rewards=expected,
            reward_data=data,
            initial=freeze(
                _checks.distribution(start, "initial", (n_states,), given=initial)
            ),
            discount=_checks.number_in(discount, "discount", 0.0, 1.0),
            terminal_state=freeze(terminal),
            layout=coordinates(states) if own is None else own,
            state_names=states,
            action_names=actions,
            sampling=sampling,
            _reward_table=table,
            _own_layout=own,
            has_all_actions=mask is None,
            _available=mask,
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
        pairs = "" if self.has_all_actions else f" ({self._available_pairs} pairs)"
        sizes = (
            f"{self.n_states} states, {self.n_actions} actions{pairs}, {self.csr.nnz}"
            " transitions"
        )
        return (
            f"FiniteMDP({sizes}, rewards {self._reward_form}, discount"
            f" {self.discount:g})"
        )

    def _repr_html_(self) -> str:
        """Return the summary as HTML, which notebooks show."""
        values = self.rewards if self.reward_data is None else self.reward_data
        if self._available is not None and self.reward_data is None:
            values = values[self._available]
        # adding 0.0 makes -0.0 plain
        span = f"{values.min() + 0.0:.4g} to {values.max() + 0.0:.4g}"
        rows = [
            ("states", self.n_states),
            ("actions", self.n_actions),
            ("transitions", self.csr.nnz),
            ("rewards", f"{self._reward_form}, {span}"),
            ("discount", f"{self.discount:g}"),
            ("first states", int((self.initial > 0).sum())),
            ("terminal states", int(self.absorbing().sum())),
        ]
        if not self.has_all_actions:
            rows.insert(2, ("available pairs", self._available_pairs))
        return _printing.facts("FiniteMDP: rewards in units of the return", rows)

    @property
    def _reward_form(self) -> str:
        """Return what the rewards depend on, "r(s, a)" or "r(s, a, s')"."""
        return "r(s, a)" if self.reward_data is None else "r(s, a, s')"

    @property
    def _available_pairs(self) -> str:
        """Return how many pairs can be taken, "5 of 6"."""
        return f"{np.count_nonzero(self.available)} of {self.rewards.size}"

    @cached_property
    def available(self) -> BoolArray:
        """Return which actions can be taken in each state, a read-only (S, A) array."""
        if self._available is not None:
            return self._available
        return np.broadcast_to(np.True_, self.rewards.shape)

    @cached_property
    def transitions(self) -> Csr:
        """Return P(s' | s, a) as a read-only csr of shape (S*A, S).

        Its indices are sorted, and it has no explicit zeros.
        """
        return self.csr.to_matrix()

    @cached_property
    def transition_rewards(self) -> Csr | None:
        """Return r(s, a, s') as csr of shape (S*A, S), or None if rewards are r(s, a).

        It has an entry wherever r(s, a, s') is defined.
        """
        if not isinstance(self._reward_table, np.ndarray):
            return self._reward_table
        rows = self._reward_table.reshape(self.csr.shape)
        defined = CsrArrays.from_dense(rows, ~np.isnan(rows)).to_matrix()
        return align_to(defined, self.csr)[0]

    @property
    def names(self) -> Names:
        """Return the names of states and actions for sentences.

        Where there are no names, the sentences use numbers.
        """
        return Names(self.state_names, self.action_names)

    def absorbing(self) -> BoolArray:
        """Find the terminal states: those that are closed and have reward 0.

        Returns
        -------
        ndarray of bool of shape (S,)
            True for terminal states.
        """
        return np.asarray(self.closed() & (self.rewards == 0.0).all(axis=1))

    def closed(self) -> BoolArray:
        """Find the states that every action leads back to.

        Returns
        -------
        ndarray of bool of shape (S,)
            True for closed states, P(s | s, a) = 1 for each a that can be taken.
        """
        state = row_of_entry(self.csr) // self.n_actions
        leaves = np.zeros(self.n_states, dtype=np.bool_)
        leaves[state[self.csr.indices != state]] = True
        return ~leaves

    def with_transitions(self, new: RealArrayLike | MatrixLike) -> Self:
        """Return the same MDP with other transition probabilities (eq. 3.4).

        Rewards r(s, a, s') are averaged again under the new probabilities.

        Parameters
        ----------
        new : array_like of shape (S, A, S), or sparse of shape (S*A, S)
            The new probabilities, in any of the constructor's forms; zeros where an
            action cannot be taken.

        Returns
        -------
        FiniteMDP
            The new MDP; its ``sampling`` is None.

        Raises
        ------
        ValueError
            If ``new`` is for other numbers of states or actions, or has a transition
            for which r(s, a, s') is not defined.
        """
        available = None
        if self._available is not None:
            available = Available(self._available, self.names)
        try:
            csr, n_states, n_actions = check_transitions(new, available)
        except ArgumentError as error:
            raise ArgumentError(f"new {error.argument}", error.rule) from None
        if (n_states, n_actions) != self.rewards.shape:
            raise ArgumentError(
                "new transitions",
                f"must be for {self.n_states} states and {self.n_actions} actions; they"
                f" are for {n_states} and {n_actions}",
            )
        defined = self.transition_rewards
        if defined is not None:
            undefined = np.flatnonzero(~align(defined, csr)[1])
            if undefined.size:
                first = "; ".join(
                    name_transition(csr, k, self.n_actions, self.names)
                    for k in undefined[:3]
                )
                raise ArgumentError(
                    "new transitions",
                    "must stay where r(s, a, s') is defined;"
                    f" {undefined.size} transitions do not, the first: {first}",
                )
        return self._replace(transitions=csr, sampling=None)

    def with_rewards(self, rewards: RealArrayLike | MatrixLike) -> Self:
        """Return the same MDP with other rewards.

        Parameters
        ----------
        rewards : array_like of shape (S,), (S, A) or (S, A, S), or sparse (S*A, S)
            The new rewards, in any of the constructor's forms.

        Returns
        -------
        FiniteMDP
            The new MDP; its rewards count as known exactly.
        """
        return self._replace(
            rewards=rewards,
            sampling=self.sampling and self.sampling._replace(reward_error=None),
        )

    def with_discount(self, discount: float) -> Self:
        """Return the same MDP with another discount.

        Parameters
        ----------
        discount : float
            The new discount in [0, 1].

        Returns
        -------
        FiniteMDP
            The new MDP.
        """
        return self._replace(discount=discount)

    def with_initial(self, initial: InitialLike) -> Self:
        """Return the same MDP with another distribution of the first state.

        Parameters
        ----------
        initial : array_like of shape (S,), int, name, or mapping
            The new distribution or first state, in any of the constructor's forms.

        Returns
        -------
        FiniteMDP
            The new MDP; its first states count as known exactly.
        """
        return self._replace(
            initial=initial,
            sampling=self.sampling and self.sampling._replace(starts=np.inf),
        )

    def with_layout(self, layout: RealArrayLike | None) -> Self:
        """Return the same MDP with other coordinates of its states.

        Parameters
        ----------
        layout : array_like of shape (S,) or (S, c), or tuple (height, width), or None
            The new coordinates, in any of the constructor's forms. None means those in
            the states' names, or none.

        Returns
        -------
        FiniteMDP
            The new MDP.
        """
        return self._replace(layout=layout)

    def with_names(
        self,
        state_names: NamesLike | None = None,
        action_names: NamesLike | None = None,
    ) -> Self:
        """Return the same MDP with other names of its states and actions.

        Parameters
        ----------
        state_names : sequence of S str or tuple, optional
            The new names of the states. None means that states have no names.
        action_names : sequence of A str or tuple, optional
            The new names of the actions. None means that actions have no names.

        Returns
        -------
        FiniteMDP
            The new MDP.
        """
        return self._replace(state_names=state_names, action_names=action_names)

    def with_action_noise(self, epsilon: float) -> Self:
        """Return the same MDP with actions replaced by uniform ones at random.

        It gives a too deterministic simulator the support that a ratio needs.

        Parameters
        ----------
        epsilon : float
            The probability in [0, 1] with which the action is replaced by a uniform
            one, which may be the same.

        Returns
        -------
        FiniteMDP
            The MDP with noisy actions.

        See Also
        --------
        with_support_of : Allow the transitions of a log, and no other new ones.

        Notes
        -----
        P_eps(. | s, a) = (1 - eps) P(. | s, a) + eps mean_b P(. | s, b), b among the
        actions that can be taken in s. The rewards are those of the action that was
        carried out: r_eps(s, a, s') = E[r(s, b, s') | s, a, s'], or
        r_eps(s, a) = E[r(s, b) | s, a] where rewards do not depend on s'. A state's
        value under (P_eps, policy) is its value under
        (P, (1 - eps) policy + eps uniform).
        """
        return self._replace(**add_action_noise(self, epsilon))

    def with_support_of(self, log: LogLike | SparseLike, epsilon: float) -> Self:
        """Return the same MDP with a log's impossible transitions made possible.

        Parameters
        ----------
        log : Transitions, or sparse counts of shape (S*A, S)
            The log whose transitions are to have positive probability.
        epsilon : float
            The probability in (0, 1) that such transitions get together in their
            state-action pair.

        Returns
        -------
        FiniteMDP
            The new MDP; itself if the log has no impossible transition.

        See Also
        --------
        with_action_noise : Mix the actions of each state instead.

        Notes
        -----
        Of a simulator made of samples (``from_env``, ``from_log``), epsilon is about 1 /
        (n + 1), n the samples of a pair: the probability of what so many samples
        usually lack. The error of ``Problem`` gives it.

        In pairs (s, a) that the log has impossible transitions of, P' = (1 - eps) P +
        eps U, where U is uniform over the log's transitions from (s, a) that P gives
        probability 0; other pairs stay as they are. A new transition has the log's mean
        reward for it, or r(s, a) if the log has none.

        Examples
        --------
        >>> import oee_tabular as oee
        >>> P = [[[0.5, 0.5, 0]], [[0, 0, 1]], [[0, 0, 1]]]
        >>> line = oee.FiniteMDP(P, [1, 1, 0], 0, 0.9)
        >>> log = oee.Transitions([0, 1], [0, 0], [2, 2])
        >>> line.with_support_of(log, 0.1).transitions.toarray().tolist()
        [[0.45, 0.45, 0.1], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]
        """
        return self._replace(**add_support(self, log, epsilon))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the MDP to an npz file, or to a .umb file, which model checkers read.

        Parameters
        ----------
        path : path_like
            The file; it appears whole or not at all. One whose name ends in .umb has
            the format of PRISM and Storm (extra ``umb``), any other that of npz.

        Raises
        ------
        ImportError
            If umbi is not installed, for a .umb file.

        See Also
        --------
        load : Read the file.

        Notes
        -----
        Model checkers know no discount. In a .umb file the total reward until the label
        ``end`` is the value J: after each transition the model ends with probability 1 -
        gamma. States keep their numbers; the file has others after them.
        """
        if _files.has_ending(_files.local(path), (UMB_SUFFIX,)):
            umb = importlib.import_module("oee_tabular.mdp.umb")
            umb.save_umb(self, path, self._own_layout)
            return
        _files.save_npz(path, KIND, self.arrays())

    @suggest_keywords
    def to_env(self, *, max_steps: int | None = None) -> FiniteMDPEnv:
        """Make a Gymnasium environment of the MDP, in which agents can be trained.

        Parameters
        ----------
        max_steps : int, optional
            The number of steps after which an episode is truncated. None means that only
            a terminal state ends it.

        Returns
        -------
        gymnasium.Env
            The environment.

        Raises
        ------
        ValueError
            If ``max_steps`` is no positive integer.

        See Also
        --------
        from_env : Estimate the MDP of an environment.
        from_gymnasium : Read the MDP of an environment's table.

        Notes
        -----
        Observations and actions are the numbers of states and actions. ``reset(seed=)``
        decides all that follows. ``info["action_mask"]`` says which actions the state
        has (1 or 0), as Gymnasium's Taxi does; ``action_space.sample()`` draws one of
        them, and a step with another one is an error. ``info["state_name"]`` and
        ``info["action_name"]`` are the names, where there are any. ``render()`` returns
        text: a map where the layout is a grid. Rewards are not discounted: give the
        agent ``mdp.discount``.

        Examples
        --------
        >>> import oee_tabular as oee
        >>> env = oee.tasks.gridworld(3, 0.1).to_env(max_steps=50)
        >>> state, info = env.reset(seed=0)
        >>> print(env.render())
        @..
        ...
        ..T
        """
        env = importlib.import_module("oee_tabular.mdp.env")
        made: FiniteMDPEnv = env.FiniteMDPEnv(self, max_steps=max_steps)
        return made

    def arrays(self) -> dict[str, Any]:
        """Return the arrays that a file of the MDP holds.

        Returns
        -------
        dict of str to ndarray
            The arrays by their names in the file.
        """
        return file_arrays(self, self._own_layout)

    @classmethod
    @suggest_keywords
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        reward: str | None = None,
        success: str | None = None,
        until: str | None = None,
    ) -> Self:
        """Read an MDP that ``save``, PRISM or Storm wrote, and check its arrays.

        Parameters
        ----------
        path : path_like
            The npz file, or a .umb file (extra ``umb``).
        reward : str, optional
            Of a .umb file by another program, the rewards to read. None means its only
            ones.
        success : str, optional
            Of such a file, a label in place of rewards: entering one of its states pays
            1. The value is then the probability of getting there.
        until : str, optional
            Of such a file, the label of the states where all is over; they become
            terminal. None means those of ``success``, or none.

        Returns
        -------
        FiniteMDP
            The MDP in the file.

        Raises
        ------
        ValueError
            If the file is no FiniteMDP, or is damaged; if a .umb file holds another kind
            of model (a POMDP, a game, continuous time, intervals, parameters), or has no
            such rewards or label.
        ImportError
            If umbi is not installed, for a .umb file.

        Notes
        -----
        Of a .umb file by another program the discount is 1 (``with_discount``). Rewards
        of states, choices and branches add up to r(s, a, s'). An action is a choice's
        action; where a state has several choices of one action, actions are the first,
        second, ... choice of each state. What a state lacks is not ``available``. Names
        of states are the values of their variables.
        """
        options = {"reward": reward, "success": success, "until": until}
        if _files.has_ending(_files.local(path), (UMB_SUFFIX,)):
            umb = importlib.import_module("oee_tabular.mdp.umb")
            arguments = umb.load_umb(path, **options)
            with _files.parts_of(path, "a FiniteMDP"):
                return cls(**arguments)
        for name, value in options.items():
            if value is not None:
                raise ArgumentError(
                    name,
                    f"must be left out for a file that does not end in {UMB_SUFFIX};"
                    f" got {_checks.show(value)}",
                )
        hint = (
            "make one with FiniteMDP(transitions, rewards, initial,"
            " discount).save(path)"
        )
        stored = _files.load_npz(path, KIND, hint=hint)
        with _files.parts_of(path, "a FiniteMDP"):
            return cls(**constructor_arguments(stored))

    @classmethod
    @suggest_keywords
    def from_gymnasium(
        cls, env: Env[Any, Any], discount: float = 0.99, *, masked: bool = False
    ) -> Self:
        """Read the MDP of a Gymnasium environment that has a table of its transitions.

        Such are the toy-text environments with ``env.unwrapped.P`` (FrozenLake,
        CliffWalking, Taxi).

        Parameters
        ----------
        env : gymnasium.Env
            The environment; it is not stepped.
        discount : float, default 0.99
            The discount gamma in [0, 1].
        masked : bool, default False
            Whether only the actions can be taken that ``env.unwrapped.action_mask``
            allows in each state. Otherwise all can that have outcomes in the table.

        Returns
        -------
        FiniteMDP
            The MDP of the table.

        Raises
        ------
        ValueError
            If there is no such table (Blackjack), if the dynamics are not in it (a
            fickle Taxi passenger, a wrapper that changes actions, observations or
            rewards), or if the table has a state without actions, an action without a
            state, probabilities that do not sum to 1, states outside it, or rewards
            that are no numbers: the error names the entry, ``env.P[3][1][0]``.

        See Also
        --------
        from_env : Sample an environment that can only be stepped.
        with_names : Give other names to states and actions.

        Notes
        -----
        State numbers stay Gymnasium's. A state that is only entered by termination
        becomes terminal itself; otherwise a terminal twin is appended, and
        ``terminal_state[s]`` says where a terminated transition into s leads. Outcomes
        of one (s, a) that enter the same s' are merged: r(s, a, s') is their mean. Time
        limits are not part of the table: they are the ``horizon`` of an evaluation. Of
        an environment on a map (``desc`` or ``shape``, a cell for each state)
        ``layout`` has row and column. Names are the environment's ``state_names``,
        ``action_names`` or ``get_action_meanings()``, else its module's (LEFT = 0).

        An action that is no key of ``P[s]``, or has no outcomes there, cannot be taken
        in s (``available``). All actions of a terminal state can.

        Examples
        --------
        Taxi's masks leave out what would change nothing, such as driving into a wall:

        >>> from oee_tabular.tasks import make_environment
        >>> taxi = FiniteMDP.from_gymnasium(make_environment("Taxi-v4"), masked=True)
        >>> taxi.available[0].tolist()  # south, north, east, west, pick up, drop off
        [True, False, True, False, True, False]
        """
        allow = _checks.boolean(masked, "masked")
        return cls(**read_table(env, masked=allow), discount=discount)

    @classmethod
    @suggest_keywords
    def from_log(
        cls,
        log: LogLike,
        rewards: RealArrayLike | MatrixLike | None = None,
        *,
        discount: float = 0.99,
        initial: InitialLike | None = None,
        n_states: int | None = None,
        n_actions: int | None = None,
        state_names: NamesLike | None = None,
        action_names: NamesLike | None = None,
        layout: RealArrayLike | None = None,
        available: IntArrayLike | None = None,
    ) -> Self:
        """Estimate the MDP of a log's frequencies: a simulator from its own log.

        Parameters
        ----------
        log : Transitions
            The log.
        rewards : array_like of shape (S,), (S, A) or (S, A, S), or sparse, optional
            The rewards, S the log's own states. None means the log's mean reward of
            each transition.
        discount : float, default 0.99
            The discount gamma in [0, 1].
        initial : array_like of shape (S,), int, name, or mapping, optional
            The distribution of the first state, as in the constructor. None means how
            often episodes began in each state (without episodes: the frequencies of all
            states, with a warning).
        n_states : int, optional
            The number of states. None means one more than the largest of the log, or as
            many as there are names.
        n_actions : int, optional
            The number of actions, with the same default.
        state_names : sequence of str or tuple, optional
            The names of the states, which also order their numbers. None means the
            log's.
        action_names : sequence of str or tuple, optional
            The names of the actions, which also order their numbers. None means the
            log's.
        layout : array_like of shape (S,) or (S, c), or tuple (height, width), optional
            The coordinates of the states, as in the constructor.
        available : array_like of bool of shape (S, A), optional
            Which actions can be taken in each state, S the log's own states. None means
            all of them.

        Returns
        -------
        FiniteMDP
            The MDP of the frequencies; its ``sampling`` has the numbers of samples.

        Raises
        ------
        ValueError
            If there is no log or no reward, if a state or an action is outside the
            given numbers or names, or if the constructor refuses an argument.

        See Also
        --------
        from_env : The same of an environment that is stepped.
        with_support_of : Allow another log's transitions that this log lacks.

        Notes
        -----
        P(s' | s, a) = n(s, a, s') / n(s, a). An action that can be taken in a state but
        was never recorded there gets the mean distribution of those recorded there,
        weighted by their counts; a state without recorded actions is absorbing with
        reward 0. A warning says how many such pairs there are. States in which
        transitions terminated are terminal, as in ``from_gymnasium``.

        Examples
        --------
        >>> import oee_tabular as oee
        >>> log = oee.Transitions(
        ...     [0, 0, 1], [0, 0, 0], [0, 1, 1], [0.0, 1.0, 0.0], terminated=[0, 0, 1]
        ... )
        >>> mdp = oee.FiniteMDP.from_log(log, discount=0.9, initial=0)
        >>> mdp.transitions.toarray().tolist()  # 2: where 1 -> 1 ended it
        [[0.5, 0.5, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]
        """
        sizes = (n_states, n_actions)
        names = (state_names, action_names)
        return cls(
            **log_arguments(log, rewards, initial, sizes, names, layout, available),
            discount=discount,
        )

    @classmethod
    @suggest_keywords
    def from_env(
        cls,
        env: Env[Any, Any],
        *,
        samples_per_pair: int,
        seed: Seed = None,
        discount: float = 0.99,
        max_steps: int = 1_000_000,
        state_names: NamesLike | None = None,
        action_names: NamesLike | None = None,
        masked: bool = True,
    ) -> Self:
        """Estimate the MDP of a Gymnasium environment that can only be stepped.

        Parameters
        ----------
        env : gymnasium.Env
            The environment, with discrete observations and Discrete actions. It is
            stepped and reset, not closed.
        samples_per_pair : int
            The number of samples wanted of each state-action pair.
        seed : int, Generator or None, default None
            Anything that ``numpy.random.default_rng`` takes, for the first
            ``env.reset`` and for the actions.
        discount : float, default 0.99
            The discount gamma in [0, 1].
        max_steps : int, default 1_000_000
            The largest number of steps. If it does not suffice, a warning gives the
            number of pairs with fewer samples, and names three.
        state_names : sequence of str or tuple, optional
            The names of the environment's states. Where observations are numbers, one
            for each number; where they are texts, tuples or arrays, these themselves in
            the order of the states' numbers. None means no names, or those that were
            observed.
        action_names : sequence of A str or tuple, optional
            The names of the actions.
        masked : bool, default True
            Whether only the actions are taken that ``info["action_mask"]`` allows,
            where reset and step give one; others cannot be taken (``available``).

        Returns
        -------
        FiniteMDP
            The MDP of the frequencies; its ``sampling`` has the numbers of samples, by
            which intervals widen.

        Raises
        ------
        ValueError
            If observations or actions are continuous, if an argument breaks its rule,
            or if the environment raises an error or returns what is no step (old Gym's
            four values, a reward that is no number, an observation outside its space, a
            mask that allows no action or is not always the same in a state): the error
            names the action, the state and what was returned.

        See Also
        --------
        from_gymnasium : Read the table of a toy-text environment.
        from_log : Estimate the same from a log.
        with_names : Give names to states and actions afterwards.
        with_support_of : Allow a log's transitions that the samples lack.

        Notes
        -----
        Episodes go to the nearest state-action pair with too few samples, by value
        iteration on the transitions so far (``tasks.exploring``), until every action of
        every state reached has been taken ``samples_per_pair`` times; an episode that
        cannot lead there is ended by ``env.reset``. Observations that are not Discrete
        (tuples, integer arrays, texts) become the states' names. States that no episode
        reached are absorbing with reward 0. On a terminal a bar shows how many of the
        reached pairs have their samples, from the second second on.

        Examples
        --------
        >>> from oee_tabular.tasks import make_environment
        >>> lake = make_environment("FrozenLake-v1", is_slippery=False)
        >>> sampled = FiniteMDP.from_env(lake, samples_per_pair=1, seed=0)
        >>> exact = FiniteMDP.from_gymnasium(lake)
        >>> bool(abs(sampled.transitions - exact.transitions).max() == 0)
        True
        """
        gamma = _checks.number_in(discount, "discount", 0.0, 1.0)
        names = (state_names, action_names)
        # by name and on use, because what steps an environment is an agent, in a room
        # above this one
        exploring = importlib.import_module("oee_tabular.tasks.exploring")
        allow = _checks.boolean(masked, "masked")
        samples = exploring.explore_environment(
            env, samples_per_pair, seed, max_steps, names, masked=allow
        )
        return cls(**frequency_arguments(samples), discount=gamma)

    def _arguments(self) -> dict[str, Any]:
        """Return the constructor's arguments that make this MDP."""
        same = (
            "initial",
            "discount",
            "terminal_state",
            "state_names",
            "action_names",
            "sampling",
        )
        table = self.rewards if self._reward_table is None else self._reward_table
        arguments = {
            "transitions": self.csr,
            "rewards": table,
            "layout": self._own_layout,
            "available": self._available,
        }
        return arguments | {name: getattr(self, name) for name in same}

    def _replace(self, **changes: object) -> Self:
        """Return the same MDP with other arguments of the constructor."""
        return type(self)(**self._arguments() | changes)
