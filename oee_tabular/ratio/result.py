"""Fitted ratios zeta: values, certificate, standard error and one-step correction."""

from __future__ import annotations

from dataclasses import astuple, dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from oee_tabular import _checks, _printing
from oee_tabular._parallel import one_thread
from oee_tabular._results import checked
from oee_tabular._sparse import (
    align,
    check_values,
    csr_on_pattern,
    row_of_entry,
    row_sums,
)
from oee_tabular.exact import exponent
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, Rows
from oee_tabular.ratio.prior import FittedRows
from oee_tabular.typing import Array, BoolArray, Csr, RealArrayLike


@checked(shapes={"visited": "S A", "counts": "S A"})
@dataclass(frozen=True, eq=False)
class TransitionRatio:
    """Fitted zeta on the simulator's support, with its certificate and diagnostics.

    Attributes
    ----------
    values : sparse array of shape (S*A, S)
        zeta on the entries of ``simulator.transitions``, row s*A + a and column s'.
    method : str
        The method's name.
    gap : float
        The largest duality gap of the programs solved, in nats, each program scaled to
        probabilities.
    visited : ndarray of bool of shape (S, A)
        Whether the pair was recorded; elsewhere zeta is what the method carries over
        to it: the prior's, the class's, or 1.
    row_sum_error : float
        The largest absolute difference of sum_s' zeta P from 1 over (s, a).
    counts : ndarray of shape (S, A)
        Number of transitions of the log in each pair.
    details : dict
        The method's own diagnostics.
    tied : bool
        Whether transitions of one key share one value, so that unrecorded pairs are not
        the prior's.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (
    ...     oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5)
    ...     for p in (0.5, 0.6)
    ... )
    >>> fit = oee.transition_ratio(
    ...     oee.sample_transitions(target, [[0.5], [0.5]], 1000, seed=0), simulator
    ... )
    >>> fit.counts.tolist(), fit.row_sum_error < 1e-12, fit.gap < 1e-9
    ([[502.0], [498.0]], True, True)
    >>> fit.target_model(simulator)
    FiniteMDP(2 states, 1 actions, 4 transitions, rewards r(s, a), discount 0.5)
    """

    values: Csr
    method: str
    gap: float
    visited: BoolArray
    row_sum_error: float
    counts: Array
    details: dict[str, Any] = field(default_factory=dict)
    tied: bool = False
    _influence: Influence | None = field(default=None, repr=False)

    @property
    def _n_pairs(self) -> int:
        """Return the number of state-action pairs that can be taken."""
        return int(np.count_nonzero(np.diff(self.values.indptr)))

    def __repr__(self) -> str:
        """Return one line about the ratio."""
        data = self.values.data
        return (
            f"TransitionRatio({self.method}: {len(data)} values from {data.min():.4g}"
            f" to {data.max():.4g}, {int(self.visited.sum())} of {self._n_pairs}"
            f" pairs recorded, gap {self.gap:.1e}, row-sum error"
            f" {self.row_sum_error:.1e})"
        )

    def _repr_html_(self) -> str:
        """Return a table for notebooks."""
        data = self.values.data
        rows = [
            ("method", self.method),
            ("values", f"{len(data)}, from {data.min():.4g} to {data.max():.4g}"),
            ("pairs recorded", f"{int(self.visited.sum())} of {self._n_pairs}"),
            ("largest gap (nats)", f"{self.gap:.1e}"),
            ("row-sum error", f"{self.row_sum_error:.1e}"),
        ]
        return _printing.facts(
            "TransitionRatio: P_target / P_simulator, without unit", rows
        )

    def on(self, simulator: FiniteMDP) -> Array:
        """Return the values on the entries of ``simulator.transitions``.

        Parameters
        ----------
        simulator : FiniteMDP
            The simulator that the ratio was fitted for.

        Returns
        -------
        ndarray of shape (entries,)
            The ratio of each entry.

        Raises
        ------
        ValueError
            If the ratio is another simulator's.
        """
        _checks.instance(simulator, FiniteMDP, "simulator")
        if self.values.shape != simulator.transitions.shape:
            raise ArgumentError(
                "ratio",
                f"must be for {simulator.transitions.shape} rows and states; it is for"
                f" {self.values.shape}, another simulator's",
            )
        zeta, stored = align(
            check_values(self.values, "ratio"),
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
        """Return zeta * P as a model of the target.

        Parameters
        ----------
        simulator : FiniteMDP
            The simulator that the ratio was fitted for.
        normalize : bool, default False
            Whether each row is divided by its sum.

        Returns
        -------
        FiniteMDP
            The simulator with the transitions zeta * P.

        Raises
        ------
        ValueError
            If rows of zeta * P do not sum to 1 (the paper's quotient) and ``normalize``
            is False.

        See Also
        --------
        maximum_likelihood_model : The same without a prior in recorded pairs.
        """
        _checks.boolean(normalize, "normalize")
        zeta = self.on(simulator)
        data = zeta * simulator.transitions.data
        sums = row_sums(simulator.transitions, data)
        # the rows of actions that cannot be taken are empty
        sums[~simulator.available.reshape(-1)] = 1.0
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
        """Return the model of the log's frequencies, zeta * P in unrecorded pairs.

        Parameters
        ----------
        simulator : FiniteMDP
            The simulator that the ratio was fitted for.

        Returns
        -------
        FiniteMDP
            The simulator with these transitions.

        Raises
        ------
        ValueError
            If the method keeps no frequencies, or the ratio is another simulator's.

        See Also
        --------
        target_model : The model zeta * P.
        """
        # This raises an error where the ratio is another simulator's.
        self.on(simulator)
        if self._influence is None:
            raise ValueError(
                f"a ratio of method {self.method!r} has no maximum-likelihood model: it"
                " keeps no frequencies"
            )
        rows = self._influence.maximum_likelihood_rows()
        return simulator.with_transitions(csr_on_pattern(simulator.transitions, rows))

    @property
    def maximum_likelihood_rows(self) -> Array | None:
        """Return the rows of ``maximum_likelihood_model``, (entries,).

        None where the method keeps no frequencies.
        """
        if self._influence is None:
            return None
        return self._influence.maximum_likelihood_rows()

    @property
    def finite(self) -> bool:
        """Return whether zeta, its gap and its errors are finite numbers."""
        numbers: list[Array] = [self.values.data, np.asarray(self.gap)]
        if self._influence is not None:
            if self._influence.information is not None:
                numbers.append(self._influence.information)
            fitted = self._influence.prior
            if fitted is not None and not fitted.is_finite:
                return False
        return all(np.isfinite(x).all() for x in numbers)

    @one_thread
    def log_standard_error(self, gradient: RealArrayLike) -> float | None:
        """Compute the standard error that the log's sampling noise gives a value.

        Parameters
        ----------
        gradient : array-like of shape (entries,)
            The value's derivative in each entry of zeta * P
            (``exact.transition_gradient``).

        Returns
        -------
        float or None
            The standard error, in the value's unit; None where no formula is known.

        See Also
        --------
        one_step : The correction towards maximum likelihood, with its own error.

        Notes
        -----
        Rows are taken as multinomial given their counts, and what was chosen on the
        data (the prior's strength, the strengths of directions) as given; parameters of
        a tilt have their posterior variance, so that rows without data add what they
        share with others. The error that a wrong prior makes is not in it.
        """
        scaled, shift = self._scale(gradient)
        if self._influence is None:
            return None
        return float(np.ldexp(self._influence.standard_error(scaled), shift))

    @one_thread
    def one_step(self, gradient: RealArrayLike) -> OneStep | None:
        """Compute the first-order correction of a value towards maximum likelihood.

        Parameters
        ----------
        gradient : array-like of shape (entries,)
            The value's derivative in each entry of zeta * P
            (``exact.transition_gradient``).

        Returns
        -------
        OneStep or None
            The correction with its standard errors; None where the method keeps no
            frequencies.

        See Also
        --------
        log_standard_error : The error of the value without the correction.

        Notes
        -----
        The correction is sum_x gradient_x (n_x / n_sa - zeta P), over recorded rows. It
        removes, to first order, the bias that the prior brings, and takes on the
        variance of maximum likelihood. Its error takes the variances of a row under
        zeta P: a row with a single transition has none under its own frequencies.
        """
        scaled, shift = self._scale(gradient)
        if self._influence is None:
            return None
        step = self._influence.one_step(scaled)
        return OneStep(*(float(np.ldexp(part, shift)) for part in astuple(step)))

    def _scale(self, gradient: RealArrayLike) -> tuple[Array, int]:
        """Return the checked gradient divided by 2^shift, and shift.

        The power of two keeps the gradient's squares within double precision.
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


@checked()
@dataclass(frozen=True)
class OneStep:
    """A one-step correction of a value, in the value's unit.

    Attributes
    ----------
    change : float
        The number to add to the value.
    standard_error : float
        Standard error of the corrected value, sqrt(sum over recorded rows of
        Var(gradient) / n), variances under zeta P.
    unrecorded : float
        The part that unrecorded pairs may add to it: sqrt(sum of Var(gradient)), each
        as of one transition.
    change_error : float
        Standard error of the change alone, sqrt(sum (1 - share)^2 Var(gradient) / n).
    """

    change: float
    standard_error: float
    unrecorded: float
    change_error: float


@dataclass(frozen=True, eq=False)
class Influence:
    """The derivative of zeta * P in the log's frequencies.

    It follows from the conditions that determine zeta. Sums go over the rows block by
    block, to save memory.

    Attributes
    ----------
    rows : Rows
        The simulator's rows.
    counts : ndarray of shape (entries,)
        Counts n_x.
    ratio : ndarray of shape (entries,)
        zeta.
    curvature : ndarray of shape (entries,)
        p / zeta^2 + A inside the box, 0 at its bounds (where the derivative is 0).
    share : ndarray of shape (rows,)
        Weight of the data in a row, n_sa / (n_sa + kappa).
    prior : FittedRows or None
        The prior's rows, where they are fitted to the log.
    scores : ndarray of shape (entries, d) or None
        d log zeta / d parameters of a class that all rows share.
    information : ndarray of shape (d, d) or None
        The Hessian of the class's risk.
    """

    rows: Rows
    counts: Array
    ratio: Array
    curvature: Array
    share: Array
    prior: FittedRows | None = None
    scores: Array | None = None
    information: Array | None = None

    @cached_property
    def n(self) -> Array:
        """Return the counts n_sa, (rows,)."""
        return self.rows.sums(self.counts)

    def standard_error(self, gradient: Array) -> float:
        """Compute the standard error that the log's noise makes.

        For a class it is sqrt(sum_rows n Var(psi)), psi = d value / d (one more
        observation). Else it is sqrt(sum_rows share^2 Var(d) / n + p' H^-1 p), d = d
        value / d frequencies, p and H the derivative in the tilt's parameters, through
        the rows' share of the prior, and their information. Variances are those under
        the frequencies.
        """
        total = 0.0
        step = None
        if self.scores is not None:
            assert self.information is not None
            prior_share = self.rows.spread(1.0 - self.share)
            free = self._by_probability(gradient, self.rows) * prior_share
            slope = (free * self.ratio * self.rows.weights) @ self.scores
            step = np.linalg.lstsq(self.information, slope)[0]
        for rows in self.rows.select(self.n > 0).blocks():
            n = self.n[rows.number]
            slope = self._by_probability(gradient, rows)
            psi = rows.spread(self.share[rows.number] / n) * slope
            if step is not None and self.scores is not None:
                psi += self.scores[rows.entries] @ step
            frequencies = rows.frequencies(self.counts[rows.entries])
            total += float(np.sum(n * rows.variance(frequencies, psi)))
        if self.prior is not None:
            pull: Any = 0.0
            for rows in self.rows.blocks():
                prior_share = rows.spread(1.0 - self.share[rows.number])
                free = prior_share * self._by_probability(gradient, rows)
                pull = pull + self.prior.pull(rows, free * self.prior.at(rows))
            total += self.prior.variance(pull)
        return float(np.sqrt(total))

    def maximum_likelihood_rows(self) -> Array:
        """Return n_x / n_sa in recorded rows and zeta P elsewhere, (entries,)."""
        model = self.ratio * self.rows.weights
        recorded = self.rows.select(self.n > 0)
        frequencies = recorded.frequencies(self.counts[recorded.entries])
        model[recorded.entries] = frequencies
        return model

    def one_step(self, gradient: Array) -> OneStep:
        """Compute the one-step correction, the prior taken as given.

        The variances of a row are those under zeta P (``TransitionRatio.one_step``).
        """
        variance = np.empty(len(self.rows))
        change = 0.0
        for rows in self.rows.blocks():
            kernel = self.ratio[rows.entries] * rows.weights
            slope = gradient[rows.entries]
            variance[rows.number] = rows.variance(kernel, slope)
            recorded = rows.spread(self.n[rows.number] > 0)
            difference = rows.frequencies(self.counts[rows.entries]) - kernel
            change += float(slope[recorded] @ difference[recorded])
        is_recorded = self.n > 0
        each = np.where(is_recorded, variance / np.maximum(self.n, 1.0), 0.0)
        return OneStep(
            change,
            standard_error=float(np.sqrt(each.sum())),
            unrecorded=float(np.sqrt(variance[~is_recorded].sum())),
            change_error=float(np.sqrt(np.sum((1.0 - self.share) ** 2 * each))),
        )

    def _by_probability(self, gradient: Array, rows: Rows) -> Array:
        """Compute d value / d p, p the smoothed frequencies, on the rows' entries.

        It follows from H dg = dp/g - q dm and sum q dg = 0 in each of the rows.
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
