"""Training of networks by Algorithm 1, in jax.

This is the only file that imports the extra ``neural``. It uses double precision,
batches from numpy's generator and one thread, so that the same seed gives the same
bits. jax sums in an order that depends on its number of threads, which is fixed when a
process first uses jax; a process that has used it before keeps its own number.
"""

from __future__ import annotations

import functools
import math
import os
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax

from oee_tabular._progress import progress_bar
from oee_tabular.mdp import Rows
from oee_tabular.typing import Array, IntArray

if TYPE_CHECKING:
    from oee_tabular.ratio.network import Network

# The number of iterations between two checks of the held-out risk.
N_ITERATIONS_PER_CHECK = 100
# The number of cells on which a network is evaluated together.
N_CELLS_AT_ONCE = 2**16


class Training(NamedTuple):
    """The data of a training: cells, weights, and the other terms of the risk.

    ``cells`` are the columns s, a and, of transitions, s'; ``places`` (S, c), or None
    for one-hot states; ``sizes`` S and A. ``p``, ``q``: weights to train on, each
    summing to 1; ``held_p``, ``held_q``: weights to stop on, None without. ``ridge``:
    (cells,). ``rows``: those in which sum P g = 1, whose cells are all there are and q
    their share of p times P; None means that the box is the only constraint.
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
    ridge: Array
    toward: float
    rows: Rows | None = None

    def risk(self, g: Array, p: Array, q: Array) -> float:
        """Compute sum q g - sum p log g + ridge/2 sum q (g - toward)^2."""
        return float(q @ (g + self.ridge / 2 * (g - self.toward) ** 2) - p @ np.log(g))

    def held_out_risk(self, g: Array) -> float:
        """Compute the risk on the held-out weights; nan without any."""
        if self.held_p is None or self.held_q is None:
            return np.nan
        return self.risk(g, self.held_p, self.held_q)


class Trained(NamedTuple):
    """The result of a training: the ratio of iteration ``kept``, and all checks.

    ``checked`` and ``held_out`` are the ratio and the held-out risk (nan without) at
    each ``iteration`` checked.
    """

    ratio: Array
    kept: int
    iteration: IntArray
    checked: list[Array]
    held_out: Array


class Perceptron(eqx.Module):  # type: ignore[misc]
    """The perceptron f on cells.

    The first layer is one table an input, since a one-hot vector times a matrix is a
    row of the matrix.
    """

    tables: list[jax.Array]
    bias: jax.Array
    rest: list[eqx.nn.Linear]
    activation: str = eqx.field(static=True)

    def __init__(self, network: Network, training: Training, key: jax.Array):
        """Draw the first parameters, with f = 0 everywhere."""
        n_states, n_actions = training.sizes
        state_width = n_states if training.places is None else training.places.shape[1]
        inputs = [state_width, n_actions, state_width][: len(training.cells)]
        widths = [*network.layers, 1]
        keys = jax.random.split(key, len(inputs) + len(widths))
        # Of one-hot inputs one number an input is not 0.
        n_active = len(inputs) if training.places is None else sum(inputs)
        first = 0.0 if len(widths) == 1 else 1.0 / math.sqrt(n_active)
        self.tables = [
            first * jax.random.normal(k, (n, widths[0]))
            for k, n in zip(keys, inputs, strict=False)
        ]
        self.bias = jnp.zeros(widths[0])
        keys_of_layers = keys[len(inputs) :]
        self.rest = [
            eqx.nn.Linear(n, m, key=k)
            for n, m, k in zip(widths[:-1], widths[1:], keys_of_layers, strict=False)
        ]
        if self.rest:
            # g = 1 at the start.
            self.rest[-1] = jax.tree.map(jnp.zeros_like, self.rest[-1])
        self.activation = network.activation

    def __call__(
        self, places: jax.Array | None, cells: tuple[jax.Array, ...]
    ) -> jax.Array:
        """Compute f at the cells."""
        h = self.bias
        for k, (table, index) in enumerate(zip(self.tables, cells, strict=True)):
            h = h + (table if places is None or k == 1 else places @ table)[index]
        for layer in self.rest:
            h = jax.vmap(layer)(getattr(jax.nn, self.activation)(h))
        return h[:, 0]


class Batch(NamedTuple):
    """The cells of an iteration and their p and q.

    In training by rows also the row of the batch that each cell is in, and its P there.
    """

    index: Any
    p: Any
    q: Any
    row: Any = None
    known: Any = None


class NetworkProgram(eqx.Module):  # type: ignore[misc]
    """The map from f to the ratio, and the batches, cell by cell or row by row.

    ``row``, ``known`` and ``indptr`` are None cell by cell.

    In a box log g = log nu + (log mu - log nu) sigmoid(f + c), and a batch is draws of
    p and draws of q; by rows log zeta = f - log sum_s' P exp f, and a batch is draws of
    p, each with the whole of its row.
    """

    p: jax.Array
    q: jax.Array
    known: jax.Array | None = None
    row: jax.Array | None = None
    indptr: jax.Array | None = None
    widest: int = eqx.field(static=True, default=0)
    span: tuple[float, float] = eqx.field(static=True, default=(0.0, 0.0))

    @classmethod
    def of(cls, training: Training) -> NetworkProgram:
        """Return the program of a training."""
        p = jnp.asarray(training.p)
        q = jnp.asarray(training.q)
        rows = training.rows
        if rows is None:
            return cls(p, q, span=(math.log(training.lower), math.log(training.upper)))
        row = jnp.asarray(rows.spread(np.arange(len(rows))))
        indptr = jnp.asarray(rows.indptr)
        return cls(
            p,
            q,
            jnp.asarray(rows.weights),
            row,
            indptr,
            int(np.diff(rows.indptr).max()),
        )

    def log_ratio(self, f: jax.Array, batch: Batch) -> jax.Array:
        """Compute log g from f on the batch."""
        if self.row is None:
            low, high = self.span
            start = math.log(-low / high) if low < 0.0 < high else 0.0
            return low + (high - low) * jax.nn.sigmoid(f + start)
        # The largest f of each row is subtracted so that exp does not overflow.
        largest = jax.ops.segment_max(f, batch.row, num_segments=len(f))
        top = jax.lax.stop_gradient(largest)[batch.row]
        total = jax.ops.segment_sum(
            batch.known * jnp.exp(f - top), batch.row, num_segments=len(f)
        )
        return f - top - jnp.log(total[batch.row])

    def whole(self) -> Batch:
        """Return the batch of all cells."""
        return Batch(jnp.arange(len(self.p)), self.p, self.q, self.row, self.known)

    def batch(self, drawn: jax.Array) -> Batch:
        """Return the batch of N draws of p and N draws of q.

        By rows it has the whole rows of N draws of p; rows narrower than the widest
        repeat a cell without weight.
        """
        if self.row is None or self.indptr is None or self.known is None:
            size = len(drawn) // 2
            of_p = jnp.asarray(np.repeat([1.0 / size, 0.0], size))
            return Batch(drawn, of_p, of_p[::-1])
        begin = self.indptr[self.row[drawn]]
        end = self.indptr[self.row[drawn] + 1]
        index = begin[:, None] + jnp.arange(self.widest)
        inside = index < end[:, None]
        p = jnp.where(index == drawn[:, None], 1.0 / len(drawn), 0.0)
        index = jnp.where(inside, index, begin[:, None])
        known = jnp.where(inside, self.known[index], 0.0)
        row = jnp.repeat(jnp.arange(len(drawn)), self.widest)
        return Batch(
            index.ravel(), p.ravel(), known.ravel() / len(drawn), row, known.ravel()
        )


@functools.lru_cache(maxsize=16)
def _optimizer(
    name: str, step_size: float, n_iterations: int
) -> optax.GradientTransformation:
    """Return the optimizer, whose step size falls along a quarter of a cosine."""
    steps = optax.cosine_decay_schedule(step_size, n_iterations)
    return optax.adam(steps) if name == "adam" else optax.sgd(steps)


@eqx.filter_jit  # type: ignore[untyped-decorator]
def _iterate(
    model: Any,
    state: Any,
    optimizer: Any,
    places: Any,
    cells: Any,
    program: Any,
    ridge: Any,
    toward: Any,
    draws: Any,
    count: int,
) -> Any:
    """Run ``count`` iterations; return the model, its state and each batch's risk.

    ``draws`` (count, ...) are the cells of each batch; None means all cells.
    """
    moving, fixed = eqx.partition(model, eqx.is_array)

    def risk(moving: Any, batch: Batch) -> Any:
        """Compute the risk of a batch."""
        columns = tuple(column[batch.index] for column in cells)
        f = eqx.combine(moving, fixed)(places, columns)
        log_g = program.log_ratio(f, batch)
        g = jnp.exp(log_g)
        penalty = ridge[batch.index] / 2 * (g - toward) ** 2
        return jnp.sum(batch.q * (g + penalty) - batch.p * log_g)

    def step(carry: Any, drawn: Any) -> Any:
        """Update the parameters by the gradient of one batch's risk."""
        moving, state = carry
        batch = program.whole() if drawn is None else program.batch(drawn)
        value, slope = jax.value_and_grad(risk)(moving, batch)
        change, state = optimizer.update(slope, state)
        return (optax.apply_updates(moving, change), state), value

    (moving, state), values = jax.lax.scan(step, (moving, state), draws, length=count)
    return eqx.combine(moving, fixed), state, values


@eqx.filter_jit  # type: ignore[untyped-decorator]
def _outputs(model: Any, places: Any, cells: Any) -> Any:
    """Compute f at the cells."""
    return model(places, cells)


@functools.cache
def _cpu() -> Any:
    """Return the processor as a device with one thread.

    The environment variable is read when the device is made.
    """
    before = os.environ.get("PJRT_NPROC")
    os.environ["PJRT_NPROC"] = "1"
    try:
        return jax.devices("cpu")[0]
    finally:
        os.environ.pop("PJRT_NPROC")
        if before is not None:
            os.environ["PJRT_NPROC"] = before


def train(
    network: Network, training: Training, generator: np.random.Generator
) -> Trained:
    """Train by Algorithm 1; keep the ratio of least held-out risk, or the last."""
    with jax.default_device(_cpu()), jax.enable_x64(True):
        return _train(network, training, generator)


def _train(
    network: Network, training: Training, generator: np.random.Generator
) -> Trained:
    """Train on the device and in the precision that the caller has set."""
    key = jax.random.key(int(generator.integers(2**31)))
    model = Perceptron(network, training, key)
    optimizer = _optimizer(
        network.optimizer, float(network.step_size), network.n_iterations
    )
    state = optimizer.init(eqx.filter(model, eqx.is_array))
    places = None if training.places is None else jnp.asarray(training.places)
    cells = tuple(jnp.asarray(column) for column in training.cells)
    program = NetworkProgram.of(training)
    ridge = jnp.asarray(training.ridge)
    start = training.risk(np.ones(len(training.p)), training.p, training.q)
    iterations = [0]
    ratios = [_ratio_everywhere(model, places, cells, program, training)]
    held: list[float] = []
    bar = progress_bar("training", total=network.n_iterations)
    while True:
        held.append(training.held_out_risk(ratios[-1]))
        # Where nothing is held out the last ratio is kept.
        kept = len(held) - 1 if math.isnan(held[0]) else int(np.argmin(held))
        n_checks_without_gain = len(held) - 1 - kept
        if iterations[-1] == network.n_iterations:
            break
        if n_checks_without_gain >= network.patience:
            break
        count = min(N_ITERATIONS_PER_CHECK, network.n_iterations - iterations[-1])
        drawn = _draw(network.batch_size, program, generator, count)
        model, state, values = _iterate(
            model,
            state,
            optimizer,
            places,
            cells,
            program,
            ridge,
            training.toward,
            drawn,
            count,
        )
        _refuse_divergence(np.asarray(values), start, iterations[-1], network.step_size)
        iterations.append(iterations[-1] + count)
        ratios.append(_ratio_everywhere(model, places, cells, program, training))
        bar.update(count)
    bar.close()
    return Trained(
        ratios[kept], iterations[kept], np.array(iterations), ratios, np.array(held)
    )


def _ratio_everywhere(
    model: Any, places: Any, cells: Any, program: NetworkProgram, training: Training
) -> Array:
    """Compute g on all cells, clipped to the box."""
    n = len(cells[0])
    parts = [slice(low, low + N_CELLS_AT_ONCE) for low in range(0, n, N_CELLS_AT_ONCE)]
    f = jnp.concatenate(
        [
            _outputs(model, places, tuple(column[part] for column in cells))
            for part in parts
        ]
    )
    g = jnp.exp(program.log_ratio(f, program.whole()))
    return np.asarray(np.clip(np.asarray(g), training.lower, training.upper))


def _draw(
    size: int | None,
    program: NetworkProgram,
    generator: np.random.Generator,
    count: int,
) -> Any:
    """Draw the cells of ``count`` batches, (count, draws), N from each side.

    By rows they are N from p. None means that every batch has all cells.
    """
    if size is None:
        return None
    sides = (program.p, program.q) if program.row is None else (program.p,)
    sums = [np.cumsum(np.asarray(weights)) for weights in sides]
    drawn = [
        np.searchsorted(s, generator.random((count, size)) * s[-1], side="right")
        for s in sums
    ]
    return jnp.asarray(np.minimum(np.concatenate(drawn, axis=1), len(program.p) - 1))


def _refuse_divergence(
    values: Array, start: float, done: int, step_size: float
) -> None:
    """Raise a RuntimeError where training diverges.

    It does where a batch's risk is not finite, or the mean of these batches is 1 nat
    above the risk of g = 1.
    """
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size or values.mean() > start + 1.0:
        at = bad[0] if bad.size else len(values) - 1
        value = values[at] if bad.size else values.mean()
        raise RuntimeError(
            f"training must not diverge; at iteration {done + at + 1} the risk is"
            f" {value:.4g}, at the start it was {start:.4g}: give a smaller step_size"
            f" than {step_size:g}"
        )
