"""MDPs as .umb files: what becomes of rewards and of the discount, both ways.

Model checkers add up rewards of states and of choices and know no discount. In a file of
ours the total reward until ``end`` is therefore J of eq. 3.1: after each transition the
model goes on with probability gamma, and is over with 1 - gamma::

    states   0 ... S-1        those of the MDP; a choice for each available action
             S ... S+K-1      one for each (s', r) that a transition enters and pays:
                              pays r, goes to s' with gamma, to the end with 1 - gamma
             the end          if gamma < 1
             the start        if there are several first states: goes to s with mu_0(s)

P itself has no other factor, and comes back bit by bit. At discount 1, with rewards r(s,
a), the K states are not needed: choices pay r(s, a) and lead to s'. What model checkers
do not know (names, layout, sample sizes, gamma) is in the index, among the parameters
of the tool that made the file.

Of a file by another program (PRISM, Storm) rewards of states, choices and branches add
up to r(s, a, s'), and the discount is 1.
"""

from __future__ import annotations

import base64
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._sparse import align, row_of_entry
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp.files import constructor_arguments, file_arrays
from oee_tabular.mdp.naming import check_names, name_text
from oee_tabular.mdp.umb_files import UmbFile, require_umbi, write_umb
from oee_tabular.typing import Array, BoolArray, IntArray

if TYPE_CHECKING:
    from oee_tabular.mdp.finite_mdp import FiniteMDP

TOOL = "oee_tabular"
REWARD = "reward"  # the name of the rewards in files of ours
# the same without negative rewards, on which Storm's sound methods are wrong (2.0):
COST = "cost"  # -r, where no reward is positive
SHIFTED = "shifted"  # r - min r, where there is a discount
END = "end"  # the label of the states that pay nothing more
GO_ON = "go on"  # the action of states that are not the MDP's
NO_LABEL = "no label"  # the action of PRISM's commands [] ...
# what the states, choices and branches of a file say
_STRUCTURE = ("transitions_", "rewards", "initial", "available", "shape")


def save_umb(mdp: FiniteMDP, path: str | os.PathLike[str], layout: object) -> None:
    """Write an MDP to a .umb file. ``layout``: the one that was given."""
    require_umbi()
    from umbi import version  # an extra
    from umbi.binary import SizedType
    from umbi.datatypes import NumericPrimitiveType, PrimitiveType
    from umbi.umb.index import (
        AnnotationDescription,
        FileData,
        TransitionSystem,
        UmbIndex,
    )

    parts = _Parts(mdp)
    place = "states" if parts.pays_states else "choices"
    number = SizedType(NumericPrimitiveType.DOUBLE, 64)
    flag = SizedType(PrimitiveType.BOOL, 1)
    system = TransitionSystem(
        num_players=1,
        num_states=parts.n_states,
        num_initial_states=1,
        num_choices=len(parts.action),
        num_choice_actions=len(parts.action_texts),
        num_branches=len(parts.target),
        branch_probability_type=number,
    )
    end = AnnotationDescription(alias=END, applies_to=["states"], type=flag)
    rewards = {
        name: AnnotationDescription(
            alias=name, description=about, applies_to=[place], type=number
        )
        for name, (about, _) in parts.rewards.items()
    }
    index = UmbIndex(
        format_version=version.__format_version__,
        format_revision=version.__format_revision__,
        file_data=FileData(
            tool=TOOL, tool_version=_version(), parameters=_parameters(mdp, layout)
        ),
        transition_system=system,
        annotations={"rewards": rewards, "aps": {END: end}},
    )
    is_first = np.zeros(parts.n_states, dtype=np.bool_)
    is_first[parts.first] = True
    arrays: dict[str, Any] = {
        "state-is-initial": is_first,
        "state-to-choices": parts.state_to_choices.astype("<u8"),
        "choice-to-branches": parts.choice_to_branches.astype("<u8"),
        "branch-to-target": parts.target.astype("<u8"),
        "branch-to-probability": parts.probability.astype("<f8"),
        "actions/choices/values": parts.action.astype("<u4"),
        "actions/choices": parts.action_texts,
        f"annotations/aps/{END}/states/values": parts.is_end,
    }
    for name, (_, values) in parts.rewards.items():
        member = f"annotations/rewards/{name}/{place}/values"
        arrays[member] = values.astype("<f8")
    write_umb(path, index, arrays)


class _Parts:
    """Lay an MDP out as states, choices and branches of a file."""

    def __init__(self, mdp: FiniteMDP) -> None:
        csr = mdp.csr
        n, gamma = mdp.n_states, mdp.discount
        is_available = mdp.available.reshape(-1)
        rows = np.flatnonzero(is_available)
        first = np.flatnonzero(mdp.initial)
        has_steps = gamma < 1.0 or mdp.reward_data is not None
        has_end = gamma < 1.0
        step_to = np.zeros(0, dtype=np.int64)
        step_pay = np.zeros(0)
        target = csr.indices.astype(np.int64)
        if has_steps:
            paid = np.zeros(csr.nnz) if mdp.reward_data is None else mdp.reward_data
            step_to, step_pay, which = _distinct_steps(target, paid)
            target = n + which
        n_steps = len(step_to)
        end = n + n_steps
        start = end + has_end
        self.n_states = start + (len(first) > 1)
        self.first = int(first[0]) if len(first) == 1 else start
        targets, probabilities = [target], [csr.data]
        counts = [np.diff(csr.indptr)[rows].astype(np.int64)]
        # where the MDP goes on after a step: with gamma = 0 it does not
        ways = [
            (gamma > 0.0, step_to, gamma),
            (has_end, step_to * 0 + end, 1.0 - gamma),
        ]
        taken = [(to, chance) for is_there, to, chance in ways if is_there]
        counts.append(np.full(n_steps, len(taken), dtype=np.int64))
        targets.append(np.stack([to for to, _ in taken], axis=1).reshape(-1))
        probabilities.append(np.tile([chance for _, chance in taken], n_steps))
        if has_end:
            counts.append(np.ones(1, dtype=np.int64))
            targets.append(np.array([end]))
            probabilities.append(np.ones(1))
        if len(first) > 1:
            counts.append(np.array([len(first)]))
            targets.append(first)
            probabilities.append(mdp.initial[first])
        self.target = np.concatenate(targets)
        self.probability = np.concatenate(probabilities)
        self.choice_to_branches = _offsets(np.concatenate(counts))
        n_others = self.n_states - n
        self.state_to_choices = _offsets(
            np.concatenate([mdp.available.sum(axis=1), np.ones(n_others)])
        )
        self.action = np.concatenate(
            [rows % mdp.n_actions, np.full(n_others, mdp.n_actions)]
        )
        self.action_texts = [
            name_text(mdp.action_names, a) if mdp.action_names else f"action {a}"
            for a in range(mdp.n_actions)
        ]
        if n_others:
            self.action_texts.append(GO_ON)
        self.pays_states = mdp.reward_data is not None
        paid = np.zeros(self.n_states if self.pays_states else len(self.action))
        # where the MDP pays: in the K states, or in its own choices
        own = slice(n, end) if self.pays_states else slice(0, len(rows))
        paid[own] = step_pay if self.pays_states else mdp.rewards.reshape(-1)[rows]
        self.rewards = {REWARD: ("the rewards of the MDP", paid)}
        least, most = float(paid[own].min()), float(paid[own].max())
        if least < 0.0 and most <= 0.0:
            self.rewards[COST] = ("the rewards times -1, to be minimised", 0.0 - paid)
        elif least < 0.0 and has_end:
            shifted = paid.copy()
            shifted[own] -= least
            about = f"each step pays {-least!r} more: {-least / (1.0 - gamma)!r} in all"
            self.rewards[SHIFTED] = (about, shifted)
        self.is_end = np.zeros(self.n_states, dtype=np.bool_)
        if has_end:
            self.is_end[end] = True
        else:
            self.is_end[:n] = mdp.absorbing()


def load_umb(
    path: str | os.PathLike[str],
    reward: str | None = None,
    success: str | None = None,
    until: str | None = None,
) -> dict[str, Any]:
    """Return the arguments of ``FiniteMDP`` from a .umb file.

    ``FiniteMDP.load`` explains the others.
    """
    file = UmbFile(path)
    model = _Model(file)
    made = file.index.get("file-data") or {}
    if made.get("tool") == TOOL and isinstance(made.get("parameters"), dict):
        for name, value in (("reward", reward), ("success", success), ("until", until)):
            if value is not None:
                raise ArgumentError(
                    name,
                    "must be left out for a file that FiniteMDP.save wrote; got"
                    f" {_checks.show(value)} ({file.name!r} has its rewards)",
                )
        return _own_arguments(file, model, made["parameters"])
    return _foreign_arguments(file, model, reward, success, until)


class _Model:
    """Hold the states, choices and branches of a file, checked.

    Attributes
    ----------
    n_states : int
        The number of states.
    first : int
        The one initial state.
    state : ndarray of int of shape (choices,)
        The state of each choice.
    choice : ndarray of int of shape (branches,)
        The choice of each branch.
    target : ndarray of int of shape (branches,)
        Where each branch leads.
    probability : ndarray of shape (branches,)
        Its probability.
    """

    def __init__(self, file: UmbFile) -> None:
        n, n_choices = file.count("#states"), file.count("#choices")
        n_branches = file.count("#branches")
        # what follows is allocated by these numbers, and the bytes of the first member
        # bound them
        self.target = file.integers("branch-to-target.bin", n_branches)
        if not 1 <= n <= n_choices <= n_branches:
            raise file.error(
                "must have a choice in each state, and a branch in each choice; it has"
                f" {n} states, {n_choices} choices and {n_branches} branches (let the"
                " program that wrote it add self-loops to states without choices)"
            )
        if self.target.max() >= n:
            raise file.error(
                f"must lead to its {n} states; a branch leads to {self.target.max()}"
            )
        self.n_states = n
        choices = file.offsets("state-to-choices.bin", n, n_choices)
        branches = file.offsets("choice-to-branches.bin", n_choices, n_branches)
        self.n_choices_of = np.diff(choices)
        for what, sizes in (
            ("state", self.n_choices_of),
            ("choice", np.diff(branches)),
        ):
            if not sizes.all():
                part = "choice" if what == "state" else "branch"
                raise file.error(
                    f"must have a {part} in each {what}; {what}"
                    f" {int(sizes.argmin())} has none (let the program that wrote it"
                    " add self-loops)"
                )
        self.state = np.repeat(np.arange(n), self.n_choices_of)
        self.choice_begins = choices
        self.branch_begins = branches
        self.choice = np.repeat(np.arange(n_choices), np.diff(branches))
        kind = file.index["transition-system"].get("branch-probability-type")
        if kind is None:
            if n_branches > n_choices:
                raise file.error(
                    "must have probabilities; it holds a transition system without"
                    " them, where an MDP or a Markov chain is needed"
                )
            self.probability = np.ones(n_branches)
        else:
            self.probability = file.numbers(
                "branch-to-probability.bin", n_branches, kind
            )
        first = np.zeros(0, dtype=np.int64)
        if file.count("#initial-states"):
            first = np.flatnonzero(file.flags("state-is-initial.bin", n))
        if len(first) != 1:
            raise file.error(
                f"must have one initial state; it has {len(first)} (of several no"
                " distribution is known: add a state that leads to them)"
            )
        self.first = int(first[0])

    def actions(self, file: UmbFile) -> tuple[IntArray, list[str] | None]:
        """Return the number of each choice's action, and the actions' texts."""
        n_choices, n_actions = len(self.state), file.count("#choice-actions")
        folder = "actions/choices"
        numbers = np.zeros(n_choices, dtype=np.int64)
        if n_actions and file.has(f"{folder}/values.bin"):
            numbers = file.integers(f"{folder}/values.bin", n_choices, 4)
            if numbers.max() >= n_actions:
                raise file.error(
                    f"must have actions below {n_actions}, as its index says; it has"
                    f" {numbers.max()}"
                )
        texts = None
        if n_actions and file.has(f"{folder}/string-mapping.bin"):
            texts = file.texts(folder, n_actions)
        return numbers, texts

    def rewards(self, file: UmbFile, name: str) -> tuple[Array, Array | None]:
        """Return the rewards of the choices, and those of the branches, or None."""
        described = _annotations(file, "rewards")[name]
        sizes = {
            "states": self.n_states,
            "choices": len(self.state),
            "branches": len(self.target),
        }
        if described.get("probability-type") is not None:
            raise file.error(f"must have rewards that are numbers; {name!r} has random")
        found = {
            place: file.numbers(
                f"annotations/rewards/{name}/{place}/values.bin",
                sizes[place],
                described["type"],
            )
            for place in described.get("applies-to") or ()
        }
        of_choices = found.get("choices", np.zeros(len(self.state)))
        if "states" in found:
            of_choices = of_choices + found["states"][self.state]
        return of_choices, found.get("branches")


def _foreign_arguments(
    file: UmbFile,
    model: _Model,
    reward: str | None,
    success: str | None,
    until: str | None,
) -> dict[str, Any]:
    """Return the arguments of the MDP in a file by another program."""
    action, texts = _number_actions(file, model)
    n, n_actions = model.n_states, int(action.max()) + 1
    _checks.require_memory(8 * n * n_actions, repr(file.name), size=1)
    rows = model.state * n_actions + action
    available = np.zeros(n * n_actions, dtype=np.bool_)
    available[rows] = True
    is_over = np.zeros(n, dtype=np.bool_)
    is_success = is_over
    if success is not None:
        is_over = is_success = _label(file, success, "success", n)
    if until is not None:
        is_over = _label(file, until, "until", n)
    if success is None:
        name = _choose_reward(file, reward)
        of_choices, of_branches = model.rewards(file, name)
        paid = of_choices[model.choice]
        if of_branches is not None:
            paid = paid + of_branches
    elif reward is None:
        of_branches = paid = (is_success & is_over)[model.target].astype(np.float64)
        of_choices = np.zeros(len(rows))
    else:
        raise ArgumentError(
            "success",
            "must be left out where reward names what is paid; got"
            f" {_checks.show(success)}",
        )
    # a state where all is over stays, and pays nothing
    goes_on = ~is_over[model.state]
    is_kept = goes_on[model.choice]
    stay = np.flatnonzero(~goes_on)
    row = np.concatenate([rows[model.choice[is_kept]], rows[stay]])
    column = np.concatenate([model.target[is_kept], model.state[stay]])
    nothing = np.zeros(len(stay))
    shape = n * n_actions, n
    probability = np.concatenate([model.probability[is_kept], nothing + 1.0])
    table: Any
    if of_branches is None:
        table = np.zeros(n * n_actions)
        table[rows] = np.where(goes_on, of_choices, 0.0)
        table = table.reshape(n, n_actions)
    else:
        paid = np.concatenate([paid[is_kept], nothing])
        table = sparse.coo_array((paid, (row, column)), shape=shape)
    arguments: dict[str, Any] = {
        "transitions": sparse.coo_array((probability, (row, column)), shape=shape),
        "rewards": table,
        "initial": model.first,
        "discount": 1.0,
        "state_names": _state_names(file, n),
        "action_names": _valid_names(texts),
    }
    if not available.all():
        arguments["available"] = available.reshape(n, n_actions)
    return arguments


def _number_actions(file: UmbFile, model: _Model) -> tuple[IntArray, list[str] | None]:
    """Return the number of each choice's action, and the names of the actions.

    Actions are those of the file where no state has two choices of one action.
    Otherwise they are the first, second, ... choice of a state, without names.
    """
    numbers, texts = model.actions(file)
    used, action = np.unique(numbers, return_inverse=True)
    pairs = model.state * len(used) + action
    if len(np.unique(pairs)) == len(pairs):
        names = None if texts is None else [texts[a] for a in used]
        return action, names
    return np.arange(len(pairs)) - model.choice_begins[model.state], None


def _annotations(file: UmbFile, category: str) -> dict[str, Any]:
    """Return what the index says of the rewards or labels, by their names."""
    return dict((file.index.get("annotations") or {}).get(category) or {})


def _find_annotation(
    file: UmbFile, category: str, name: object, argument: str
) -> tuple[str, Any]:
    """Return the key and description of the rewards or label with a name or alias."""
    described = _annotations(file, category)
    for key, value in described.items():
        if isinstance(name, str) and name in (key, value.get("alias")):
            return key, value
    what = "rewards" if category == "rewards" else "labels"
    known = ", ".join(
        repr(value.get("alias") or key) for key, value in described.items()
    )
    raise ArgumentError(
        argument,
        f"must be one of the {what} of {file.name!r} ({known or 'none'}); got"
        f" {_checks.show(name)}",
    )


def _choose_reward(file: UmbFile, reward: str | None) -> str:
    """Return the key of the rewards with a name, or of the only ones."""
    described = _annotations(file, "rewards")
    if reward is None and len(described) == 1:
        return next(iter(described))
    if reward is None:
        known = ", ".join(
            repr(value.get("alias") or key) for key, value in described.items()
        )
        labels = ", ".join(
            repr(value.get("alias") or key)
            for key, value in _annotations(file, "aps").items()
        )
        raise ArgumentError(
            "reward",
            f"must say which rewards of {file.name!r} are meant: it has"
            f" {known or 'none'} (reward='its name', or success='a label' for 1 on"
            f" entering its states; labels: {labels or 'none'})",
        )
    return _find_annotation(file, "rewards", reward, "reward")[0]


def _label(file: UmbFile, name: object, argument: str, n_states: int) -> BoolArray:
    """Return which states have a label."""
    key, _ = _find_annotation(file, "aps", name, argument)
    return file.flags(f"annotations/aps/{key}/states/values.bin", n_states)


def _state_names(file: UmbFile, n_states: int) -> list[tuple[int, ...]] | None:
    """Return the values of the variables as names, where no two states share them."""
    values = file.variables(n_states)
    if values is None or len(np.unique(values, axis=0)) < n_states:
        return None
    return list(map(tuple, values.tolist()))


def _valid_names(texts: list[str] | None) -> tuple[Any, ...] | None:
    """Return texts as names of actions; None where they cannot be names."""
    if texts is None:
        return None
    try:
        names = [text or NO_LABEL for text in texts]
        return check_names(names, "action_names", len(names))
    except ArgumentError:
        return None


def _own_arguments(
    file: UmbFile, model: _Model, parameters: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the arguments of the MDP in a file that ``save_umb`` wrote."""
    edited = "must hold the model that was saved in it; it is damaged, or was edited"
    try:
        n, n_actions = (int(parameters[name]) for name in ("states", "actions"))
        stored = {name: _decode(x) for name, x in parameters["arrays"].items()}
        gamma = float(stored["discount"])
        is_of_transitions = parameters["rewards"] == "r(s, a, s')"
        _checks.require_memory(n * n_actions, repr(file.name))
        if not 1 <= n <= model.n_states or not 0.0 <= gamma <= 1.0 or n_actions < 1:
            raise file.error(edited)
        action, _ = model.actions(file)
        n_pairs = int(model.choice_begins[n])
        n_entries = int(model.branch_begins[n_pairs])
        rows = model.state[:n_pairs] * n_actions + action[:n_pairs]
        if action[:n_pairs].max() >= n_actions or (np.diff(rows) <= 0).any():
            raise file.error(edited)
        column, reward = model.target[:n_entries], np.zeros(0)
        if gamma < 1.0 or is_of_transitions:
            paid = np.zeros(model.n_states)
            if is_of_transitions:
                kind = _annotations(file, "rewards")[REWARD]["type"]
                member = f"annotations/rewards/{REWARD}/states/values.bin"
                paid = file.numbers(member, model.n_states, kind)
            following = stored.get("next_states")
            if following is None:
                following = model.target[model.branch_begins[model.choice_begins[n:-1]]]
            reward = paid[column]
            column = np.asarray(following)[column - n]
        if not ((column >= 0) & (column < n)).all():
            raise file.error(edited)
        available = np.zeros(n * n_actions, dtype=np.bool_)
        available[rows] = True
        sizes = np.zeros(n * n_actions, dtype=np.int64)
        sizes[rows] = np.diff(model.branch_begins[: n_pairs + 1])
        arrays = dict(stored)
        arrays |= {
            "shape": np.array([n, n_actions]),
            "transitions_data": model.probability[:n_entries],
            "transitions_indices": column,
            "transitions_indptr": _offsets(sizes),
            "initial": _read_initial(model, n),
        }
        arrays.setdefault("terminal_state", np.arange(n))
        if not available.all():
            arrays["available"] = available.reshape(n, n_actions)
        if is_of_transitions:
            arrays |= _reward_parts(stored, arrays, reward, (n * n_actions, n))
        else:
            of_choices, _ = model.rewards(file, REWARD)
            table = np.zeros(n * n_actions)
            table[rows] = of_choices[:n_pairs]
            arrays["rewards"] = table.reshape(n, n_actions)
        return constructor_arguments(arrays)
    except ArgumentError:
        raise
    except (KeyError, IndexError, TypeError, ValueError, OverflowError):
        raise file.error(edited) from None


def _read_initial(model: _Model, n_states: int) -> Array:
    """Return the distribution of the first state, which a state may lead to."""
    initial = np.zeros(n_states)
    if model.first < n_states:
        initial[model.first] = 1.0
        return initial
    choice = model.choice_begins[model.first]
    branches = slice(model.branch_begins[choice], model.branch_begins[choice + 1])
    initial[model.target[branches]] = model.probability[branches]
    return initial


def _reward_parts(
    stored: Mapping[str, Any],
    arrays: Mapping[str, Any],
    reward: Array,
    shape: tuple[int, int],
) -> dict[str, Any]:
    """Return r(s, a, s') as the parts of a csr matrix, with those outside P."""
    indptr = arrays["transitions_indptr"]
    row = np.repeat(np.arange(shape[0]), np.diff(indptr))
    column = arrays["transitions_indices"]
    if "outside_row" in stored:
        row = np.concatenate([row, stored["outside_row"]])
        column = np.concatenate([column, stored["outside_column"]])
        reward = np.concatenate([reward, stored["outside_reward"]])
    table = sparse.csr_array((reward, (row, column)), shape=shape)
    table.sort_indices()
    return {
        "rewards_data": table.data,
        "rewards_indices": table.indices,
        "rewards_indptr": table.indptr,
    }


def _parameters(mdp: FiniteMDP, layout: object) -> dict[str, Any]:
    """Return what the states, choices and branches do not say, as JSON."""
    arrays = {
        name: array
        for name, array in file_arrays(mdp, layout).items()
        if not name.startswith(_STRUCTURE)
    }
    if np.array_equal(mdp.terminal_state, np.arange(mdp.n_states)):
        del arrays["terminal_state"]
    table = mdp.transition_rewards
    if table is not None and table.nnz > mdp.csr.nnz:
        outside = ~align(mdp.transitions, table)[1]
        arrays |= {
            "outside_row": row_of_entry(table)[outside],
            "outside_column": table.indices[outside],
            "outside_reward": table.data[outside],
        }
    if mdp.discount == 0.0:
        paid = np.zeros(mdp.csr.nnz) if mdp.reward_data is None else mdp.reward_data
        arrays["next_states"] = _distinct_steps(mdp.csr.indices, paid)[0]
    return {
        "states": mdp.n_states,
        "actions": mdp.n_actions,
        "discount": mdp.discount,
        "rewards": "r(s, a)" if mdp.reward_data is None else "r(s, a, s')",
        "arrays": {name: _encode(array) for name, array in arrays.items()},
    }


def _encode(array: NDArray[Any]) -> dict[str, Any]:
    """Return an array as JSON: texts as they are, numbers bit by bit."""
    if array.dtype.kind == "U":
        return {"texts": array.tolist()}
    kind = "<f8" if array.dtype.kind == "f" else "<i8"
    data = base64.b64encode(array.astype(kind).tobytes()).decode()
    return {"type": kind, "shape": list(array.shape), "base64": data}


def _decode(stored: Mapping[str, Any]) -> NDArray[Any]:
    """Return the array that ``_encode`` was given."""
    if "texts" in stored:
        return np.array(stored["texts"], dtype=np.str_)
    if stored["type"] not in ("<f8", "<i8"):
        raise ValueError("type")
    data = base64.b64decode(stored["base64"], validate=True)
    array = np.frombuffer(data, dtype=stored["type"]).reshape(stored["shape"])
    return array.astype(array.dtype.newbyteorder("="))


def _distinct_steps(to: NDArray[Any], paid: Array) -> tuple[IntArray, Array, IntArray]:
    """Return the distinct (s', r), and which of them each entry is."""
    bits = np.ascontiguousarray(paid, dtype=np.float64).view(np.int64)
    pairs = np.stack([to.astype(np.int64), bits], axis=1)
    distinct, which = np.unique(pairs, axis=0, return_inverse=True)
    steps = np.ascontiguousarray(distinct[:, 1]).view(np.float64)
    return distinct[:, 0], steps, which.reshape(-1)


def _offsets(sizes: NDArray[Any]) -> IntArray:
    """Return where parts of these sizes begin, and the end of the last."""
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)


def _version() -> str:
    """Return the version of this package, which is known once it is imported."""
    from oee_tabular import __version__

    return __version__
