"""Ratios by a trained network, each with its gap to the optimum over all functions (eq. 3.7) or over all rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, IntArray, Seed
from oee_tabular.mdp.arrays import check_layout
from oee_tabular.mdp.rows import Rows
from oee_tabular.ratio import dual
from oee_tabular.ratio.arguments import check_ridge
from oee_tabular.ratio.density import RatioFit, density_ratio
from oee_tabular.ratio.dual import Coordinates
from oee_tabular.ratio.network import Network
from oee_tabular.ratio.sgd import SgdTrace


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
    """p / q on the cells by a network: counts (or probabilities) p, q and the columns of the cells.

    ``trace`` has excess and error against the optimum over all functions in the box; ``details`` the iteration kept and the
    held-out risk at each check.
    """
    neural, generator = _require_neural(), _checks.generator(seed)
    best = density_ratio(p, q, lower=lower, upper=upper, ridge=ridge, toward=toward, normalized=False)
    p_train, p_held = _split(p, "p", network.held_out, generator)
    q_train, q_held = _split(q, "q", network.held_out, generator)
    lam, places = np.full(len(p), check_ridge(ridge, float(p.sum()))), _places(network, sizes[0])
    training = neural.Training(cells, sizes, places, p_train, q_train, p_held, q_held, lower, upper, lam, toward or 0.0)
    trained = neural.train(network, training, generator)
    pk, qk = p / p.sum(), q / q.sum()
    g, value = trained.ratio, training.risk(trained.ratio, pk, qk)
    risks = [training.risk(each, pk, qk) for each in trained.checked]
    return replace(
        best,
        ratio=_checks.freeze(g),
        enclosure=(np.full(len(p), lower), np.full(len(p), upper)),
        objective=value,
        gap=value - best.dual_bound,
        divergence=float(pk @ np.log(g) - qk @ g + 1.0),
        status=f"trained for {trained.iteration[-1]} iterations",
        trace=_trace(trained, risks, best.objective, best.ratio, (p > 0) | (q > 0)),
        details={"kept": trained.kept, "held_out_risk": trained.held_out},
    )


def fit_rows(
    network: Network, counts: Array, program: Coordinates, rows: Rows, *, seed: Seed
) -> tuple[Array, float, dict[str, Any]]:
    """zeta by a network, each row of zeta P summing to 1: the rows' programs, each with its share of the counts.

    Risk: sum over rows of n_sa / n [sum_s' P z - p log z + curvature/2 (z - center)^2], p = counts / n_sa. Returns zeta on the
    simulator's entries, its risk above the optimum over all rows (nats per transition), and details: the ``trace`` against
    that optimum, ``iterations``, the one kept, the held-out risk at each check.
    """
    neural, generator = _require_neural(), _checks.generator(seed)
    p_train, p_held = _split(counts, "p", network.held_out, generator)
    p, share = counts / counts.sum(), rows.spread(rows.sums(counts / counts.sum()))
    q_train = rows.spread(rows.sums(p_train)) * rows.weights
    q_held = None if p_held is None else rows.spread(rows.sums(p_held)) * rows.weights
    sizes, places = (rows.n_states, rows.n_actions), _places(network, rows.n_states)
    training = neural.Training(
        rows.transitions, sizes, places, p_train, q_train, p_held, q_held, 0.0, np.inf, program.curvature / rows.weights,
        float(program.center[0]), rows,
    )  # fmt: skip
    trained = neural.train(network, training, generator)
    best = dual.solve_rows(program, 0.0, np.inf, rows.indptr)
    weighted = program._replace(p=p, q=share * rows.weights, curvature=share * program.curvature)
    least = dual.objective(best.ratio, weighted)
    excess = dual.objective(trained.ratio, weighted) - least
    details = {
        "trace": _trace(
            trained, [dual.objective(each, weighted) for each in trained.checked], least, best.ratio, share > 0
        ),
        "iterations": int(trained.iteration[-1]),
        "kept": trained.kept,
        "held_out_risk": trained.held_out,
    }
    return trained.ratio, max(excess + float(rows.sums(p) @ best.gap), 0.0), details  # but for rounding


def _require_neural() -> Any:
    """``_neural``: an ImportError in one sentence without the extra."""
    try:
        from oee_tabular.ratio import _neural
    except ImportError:
        raise ImportError(
            "Network needs jax, equinox and optax, which are not installed; in a clone: pip install '.[neural]'"
        ) from None
    return _neural


def _trace(trained: Any, risks: list[float], least: float, ratio: Array, known: BoolArray) -> SgdTrace:
    """Excess risk and error of each check against the optimum, ``least`` at ``ratio``; the error where something is known."""
    errors = [np.abs(each - ratio)[known].mean() for each in trained.checked]
    return SgdTrace(trained.iteration, np.array(risks) - least, np.array(errors))


def _places(network: Network, n_states: int) -> Array | None:
    """(S, c) coordinates, each of mean 0 and standard deviation 1 (0 where it is constant); None: one-hot."""
    if isinstance(network.inputs, str):
        return None
    places = check_layout(network.inputs, n_states, "inputs")
    spread = places.std(axis=0)
    return np.asarray((places - places.mean(axis=0)) / np.where(spread > 0, spread, 1.0))


def _split(weights: Array, name: str, held_out: float, generator: np.random.Generator) -> tuple[Array, Array | None]:
    """Shares to train on and to stop on. Probabilities (q of an exact simulator) are both, whole."""
    if held_out == 0.0:
        return weights / weights.sum(), None
    if (weights != np.round(weights)).any():
        if name == "q":
            return (weights / weights.sum(),) * 2
        raise ValueError("held_out must be 0 if the log's transitions are weighted (discount) or are probabilities")
    total = int(weights.sum())
    size = max(round(held_out * total), 1)
    if size >= total:
        raise ValueError(f"held_out must leave transitions to train on; it keeps out {size} of {total}")
    held = generator.multivariate_hypergeometric(weights.astype(np.int64), size, method="marginals").astype(np.float64)
    return (weights - held) / (total - size), held / size
