"""From a Gymnasium toy-text table ``P[s][a] = [(probability, s', reward, terminated), ...]`` to rows.

Gymnasium itself is not imported: the environment that is handed over brings what is needed.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular._sparse import align, canonical
from oee_tabular.mdp.naming import Name, check_names, coordinates

# wrappers of Gymnasium that change neither actions nor observations nor rewards (a time limit is a horizon)
_HARMLESS = {
    "HumanRendering",
    "OrderEnforcing",
    "PassiveEnvChecker",
    "RecordEpisodeStatistics",
    "RecordVideo",
    "RenderCollection",
    "TimeLimit",
}


@dataclass(frozen=True)
class Table:
    """The parts of a FiniteMDP, by the names of its arguments."""

    transitions: sparse.csr_array
    rewards: sparse.csr_array
    initial: Array
    terminal_state: IntArray
    layout: Array | None
    state_names: tuple[Name, ...] | None = None
    action_names: tuple[Name, ...] | None = None


def read_table(env: Any) -> Table:
    """The transitions, rewards r(s, a, s'), initial distribution and terminal states of ``env``'s table."""
    _refuse_changing_wrappers(env)
    base = getattr(env, "unwrapped", env)
    name = type(base).__name__
    table = getattr(base, "P", None)
    if table is None or not hasattr(base, "initial_state_distrib"):
        raise ValueError(
            f"env must have a toy-text table env.unwrapped.P and an initial_state_distrib; {name} has none "
            "(build the FiniteMDP from its arrays, or sample it: FiniteMDP.from_env(env, samples_per_pair=...); of an "
            "environment with continuous states make a tasks.GymnasiumTask)"
        )
    if getattr(base, "fickle_passenger", False):
        raise ValueError(
            "env must have all its dynamics in the table P; a fickle Taxi passenger changes its destination outside it "
            f"(fickle_probability={base.fickle_probability:g}): use fickle_passenger=False"
        )
    outcomes = np.array(
        [
            (s, a, next_state, probability, reward, terminated)
            for s in range(len(table))
            for a in range(len(table[0]))
            for probability, next_state, reward, terminated in table[s][a]
            if probability > 0
        ],
        dtype=np.float64,
    ).T
    state, action, following = (part.astype(np.int64) for part in outcomes[:3])
    moves = Outcomes(state, action, following, outcomes[3], outcomes[4], outcomes[5] > 0)
    built = build(
        moves, len(table[0]), np.array(base.initial_state_distrib, dtype=np.float64), _map_of(base, len(table)),
        state_names=_names(getattr(base, "state_names", None), len(table)),
    )  # fmt: skip
    return replace(built, action_names=_action_names(base, len(table[0])))


def _refuse_changing_wrappers(env: object) -> None:
    layer = env
    while hasattr(layer, "env") and layer is not getattr(layer, "unwrapped", layer):
        if type(layer).__name__ not in _HARMLESS:
            raise ValueError(
                "env must not change actions, observations or rewards outside its table P; "
                f"the wrapper {type(layer).__name__} may (pass env.unwrapped to leave it out)"
            )
        layer = layer.env


def _map_of(base: object, n_states: int) -> Array | None:
    """(S, 2) row and column of each state of an environment on a map; None where there is no map with a cell a state."""
    shapes: tuple[Any, ...] = (getattr(getattr(base, "desc", None), "shape", None), getattr(base, "shape", None))
    for shape in shapes:
        cells = isinstance(shape, tuple) and len(shape) == 2 and all(isinstance(n, int) for n in shape)
        if cells and shape[0] * shape[1] == n_states:
            return np.stack(np.divmod(np.arange(n_states), shape[1]), axis=1).astype(np.float64)
    return None


def _names(given: object, size: int) -> tuple[Name, ...] | None:
    """An environment's own names where they are names for each."""
    try:
        return None if given is None else check_names(given, "names", size)
    except ValueError:
        return None


def _action_names(base: object, n_actions: int) -> tuple[Name, ...] | None:
    """What an environment calls its actions; None where it does not say."""
    meanings = getattr(base, "get_action_meanings", None)
    given = getattr(base, "action_names", None if meanings is None else meanings())
    if given is not None:
        return _names(given, n_actions)
    module = sys.modules.get(type(base).__module__)
    constants = [(k, v) for k, v in vars(module).items() if k.isupper() and isinstance(v, int)] if module else []
    numbered = sorted((v, k.lower()) for k, v in constants if 0 <= v < n_actions)
    return tuple(k for _, k in numbered) if [v for v, _ in numbered] == list(range(n_actions)) else None


class Outcomes(NamedTuple):
    """What may follow: six columns, (n,) each; probabilities of a row (s, a) sum to 1."""

    state: IntArray
    action: IntArray
    next_state: IntArray
    probability: Array
    reward: Array
    terminated: BoolArray


def build(
    moves: Outcomes, n_actions: int, initial: Array, layout: Array | None = None,
    state_names: tuple[Name, ...] | None = None,
) -> Table:  # fmt: skip
    """Rows of outcomes, those that terminate led to states that are over (``FiniteMDP.from_gymnasium`` says which)."""
    n_own = len(initial)
    row, to = moves.state * n_actions + moves.action, moves.next_state
    probability, reward, terminated = moves.probability, moves.reward, moves.terminated
    entered_alive, entered_dead = np.zeros(n_own, dtype=bool), np.zeros(n_own, dtype=bool)
    entered_alive[to[~terminated]] = True
    entered_dead[to[terminated]] = True
    entered_alive |= initial > 0
    terminal_state = np.arange(n_own, dtype=np.int64)
    twins = np.flatnonzero(entered_dead & entered_alive)
    terminal_state[twins] = n_own + np.arange(len(twins))
    n_states = n_own + len(twins)
    to = np.where(terminated, terminal_state[to], to)
    over = np.concatenate([np.flatnonzero(entered_dead & ~entered_alive), terminal_state[twins]])
    kept = ~np.isin(row // n_actions, over)
    stay_rows = (over[:, None] * n_actions + np.arange(n_actions)).reshape(-1)
    rows = np.concatenate([row[kept], stay_rows])
    columns = np.concatenate([to[kept], np.repeat(over, n_actions)])
    weights = np.concatenate([probability[kept], np.ones(len(stay_rows))])
    paid = np.concatenate([reward[kept], np.zeros(len(stay_rows))])
    shape = (n_states * n_actions, n_states)
    transitions = canonical(sparse.csr_array((weights, (rows, columns)), shape=shape), drop_zeros=True)
    flow = canonical(sparse.csr_array((weights * paid, (rows, columns)), shape=shape), drop_zeros=False)
    mean, _ = align(flow, transitions)
    rewards = sparse.csr_array((mean / transitions.data, transitions.indices, transitions.indptr), shape)
    layout = coordinates(state_names) if layout is None else layout
    if layout is not None:
        layout = np.concatenate([layout, layout[twins]])
    if state_names is not None:
        state_names += tuple(_over(state_names[s]) for s in twins)
    start = np.concatenate([initial, np.zeros(len(twins))])
    return Table(transitions, rewards, start, terminal_state, layout, state_names)


def _over(name: Name) -> Name:
    """What the twin of a state is called, in which the episode is over."""
    return (*name, "over") if isinstance(name, tuple) else f"{name} (over)"
