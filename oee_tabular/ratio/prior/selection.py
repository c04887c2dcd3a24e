"""Tilts along a few features of a library, chosen one after the other by evidence.

    zeta proportional to exp(theta . phi) in each row,   theta_j ~ N(0, 1 / lambda_j),   lambda_j >= 1.

The counts of a row are not those of the tilt alone: rows have misfits of their own, Dirichlet(kappa). n moves of one row then
tell about the tilt what n (1 + kappa) / (n + kappa) moves would tell of rows without: each row's log likelihood counts
w = (1 + kappa) / (n + kappa) times. theta minimises

    f(theta) = sum_rows w [n ln Z(theta) - sum_x n_x theta . phi_x] + 1/2 sum_j lambda_j theta_j^2,

lambda_j its maximiser of evidence (MacKay [1]: lambda <- (1 - lambda (f'')^-1_jj) / theta_j^2). The next feature is the one
with the most evidence for a theta_j of its own, by its score s and its information I given the features already in [2]:

    gain = [ln(lambda / (lambda + I)) + s^2 / (lambda + I)] / 2   at the best lambda >= 1,

which is (z^2 - 1 - ln z^2) / 2, z^2 = s^2 / I, where that lambda is not below 1.

Differs from [1] in lambda >= 1 (a unit prior is the widest) and in the rows' weights w; from [2] in that a feature once in
stays, and pays a price beside its evidence.

References: [1] D. J. C. MacKay, Bayesian interpolation, Neural Computation 4(3), 1992. [2] M. E. Tipping and A. C. Faul, Fast
marginal likelihood maximisation for sparse Bayesian models, AISTATS 2003.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from oee_tabular._checks import Array, BoolArray
from oee_tabular.mdp.rows import Rows
from oee_tabular.ratio.prior.library import Chosen, columns_of
from oee_tabular.ratio.prior.tilt import Minimum, TiltRisk, minimise

MOST = 6  # features of one tilt
TIGHTEST = 1e6  # lambda of a feature that is as good as out


@dataclass(frozen=True, eq=False)
class Selected:
    """A tilt along chosen features.

    Attributes
    ----------
    chosen : its features (see ``library.Chosen``)
    theta, precision : (k,) of the scaled features, and their lambda
    information : (k, k), f''
    model : (entries,) the tilted rows
    gap : bound on f less its minimum, divided by the number of moves (nats)
    """

    chosen: tuple[Chosen, ...]
    theta: Array
    precision: Array
    information: Array
    model: Array
    gap: float

    @property
    def size(self) -> float:
        """ln |f''| / 2 - sum ln lambda / 2 + sum lambda theta^2 / 2: what the parameters cost in evidence (Laplace)."""
        if not self.chosen:
            return 0.0
        log_determinant = float(np.linalg.slogdet(self.information)[1])
        return 0.5 * (log_determinant - float(np.log(self.precision).sum()) + float(self.precision @ self.theta**2))


class Selection:
    """Counts on rows, and the library's columns there.

    Parameters
    ----------
    rows : those that the log has visited; observed : (entries,) their counts
    base : (entries, d) the library's columns, centred
    allowed : (1 + A, d) which features there are, for all actions and for each alone (``library.by_action``)
    """

    def __init__(self, rows: Rows, observed: Array, base: Array, allowed: BoolArray):
        self.rows, self.observed, self.base = rows, observed, base
        self.count = rows.sums(observed)
        self.parts = allowed.shape[0]
        square = self._by_part(rows.mean(rows.weights, base**2)) / max(len(rows), 1)
        self.allowed = allowed & (square > 1e-20 * np.maximum(np.abs(base).max(axis=0, initial=0.0), 1e-300) ** 2)
        self.scale = np.where(self.allowed, np.sqrt(square), np.inf)
        self._moved = rows.mean(observed, base)

    def _by_part(self, values: Array) -> Array:
        """(rows, d) summed over all rows, and over those of each action: (1 + A, d)."""
        found = np.zeros((self.parts, values.shape[1]))
        found[0] = values.sum(axis=0)
        for action in range(self.parts - 1):
            found[1 + action] = values[self.rows.action == action].sum(axis=0)
        return found

    def columns(self, chosen: Sequence[Chosen]) -> Array:
        """(entries, k)."""
        action = self.rows.spread(self.rows.action)
        return columns_of(chosen, lambda j: self.base[:, j], self.scale, action)

    def counted(self, kappa: Array) -> Array:
        """w, how much a move of each row counts."""
        return np.asarray(np.minimum((1.0 + kappa) / (self.count + kappa), 1.0))

    def fit(self, chosen: Sequence[Chosen], kappa: Array, start: Selected | None = None) -> Selected:
        """theta and lambda of given features, by at most eight rounds of Newton's method and MacKay's rule."""
        k = len(chosen)
        theta, precision = np.zeros(k), np.ones(k)
        if start is not None:
            theta[: len(start.theta)], precision[: len(start.theta)] = start.theta, start.precision
        for _ in range(8):
            found = minimise(self._risk(chosen, kappa, precision), theta)
            theta, last = found.theta, precision
            new = (1.0 - precision * np.diag(np.linalg.inv(found.hessian))) / np.maximum(theta**2, 1e-300)
            precision = np.clip(new, 1.0, TIGHTEST)
            if (np.abs(np.log(precision / last)) < 0.05).all():
                break
        return self._selected(chosen, precision, minimise(self._risk(chosen, kappa, precision), theta))

    def _risk(self, chosen: Sequence[Chosen], kappa: Array, precision: Array) -> TiltRisk:
        """f, with each row's counts weighed."""
        counts = self.rows.spread(self.counted(kappa)) * self.observed
        return TiltRisk(self.rows, counts, self.columns(chosen), precision)

    def _selected(self, chosen: Sequence[Chosen], precision: Array, found: Minimum) -> Selected:
        gap = found.gap / max(float(self.count.sum()), 1.0)
        return Selected(tuple(chosen), found.theta, precision, found.hessian, found.model, gap)

    def gains(self, fitted: Selected | None, kappa: Array) -> Array:
        """(1 + A, d) evidence in nats that each feature would add; -inf for one that is in, or tells nothing."""
        rows, weight = self.rows, self.counted(kappa)
        mass = weight * self.count
        model = rows.weights if fitted is None else fitted.model
        mean = rows.mean(model, self.base)
        score = self._by_part(weight[:, None] * self._moved - mass[:, None] * mean) / self.scale
        spread = rows.mean(model, self.base**2) - mean**2
        own = self._by_part(mass[:, None] * spread) / self.scale**2
        information = own
        usable = self.allowed.copy()
        if fitted is not None:
            features = self.columns(fitted.chosen)
            scores = features - rows.spread(rows.mean(model, features))
            pulls = scores * (model * rows.spread(mass))[:, None]
            cross = np.stack([self._by_part(rows.mean(pull, self.base)) / self.scale for pull in pulls.T])
            flat = cross.reshape(len(cross), -1)
            known = np.sum(flat * np.linalg.solve(fitted.information, flat), axis=0).reshape(own.shape)
            information = own - known
            for j, part in fitted.chosen:
                usable[part, j] = False
        usable &= information > np.maximum(1e-6, 1e-8 * own)
        return _gain(score, np.where(usable, information, 1.0), usable)

    def path(self, kappa: Array, price: Array) -> list[Selected]:
        """Tilts of 1, 2, ... features, each with the feature more that gains most above its price (1 + A, d)."""
        found: list[Selected] = []
        while len(found) < MOST:
            last = found[-1] if found else None
            gain = self.gains(last, kappa) - price
            part, j = np.unravel_index(int(np.argmax(gain)), gain.shape)
            if not gain[part, j] > 0:
                break
            before = () if last is None else last.chosen
            found.append(self.fit([*before, (int(j), int(part))], kappa, last))
        return found

    def by_cvxpy(self, fitted: Selected, kappa: Array, solver: str) -> Selected:
        """The same features and lambda, theta by a cvxpy solver."""
        risk = self._risk(fitted.chosen, kappa, fitted.precision)
        theirs = self._selected(fitted.chosen, fitted.precision, minimise(risk, fitted.theta, solver))
        return replace(theirs, information=fitted.information)


def _gain(score: Array, information: Array, usable: BoolArray) -> Array:
    """The evidence for a feature of its own lambda >= 1."""
    excess = score**2 - information
    best = np.where(excess > 0, information**2 / np.where(excess > 0, excess, 1.0), np.inf)
    precision = np.maximum(best, 1.0)
    safe = np.where(np.isfinite(precision), precision, 1.0)
    gain = 0.5 * (score**2 / (safe + information) - np.log1p(information / safe))
    return np.where(usable & (excess > 0), gain, -np.inf)
