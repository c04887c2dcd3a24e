"""The paper's class of functions: a multilayer perceptron trained by Algorithm 1.

This module has its settings, prepares what its training (on eq. 3.7) is given, and
computes the gap of the trained ratio to the optimum over all functions, or all rows. A
network is trained cell by cell, within a box (``Quotient``), or row by row with q = P
known and each row's sum q g = 1 (``Conditional``). Training needs the extra ``neural``
(jax, equinox, optax).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import Rows, check_layout
from oee_tabular.ratio import dual
from oee_tabular.ratio.density import RatioFit, density_ratio
from oee_tabular.ratio.dual import Coordinates, check_box, check_ridge
from oee_tabular.ratio.sgd import SgdTrace
from oee_tabular.typing import Array, BoolArray, IntArray, RealArrayLike, Seed

Activation: TypeAlias = Literal["relu", "tanh", "gelu", "silu", "softplus"]
Optimizer: TypeAlias = Literal["adam", "sgd"]


@suggest_keywords
@dataclass(frozen=True, eq=False)
class Network:
    """A multilayer perceptron for a ratio, with its training by Algorithm 1.

    With f_theta(s, a[, s']) the perceptron's output

        ``Quotient``:     log g = log nu + (log mu - log nu) sigmoid(f_theta + c),
                          within the box,
        ``Conditional``:  log zeta = f_theta - log sum_s' P exp f_theta,
                          each row of zeta P sums to 1;

    g = 1 where f = 0, as it is at the start, and

        theta <- theta - step d/d theta [mean of g over N draws of q
                                         - mean of log g over N draws of p],

    where ``Conditional`` replaces the draws of q by the known rows of N transitions:
    the log's mean -log zeta.

    Parameters
    ----------
    layers : sequence of int, default (64, 64)
        Widths of the hidden layers; () is a linear f.
    activation : {'relu', 'tanh', 'gelu', 'silu', 'softplus'}, default 'relu'
        Activation of the hidden layers.
    inputs : 'one_hot' or array-like of shape (S,) or (S, c), default 'one_hot'
        One-hot vectors of s, a and s'; or coordinates of the states (standardised),
        with one-hot actions.
    step_size : float, default 0.001
        Step size of the first iteration; it falls to 0 along a quarter of a cosine.
    batch_size : int or None, default 128
        Number N of draws from each side at an iteration. None means full batch, the
        whole log at each.
    n_iterations : int, default 20000
        Largest number of iterations.
    held_out : float, default 0.1
        Share of each log's transitions kept out of batches, to choose the parameters of
        least risk. 0 means that the last parameters are kept.
    patience : int, default 20
        Number of checks of the held-out risk, one every 100 iterations, without a new
        least one, after which training stops.
    optimizer : {'adam', 'sgd'}, default 'adam'
        'sgd' is Algorithm 1 as it is printed (which hardly trains rare cells).

    Raises
    ------
    ImportError
        If the extra is not installed; in a clone: pip install '.[neural]'.
    RuntimeError
        If training diverges; the error has the iteration and the risk.

    See Also
    --------
    Sgd : Algorithm 1 on tables.

    Notes
    -----
    The risk is convex in g, not in theta: training gives no certificate in its class.
    The gap of its ``RatioFit`` is to the optimum over all functions in the box (or over
    all rows), which contain the class. The same seed gives identical results: one
    thread, unless the process has used jax before. Cost: O(n_iterations batch_size sum
    of the products of consecutive widths), in ``Conditional`` times the simulator's
    widest row; about 0.5 ms an iteration for (64, 64) and batches of 128.

    Examples
    --------
    >>> Network((32, 32), "tanh", n_iterations=500)
    Network(layers=(32, 32), activation='tanh', step_size=0.001, batch_size=128, n_iterations=500, held_out=0.1,
            patience=20, optimizer='adam')
    """

    layers: Sequence[int] = (64, 64)
    activation: Activation = "relu"
    inputs: Literal["one_hot"] | RealArrayLike = field(default="one_hot", repr=False)
    step_size: float = 1e-3
    batch_size: int | None = 128
    n_iterations: int = 20_000
    held_out: float = 0.1
    patience: int = 20
    optimizer: Optimizer = "adam"

    def __post_init__(self) -> None:
        """Check the settings of training."""
        widths = _checks.collection(
            self.layers, "layers", "a collection of widths of hidden layers"
        )
        layers = tuple(
            _checks.positive_integer(width, f"layers[{k}]")
            for k, width in enumerate(widths)
        )
        object.__setattr__(self, "layers", layers)
        _checks.one_of(self.activation, "activation", get_args(Activation))
        _checks.one_of(self.optimizer, "optimizer", get_args(Optimizer))
        if isinstance(self.inputs, str):
            _checks.one_of(self.inputs, "inputs", ("one_hot",))
        else:
            places = _checks.float_array(self.inputs, "inputs", ndim=(1, 2))
            _checks.require_finite(places, "inputs")
        _checks.number_in(self.step_size, "step_size", 0.0, np.inf, open_ends=True)
        if self.batch_size is not None:
            _checks.positive_integer(self.batch_size, "batch_size")
        _checks.positive_integer(self.n_iterations, "n_iterations")
        if _checks.number_in(self.held_out, "held_out", 0.0, 1.0) == 1.0:
            raise ArgumentError(
                "held_out", "must leave transitions to train on; it is 1"
            )
        _checks.positive_integer(self.patience, "patience")


def check_network(method: Any) -> None:
    """Raise an error for an option that no method can have beside a network."""
    _checks.instance(method.functions, Network, "functions", "Network(...)")
    if method.solver != "dual":
        raise ArgumentError(
            "solver",
            "must be left out with functions=Network(...), which has its own; got"
            f" {_checks.show(method.solver)}",
        )


def check_boxed_network(method: Any) -> None:
    """Raise an error for an option that eq. 3.7 cannot have with a network in a box."""
    check_network(method)
    if method.normalized:
        raise ArgumentError(
            "normalized",
            "must be False with functions=Network(...): Algorithm 1 imposes no sum q"
            " g = 1",
        )
    box = check_box(method.lower, method.upper, normalized=False)
    if not 0.0 < box.lower < box.upper < np.inf:
        raise ValueError(
            "lower and upper must be a box with 0 < lower < upper < inf with"
            f" functions=Network(...); it is [{box.lower:g}, {box.upper:g}]"
        )
    if method.toward is None and (callable(method.ridge) or method.ridge != 0):
        raise ArgumentError(
            "toward",
            "must be a number with functions=Network(...) and a ridge: sum g^2 has no"
            " batches",
        )


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
    seed: Seed,
) -> RatioFit:
    """Fit p / q on the cells by a network.

    p and q are counts or probabilities; ``cells`` the columns of the cells. ``trace``
    has excess and error against the optimum over all functions in the box; ``details``
    the iteration kept and the held-out risk at each check.
    """
    neural = _require_neural()
    generator = _checks.generator(seed)
    best = density_ratio(
        p, q, lower=lower, upper=upper, ridge=ridge, toward=toward, normalized=False
    )
    p_train, p_held = _split(p, "p", network.held_out, generator)
    q_train, q_held = _split(q, "q", network.held_out, generator)
    lam = np.full(len(p), check_ridge(ridge, float(p.sum())))
    places = _places(network, sizes[0])
    training = neural.Training(
        cells,
        sizes,
        places,
        p_train,
        q_train,
        p_held,
        q_held,
        lower,
        upper,
        lam,
        toward or 0.0,
    )
    trained = neural.train(network, training, generator)
    pk = p / p.sum()
    qk = q / q.sum()
    g = trained.ratio
    value = training.risk(trained.ratio, pk, qk)
    risks = [training.risk(each, pk, qk) for each in trained.checked]
    return replace(
        best,
        ratio=_checks.freeze(g),
        enclosure=(np.full(len(p), lower), np.full(len(p), upper)),
        objective=value,
        # Rounding may make the difference negative.
        gap=max(value - best.dual_bound, 0.0),
        divergence=float(pk @ np.log(g) - qk @ g + 1.0),
        status=f"trained for {trained.iteration[-1]} iterations",
        trace=_trace(trained, risks, best.objective, best.ratio, (p > 0) | (q > 0)),
        details={"kept": trained.kept, "held_out_risk": trained.held_out},
    )


def fit_rows(
    network: Network, counts: Array, program: Coordinates, rows: Rows, *, seed: Seed
) -> tuple[Array, float, dict[str, Any]]:
    """Fit zeta by a network, each row of zeta P summing to 1.

    The program is that of all rows, each with its share of the counts.

    Risk: sum over rows of n_sa / n [sum_s' P z - p log z + curvature/2 (z - center)^2],
    p = counts / n_sa. Returns zeta on the simulator's entries, its risk above the
    optimum over all rows (nats per transition), and details: the ``trace`` against that
    optimum, ``iterations``, the one kept, the held-out risk at each check.
    """
    neural = _require_neural()
    generator = _checks.generator(seed)
    p_train, p_held = _split(counts, "p", network.held_out, generator)
    p = counts / counts.sum()
    share = rows.spread(rows.sums(counts / counts.sum()))
    q_train = rows.spread(rows.sums(p_train)) * rows.weights
    q_held = None
    if p_held is not None:
        q_held = rows.spread(rows.sums(p_held)) * rows.weights
    sizes = (rows.n_states, rows.n_actions)
    places = _places(network, rows.n_states)
    training = neural.Training(
        rows.transitions,
        sizes,
        places,
        p_train,
        q_train,
        p_held,
        q_held,
        0.0,
        np.inf,
        program.curvature / rows.weights,
        float(program.center[0]),
        rows,
    )
    trained = neural.train(network, training, generator)
    best = dual.solve_rows(program, 0.0, np.inf, rows.indptr)
    weighted = program._replace(
        p=p, q=share * rows.weights, curvature=share * program.curvature
    )
    least = dual.objective(best.ratio, weighted)
    excess = dual.objective(trained.ratio, weighted) - least
    risks = [dual.objective(each, weighted) for each in trained.checked]
    details = {
        "trace": _trace(trained, risks, least, best.ratio, share > 0),
        "iterations": int(trained.iteration[-1]),
        "kept": trained.kept,
        "held_out_risk": trained.held_out,
    }
    # Rounding may make the gap negative.
    gap = max(excess + float(rows.sums(p) @ best.gap), 0.0)
    return trained.ratio, gap, details


def _require_neural() -> Any:
    """Import the module that trains, or raise an ImportError in one sentence."""
    try:
        from oee_tabular.ratio import _neural
    except ImportError:
        raise ImportError(
            "Network needs jax, equinox and optax, which are not installed; in a clone:"
            " pip install '.[neural]'"
        ) from None
    return _neural


def _trace(
    trained: Any, risks: list[float], least: float, ratio: Array, known: BoolArray
) -> SgdTrace:
    """Return the excess risk and the error of each check against the optimum.

    The optimum is ``least``, at ``ratio``; the error is the mean over ``known`` cells.
    """
    errors = [np.abs(each - ratio)[known].mean() for each in trained.checked]
    return SgdTrace(trained.iteration, np.array(risks) - least, np.array(errors))


def _places(network: Network, n_states: int) -> Array | None:
    """Return standardised coordinates, (S, c), or None for one-hot states.

    A constant coordinate is 0.
    """
    if isinstance(network.inputs, str):
        return None
    places = check_layout(network.inputs, n_states, "inputs")
    deviation = places.std(axis=0)
    unit = np.where(deviation > 0, deviation, 1.0)
    return np.asarray((places - places.mean(axis=0)) / unit)


def _split(
    weights: Array, name: str, held_out: float, generator: np.random.Generator
) -> tuple[Array, Array | None]:
    """Return the shares to train on and to stop on, each summing to 1.

    Probabilities (q of an exact simulator) are used whole for both.
    """
    if held_out == 0.0:
        return weights / weights.sum(), None
    if (weights != np.round(weights)).any():
        if name == "q":
            return weights / weights.sum(), weights / weights.sum()
        raise ArgumentError(
            "held_out",
            "must be 0 if the log's transitions are weighted (discount) or are"
            " probabilities",
        )
    total = int(weights.sum())
    size = max(round(held_out * total), 1)
    if size >= total:
        raise ArgumentError(
            "held_out",
            f"must leave transitions to train on; it keeps out {size} of {total}",
        )
    held = generator.multivariate_hypergeometric(
        weights.astype(np.int64), size, method="marginals"
    ).astype(np.float64)
    return (weights - held) / (total - size), held / size
