"""The arrays of an MDP's npz file, P and r(s, a, s') as the parts of csr matrices."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._sparse import csr_from_parts
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp.empirical import Sampling
from oee_tabular.mdp.naming import from_text, to_text
from oee_tabular.typing import Csr

if TYPE_CHECKING:
    from oee_tabular.mdp.finite_mdp import FiniteMDP

_PARTS = ("data", "indices", "indptr")


def file_arrays(mdp: FiniteMDP, layout: object) -> dict[str, Any]:
    """Return the arrays that the file of an MDP holds.

    ``layout``: the one that was given, without the coordinates of names.
    """
    pairs, starts, error = mdp.sampling or (None, None, None)
    arrays = {
        "shape": mdp.rewards.shape,
        "rewards": mdp.rewards if mdp.reward_data is None else None,
        "initial": mdp.initial,
        "discount": mdp.discount,
        "terminal_state": mdp.terminal_state,
        "layout": layout,
        "sampling_pairs": pairs,
        "sampling_starts": starts,
        "state_names": mdp.state_names and to_text(mdp.state_names),
        "action_names": mdp.action_names and to_text(mdp.action_names),
        "available": None if mdp.has_all_actions else mdp.available,
    }
    tables = {
        "transitions": mdp.csr,
        "rewards": mdp.transition_rewards,
        "sampling_error": error,
    }
    for name, table in tables.items():
        arrays |= {
            f"{name}_{part}": None if table is None else getattr(table, part)
            for part in _PARTS
        }
    return {
        name: np.asarray(array) for name, array in arrays.items() if array is not None
    }


def constructor_arguments(arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of ``FiniteMDP`` from the arrays of a file.

    Raises KeyError or ValueError where they are not those of an MDP.
    """
    sizes = arrays["shape"]
    if sizes.shape != (2,) or sizes.dtype.kind not in "iu" or sizes.min() < 1:
        raise ArgumentError(
            "shape",
            "must be two positive integers, states and actions; it is"
            f" {sizes.tolist()!r:.80}",
        )
    n_states, n_actions = sizes.tolist()
    shape = n_states * n_actions, n_states
    if "rewards" in arrays:
        rewards = arrays["rewards"]
    else:
        rewards = _read_csr(arrays, "rewards", shape)
    arguments = {
        "transitions": _read_csr(arrays, "transitions", shape),
        "rewards": rewards,
        "initial": arrays["initial"],
        "discount": float(_checks.float_array(arrays["discount"], "discount", ndim=0)),
        "terminal_state": arrays["terminal_state"],
        "layout": arrays.get("layout"),
        "sampling": None,
        "available": arrays.get("available"),
    }
    if "sampling_pairs" in arrays:
        arguments["sampling"] = _read_sampling(arrays, shape)
    for name in ("state_names", "action_names"):
        if name in arrays:
            arguments[name] = from_text(arrays[name], name)
    return arguments


def _read_csr(arrays: Mapping[str, Any], name: str, shape: tuple[int, int]) -> Csr:
    """Read the csr matrix of this name from its three arrays."""
    data, indices, indptr = (arrays[f"{name}_{part}"] for part in _PARTS)
    return csr_from_parts(data, indices, indptr, shape, name)


def _read_sampling(arrays: Mapping[str, Any], shape: tuple[int, int]) -> Sampling:
    """Read and check the numbers of samples of an MDP."""
    pairs = _checks.float_array(arrays["sampling_pairs"], "sampling_pairs", ndim=1)
    starts = float(
        _checks.float_array(arrays["sampling_starts"], "sampling_starts", ndim=0)
    )
    if pairs.shape != shape[:1] or not (pairs >= 0).all() or not starts > 0:
        raise ArgumentError(
            "sampling_pairs",
            f"must be {shape[0]} numbers of samples, and sampling_starts positive",
        )
    error = None
    if "sampling_error_data" in arrays:
        error = _read_csr(arrays, "sampling_error", shape)
    return Sampling(pairs, starts, error)
