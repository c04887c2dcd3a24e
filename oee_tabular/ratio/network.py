"""The paper's class of functions: g is a multilayer perceptron, trained on eq. 3.7 by Algorithm 1.

What a user states of it, and what its training is given: cell by cell, within a box (``Quotient``), or row by row with q = P
known, each row's sum q g = 1 (``Conditional``). Training needs the extra ``neural`` (jax, equinox, optax).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular.ratio.arguments import check_box

ACTIVATIONS = ("relu", "tanh", "gelu", "silu", "softplus")
OPTIMIZERS = ("adam", "sgd")


@dataclass(frozen=True, eq=False)
class Network:
    """A multilayer perceptron f_theta(s, a[, s']) for a ratio, and its training by Algorithm 1.

        ``Quotient``:     log g = log nu + (log mu - log nu) sigmoid(f_theta + c),   within the box,
        ``Conditional``:  log zeta = f_theta - log sum_s' P exp f_theta,             each row of zeta P sums to 1;

    g = 1 where f = 0, as it is at the start, and

        theta <- theta - step d/d theta [mean of g over N draws of q - mean of log g over N draws of p],

    where ``Conditional`` replaces the draws of q by the known rows of N transitions: the log's mean -log zeta.

    Parameters
    ----------
    layers : widths of the hidden layers; () is a linear f
    activation : "relu" | "tanh" | "gelu" | "silu" | "softplus"
    inputs : "one_hot": of s, a and s'; or (S,) or (S, c) coordinates of the states (standardised), actions one-hot
    step_size : of the first iteration; it falls to 0 along a quarter of a cosine
    batch_size : draws of each side an iteration (N); None: the whole log at each, full batch
    n_iterations : at most
    held_out : the share of each log's transitions kept out of batches, to choose the parameters of least risk. 0: the last
    patience : training stops after so many checks of the held-out risk, one every 100 iterations, without a new least one
    optimizer : "adam", or "sgd" as Algorithm 1 is printed (which hardly trains rare cells)

    Raises
    ------
    ImportError
        Without the extra; in a clone: pip install '.[neural]'.
    RuntimeError
        A training that diverges, with its iteration and its risk.

    Notes
    -----
    The risk is convex in g, not in theta: training gives no certificate in its class. The gap of its ``RatioFit`` is
    to the optimum over all functions in the box (or over all rows), which contain the class. The same seed gives identical
    results: one thread, unless the process has used jax before. Cost: O(n_iterations batch_size sum of the products of
    consecutive widths), in ``Conditional`` times the simulator's widest row; about 0.5 ms an iteration for (64, 64) and
    batches of 128.

    Examples
    --------
    >>> Network((32, 32), "tanh", n_iterations=500)
    Network(layers=(32, 32), activation='tanh', step_size=0.001, batch_size=128, n_iterations=500, held_out=0.1,
            patience=20, optimizer='adam')
    """

    layers: tuple[int, ...] = (64, 64)
    activation: str = "relu"
    inputs: Any = field(default="one_hot", repr=False)
    step_size: float = 1e-3
    batch_size: int | None = 128
    n_iterations: int = 20_000
    held_out: float = 0.1
    patience: int = 20
    optimizer: str = "adam"

    def __post_init__(self) -> None:
        widths = _checks.collection(self.layers, "layers", "a collection of widths of hidden layers")
        object.__setattr__(
            self, "layers", tuple(_checks.positive_integer(w, f"layers[{k}]") for k, w in enumerate(widths))
        )
        _checks.one_of(self.activation, "activation", ACTIVATIONS)
        _checks.one_of(self.optimizer, "optimizer", OPTIMIZERS)
        if isinstance(self.inputs, str):
            _checks.one_of(self.inputs, "inputs", ("one_hot",))
        else:
            _checks.require_finite(_checks.float_array(self.inputs, "inputs", ndim=(1, 2)), "inputs")
        _checks.number_in(self.step_size, "step_size", 0.0, np.inf, open_ends=True)
        if self.batch_size is not None:
            _checks.positive_integer(self.batch_size, "batch_size")
        _checks.positive_integer(self.n_iterations, "n_iterations")
        if _checks.number_in(self.held_out, "held_out", 0.0, 1.0) == 1.0:
            raise ValueError("held_out must leave transitions to train on; it is 1")
        _checks.positive_integer(self.patience, "patience")


def check_network(method: Any) -> None:
    """What no method can have with a network: a ValueError, at the making of the method."""
    _checks.instance(method.functions, Network, "functions", "Network(...)")
    if method.solver != "dual":
        raise ValueError(
            f"solver must be left out with functions=Network(...), which has its own; got {_checks.show(method.solver)}"
        )


def check_boxed_network(method: Any) -> None:
    """Nor eq. 3.7 without rows."""
    check_network(method)
    if method.normalized:
        raise ValueError("normalized must be False with functions=Network(...): Algorithm 1 imposes no sum q g = 1")
    box = check_box(method.lower, method.upper, normalized=False)
    if not 0.0 < box.lower < box.upper < np.inf:
        raise ValueError(
            "lower and upper must be a box with 0 < lower < upper < inf with functions=Network(...); "
            f"it is [{box.lower:g}, {box.upper:g}]"
        )
    if method.toward is None and (callable(method.ridge) or method.ridge != 0):
        raise ValueError("toward must be a number with functions=Network(...) and a ridge: sum g^2 has no batches")
