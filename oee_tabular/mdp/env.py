"""An MDP as a Gymnasium environment, which agents of any library train in.

Gymnasium is imported when ``FiniteMDP.to_env`` is called, not before.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium import spaces

from oee_tabular import _checks
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array, BoolArray

if TYPE_CHECKING:
    from oee_tabular.mdp.finite_mdp import FiniteMDP

MAX_MAP_CELLS = 10_000  # of a map that is drawn as text; other states are named


class AvailableActions(spaces.Discrete):
    """Number the actions; samples are actions that the present state has.

    The environment sets ``mask`` in each step.
    """

    mask: BoolArray

    def __init__(self, n_actions: int) -> None:
        super().__init__(n_actions)
        self.mask = np.ones(n_actions, dtype=np.bool_)

    def sample(self, mask: Any = None, probability: Any = None) -> Any:
        """Draw an action that the present state has, or as the arguments say.

        Parameters
        ----------
        mask : ndarray of int8 of shape (A,), optional
            The actions to draw from, as in Gymnasium. None means the state's.
        probability : ndarray of float of shape (A,), optional
            The probabilities to draw with, as in Gymnasium.

        Returns
        -------
        int
            The action.
        """
        if mask is None and probability is None:
            mask = self.mask.astype(np.int8)
        return super().sample(mask=mask, probability=probability)


class FiniteMDPEnv(gymnasium.Env[Any, Any]):
    """Step an MDP: observations are the numbers of states, actions those of actions.

    ``FiniteMDP.to_env`` makes it, and explains it.

    Parameters
    ----------
    mdp : FiniteMDP
        The MDP.
    max_steps : int, optional
        The number of steps after which an episode is truncated. None means never.
    """

    def __init__(self, mdp: FiniteMDP, *, max_steps: int | None = None) -> None:
        if max_steps is not None:
            max_steps = _checks.positive_integer(max_steps, "max_steps")
        self.mdp = mdp
        self.max_steps = max_steps
        self.metadata = {"render_modes": ["ansi"], "render_fps": 4}
        self.render_mode = "ansi"
        self.observation_space = spaces.Discrete(mdp.n_states)
        self._actions = AvailableActions(mdp.n_actions)
        self.action_space = self._actions
        self._is_terminal = mdp.absorbing()
        self._first_states = np.flatnonzero(mdp.initial)
        self._state: int | None = None
        self._is_over = False
        self._n_steps = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[int, dict[str, Any]]:
        """Begin an episode in a state drawn from the MDP's first states.

        Parameters
        ----------
        seed : int, optional
            The seed of all that follows. None means that the generator goes on.
        options : dict, optional
            Nothing is read from it.

        Returns
        -------
        int
            The first state.
        dict
            ``action_mask``, and ``state_name`` where states have names.
        """
        super().reset(seed=seed)
        first = self._first_states
        self._state = int(first[self._draw(self.mdp.initial[first])])
        self._is_over = False
        self._n_steps = 0
        return self._state, self._describe()

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        """Take an action, and draw the transition from P.

        Parameters
        ----------
        action : int
            The number of the action.

        Returns
        -------
        int
            The next state.
        float
            The reward of the transition.
        bool
            Whether the next state is terminal.
        bool
            Whether the episode has had ``max_steps`` steps.
        dict
            ``action_mask`` of the next state, and ``state_name`` and ``action_name``
            where there are names.

        Raises
        ------
        ValueError
            If there is no such action, or if the state does not have it.
        RuntimeError
            If the episode is over, or none has begun.
        """
        state = self._state
        if state is None or self._is_over:
            begun = "no episode has begun" if state is None else "the episode is over"
            raise gymnasium.error.ResetNeeded(f"call reset before step: {begun}")
        number = self._check_action(action, state)
        mdp = self.mdp
        row = state * mdp.n_actions + number
        begin, end = mdp.csr.indptr[row], mdp.csr.indptr[row + 1]
        entry = begin + self._draw(mdp.csr.data[begin:end])
        if mdp.reward_data is None:
            reward = float(mdp.rewards[state, number])
        else:
            reward = float(mdp.reward_data[entry])
        self._state = int(mdp.csr.indices[entry])
        self._n_steps += 1
        is_terminated = bool(self._is_terminal[self._state])
        is_truncated = self.max_steps is not None and self._n_steps >= self.max_steps
        self._is_over = is_terminated or is_truncated
        info = self._describe()
        if mdp.action_names is not None:
            info["action_name"] = mdp.action_names[number]
        return self._state, reward, is_terminated, is_truncated, info

    def render(self) -> str:
        """Return the present state as text: a map where the layout is one.

        Returns
        -------
        str
            The map's rows: ``@`` the present state, ``T`` a terminal state, ``.``
            another, a space where there is none. Without a map, the state's name.
        """
        state = self._state
        if state is None:
            raise gymnasium.error.ResetNeeded("call reset before render")
        cells = _map_cells(self.mdp.layout)
        if cells is None:
            return f"state {self.mdp.names.state(state)}"
        chart = np.full(cells.max(axis=0) + 1, " ", dtype="<U1")
        for mark, states in (
            (".", ~self._is_terminal),
            ("T", self._is_terminal),
            ("@", np.array([state])),
        ):
            chart[tuple(cells[states].T)] = mark
        return "\n".join("".join(row).rstrip() for row in chart)

    def _check_action(self, action: Any, state: int) -> int:
        """Return the number of an action that the state has; refuse all others."""
        if not self.action_space.contains(action):
            raise ArgumentError(
                "action",
                f"must be an integer from 0 to {self.mdp.n_actions - 1}; got"
                f" {_checks.show(action)}",
            )
        number = int(action)
        mask = self._actions.mask
        if not mask[number]:
            names = self.mdp.names
            available = ", ".join(names.action(int(a)) for a in np.flatnonzero(mask))
            raise ArgumentError(
                "action",
                f"must be available in state {names.state(state)}; action"
                f" {names.action(number)} is not (info['action_mask'] says which are:"
                f" {available:.200})",
            )
        return number

    def _draw(self, probabilities: Array) -> int:
        """Draw a place of a distribution; the sum may differ from 1 by rounding."""
        sums = np.cumsum(probabilities)
        place = sums.searchsorted(self.np_random.random() * sums[-1], side="right")
        return min(int(place), len(sums) - 1)

    def _describe(self) -> dict[str, Any]:
        """Return what ``info`` says of the present state."""
        state = self._state
        assert state is not None
        mask = self.mdp.available[state]
        self._actions.mask = mask
        info: dict[str, Any] = {"action_mask": mask.astype(np.int8)}
        if self.mdp.state_names is not None:
            info["state_name"] = self.mdp.state_names[state]
        return info


def _map_cells(layout: Array | None) -> Any:
    """Return the row and column of each state on a map; None where there is none."""
    if layout is None or layout.shape[1] != 2:
        return None
    cells = layout - layout.min(axis=0)
    size = float(np.prod(cells.max(axis=0) + 1))
    if not (cells == np.floor(cells)).all() or size > MAX_MAP_CELLS:
        return None
    return cells.astype(np.int64)
