"""Ridge regression on nested classes of functions of (s, a), chosen for each target by held-out error over episodes.

    G[group, a] = sum over the group's rows of action a of (phi, y) (phi, y)^T,    accumulated in blocks,

is all that fits, held-out errors and refits on resampled episodes need: with weights k over groups, the coefficients of a
class C are (sum_g k_g G_CC + ridge)^-1 sum_g k_g G_Cy, and the squared error on a group is y'y - 2 w'G_Cy + w'G_CC w.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import linalg

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular.continuous.task import ContinuousTask

BLOCK = 4096  # rows at a time
FOLDS = 4
LARGEST = 48e6  # bytes of the Gram matrices
FOURIER = 128  # random frequencies
PAIRS = 24  # inputs whose products are functions too
RIDGES = (1e-3, 1e-5, 1e-9)  # of a column's mean square
EQUAL = 1e-10  # shares of a target's mean square that are no difference


class Functions:
    """phi(s, a): 1, x, d, products of (x, d), cos(w (x, d) + b), of standardised inputs kept within what was logged.

    x are the task's ``smooth`` coordinates and the command, d = f(s, a) - s is the displacement.

    Attributes
    ----------
    nested : name -> the columns of a class of functions; the simplest first
    """

    def __init__(
        self, task: ContinuousTask, states: Array, actions: IntArray, displacement: Array, rng: np.random.Generator
    ) -> None:
        commands = np.asarray(task.actions, dtype=np.float64)
        self._task, self._commands = task, commands.reshape(len(commands), -1)
        raw = self._raw(states, actions, displacement)
        n_x = raw.shape[1] - displacement.shape[1]
        self.low, self.high = raw.min(axis=0), raw.max(axis=0)
        self.centre, self.scale = raw.mean(axis=0), raw.std(axis=0)
        self._kept = self._distinct(raw)
        n_x = int((self._kept < n_x).sum())
        self.m = len(self._kept)
        first, second = np.triu_indices(self.m) if self.m <= PAIRS else np.triu_indices(0)
        self._first, self._second = first, second
        waves = FOURIER if self.m > 0 else 0
        reach = rng.choice([0.25, 0.5, 1.0], size=waves) * np.sqrt(2.0 / max(self.m, 1))
        self._frequencies = rng.standard_normal((self.m, waves)) * reach
        self._phases = rng.uniform(0.0, 2.0 * np.pi, waves)
        one, x, d = np.arange(1), 1 + np.arange(n_x), 1 + np.arange(n_x, self.m)
        products = 1 + self.m + np.arange(len(first))
        of_x = products[second < n_x]
        fourier = 1 + self.m + len(first) + np.arange(waves)
        parts = {
            "zero": one[:0],
            "mean": one,
            "linear": np.concatenate([one, x]),
            "displacement": np.concatenate([one, d]),
            "linear, displacement": np.concatenate([one, x, d]),
            "quadratic": np.concatenate([one, x, of_x]),
            "quadratic, displacement": np.concatenate([one, x, d, products]),
            "Fourier": np.concatenate([one, x, d, products, fourier]),
        }
        self.nested: dict[str, IntArray] = {}
        for name, columns in parts.items():  # classes that are the same here are one
            if not any(np.array_equal(columns, other) for other in self.nested.values()):
                self.nested[name] = columns
        self.width = 1 + self.m + len(first) + waves

    def _raw(self, states: Array, actions: IntArray, displacement: Array) -> Array:
        return np.column_stack([self._task.smooth(states), self._commands[actions], displacement])

    def _distinct(self, raw: Array) -> IntArray:
        """Inputs that vary and are no multiple of an earlier one."""
        moving = np.flatnonzero(self.scale > 1e-12 * (1.0 + np.abs(self.centre)))
        z = (raw[:, moving] - self.centre[moving]) / self.scale[moving]
        alike = np.abs(z.T @ z) / len(z) > 1.0 - 1e-9
        return moving[[not alike[i, :i].any() for i in range(len(moving))]]

    def __call__(self, states: Array, actions: IntArray, displacement: Array, columns: IntArray) -> Array:
        """(n, len(columns)) of the columns asked for: O(n) for each."""
        raw = np.clip(self._raw(states, actions, displacement), self.low, self.high)
        z = ((raw - self.centre) / np.where(self.scale > 0, self.scale, 1.0))[:, self._kept]
        n_products = len(self._first)
        found = np.empty((len(states), len(columns)))
        products = (columns > self.m) & (columns <= self.m + n_products)
        waves = columns > self.m + n_products
        plain = ~products & ~waves
        found[:, plain] = np.column_stack([np.ones(len(states)), z])[:, columns[plain]]
        which = columns[products] - 1 - self.m
        found[:, products] = z[:, self._first[which]] * z[:, self._second[which]]
        which = columns[waves] - 1 - self.m - n_products
        if len(which):
            found[:, waves] = np.cos(z @ self._frequencies[:, which] + self._phases[which])
        return found


class Rows(NamedTuple):
    """Where the regression's rows are: states, action numbers, displacements, targets (n, k), groups, and which are used."""

    states: Array
    actions: IntArray
    displacement: Array
    targets: Array
    group: IntArray
    used: BoolArray


@dataclass(frozen=True)
class Fit:
    """g for one target.

    Attributes
    ----------
    kind : name of the class of functions
    per_action : whether each action has its own coefficients
    ridge : of a column's mean square
    columns, coefficients : (p,), (A, p)
    error : sum of its squared errors on episodes that it was not fitted to
    t_statistic : how many standard errors (over groups of episodes) that is below the error of g = 0
    """

    kind: str
    per_action: bool
    ridge: float
    columns: IntArray
    coefficients: Array
    error: float
    t_statistic: float


class Grams:
    """G (groups, A, q, q) of the columns of all classes and the targets."""

    def __init__(self, functions: Functions, rows: Rows, n_groups: int, n_actions: int) -> None:
        self.functions = functions
        p, k = functions.width, rows.targets.shape[1]
        self.p, self.k = p, k
        self.g = np.zeros((n_groups, n_actions, p + k, p + k))
        every = np.arange(p)
        for group, action, at in _blocks(rows, n_actions):
            phi = functions(rows.states[at], rows.actions[at], rows.displacement[at], every)
            both = np.column_stack([phi, rows.targets[at]])
            self.g[group, action] += both.T @ both
        self.mean_square = self.g.sum(axis=(0, 1)).diagonal() / max(float(self.g[..., 0, 0].sum()), 1.0)

    def solve(self, columns: IntArray, target: slice, ridge: float, per_action: bool, weights: Array) -> Array:
        """(A, p, targets) the coefficients from groups with these weights; an action without rows has the pooled ones."""
        return self._solved(np.tensordot(weights, self.g, axes=1), columns, target, ridge, per_action)

    def _solved(self, gram: Array, columns: IntArray, target: slice, ridge: float, per_action: bool) -> Array:
        pooled = self._one(gram.sum(axis=0), columns, target, ridge)
        if not per_action:
            return np.repeat(pooled[None], len(gram), axis=0)
        return np.stack([self._one(g, columns, target, ridge) if g[0, 0] > 0 else pooled for g in gram])

    def _one(self, gram: Array, columns: IntArray, target: slice, ridge: float) -> Array:
        right = gram[columns, self.p :][:, target]
        if len(columns) == 0:
            return right
        left = gram[np.ix_(columns, columns)]
        size = np.sqrt(np.maximum(self.mean_square[columns], 1e-300))
        scaled = left / np.outer(size, size)
        scaled[np.diag_indices_from(scaled)] += max(ridge, 1e-9) * max(float(gram[0, 0]), 1.0)
        factor = linalg.cho_factor(scaled, check_finite=False)
        return np.asarray(linalg.cho_solve(factor, right / size[:, None], check_finite=False) / size[:, None])

    def _parts(self, columns: IntArray, groups: IntArray) -> tuple[Array, Array, Array]:
        """Of groups: y'y (groups, targets), G_Cy (groups, A, p, targets), G_CC (groups, A, p, p)."""
        g = self.g[groups]
        total = g[:, :, self.p :, self.p :].diagonal(axis1=2, axis2=3).sum(axis=1)
        return np.asarray(total), g[:, :, columns, self.p :], g[:, :, columns][:, :, :, columns]

    def choose(self) -> list[Fit]:
        """For each target the simplest class whose held-out error is within a standard error (over groups) of the best.

        Simplest: fewest coefficients, then the largest ridge.
        """
        n_groups, n_actions = self.g.shape[:2]
        fold = np.arange(n_groups) % FOLDS
        grams = [np.tensordot((fold != f).astype(np.float64), self.g, axes=1) for f in range(FOLDS)]
        tried: list[tuple[str, bool, float, Array]] = []
        for name, columns in self.functions.nested.items():
            options = [
                (per_action, ridge)
                for per_action in (False, True)[: 1 + (len(columns) > 0 and n_actions > 1)]
                for ridge in (RIDGES if len(columns) > 1 else RIDGES[-1:])
            ]
            found = self._held_out(columns, options, fold, grams)
            tried += [(name, *option, errors) for option, errors in zip(options, found, strict=True)]
        tried.sort(key=lambda c: (len(self.functions.nested[c[0]]) * (n_actions if c[1] else 1), -c[2]))
        return [self._chosen(tried, k, n_groups) for k in range(self.k)]

    def _held_out(
        self, columns: IntArray, options: list[tuple[bool, float]], fold: IntArray, grams: list[Array]
    ) -> Array:
        """(options, groups, targets) sums of squared errors on groups by the fit to the other folds, ``grams`` theirs."""
        found = np.empty((len(options), len(fold), self.k))
        for f in range(FOLDS):
            inside = np.flatnonzero(fold == f)
            parts = self._parts(columns, inside)
            for i, (per_action, ridge) in enumerate(options):
                w = self._solved(grams[f], columns, slice(None), ridge, per_action)
                found[i, inside] = _errors(parts, w)
        return found

    def _chosen(self, tried: list[tuple[str, bool, float, Array]], target: int, n_groups: int) -> Fit:
        errors = np.array([held_out[:, target] for _, _, _, held_out in tried])
        whole = self.g[:, :, self.p + target, self.p + target].sum()
        best = errors[errors.sum(axis=1).argmin()]
        beyond = errors - best
        sure = np.sqrt(n_groups) * beyond.std(axis=1) + EQUAL * whole
        name, per_action, ridge, held_out = tried[int(np.argmax(beyond.sum(axis=1) <= sure))]
        columns = self.functions.nested[name]
        w = self.solve(columns, slice(target, target + 1), ridge, per_action, np.ones(n_groups))[:, :, 0]
        gained = errors[0] - held_out[:, target]  # the first is g = 0
        error = float(np.sqrt(n_groups) * gained.std())
        t = float(gained.sum()) / error if error > 0 else (np.inf if gained.sum() > 0 else 0.0)
        return Fit(name, per_action, ridge, columns, w, float(held_out[:, target].sum()), t)

    def refit(self, fits: list[Fit], weights: Array) -> list[Fit]:
        """The same classes fitted to groups with these weights: a bootstrap's."""
        again = []
        for k, fit in enumerate(fits):
            w = self.solve(fit.columns, slice(k, k + 1), fit.ridge, fit.per_action, weights)[:, :, 0]
            again.append(replace(fit, coefficients=w))
        return again


def _errors(parts: tuple[Array, Array, Array], coefficients: Array) -> Array:
    """(groups, targets) y'y - 2 w'G_Cy + w'G_CC w, of coefficients w (A, p, targets)."""
    total, cross, inner = parts
    if coefficients.shape[1] == 0:
        return total
    crossed = np.einsum("gapk,apk->gk", cross, coefficients, optimize=True)
    square = np.zeros_like(total)
    for a, w in enumerate(coefficients):
        square += np.einsum("pk,gpk->gk", w, inner[:, a] @ w)
    return np.asarray(np.maximum(total - 2.0 * crossed + square, 0.0))


def _blocks(rows: Rows, n_actions: int) -> Iterator[tuple[int, int, IntArray]]:
    """Group, action and at most ``BLOCK`` rows of them."""
    cell = rows.group * n_actions + rows.actions
    at = np.flatnonzero(rows.used)
    at = at[np.argsort(cell[at], kind="stable")]
    for part in np.split(at, np.flatnonzero(np.diff(cell[at])) + 1):
        for low in range(0, len(part), BLOCK):
            group, action = divmod(int(cell[part[0]]), n_actions)
            yield group, action, part[low : low + BLOCK]


def groups_of(episode: IntArray | None, n: int, width: int, n_actions: int) -> IntArray:
    """(n,) groups of whole episodes (of rows in turn, without episodes), as many as the Gram matrices' memory allows.

    At least 8 and at most 40, if there are so many episodes.
    """
    if episode is None or len(np.unique(episode)) < 8:
        number = np.arange(n) * 40 // n
    else:
        number = np.unique(episode, return_inverse=True)[1].astype(np.int64)
    most = int(np.clip(LARGEST / (8.0 * n_actions * width**2), 8, 40))
    return np.asarray(number % most, dtype=np.int64)
