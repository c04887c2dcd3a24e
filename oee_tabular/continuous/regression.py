"""Ridge regression on nested classes of functions of (s, a), chosen for each target by held-out error over episodes.

    G[group, a] = sum over the group's rows of action a of (phi, y) (phi, y)^T

is all that fits, held-out errors and refits on resampled episodes need: with weights k over groups, the coefficients of a
class C are w = (sum_g k_g G_CC + ridge)^-1 sum_g k_g G_Cy, and the squared error on a group is y'y - 2 w'G_Cy + w'G_CC w.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular.continuous import _regression
from oee_tabular.continuous.task import ContinuousTask

BLOCK = 4096  # rows at a time
FOLDS = 4
LARGEST = 48e6  # bytes of the Gram matrices
FOURIER = 128  # random frequencies
PAIRS = 24  # inputs whose products are functions too
RIDGES = (1e-3, 1e-5, 1e-9)  # of a column's mean square
EQUAL = 1e-10  # shares of a target's mean square that are no difference


class Functions:
    """phi(s, a): products of (1, x, d) and cos(w (x, d) + b), of standardised inputs kept within what was logged.

    x are the task's ``smooth`` coordinates and the command, d = f(s, a) - s is the displacement.

    Attributes
    ----------
    nested : name -> the columns of a class of functions; the simplest first
    width, n_actions : how many columns and actions there are
    """

    def __init__(
        self, task: ContinuousTask, states: Array, actions: IntArray, displacement: Array, rng: np.random.Generator
    ) -> None:
        self._task, self.n_actions = task, task.n_actions
        self._commands = np.array(task.actions, dtype=np.float64).reshape(task.n_actions, -1)
        smooth, n_commands = task.smooth(states), self._commands.shape[1]
        raw = np.column_stack([smooth, self._commands[actions], displacement])
        centre, scale = raw.mean(axis=0), raw.std(axis=0)
        moving = np.flatnonzero(scale > 1e-12 * (1.0 + np.abs(centre)))
        z = (raw[:, moving] - centre[moving]) / scale[moving]
        alike = np.abs(z.T @ z) / len(z) > 1.0 - 1e-9
        is_new = [not alike[i, :i].any() for i in range(len(moving))]  # no multiple of an earlier one
        self._kept = kept = moving[is_new]
        self._limits = np.stack([raw.min(axis=0)[kept], raw.max(axis=0)[kept], centre[kept], 1.0 / scale[kept]])
        m, n_x = len(kept), int((kept < smooth.shape[1] + n_commands).sum())
        n_waves = FOURIER if m > 0 else 0
        reach = rng.choice([0.25, 0.5, 1.0], size=n_waves) * np.sqrt(2.0 / max(m, 1))
        self._frequencies = rng.standard_normal((m, n_waves)) * reach
        self._phases = rng.uniform(0.0, 2.0 * np.pi, n_waves)
        first, second = np.triu_indices(m if m <= PAIRS else 0)
        linear, q = np.arange(1 + m), 1 + m + len(first)
        self._first = np.concatenate([np.zeros(1 + m, dtype=np.int64), first + 1])  # 0 is the constant 1
        self._second = np.concatenate([linear, second + 1])
        self.width = q + n_waves
        of_x = 1 + m + np.flatnonzero(second < n_x)
        classes = {
            "zero": linear[:0],
            "mean": linear[:1],
            "linear": linear[: 1 + n_x],
            "displacement": np.delete(linear, np.arange(1, 1 + n_x)),
            "linear, displacement": linear,
            "quadratic": np.concatenate([linear[: 1 + n_x], of_x]),
            "quadratic, displacement": np.arange(q),
            "Fourier": np.arange(self.width),
        }
        self.nested: dict[str, IntArray] = {}
        for name, columns in classes.items():  # classes that are the same here are one
            if not any(np.array_equal(columns, other) for other in self.nested.values()):
                self.nested[name] = columns

    def __call__(self, states: Array, actions: IntArray, displacement: Array) -> Array:
        """(n, width) every column."""
        raw = np.column_stack([self._task.smooth(states), self._commands[actions], displacement])[:, self._kept]
        low, high, centre, slope = self._limits
        z = (np.clip(raw, low, high) - centre) * slope
        one = np.column_stack([np.ones(len(z)), z])
        waves = np.cos(z @ self._frequencies + self._phases)
        return np.column_stack([one[:, self._first] * one[:, self._second], waves])

    def stack(self, fits: Sequence[Fit]) -> Array:
        """(A, columns, len(fits)) the coefficients of all fits."""
        width = max(int(fit.columns.max(initial=-1)) for fit in fits) + 1
        w = np.zeros((self.n_actions, width, len(fits)))
        for k, fit in enumerate(fits):
            w[:, fit.columns, k] = fit.coefficients
        return w

    def predict(self, states: Array, actions: IntArray, displacement: Array, w: Array, ends: Array) -> Array:
        """(n, k) sums over columns weighted by w (A, columns, k), kept within ``ends`` (2, k): compiled, O(n p k)."""
        q, inputs = min(w.shape[1], len(self._first)), (self._task.smooth(states), displacement)
        x, d = (np.require(each, requirements=["C", "W"]) for each in inputs)  # so that one kernel takes all
        a = np.require(actions, np.int64, ["C", "W"])
        functions = self._first[:q], self._second[:q], self._frequencies, self._phases
        return np.asarray(_regression.predict(x, self._commands, d, a, self._kept, self._limits, *functions, w, ends))


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
    """G (groups, A, q, q) of the columns of all classes and the targets (n, k), of the rows that are used."""

    def __init__(
        self, functions: Functions, arguments: tuple[Array, IntArray, Array], targets: Array, group: IntArray,
        is_used: BoolArray,
    ) -> None:  # fmt: skip
        states, actions, displacement = arguments
        n_actions, n_groups = functions.n_actions, int(group.max()) + 1
        self.nested, self.p, self.k = functions.nested, functions.width, targets.shape[1]
        self.g = np.zeros((n_groups, n_actions, self.p + self.k, self.p + self.k))
        for number in np.unique((group * n_actions + actions)[is_used]):
            rows = np.flatnonzero(is_used & (group * n_actions + actions == number))
            for at in np.array_split(rows, 1 + len(rows) // BLOCK):
                both = np.column_stack([functions(states[at], actions[at], displacement[at]), targets[at]])
                self.g[divmod(number, n_actions)] += both.T @ both
        self.mean_square = self.g.sum(axis=(0, 1)).diagonal() / max(float(self.g[..., 0, 0].sum()), 1.0)

    def solve(self, gram: Array, columns: IntArray, target: slice, ridge: float, per_action: bool) -> Array:
        """(A, p, targets) the coefficients from a weighted sum over groups; an action without rows has the pooled ones."""
        pooled = self._solve(gram.sum(axis=0), columns, target, ridge)
        each = [self._solve(g, columns, target, ridge) if per_action and g[0, 0] > 0 else pooled for g in gram]
        return np.stack(each)

    def _solve(self, gram: Array, columns: IntArray, target: slice, ridge: float) -> Array:
        right = gram[columns, self.p :][:, target]
        if len(columns) == 0:
            return right
        size = np.sqrt(np.maximum(self.mean_square[columns], 1e-300))
        scaled = gram[np.ix_(columns, columns)] / np.outer(size, size)
        scaled[np.diag_indices_from(scaled)] += max(ridge, 1e-9) * max(float(gram[0, 0]), 1.0)
        factor = linalg.cho_factor(scaled, check_finite=False)
        return np.asarray(linalg.cho_solve(factor, right / size[:, None], check_finite=False) / size[:, None])

    def choose(self) -> list[Fit]:
        """For each target the simplest class whose held-out error is within a standard error (over groups) of the best.

        Simplest: fewest coefficients, then the largest ridge.
        """
        n_groups, n_actions = self.g.shape[:2]
        fold = np.arange(n_groups) % FOLDS
        grams = [np.tensordot((fold != f).astype(np.float64), self.g, axes=1) for f in range(FOLDS)]
        tried: list[tuple[str, bool, float, Array]] = []
        for name, columns in self.nested.items():
            options = [
                (per_action, ridge)
                for per_action in (False, True)[: 1 + (len(columns) > 0 and n_actions > 1)]
                for ridge in (RIDGES if len(columns) > 1 else RIDGES[-1:])
            ]
            errors = self.held_out_errors(columns, options, fold, grams)
            tried += [(name, *option, error) for option, error in zip(options, errors, strict=True)]
        tried.sort(key=lambda c: (len(self.nested[c[0]]) * (n_actions if c[1] else 1), -c[2]))
        every = np.array([errors for _, _, _, errors in tried])  # (tried, groups, targets)
        return [self._choose_for(tried, every[:, :, k], k) for k in range(self.k)]

    def held_out_errors(
        self, columns: IntArray, options: list[tuple[bool, float]], fold: IntArray, grams: list[Array]
    ) -> Array:
        """(options, groups, targets) sums of squared errors on groups by the fit to the other folds, ``grams`` theirs."""
        errors = np.empty((len(options), len(fold), self.k))
        for f in range(FOLDS):
            inside = np.flatnonzero(fold == f)
            g = self.g[inside]
            total = g[:, :, self.p :, self.p :].diagonal(axis1=2, axis2=3).sum(axis=1)
            cross, inner = g[:, :, columns, self.p :], g[:, :, columns][:, :, :, columns]
            for i, (per_action, ridge) in enumerate(options):
                w = self.solve(grams[f], columns, slice(None), ridge, per_action)
                error = total - 2.0 * np.einsum("gapk,apk->gk", cross, w, optimize=True)
                for a in range(len(w)):
                    error += np.einsum("pk,gpk->gk", w[a], inner[:, a] @ w[a])
                errors[i, inside] = np.maximum(error, 0.0)
        return errors

    def _choose_for(self, tried: list[tuple[str, bool, float, Array]], errors: Array, target: int) -> Fit:
        """Of the classes that were tried, with ``errors`` (tried, groups), the first that is as good as the best."""
        n_groups, whole = len(self.g), self.g[:, :, self.p + target, self.p + target].sum()
        excess = errors - errors[errors.sum(axis=1).argmin()]
        tolerance = np.sqrt(n_groups) * excess.std(axis=1) + EQUAL * whole
        k = int(np.argmax(excess.sum(axis=1) <= tolerance))
        gain = errors[0] - errors[k]  # the first is g = 0
        error = float(np.sqrt(n_groups) * gain.std())
        t = float(gain.sum()) / error if error > 0 else (np.inf if gain.sum() > 0 else 0.0)
        name, per_action, ridge, _ = tried[k]
        fit = Fit(name, per_action, ridge, self.nested[name], np.empty(0), float(errors[k].sum()), t)
        return self._refit(fit, target, self.g.sum(axis=0))

    def _refit(self, fit: Fit, target: int, gram: Array) -> Fit:
        of_target = slice(target, target + 1)
        w = self.solve(gram, fit.columns, of_target, fit.ridge, fit.per_action)
        return replace(fit, coefficients=w[:, :, 0])

    def refit(self, fits: Sequence[Fit], weights: Array) -> list[Fit]:
        """The same classes fitted to groups with these weights: a bootstrap's."""
        gram = np.tensordot(weights, self.g, axes=1)
        return [self._refit(fit, k, gram) for k, fit in enumerate(fits)]


def episode_groups(episode: IntArray | None, n: int, width: int, n_actions: int) -> IntArray:
    """(n,) groups of whole episodes (of rows in turn, without episodes), as many as the Gram matrices' memory allows.

    At least 8 and at most 40, if there are so many episodes.
    """
    if episode is None or len(np.unique(episode)) < 8:
        number = np.arange(n) * 40 // n
    else:
        number = np.unique(episode, return_inverse=True)[1].astype(np.int64)
    most = int(np.clip(LARGEST / (8.0 * n_actions * width**2), 8, 40))
    return np.asarray(number % most, dtype=np.int64)


def draw_groups(n_groups: int, seed: Any) -> Array:
    """(n_groups,) how often a bootstrap draws each group, with replacement."""
    drawn = _checks.generator(seed).integers(n_groups, size=n_groups)
    return np.bincount(drawn, minlength=n_groups).astype(np.float64)
