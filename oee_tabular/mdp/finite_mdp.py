"""A finite MDP on sparse rows.

The model (S, A, P, r, mu_0, gamma) of the paper's eq. 3.4. Row ``s*A + a`` of ``transitions`` is P(. | s, a).
Rewards are r(s), r(s, a) or r(s, a, s'); the last form belongs to the transition and is kept beside its expectation
r(s, a) = sum_s' P(s' | s, a) r(s, a, s'), which never stands in for it where a transition is weighted.
"""

from __future__ import annotations

import os
from functools import partial
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from oee_tabular import _checks, _files, _printing
from oee_tabular._checks import Array, IntArray
from oee_tabular._sparse import align, align_to, canonical, csr_from_parts, row_of_entry, row_sums
from oee_tabular.mdp.arrays import (
    Sampling,
    canonical_table,
    check_layout,
    name_move,
    reward_table,
    stored_sampling,
    stored_shape,
    terminal_states,
    transition_rows,
)
from oee_tabular.mdp.made import Made
from oee_tabular.mdp.naming import Name, Names, check_names, coordinates, from_text, initial_distribution, to_text

KIND = "finite_mdp"


class FiniteMDP(Made):
    """A finite Markov decision process, checked when it is made and immutable afterwards.

    Parameters
    ----------
    transitions : (S, A, S) array, or sparse of shape (S*A, S)
        P(s' | s, a), in row ``s*A + a`` of the sparse form; nonnegative, rows sum to 1 (tolerance 1e-8; those of a dense
        single-precision array are scaled). A state in which an episode is over leads to itself and pays 0.
    rewards : (S,), (S, A) or (S, A, S) array, or sparse of shape (S*A, S)
        r(s), r(s, a) or r(s, a, s'), finite. In a dense r(s, a, s') a nan outside the support of P means "undefined".
        In a sparse one an absent entry is 0 on the support and undefined elsewhere.
    initial : (S,) array
        Distribution mu_0 of the first state; or one state, by number or name, or a mapping state -> probability.
    discount : float in [0, 1]
        gamma. At 1 an infinite horizon is defined only for policies that are absorbed in states that pay nothing;
        the functions that evaluate say so when it is not.
    terminal_state : (S0,) integers, optional
        For s below S0, the number of the environment's own states: where a transition that *terminates* on entering s
        leads. By default s itself.
    layout : (S,) or (S, c) array, or a grid's shape (height, width), optional
        Coordinates of the states, finite: what makes moves from different states alike (``mdp.displacements``) and where
        maps have them, (row, column) of two. Of a shape, two integers whose product is S, state s lies in row s // width.
        None: the coordinates in ``state_names`` where all are tuples of numbers of one length, (3, 4); else none.
    sampling : Sampling, optional
        What the MDP rests on where it was made of samples; ``from_log`` and ``from_env`` give it, intervals widen by it.
    state_names, action_names : S, A texts or tuples of texts and numbers, optional
        What the states and the actions are called, each once; none reads as a number. Logs and policies may use them.

    Attributes
    ----------
    n_states, n_actions : int
    transitions : csr_array of shape (S*A, S), without explicit zeros
    rewards : (S, A) expected reward
    transition_rewards : csr_array of shape (S*A, S), an entry wherever r(s, a, s') is defined, or None
    initial, discount, terminal_state, layout ((S, c) or None), state_names, action_names (tuples or None), sampling (or None)
    names : both, as sentences word them (``mdp.naming``)

    Raises
    ------
    ValueError
        With the argument, the place, the rule and the value found.

    Examples
    --------
    >>> import numpy as np
    >>> P = np.array([[[0.9, 0.1], [0.2, 0.8]], [[0.0, 1.0], [0.0, 1.0]]])
    >>> mdp = FiniteMDP(P, np.array([1.0, 0.0]), np.array([1.0, 0.0]), 0.9)
    >>> mdp
    FiniteMDP(2 states, 2 actions, 6 transitions, rewards r(s, a), discount 0.9)
    """

    __slots__ = (
        "_own_layout",
        "_reward_data",
        "action_names",
        "discount",
        "initial",
        "layout",
        "n_actions",
        "n_states",
        "rewards",
        "sampling",
        "state_names",
        "terminal_state",
        "transition_rewards",
        "transitions",
    )

    n_states: int
    n_actions: int
    transitions: sparse.csr_array
    rewards: Array
    transition_rewards: sparse.csr_array | None
    initial: Array
    discount: float
    terminal_state: IntArray
    layout: Array | None
    state_names: tuple[Name, ...] | None
    action_names: tuple[Name, ...] | None
    sampling: Sampling | None
    _own_layout: Array | None  # as given, without the names' coordinates
    _reward_data: Array | None

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
        matrix, n_states, n_actions = transition_rows(transitions)
        table, expected = reward_table(rewards, matrix, n_states, n_actions)
        data = None
        if table is not None:
            table, data = align_to(table, matrix)
            expected = row_sums(matrix, matrix.data * data).reshape(n_states, n_actions)
        if terminal_state is None:
            terminal = np.arange(n_states, dtype=np.int64)
        else:
            terminal = terminal_states(terminal_state, n_states)
        called = None if state_names is None else check_names(state_names, "state_names", n_states)
        start = initial_distribution(initial, called, n_states)
        places = None if layout is None else check_layout(layout, n_states)
        values = {
            "n_states": n_states,
            "n_actions": n_actions,
            "transitions": matrix,
            "rewards": _checks.freeze(expected),
            "transition_rewards": table,
            "initial": _checks.freeze(_checks.distribution(start, "initial", (n_states,))),
            "discount": _checks.number_in(discount, "discount", 0.0, 1.0),
            "terminal_state": _checks.freeze(terminal),
            "layout": coordinates(called) if places is None else places,
            "state_names": called,
            "action_names": None if action_names is None else check_names(action_names, "action_names", n_actions),
            "sampling": sampling,
            "_own_layout": places,
            "_reward_data": data,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"FiniteMDP is immutable; cannot set {name!r} (make a new one)")

    def __delattr__(self, name: str) -> None:
        raise AttributeError(f"FiniteMDP is immutable; cannot delete {name!r}")

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(type(self), **self._arguments()), ()

    def __repr__(self) -> str:
        form = "r(s, a)" if self.transition_rewards is None else "r(s, a, s')"
        return (
            f"FiniteMDP({self.n_states} states, {self.n_actions} actions, {self.transitions.nnz} transitions, "
            f"rewards {form}, discount {self.discount:g})"
        )

    def _repr_html_(self) -> str:
        form = "r(s, a)" if self.transition_rewards is None else "r(s, a, s')"
        paid = self.rewards if self.reward_data is None else self.reward_data
        rows = [
            ("states", self.n_states), ("actions", self.n_actions), ("transitions", self.transitions.nnz),
            ("rewards", f"{form}, {paid.min():.4g} to {paid.max():.4g}"), ("discount", f"{self.discount:g}"),
            ("first states", int((self.initial > 0).sum())), ("states that are over", int(self.absorbing().sum())),
        ]  # fmt: skip
        return _printing.facts("FiniteMDP: rewards in units of the return", rows)

    @property
    def reward_data(self) -> Array | None:
        """r(s, a, s') on the entries of ``transitions`` (aligned with ``transitions.data``), None for r(s, a)."""
        return self._reward_data

    @property
    def names(self) -> Names:
        """How sentences word a state and an action: by name, or by number."""
        return Names(self.state_names, self.action_names)

    def absorbing(self) -> _checks.BoolArray:
        """(S,) mask of the closed states that pay nothing: where an episode is over."""
        unpaid: _checks.BoolArray = np.all(self.rewards == 0.0, axis=1)
        return self.closed() & unpaid

    def closed(self) -> _checks.BoolArray:
        """(S,) mask of the states that every action leads back to."""
        rows = row_of_entry(self.transitions)
        stays = self.transitions.indices == rows // self.n_actions
        leaves = np.zeros(self.n_states, dtype=np.bool_)
        leaves[rows[~stays] // self.n_actions] = True
        return ~leaves

    def with_transitions(self, new: object) -> Self:
        """The same MDP under other dynamics (eq. 3.4); r(s, a, s') is averaged again.

        Raises ValueError where ``new`` moves to an s' for which r(s, a, s') is not defined.
        """
        try:
            matrix, n_states, n_actions = transition_rows(new)
        except ValueError as error:
            raise ValueError(f"new {error}") from None
        if (n_states, n_actions) != (self.n_states, self.n_actions):
            raise ValueError(
                f"new transitions must be for {self.n_states} states and {self.n_actions} actions; "
                f"they are for {n_states} and {n_actions}"
            )
        rewards: object = self.rewards
        if self.transition_rewards is not None:
            _, defined = align(self.transition_rewards, matrix)
            if not defined.all():
                moves = [name_move(matrix, k, n_actions, self.names) for k in np.flatnonzero(~defined)[:3]]
                raise ValueError(
                    f"new transitions must stay where r(s, a, s') is defined; {int((~defined).sum())} moves do not, "
                    f"the first: {'; '.join(moves)}"
                )
            rewards = self.transition_rewards
        return self._changed(transitions=matrix, rewards=rewards, sampling=None)

    def with_rewards(self, rewards: object) -> Self:
        """The same dynamics with other rewards, in any of the constructor's forms."""
        return self._changed(rewards=rewards, sampling=self.sampling and self.sampling.without_rewards())

    def with_discount(self, discount: float) -> Self:
        """The same MDP with another discount."""
        return self._changed(discount=discount)

    def with_initial(self, initial: object) -> Self:
        """The same MDP begun elsewhere: in a state, by number or name, or by a law in any of the constructor's forms."""
        return self._changed(initial=initial, sampling=self.sampling and self.sampling._replace(starts=np.inf))

    def with_layout(self, layout: ArrayLike | None) -> Self:
        """The same MDP with other coordinates of its states, as in the constructor; None: those in its names, or none."""
        return self._changed(layout=layout)

    def with_names(self, state_names: object = None, action_names: object = None) -> Self:
        """The same MDP with these names of its states and of its actions; None: with none."""
        return self._changed(state_names=state_names, action_names=action_names)

    def with_action_noise(self, epsilon: float) -> Self:
        """With probability epsilon the action is replaced by a uniform one (which may be the same).

        P_eps(. | s, a) = (1 - eps) P(. | s, a) + eps mean_b P(. | s, b), and the rewards are those of the action that
        was carried out: r_eps(s, a, s') = E[r(s, b, s') | s, a, s'], or r_eps(s, a) = E[r(s, b) | s, a] where rewards
        do not depend on s'. It gives a too deterministic simulator the support that a ratio needs.
        A state's value under (P_eps, policy) is its value under (P, (1 - eps) policy + eps uniform).
        """
        eps = _checks.number_in(epsilon, "epsilon", 0.0, 1.0)
        noise = sparse.kron(
            sparse.eye_array(self.n_states), np.full((self.n_actions, self.n_actions), 1.0 / self.n_actions)
        )
        mixing = sparse.csr_array((1.0 - eps) * sparse.eye_array(self.n_states * self.n_actions) + eps * noise)
        matrix = canonical(mixing @ self.transitions, drop_zeros=True)
        rewards: object = (mixing @ self.rewards.reshape(-1)).reshape(self.rewards.shape)
        if self._reward_data is not None:
            flow = self.transitions.copy()
            flow.data = self.transitions.data * self._reward_data
            total, _ = align(canonical(mixing @ flow, drop_zeros=False), matrix)
            rewards = sparse.csr_array((total / matrix.data, matrix.indices, matrix.indptr), matrix.shape)
        sampling = self.sampling and self.sampling.mixed(self.n_actions)
        return self._changed(transitions=matrix, rewards=rewards, sampling=sampling)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an npz of plain arrays, whole or not at all."""
        _files.save_npz(path, KIND, self.arrays())

    def arrays(self) -> dict[str, Any]:
        """What a file holds."""
        arrays: dict[str, object] = {
            "shape": np.array([self.n_states, self.n_actions]),
            "transitions_data": self.transitions.data,
            "transitions_indices": self.transitions.indices,
            "transitions_indptr": self.transitions.indptr,
            "initial": self.initial,
            "discount": np.array(self.discount),
            "terminal_state": self.terminal_state,
        }
        if self.transition_rewards is None:
            arrays["rewards"] = self.rewards
        else:
            for part in ("data", "indices", "indptr"):
                arrays[f"rewards_{part}"] = getattr(self.transition_rewards, part)
        if self._own_layout is not None:
            arrays["layout"] = self._own_layout
        called = {"state_names": self.state_names, "action_names": self.action_names}
        arrays |= {name: to_text(names) for name, names in called.items() if names is not None}
        return arrays | ({} if self.sampling is None else self.sampling.arrays())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read what ``save`` wrote; the same checks as in the constructor."""
        arrays = _files.load_npz(
            path, KIND, hint="make one with FiniteMDP(transitions, rewards, initial, discount).save(path)"
        )
        with _files.parts_of(path, "a FiniteMDP"):
            shape = stored_shape(arrays["shape"])

            def matrix(name: str) -> sparse.csr_array:
                data, indices, indptr = (arrays[f"{name}_{part}"] for part in ("data", "indices", "indptr"))
                return csr_from_parts(data, indices, indptr, shape, name)

            rewards = arrays["rewards"] if "rewards" in arrays else matrix("rewards")
            return cls(
                matrix("transitions"),
                rewards,
                arrays["initial"],
                float(_checks.float_array(arrays["discount"], "discount", ndim=0)),
                terminal_state=arrays["terminal_state"],
                layout=arrays.get("layout"),
                sampling=stored_sampling(arrays, shape),
                **{name: from_text(arrays[name], name) for name in ("state_names", "action_names") if name in arrays},
            )

    def with_support_of(self, log: object, epsilon: float) -> Self:
        """The same MDP in which the moves of ``log`` are possible: where some were not, P' = (1 - eps) P + eps U.

        U is uniform over those of the log's moves from (s, a) that P gives probability 0; other rows stay as they are. A
        new move pays the log's mean reward for it, or r(s, a) where the log has none.

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
        from oee_tabular.mdp.support import supporting

        return self._changed(**supporting(self, log, epsilon))

    def _arguments(self) -> dict[str, Any]:
        rewards = self.rewards if self.transition_rewards is None else self.transition_rewards
        same: tuple[str, ...] = (
            "transitions",
            "initial",
            "discount",
            "terminal_state",
            "state_names",
            "action_names",
            "sampling",
        )
        return {"rewards": rewards, "layout": self._own_layout} | {name: getattr(self, name) for name in same}

    def _changed(self, **changes: object) -> Self:
        """The same MDP with other arguments of the constructor."""
        return type(self)(**self._arguments() | changes)


__all__ = ["KIND", "FiniteMDP", "canonical_table", "name_move"]
