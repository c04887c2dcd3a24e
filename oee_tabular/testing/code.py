"""Small MDPs, logs and policies as code that evaluates to them.

A counterexample that a law or Hypothesis has found can then be pasted into a script,
after ``import numpy as np`` and ``import oee_tabular as oee``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular.data import Transitions
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP

IMPORTS = "import numpy as np\nimport oee_tabular as oee"
MAX_NUMBERS = 400  # of an array that is written out
MAX_ROWS = 64  # of a log that is written out
WIDTH = 88
# of an integer that is written in base 10: Python reads and writes at most 4300 digits
MAX_BITS = 14_000


def as_code(value: object) -> str:
    """Write an MDP, a log, a policy or another plain value as code.

    Parameters
    ----------
    value : FiniteMDP, Transitions, array or plain value
        What is written out: an MDP, a log, an array, a number, a text, None, or a
        sequence or mapping of these.

    Returns
    -------
    str
        An expression of ``np`` (numpy) and ``oee`` (oee_tabular) that evaluates to an
        equal object.

    Raises
    ------
    ValueError
        If it is something else, or too large to be read: an array of more than 400
        numbers, or a log of more than 64 rows.

    Examples
    --------
    >>> import numpy as np
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> print(oee.testing.as_code(coin))
    oee.FiniteMDP(
        transitions=np.array([[[0.5, 0.5]], [[0.5, 0.5]]]),
        rewards=np.array([[0.0], [1.0]]),
        initial=np.array([0.5, 0.5]),
        discount=0.5,
    )
    >>> eval(oee.testing.as_code(coin)).rewards.tolist()
    [[0.0], [1.0]]
    """
    try:
        return _write(value)
    except RecursionError:
        raise ArgumentError(
            "value", "must not be nested so deep, or hold itself"
        ) from None


def _write(value: object) -> str:
    """Write a value, and what is in it."""
    if isinstance(value, FiniteMDP):
        return _call("oee.FiniteMDP", _mdp_arguments(value))
    if isinstance(value, Transitions):
        if len(value) > MAX_ROWS:
            raise ArgumentError(
                "value",
                f"must have at most {MAX_ROWS} rows to be written out; it has"
                f" {len(value)}",
            )
        return _call("oee.Transitions", value.columns())
    if isinstance(value, np.ndarray):
        return _array(value)
    if isinstance(value, np.generic):
        return _write(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return f"{'-' if value < 0 else ''}np.{'nan' if np.isnan(value) else 'inf'}"
    if value is None or isinstance(value, bool):
        return repr(value)
    if isinstance(value, int) and int.bit_length(value) > MAX_BITS:
        return hex(int.__add__(value, 0))
    for kind in (int, float, str):
        if isinstance(value, kind):
            # of a subclass the plain value: its own text may be anything
            return kind.__repr__(value)
    if isinstance(value, Mapping):
        pairs = (f"{_write(key)}: {_write(item)}" for key, item in value.items())
        return f"{{{', '.join(pairs)}}}"
    if isinstance(value, tuple):
        items = [_write(item) for item in value]
        return f"({', '.join(items)}{',' if len(items) == 1 else ''})"
    if isinstance(value, range):
        ends = (value.start, value.stop, value.step)
        return f"range({', '.join(map(_write, ends))})"
    if isinstance(value, Sequence):
        return f"[{', '.join(map(_write, value))}]"
    raise ArgumentError(
        "value",
        "must be an MDP, a log, an array or a plain value; got"
        f" {_checks.show(type(value).__name__)}",
    )


def _call(name: str, arguments: Mapping[str, Any]) -> str:
    """Write a call with an argument a line."""
    lines = [f"    {key}={_indent(_write(value))}," for key, value in arguments.items()]
    return "\n".join([f"{name}(", *lines, ")"])


def _indent(text: str) -> str:
    """Move all lines but the first to the right."""
    return text.replace("\n", "\n    ")


def _array(array: np.ndarray[Any, Any]) -> str:
    """Write an array as np.array(...), with its type where the numbers do not tell."""
    if array.size > MAX_NUMBERS:
        raise ArgumentError(
            "value",
            f"must have at most {MAX_NUMBERS} numbers to be written out; it has"
            f" {array.size}",
        )
    kind = array.dtype
    numbers = _write(array.tolist())
    if array.size and np.asarray(array.tolist()).dtype == kind:
        return f"np.array({numbers})"
    name = "object" if kind.kind == "O" else kind.str
    return f'np.array({numbers}, dtype="{name}")'


def _mdp_arguments(mdp: FiniteMDP) -> dict[str, Any]:
    """Return the arguments that make an MDP, its matrices as dense arrays."""
    shape = (mdp.n_states, mdp.n_actions, mdp.n_states)
    make, _ = mdp.__reduce__()
    given = dict(make.keywords)
    if given.get("sampling") is not None:
        raise ArgumentError(
            "value",
            "must be an MDP that is known exactly; it was estimated from samples (its"
            " file keeps them: mdp.save)",
        )
    if mdp.n_states**2 * mdp.n_actions > MAX_NUMBERS:
        raise ArgumentError(
            "value",
            f"must have at most {MAX_NUMBERS} numbers to be written out; it has"
            f" {mdp.n_states**2 * mdp.n_actions} probabilities",
        )
    given["transitions"] = mdp.transitions.toarray().reshape(shape)
    if mdp.transition_rewards is not None:
        defined = mdp.transition_rewards.tocoo()
        rewards = np.full(defined.shape, np.nan)
        rewards[defined.row, defined.col] = defined.data
        given["rewards"] = rewards.reshape(shape)
    terminal = given.get("terminal_state")
    if terminal is not None and np.array_equal(terminal, np.arange(mdp.n_states)):
        del given["terminal_state"]
    return {name: value for name, value in given.items() if value is not None}


def program(parts: Mapping[str, object], recipes: Mapping[str, str]) -> str:
    """Write assignments as a program.

    Parameters
    ----------
    parts : mapping of str to object
        Names and what they stand for, in their order.
    recipes : mapping of str to str
        For some of the names an expression that makes the same anew, which is written
        where the object is too large.

    Returns
    -------
    str
        The program, with its imports. What is too large and has no recipe is a comment.
    """
    lines = [IMPORTS, ""]
    for name, value in parts.items():
        try:
            lines.append(f"{name} = {_write(value)}")
        except ArgumentError as error:
            if name in recipes:
                lines.append(f"{name} = {recipes[name]}")
            else:
                lines.append(
                    f"# {name}: {_checks.show(value)} is not written out: {error}"
                )
    return "\n".join(lines)
