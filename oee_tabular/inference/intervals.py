"""Confidence intervals for J: ``interval``, by four methods, and ``value_range``, the
range of J under Assumption V.1.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from oee_tabular import _checks, _printing
from oee_tabular._parallel import one_thread
from oee_tabular.estimators import OffEnvironment, Problem
from oee_tabular.exact import policy_value
from oee_tabular.exceptions import ArgumentError
from oee_tabular.inference.asymptotic import (
    bootstrap_values,
    outside_margin,
    value_covariances,
)
from oee_tabular.inference.evidence import (
    Evidence,
    describe_rows,
    evidence_of,
    gather,
    reachable_rows,
    require_squares,
    unrecorded_share,
)
from oee_tabular.inference.likelihood import (
    likelihood_ends,
    shared_directions,
    shared_ends,
)
from oee_tabular.inference.robust import (
    extreme_value,
    find_contradictions,
    radii,
    require_end,
)
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.plots import plot_intervals
from oee_tabular.typing import PolicyLike, Seed

if TYPE_CHECKING:
    from matplotlib.axes import Axes

METHODS = ("likelihood", "delta", "bootstrap", "robust")
NO_VARIATION = (
    "the log's transitions that affect the value never vary: no spread can be"
    " estimated; use method='likelihood'"
)


@dataclass(frozen=True)
class Interval:
    """A confidence interval for J of a policy in the target, a discounted sum.

    Attributes
    ----------
    lower, upper : the ends (nan where ``status`` says why there is none)
    confidence : the level asked for; at least that for "robust", asymptotically for the
        others; 1 of a ``value_range``
    method : "likelihood", "delta", "bootstrap" or "robust"; "likelihood under the tie"
        or "... under the features"; "range" of a ``value_range``
    diagnostics : plain numbers: ``unrecorded_share``, of the policy's discounted time
        in stochastic pairs never recorded, ``unrecorded_pairs``, how many of them the
        policy reaches, and those of the method; if impossible transitions were dropped,
        their number (``dropped_transitions``) and estimated share of the policy's time
        (``dropped_share``)
    status : "ok", or the contradiction between the log and the assumed box
    sampling : of the likelihood interval: (lower, upper) from the recorded transitions
        alone. If the policy reaches recorded pairs only and no transition was dropped,
        the interval itself, before a sampled simulator widens it; else the value of
        ``OffEnvironment()`` ± a normal quantile times its standard error, in which
        unrecorded pairs are as estimated, with the uncertainty that one transition
        would leave (it covers 96% at 3 to 10 transitions a pair and 90% of the time
        recorded). None without a standard error, and for the other methods

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a known target
    >>> likelihood = interval(pair.problem(1000, seed=0), pair.policy)
    >>> round(likelihood.lower, 2), round(likelihood.upper, 2), pair.truth in likelihood
    (9.87, 10.54, True)
    >>> print(likelihood)
    [9.87, 10.54], 95% likelihood interval; discounted sum of rewards, not normalised
    """

    lower: float
    upper: float
    confidence: float
    method: str
    diagnostics: dict[str, Any] = field(default_factory=dict, repr=False)
    status: str = "ok"
    sampling: tuple[float, float] | None = None

    @property
    def width(self) -> float:
        """upper - lower."""
        return self.upper - self.lower

    def __contains__(self, value: object) -> bool:
        return isinstance(value, int | float) and self.lower <= value <= self.upper

    def __str__(self) -> str:
        what = "range over all models in the box"
        if self.method != "range":
            kind, *under = self.method.partition(" under ")
            what = f"{100 * self.confidence:.4g}% {kind} interval{''.join(under)}"
        if self.status != "ok":
            return f"no {what}: {self.status}"
        return f"{_printing.interval(self.lower, self.upper)}, {what}; {_printing.SUM}"

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the interval on a line (``oee_tabular.plots.plot_intervals``); without
        ``ax`` on new axes.
        """
        return plot_intervals(
            ["value"], [np.nan], [self.lower], [self.upper], ax, title=str(self)
        )

    def _repr_html_(self) -> str:
        spec = _printing.spec(self.lower, self.upper)
        rows: list[tuple[str, object]] = [
            ("lower", format(self.lower, spec)),
            ("upper", format(self.upper, spec)),
            ("width", f"{self.width:.4g}"),
            ("confidence", f"{100 * self.confidence:.4g}%"),
            ("method", self.method),
        ]
        if self.sampling is not None:
            rows.append(
                (
                    "from the recorded transitions alone",
                    _printing.interval(*self.sampling),
                )
            )
        rows += [
            (name, f"{x:.4g}" if isinstance(x, float) else x)
            for name, x in self.diagnostics.items()
        ]
        return _printing.facts(
            f"Interval for a value: {_printing.SUM}", [*rows, ("status", self.status)]
        )


@one_thread
def interval(
    problem: Problem,
    policy: PolicyLike,
    *,
    method: Literal["likelihood", "delta", "bootstrap", "robust"] = "likelihood",
    confidence: float = 0.95,
    lower_ratio: float | None = None,
    upper_ratio: float | None = None,
    tie: Any = None,
    features: Any = None,
    radius: Literal["auto", "independent", "anytime"] = "auto",
    resample: Literal["transitions", "episodes"] = "transitions",
    n_bootstrap: int = 400,
    seed: Seed = None,
) -> Interval:
    """Compute a confidence interval for J of a policy in the target. Rewards are taken
    as known.

    Parameters
    ----------
    problem, policy : as for an estimator
    method : "likelihood"
        Profile likelihood, chi-square with one degree of freedom; unrecorded pairs that
        the policy reaches are set to their extremes in the box.
        "delta", "bootstrap"
        Intervals of the maximum-likelihood model; unrecorded pairs are exactly as
        simulated, without uncertainty. "robust"
        Guaranteed: each pair's distribution lies in a KL ball around its frequencies
        and in the box, in all pairs at once; the extreme values by robust policy
        evaluation, certified.
    confidence : in (0, 1)
    lower_ratio, upper_ratio : the box lower_ratio * P <= P_target <= upper_ratio * P;
        None: any distribution on the simulator's support. It limits "likelihood" in
        unrecorded pairs and "robust" in all; the log is tested against it in each
        recorded pair, weakly: ``radius`` at ``confidence``, shared by all pairs
    tie, features : as in ``transition_ratio``, one of them: the likelihood interval of
        the model in which transitions of one key, or along features, differ from the
        simulator alike, and nothing else does (``inference.likelihood``). It is
        narrower if the assumption is true and may miss the value if it is not
    radius : of the balls: "independent" (fixed counts), "anytime" (random counts, as in
        episodes), "auto": anytime for a log with episodes
    resample, n_bootstrap, seed : what the percentile bootstrap resamples ("transitions"
        or "episodes"), how often, its seed

    Returns
    -------
    Interval
        If the counts contradict the box (with this confidence), no interval, but a
        status that names the pairs.

    Notes
    -----
    Cost: likelihood about a hundred linear solves (10 000 states in a second); robust a
    few policy evaluations with O(nnz) row problems each; bootstrap n_bootstrap
    evaluations. ``promised`` in a likelihood interval's diagnostics is a first-order
    bound on how far models in the set may lie beyond its ends, 0 at convergence. If a
    Problem dropped impossible transitions, "likelihood" and "robust" let them lead
    anywhere (to first order), and the others are refused. All intervals widen for a
    sampled simulator's uncertainty in first states, rewards and unsampled transitions
    (``inference.asymptotic``; ``unmet_share``: the time that the latter may take).
    ``sampling`` includes neither.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a known target
    >>> problem = pair.problem(1000, seed=0)
    >>> [round(interval(problem, pair.policy, method=method).width, 2) for method in ("likelihood", "delta", "robust")]
    [0.66, 0.66, 5.12]
    """
    _checks.instance(problem, Problem, "problem")
    _checks.one_of(method, "method", METHODS)
    _checks.one_of(radius, "radius", ("auto", "independent", "anytime"))
    _checks.one_of(resample, "resample", ("transitions", "episodes"))
    level = _checks.number_in(confidence, "confidence", 0.0, 1.0, open_ends=True)
    if problem.simulator.discount == 1.0 and problem.horizon is None:
        raise ArgumentError("horizon", "must be given at discount 1")
    if tie is not None or features is not None:
        has_box = lower_ratio is not None or upper_ratio is not None
        return _interval_under(
            problem, policy, tie, features, level, method, has_box=has_box
        )
    evidence = gather(problem, policy, lower_ratio, upper_ratio)
    has_dropped = bool(problem.dropped.any())
    if has_dropped and method not in ("likelihood", "robust"):
        raise ArgumentError(
            "method",
            "must be 'likelihood' or 'robust' if impossible transitions were dropped;"
            f" it is {_checks.show(method)}",
        )
    if has_dropped and evidence.has_box:
        raise ValueError(
            "lower_ratio and upper_ratio must be None if impossible transitions were"
            " dropped: no box contains those"
        )
    kind = (
        ("anytime" if problem.log.by_episodes else "independent")
        if radius == "auto"
        else radius
    )
    z = NormalDist().inv_cdf(0.5 + level / 2.0)
    margin = outside_margin(problem, evidence)
    unrecorded = _count_unrecorded(evidence)
    facts: dict[str, Any] = {
        "unrecorded_share": unrecorded_share(evidence),
        "unrecorded_pairs": unrecorded,
    }
    facts |= {} if margin is None else margin.diagnostics
    wrong = (
        find_contradictions(evidence, level, kind) if evidence.has_box else np.zeros(0)
    )
    if wrong.size:
        status = (
            f"the counts contradict the box [{lower_ratio or 0:g},"
            f" {np.inf if upper_ratio is None else upper_ratio:g}] in {wrong.size}"
            f" state-action pair{'s' * (wrong.size > 1)}, with confidence {level:g}:"
            f" {describe_rows(evidence, wrong)}; widen it"
        )
        return Interval(
            np.nan, np.nan, level, method, facts | {"contradicted_rows": wrong}, status
        )
    sampling: tuple[float, float] | None = None
    if method == "likelihood":
        low, high = likelihood_ends(evidence, level)
        lower = low.value
        upper = high.value
        names = {
            "divergence": "divergence",
            "iterations": "iterations",
            "change": "last_change",
            "promised": "promised",
        }
        facts |= {
            shown: max(getattr(low, name), getattr(high, name))
            for name, shown in names.items()
        }
        sampling = lower, upper
        if has_dropped or unrecorded:
            sampling = _interval_as_estimated(problem, evidence, z, sampling)
            facts["sampling_method"] = "value ± quantile x standard error"
    elif method == "robust":
        require_squares(problem.model)
        radius_of_row = radii(evidence, level, kind)
        ends = [extreme_value(evidence, radius_of_row, sign) for sign in (-1.0, 1.0)]
        lower, upper = (end.bound for end in ends)
        beyond = max(abs(end.bound - end.value) for end in ends)
        facts |= {
            "radius": kind,
            "sweeps": max(end.sweeps for end in ends),
            "certified_beyond": beyond,
        }
    else:
        if method == "delta":
            value = policy_value(
                evidence.fitted, evidence.policy, horizon=evidence.horizon
            )
            error = float(np.sqrt(value_covariances([evidence], prior=0.0)[0][0, 0]))
            lower = value - z * error
            upper = value + z * error
        else:
            number = _checks.positive_integer(n_bootstrap, "n_bootstrap")
            values = bootstrap_values(
                problem, evidence, by=resample, n_bootstrap=number, seed=seed
            )
            lower, upper = (
                float(x)
                for x in np.quantile(values, [(1.0 - level) / 2.0, (1.0 + level) / 2.0])
            )
            error = float(values.std(ddof=1))
        facts["standard_error"] = error
    if margin is not None:
        lower, upper = margin.widen(lower, upper, z)
    varies = (
        upper - lower > 1e-12 * max(abs(lower), abs(upper))
        or not (evidence.open_rows & evidence.reachable).any()
    )
    if method in ("delta", "bootstrap") and not varies:
        facts["standard_error"] = np.nan
        return Interval(np.nan, np.nan, level, method, facts, NO_VARIATION)
    return Interval(lower, upper, level, method, facts, sampling=sampling)


@one_thread
def value_range(
    simulator: FiniteMDP,
    policy: PolicyLike,
    lower_ratio: float | None,
    upper_ratio: float | None,
    *,
    horizon: int | None = None,
) -> Interval:
    """Return the values of a policy in all targets with lower_ratio * P <= P' <=
    upper_ratio * P (Assumption V.1).

    Parameters
    ----------
    simulator : FiniteMDP
    policy : as for ``policy_value``; with a horizon T also (T, S, A)
    lower_ratio : nu in [0, 1]; 0 (or None) sets no lower bound
    upper_ratio : mu in [1, inf]; inf (or None) sets no upper bound
    horizon : number of rewards; None: the infinite discounted sum

    Returns
    -------
    Interval
        Models in the box attain both ends. ``confidence`` is 1, and ``method`` "range".
        ``diagnostics``: the number of ``sweeps``, and by how much at most rounding
        widened an end (``certified_beyond``).

    Raises
    ------
    ValueError
        Bad arguments; discount 1 without a horizon where the sum diverges in some model
        of the box.

    Notes
    -----
    Without data ``interval`` with this box is the same. With a horizon the target may
    change from step to step. Cost: some policy evaluations, and O(nnz) a sweep.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator = oee.tasks.gridworld(4, slip=0.3)
    >>> expert = oee.tasks.gridworld_expert(4)
    >>> print(value_range(simulator, expert, 0.5, 2.0))
    [-13.48, -3.82], range over all models in the box; discounted sum of rewards, not normalised
    """
    _checks.instance(simulator, FiniteMDP, "simulator")
    horizon = _checks.optional_horizon(horizon)
    pi = check_policy(policy, simulator, horizon=horizon)
    evidence = evidence_of(simulator, pi, horizon, None, lower_ratio, upper_ratio)
    if simulator.discount == 1.0 and horizon is None:
        require_end(evidence)
    free = np.full(len(evidence.n), np.inf)
    low, high = (extreme_value(evidence, free, sign) for sign in (-1.0, 1.0))
    beyond = max(abs(end.bound - end.value) for end in (low, high))
    facts = {"sweeps": max(low.sweeps, high.sweeps), "certified_beyond": beyond}
    return Interval(low.bound, high.bound, 1.0, "range", facts)


def _interval_under(
    problem: Problem,
    policy: PolicyLike,
    tie: Any,
    features: Any,
    level: float,
    method: str,
    *,
    has_box: bool,
) -> Interval:
    """The likelihood interval of a model whose rows share parameters."""
    if method != "likelihood" or has_box:
        what = (
            "lower_ratio and upper_ratio must be None"
            if has_box
            else "method must be 'likelihood'"
        )
        raise ValueError(
            f"{what} with {'features' if tie is None else 'tie'}, which defines the"
            " model"
        )
    if problem.dropped.any():
        raise ValueError(
            "tie and features must be left out if impossible transitions were dropped,"
            " which they do not describe"
        )
    directions = shared_directions(problem.simulator, tie, features)
    pi = check_policy(policy, problem.simulator)
    lower, upper, estimate = shared_ends(problem, pi, directions, level)
    name = f"likelihood under the {'features' if tie is None else 'tie'}"
    return Interval(
        lower,
        upper,
        level,
        name,
        {"estimate": estimate, "n_parameters": len(directions.names)},
    )


def _interval_as_estimated(
    problem: Problem, evidence: Evidence, z: float, quoted: tuple[float, float]
) -> tuple[float, float] | None:
    """The default's value, plus or minus a normal quantile times its standard error;
    within the quoted ends under a box.
    """
    estimate = OffEnvironment()(problem, evidence.policy)  # exact: no seed matters
    if estimate.standard_error is None or not np.isfinite(estimate.standard_error):
        return None
    ends = (
        estimate.value - z * estimate.standard_error,
        estimate.value + z * estimate.standard_error,
    )
    return tuple(np.clip(ends, *quoted).tolist()) if evidence.has_box else ends


def _count_unrecorded(evidence: Evidence) -> int:
    """How many rows bear on the value and were never recorded."""
    steps = 1 if evidence.model.discount == 0.0 else evidence.horizon
    if steps is not None and evidence.model.reward_data is None:
        steps -= 1  # where the last step leads pays nothing more
    reached = evidence.reachable if steps is None else reachable_rows(evidence, steps)
    return int(((evidence.n == 0) & evidence.open_rows & reached).sum())
