"""Trials: whole runs of a policy in the target of which only the outcome was written.

A trial has a return, or it succeeded or failed. The trials of a policy say something of
its value J and nothing of a single transition::

    E Y = J,   mean = sum w y / sum w,   m = (sum w)^2 / sum w^2

with outcomes y and weights w (1 without any). ``inference.trials`` joins them with a
log. The quantity that was tried must be the one that is evaluated: the same discount,
the same horizon and, for successes, a simulator that pays 1 on entering success and
nothing else (``success_simulator`` makes it of any simulator).
"""

from __future__ import annotations

import json
import operator
import os
import sys
from collections.abc import Container, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self, TypeAlias

import numpy as np

from oee_tabular import _checks, _files
from oee_tabular._keywords import suggest_keywords
from oee_tabular.data.tables import csv_frame, read_labels
from oee_tabular.exceptions import ArgumentError, DataWarning
from oee_tabular.mdp import (
    FiniteMDP,
    Name,
    check_policy,
    find_misspelt,
    number_of,
    total_discount,
)
from oee_tabular.typing import Array, BoolArray, IntArray, PolicyLike, RealArrayLike

# a name or a number of a state, or several
StatesLike: TypeAlias = Name | int | Sequence[Name | int] | IntArray
# of the largest possible return: how far a return may be beyond it, by rounding
RETURN_TOLERANCE = 1e-6
COLUMNS = ("policy", "success", "return", "weight")
# a letter away from policy and weight, and words of their own
OTHER_WORDS = {"police", "height", "eight"}
FLAGS = {"true": 1.0, "false": 0.0, "yes": 1.0, "no": 0.0, "1": 1.0, "0": 0.0}
LARGEST = sys.float_info.max
MAX_TRIALS = 10**8  # that counts of successes may stand for


@suggest_keywords
@dataclass(frozen=True, eq=False, repr=False, init=False)
class Trials:
    """Hold the outcomes of whole runs of a policy in the target.

    Each trial starts as the problem's ``initial`` says, and the trials are independent
    of each other and of the log. ``oee.Problem(simulator, log, trials=trials)`` joins
    them with the log. Every parameter is also an attribute, and ``len(trials)`` is the
    number of trials.

    Parameters
    ----------
    returns : array_like of shape (m,)
        The return of each trial: its sum of discount^t * reward, not normalised.
    policy : str, sequence of str, or array_like, optional
        What was tried: the name of one of the policies that are evaluated, a name for
        each trial, or the policy itself as an array of shape (S, A) or (S,). None means
        the one policy that is evaluated.
    discount : float, optional
        The discount of the returns, in [0, 1]. None means the problem's.
    horizon : int, optional
        The number of rewards in a return. None means the problem's.
    weight : array_like of shape (m,), optional
        The positive weight of each trial in the mean, for trials that were not drawn as
        often as the problem has them. None means that all count the same.

    Raises
    ------
    ValueError
        If there are no trials, if a return is not finite, or if an argument is out of
        its range.

    See Also
    --------
    Trials.from_successes : Make trials of a number of successes.
    Trials.load : Read trials from a file.

    Notes
    -----
    Paired tests of two policies, sequential tests (betting) and the power of a plan of
    trials are other questions, for which there are other packages.

    Examples
    --------
    >>> trials = Trials([3.0, 1.0, 2.0, 2.0])
    >>> trials
    Trials(4 returns: mean 2, standard deviation 0.816)
    >>> Trials.from_successes(9, 12)
    Trials(9 of 12 succeeded)
    """

    returns: Array
    policy: str | tuple[str, ...] | Array | None
    discount: float | None
    horizon: int | None
    weight: Array | None
    success: tuple[Name | int, ...] | None
    is_success: bool

    def __init__(
        self,
        returns: RealArrayLike,
        *,
        policy: str | Sequence[str] | PolicyLike | None = None,
        discount: float | None = None,
        horizon: int | None = None,
        weight: RealArrayLike | None = None,
    ) -> None:
        values = _checks.float_array(returns, "returns", ndim=1)
        if not len(values):
            raise ArgumentError("returns", "must have at least one trial; it is empty")
        _checks.require_finite(values, "returns")
        if discount is not None:
            discount = _checks.number_in(discount, "discount", 0.0, 1.0)
        fields = {
            "returns": _checks.freeze(values),
            "policy": _check_tried(policy, len(values)),
            "discount": discount,
            "horizon": _checks.optional_horizon(horizon),
            "weight": _check_weight(weight, len(values)),
            "success": None,
            "is_success": False,
        }
        for name, value in fields.items():
            object.__setattr__(self, name, value)

    @classmethod
    @suggest_keywords
    def from_successes(
        cls,
        successes: int,
        trials: int,
        *,
        success: StatesLike | None = None,
        policy: str | PolicyLike | None = None,
        horizon: int | None = None,
    ) -> Self:
        """Make trials of the number that succeeded.

        Success is to enter one of some states. Its discount is 1, and a trial that
        succeeds has the return 1.

        Parameters
        ----------
        successes : int
            The number of trials that succeeded, from 0 to ``trials``.
        trials : int
            The number of trials, at least 1.
        success : state or sequence of states, optional
            The states, by name or number, whose entering is success. The problem must
            pay 1 on entering them and nothing else. None means the states on whose
            entering the problem pays 1.
        policy : str or array_like, optional
            What was tried, as in ``Trials``.
        horizon : int, optional
            The number of steps of a trial. None means the problem's.

        Returns
        -------
        Trials
            The trials, with the discount 1.

        Raises
        ------
        ValueError
            If there are more successes than trials, or a number is out of its range.

        See Also
        --------
        oee_tabular.data.success_simulator : Make a simulator that pays for success.

        Examples
        --------
        >>> trials = Trials.from_successes(9, 12)
        >>> len(trials), trials.mean
        (12, 0.75)
        """
        number = _checks.positive_integer(trials, "trials")
        if number > MAX_TRIALS:
            raise ArgumentError(
                "trials", f"must be at most {MAX_TRIALS}; it is {number}"
            )
        won = _check_successes(successes, number)
        if won > number:
            raise ArgumentError(
                "successes", f"must be at most trials, {number}; it is {won}"
            )
        outcomes = np.zeros(number)
        outcomes[:won] = 1.0
        made = cls(outcomes, policy=policy, discount=1.0, horizon=horizon)
        return made._as_successes(success)

    @classmethod
    @suggest_keywords
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        measure: Literal["success", "return"] | None = None,
        success: StatesLike | None = None,
        task: str | None = None,
        discount: float | None = None,
        horizon: int | None = None,
    ) -> Self:
        """Read trials from a CSV table or from LeRobot's ``eval_info.json``.

        A CSV table has a row for each trial, with the column ``success`` (1 or 0, true
        or false) or ``return``, and may have ``policy`` (a name) and ``weight``. Of an
        ``eval_info.json`` the outcome of each episode is read.

        Parameters
        ----------
        path : str or path
            A .csv or .json file.
        measure : {'success', 'return'}, optional
            Which outcome is read. None means success where the file has it, else the
            return. The return of LeRobot is its sum of rewards, at discount 1.
        success : state or sequence of states, optional
            The states whose entering is success, as in ``from_successes``.
        task : str, optional
            The task of an ``eval_info.json`` with several, as "group/number".
        discount : float, optional
            The discount of the returns of a CSV table. None means the problem's.
        horizon : int, optional
            The number of rewards in a return. None means the problem's.

        Returns
        -------
        Trials
            The trials of the file, in its order.

        Raises
        ------
        ValueError
            If the file has another form, or a row breaks a rule; the error names the
            file, the row, the rule and the value.
        """
        name = _files.local(path)
        if measure is not None:
            _checks.one_of(measure, "measure", ("success", "return"))
        if discount is not None:
            discount = _checks.number_in(discount, "discount", 0.0, 1.0)
        suffix = Path(name).suffix.lower()
        if suffix == ".csv":
            if task is not None:
                raise ArgumentError(
                    "task", "must be None for a CSV file, which has no tasks"
                )
            table = _read_table(name, measure)
        elif suffix == ".json":
            table = _read_lerobot(name, measure, task)
            if table["is_success"] or discount is None:
                discount = None if table["is_success"] else 1.0
        else:
            raise ArgumentError("path", f"must end in .csv or .json; it is {name!r}")
        if discount is not None:
            discount = _checks.number_in(discount, "discount", 0.0, 1.0)
        if table["is_success"] and discount not in (None, 1.0):
            raise ArgumentError(
                "discount",
                f"must be 1 or None for successes; it is {_checks.show(discount)}",
            )
        made = cls(
            table["outcome"],
            policy=table["policy"],
            discount=1.0 if table["is_success"] else discount,
            horizon=horizon,
            weight=table["weight"],
        )
        if table["is_success"]:
            return made._as_successes(success)
        if success is not None:
            raise ArgumentError("success", "must be None for returns")
        return made

    def _as_successes(self, success: StatesLike | None) -> Self:
        """Return the same trials with outcomes that are successes."""
        object.__setattr__(self, "is_success", True)
        if success is not None:
            object.__setattr__(self, "success", _check_states(success))
        return self

    def __len__(self) -> int:
        return len(self.returns)

    def __repr__(self) -> str:
        return f"Trials({self.describe()})"

    def describe(self) -> str:
        """Say how many trials there are, and what came of them.

        Returns
        -------
        str
            A phrase such as "9 of 12 succeeded".
        """
        if self.is_success and self.weight is None:
            return f"{int(self.returns.sum())} of {len(self)} succeeded"
        what = "successes and failures" if self.is_success else "returns"
        spread = ""
        if len(self) > 1:
            spread = f", standard deviation {np.sqrt(self.variance):.3g}"
        return f"{len(self)} {what}: mean {self.mean:.4g}{spread}"

    @property
    def number(self) -> float:
        """Return the number of trials of equal weight that are worth as much."""
        if self.weight is None:
            return float(len(self.returns))
        return float(self.weight.sum() ** 2 / (self.weight**2).sum())

    @property
    def mean(self) -> float:
        """Return the weighted mean of the outcomes."""
        return float(np.average(self.returns, weights=self.weight))

    @property
    def variance(self) -> float:
        """Return the unbiased variance of an outcome; nan of a single trial."""
        m = self.number
        if m <= 1.0 + 1e-12:
            return float("nan")
        squares = np.average((self.returns - self.mean) ** 2, weights=self.weight)
        return float(squares * m / (m - 1.0))

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the policies that were tried, each once."""
        if isinstance(self.policy, str):
            return (self.policy,)
        if isinstance(self.policy, tuple):
            return tuple(dict.fromkeys(self.policy))
        return ()

    def of(self, name: str) -> Self:
        """Return the trials of one policy, by its name.

        Parameters
        ----------
        name : str
            One of ``names``.

        Returns
        -------
        Trials
            Its trials; their ``policy`` is None.

        Raises
        ------
        ValueError
            If no trial has this name.
        """
        _checks.instance(name, str, "name", "string")
        if name not in self.names:
            known = ", ".join(map(repr, self.names)) or "none"
            raise ArgumentError(
                "name", f"must be a policy that was tried ({known}); got {name!r}"
            )
        chosen: BoolArray = np.ones(len(self), dtype=np.bool_)
        if isinstance(self.policy, tuple):
            chosen = np.array([own == name for own in self.policy])
        made = type(self)(
            self.returns[chosen],
            discount=self.discount,
            horizon=self.horizon,
            weight=None if self.weight is None else self.weight[chosen],
        )
        return made._as_successes(self.success) if self.is_success else made


def holds_trials(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is a table of trials or an ``eval_info.json``.

    A table with the columns of a log is none. Only the header of a table is read.
    """
    name = _files.local(path)
    suffix = Path(name).suffix.lower()
    try:
        if suffix == ".csv":
            labels = {str(label).strip().lower() for label in read_labels(name)}
            return bool(labels & {"success", "return"}) and "action" not in labels
        if suffix != ".json":
            return False
        content = json.loads(_files.read_text(name))
    except (ValueError, OSError, RecursionError):
        return False  # whoever reads it says what is wrong
    return isinstance(content, dict) and bool(
        {"per_task", "per_episode"} & set(content)
    )


def require_fit(trials: Trials, simulator: FiniteMDP, horizon: int | None) -> None:
    """Refuse trials of another quantity than a problem's value.

    The quantity is what the simulator's rewards and discount say, over the horizon.
    """
    if trials.is_success:
        _require_success(trials, simulator)
    elif trials.discount is not None and trials.discount != simulator.discount:
        raise ArgumentError(
            "trials.discount",
            f"must be the problem's, {simulator.discount:g}; it is"
            f" {trials.discount:g} (give the simulator the discount of the returns:"
            f" simulator.with_discount({trials.discount:g}), or sum the rewards of each"
            " trial anew)",
        )
    if trials.horizon is not None and trials.horizon != horizon:
        raise ArgumentError(
            "trials.horizon",
            f"must be the problem's, {horizon}; it is {trials.horizon} (evaluate what"
            f" was tried: Problem(..., horizon={trials.horizon}), --horizon"
            f" {trials.horizon})",
        )
    if isinstance(trials.policy, np.ndarray):
        check_policy(trials.policy, simulator, name="trials.policy")
    if not trials.is_success and simulator.sampling is None:
        _require_range(trials, simulator, horizon)


def _require_success(trials: Trials, simulator: FiniteMDP) -> None:
    """Refuse a problem whose value is not the probability of success."""
    remedy = (
        "(data.success_simulator(simulator, success) makes such a simulator; on the"
        " command line: --success STATE)"
    )
    if simulator.discount != 1.0:
        raise ArgumentError(
            "trials",
            "must be of the quantity that is evaluated: a success counts 1 at discount"
            f" 1, and the problem has discount {simulator.discount:g} {remedy}",
        )
    paid = success_states(simulator)
    if paid is None:
        raise ArgumentError(
            "trials",
            "must be of the quantity that is evaluated: for successes the simulator"
            " must pay 1 on entering terminal states of success, and nothing else; it"
            f" pays otherwise {remedy}",
        )
    if trials.success is None:
        return
    named = _find_states(trials.success, simulator)
    other = set(named.tolist()) ^ set(paid.tolist())
    if other:
        raise ArgumentError(
            "trials.success",
            "must be the states on whose entering the simulator pays 1; state"
            f" {simulator.names.state(min(other))} is one of the two only {remedy}",
        )


def _require_range(trials: Trials, simulator: FiniteMDP, horizon: int | None) -> None:
    """Refuse returns that the simulator's rewards cannot add up to."""
    if simulator.discount == 1.0 and horizon is None:
        return
    data = simulator.transition_rewards
    paid = simulator.rewards if data is None else data.data
    total = total_discount(simulator.discount, horizon)
    # a reward that is nowhere paid is 0, as after the end of an episode
    low = min(float(np.min(paid)), 0.0) * total
    high = max(float(np.max(paid)), 0.0) * total
    slack = RETURN_TOLERANCE * max(abs(low), abs(high))
    is_outside = (trials.returns < low - slack) | (trials.returns > high + slack)
    if is_outside.any():
        row = int(np.argmax(is_outside))
        raise ArgumentError(
            f"trials.returns[{row}]",
            f"must be in [{low:g}, {high:g}], the returns that the simulator's rewards,"
            f" discount and horizon allow; it is {trials.returns[row]:g}"
            f" ({int(is_outside.sum())} such trials; are they sums at another discount"
            " or horizon?)",
        )


def success_states(simulator: FiniteMDP) -> IntArray | None:
    """Return the states of success, where J is the probability to enter one.

    This is so where every transition into some terminal states pays 1, and no other
    transition pays anything. Otherwise None is returned.
    """
    transitions = simulator.transitions
    rewards = simulator.transition_rewards
    ends = simulator.absorbing()
    row = np.repeat(np.arange(transitions.shape[0]), np.diff(transitions.indptr))
    if rewards is None:
        # one reward for a pair: all of its transitions lead to success, or none does
        paid = simulator.rewards.reshape(-1)[row]
    else:
        paid = np.asarray(rewards.data)
    is_move = transitions.data > 0
    into = transitions.indices
    wins = is_move & (paid == 1.0)
    if (is_move & (paid != 0.0) & ~wins).any():
        return None
    states: IntArray = np.unique(into[wins])
    if not len(states) or not ends[states].all():
        return None
    is_end = np.zeros(simulator.n_states, dtype=np.bool_)
    is_end[states] = True
    state = row // simulator.n_actions
    unpaid = is_move & is_end[into] & ~wins & ~is_end[state]
    return None if unpaid.any() else states


@suggest_keywords
def success_simulator(simulator: FiniteMDP, success: StatesLike) -> FiniteMDP:
    """Make the simulator whose value is the probability of success.

    It has discount 1, pays 1 on entering one of the states of success and nothing else,
    and stops there.

    Parameters
    ----------
    simulator : FiniteMDP
        The simulator of the transitions.
    success : state or sequence of states
        The states, by name or number, whose entering is success. No episode starts in
        one.

    Returns
    -------
    FiniteMDP
        The simulator with other rewards; its states of success are terminal.

    Raises
    ------
    ValueError
        If a state is unknown, or an episode may start in one.

    See Also
    --------
    Trials.from_successes : Make trials of a number of successes.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> walk = oee.tasks.gridworld(3, slip=0.2)
    >>> reach = success_simulator(walk, 8)
    >>> round(oee.policy_value(reach, oee.tasks.gridworld_expert(3), horizon=5), 3)
    0.671
    """
    _checks.instance(simulator, FiniteMDP, "simulator")
    states = _find_states(_check_states(success), simulator)
    starting = states[simulator.initial[states] > 0]
    if len(starting):
        raise ArgumentError(
            "success",
            "must be states in which no episode starts: success is to enter them;"
            f" {simulator.names.state(int(starting[0]))} is a first state",
        )
    is_success = np.zeros(simulator.n_states, dtype=np.bool_)
    is_success[states] = True
    bare = simulator.with_rewards(np.zeros((simulator.n_states, simulator.n_actions)))
    ending = bare.transitions.tolil(copy=True)
    for state in states:
        for action in range(simulator.n_actions):
            pair = int(state) * simulator.n_actions + action
            ending.rows[pair] = [int(state)]
            ending.data[pair] = [1.0]
    stopped = bare.with_transitions(ending.tocsr())
    paid = stopped.transitions.copy()
    row = np.repeat(np.arange(paid.shape[0]), np.diff(paid.indptr))
    enters = is_success[paid.indices] & ~is_success[row // simulator.n_actions]
    paid.data = enters.astype(np.float64)
    return stopped.with_rewards(paid).with_discount(1.0)


def _check_successes(successes: Any, number: int) -> int:
    """Return a number of successes that is an integer of at least 0."""
    try:
        if isinstance(successes, bool | np.bool_) or np.ma.isMaskedArray(successes):
            raise TypeError
        won = operator.index(successes)
    except (TypeError, ValueError):
        raise ArgumentError(
            "successes",
            f"must be an integer in 0..{number}; got {_checks.show(successes)}",
        ) from None
    if won < 0:
        raise ArgumentError(
            "successes", f"must be an integer in 0..{number}; it is {won}"
        )
    return won


def _check_states(success: Any) -> tuple[Name | int, ...]:
    """Return states as a tuple of names and numbers, at least one."""
    if isinstance(success, str) or _checks.is_integer(success):
        return (success,)
    if isinstance(success, np.ndarray):
        success = success.tolist()
    states = _checks.collection(success, "success", "states, by name or number")
    if not states:
        raise ArgumentError("success", "must name at least one state; it is empty")
    for k, state in enumerate(states):
        if not isinstance(state, str | tuple) and not _checks.is_integer(state):
            raise ArgumentError(
                f"success[{k}]",
                f"must be a name or a number; got {_checks.show(state)}",
            )
    return states


def _find_states(states: Sequence[Name | int], simulator: FiniteMDP) -> IntArray:
    """Return the numbers of states that are given by name or number."""
    names = simulator.state_names
    numbers = []
    for k, state in enumerate(states):
        place = "success" if len(states) == 1 else f"success[{k}]"
        numbers.append(number_of(state, names, simulator.n_states, place))
    return np.array(numbers, dtype=np.int64)


def _check_tried(policy: Any, number: int) -> str | tuple[str, ...] | Array | None:
    """Return a name, a name for each trial, the policy's array, or None."""
    if policy is None:
        return None
    if isinstance(policy, str):
        if not policy:
            raise ArgumentError("policy", "must be a name that is not empty")
        return policy
    is_texts = isinstance(policy, list | tuple) and all(
        isinstance(name, str) for name in policy
    )
    if is_texts or getattr(getattr(policy, "dtype", None), "kind", "f") in "OUT":
        names = _checks.collection(policy, "policy", "a name for each trial")
        if len(names) != number:
            raise ArgumentError(
                "policy",
                f"must be one name, or {number}, one for each trial; there are"
                f" {len(names)}",
            )
        for k, name in enumerate(names):
            if not isinstance(name, str) or not name:
                raise ArgumentError(
                    f"policy[{k}]", f"must be a name; got {_checks.show(name)}"
                )
        return tuple(str(name) for name in names)
    array = _checks.float_array(policy, "policy", ndim=(1, 2))
    _checks.require_finite(array, "policy")
    return _checks.freeze(array)


def _check_weight(weight: Any, number: int) -> Array | None:
    """Return positive weights, one for each trial, or None."""
    if weight is None:
        return None
    values = _checks.float_array(weight, "weight", ndim=1)
    if len(values) != number:
        raise ArgumentError(
            "weight",
            f"must have one number for each of the {number} trials; it has"
            f" {len(values)}",
        )
    bad = np.flatnonzero(~((values > 0) & np.isfinite(values)))
    if bad.size:
        raise ArgumentError(
            f"weight[{bad[0]}]",
            f"must be positive and finite; it is {values[bad[0]]:g}",
        )
    return _checks.freeze(values)


def _refuse_misspelt(unread: Sequence[str], known: Container[str], name: str) -> None:
    """Raise an ArgumentError for a column that may be a policy's or a weight's.

    Without it the trials of all policies would be those of one, each with weight 1.
    """
    written = {label.strip().lower()[:80]: label for label in unread[:1000]}
    for field in ("policy", "weight"):
        near = list(find_misspelt(sorted(written.keys() - OTHER_WORDS), [field]))
        if near and field not in known:
            shown = _checks.show(written[str(near[0])])
            raise ArgumentError(
                f"{name!r}",
                f"must have columns whose meaning is clear; {shown}"
                f" resembles {field} (call it {field} to have it read, or leave it out"
                " of the file)",
            )


def _read_table(name: str, measure: str | None) -> dict[str, Any]:
    """Read the columns of a CSV table of trials."""
    frame = csv_frame(name, has_flags=False)
    labels = {str(label).strip().lower(): label for label in frame.columns}
    outcomes = [label for label in ("success", "return") if label in labels]
    if measure is not None:
        outcomes = [label for label in outcomes if label == measure]
    if not outcomes:
        wanted = "success or return" if measure is None else measure
        shown = _checks.show(", ".join(map(str, frame.columns)))
        known = COLUMNS[1:3] if measure is None else [measure]
        hint = ""
        for each in known:
            for near in find_misspelt(map(str, frame.columns), [each]):
                hint = f" (is {_checks.show(near)} {each}? Then call it so)"
        raise ArgumentError(
            f"{name!r}", f"must have the column {wanted}; it has {shown}{hint}"
        )
    outcome = outcomes[0]
    if not len(frame):
        raise ArgumentError(f"{name!r}", "must have at least one trial; it has no rows")
    unread = [str(labels[label]) for label in labels if label not in COLUMNS]
    _refuse_misspelt(unread, labels, name)
    if unread:
        _checks.warn(
            f"{name!r}: columns that trials do not have are not read:"
            f" {_checks.show(', '.join(unread))}",
            DataWarning,
        )
    read = _read_flag if outcome == "success" else _read_number
    names = None
    if "policy" in labels:
        names = [
            _read_name(value, name, k)
            for k, value in enumerate(frame[labels["policy"]])
        ]
    weights = None
    if "weight" in labels:
        column = frame[labels["weight"]]
        weights = [
            _read_number(value, name, k, "weight") for k, value in enumerate(column)
        ]
        for k, weight in enumerate(weights):
            if not weight > 0:
                raise ArgumentError(
                    _place(name, k), f"must have a positive weight; it is {weight:g}"
                )
    column = frame[labels[outcome]]
    return {
        "outcome": [read(value, name, k, outcome) for k, value in enumerate(column)],
        "policy": names,
        "weight": weights,
        "is_success": outcome == "success",
    }


def _place(name: str, row: int) -> str:
    """Return the place of a row in a file; the header is its first line."""
    return f"{name!r}: row {row} (line {row + 2})"


def _read_flag(value: object, name: str, row: int, column: str) -> float:
    """Read a success: 1 or 0, true or false."""
    text = str(value).strip().lower().removesuffix(".0")
    if text in FLAGS:
        return FLAGS[text]
    raise ArgumentError(
        _place(name, row),
        f"must have 1 or 0 (true or false) in {column}; it has {_checks.show(value)}",
    )


def _read_number(value: Any, name: str, row: int, column: str) -> float:
    """Read a finite number of a column."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if not np.isfinite(number):
        raise ArgumentError(
            _place(name, row),
            f"must have a finite number in {column}; it has {_checks.show(value)}",
        )
    return number


def _read_name(value: object, name: str, row: int) -> str:
    """Read the name of a policy."""
    text = "" if value is None or value != value else str(value).strip()
    if not text:
        raise ArgumentError(
            _place(name, row), "must have a name in policy; it is empty"
        )
    return text


def _read_lerobot(name: str, measure: str | None, task: str | None) -> dict[str, Any]:
    """Read the outcomes of an ``eval_info.json``, of its newer and its older form.

    The newer one has ``per_task``, a list of {"task_group", "task_id", "metrics":
    {"successes": [...], "sum_rewards": [...]}}, the older one ``per_episode``, a list
    of {"success", "sum_reward"}.
    """
    file = f"{name!r}"
    try:
        content = json.loads(_files.read_text(name))
    except (ValueError, RecursionError) as error:
        raise ArgumentError(
            file, f"must be JSON; {_checks.first_line(error)}"
        ) from None
    form = (
        "must be an eval_info.json of LeRobot, with per_task (metrics: successes,"
        " sum_rewards) or per_episode (success, sum_reward)"
    )
    if not isinstance(content, dict):
        raise ArgumentError(file, f"{form}; it holds {_checks.show(content)}")
    if isinstance(content.get("per_task"), list):
        metrics = _choose_task(file, form, content["per_task"], task)
        found = {
            "success": metrics.get("successes"),
            "return": metrics.get("sum_rewards"),
        }
    elif isinstance(content.get("per_episode"), list):
        if task is not None:
            raise ArgumentError("task", f"must be None: {file} has one task")
        episodes = content["per_episode"]
        if not all(isinstance(one, dict) for one in episodes):
            raise ArgumentError(file, form)
        found = {
            "success": [one.get("success") for one in episodes],
            "return": [one.get("sum_reward") for one in episodes],
        }
    else:
        keys = _checks.show(", ".join(map(str, content)))
        raise ArgumentError(file, f"{form}; it has {keys}")
    outcome = measure
    if outcome is None:
        outcome = "success" if found["success"] else "return"
    values = found[outcome]
    if not isinstance(values, list) or not values:
        raise ArgumentError(file, f"{form}; it has no {outcome} of any episode")
    numbers = []
    for k, value in enumerate(values):
        is_number = isinstance(value, bool | int | float) and abs(value) <= LARGEST
        if not is_number or (outcome == "success" and value not in (0, 1)):
            kind = "true or false" if outcome == "success" else "a finite number"
            raise ArgumentError(
                f"{file}: episode {k}",
                f"must have {kind} as its {outcome}; it has {_checks.show(value)}",
            )
        numbers.append(float(value))
    return {
        "outcome": numbers,
        "policy": None,
        "weight": None,
        "is_success": outcome == "success",
    }


def _choose_task(
    file: str, form: str, tasks: list[Any], task: str | None
) -> dict[str, Any]:
    """Return the metrics of the one task of a file, or of the one that is named."""
    named: dict[str, Any] = {}
    for entry in tasks:
        metrics = entry.get("metrics") if isinstance(entry, dict) else None
        if not isinstance(metrics, dict):
            raise ArgumentError(file, form)
        named[f"{entry.get('task_group')}/{entry.get('task_id')}"] = metrics
    known = ", ".join(map(repr, named))
    if task is None and len(named) == 1:
        return next(iter(named.values()))
    if task is None:
        raise ArgumentError(
            "task",
            f"must name one of the {len(named)} tasks of {file}, each of which has a"
            f" value of its own: {_checks.show(known)}",
        )
    if task not in named:
        raise ArgumentError(
            "task", f"must be one of {_checks.show(known)}; got {_checks.show(task)}"
        )
    return dict(named[task])
