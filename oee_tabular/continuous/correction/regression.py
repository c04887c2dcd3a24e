"""Regressions on the steps of a log: the functions of which a correction is made.

Ridge regression chooses for each target among nested classes of functions of (s, a) by
held-out error over episodes (``Grams``). All that fits, held-out errors and refits on
resampled episodes need is

    G[group, a] = sum over the group's rows of action a of (phi, y) (phi, y)^T;

with weights k over groups, the coefficients of a class C are w = (sum_g k_g G_CC +
ridge)^-1 sum_g k_g G_Cy, and the squared error on a group is y'y - 2 w'G_Cy + w'G_CC w.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from oee_tabular import _checks
from oee_tabular._compiling import njit
from oee_tabular.continuous.task.base import (
    ContinuousTask,
)
from oee_tabular.typing import Array, BoolArray, IntArray, Seed

ROWS = 256  # at a time, in a kernel: their inputs stay in the nearest cache
BLOCK = 4096  # rows at a time
FOLDS = 4
MAX_GRAM_BYTES = 48e6
N_FREQUENCIES = 128  # of random cosines
MAX_PAIRED_INPUTS = 24  # above, products of inputs are no functions
RIDGES = (1e-3, 1e-5, 1e-9)  # shares of a column's mean square
# errors that differ by less than this share of a target's mean square are equal
EQUAL_SHARE = 1e-10


@njit(cache=True)
def _standardise(z, rows, a, inputs, kept, limits):
    """Write the inputs of some rows of action ``a`` into z[1:], standardised.

    ``inputs`` are x (n, .), the command of each action, and d (n, .); ``kept`` numbers
    those that are used among all, ``limits`` (4, m) are the least and the most of each,
    its centre and 1 over its scale.
    """
    x, commands, d = inputs
    n_x = x.shape[1]
    n_c = commands.shape[1]
    for i in range(len(kept)):
        j = kept[i]
        for r in range(len(rows)):
            if j < n_x:
                value = x[rows[r], j]
            elif j < n_x + n_c:
                value = commands[a, j - n_x]
            else:
                value = d[rows[r], j - n_x - n_c]
            inside = min(max(value, limits[0, i]), limits[1, i])
            z[i + 1, r] = (inside - limits[2, i]) * limits[3, i]


@njit(cache=True)
def _compute_function(phi, z, j, products, waves):
    """Write the function ``j`` of each row of inputs ``z`` (1 + m, rows) into ``phi``.

    phi_j = z[first_j] z[second_j],  j < q
    phi_j = cos(sum_i z_i frequency_ij + phase_j),  j >= q
    """
    first, second = products
    frequencies, phases = waves
    q = len(first)
    size = len(phi)
    if j < q:
        left = z[first[j]]
        right = z[second[j]]
        for r in range(size):
            phi[r] = left[r] * right[r]
        return
    phi[:] = phases[j - q]
    for i in range(len(z) - 1):
        c = frequencies[i, j - q]
        left = z[i + 1]
        for r in range(size):
            phi[r] += c * left[r]
    for r in range(size):
        phi[r] = math.cos(phi[r])


@njit(cache=True)
def _predict(inputs, actions, order, kept, limits, products, waves, w, ends):
    """Compute values g_k = sum_j w[a, j, k] phi_j, (n, k), kept within ``ends`` (2, k).

    The functions phi_j are ``_compute_function``'s over z = (1, inputs kept within what
    was logged and standardised), as ``_standardise`` makes them. A row is summed in the
    order of j, whatever rows stand beside it, so its bits depend on nothing else; the
    inner loops run over rows of one action, side by side in the processor's registers.
    ``order`` sorts rows by action.
    """
    n = len(actions)
    k = w.shape[2]
    found = np.zeros((n, k))
    z = np.ones((len(kept) + 1, ROWS))
    functions = np.empty(ROWS)
    total = np.empty((k, ROWS))
    begin = 0
    while begin < n:
        a = actions[order[begin]]
        size = 1
        while size < ROWS and begin + size < n and actions[order[begin + size]] == a:
            size += 1
        rows = order[begin : begin + size]
        _standardise(z, rows, a, inputs, kept, limits)
        phi = functions[:size]
        total[:] = 0.0
        for j in range(w.shape[1]):
            if not w[a, j].any():
                continue
            _compute_function(phi, z, j, products, waves)
            for t in range(k):
                c = w[a, j, t]
                part = total[t]
                if c != 0.0:
                    for r in range(size):
                        part[r] += c * phi[r]
        for r in range(size):
            for t in range(k):
                found[rows[r], t] = min(max(total[t, r], ends[0, t]), ends[1, t])
        begin += size
    return found


class Functions:
    """Functions phi(s, a): products of (1, x, d), and cos(w (x, d) + b).

    Their inputs are standardised and kept within what was logged. x are the task's
    ``smooth`` coordinates and the command, d = f(s, a) - s is the displacement.

    Attributes
    ----------
    nested : dict from str to ndarray of int
        The columns of each class of functions by its name, the simplest first.
    width : int
        The number of columns.
    n_actions : int
        The number of actions.
    """

    def __init__(
        self,
        task: ContinuousTask,
        states: Array,
        actions: IntArray,
        displacement: Array,
        commands: Array | None,
        rng: np.random.Generator,
    ) -> None:
        self._task = task
        self.n_actions = task.n_actions
        self._commands = np.array(task.actions, dtype=np.float64).reshape(
            task.n_actions, -1
        )
        raw = self._stack_inputs(states, actions, displacement, commands)
        self._kept, self._limits = _choose_inputs(raw)
        m = len(self._kept)
        n_waves = N_FREQUENCIES if m > 0 else 0
        self._frequencies, self._phases = _draw_waves(m, n_waves, rng)
        first, second = np.triu_indices(m if m <= MAX_PAIRED_INPUTS else 0)
        # 0 is the constant 1
        self._first = np.concatenate([np.zeros(1 + m, dtype=np.int64), first + 1])
        self._second = np.concatenate([np.arange(1 + m), second + 1])
        self.width = len(self._first) + n_waves
        is_of_x = self._kept < raw.shape[1] - displacement.shape[1]
        self.nested: dict[str, IntArray] = self._nest(m, int(is_of_x.sum()))

    def _stack_inputs(
        self,
        states: Array,
        actions: IntArray,
        displacement: Array,
        commands: Array | None,
    ) -> Array:
        """Return the inputs side by side: smooth coordinates, commands, displacements.

        ``commands`` (n, k) are those of the rows; None means those of their actions.
        """
        given = self._commands[actions] if commands is None else commands
        return np.column_stack([self._task.smooth(states), given, displacement])

    def _nest(self, m: int, n_x: int) -> dict[str, IntArray]:
        """Return the columns of each class, the simplest first.

        Of the ``m`` inputs the first ``n_x`` are coordinates and commands, the others
        displacements. The second factor of a product is its later input.
        """
        linear = np.arange(1 + m)
        of_x = linear[: 1 + n_x]
        products_of_x = np.flatnonzero(self._second[1 + m :] <= n_x)
        return _drop_equal(
            {
                "zero": linear[:0],
                "mean": linear[:1],
                "linear": of_x,
                "displacement": np.delete(linear, np.arange(1, 1 + n_x)),
                "linear, displacement": linear,
                "quadratic": np.concatenate([of_x, 1 + m + products_of_x]),
                "quadratic, displacement": np.arange(len(self._second)),
                "Fourier": np.arange(self.width),
            }
        )

    def __call__(
        self,
        states: Array,
        actions: IntArray,
        displacement: Array,
        commands: Array | None = None,
    ) -> Array:
        """Compute every column, (n, width).

        ``commands`` (n, k) are those of the rows; None means those of their actions.
        """
        raw = self._stack_inputs(states, actions, displacement, commands)
        raw = raw[:, self._kept]
        low, high, centre, slope = self._limits
        z = (np.clip(raw, low, high) - centre) * slope
        one = np.column_stack([np.ones(len(z)), z])
        waves = np.cos(z @ self._frequencies + self._phases)
        return np.column_stack([one[:, self._first] * one[:, self._second], waves])

    def stack(self, fits: Sequence[Fit]) -> Array:
        """Return the coefficients of all fits, (A, columns, len(fits))."""
        width = max(int(fit.columns.max(initial=-1)) for fit in fits) + 1
        w = np.zeros((self.n_actions, width, len(fits)))
        for k, fit in enumerate(fits):
            w[:, fit.columns, k] = fit.coefficients
        return w

    def predict(
        self,
        states: Array,
        actions: IntArray,
        displacement: Array,
        w: Array,
        ends: Array,
        commands: Array | None = None,
    ) -> Array:
        """Compute sums over columns weighted by w (A, columns, k), (n, k).

        They are kept within ``ends`` (2, k). The sums are compiled and cost O(n p k).
        Rows with commands of their own, which only a log has, are not compiled.
        """
        if commands is not None:
            found = np.empty((len(states), w.shape[2]))
            for at in np.array_split(np.arange(len(states)), 1 + len(states) // BLOCK):
                phi = self(states[at], actions[at], displacement[at], commands[at])
                for a in np.unique(actions[at]):
                    rows = actions[at] == a
                    found[at[rows]] = phi[rows][:, : w.shape[1]] @ w[a]
            return np.clip(found, *ends)
        q = min(w.shape[1], len(self._first))
        given = (self._task.smooth(states), displacement)
        # so that one kernel takes all
        x, d = (np.require(each, requirements=["C", "W"]) for each in given)
        a = np.require(actions, np.int64, ["C", "W"])
        order = np.argsort(actions.astype(np.int16), kind="stable")
        inputs = (x, self._commands, d)
        products = (self._first[:q], self._second[:q])
        waves = (self._frequencies, self._phases)
        return np.asarray(
            _predict(
                inputs, a, order, self._kept, self._limits, products, waves, w, ends
            )
        )


def _choose_inputs(raw: Array) -> tuple[IntArray, Array]:
    """Return which inputs are used, and how they are standardised, (4, m).

    Inputs that do not vary are left out, and multiples of an earlier one. Of each that
    is used, the rows are the least, the most, the centre and 1 over the scale.
    """
    centre = raw.mean(axis=0)
    scale = raw.std(axis=0)
    moving = np.flatnonzero(scale > 1e-12 * (1.0 + np.abs(centre)))
    z = (raw[:, moving] - centre[moving]) / scale[moving]
    alike = np.abs(z.T @ z) / len(z) > 1.0 - 1e-9
    is_new = [not alike[i, :i].any() for i in range(len(moving))]
    kept = moving[is_new]
    low = raw.min(axis=0)
    high = raw.max(axis=0)
    return kept, np.stack([low[kept], high[kept], centre[kept], 1.0 / scale[kept]])


def _draw_waves(m: int, n_waves: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw frequencies (m, n_waves) and phases of random cosines of ``m`` inputs."""
    reach = rng.choice([0.25, 0.5, 1.0], size=n_waves) * np.sqrt(2.0 / max(m, 1))
    frequencies = rng.standard_normal((m, n_waves)) * reach
    return frequencies, rng.uniform(0.0, 2.0 * np.pi, n_waves)


def _drop_equal(classes: dict[str, IntArray]) -> dict[str, IntArray]:
    """Return classes of functions by their columns, of equal ones the first.

    Without displacements or products some are the same.
    """
    different: dict[str, IntArray] = {}
    for name, columns in classes.items():
        if not any(np.array_equal(columns, other) for other in different.values()):
            different[name] = columns
    return different


@dataclass(frozen=True)
class Fit:
    """The correction g of one target.

    Attributes
    ----------
    kind : str
        The name of the class of functions.
    per_action : bool
        Whether each action has its own coefficients.
    ridge : float
        The ridge, as a share of a column's mean square.
    columns : ndarray of int, shape (p,)
        The columns of the class.
    coefficients : ndarray of shape (A, p)
        Their coefficients.
    error : float
        The sum of its squared errors on episodes to which it was not fitted.
    t_statistic : float
        How many standard errors (over groups of episodes) that is below the error of g
        = 0.
    """

    kind: str
    per_action: bool
    ridge: float
    columns: IntArray
    coefficients: Array
    error: float
    t_statistic: float


class Grams:
    """Gram matrices (groups, A, q, q) of all classes' columns and the targets.

    The targets are (n, k). The matrices sum over the rows that are used.
    """

    def __init__(
        self,
        functions: Functions,
        arguments: tuple[Array, IntArray, Array, Array | None],
        targets: Array,
        group: IntArray,
        is_used: BoolArray,
    ) -> None:
        states, actions, displacement, commands = arguments
        n_actions = functions.n_actions
        n_groups = int(group.max()) + 1
        self.nested = functions.nested
        # what ``choose`` tries, the simplest first: class, whether each action has its
        # own coefficients, ridge; and their errors (tried, groups, targets)
        self.ways: list[tuple[str, bool, float]] = []
        self.held_out = np.empty((0, n_groups, targets.shape[1]))
        self.p = functions.width
        self.k = targets.shape[1]
        self.g = np.zeros((n_groups, n_actions, self.p + self.k, self.p + self.k))
        for number in np.unique((group * n_actions + actions)[is_used]):
            rows = np.flatnonzero(is_used & (group * n_actions + actions == number))
            for at in np.array_split(rows, 1 + len(rows) // BLOCK):
                own = None if commands is None else commands[at]
                phi = functions(states[at], actions[at], displacement[at], own)
                both = np.column_stack([phi, targets[at]])
                self.g[divmod(number, n_actions)] += both.T @ both
        self.mean_square = self.g.sum(axis=(0, 1)).diagonal() / max(
            float(self.g[..., 0, 0].sum()), 1.0
        )

    def solve(
        self,
        gram: Array,
        columns: IntArray,
        target: slice,
        ridge: float,
        per_action: bool,
    ) -> Array:
        """Compute coefficients (A, p, targets) from a weighted sum over groups.

        An action without rows has the pooled ones.
        """
        size = np.sqrt(np.maximum(self.mean_square[columns], 1e-300))

        def solve_one(gram: Array) -> Array:
            """Solve the ridge regression of one Gram matrix."""
            right = gram[columns, self.p :][:, target]
            if len(columns) == 0:
                return right
            scaled = gram[np.ix_(columns, columns)] / np.outer(size, size)
            n_rows = max(float(gram[0, 0]), 1.0)  # the first column is 1
            scaled[np.diag_indices_from(scaled)] += max(ridge, 1e-9) * n_rows
            factor = linalg.cho_factor(scaled, check_finite=False)
            scaled_right = right / size[:, None]
            found = linalg.cho_solve(factor, scaled_right, check_finite=False)
            return np.asarray(found / size[:, None])

        pooled = solve_one(gram.sum(axis=0))
        return np.stack(
            [solve_one(g) if per_action and g[0, 0] > 0 else pooled for g in gram]
        )

    def choose(self) -> list[Fit]:
        """Choose for each target the simplest class with a small held-out error.

        The error must be within a standard error (over groups) of the best. Simplest
        means fewest coefficients, then the largest ridge.
        """
        n_groups, n_actions = self.g.shape[:2]
        fold = np.arange(n_groups) % FOLDS
        grams = [
            np.tensordot((fold != f).astype(np.float64), self.g, axes=1)
            for f in range(FOLDS)
        ]
        tried: list[tuple[str, bool, float, Array]] = []
        for name, columns in self.nested.items():
            has_actions = len(columns) > 0 and n_actions > 1
            ways = (False, True) if has_actions else (False,)
            ridges = RIDGES if len(columns) > 1 else RIDGES[-1:]
            options = list(itertools.product(ways, ridges))
            errors = self.held_out_errors(columns, options, fold, grams)
            tried += [
                (name, *option, error)
                for option, error in zip(options, errors, strict=True)
            ]

        def complexity(candidate: tuple[str, bool, float, Array]) -> tuple[int, float]:
            """Return the number of coefficients, and minus the ridge."""
            name, per_action, ridge, _ = candidate
            return len(self.nested[name]) * (n_actions if per_action else 1), -ridge

        tried.sort(key=complexity)
        self.ways = [(name, per_action, ridge) for name, per_action, ridge, _ in tried]
        self.held_out = np.array([errors for _, _, _, errors in tried])
        fits = [self._choose_one(k, np.arange(n_groups)) for k in range(self.k)]
        return self._fit(fits, self.g.sum(axis=0))

    def _choose_one(self, k: int, groups: IntArray) -> Fit:
        """Choose a class for target ``k`` by its held-out errors on these groups.

        The fit has no coefficients yet.
        """
        errors = self.held_out[:, groups, k]
        whole = self.g[:, :, self.p + k, self.p + k].sum()
        best, t = _choose_simplest(errors, EQUAL_SHARE * whole)
        name, per_action, ridge = self.ways[best]
        return Fit(
            kind=name,
            per_action=per_action,
            ridge=ridge,
            columns=self.nested[name],
            coefficients=np.empty(0),
            error=float(errors[best].sum()),
            t_statistic=t,
        )

    def held_out_errors(
        self,
        columns: IntArray,
        options: list[tuple[bool, float]],
        fold: IntArray,
        grams: list[Array],
    ) -> Array:
        """Compute sums of squared errors (options, groups, targets) on held-out groups.

        Groups are predicted by the fit to the other folds, whose Gram matrices are
        ``grams``. Where all actions share coefficients, their Gram matrices are summed
        first.
        """
        errors = np.empty((len(options), len(fold), self.k))
        for f in range(FOLDS):
            inside = np.flatnonzero(fold == f)
            g = self.g[inside]
            total = g[:, :, self.p :, self.p :].diagonal(axis1=2, axis2=3).sum(axis=1)
            cross = g[:, :, columns, self.p :]
            inner = g[:, :, columns][:, :, :, columns]
            pooled = cross.sum(axis=1), inner.sum(axis=1)
            for i, (per_action, ridge) in enumerate(options):
                w = self.solve(grams[f], columns, slice(None), ridge, per_action)
                error = total.copy()
                if per_action:
                    for a in range(len(w)):
                        error += _added_error(w[a], cross[:, a], inner[:, a])
                else:
                    error += _added_error(w[0], *pooled)
                errors[i, inside] = np.maximum(error, 0.0)
        return errors

    def refit(self, weights: Array) -> list[Fit]:
        """Choose classes and fit them as if groups had been drawn ``weights`` times.

        A bootstrap draws groups with replacement. The choice counts the held-out errors
        of the groups that were drawn, so a choice that hangs on a few groups varies
        with them. The errors themselves are those of the fits to the whole log.
        """
        groups = np.repeat(np.arange(len(self.g)), weights.astype(np.int64))
        fits = [self._choose_one(k, groups) for k in range(self.k)]
        return self._fit(fits, np.tensordot(weights, self.g, axes=1))

    def _fit(self, fits: Sequence[Fit], gram: Array) -> list[Fit]:
        """Return the fits with the coefficients of a weighted sum over groups."""
        return [
            replace(
                fit,
                coefficients=self.solve(
                    gram, fit.columns, slice(k, k + 1), fit.ridge, fit.per_action
                )[:, :, 0],
            )
            for k, fit in enumerate(fits)
        ]


def _added_error(w: Array, cross: Array, inner: Array) -> Array:
    """Compute w'G_CC w - 2 w'G_Cy of groups and targets, (g, k).

    Coefficients ``w`` are (p, k), ``cross`` G_Cy is (g, p, k) and ``inner`` G_CC is
    (g, p, p).
    """
    return np.asarray(np.einsum("pk,gpk->gk", w, inner @ w - 2.0 * cross))


def episode_groups(
    episode: IntArray | None, n: int, width: int, n_actions: int
) -> IntArray:
    """Return the group (n,) of each row: whole episodes, or stretches of rows.

    Where there are fewer than 8 episodes, 40 stretches of consecutive rows take their
    place. They are dealt out in turn to as many groups as the Gram matrices' memory
    allows, from 8 to 40.
    """
    if episode is None or len(np.unique(episode)) < 8:
        number = np.arange(n) * 40 // n
    else:
        number = np.unique(episode, return_inverse=True)[1].astype(np.int64)
    most = int(np.clip(MAX_GRAM_BYTES / (8.0 * n_actions * width**2), 8, 40))
    return np.asarray(number % most, dtype=np.int64)


def draw_groups(n_groups: int, seed: Seed) -> Array:
    """Draw groups with replacement and return how often each is drawn, (n_groups,)."""
    drawn = _checks.generator(seed).integers(n_groups, size=n_groups)
    return np.bincount(drawn, minlength=n_groups).astype(np.float64)


def _choose_simplest(errors: Array, equal: float) -> tuple[int, float]:
    """Return the first candidate within a standard error of the best, and its t.

    ``errors`` (candidates, groups) are sums of squares, those of g = 0 first.
    Candidates whose errors differ by at most ``equal`` are as good. t is by how many
    standard errors, over groups, the chosen one is better than g = 0.
    """
    root = np.sqrt(errors.shape[1])
    excess = errors - errors[errors.sum(axis=1).argmin()]
    tolerance = root * excess.std(axis=1) + equal
    best = int(np.argmax(excess.sum(axis=1) <= tolerance))
    gain = errors[0] - errors[best]
    error = float(root * gain.std())
    if error > 0:
        return best, float(gain.sum()) / error
    return best, np.inf if gain.sum() > 0 else 0.0
