"""Rows of a continuous task's report: functions of a policy that give an ``Estimate``.

They estimate J = E[sum_{t<T} gamma^t r_t].

Monte Carlo in a task (``Rollouts``): the simulator, the simulator corrected by the
log's residuals, a linear model of the log; of the last two the error counts the
rollouts and the log, see ``corrected_value``. Importance sampling on the log's own
episodes, with the policy's probabilities in the log's own states: every row of the log
is a state of its own.

On cells (``OnCells``): the simulator is discretised at the log's own places, with the
small defensive share of its configuration; the log becomes numbered transitions and
soft counts on the same cells; zeta is fitted to the soft counts. Beside the raw value
stands the calibrated one, by the simulator without the defensive share.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

import numpy as np
from scipy.special import stdtrit

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import one_thread
from oee_tabular._sparse import row_sums
from oee_tabular.continuous.cells import Grid
from oee_tabular.continuous.correction import describe_flaw
from oee_tabular.continuous.discretization import CellsLike
from oee_tabular.continuous.episodes import (
    MonteCarlo,
    compare_returns,
    monte_carlo_value,
)
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.regression import LinearModel
from oee_tabular.continuous.residual import ResidualSimulator
from oee_tabular.continuous.simulator import ContinuousSimulator, Settings
from oee_tabular.continuous.task import ContinuousTask, StatePolicy
from oee_tabular.data import Transitions
from oee_tabular.estimators import (
    Estimate,
    Estimator,
    OffEnvironment,
    Problem,
    Simulator,
    calibrate,
)
from oee_tabular.estimators.diagnostics import Diagnostics
from oee_tabular.estimators.findings import Finding, missing_support
from oee_tabular.exact import policy_value
from oee_tabular.exceptions import ArgumentError, DiscretizationWarning, NoCellsError
from oee_tabular.ratio import uncovered_share
from oee_tabular.shrinkage import transition_ratio
from oee_tabular.typing import Array, Seed

# A finding tells of a larger share of transitions that start beyond the log's range.
MAX_BEYOND_SHARE = 0.02
# The rows on the cells leave out up to this share of the log's transitions, those
# without support.
MAX_SHARE_LEFT_OUT = 0.01
QUANTILE = 1.96  # standard errors, of the intervals that estimators set themselves
BEYOND = (
    "{} of the policy's transitions start outside the range of the recorded states. The"
    " correction is a guess there, and no interval counts its error."
)
CALIBRATED_FAR = (
    "calibration changes the value by {}. Rely on the corrected simulator instead."
)

Row: TypeAlias = Callable[[StatePolicy], Estimate]


@dataclass(frozen=True)
class Rollouts:
    """How values are computed by Monte Carlo.

    Attributes
    ----------
    horizon : int
        The number of rewards.
    discount : float
        Gamma, in [0, 1].
    episodes : int
        The number of episodes of each value.
    seed : numpy.random.SeedSequence
        The seed of all values, whatever the policy and the task.
    refits : int
        How many logs are resampled.
    paths : int
        The number of episodes by which each J_b - J is computed.
    """

    horizon: int
    discount: float
    episodes: int
    seed: np.random.SeedSequence
    refits: int = 20
    paths: int = 1000

    def _stream(self, *key: int) -> np.random.SeedSequence:
        """Return the seed of a stream of its own."""
        return np.random.SeedSequence(
            self.seed.entropy, spawn_key=(*self.seed.spawn_key, *key)
        )

    def value(self, task: ContinuousTask, policy: StatePolicy) -> MonteCarlo:
        """Estimate J of the policy in the task."""
        seed = np.random.default_rng(self._stream())
        return monte_carlo_value(
            task, policy, self.episodes, self.horizon, discount=self.discount, seed=seed
        )

    def _sample_returns(
        self, tasks: Sequence[ContinuousTask], policy: StatePolicy, n: int
    ) -> Array:
        """Sample returns (len(tasks), at most n) with common random numbers."""
        n = min(n, self.paths, self.episodes)
        seed = self._stream(1)
        return compare_returns(
            tasks, policy, n, self.horizon, discount=self.discount, seed=seed
        )

    def estimate(
        self,
        learned: ResidualSimulator | LinearModel,
        policy: StatePolicy,
        status: str = "ok",
    ) -> Estimate:
        """Estimate J in a task learned from the log.

        Its error counts the log and the rollouts.

        Parameters
        ----------
        learned : ContinuousTask
            A task whose ``resampled(rng)`` is the same fitted to a bootstrap's log. A
            report begins with the value in a ``ResidualSimulator``, which says how
            often the policy leaves what the log has observed.
        policy : function
            The policy, of the task's states.
        status : str, default 'ok'
            Why the value is not to be relied on, and then has no error; or 'ok'.

        Returns
        -------
        Estimate
            The value.
        """
        mc = self.value(learned, policy)
        is_ok = status == "ok"
        facts: dict[str, Any] = {
            "standard_error_of": "rollouts",
            "n_rollouts": mc.n_episodes,
        }
        error: float | None = None
        interval: tuple[float, float] | None = None
        findings: tuple[Finding, ...] = ()
        if is_ok:
            rngs = map(np.random.default_rng, self._stream(2).spawn(self.refits))
            refitted = [learned.resampled(rng) for rng in rngs]
            tasks = [learned, *refitted]
            returns = self._sample_returns(tasks, policy, self.paths)
            of_log = float((returns[1:] - returns[0]).mean(axis=1).std(ddof=1))
            error = float(np.hypot(of_log, mc.standard_error))
            reach = error * float(stdtrit(self.refits - 1, 0.975))
            interval = mc.value - reach, mc.value + reach
            facts |= {
                "standard_error_of": "log and rollouts",
                "refits": self.refits,
                "standard_error_of_the_log": of_log,
                "interval_method": "refits",
            }
        if isinstance(learned, ResidualSimulator):
            counts = np.zeros(2)

            def watch(states: Array) -> Array:
                """Count the states beyond the log's, and return probabilities."""
                counts[:] += learned.beyond(states).sum(), len(states)
                return policy(states)

            self._sample_returns([learned], watch, 200)
            share = float(counts[0] / counts[1])
            corrected = [c for c in learned.coordinates if c.kind != "zero"]
            explained = ", ".join(f"{c.name} {c.explained:.3g}" for c in corrected)
            facts |= {"explained": explained, "beyond_log": share}
            if share > MAX_BEYOND_SHARE:
                findings = (Finding("beyond", share, BEYOND, f"{share:.0%}"),)
        return Estimate(
            mc.value,
            error,
            interval,
            facts,
            status,
            findings,
            is_normal=is_ok,
            is_headline=is_ok and isinstance(learned, ResidualSimulator),
        )


@suggest_keywords
@one_thread
def corrected_value(
    corrected: ResidualSimulator,
    policy: StatePolicy,
    n_episodes: int,
    horizon: int,
    *,
    discount: float = 0.99,
    refits: int = 20,
    paths: int = 1000,
    seed: Seed = None,
) -> Estimate:
    """Estimate J in the corrected simulator by Monte Carlo, with error and interval.

    J = E[sum_{t<T} gamma^t r_t]; its standard error counts the rollouts and the log,

        se^2 = se_MC^2 + Var_b (J_b - J),

    J_b of the correction fitted to resampled episodes, by common random numbers.

    Parameters
    ----------
    corrected : ResidualSimulator
        The corrected simulator.
    policy : function
        The policy: of states (n, d) it gives probabilities (n, A).
    n_episodes : int
        The number of episodes of the value.
    horizon : int
        T, the number of rewards.
    discount : float, default 0.99
        Gamma, in [0, 1].
    refits : int, default 20
        How many logs are resampled, at least 2.
    paths : int, default 1000
        The number of episodes by which each J_b - J is computed.
    seed : int, Generator or SeedSequence, optional
        The source of random numbers. The same seed gives the same bits.

    Returns
    -------
    Estimate
        The value with its standard error and 95% interval. Its ``status`` is not "ok",
        and there is no interval, where history explains what the correction leaves
        over: the state is not Markov then.

    Raises
    ------
    ValueError
        If a number is out of its range.

    See Also
    --------
    monte_carlo_value : The value in a task, without the error of a log.

    Notes
    -----
    Costs (n_episodes + (refits + 1) paths) horizon steps of the corrected simulator.
    The interval is that of Student's t. It covers the variation between logs, not a
    change that no smooth correction fits.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy, record
    >>> log = record(
    ...     CartPole(15.0),
    ...     cartpole_policy(0.3),
    ...     n_transitions=2000,
    ...     max_steps=100,
    ...     seed=0,
    ... )
    >>> corrected = ResidualSimulator(CartPole(10.0), log, seed=0)
    >>> found = corrected_value(
    ...     corrected, cartpole_policy(0.6), 1000, 100, refits=5, paths=200, seed=0
    ... )
    >>> found.status, bool(found.interval[0] < found.value < found.interval[1])
    ('ok', True)
    """
    _checks.instance(corrected, ResidualSimulator, "corrected")
    _checks.function(policy, "policy")
    steps = _checks.positive_integer(horizon, "horizon")
    episodes = _checks.positive_integer(n_episodes, "n_episodes")
    n_refits = _checks.positive_integer(refits, "refits")
    n_paths = _checks.positive_integer(paths, "paths")
    if n_refits < 2:
        raise ArgumentError(
            "refits", f"must be at least 2, for a variance; got {refits}"
        )
    gamma = _checks.number_in(discount, "discount", 0.0, 1.0)
    stream = _checks.seed_sequence(seed, ())
    rollouts = Rollouts(steps, gamma, episodes, stream, n_refits, n_paths)
    return rollouts.estimate(corrected, policy, describe_flaw(corrected))


def refuse_impossible(
    estimate: Estimate, lowest: float, highest: float, horizon: int, scale: float = 1.0
) -> Estimate:
    """Return the estimate without a value that no sum of the rewards can have.

    The status then says so in a sentence. A value that is beyond the bounds by at most
    1.96 standard errors is put on the bound; ``scale`` multiplies values in the
    sentence.
    """
    value = estimate.value
    bounds = [abs(bound) for bound in (lowest, highest) if np.isfinite(bound)]
    rounding = 1e-9 * max(bounds, default=0.0)
    nearest = float(np.clip(value, lowest, highest))
    if not np.isfinite(value) or abs(nearest - value) <= rounding:
        return estimate
    if abs(nearest - value) <= QUANTILE * (estimate.standard_error or 0.0):
        return replace(estimate, value=nearest)
    shown, low, high = (x * scale for x in (value, lowest, highest))
    text = (
        f"{shown:.4g} is impossible: a sum of {horizon} rewards is between {low:.4g}"
        f" and {high:.4g}"
    )
    facts = estimate.diagnostics | {"refused_value": value}
    return replace(
        estimate,
        value=float("nan"),
        standard_error=None,
        interval=None,
        status=text,
        findings=(),
        diagnostics=facts,
    )


class OnCells:
    """A simulator and a log on cells, and the ratio between the two.

    It is what does not depend on the policies.

    Parameters
    ----------
    simulator : ContinuousSimulator
        The simulator.
    log : ContinuousTransitions
        The log, whose actions are numbers.
    settings : Settings
        Where the cells lie (``grid``), and what is done with what lies outside of them.
    horizon : int
        The number of rewards.
    discount : float
        Gamma, in [0, 1].
    seed : int, Generator or SeedSequence, optional
        The source of the numbers that the log's states get.

    Attributes
    ----------
    model : Discretization
        The simulator on the cells.
    problem : Problem
        The log on the cells.
    facts : dict
        What the report says of them.

    Raises
    ------
    NoCellsError
        If too many transitions have no support.
    ValueError
        If the settings do not fit, or states lie outside the cells and
        ``settings.outside`` is "error".
    """

    def __init__(
        self,
        simulator: ContinuousSimulator,
        log: ContinuousTransitions,
        settings: Settings,
        horizon: int,
        discount: float,
        seed: Seed,
    ) -> None:
        floor = simulator.floor
        if settings.floor is not None:
            floor = _checks.number_in(settings.floor, "floor", 0.0, 1.0)
        cells: CellsLike | None = None
        if not isinstance(settings.grid, str):
            cells = settings.grid
        else:
            _checks.one_of(settings.grid, "grid", ("auto",), " (or cells)")
        self.model = model = simulator.discretize(
            log, cells=cells, floor=floor, discount=discount
        )
        counts = model.counts(log, outside=settings.outside)
        where = model.cells.extent()
        stream = _checks.seed_sequence(seed, (10**6 + 1,))
        encoded = model.encode(log, seed=stream, outside=settings.outside)
        # rewards differ within a cell: they are held against the task's own steps, not
        # against the cells' means
        columns = encoded.columns()
        columns.pop("reward", None)
        bag = Transitions(**columns)
        kept, share = model.supported(counts)
        if kept.nnz == 0 or (share > MAX_SHARE_LEFT_OUT and settings.outside != "drop"):
            ways = [
                "a coarser grid (--grid NxM)",
                "without those transitions (--task-option outside=drop)",
            ]
            more = ""
            if floor > 0.0:
                more = f", with a defensive share of {floor:g}"
            else:
                ways.insert(0, "a defensive share (--task-option floor=0.001)")
            raise NoCellsError(
                f"the log must stay where the simulator has probability: {share:.2g} of"
                f" its transitions have none on {where}{more}, and no ratio exists"
                f" there. Ways out: {', '.join(ways[:-1])}, or {ways[-1]}"
            )
        if share > 0.0:
            lost = row_sums(counts) - row_sums(kept)
            most = int(lost.argmax()) // model.task.n_actions
            _checks.warn(
                f"{share:.2g} of the log's transitions have no probability in the"
                f" simulator on {where}; the rows on the cells leave them out. Most of"
                f" them begin at state {most}",
                DiscretizationWarning,
            )
        episodes = encoded if encoded.episode is not None else None
        self.problem = Problem(
            model.mdp, bag, horizon=horizon, counts=kept, episodes=episodes
        )
        is_tied = model.task.is_translation_invariant and isinstance(model.cells, Grid)
        tie = model.displacement_ties() if is_tied else None
        self._zeta = transition_ratio(kept, model.mdp, tie=tie, **simulator.ratio)
        largest = float(self._zeta.values.data.max())
        uncovered = uncovered_share(kept, model.plain)
        self._support = {
            "uncovered_mass": uncovered,
            "largest_zeta": largest,
            "d_inf": float(np.log(largest)),
        }
        ratio = dict(simulator.ratio)
        if tie is not None:
            ratio = {"tie": "displacements"} | ratio
        self.facts: dict[str, Any] = {
            "simulator": self._describe(simulator.name),
            "log": (
                f"{len(log)} transitions of {log.n_state}-dimensional states; encoded:"
                f" {encoded.describe()}"
            ),
            "grid": where,
            "floor": floor,
            "ratio": ratio,
            "rows_left_out": len(log) - len(encoded),
            "moves_left_out": share,
            "closure_error": model.diagnostics["closure_error"],
            **self._support,
        }
        rewards = [model.mdp.rewards.min(), model.mdp.rewards.max()]
        if log.reward is not None:
            rewards += [log.reward.min(), log.reward.max()]
        # after an end all rewards are 0
        if log.terminated.any() or model.mdp.absorbing().any():
            rewards.append(0.0)
        number = float(np.sum(discount ** np.arange(horizon)))
        self._bounds = float(min(rewards)) * number, float(max(rewards)) * number

    def _describe(self, name: str) -> str:
        """Describe the simulator on cells in one line of a report."""
        model = self.model
        support = self._support
        places = ", looked at in the log's own places"
        if model.task.is_translation_invariant:
            places = ""
        text = f"{name} on {model.cells.extent()}{places}: {model.mdp!r}"
        if floor := model.metadata["floor"]:
            own = model.metadata["parameters"]
            others = model.metadata["others"]
            differing = []
            for parameters in others:
                changes = [(k, v) for k, v in parameters.items() if own.get(k) != v]
                differing.append(", ".join(f"{k}={v:.3g}" for k, v in changes))
            other = "a transition of the log"
            if others:
                other = f"one of {'; '.join(differing)}"
            text += (
                f"; defensive: with probability {floor:g} a step is {other} (plain:"
                " without)"
            )
        error = model.diagnostics["closure_error"]
        noise = model.diagnostics["closure_standard_error"]
        return (
            text
            + f"; closure error of the uniform policy {error:+.1%} (+-{noise:.1%});"
            f" uncovered mass {support['uncovered_mass']:.2g}, largest zeta"
            f" {support['largest_zeta']:.3g} (D_inf {support['d_inf']:.2g} nats)"
        )

    def plain(self, problem: Problem, policy: Any, *, seed: Seed = None) -> Estimate:
        """Compute the exact value in the simulator on the cells without a floor."""
        return Estimate(
            policy_value(self.model.plain, policy, horizon=self.problem.horizon)
        )

    def raw(self, problem: Problem, policy: Any, *, seed: Seed = None) -> Estimate:
        """Compute the off-environment value on the cells, and its ratio's support."""
        found = OffEnvironment(self._zeta)(self.problem, policy, seed=seed)
        missing = missing_support(*self._support.values())
        return replace(
            found,
            diagnostics=found.diagnostics | self._support,
            findings=(*found.findings, *missing),
        )

    def calibrated(
        self,
        simulate: Callable[[Array], MonteCarlo],
        kind: Literal["ratio", "difference"],
        scale: float,
    ) -> Estimator:
        """Return the estimator of the raw value, calibrated by ``simulate(policy)``.

        Its values do not lie beyond what the rewards can sum to.
        """

        def row(problem: Problem, policy: Any, *, seed: Seed = None) -> Estimate:
            """Estimate the calibrated value of a policy."""
            below = self.plain(problem, policy).value
            found = calibrated_row(
                self.raw(problem, policy), simulate(policy), below, kind, scale
            )
            return refuse_impossible(
                found, *self._bounds, self.problem.horizon or 0, scale
            )

        return row

    def others(self, wanted: Mapping[str, Estimator]) -> dict[str, Estimator]:
        """Return the rows of finite estimators without calibration; oee's is last."""
        rows: dict[str, Estimator] = {}
        for name, estimator in wanted.items():
            if estimator != OffEnvironment():
                rows[name] = estimator
            has_floor = self.model.mdp is not self.model.plain
            if isinstance(estimator, Simulator) and has_floor:
                rows["simulator (plain)"] = self.plain
        if OffEnvironment() in wanted.values():
            rows["oee on the grid"] = self.raw
        return rows

    def describe_loss(
        self, simulate: Callable[[Array], MonteCarlo], tables: Mapping[str, Array]
    ) -> str:
        """Describe by how much the cells change the simulator's own values.

        No interval counts that.
        """
        parts = []
        for name, table in tables.items():
            value = simulate(table).value
            change = self.plain(self.problem, table).value - value
            parts.append(f"{change:+.3g} of {value:.3g} ({name})")
        changes = ", ".join(parts)
        return (
            "standard errors and intervals count the log's noise and not the error of"
            f" the cells. The cells change the simulator's own value by {changes}, and"
            " may change another environment's by more"
        )

    def add_features(self, text: str) -> str:
        """Return a warning with the features of the states that it numbers."""
        model = self.model

        def place(match: re.Match[str]) -> str:
            """Return the matched state with the mean features of its cell."""
            points = model.points[model.places.point_cell == int(match[1])]
            if len(points) == 0:  # no point stands for the terminal state
                return match[0]
            means = model.task.features(points).mean(axis=0)
            pairs = zip(model.task.feature_names, means, strict=True)
            features = ", ".join(f"{name}={value:.3g}" for name, value in pairs)
            return f"{match[0]} ({features})"

        return re.sub(r"\bstate (\d+)", place, text)


def calibrated_row(
    raw: Estimate,
    outside: MonteCarlo,
    below: float,
    kind: Literal["ratio", "difference"],
    scale: float,
) -> Estimate:
    """Return the raw value calibrated by the simulator's value, as a row of its own.

    It is multiplied by J_continuous / J_discretised of the simulator, or their
    difference is added.
    """
    found = calibrate(
        raw,
        discretised=below,
        continuous=outside.value,
        continuous_error=outside.standard_error,
        kind=kind,
    )
    value = found.diagnostics["calibrated_value"]
    error = found.diagnostics["calibrated_standard_error"]
    # values of the raw row are not those of this one, nor are its row sums
    facts = {
        name: x
        for name, x in found.diagnostics.items()
        if Diagnostics.unit_of(name) != "value" and name != "row_sum_error"
    }
    findings = list(found.findings)
    apart = abs(raw.value - value)
    own = abs(outside.value - below)
    # calibration then changes more than the cells did
    if apart > 1.01 * own + 2.0 * outside.standard_error:
        figure = (
            f"{apart * scale:.3g}, and the cells change the simulator's own value by"
            f" {own * scale:.3g} alone"
        )
        finding = Finding("calibrated far", apart * scale, CALIBRATED_FAR, figure)
        findings.append(finding)
    ends = None
    if found.interval is not None and error is not None:
        ends = (value - QUANTILE * error, value + QUANTILE * error)
    return replace(
        found,
        value=value,
        standard_error=error,
        interval=ends,
        diagnostics=facts | {"interval_method": "calibrated"},
        findings=tuple(findings),
        model_value=None,
        is_normal=True,
        is_from_log=True,
        is_from_episodes=False,
        is_headline=False,
    )
