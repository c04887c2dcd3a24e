"""``evaluate``: policies by estimators, each with a seed of its own, and what a reader must know about them: ``Report``."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from oee_tabular import _checks, _files, _progress
from oee_tabular._checks import Array, Seed
from oee_tabular._threads import one_thread
from oee_tabular.estimators import Estimate, Estimator, Problem, Simulator
from oee_tabular.estimators.findings import MADE_FROM_LOG, WEIGHTLESS
from oee_tabular.estimators.names import default_names, named_estimators
from oee_tabular.exact import Model, action_values, occupancy, policy_value
from oee_tabular.inference.evidence import gather
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.policies import check_policies
from oee_tabular.report import contents
from oee_tabular.report.assumptions import Assumptions
from oee_tabular.report.files import check_page
from oee_tabular.report.quoting import LIKELIHOOD, quoted, sentences, way
from oee_tabular.report.results import Evaluation, Result, headline
from oee_tabular.report.sureness import SHARED, Sureness, how_sure, ranked


class Report(Evaluation):
    """What ``oee evaluate`` prints and draws.

    Attributes
    ----------
    results : one entry per policy and estimator; estimates are raw discounted sums
    truth : exact value of each policy in the target, where the target is known
    warnings : what the numbers do not tell, in plain language
    notes : for each (policy, estimator), the numbers (from 1) of the warnings that concern it
    confidence : of the intervals
    normalized : whether table, picture and JSON multiply values by (1 - discount)
    discount, horizon, seed, facts : how it was computed
    sureness : likelihood (and guaranteed) intervals of each policy, the comparison of the policies, and the sentences that end
        the report
    problem, policies : what was evaluated, for the pictures of ``to_html``

    Examples
    --------
    >>> import oee_tabular as oee
    >>> pair = oee.testing.case("ragged")
    >>> report = oee.evaluate(pair.problem(1000, seed=0), pair.policy, estimators=["pdis"], target=pair.target, seed=0)
    >>> [(row["estimator"], round(row["value"], 2), round(row["error"], 2)) for row in report.records()]
    [('pdis', 10.51, 0.44)]
    """

    @property
    def answer(self) -> str:
        """What the page says first: each policy's value in the target with the interval to quote, beside the simulator's.

        >>> import oee_tabular as oee
        >>> pair = oee.testing.case("ragged")
        >>> oee.evaluate(pair.problem(1000, seed=0), {"new": pair.policy}, seed=0).answer.split("about")[0]
        'In the target, the policy “new” is worth '
        """
        return " ".join(filter(None, contents.first_words(self, contents.answers(self))))

    def to_html(
        self,
        path: str | os.PathLike[str] | None = None,
        *,
        title: str | None = None,
        grid: tuple[int, int] | None = None,
    ) -> str:
        """The report as one self-contained page, for people who did not run it; written to ``path`` if one is given.

        Parameters
        ----------
        path : .html or .htm file; its folder is made, the file appears whole or not at all
        title : of the page
        grid : (rows, columns) of a task whose states are cells, row * columns + column; None: the simulator's layout,
            or the moves that it makes (``plots.map_of``). Other tasks get a picture of the states where a policy spends
            its time

        Returns
        -------
        The page's text. The same input and seed give the same text.

        Raises
        ------
        ValueError
            A path that cannot be written, a grid that has not as many cells as there are states.

        Examples
        --------
        >>> import oee_tabular as oee
        >>> simulator, target = oee.tasks.gridworld(3, slip=0.3), oee.tasks.gridworld(3, slip=0.1)
        >>> log = oee.sample_episodes(target, oee.uniform_policy(target), 20, horizon=30, seed=0)
        >>> page = oee.evaluate(oee.Problem(simulator, log), oee.tasks.gridworld_expert(3), seed=0).to_html()
        >>> page[:15], "Where simulator and target differ most" in page
        ('<!doctype html>', True)
        """
        from oee_tabular.report.page import render

        if title is not None:
            _checks.instance(title, str, "title", "string")
        file = None if path is None else check_page(path)
        text = render(self, title=title, grid=grid)
        if file is not None:
            _files.write_all(file.parent, {file.name: text.encode()})
        return text


@one_thread
def evaluate(
    problem: Problem,
    policies: object,
    *,
    estimators: Sequence[str | Estimator] | Mapping[str, Estimator] | None = None,
    confidence: float = 0.95,
    seed: Seed = None,
    normalized: bool = False,
    target: FiniteMDP | None = None,
    facts: Mapping[str, Any] | None = None,
    guaranteed: bool = False,
    quick: bool = False,
    **assumed: Any,
) -> Report:
    """Evaluate policies in the target by several estimators.

    Parameters
    ----------
    problem : Problem
    policies : a policy in any of its forms (``mdp.check_policy``: (S, A), (S,) actions, by state, a function), a list of such,
        or a mapping name -> policy
    estimators : names, estimators, or a mapping name -> estimator; None: the simulator, off-environment evaluation, the
        model-based baseline, and importance sampling where the log allows it
    confidence : level of the intervals
    seed : int, or anything that ``numpy.random.SeedSequence`` takes; every (policy, estimator) has a stream of its own
    normalized : whether the report multiplies by (1 - discount)
    target : the true target, where it is known (teaching, research): adds its exact values and the errors
    guaranteed : whether the intervals that hold at any sample size are computed too (``interval(method="robust")``)
    quick : whether likelihood intervals, most of the time of large problems, are left out
    assumed : what you know about the target, by the keywords lower_ratio, upper_ratio, tie and features (as in
        ``inference.interval``): a box narrows every interval and comparison; a tie, or features, adds a row (oee-tied,
        oee-features) with the interval of its own model
    facts : more to keep in the report's ``facts`` (names of files, how the simulator was changed)

    Returns
    -------
    Report
        Estimates with their intervals, in the order policy, estimator; warnings in plain language; how sure it all is. Values
        that the log corrects stand inside the likelihood interval, or, where that is not computed, beside the estimator's own;
        ``diagnostics["interval_method"]`` says which.

    Raises
    ------
    ValueError
        Bad arguments, and what the estimators that were asked for raise.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> pair = oee.testing.case("ragged")
    >>> report = evaluate(pair.problem(1000, seed=0), {"new": pair.policy}, estimators=["simulator", "wpdis"], seed=0)
    >>> report.table[["policy", "estimator", "value"]].round(2).values.tolist()
    [['new', 'simulator', 7.97], ['new', 'wpdis', 10.57]]
    >>> report.sureness.sentences[0].split(":")[0]
    'The target differs from the simulator'
    """
    _checks.boolean(normalized, "normalized")
    _checks.boolean(guaranteed, "guaranteed")
    if _checks.boolean(quick, "quick") and guaranteed:
        raise ValueError("guaranteed must be False where quick is True: it leaves intervals out")
    _checks.instance(problem, Problem, "problem", "Problem(simulator, log, ...)")
    if target is not None:
        _checks.instance(target, FiniteMDP, "target")
    if facts is not None:
        _checks.instance(facts, Mapping, "facts")
    if target is not None and target.transitions.shape != problem.simulator.transitions.shape:
        raise ValueError(
            f"target must have the simulator's {problem.simulator.n_states} states and {problem.simulator.n_actions} actions; "
            f"it has {target.n_states} and {target.n_actions}"
        )
    level = _checks.number_in(confidence, "confidence", 0.0, 1.0, open_ends=True)
    if normalized and problem.simulator.discount == 1.0:
        raise ValueError("normalized must be False at discount 1: the factor (1 - discount) would be 0")
    named_policies = check_policies(policies, problem.simulator, name="policy")
    if not named_policies:
        raise ValueError("policies must hold at least one; it is empty")
    assumptions = Assumptions(**assumed)
    own = assumptions.estimators()
    chosen, left_out = _chosen(problem, estimators, target)
    chosen |= own
    truth = {}
    if target is not None:
        truth = {name: policy_value(target, pi, horizon=problem.horizon) for name, pi in named_policies.items()}
    scale = 1.0 - problem.simulator.discount if normalized else 1.0
    with _progress.show_steps(only_terminal=True):
        raw = _estimated(problem, named_policies, chosen, seed)
        if estimators is None:
            raw, lost = _weighted(raw)
            left_out += lost
        sure = how_sure(
            problem, named_policies, level, guaranteed=guaranteed, quick=quick, scale=scale, assumed=assumptions
        )
    results = []
    made_from_log = {name for name, policy in named_policies.items() if is_best_in_log(problem, policy)}
    for result in raw:
        if result.policy in made_from_log and result.estimate.is_from_log and result.estimate.status == "ok":
            warned = replace(result.estimate, findings=(MADE_FROM_LOG, *result.estimate.findings))
            result = replace(result, estimate=warned)
        key = SHARED if result.estimator in own else LIKELIHOOD
        likelihood = sure.intervals.get(result.policy, {}).get(key)
        results.append(replace(result, estimate=quoted(result.estimate, likelihood, level, scale)))
    sure = _told(sure, results, problem, named_policies, chosen, scale)
    warnings, notes = _noted(problem, results, left_out)
    known = {"simulator": repr(problem.simulator), "log": problem.log.describe(), "rewards": problem.rewards}
    known |= {"target": str(assumptions)} if str(assumptions) else {}
    known |= facts or {}
    return Report(
        tuple(results),
        truth,
        warnings,
        notes,
        level,
        normalized,
        problem.simulator.discount,
        problem.horizon,
        seed,
        known,
        sure,
        problem,
        named_policies,
    )  # fmt: skip


def is_best_in_log(problem: Problem, policy: Array) -> bool:
    """Whether the policy is optimal in the log's own model, without a horizon, and not in the simulator.

    The log's own model has its frequencies, and the simulator's rows where there are none.
    """
    if problem.simulator.discount == 1.0:
        return False
    evidence = gather(problem, policy)
    return _is_optimal(evidence.fitted, policy) and not _is_optimal(problem.model, policy)


def _is_optimal(model: Model, policy: Array) -> bool:
    """Whether no action is better than the policy's own in any state that it reaches."""
    values = action_values(model, policy)
    lost = values.max(axis=1) - (policy * values).sum(axis=1)
    reached = occupancy(model, policy).sum(axis=1) > 0
    return bool(lost[reached].max() <= 1e-9 * max(1.0, float(np.abs(values).max())))


def _weighted(raw: Sequence[Result]) -> tuple[list[Result], list[str]]:
    """Without importance sampling that has no positive weight, and a sentence about that."""
    kept = [result for result in raw if WEIGHTLESS not in result.estimate.findings]
    lost = [result for result in raw if WEIGHTLESS in result.estimate.findings]
    if not lost:
        return kept, []
    names = ", ".join(dict.fromkeys(result.policy for result in lost))
    return kept, [f"Importance sampling is left out ({names}): {lost[0].estimate.status}."]


def _estimated(
    problem: Problem, policies: Mapping[str, Any], chosen: Mapping[str, Estimator], seed: Any
) -> list[Result]:
    raw = []
    for i, policy in enumerate(policies):
        for j, estimator in enumerate(chosen):
            _progress.report_step(f"{estimator} of “{policy}” (policy {i + 1} of {len(policies)})")
            stream = _checks.seed_sequence(seed, (i, j))
            found = chosen[estimator](problem, policies[policy], seed=stream)
            _checks.instance(found, Estimate, f"what estimator {estimator!r} returns", "Estimate, Estimate(value)")
            raw.append(Result(policy, estimator, found))
    return raw


def _told(
    sure: Sureness,
    results: Sequence[Result],
    problem: Problem,
    policies: Mapping[str, Array],
    chosen: Mapping[str, Estimator],
    scale: float,
) -> Sureness:
    """With how each policy's value moves from simulator to log, and whether the log tells which policy is worth most."""
    about, values = {}, {}
    known = next((name for name, estimator in chosen.items() if type(estimator) is Simulator), None)
    for name, policy in policies.items():
        own = [result for result in results if result.policy == name]
        values[name] = headline(own).estimate.value
        by_name = {result.estimator: result.estimate for result in own}
        simulator = Simulator()(problem, policy) if known is None else by_name[known]
        about[name] = " ".join(filter(None, (sure.policies.get(name), way(by_name, simulator.value, scale))))
    return ranked(replace(sure, policies=about), values, scale)


def _noted(
    problem: Problem, results: Sequence[Result], left_out: Sequence[str]
) -> tuple[tuple[str, ...], dict[tuple[str, str], tuple[int, ...]]]:
    """Every sentence to be read before use, and of each (policy, estimator) the numbers of those that concern it."""
    general = [*left_out, *(str(finding) for finding in problem.findings)]
    on_models = tuple(k for k, f in enumerate(problem.findings, start=1 + len(left_out)) if f.severity > 0)
    told = sentences([(r.policy, r.estimator, finding) for r in results for finding in r.estimate.findings])
    notes = {
        (r.policy, r.estimator): (() if r.estimate.is_from_episodes else on_models)
        + tuple(k for k, (_, pairs) in enumerate(told, start=1 + len(general)) if (r.policy, r.estimator) in pairs)
        for r in results
    }
    return (*general, *(sentence for sentence, _ in told)), notes


def _chosen(
    problem: Problem, estimators: Sequence[str | Estimator] | Mapping[str, Estimator] | None, target: FiniteMDP | None
) -> tuple[dict[str, Estimator], list[str]]:
    if estimators is None:
        names, left_out = default_names(problem)
        return named_estimators(names, target), left_out
    if isinstance(estimators, Mapping):
        for name, estimator in estimators.items():
            _checks.function(estimator, f"estimators[{name!r}]")
        if not estimators:
            raise ValueError("estimators must hold at least one; it is empty")
        return dict(estimators), []
    found: dict[str, Estimator] = {}
    every = (
        (estimators,)
        if isinstance(estimators, str)
        else _checks.collection(estimators, "estimators", "names or estimators")
    )
    for item in every:
        if isinstance(item, str):
            found |= named_estimators([item], target)
        elif callable(item):
            label = type(item).__name__
            while label in found:
                label += "'"
            found[label] = item
        else:
            raise ValueError(f"estimators must be names or callables; got {_checks.show(item)}")
    if not found:
        raise ValueError("estimators must name at least one; it is empty")
    return found, []
