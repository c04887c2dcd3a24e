"""Gymnasium's toy-text environments as finite MDPs, and logs of any environment.

Logs are made by stepping an environment through its own ``step``.
"""

from __future__ import annotations

import difflib
import itertools
from collections.abc import Iterable, Iterator
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._progress import progress_bar
from oee_tabular.data import Transitions
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, check_policy, require_environment, shape_of
from oee_tabular.tasks.stepping import (
    MAX_EPISODE_STEPS,
    count_actions,
    count_observations,
    require_observation,
    reset_environment,
    step_environment,
)
from oee_tabular.typing import Array, PolicyLike, Seed


class Environment(Protocol):
    """Describe an environment with Gymnasium's interface."""

    @property
    def observation_space(self) -> Any:
        """Return the space of observations."""

    @property
    def action_space(self) -> Any:
        """Return the space of actions."""

    def reset(self, *, seed: int | None = None) -> Any:
        """Begin an episode; return its first observation, and information."""

    def step(self, action: Any, /) -> Any:
        """Take an action; return observation, reward, two flags, and information."""


def environment_exists(identifier: str, others: Iterable[str] = ()) -> None:
    """Raise a ValueError for an unknown id.

    The error has the nearest ids, or names of ``others``.
    """
    from gymnasium.envs.registration import registry

    _checks.instance(identifier, str, "identifier")
    if identifier not in registry:
        near = difflib.get_close_matches(
            identifier, [*others, *registry], n=3, cutoff=0.5
        )
        hint = f"; near: {', '.join(near)}" if near else ""
        raise ArgumentError(
            "environment",
            f"must be a task or a Gymnasium id; {_checks.show(identifier)} is neither"
            f"{hint} (your own: module:Class or module:EnvId-v0)",
        )


def make_environment(identifier: str, **kwargs: Any) -> Any:
    """Make a Gymnasium environment, with errors that name what was asked for.

    Parameters
    ----------
    identifier : str
        A Gymnasium id.
    **kwargs : Any
        Arguments of the environment.

    Returns
    -------
    gymnasium.Env
        The environment that ``gymnasium.make`` makes.

    Raises
    ------
    ValueError
        If the id is unknown (with the nearest ones), or the environment does not take
        the arguments.

    See Also
    --------
    toy_text : A toy-text environment as a FiniteMDP.

    Examples
    --------
    >>> make_environment("FrozenLake-v1", is_slippery=False).observation_space
    Discrete(16)
    >>> make_environment("FrozenLak-v1")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    oee_tabular.exceptions.ArgumentError: environment must be ... near: FrozenLake-v1...
    """
    import gymnasium

    environment_exists(identifier)
    try:
        return gymnasium.make(identifier, **kwargs)
    except gymnasium.error.Error as error:
        raise ValueError(
            f"environment {identifier!r} cannot be made: {error}"
        ) from None
    except (
        TypeError,
        LookupError,
        ValueError,
        ArithmeticError,
        AttributeError,
        AssertionError,
        NotImplementedError,
    ) as error:
        raise ValueError(
            f"environment {identifier!r} does not take these arguments {kwargs}:"
            f" {error}"
        ) from None


def toy_text(identifier: str, *, discount: float = 0.99, **kwargs: Any) -> FiniteMDP:
    """Make the FiniteMDP of a Gymnasium toy-text environment.

    Parameters
    ----------
    identifier : str
        A Gymnasium id.
    discount : float, default 0.99
        The discount, in [0, 1].
    **kwargs : Any
        Arguments of the environment.

    Returns
    -------
    FiniteMDP
        The environment's transitions and rewards.

    Raises
    ------
    ValueError
        If the environment cannot be made, or is no finite MDP.

    See Also
    --------
    make_environment : The environment itself.

    Examples
    --------
    >>> toy_text("FrozenLake-v1", map_name="8x8", success_rate=0.6)
    FiniteMDP(64 states, 4 actions, 674 transitions, rewards r(s, a, s'), discount 0.99)
    """
    gamma = _checks.number_in(discount, "discount", 0.0, 1.0)
    env = make_environment(identifier, **kwargs)
    try:
        return FiniteMDP.from_gymnasium(env, discount=gamma)
    except ValueError as error:
        options = ""
        if kwargs:
            given = ", ".join(f"{name}={value!r}" for name, value in kwargs.items())
            options = f" with {given}"
        raise ValueError(
            f"environment {identifier!r}{options} is no finite MDP: {error}"
        ) from None
    finally:
        env.close()


@suggest_keywords
def record_episodes(
    env: Environment,
    policy: PolicyLike,
    *,
    n_transitions: int | None = None,
    n_episodes: int | None = None,
    max_steps: int | None = None,
    seed: Seed = None,
) -> Transitions:
    """Step an environment under a policy, and record its transitions.

    Nothing of our own sampler is used: the log is evidence about the environment
    itself.

    Parameters
    ----------
    env : gymnasium.Env
        A Gymnasium environment with discrete observations and actions.
    policy : PolicyLike
        Action probabilities of shape (S, A), or an action for each observation, a
        mapping, or a function of the observation (``check_policy``). Rows sum to 1; S
        is at least the number of observations (twins of a FiniteMDP may follow).
    n_transitions : int, optional
        Number of transitions. The last episode is truncated where the log ends. Exactly
        one of ``n_transitions`` and ``n_episodes`` must be given.
    n_episodes : int, optional
        Number of episodes.
    max_steps : int, optional
        Number of steps after which episodes are truncated, besides the environment's
        own limit (some have none).
    seed : Seed, optional
        Anything that ``numpy.random.default_rng`` takes, for the actions and for the
        first ``env.reset``.

    Returns
    -------
    Transitions
        With rewards, termination, truncation, episodes and the probabilities of the
        actions taken.

    Raises
    ------
    ValueError
        If an argument is bad, if the environment raises an error or returns what is no
        step (the error names the action, the state and what was returned), or if an
        episode has not ended after 10^6 steps and ``max_steps`` is not given.

    See Also
    --------
    sample_episodes : Episodes of a FiniteMDP.
    oee_tabular.Transitions.from_episodes : A log of steps that you made yourself.
    oee_tabular.FiniteMDP.from_env : A simulator of an environment that is stepped.

    Examples
    --------
    >>> from oee_tabular.tasks import make_environment
    >>> env = make_environment("FrozenLake-v1", is_slippery=False)
    >>> record_episodes(env, np.full((16, 4), 0.25), n_episodes=3, seed=0)
    Transitions(40 transitions in 3 episodes of 7 to 24 steps: 3 terminated, 0 truncated;
                states 0..11, actions 0..3; rewards 0 to 0; behaviour probabilities)
    """
    if (n_transitions is None) == (n_episodes is None):
        raise ValueError("one of n_transitions and n_episodes must be given")
    limit = _positive_or_none(n_transitions, "n_transitions")
    _checks.require_memory(8.0 * (limit or 0), "n_transitions", limit)
    episodes = _positive_or_none(n_episodes, "n_episodes")
    # an episode has at least a row
    _checks.require_memory(8.0 * (episodes or 0), "n_episodes", episodes)
    longest = _positive_or_none(max_steps, "max_steps")
    require_environment(env)
    pi, n_observations = _policy_on_observations(env, policy)
    rows = []
    steps = _step(env, pi, n_observations, episodes, longest, _checks.generator(seed))
    with progress_bar("recording", total=limit or episodes) as progress:
        for row in itertools.islice(steps, limit):
            rows.append(row)
            progress.update(1 if episodes is None else int(row[4] or row[5]))
    states, actions, next_states, rewards, terminated, truncated, episode = map(
        np.array, zip(*rows, strict=True)
    )
    # the log ends here, also where the last episode neither terminated nor was cut
    truncated[-1] = True
    return Transitions(
        states,
        actions,
        next_states,
        rewards,
        terminated=terminated,
        truncated=truncated & ~terminated,
        episode=episode,
        behavior_probability=pi[states, actions],
    )


def _policy_on_observations(env: Environment, policy: PolicyLike) -> tuple[Array, int]:
    """Return a policy as (S, A), and the number of the environment's observations."""
    n_actions = count_actions(env)
    n_observations = count_observations(env)
    if n_observations is None:
        space = getattr(env, "observation_space", None)
        raise ArgumentError(
            "env.observation_space",
            f"must be Discrete; it is {_checks.show(space)} (of episodes that you step"
            " yourself: Transitions.from_episodes)",
        )
    # a policy may have more rows than the environment: twins of its states follow
    shape = shape_of(policy)
    n_rows = shape[0] if len(shape) == 2 else 0
    numbered = SimpleNamespace(
        n_states=max(n_rows, n_observations),
        n_actions=n_actions,
        terminal_state=np.arange(n_observations),
    )
    return check_policy(policy, numbered), n_observations


def _positive_or_none(value: int | None, name: str) -> int | None:
    """Check an optional positive integer."""
    return None if value is None else _checks.positive_integer(value, name)


def _step(
    env: Environment,
    pi: Array,
    n_observations: int,
    episodes: int | None,
    longest: int | None,
    generator: np.random.Generator,
) -> Iterator[tuple[int, int, int, float, bool, bool, int]]:
    """Step an environment and yield s, a, s', r, terminated, truncated and episode.

    There are ``episodes`` episodes, or no end. Without a longest one, an episode of a
    million steps is an ArgumentError.
    """
    cumulative = np.cumsum(pi, axis=1)
    cumulative /= cumulative[:, -1:]
    low = int(getattr(env.observation_space, "start", 0))
    # only the first reset is seeded: later episodes go on with its random numbers
    first_seed: int | None = int(generator.integers(2**31))
    for episode in itertools.count() if episodes is None else range(episodes):
        seen = reset_environment(env, first_seed)
        state = require_observation(seen, n_observations, env, "env.reset", None)
        has_ended = False
        steps = 0
        first_seed = None
        while not has_ended:
            number = generator.random()
            action = int(np.searchsorted(cumulative[state], number, side="right"))
            seen, reward, terminated, truncated = step_environment(env, action, state)
            if type(seen) is int and low <= seen < n_observations:
                next_state = seen
            else:
                call = f"env.step({action})"
                next_state = require_observation(seen, n_observations, env, call, state)
            steps += 1
            truncated = truncated or steps == longest
            yield state, action, next_state, reward, terminated, truncated, episode
            state = next_state
            has_ended = terminated or truncated
            if steps == MAX_EPISODE_STEPS and longest is None and episodes is not None:
                raise ArgumentError(
                    "max_steps",
                    f"must be given where episodes do not end; episode {episode} has"
                    f" not ended after {steps} steps",
                )
