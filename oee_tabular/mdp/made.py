"""Where an MDP comes from but its own arrays: a table of Gymnasium's, a log, an environment that is stepped."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Self


class Made:
    """The constructors of ``FiniteMDP`` from other things than arrays."""

    __slots__ = ()

    if TYPE_CHECKING:

        def __init__(self, *args: object, **arguments: object) -> None: ...

    @classmethod
    def from_gymnasium(cls, env: object, discount: float = 0.99) -> Self:
        """The MDP of a Gymnasium environment with a toy-text table ``env.unwrapped.P`` (FrozenLake, CliffWalking, Taxi).

        State numbers stay Gymnasium's. A state that is only entered by termination becomes absorbing itself; otherwise
        an absorbing twin is appended, and ``terminal_state[s]`` says where a terminated transition into s leads. No
        reward is paid after termination. Outcomes of one (s, a) that enter the same s' are merged: r(s, a, s') is their
        mean. Time limits are not part of the table: they are the ``horizon`` of an evaluation. Of an environment on a map
        (``desc`` or ``shape``, a cell a state) ``layout`` has row and column; a twin's are those of its state. Names are the
        environment's own: ``state_names``, ``action_names`` or ``get_action_meanings()``, else its module's (LEFT = 0).

        Raises
        ------
        ValueError
            Without such a table (Blackjack), or where the dynamics are not in it: a fickle Taxi passenger, a wrapper that
            changes actions, observations or rewards.
        """
        from oee_tabular.mdp.gymnasium_table import read_table

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
        """The MDP of a log's frequencies: a simulator that can only be sampled, from its own log.

        P(s' | s, a) = n(s, a, s') / n(s, a). An action never recorded in a state is taken to do what the recorded ones
        do there, on average by their moves; a state that was entered and never left stays where it is and pays 0. A warning
        says how many such pairs there are. Where moves terminated is over and pays 0, as in
        ``from_gymnasium``.

        Parameters
        ----------
        log : Transitions
        rewards : (S,), (S, A) or (S, A, S), S the log's own states; None: the log's mean for each move
        initial : (S,), a state, or a mapping; None: how often episodes began in each state (of a bag of moves: all states)
        n_states, n_actions : default one more than the largest of the log, or as many as there are names
        state_names, action_names : default the log's; given ones also order its numbers
        discount, layout : as in the constructor

        Raises
        ------
        ValueError
            No log; no rewards at all; a state or an action outside the given numbers or names; the constructor's errors.

        Examples
        --------
        >>> import oee_tabular as oee
        >>> log = oee.Transitions([0, 0, 1], [0, 0, 0], [0, 1, 1], [0.0, 1.0, 0.0], terminated=[0, 0, 1])
        >>> oee.FiniteMDP.from_log(log, discount=0.9).transitions.toarray().tolist()  # 2: where 1 -> 1 ended it
        [[0.5, 0.5, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]
        """
        from oee_tabular.mdp.empirical import log_arguments

        sizes, names = (n_states, n_actions), (state_names, action_names)
        return cls(**log_arguments(log, rewards, initial, sizes, names, layout), discount=discount)

    @classmethod
    def from_env(
        cls, env: Any, *, samples_per_pair: int, seed: Any = None, discount: float = 0.99, max_steps: int = 1_000_000
    ) -> Self:
        """The MDP of a Gymnasium environment that can only be sampled, by the frequencies of its moves.

        Episodes go to the nearest state-action pair with too few samples, by value iteration in what has been met so far
        (``mdp.explorer``), until every action of every state that was met has been taken ``samples_per_pair`` times; an
        episode that cannot lead there is left by ``env.reset``. Observations that are not Discrete (tuples, integer arrays,
        texts) become the states' names. States that no episode met stay where they are and pay 0.

        Parameters
        ----------
        env : with discrete observations and Discrete actions; it is stepped and reset, not closed
        samples_per_pair : positive int
        seed : anything that ``numpy.random.default_rng`` takes; of the first ``env.reset`` and of the actions
        discount : gamma
        max_steps : positive int, at which it ends; a warning says how many pairs have fewer samples then, and names three

        Raises
        ------
        ValueError
            Continuous observations or actions; bad arguments.

        Notes
        -----
        How many samples there were is kept (``sampling``): intervals widen by what first states, mean rewards and moves that
        were never met may change (``inference.margins``).

        Examples
        --------
        >>> from oee_tabular.tasks import make_environment
        >>> from oee_tabular import FiniteMDP
        >>> lake = make_environment("FrozenLake-v1", is_slippery=False)
        >>> sampled = FiniteMDP.from_env(lake, samples_per_pair=1, seed=0)
        >>> bool(abs(sampled.transitions - FiniteMDP.from_gymnasium(lake).transitions).max() == 0)
        True
        """
        from oee_tabular.mdp.empirical import env_arguments

        return cls(**env_arguments(env, samples_per_pair, seed, max_steps), discount=discount)
