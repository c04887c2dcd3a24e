"""The result of a fit of zeta: the ratio, its certificate, and the influence of
sampling noise on values.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from oee_tabular import _checks, _printing
from oee_tabular._parallel import one_thread
from oee_tabular._sparse import (
    align,
    canonical,
    check_csr,
    csr_on_pattern,
    row_of_entry,
    row_sums,
)
from oee_tabular.exact.system import exponent
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.rows import Rows
from oee_tabular.ratio.prior.ridge import Tilt
from oee_tabular.typing import Array, BoolArray


@dataclass(frozen=True, eq=False)
class TransitionRatio:
    """zeta on the simulator's support, with its certificate and diagnostics.

    Attributes
    ----------
    values : csr of shape (S*A, S) with the entries of ``simulator.transitions``
    method : the method's name
    gap : the largest duality gap of the programs solved (nats, each program scaled to
        probabilities)
    visited : (S, A), whether the pair was recorded; elsewhere zeta is the prior's (1,
        or the tilt's)
    row_sum_error : largest |sum_s' zeta P - 1| over (s, a)
    counts : (S, A) transitions of the log in each pair
    details : the method's own diagnostics
    tied : whether transitions of one key share one value, so that unrecorded pairs are
        not the prior's

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5) for p in (0.5, 0.6))
    >>> fit = oee.transition_ratio(oee.sample_transitions(target, [[0.5], [0.5]], 1000, seed=0), simulator)
    >>> fit.counts.tolist(), fit.row_sum_error < 1e-12, fit.gap < 1e-9
    ([[502.0], [498.0]], True, True)
    >>> fit.target_model(simulator)
    FiniteMDP(2 states, 1 actions, 4 transitions, rewards r(s, a), discount 0.5)
    """

    values: sparse.csr_array
    method: str
    gap: float
    visited: BoolArray
    row_sum_error: float
    counts: Array
    details: dict[str, Any] = field(default_factory=dict)
    tied: bool = False
    _influence: Influence | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        data = self.values.data
        return (
            f"TransitionRatio({self.method}: {len(data)} values from {data.min():.4g}"
            f" to {data.max():.4g}, {int(self.visited.sum())} of {self.visited.size}"
            f" pairs recorded, gap {self.gap:.1e}, row-sum error"
            f" {self.row_sum_error:.1e})"
        )

    def _repr_html_(self) -> str:
        data = self.values.data
        rows = [
            ("method", self.method),
            ("values", f"{len(data)}, from {data.min():.4g} to {data.max():.4g}"),
            ("pairs recorded", f"{int(self.visited.sum())} of {self.visited.size}"),
            ("largest gap (nats)", f"{self.gap:.1e}"),
            ("row-sum error", f"{self.row_sum_error:.1e}"),
        ]
        return _printing.facts(
            "TransitionRatio: P_target / P_simulator, without unit", rows
        )

    def on(self, simulator: FiniteMDP) -> Array:
        """The values on the entries of ``simulator.transitions``; ValueError where they
        are another simulator's.
        """
        _checks.instance(simulator, FiniteMDP, "simulator")
        if self.values.shape != simulator.transitions.shape:
            raise ArgumentError(
                "ratio",
                f"must be for {simulator.transitions.shape} rows and states; it is for"
                f" {self.values.shape}, another simulator's",
            )
        zeta, stored = align(
            canonical(check_csr(self.values, "ratio"), drop_zeros=False),
            simulator.transitions,
        )
        if not stored.all() or self.values.nnz != simulator.transitions.nnz:
            raise ArgumentError(
                "ratio",
                "must have the support of this simulator's transitions; it is another"
                " simulator's",
            )
        return zeta

    def target_model(
        self, simulator: FiniteMDP, *, normalize: bool = False
    ) -> FiniteMDP:
        """zeta * P as a FiniteMDP.

        Raises ValueError where its rows do not sum to 1 (the paper's quotient), unless
        ``normalize`` divides them.
        """
        _checks.boolean(normalize, "normalize")
        zeta = self.on(simulator)
        data = zeta * simulator.transitions.data
        sums = row_sums(simulator.transitions, data)
        if normalize:
            data = data / sums[row_of_entry(simulator.transitions)]
        elif np.abs(sums - 1.0).max() > _checks.SUM_TOLERANCE:
            raise ValueError(
                f"rows of zeta * P must sum to 1; they sum to {sums.min():.4g} to"
                f" {sums.max():.4g} (method {self.method!r} does not make them;"
                " normalize=True divides each row, exact.reweight keeps them as they"
                " are)"
            )
        return simulator.with_transitions(csr_on_pattern(simulator.transitions, data))

    def maximum_likelihood_model(self, simulator: FiniteMDP) -> FiniteMDP:
        """The log's frequencies in recorded pairs, zeta * P in the others; a ValueError
        if no log is known.
        """
        self.on(simulator)  # or an error
        if self._influence is None:
            raise ValueError(
                f"a ratio of method {self.method!r} has no maximum-likelihood model: it"
                " keeps no frequencies"
            )
        rows = self._influence.maximum_likelihood_rows()
        return simulator.with_transitions(csr_on_pattern(simulator.transitions, rows))

    @property
    def maximum_likelihood_rows(self) -> Array | None:
        """(entries,) the rows of ``maximum_likelihood_model``; None where no log is
        known.
        """
        return (
            None
            if self._influence is None
            else self._influence.maximum_likelihood_rows()
        )

    @property
    def finite(self) -> bool:
        """Whether zeta, its gap and what its errors are computed from are finite
        numbers.
        """
        known = [self.values.data, self.gap]
        if self._influence is not None:
            tilt = self._influence.tilt
            information = self._influence.information
            known += [] if information is None else [information]
            known += [] if tilt is None else [tilt.theta, tilt.covariances]
        return all(np.isfinite(x).all() for x in known)

    @one_thread
    def log_standard_error(self, gradient: Array) -> float | None:
        """Standard error of a function of zeta * P if its prior fits: that of the log's
        sampling noise.

        ``gradient`` is its derivative in each entry of zeta * P
        (``exact.transition_gradient``). Rows are taken as multinomial given their
        counts, and what was chosen on the data (the prior's strength, the strengths of
        directions) as given; parameters of a tilt have their posterior variance, so
        that rows without data add what they share with others. The error that a wrong
        prior makes is not in it. None where no formula is known.
        """
        scaled, shift = self._scale(gradient)
        return (
            None
            if self._influence is None
            else float(np.ldexp(self._influence.standard_error(scaled), shift))
        )

    @one_thread
    def one_step(self, gradient: Array) -> OneStep | None:
        """The first-order correction of a function of zeta * P towards maximum
        likelihood.

        sum_x gradient_x (n_x / n_sa - zeta P), over the rows that the log has recorded:
        it removes, to first order, the bias that the prior brings, and takes on the
        variance of maximum likelihood. Its error takes the variances of a row under
        zeta P: a row with a single transition has none under its own frequencies.
        """
        scaled, shift = self._scale(gradient)
        if self._influence is None:
            return None
        return OneStep(
            *(
                float(np.ldexp(part, shift))
                for part in astuple(self._influence.one_step(scaled))
            )
        )

    def _scale(self, gradient: ArrayLike) -> tuple[Array, int]:
        """A checked gradient divided by the power of two 2^shift that makes its squares
        numbers, and shift.
        """
        array = _checks.float_array(gradient, "gradient", ndim=1)
        _checks.require_finite(array, "gradient")
        if len(array) != self.values.nnz:
            raise ArgumentError(
                "gradient",
                f"must have an entry for each of the {self.values.nnz} transitions; it"
                f" has {len(array)}",
            )
        shift = exponent(array)
        return array if shift == 0 else np.ldexp(array, -shift), shift


@dataclass(frozen=True)
class OneStep:
    """A one-step correction.

    Attributes
    ----------
    change : what to add to the value
    standard_error : of the corrected value, sqrt(sum over recorded rows of
        Var(gradient) / n), variances under zeta P
    unrecorded : what unrecorded pairs may add to it: sqrt(sum of Var(gradient)), each
        as of one transition
    change_error : of the change alone, sqrt(sum (1 - share)^2 Var(gradient) / n)
    """

    change: float
    standard_error: float
    unrecorded: float
    change_error: float


@dataclass(frozen=True, eq=False)
class Influence:
    """The derivative of zeta * P in the log's frequencies, from the conditions that
    determine zeta.

    Attributes
    ----------
    rows : the simulator's; counts : n_x on their entries; ratio : zeta
    curvature : p / zeta^2 + A inside the box, 0 at its bounds (where the derivative is
        0)
    share : of the data in a row, n_sa / (n_sa + kappa)
    tilt : what the prior's rows are, where it is fitted
    scores, information : of a class that all rows share, d log zeta / d parameters
        (entries, d) and its risk's Hessian (d, d)

    What is computed of them goes over the rows block by block.
    """

    rows: Rows
    counts: Array
    ratio: Array
    curvature: Array
    share: Array
    tilt: Tilt | None = None
    scores: Array | None = None
    information: Array | None = None

    @cached_property
    def n(self) -> Array:
        """n_sa."""
        return self.rows.sums(self.counts)

    def standard_error(self, gradient: Array) -> float:
        """The error that the log's noise makes.

        Of a class, sqrt(sum_rows n Var(psi)), psi = d value / d (one more observation).
        Else sqrt(sum_rows share^2 Var(d) / n + p' H^-1 p), d = d value / d frequencies,
        p and H the derivative in the tilt's parameters, through what the rows have of
        it, and their information. Variances are those under the frequencies.
        """
        total = 0.0
        step = None
        if self.scores is not None:
            assert self.information is not None
            free = self._by_probability(gradient, self.rows) * self.rows.spread(
                1.0 - self.share
            )
            step = np.linalg.lstsq(
                self.information, (free * self.ratio * self.rows.weights) @ self.scores
            )[0]
        for rows in self.rows.select(self.n > 0).blocks():
            n = self.n[rows.number]
            psi = rows.spread(self.share[rows.number] / n) * self._by_probability(
                gradient, rows
            )
            if step is not None and self.scores is not None:
                psi += self.scores[rows.entries] @ step
            total += float(
                np.sum(
                    n * rows.variance(rows.frequencies(self.counts[rows.entries]), psi)
                )
            )
        if self.tilt is not None:
            pull: Any = 0.0
            for rows in self.rows.blocks():
                free = rows.spread(
                    1.0 - self.share[rows.number]
                ) * self._by_probability(gradient, rows)
                pull = pull + self.tilt.pull(rows, free * self.tilt.at(rows))
            total += self.tilt.variance(pull)
        return float(np.sqrt(total))

    def maximum_likelihood_rows(self) -> Array:
        """n_x / n_sa where the log has been, zeta P elsewhere."""
        model = self.ratio * self.rows.weights
        seen = self.rows.select(self.n > 0)
        model[seen.entries] = seen.frequencies(self.counts[seen.entries])
        return model

    def one_step(self, gradient: Array) -> OneStep:
        """See ``TransitionRatio.one_step``; the variances of a row are those under zeta
        P, the prior taken as given.
        """
        variance = np.empty(len(self.rows))
        change = 0.0
        for rows in self.rows.blocks():
            kernel = self.ratio[rows.entries] * rows.weights
            slope = gradient[rows.entries]
            variance[rows.number] = rows.variance(kernel, slope)
            seen = rows.spread(self.n[rows.number] > 0)
            change += float(
                slope[seen]
                @ (rows.frequencies(self.counts[rows.entries]) - kernel)[seen]
            )
        visited = self.n > 0
        each = np.where(visited, variance / np.maximum(self.n, 1.0), 0.0)
        squares = (
            each.sum(),
            variance[~visited].sum(),
            np.sum((1.0 - self.share) ** 2 * each),
        )
        return OneStep(change, *(float(np.sqrt(x)) for x in squares))

    def _by_probability(self, gradient: Array, rows: Rows) -> Array:
        """d value / d p, p the smoothed frequencies: from H dg = dp/g - q dm and sum q
        dg = 0 in each of the rows.
        """
        q = rows.weights
        zeta = self.ratio[rows.entries]
        curvature = self.curvature[rows.entries]
        soft = np.divide(1.0, curvature, out=np.zeros_like(q), where=curvature > 0)
        pull = gradient[rows.entries] * q
        slope = rows.spread(rows.sums(pull * q * soft))
        scale = rows.spread(rows.sums(q * q * soft))
        mean = np.divide(slope, scale, out=np.zeros_like(slope), where=scale > 0)
        moved: Array = np.divide(
            (pull - q * mean) * soft, zeta, out=np.zeros_like(q), where=zeta > 0
        )
        return moved
