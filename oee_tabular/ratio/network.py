"""The paper's class of functions: g is a multilayer perceptron, trained on eq. 3.7 by Algorithm 1.

Needs the extra ``neural`` (jax, equinox, optax), which is imported by ``fit_network`` alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular.mdp.layout import check_layout
from oee_tabular.ratio.density import RatioFit, density_ratio
from oee_tabular.ratio.sgd import SgdTrace

ACTIVATIONS = ("relu", "tanh", "gelu", "silu", "softplus")
OPTIMIZERS = ("adam", "sgd")


@dataclass(frozen=True, eq=False)
class Network:
    """A multilayer perceptron g_theta(s, a[, s']) within the box, and how Algorithm 1 trains it.

        log g = log nu + (log mu - log nu) sigmoid(f_theta + c),   g = 1 where f = 0, as it is at the start,
        theta <- theta - step d/d theta [mean of g over N draws of q - mean of log g over N draws of p].

    Parameters
    ----------
    layers : widths of the hidden layers; () is a linear f
    activation : "relu" | "tanh" | "gelu" | "silu" | "softplus"
    inputs : "one_hot": of s, a and s'; or (S,) or (S, c) coordinates of the states (standardised), actions one-hot
    step_size : of the first iteration; it falls to 0 along a quarter of a cosine
    batch_size : draws of each side an iteration (N); None: the whole log at each, full batch
    n_iterations : at most
    held_out : the share of each log's moves that no batch has; the parameters of least risk on them are kept. 0: the last
    patience : training stops after so many checks of the held-out risk, one every 100 iterations, without a new least one
    optimizer : "adam", or "sgd" as Algorithm 1 is printed (cells that are seldom seen hardly move under it)

    Raises
    ------
    ImportError
        Where it is used without the extra: pip install 'oee-tabular[neural]'.
    RuntimeError
        A training that diverges, with its iteration and its risk.

    Notes
    -----
    The risk is convex in g, not in theta: what training finds has no certificate in its class. The gap of its ``RatioFit`` is
    to the optimum over all functions in the box, which contains the class. The same seed gives the same bits: one thread,
    unless the process has used jax before, with its own. Cost: O(n_iterations batch_size sum of the products of consecutive
    widths); about 0.5 ms an iteration for (64, 64) and batches of 128.

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
            raise ValueError("held_out must leave moves to train on; it is 1")
        _checks.positive_integer(self.patience, "patience")


@dataclass(frozen=True, eq=False)
class Training:
    """What ``_neural.train`` gets: the cells, their weights (each side's sum to 1), and the risk's other terms.

    ``cells`` are the columns s, a and, for moves, s'; ``places`` (S, c), or None for one-hot states; ``sizes`` S and A.
    ``p``, ``q`` : train on; ``held_p``, ``held_q`` : stop on, None without.
    """

    cells: tuple[IntArray, ...]
    sizes: tuple[int, int]
    places: Array | None
    p: Array
    q: Array
    held_p: Array | None
    held_q: Array | None
    lower: float
    upper: float
    ridge: float
    toward: float

    def risk(self, g: Array, p: Array, q: Array) -> float:
        """sum q g - sum p log g + ridge/2 sum q (g - toward)^2."""
        return float(q @ (g + self.ridge / 2 * (g - self.toward) ** 2) - p @ np.log(g))


def check_network(
    network: Any, *, lower: Any, upper: Any, ridge: Any, toward: Any, normalized: bool, solver: Any
) -> None:
    """What eq. 3.7 over a network can't have: a ValueError, at the making of the method."""
    _checks.instance(network, Network, "functions", "Network(...)")
    if normalized:
        raise ValueError("normalized must be False with functions=Network(...): Algorithm 1 imposes no sum q g = 1")
    if solver != "dual":
        raise ValueError(f"solver must be left out with functions=Network(...), which has its own; got {solver!r}")
    box = _checks.box(lower, upper, normalized=False)
    if not 0.0 < box.lower < box.upper < np.inf:
        raise ValueError(
            "lower and upper must be a box with 0 < lower < upper < inf with functions=Network(...); "
            f"it is [{box.lower:g}, {box.upper:g}]"
        )
    if toward is None and (callable(ridge) or ridge != 0):
        raise ValueError("toward must be a number with functions=Network(...) and a ridge: sum g^2 has no batches")


def fit_network(
    network: Network,
    p: Array,
    q: Array,
    cells: tuple[IntArray, ...],
    sizes: tuple[int, int],
    *,
    lower: float,
    upper: float,
    ridge: float | Callable[[Any], Any],
    toward: float | None,
    seed: Any,
) -> RatioFit:
    """p / q on the cells by a network: counts (or probabilities) p, q and the columns of the cells.

    ``trace`` has excess and error against the optimum over all functions in the box; ``details`` the iteration kept and the
    held-out risk at each check.
    """
    try:
        from oee_tabular.ratio import _neural
    except ImportError:
        raise ImportError(
            "Network needs jax, equinox and optax, which are not installed: pip install 'oee-tabular[neural]'"
        ) from None
    generator = _checks.generator(seed)
    best = density_ratio(p, q, lower=lower, upper=upper, ridge=ridge, toward=toward, normalized=False)
    places = None if isinstance(network.inputs, str) else _standard(check_layout(network.inputs, sizes[0], "inputs"))
    (p_train, p_held), (q_train, q_held) = (
        _split(w, name, network.held_out, generator) for w, name in ((p, "p"), (q, "q"))
    )
    lam = _checks.ridge(ridge, float(p.sum()))
    training = Training(cells, sizes, places, p_train, q_train, p_held, q_held, lower, upper, lam, toward or 0.0)
    found = _neural.train(network, training, generator)
    pk, qk = p / p.sum(), q / q.sum()
    g, known = found.ratio, (p > 0) | (q > 0)
    value = training.risk(g, pk, qk)
    trace = SgdTrace(
        found.iteration,
        np.array([training.risk(each, pk, qk) - best.objective for each in found.checked]),
        np.array([np.abs(each - best.ratio)[known].mean() for each in found.checked]),
    )
    return replace(
        best,
        ratio=_checks.freeze(g),
        enclosure=(np.full(len(g), lower), np.full(len(g), upper)),
        objective=value,
        gap=value - best.dual_bound,
        divergence=float(pk @ np.log(g) - qk @ g + 1.0),
        status=f"trained for {found.iteration[-1]} iterations",
        trace=trace,
        details={"kept": found.kept, "held_out_risk": found.held_out},
    )


def _standard(places: Array) -> Array:
    """Each coordinate with mean 0 and standard deviation 1 over the states; a constant one is 0."""
    centred = places - places.mean(axis=0)
    spread = centred.std(axis=0)
    return np.asarray(centred / np.where(spread > 0, spread, 1.0))


def _split(weights: Array, name: str, held_out: float, generator: np.random.Generator) -> tuple[Array, Array | None]:
    """Shares to train on and to stop on. Probabilities (q of an exact simulator) are both, whole."""
    if held_out == 0.0:
        return weights / weights.sum(), None
    if (weights != np.round(weights)).any():
        if name == "q":
            return (weights / weights.sum(),) * 2
        raise ValueError(
            "held_out must be 0 where the log's moves are weighted (discount) or are probabilities: none can be held out"
        )
    total = int(weights.sum())
    size = max(round(held_out * total), 1)
    if size >= total:
        raise ValueError(f"held_out must leave moves to train on; it holds {size} of {total} out")
    held = generator.multivariate_hypergeometric(weights.astype(np.int64), size, method="marginals").astype(np.float64)
    return (weights - held) / (total - size), held / size
