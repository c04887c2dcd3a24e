"""Assignment 2: the true ratio of two environments, its support, and the log's."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio import transition_ratio
from oee_tabular.ratio import true_ratio as ratio_of
from oee_tabular.testing.assignments.drawing import draw_counts, draw_rows
from oee_tabular.testing.assignments.judging import Arguments, Kind, Mistake, Task
from oee_tabular.typing import Array, BoolArray


def _as_mdp(P: Array) -> FiniteMDP:
    n = P.shape[0]
    return FiniteMDP(P, np.zeros(P.shape[:2]), np.full(n, 1 / n), 0.9)


TINY = 1e-6  # a small probability
MINUTE = 1e-9  # the smallest one that is drawn
RARE = 1e-3  # above small probabilities, and below all others


def _draw_pair(
    rng: np.random.Generator,
    *,
    n_states: int | None = None,
    n_actions: int = 2,
    simulator_has_zeros: bool = False,
    target_has_zeros: bool = False,
) -> Arguments:
    """Draw a target in the support of a simulator."""
    n_states = int(rng.integers(3, 5)) if n_states is None else n_states
    shape = (n_states, n_actions, n_states)
    simulator = draw_rows(rng, shape, has_zeros=simulator_has_zeros)
    target = draw_rows(rng, shape, has_zeros=False) * (simulator > 0)
    if target_has_zeros:
        largest = simulator == simulator.max(axis=-1, keepdims=True)
        target *= largest | (rng.random(shape) < 0.6)
    target /= target.sum(axis=-1, keepdims=True)
    return {"target": target, "simulator": simulator}


def _draw_tiny(
    rng: np.random.Generator, *, size: float, is_tiny_in_target: bool
) -> Arguments:
    """Draw a transition that the simulator, and perhaps the target, makes rarely."""
    pair = _draw_pair(rng)
    for name, P in pair.items():
        if name == "simulator" or is_tiny_in_target:
            for s, a in np.ndindex(*P.shape[:2]):
                t = (s + a) % P.shape[2]
                P[s, a, t] = 0.0
                P[s, a] /= P[s, a].sum()
                P[s, a, t] = size * (2.0 if name == "target" else 1.0)
                P[s, a] /= P[s, a].sum()
    return pair


def _draw_certain(rng: np.random.Generator) -> Arguments:
    """Draw transitions that are certain in both."""
    n = int(rng.integers(3, 5))
    P = np.eye(n)[rng.integers(n, size=(n, 2))]
    return {"target": P.copy(), "simulator": P}


def _draw_equal(rng: np.random.Generator) -> Arguments:
    pair = _draw_pair(rng, simulator_has_zeros=True)
    return pair | {"target": pair["simulator"].copy()}


def _draw_outside(
    rng: np.random.Generator, *, size: float, n_outside: int = 1
) -> Arguments:
    """Draw a target with transitions that the simulator never makes.

    Other actions and other states of the simulator make it, or one of the two never
    does.
    """
    pair = _draw_pair(rng)
    places = [tuple(map(int, place)) for place in np.ndindex(*pair["target"].shape)]
    for k in rng.permutation(len(places))[:n_outside]:
        s, a, t = places[k]
        rows: tuple[Any, Any] = ((s, a), (s, slice(None)), (slice(None), a))[
            rng.integers(3)
        ]
        _put_outside(pair, (s, a, t), rows, size)
    return pair


def _draw_narrow(rng: np.random.Generator, *, size: float) -> Arguments:
    """Draw a target that does less than the simulator, with one exception.

    The row of the exception makes no more transitions than the simulator's, and no
    other state of the target leads to its state.
    """
    pair = _draw_pair(rng, target_has_zeros=True)
    target, simulator = pair["target"], pair["simulator"]
    n_states, n_actions = target.shape[:2]
    s = int(rng.integers(1, n_states))
    place = s, int(rng.integers(n_actions)), int(rng.integers(n_states))
    _put_outside(pair, place, place[:2], size)
    others = np.arange(n_states) != s
    away = target[others]
    away[:, :, s] = 0.0
    rows = simulator[others] * others
    most = rows == rows.max(axis=-1, keepdims=True)
    away = np.where(away.sum(axis=-1, keepdims=True) > 0, away, most)
    target[others] = away / away.sum(axis=-1, keepdims=True)
    row = target[place[:2]]
    row[place[2]] = 0.0
    row[row < row.max()] = 0.0
    row *= (1.0 - size) / row.sum()
    row[place[2]] = size
    return pair


def _put_outside(
    pair: Arguments, place: tuple[int, int, int], rows: tuple[Any, Any], size: float
) -> None:
    """Take a next state from rows of both, and give it to the target in one place."""
    target, simulator = pair["target"], pair["simulator"]
    s, a, t = place
    simulator[(*rows, t)] = 0.0
    target[(*rows, t)] = 0.0
    simulator /= simulator.sum(axis=-1, keepdims=True)
    target /= np.maximum(target.sum(axis=-1, keepdims=True), 1e-300)
    empty = target.sum(axis=-1) == 0
    target[empty] = simulator[empty]
    target[s, a] *= 1.0 - size
    target[s, a, t] = size


def _draw_rare_target(rng: np.random.Generator) -> Arguments:
    """Draw a target with zeros and with a transition of 1e-6 in each row."""
    pair = _draw_pair(rng, target_has_zeros=True)
    target = pair["target"]
    for s, a in np.ndindex(*target.shape[:2]):
        target[s, a, int(target[s, a].argmin())] = TINY
    target[-1, -1, int(target[-1, -1].argmin())] = 0.0
    target /= target.sum(axis=-1, keepdims=True)
    return pair


_ANY_SIZE = (
    "a small probability is a probability: compare with 0, and with no other number."
)
_EACH_ROW = (
    "each pair (s, a) has a row of its own. Compare entry by entry, with nothing summed"
    " or counted over states or actions, and with no state left out."
)

SUPPORT_KINDS = (
    Kind("", partial(_draw_outside, size=0.3), _EACH_ROW),
    Kind("both have full support", _draw_pair),
    Kind(
        "the simulator does more than the target",
        partial(_draw_pair, target_has_zeros=True),
        "the simulator may do more than the target.",
    ),
    Kind("both have zeros", partial(_draw_pair, simulator_has_zeros=True)),
    Kind(
        "two probabilities of the target are 1e-6",
        partial(_draw_outside, size=TINY, n_outside=2),
        _ANY_SIZE + " One transition outside is enough, and so are two.",
    ),
    Kind(
        "a probability of the target is 1e-9",
        partial(_draw_outside, size=MINUTE),
        _ANY_SIZE,
    ),
    Kind(
        "probabilities of the simulator are 1e-9",
        partial(_draw_tiny, size=MINUTE, is_tiny_in_target=False),
        _ANY_SIZE,
    ),
    Kind(
        "the target does less than the simulator, with one exception",
        partial(_draw_narrow, size=0.3),
        _EACH_ROW,
    ),
    Kind("the two are equal", _draw_equal),
    Kind("transitions are certain", _draw_certain),
)

_NO_FLOOR = (
    "divide by the simulator's probability as it is, however small: a floor under it or"
    " a number added to it changes the ratio. Treat zeros apart."
)
_NEITHER = "where the simulator never goes, write 0."


def _is_never_simulated(_: Array, simulator: Array) -> BoolArray:
    return np.asarray(simulator == 0)


def _is_rarely_simulated(_: Array, simulator: Array) -> BoolArray:
    return np.asarray(simulator < RARE)


def _is_unrecorded(counts: Array, _: Array) -> BoolArray:
    return np.asarray((counts.sum(axis=-1, keepdims=True) == 0) & (counts == 0))


RATIO_KINDS = (
    Kind("", _draw_pair),
    Kind(
        "the simulator has zeros",
        partial(_draw_pair, simulator_has_zeros=True),
        _NEITHER,
        _is_never_simulated,
    ),
    Kind(
        "the target has zeros and entries of 1e-6, and the simulator has neither",
        _draw_rare_target,
        "where the target never goes and the simulator does, the quotient is 0; where it"
        " goes rarely, the quotient is small and not 0.",
    ),
    Kind(
        "probabilities of both are near 1e-6",
        partial(_draw_tiny, size=TINY, is_tiny_in_target=True),
        _NO_FLOOR,
        _is_rarely_simulated,
    ),
    Kind(
        "probabilities of the simulator are 1e-9",
        partial(_draw_tiny, size=MINUTE, is_tiny_in_target=False),
        "a ratio may be very large and is not cut; " + _NO_FLOOR,
        _is_rarely_simulated,
    ),
    Kind(
        "probabilities of both are near 1e-9",
        partial(_draw_tiny, size=MINUTE, is_tiny_in_target=True),
        _NO_FLOOR,
        _is_rarely_simulated,
    ),
    Kind(
        "both have zeros",
        partial(_draw_pair, simulator_has_zeros=True, target_has_zeros=True),
        _NEITHER,
        _is_never_simulated,
    ),
    Kind(
        "the two are equal",
        _draw_equal,
        "the ratio is 1 where both go, and 0 where neither does.",
    ),
    Kind(
        "there are more actions than states",
        partial(_draw_pair, n_states=2, n_actions=5),
        "the axes are state, action and next state; take no number of one for another.",
    ),
    Kind("transitions are certain", _draw_certain, _NEITHER, _is_never_simulated),
)


def _draw_log(
    rng: np.random.Generator,
    *,
    least: int = 3,
    most: int = 12,
    n_unrecorded: int = 0,
    is_unequal: bool = False,
    simulator_has_zeros: bool = False,
    n_states: int | None = None,
    n_actions: int = 2,
) -> Arguments:
    """Draw the counts of a log of the target."""
    pair = _draw_pair(
        rng,
        n_states=n_states,
        n_actions=n_actions,
        simulator_has_zeros=simulator_has_zeros,
    )
    shape = pair["target"].shape[:2]
    n = rng.integers(least, most, size=shape)
    n[-1, -1] = least
    if is_unequal:
        n[0] = 100_000
    n.ravel()[rng.permutation(n.size)[:n_unrecorded]] = 0
    counts = draw_counts(rng, n, pair["target"])
    if is_unequal:  # of 100 000 transitions one leads to each pair's rarest state
        np.put_along_axis(counts[0], counts[0].argmin(axis=-1)[:, None], 1, axis=-1)
    return {"counts": counts, "simulator": pair["simulator"]}


def _draw_impossible(rng: np.random.Generator) -> Arguments:
    """Draw a log with transitions that the simulator never makes, one pair's alone."""
    drawn = _draw_log(rng, simulator_has_zeros=True)
    simulator, counts = drawn["simulator"], drawn["counts"]
    counts[-1, 0] = 0
    for s in range(len(simulator)):
        t = (int(simulator[s, 0].argmax()) + 1) % len(simulator)
        simulator[s, 0, t] = 0.0
        simulator[s, 0] /= simulator[s, 0].sum()
        counts[s, 0, t] = int(rng.integers(1, 5))
    return drawn


def _draw_tiny_simulator(rng: np.random.Generator) -> Arguments:
    """Draw a log with transitions to which the simulator gives 1e-9."""
    pair = _draw_tiny(rng, size=MINUTE, is_tiny_in_target=False)
    n = rng.integers(20, 40, size=pair["target"].shape[:2])
    counts = draw_counts(rng, n, pair["target"])
    return {"counts": counts, "simulator": pair["simulator"]}


_UNRECORDED = (
    "a pair (s, a) without counts keeps the simulator: its ratio is 1 where the simulator"
    " goes, and 0 where it does not."
)
_OWN_SUM = (
    "each pair (s, a) has a sum of counts of its own, and one transition is enough to"
    " be recorded. Large counts are not cut, and a small frequency is no 0."
)

COUNTS_KINDS = (
    Kind("", _draw_log),
    Kind(
        "the simulator has zeros",
        partial(_draw_log, simulator_has_zeros=True),
        _NEITHER,
        _is_never_simulated,
    ),
    Kind(
        "two pairs were never recorded",
        partial(_draw_log, n_unrecorded=2),
        _UNRECORDED,
        _is_unrecorded,
    ),
    Kind(
        "pairs were never recorded, and the simulator has zeros",
        partial(_draw_log, n_unrecorded=3, simulator_has_zeros=True),
        _UNRECORDED,
        _is_unrecorded,
    ),
    Kind(
        "the log has transitions that the simulator never makes",
        _draw_impossible,
        "such a transition counts in n(s, a), and its own ratio is 0. The other"
        " frequencies of its pair are not made larger, and a pair that has only such ones"
        " was recorded all the same: all its ratios are 0.",
    ),
    Kind(
        "probabilities of the simulator are 1e-9",
        _draw_tiny_simulator,
        "a ratio may be very large and is not cut; " + _NO_FLOOR,
        _is_rarely_simulated,
    ),
    Kind(
        "pairs have one or two transitions, and others about 100 000",
        partial(_draw_log, least=1, most=3, is_unequal=True),
        _OWN_SUM,
    ),
    Kind(
        "nothing was recorded",
        partial(_draw_log, n_unrecorded=100, simulator_has_zeros=True),
        _UNRECORDED,
        _is_unrecorded,
    ),
    Kind(
        "there are more actions than states",
        partial(_draw_log, n_states=2, n_actions=5),
        "the axes are state, action and next state; take no number of one for another.",
    ),
)


def _has_support(target: Array, simulator: Array) -> bool:
    try:
        ratio_of(_as_mdp(target), _as_mdp(simulator))
    except ValueError:  # it names the transition
        return False
    return True


def _true_ratio(target: Array, simulator: Array) -> Array:
    found = ratio_of(_as_mdp(target), _as_mdp(simulator)).values
    return np.asarray(found.toarray()).reshape(target.shape)


def _explain_support(target: Array, simulator: Array) -> str:
    outside = np.argwhere((target > 0) & (simulator == 0))
    if len(outside) == 0:
        return "The simulator makes every transition that the target makes."
    s, a, t = (int(k) for k in outside[0])
    return (
        f"In state {s} action {a} leads to state {t} with probability"
        f" {target[s, a, t]:.2g} in the target, and never in the simulator."
    )


def _ratio_from_counts(counts: Array, simulator: Array) -> Array:
    """Compute the ratio of the frequencies of all counts, where the simulator goes.

    The package's ratio is of the transitions that the simulator can make; their share
    of a row's counts makes it that of all.
    """
    mdp = _as_mdp(simulator)
    possible = np.where(simulator > 0, counts, 0)
    if not possible.any():
        found = 1.0 * (simulator > 0)
    else:
        log = sparse.csr_array(possible.reshape(-1, counts.shape[-1]))
        ratio = transition_ratio(log, mdp, prior="none").values
        found = np.asarray(ratio.toarray()).reshape(counts.shape)
    n = counts.sum(axis=-1, keepdims=True)
    share = np.where(
        n > 0, possible.sum(axis=-1, keepdims=True) / np.maximum(n, 1), 1.0
    )
    return np.asarray(found * share)


SUPPORT = Task(
    name="2_support",
    call="has_support(target, simulator)",
    kinds=SUPPORT_KINDS,
    explain=_explain_support,
    solve=_has_support,
    hint="the answer is False if there is a transition with target > 0 and simulator"
    " == 0, and True else.",
    mistakes=(
        Mistake(
            lambda target, simulator: bool(np.all((simulator > 0) <= (target > 0))),
            "the other way round: the simulator may do more than the target, and not"
            " less.",
        ),
        Mistake(
            lambda target, simulator: bool(np.all((simulator > 0) == (target > 0))),
            "the supports need not be equal: the simulator may do more.",
        ),
        Mistake(
            lambda target, simulator: bool(np.all(simulator > 0)),
            "a transition that neither of the two makes is no fault.",
        ),
        Mistake(
            lambda target, simulator: bool(np.all((simulator > 0) | (target < 1e-6))),
            "a small probability is a probability; compare with 0.",
        ),
        Mistake(
            lambda target, simulator: bool(
                np.all((simulator.sum(axis=1) > 0) | (target.sum(axis=1) == 0))
            ),
            "each action has a row of its own; do not sum over actions.",
        ),
        Mistake(
            lambda target, simulator: bool(
                np.all((simulator.sum(axis=0) > 0) | (target.sum(axis=0) == 0))
            ),
            "each state has a row of its own; do not sum over states.",
        ),
        Mistake(
            lambda target, simulator: bool(
                np.count_nonzero(target) <= np.count_nonzero(simulator)
            ),
            "how many transitions there are says nothing; compare them one by one.",
        ),
        Mistake(
            lambda target, simulator: bool(
                np.all((target > 0).sum(axis=-1) <= (simulator > 0).sum(axis=-1))
            ),
            "how many transitions a pair has says nothing; compare them one by one.",
        ),
        Mistake(
            lambda target, simulator: bool(
                np.all(simulator.transpose(2, 1, 0)[target > 0] > 0)
            ),
            "the simulator's states and next states are exchanged.",
        ),
        Mistake(
            lambda target, simulator: bool(np.all(target <= simulator)),
            "the target's probability may be larger; only a 0 of the simulator matters.",
        ),
        Mistake(
            lambda target, simulator: not _has_support(target, simulator),
            "True and False are exchanged.",
        ),
        Mistake(
            lambda target, simulator: True,
            "this is True in every case. One common transition is not enough: it must be"
            " False where a single transition leaves the simulator's support.",
        ),
        Mistake(
            lambda target, simulator: False,
            "this is False in every case; it must be True for a target that stays in the simulator's"
            " support.",
        ),
    ),
)

RATIO = Task(
    name="2_ratio",
    call="true_ratio(target, simulator)",
    kinds=RATIO_KINDS,
    is_entrywise=True,
    axes=("state", "action", "next state"),
    solve=_true_ratio,
    hint="zeta[s, a, t] = target[s, a, t] / simulator[s, a, t], and 0 where the simulator"
    " has 0.",
    mistakes=(
        Mistake(
            lambda target, simulator: simulator / target,
            "the ratio is target over simulator: it weights simulated transitions.",
        ),
        Mistake(
            lambda target, simulator: np.minimum(
                np.divide(
                    target, simulator, out=np.zeros(target.shape), where=simulator > 0
                ),
                1.0,
            ),
            "a ratio may be above 1, where the target goes more often.",
        ),
        Mistake(
            lambda target, simulator: target / simulator,
            "0 / 0 is nan; where the simulator never goes, write 0.",
        ),
        Mistake(
            lambda target, simulator: np.nan_to_num(target / simulator, nan=1.0),
            "where the simulator never goes, write 0, and not 1.",
        ),
        Mistake(
            lambda target, simulator: target * simulator,
            "this is the product; the ratio is a quotient.",
        ),
        Mistake(
            lambda target, simulator: 1.0 * (simulator > 0),
            "these are ones: the ratio of equal probabilities.",
        ),
        Mistake(
            lambda target, simulator: target - simulator,
            "this is the difference; the ratio is a quotient.",
        ),
        Mistake(
            lambda target, simulator: np.log(target / simulator),
            "this is the logarithm of the ratio.",
        ),
        Mistake(
            lambda target, simulator: np.clip(target / simulator, 0.0, 1.0),
            "a ratio may be above 1, where the target goes more often.",
        ),
        Mistake(
            lambda target, simulator: (
                lambda z: z / np.nansum(z, axis=-1, keepdims=True)
            )(target / simulator),
            "the ratio itself need not sum to 1. What sums to 1 is simulator * ratio.",
        ),
        Mistake(
            lambda target, simulator: target / (simulator + 1e-3),
            "a number added to the denominator changes every ratio; treat zeros apart.",
        ),
        Mistake(
            lambda target, simulator: np.nan_to_num(
                target / simulator.mean(axis=1, keepdims=True)
            ),
            "each action has a row of its own; do not average over actions.",
        ),
        Mistake(
            lambda target, simulator: target.copy(),
            "these are the target's probabilities; divide them by the simulator's.",
        ),
        Mistake(
            lambda target, simulator: np.nan_to_num(
                target / simulator.sum(axis=1, keepdims=True)
            ),
            "each action has a row of its own; do not sum over actions.",
        ),
        Mistake(
            lambda target, simulator: np.nan_to_num(
                target / simulator.transpose(2, 1, 0)
            ),
            "the simulator's states and next states are exchanged.",
        ),
    ),
)


def _pseudo_counts(counts: Array, simulator: Array) -> Array:
    more = counts + (simulator > 0)
    return np.asarray(np.nan_to_num(more / more.sum(-1, keepdims=True) / simulator))


def _frequencies(counts: Array, *, axis: int = -1) -> Array:
    with np.errstate(all="ignore"):
        return np.asarray(counts / counts.sum(axis=axis, keepdims=True))


def _possible_alone(counts: Array, simulator: Array) -> Array:
    return _ratio_from_counts(np.where(simulator > 0, counts, 0), simulator)


def _over_the_simulator(model: Array, simulator: Array) -> Array:
    return np.asarray(np.nan_to_num(model / simulator, posinf=0.0))


def _shrunk(counts: Array, simulator: Array, *, strength: float) -> Array:
    """Compute the ratio of a Dirichlet prior at the simulator; 0: as many as states."""
    kappa = strength or counts.shape[-1]
    mean = (counts + kappa * simulator) / (counts.sum(-1, keepdims=True) + kappa)
    return _over_the_simulator(mean, simulator)


def _one_added_below(counts: Array, simulator: Array, *, more: float) -> Array:
    n = counts.sum(axis=-1, keepdims=True) + more
    return _over_the_simulator(counts / n, simulator)


def _ones_where_not_seen(counts: Array, simulator: Array) -> Array:
    found = _ratio_from_counts(counts, simulator)
    return np.where((counts == 0) & (simulator > 0), 1.0, found)


def _by_sums(counts: Array, simulator: Array, *, axes: int | tuple[int, int]) -> Array:
    """Compute the ratio of counts to sums over other axes, 1 where these are 0."""
    sums = np.broadcast_to(counts.sum(axis=axes, keepdims=True), counts.shape)
    quotients = np.nan_to_num(counts / sums / simulator, posinf=0.0)
    return np.where(sums > 0, quotients, 1.0 * (simulator > 0))


def _ones_where_unrecorded(counts: Array, simulator: Array) -> Array:
    is_recorded = counts.sum(axis=-1, keepdims=True) > 0
    return np.where(is_recorded, _ratio_from_counts(counts, simulator), 1.0)


FROM_COUNTS = Task(
    name="2_counts",
    call="ratio_from_counts(counts, simulator)",
    kinds=COUNTS_KINDS,
    is_entrywise=True,
    axes=("state", "action", "next state"),
    solve=_ratio_from_counts,
    hint="the frequencies of a pair, counts / (sum of the pair's counts), take the place"
    " of the target, and are divided by the simulator's probabilities.",
    mistakes=(
        Mistake(
            lambda counts, simulator: (
                counts / counts.sum(axis=-1, keepdims=True) / simulator
            ),
            "0 / 0 is nan: in a pair without counts, whose ratio is 1, and where the"
            " simulator never goes, where it is 0.",
        ),
        Mistake(
            lambda counts, simulator: np.nan_to_num(counts / simulator),
            "counts are no probabilities; divide each row by its sum.",
        ),
        Mistake(
            lambda counts, simulator: np.nan_to_num(counts / counts.sum() / simulator),
            "divide each row by its own sum, and not by the sum of all counts.",
        ),
        Mistake(
            lambda counts, simulator: np.nan_to_num(
                counts / counts.sum(axis=-1, keepdims=True) / simulator
            ),
            "a pair without counts says nothing: its ratio is 1 where the simulator goes.",
        ),
        Mistake(
            lambda counts, simulator: np.where(
                simulator > 0,
                counts / counts.sum(axis=-1, keepdims=True) / simulator,
                0.0,
            ),
            "a pair without counts says nothing: its ratio is 1 where the simulator goes.",
        ),
        Mistake(
            lambda counts, simulator: np.nan_to_num(
                counts / counts.sum(axis=-1, keepdims=True)
            ),
            "these are the frequencies; divide them by the simulator's probabilities.",
        ),
        Mistake(
            _pseudo_counts,
            "one more count each is a prior. Here the frequencies are asked for.",
        ),
        Mistake(
            lambda counts, simulator: np.nan_to_num(
                counts / counts.sum(axis=0, keepdims=True) / simulator
            ),
            "the sum is over the next state, the last axis, and not over states.",
        ),
        Mistake(
            lambda counts, simulator: np.nan_to_num(
                _frequencies(counts, axis=1) / simulator
            ),
            "the sum is over the next state, the last axis, and not over actions.",
        ),
        Mistake(
            partial(_by_sums, axes=(1, 2)),
            "each pair (s, a) has a sum of its own: divide by n(s, a), and not by the sum"
            " of the state.",
        ),
        Mistake(
            partial(_by_sums, axes=0),
            "the sum is over the next state, the last axis, and not over states.",
        ),
        Mistake(
            partial(_by_sums, axes=1),
            "the sum is over the next state, the last axis, and not over actions.",
        ),
        Mistake(
            partial(_by_sums, axes=(0, 1)),
            "the sum is over the next state, the last axis, and not over states and"
            " actions.",
        ),
        *(
            Mistake(
                partial(_one_added_below, more=more),
                "a number that is added to n(s, a), or taken from it, changes every ratio;"
                " treat pairs without counts apart.",
            )
            for more in (1.0, -1.0)
        ),
        *(
            Mistake(
                partial(_shrunk, strength=strength),
                f"the simulator counts as {said} more of each pair. That is a prior; here"
                " the frequencies are asked for.",
            )
            for strength, said in (
                (0.5, "half a transition"),
                (1.0, "one transition"),
                (2.0, "two transitions"),
                (10.0, "ten transitions"),
                (0.0, "as many transitions as there are states"),
            )
        ),
        Mistake(
            lambda counts, simulator: counts.astype(float),
            "these are the counts; divide each row by its sum, and by the simulator's"
            " probabilities.",
        ),
        Mistake(
            lambda counts, simulator: simulator.copy(),
            "these are the simulator's probabilities; the log's frequencies are divided"
            " by them.",
        ),
        Mistake(
            lambda counts, simulator: _frequencies(counts) - simulator,
            "this is the difference; the ratio is a quotient.",
        ),
        Mistake(
            lambda counts, simulator: _over_the_simulator(
                counts // counts.sum(axis=-1, keepdims=True), simulator
            ),
            "// cuts the fractions off; divide with /.",
        ),
        Mistake(
            lambda counts, simulator: _over_the_simulator(
                counts / counts.max(axis=-1, keepdims=True), simulator
            ),
            "divide each row by its sum, and not by its largest count.",
        ),
        Mistake(
            lambda counts, simulator: _over_the_simulator(
                counts / (counts > 0).sum(axis=-1, keepdims=True), simulator
            ),
            "divide each row by its sum, and not by the number of its entries.",
        ),
        Mistake(
            _ones_where_not_seen,
            "only a pair (s, a) without any count keeps the simulator. In a recorded"
            " pair a next state that was not seen has the frequency 0, and the ratio 0.",
        ),
        Mistake(
            _possible_alone,
            "a transition that the simulator never makes counts in n(s, a) all the same:"
            " divide by the sum of all counts of the pair.",
        ),
        Mistake(
            _ones_where_unrecorded,
            "a pair without counts has the ratio 1 only where the simulator goes, and 0"
            " where it does not.",
        ),
        Mistake(
            lambda counts, simulator: np.nan_to_num(
                simulator / _frequencies(counts), posinf=0.0
            ),
            "the ratio is the log's frequencies over the simulator, and not the inverse.",
        ),
        Mistake(
            lambda counts, simulator: np.minimum(
                _ratio_from_counts(counts, simulator), 1.0
            ),
            "a ratio may be above 1, where the target goes more often.",
        ),
        Mistake(
            lambda counts, simulator: (
                lambda mean: np.nan_to_num(mean / simulator, posinf=0.0)
            )(
                counts.sum(axis=1, keepdims=True)
                / counts.sum(axis=(1, 2), keepdims=True)
            ),
            "each action has counts of its own; do not sum over actions.",
        ),
    ),
)

TASKS = (SUPPORT, RATIO, FROM_COUNTS)
