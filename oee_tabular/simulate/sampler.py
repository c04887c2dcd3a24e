"""The sampler: episodes by alias tables, as sums along them and as logs (4.2)."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from oee_tabular import _checks
from oee_tabular._sparse import repeat_rows, row_of_entry
from oee_tabular.data import Transitions
from oee_tabular.mdp import FiniteMDP, check_policy, horizon_length, require_available
from oee_tabular.typing import (
    Array,
    BoolArray,
    IntArray,
    PolicyLike,
    RealArrayLike,
    Seed,
)

if TYPE_CHECKING:
    from oee_tabular.exact import RatioLike
else:
    RatioLike: TypeAlias = Any  # for ``typing.get_type_hints``

# streams of random numbers, so that one seed gives three different samples
LOG_STREAM = np.uint64(0)  # of ``sample_episodes``
RETURN_STREAM = np.uint64(1)  # of ``sample_returns``
TRANSITION_STREAM = np.uint64(2)  # of ``sample_transitions``
# of a log, of the path that it is made of and of numbers for each episode, which may
# have a single step
N_NUMBERS_PER_TRANSITION = 12.0
# runs of fewer steps, which take some milliseconds, stay on the calling thread
MIN_THREADED_STEPS = 1 << 20
MAX_FIRST_PATH_STEPS = 1 << 24  # room for the first path; later ones have twice as much
N_CHUNK_EPISODES = 1 << 10  # episodes that a thread takes at a time


class AliasTable(NamedTuple):
    """Hold one alias table for all states.

    The draw of the first state is one state more, whose outcomes are entries after the
    entries of P.

    Attributes
    ----------
    code : ndarray of shape (S + 1,)
        First slot * 2^8 + terminal * 2^7 + k of each state.
    word : ndarray of shape (slots,)
        Threshold and alias of each slot, as in ``_rollout``.
    following : ndarray of shape (slots,)
        Code of the state that a slot leads to.
    reward : ndarray of shape (slots,)
        r of a slot's transition.
    factor : ndarray of shape (slots,) or (0,)
        zeta of a slot's transition; empty without weights.
    entry : ndarray of shape (slots,)
        The entry of P that a slot stands for.
    """

    code: Any
    word: Any
    following: Any
    reward: Array
    factor: Array
    entry: IntArray


@dataclass(frozen=True, eq=False)
class Drawn:
    """Hold the sums along each of n episodes, and the paths of recorded ones.

    Attributes
    ----------
    returns : ndarray of shape (n,)
        G = sum_t gamma^t r_t.
    weighted : ndarray of shape (n,)
        X = sum_t gamma^t W r_t, where W is the weight that r_t carries: W_t, or W_{t+1}
        for r(s, a, s').
    weights : ndarray of shape (n,)
        The weight of the last of ``horizon`` steps; constant after the end of an
        episode.
    largest : ndarray of shape (n,)
        The largest of the weights that the rewards carry.
    lengths : ndarray of shape (n,)
        Number of steps.
    final_state : ndarray of shape (n,)
        The state after the last step.
    path : ndarray of int
        The entry of P that each step takes, one episode after the other; empty where it
        is not recorded.
    ratio : ndarray of shape (nnz,) or (0,)
        zeta of each entry of P; empty without weights.
    """

    returns: Array
    weighted: Array
    weights: Array
    largest: Array
    lengths: IntArray
    final_state: IntArray
    path: IntArray
    ratio: Array

    @property
    def whole(self) -> Array:
        """Return W G of each episode.

        A return of 0 is 0 under any weight, even an infinite one.
        """
        with np.errstate(over="ignore"):
            return np.multiply(
                self.weights,
                self.returns,
                out=np.zeros_like(self.returns),
                where=self.returns != 0,
            )

    @property
    def starts(self) -> IntArray:
        """Return where each episode begins in ``path``, of shape (n + 1,)."""
        return np.concatenate([[0], np.cumsum(self.lengths)])


def draw(
    mdp: FiniteMDP,
    policy: Array,
    n: int,
    horizon: int,
    *,
    seed: Seed,
    zeta: RatioLike | None = None,
    record: bool = False,
    pairs: Array | None = None,
    stream: np.uint64 = RETURN_STREAM,
    name: str = "n_episodes",
) -> Drawn:
    """Draw n episodes of a checked policy, with the sums along each.

    Sums are weighted by ``zeta`` if it is given, and paths are kept to ``record`` them.
    ``pairs`` (S*A,) is the distribution of the first pair, for episodes of one step
    whose states are pairs; ``policy`` is then (S*A, 1). ``name`` is what errors call n.
    """
    # not at import: logs do without
    from oee_tabular.exact import transition_factors

    _checks.require_memory(9.0 * n, name, n)
    if pairs is None:
        terminal = mdp.absorbing()
        initial = mdp.initial
    else:
        terminal = np.zeros(len(pairs), dtype=np.bool_)
        initial = pairs
    ratio = np.zeros(0) if zeta is None else transition_factors(mdp, zeta, terminal)
    table = alias_table(mdp, policy, initial, terminal, ratio)
    key = np.uint64(_checks.generator(seed).integers(0, 2**64, dtype=np.uint64))
    sums = np.empty((4, n))
    lengths, last = np.empty((2, n), dtype=np.int64)
    by_transition = mdp.reward_data is not None
    # the arguments of the kernel between the episodes' numbers and the path
    options = (
        key,
        stream,
        horizon,
        mdp.discount,
        by_transition,
        table,
        sums,
        lengths,
        last,
    )
    if record:
        path = _run_recorded(n, horizon, options, name)
    else:
        path = np.empty(0, dtype=np.int64)
        _run(n, horizon, options, path)
    return Drawn(
        returns=sums[0],
        weighted=sums[1],
        weights=sums[2],
        largest=sums[3],
        lengths=lengths,
        final_state=mdp.transitions.indices[last].astype(np.int64),
        path=path,
        ratio=ratio,
    )


def _run_recorded(
    n: int, horizon: int, options: tuple[Any, ...], name: str
) -> IntArray:
    """Draw n episodes on this thread and return their paths, one after the other."""
    from oee_tabular.simulate._rollout import draw_episodes

    pieces = []
    done = 0
    room = min(n * horizon, MAX_FIRST_PATH_STEPS)
    # an episode that the path has no room for is drawn again, into a longer one
    while done < n:
        _checks.require_memory(2.0 * room, name, n)
        path = np.empty(room, dtype=np.int64)
        done, used = draw_episodes(done, n, *(*options, path))
        pieces.append(path[:used])
        room *= 2
    # a path has all transitions: it is not copied without need
    return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)


def _run(n: int, horizon: int, options: tuple[Any, ...], path: IntArray) -> None:
    """Draw n episodes without their paths, on threads where that takes long."""
    from oee_tabular._compiling import n_threads
    from oee_tabular.simulate._rollout import draw_episodes

    arguments = (*options, path)
    if n * horizon < MIN_THREADED_STEPS:
        draw_episodes(0, n, *arguments)
        return

    def draw_chunk(first: int) -> None:
        """Draw the episodes from ``first`` on that a thread takes at a time."""
        draw_episodes(first, min(first + N_CHUNK_EPISODES, n), *arguments)

    with ThreadPoolExecutor(n_threads()) as pool:
        list(pool.map(draw_chunk, range(0, n, N_CHUNK_EPISODES)))


def alias_table(
    mdp: FiniteMDP, policy: Array, initial: Array, terminal: BoolArray, ratio: Array
) -> AliasTable:
    """Make the alias table of every state's (a, s'), and of the first state.

    ``policy`` is (S, A). With a policy (S*A, 1), states are pairs, and the outcomes are
    every pair's s'.
    """
    from oee_tabular.simulate._rollout import fill_table

    matrix = mdp.transitions
    begin = np.flatnonzero(initial)
    # the draw of the first state is one state more, all of whose entries are in its
    # first row
    ends_of_begin = np.full(policy.shape[1], matrix.nnz + len(begin))
    indptr = np.append(matrix.indptr, ends_of_begin).astype(np.int64)
    indices = np.append(matrix.indices, begin)
    prob = np.append(matrix.data, initial[begin])
    pi = np.concatenate([policy, np.eye(1, policy.shape[1])])
    n_outcomes = (np.diff(indptr).reshape(pi.shape) * (pi > 0.0)).sum(axis=1)
    # the least k with 2^k slots for the outcomes
    size = np.frexp(n_outcomes - 1)[1].astype(np.int64)
    ends = np.cumsum(1 << size)
    first = ends - (1 << size)
    word, entry = np.empty((2, ends[-1]), dtype=np.int64)
    fill_table(indptr, prob, pi, first, size, word, entry)
    code = first << 8 | np.append(terminal, False) * 128 | size
    # rewards and factors of the first draw are not read
    padding = np.ones(len(begin))
    reward = np.append(entry_rewards(mdp), padding)[entry]
    factor = np.append(ratio, padding)[entry] if len(ratio) else ratio
    following = code[indices[entry]]
    return AliasTable(
        code=code.view(np.uint64),
        word=word.view(np.uint64),
        following=following.view(np.uint64),
        reward=reward,
        factor=factor,
        entry=entry,
    )


def entry_rewards(mdp: FiniteMDP) -> Array:
    """Return the reward of each entry of P: r(s, a, s'), or r(s, a)."""
    if mdp.reward_data is not None:
        return mdp.reward_data
    return repeat_rows(mdp.csr, mdp.rewards.reshape(-1))


def sample_episodes(
    mdp: FiniteMDP, policy: PolicyLike, n_episodes: int, horizon: int, *, seed: Seed
) -> Transitions:
    """Sample episodes from the initial distribution, each of at most ``horizon`` steps.

    An episode terminates on entering an absorbing state with reward 0; one that reaches
    the horizon is truncated. Rewards are r(s, a, s') if the MDP has them, else r(s, a).

    Parameters
    ----------
    mdp : FiniteMDP
        The model that episodes are drawn from.
    policy : PolicyLike
        Action probabilities of shape (S, A); other forms as in ``check_policy``.
    n_episodes : int
        Number of episodes.
    horizon : int
        Largest number of steps of an episode.
    seed : Seed
        Anything that ``numpy.random.default_rng`` takes. A Generator is advanced.

    Returns
    -------
    Transitions
        With episodes, timesteps and the behaviour probabilities of ``policy``. An
        episode whose first state is already absorbing has one step.

    Raises
    ------
    ValueError
        If an argument is bad.

    See Also
    --------
    sample_transitions : Independent transitions.
    sample_returns : Returns of episodes that are not stored.

    Notes
    -----
    Costs O(1) a step, after O(nnz) for the alias table; nothing is padded.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> target = oee.tasks.gridworld(3, slip=0.1)
    >>> sample_episodes(target, oee.tasks.gridworld_expert(3), 10, horizon=20, seed=0)
    Transitions(44 transitions in 10 episodes of 4 to 6 steps: 10 terminated, 0 truncated;
                states 0..8, actions 0..2; rewards -0.6 to 0; behaviour probabilities)
    """
    n = _checks.positive_integer(n_episodes, "n_episodes")
    # an episode has at least a row
    _checks.require_memory(9.0 * n, "n_episodes", n)
    _checks.instance(mdp, FiniteMDP, "mdp")
    steps = _checks.positive_integer(horizon, "horizon")
    # a horizon is limited only where the log may have more than a million transitions
    if steps > 10**6 / n:
        steps = max(horizon_length(horizon, mdp), 10**6 // n)
    pi = check_policy(policy, mdp)
    drawn = draw(mdp, pi, n, steps, seed=seed, stream=LOG_STREAM, record=True)
    return episode_log(mdp, drawn, pi)


def episodes_holding(
    mdp: FiniteMDP, policy: PolicyLike, n: int, horizon: int, *, seed: Seed
) -> Transitions:
    """Sample whole episodes that together have at least n transitions.

    As many are drawn as would do if none ended early, and more where episodes do. A
    Generator draws afresh at each try; with any other seed the episodes tried before
    stay.
    """
    _checks.require_memory(N_NUMBERS_PER_TRANSITION * n, "n_transitions", n)
    count = max(1, -(-n // horizon))  # n / horizon, rounded up
    while len(log := sample_episodes(mdp, policy, count, horizon, seed=seed)) < n:
        count = int(np.ceil(1.2 * count * n / len(log))) + 1
    return log


def sample_transitions(
    mdp: FiniteMDP, distribution: RealArrayLike, n: int, *, seed: Seed
) -> Transitions:
    """Sample n independent transitions: (s, a) ~ ``distribution``, s' ~ P(. | s, a).

    There are no episodes and no termination: absorbing states are sampled like any
    other.

    Parameters
    ----------
    mdp : FiniteMDP
        The model that next states are drawn from.
    distribution : array_like of shape (S, A)
        How state-action pairs are drawn. It sums to 1. Where the MDP has twins, the
        shape (S0, A) of the environment's own states does too.
    n : int
        Number of transitions.
    seed : Seed
        Anything that ``numpy.random.default_rng`` takes. A Generator is advanced.

    Returns
    -------
    Transitions
        The transitions with their rewards, without episodes.

    Raises
    ------
    ValueError
        If an argument is bad.

    See Also
    --------
    sample_episodes : Episodes of a policy.

    Notes
    -----
    Costs O(1) a transition, after O(nnz) for the alias table.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> log = sample_transitions(coin, [[0.5], [0.5]], 1000, seed=0)
    >>> log.counts(2, 1).toarray().tolist()
    [[255.0, 247.0], [241.0, 257.0]]
    """
    _checks.instance(mdp, FiniteMDP, "mdp")
    size = _checks.positive_integer(n, "n")
    weights = _checks.float_array(distribution, "distribution", ndim=2)
    n_own = len(mdp.terminal_state)
    # a distribution of the environment's own states: twins are not drawn
    if weights.shape == (n_own, mdp.n_actions):
        n_twins = mdp.n_states - n_own
        weights = np.concatenate([weights, np.zeros((n_twins, mdp.n_actions))])
    shape = (mdp.n_states, mdp.n_actions)
    table = _checks.distribution(weights, "distribution", shape, given=distribution)
    pairs = require_available(table, mdp, "distribution").reshape(-1)
    # episodes of one step, whose states are pairs and which have one action
    drawn = draw(
        mdp,
        np.ones((len(pairs), 1)),
        size,
        1,
        seed=seed,
        record=True,
        pairs=pairs,
        stream=TRANSITION_STREAM,
        name="n",
    )
    path = drawn.path
    state, action = np.divmod(row_of_entry(mdp.transitions)[path], mdp.n_actions)
    next_state = mdp.transitions.indices[path]
    return Transitions(state, action, next_state, entry_rewards(mdp)[path])


def episode_log(mdp: FiniteMDP, drawn: Drawn, policy: Array) -> Transitions:
    """Make a log of recorded episodes, column by column.

    What was drawn here needs no checks, which take longer than drawing.
    """
    from oee_tabular.simulate._rollout import write_columns

    n = len(drawn.path)
    integers = np.empty((5, n), dtype=np.int64)
    numbers = np.empty((2, n))
    flags = np.zeros((2, n), dtype=np.bool_)
    write_columns(
        drawn.path,
        drawn.lengths,
        row_of_entry(mdp.transitions),
        mdp.transitions.indices,
        entry_rewards(mdp),
        policy,
        mdp.absorbing(),
        integers,
        numbers,
        flags,
    )
    columns = {
        "state": integers[0],
        "action": integers[1],
        "next_state": integers[2],
        "timestep": integers[3],
        "episode": integers[4],
        "reward": numbers[0],
        "behavior_probability": numbers[1],
        "terminated": flags[0],
        "truncated": flags[1],
    }
    # without __init__, which would check every column
    log = object.__new__(Transitions)
    for field in fields(Transitions):
        column = columns.get(field.name)
        object.__setattr__(
            log, field.name, None if column is None else _checks.freeze(column)
        )
    return log
