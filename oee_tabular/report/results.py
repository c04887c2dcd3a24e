"""Results of an evaluation: ``Report`` and ``Result``, and their views and files."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oee_tabular import __version__, _checks, _files
from oee_tabular._results import checked
from oee_tabular.data import TransitionCounts
from oee_tabular.estimators import Estimate, Problem
from oee_tabular.estimators.findings import MAX_UNREAD_SHARE
from oee_tabular.estimators.rewards import reward_effect
from oee_tabular.exceptions import ArgumentError
from oee_tabular.inference import Interval
from oee_tabular.inference.trials import METHOD as JOINED
from oee_tabular.plots import draw_or_warn, figure_files, plot_values
from oee_tabular.report import tables, text
from oee_tabular.report.files import check_output, check_page, plain, write_report
from oee_tabular.report.text import Answer
from oee_tabular.report.uncertainty import LIKELIHOOD, OWN, Uncertainty
from oee_tabular.typing import Array, SeedNumbers

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

# of half an interval: rewards of the log that change a value by less are not named first
NEGLIGIBLE_SHARE = 0.05
# columns of the report's own that (1 - discount) multiplies; diagnostics know theirs
VALUES = {
    "value",
    "standard_error",
    "lower",
    "upper",
    "sampling_lower",
    "sampling_upper",
    "worst_case_lower",
    "worst_case_upper",
    "less_by",
    "less_by_lower",
    "less_by_upper",
    "mean",
    "trials_lower",
    "trials_upper",
    "log_lower",
    "log_upper",
    "true_value",
    "error",
}


@checked()
@dataclass(frozen=True)
class Result:
    """Hold one estimate of one policy with its name.

    Attributes
    ----------
    policy : str
        The name of the policy in the report.
    estimator : str
        The name of the estimator in the report.
    estimate : Estimate
        The value, a discounted sum of rewards. It is never multiplied by (1 -
        discount).

    Examples
    --------
    >>> Result("expert", "oee", Estimate(1.25, 0.5))
    Result(policy='expert', estimator='oee', estimate=Estimate(1.25 ± 0.5 (standard error)))
    """

    policy: str
    estimator: str
    estimate: Estimate


def first_results(results: Sequence[Result]) -> dict[str, Result]:
    """Choose the result of each policy that a report states first.

    A finite value goes before none, a value that the log corrects before others, and
    the simulator's value comes last.
    """

    def order(result: Result) -> tuple[bool, bool, bool, bool]:
        """Return a key that puts the result to be stated first before all others."""
        found = result.estimate
        return (
            not math.isfinite(found.value),
            not found.is_headline,
            found.model_value is None,
            not found.is_from_log,
        )

    names = dict.fromkeys(result.policy for result in results)
    return {
        name: min((result for result in results if result.policy == name), key=order)
        for name in names
    }


@checked(levels=("confidence",))
@dataclass(frozen=True)
class Report:
    """Hold the result of ``oee.evaluate``; ``print(report)`` begins with the answer.

    Values are shown in the report's unit: discounted sums of rewards, multiplied by (1
    - discount) if ``normalized``.

    Attributes
    ----------
    results : tuple of Result
        One entry for each policy and estimator. Their estimates are discounted sums,
        never multiplied by (1 - discount).
    truth : dict of str to float
        The exact value of each policy in the target, a discounted sum; empty where the
        target is not known.
    warnings : tuple of str
        What limits the values, in plain language.
    notes : dict of (policy, estimator) to tuple of int
        The numbers of the warnings that concern a result, counted from 1.
    confidence : float
        The level of the intervals, in (0, 1).
    normalized : bool
        Whether tables, pictures and files multiply values by (1 - discount).
    discount : float
        The discount of the simulator, in [0, 1].
    horizon : int or None
        The number of rewards; None for the infinite discounted sum.
    seed : Seed
        The seed that ``evaluate`` was given.
    facts : dict of str to value
        Descriptions of the simulator, the log and the rewards, and what the caller
        added.
    uncertainty : Uncertainty
        The intervals of each policy, the comparison of the policies, and their
        sentences.
    problem : Problem or None
        What was evaluated, for the pictures of ``to_html``.
    policies : dict of str to ndarray of shape (S, A)
        The policies that were evaluated, as probabilities.
    hidden : frozenset of (policy, estimator)
        The results that a short table leaves out: importance sampling that rests on a
        few episodes.

    See Also
    --------
    evaluate : Evaluate policies by several estimators.
    contest : Compare policies on one log.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> pair = oee.testing.case("ragged")
    >>> report = oee.evaluate(
    ...     pair.problem(1000, seed=0),
    ...     pair.policy,
    ...     estimators=["pdis"],
    ...     target=pair.target,
    ...     seed=0,
    ... )
    >>> [
    ...     (row["estimator"], round(row["value"], 2), round(row["error"], 2))
    ...     for row in report.records()
    ... ]
    [('pdis', 10.51, 0.44)]
    """

    results: tuple[Result, ...]
    truth: Mapping[str, float]
    warnings: tuple[str, ...]
    notes: Mapping[tuple[str, str], tuple[int, ...]]
    confidence: float
    normalized: bool
    discount: float
    horizon: int | None
    seed: SeedNumbers
    facts: Mapping[str, Any]
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    problem: Problem | None = field(default=None, repr=False, compare=False)
    policies: Mapping[str, Array] = field(
        default_factory=dict, repr=False, compare=False
    )
    hidden: frozenset[tuple[str, str]] = frozenset()

    @property
    def unit(self) -> str:
        """Return what a value is, as a formula."""
        span = "t >= 0" if self.horizon is None else f"t = 0..{self.horizon - 1}"
        factor = "(1 - discount) * " if self.normalized else ""
        return (
            f"{factor}sum of discount^t * reward over {span}, discount"
            f" {self.discount:g}"
        )

    @property
    def meaning(self) -> str:
        """Return what a value is, in words."""
        factor = f"{1.0 - self.discount:.4g} × " if self.normalized else ""
        discounted = ""
        end = ""
        if self.discount != 1.0:
            discounted = "discounted "
            end = f" (discount {self.discount:g})"
        span = "the rewards" if self.horizon is None else f"{self.horizon} rewards"
        return f"{factor}the {discounted}sum of {span}{end}"

    @property
    def scale(self) -> float:
        """Return the factor of all values: (1 - discount) if normalized, else 1."""
        return 1.0 - self.discount if self.normalized else 1.0

    @property
    def answers(self) -> list[Answer]:
        """Return what there is to say of each policy, in the order of the results.

        The value is the one that the log corrects, where there is one, with its
        interval.
        """
        answers = []
        for policy, first in first_results(self.results).items():
            row = self._record(first)
            simulator = self._record_of_simulator(policy)
            likelihood = self.uncertainty.intervals.get(policy, {}).get(LIKELIHOOD)
            unrecorded = 0
            if likelihood is not None:
                unrecorded = int(likelihood.diagnostics.get("unrecorded_pairs", 0))
            assumption = ""
            is_inner = False
            if row["interval_method"] in (LIKELIHOOD, JOINED):
                assumption = self.uncertainty.assumptions.get(policy, "")
                about = {} if likelihood is None else likelihood.diagnostics
                is_inner = about.get("inner_bounds_of") == "interval"
            answers.append(
                Answer(
                    policy,
                    row["estimator"],
                    row["value"],
                    row["lower"],
                    row["upper"],
                    row["interval_method"],
                    simulator.get("value"),
                    simulator.get("standard_error"),
                    row["true_value"],
                    row.get("coverage"),
                    unrecorded,
                    assumption,
                    is_inner,
                    first.estimate.is_from_log,
                )
            )
        return answers

    def _record_of_simulator(self, policy: str) -> dict[str, Any]:
        """Return the first record of a policy that uses the simulator alone, or {}."""
        for result in self.results:
            if result.policy == policy and not result.estimate.is_from_log:
                return self._record(result)
        return {}

    @property
    def headline(self) -> str:
        """Return the answer in a sentence or two.

        It states the value of a single policy, or which of several policies is worth
        most. A log that contradicts the simulator's rewards, or that covers less than
        half of what a policy does, is named first, and so are rows of the log that
        could not be read where they are more than 1%; rewards that were rounded, or
        change each value by less than a twentieth of half its interval, are not.
        """
        silent = self.uncertainty.unanswered
        answers = [
            answer
            for answer in self.answers
            if math.isfinite(answer.value) and answer.policy not in silent
        ]
        if not answers:
            return self.uncertainty.caveat or text.NO_VALUE
        sentences = [text.policy_worth(answer, self.confidence) for answer in answers]
        if len(self.answers) > 1 and self.uncertainty.ranking:
            sentences = [text.silent_log(answers), self.uncertainty.ranking]
        sentences.insert(0, self.uncertainty.caveat)
        # rewards of the log cannot contradict the log
        conflict = None
        if self.problem is not None and self.problem.rewards != "log":
            conflict = self.problem.reward_conflict
        if conflict is not None and not self._is_conflict_small(answers):
            where = str(conflict)
            where = f"{where[0].upper()}{where[1:]}"
            sentences.insert(0, text.REWARD_CONFLICT.format(where))
        sentences.insert(0, self._lost_rows())
        return " ".join(filter(None, sentences))

    def _lost_rows(self) -> str:
        """Return which part of the log could not be read, empty where it is small."""
        log = self.problem.log if self.problem is not None else None
        if not isinstance(log, TransitionCounts):
            return ""
        lost = log.recording.dropped
        share = lost / max(lost + len(log), 1)
        if share <= MAX_UNREAD_SHARE:
            return ""
        return text.ROWS_LOST.format(rows=lost, all=lost + len(log), share=share)

    def _is_conflict_small(self, answers: Sequence[Answer]) -> bool:
        """Say whether the log's rewards are rounded, or matter to no value."""
        problem = self.problem
        if problem is None or problem.reward_conflict is None:
            return True
        if problem.reward_conflict.is_rounding:
            return True
        for answer in answers:
            known = answer.policy in self.policies
            if answer.lower is None or answer.upper is None or not known:
                return False
            width = 0.5 * (answer.upper - answer.lower)
            effect = reward_effect(problem, self.policies[answer.policy]) * self.scale
            if not abs(effect) <= NEGLIGIBLE_SHARE * width:
                return False
        return True

    @property
    def answer(self) -> str:
        """Return the headline, and for several policies also the value of each.

        Each value comes with its interval and with the simulator's value.

        Examples
        --------
        >>> import oee_tabular as oee
        >>> pair = oee.testing.case("ragged")
        >>> oee.evaluate(
        ...     pair.problem(1000, seed=0), {"new": pair.policy}, seed=0
        ... ).answer.split("about")[0]
        'In the target, the policy “new” is worth '
        """
        answers = [answer for answer in self.answers if math.isfinite(answer.value)]
        if len(self.answers) == 1 or not answers or not self.uncertainty.ranking:
            return self.headline
        place = list(self._ordered_policies).index
        ordered = sorted(answers, key=lambda answer: place(answer.policy))
        values = [text.policy_worth(answer, self.confidence) for answer in ordered]
        return " ".join([self.headline, *values])

    def records(self) -> list[dict[str, Any]]:
        """Return the results as a list of rows, the same as in ``table``.

        Returns
        -------
        list of dict
            One row for each policy and estimator, in the order of ``results``;
            ``table`` lists the keys.
        """
        return [self._record(result) for result in self.results]

    def _record(self, result: Result) -> dict[str, Any]:
        """Return one result as a row, in the report's unit."""
        estimate = result.estimate
        truth = self.truth.get(result.policy)
        method = estimate.diagnostics.get("interval_method", OWN)
        lower, upper = estimate.interval or (None, None)
        likelihood = None
        if method == LIKELIHOOD:
            likelihood = self.uncertainty.likelihood.get(result.policy)
        elif method == JOINED and result.policy in self.uncertainty.trials:
            likelihood = self.uncertainty.trials[result.policy].interval
        row = {
            "policy": result.policy,
            "estimator": result.estimator,
            "value": estimate.value,
            "standard_error": estimate.standard_error,
            "lower": lower,
            "upper": upper,
            **end_columns(likelihood),
            "interval_method": None if lower is None else method,
            "true_value": truth,
            "error": None if truth is None else estimate.value - truth,
            "status": estimate.status,
            "notes": list(self.notes.get((result.policy, result.estimator), ())),
        }
        row = self._in_unit(row)
        # diagnostics stand after the columns, and never replace one of them
        return {**row, **estimate.diagnostics.scaled(self.scale), **row}

    def _in_unit(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """Return a row whose values are multiplied by the report's scale."""
        return {
            key: x * self.scale if key in VALUES and x is not None else x
            for key, x in row.items()
        }

    @property
    def table(self) -> pd.DataFrame:
        """Return the results as a data frame, a row for each policy and estimator.

        Values are in the report's unit (``unit``). The columns:

        - ``policy``: name of the policy.
        - ``estimator``: name of the estimator.
        - ``value``: estimated value, in the report's unit; nan where there is none.
        - ``standard_error``: standard error of the value, in the report's unit, or
          None.
        - ``lower``, ``upper``: ends of the quoted interval, in the report's unit, or
          None.
        - ``sampling_lower``, ``sampling_upper``: ends of the interval if unrecorded
          pairs behave as estimated, in the report's unit; None beside other than
          likelihood intervals.
        - ``worst_case_lower``, ``worst_case_upper``: ends of the interval if unrecorded
          pairs may do anything, likewise.
        - ``interval_method``: name of the interval, or None.
        - ``true_value``: exact value in the target, in the report's unit, where it is
          known.
        - ``error``: value minus true value, in the report's unit, where that is known.
        - ``status``: "ok", or why there is no value.
        - ``notes``: numbers of the warnings that concern the row, from 1.

        The other columns are the diagnostics of the estimators, empty where an
        estimator has none. Among them are:

        - ``coverage``: share of the policy's discounted time in recorded pairs, in [0,
          1].
        - ``effective_sample_size``: number of equally informative transitions or
          episodes.
        - ``largest_weight``: largest ratio that multiplies a reward or a transition.
        - ``row_sum_error``: how far rows of corrected probabilities are from summing to
          1.
        - ``simulator_value``, ``model_value``, ``replaced_value`` and other values: in
          the report's unit.
        """
        import pandas as pd

        return pd.DataFrame(self.records())

    def trials(self) -> list[dict[str, Any]]:
        """Return what trials and log say of each policy that was tried.

        Returns
        -------
        list of dict
            One row for each of these policies; empty without trials. The keys of a row,
            with values in the report's unit:

            - ``policy``: name of the policy.
            - ``value``, ``lower``, ``upper``: the value and the interval by both.
            - ``number``, ``mean``: the number of trials, and their mean outcome.
            - ``trials_lower``, ``trials_upper``: the interval by the trials alone.
            - ``log_lower``, ``log_upper``: the interval by the log alone.
            - ``p_value``: p-value of the test that both are of one target.
            - ``worth``: number of trials alone with as narrow an interval.
            - ``more_trials``, ``more_transitions``: how many more of either halve the
              interval by the bound, or None.
        """
        rows = []
        for policy, both in self.uncertainty.trials.items():
            row = {
                "policy": policy,
                "value": both.value,
                "lower": both.interval.lower,
                "upper": both.interval.upper,
                "number": both.number,
                "mean": both.mean,
                "trials_lower": both.trials[0],
                "trials_upper": both.trials[1],
                "log_lower": both.log.lower,
                "log_upper": both.log.upper,
                "p_value": both.p_value,
                "worth": both.worth,
                "more_trials": both.more_trials,
                "more_transitions": both.more_transitions,
            }
            rows.append(self._in_unit(row))
        return rows

    def comparison(self) -> list[dict[str, Any]]:
        """Compare the policies, best first.

        Returns
        -------
        list of dict
            One row for each policy; empty for a single policy. The keys of a row, with
            values and differences in the report's unit:

            - ``policy``: name of the policy.
            - ``value``: the value by the default, ``OffEnvironment()``, on which the
              comparison rests.
            - ``lower``, ``upper``: ends of its interval, or None.
            - ``sampling_lower``, ``sampling_upper``: ends of the interval if unrecorded
              pairs behave as estimated, or None.
            - ``worst_case_lower``, ``worst_case_upper``: ends of the interval if
              unrecorded pairs may do anything, or None.
            - ``probability_best``: P(best) in [0, 1]; None where the log cannot say.
            - ``unrecorded_share``: share in [0, 1] of the policy's discounted time in
              unrecorded pairs.
            - ``less_by``: best value minus this value; None for the best.
            - ``less_by_lower``, ``less_by_upper``: interval of this difference, or None
              where the log cannot say.

        Notes
        -----
        The intervals of all differences cover together with the report's confidence.
        One that is the difference of two likelihood intervals' ends covers where both
        of these do.
        """
        compared = self.uncertainty.comparison
        decision = self.uncertainty.decision
        if compared is None or decision is None:
            return []
        known = self.uncertainty.likelihood
        best = compared.names[0]
        table = []
        for k, policy in enumerate(compared.names):
            estimate = self.uncertainty.default.get(policy)
            lower, upper = (estimate and estimate.interval) or (None, None)
            row: dict[str, Any] = {
                "policy": policy,
                "value": float(compared.values[k]),
                "lower": lower,
                "upper": upper,
                **end_columns(known.get(policy)),
                "probability_best": decision.probability_best[policy],
                "unrecorded_share": float(compared.unrecorded_share[k]),
                "less_by": None,
                "less_by_lower": None,
                "less_by_upper": None,
            }
            if k > 0:
                less = float(compared.differences[0, k])
                ends = compared.bounds(best, policy, known)
                row["less_by"] = less
                if math.isfinite(ends[0]):
                    row["less_by_lower"] = min(ends[0], less)
                    row["less_by_upper"] = max(ends[1], less)
            table.append(self._in_unit(row))
        return table

    @property
    def _ordered_policies(self) -> tuple[str, ...]:
        """Return the names of the policies, best first where they are compared."""
        compared = self.uncertainty.comparison
        if compared is not None:
            return compared.names
        return tuple(first_results(self.results))

    @property
    def best(self) -> str | None:
        """Return the name of the policy that is worth most.

        The name is a str. It is None if there is only one policy, if the log cannot say
        which is best, or if several are worth the same.
        """
        decision = self.uncertainty.decision
        return None if decision is None else decision.best

    def __repr__(self) -> str:
        return self.to_text()

    def to_text(self, *, all: bool = False, verbose: bool = False) -> str:
        """Write the report as text for a terminal of 100 columns.

        Parameters
        ----------
        all : bool, default False
            Whether to show the rows that a short report leaves out: importance sampling
            that rests on a few episodes.
        verbose : bool, default False
            Whether to show every note, and columns of diagnostics.

        Returns
        -------
        str
            The answer, the tables, what the intervals assume, and the notes.
        """
        return tables.render(
            self,
            all=_checks.boolean(all, "all"),
            verbose=_checks.boolean(verbose, "verbose"),
        )

    def rows(self, *, all: bool = False) -> list[dict[str, Any]]:
        """Return the records that stand in the table.

        Parameters
        ----------
        all : bool, default False
            Whether to include the rows that a short report leaves out.

        Returns
        -------
        list of dict
            Some or all of ``records()``.
        """
        shows_all = _checks.boolean(all, "all")
        return [
            row
            for row in self.records()
            if shows_all or (row["policy"], row["estimator"]) not in self.hidden
        ]

    def legend(self, rows: Sequence[Mapping[str, Any]]) -> list[str]:
        """Explain the intervals of the table, one sentence for each method.

        Parameters
        ----------
        rows : sequence of dict
            Some of ``records()``.

        Returns
        -------
        list of str
            A sentence for each method, with the estimators whose interval it is.

        Raises
        ------
        ValueError
            If ``rows`` are not records of a report.
        """
        members: dict[str, dict[str, None]] = {}
        needed = {"interval_method", "estimator"}
        for row in _checks.collection(rows, "rows", "a Report's records()"):
            if not isinstance(row, Mapping) or not row.keys() >= needed:
                raise ArgumentError(
                    "rows", f"must be a Report's records(); one is {_checks.show(row)}"
                )
            if row["interval_method"] is not None:
                estimators = members.setdefault(str(row["interval_method"]), {})
                estimators[str(row["estimator"])] = None
        return [
            text.legend(method, list(names), self.confidence)
            for method, names in members.items()
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values, as in report.json.

        Returns
        -------
        dict
            Numbers, texts, lists and dicts; nan and infinities become None. ``results``
            are the rows of ``table``, ``intervals`` all intervals by policy and method,
            and ``comparison`` the rows of ``comparison()``, in the report's unit.
        """
        found = {
            "version": __version__,
            "answer": self.answer,
            "unit": self.unit,
            "discount": self.discount,
            "horizon": self.horizon,
            "normalized": self.normalized,
            "confidence": self.confidence,
            "interval": self.legend(self.records()),
            "seed": self.seed if isinstance(self.seed, int) else None,
            "facts": dict(self.facts),
            "results": self.records(),
            "intervals": [
                self._in_unit(
                    {"policy": policy, "method": method, **interval_columns(found)}
                )
                for policy, methods in self.uncertainty.intervals.items()
                for method, found in methods.items()
            ],
            "best": self.best,
            "comparison": self.comparison(),
            "trials": self.trials(),
            "conclusion": list(self.uncertainty.sentences),
            "warnings": list(self.warnings),
        }
        return {key: plain(value) for key, value in found.items()}

    def to_json(self) -> str:
        """Return ``to_dict`` as JSON.

        Returns
        -------
        str
            The text of report.json, indented by two spaces.
        """
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)

    def plot(self, ax: Axes | None = None, *, all: bool = False) -> Axes:
        """Draw the values with their intervals (``plots.plot_values``).

        Parameters
        ----------
        ax : matplotlib Axes, optional
            The axes to draw on. None makes new ones.
        all : bool, default False
            Whether to draw the rows that a short report leaves out.

        Returns
        -------
        matplotlib Axes
            The axes with the picture.
        """
        rows = self.rows(all=all)
        has_value = any(math.isfinite(row["value"]) for row in rows)
        # lines that all say "no value" need limits
        limits = None if has_value else (0.0, 1.0)
        return plot_values(
            rows, ax, title=self.headline, unit=self.meaning, limits=limits
        )

    def save(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write report.json, table.csv and a picture of the values: all or none.

        The picture is values.png, values.pdf and values.svg; inside ``plots.slides()``
        it is a slide. Files of these names are replaced. report.json is ``to_dict`` with one field
        more: ``files``, the SHA-256 of each file by its name (its own is that of the
        JSON without it).

        Parameters
        ----------
        folder : str or path
            Where the files are written; the folder is made.

        Returns
        -------
        list of Path
            The paths of the files.

        Raises
        ------
        ValueError
            If the folder cannot be written.
        """
        check_output(folder, "folder")
        height = 1.8 + 0.27 * (len(self.rows()) + len(self.answers))  # inches
        contents = {
            "table.csv": _files.csv_bytes(self.table),
        }
        pictures = draw_or_warn(
            "values.png", lambda: figure_files(self.plot, "values", size=(7.2, height))
        )
        # without them, the pictures of another report are removed
        contents |= pictures or {}
        return write_report(Path(folder), self.to_dict(), contents)

    def to_html(
        self,
        path: str | os.PathLike[str] | None = None,
        *,
        title: str | None = None,
        grid: tuple[int, int] | None = None,
    ) -> str:
        """Write the report as one self-contained page, for people who did not run it.

        Parameters
        ----------
        path : str or path, optional
            The .html or .htm file to write. Its folder is made, and the file appears
            whole or not at all. None writes no file.
        title : str, optional
            The title of the page. None names the policies.
        grid : (int, int), optional
            The (rows, columns) of a task whose states are cells, numbered row * columns
            + column. None takes the simulator's layout, or a map from its transitions
            (``plots.map_of``). Other tasks get a picture of the states where a policy
            spends its time.

        Returns
        -------
        str
            The text of the page. The same input and seed give the same text.

        Raises
        ------
        ValueError
            If the path cannot be written, or the grid has not as many cells as there
            are states.

        Examples
        --------
        >>> import oee_tabular as oee
        >>> simulator, target = (
        ...     oee.tasks.gridworld(3, slip=0.3),
        ...     oee.tasks.gridworld(3, slip=0.1),
        ... )
        >>> log = oee.sample_episodes(
        ...     target, oee.uniform_policy(target), 20, horizon=30, seed=0
        ... )
        >>> page = oee.evaluate(
        ...     oee.Problem(simulator, log), oee.tasks.gridworld_expert(3), seed=0
        ... ).to_html()
        >>> page[:15], "Where simulator and target differ most" in page
        ('<!doctype html>', True)
        """
        from oee_tabular.report.page import render

        if title is not None:
            _checks.instance(title, str, "title", "string")
        file = None if path is None else check_page(path)
        page = render(self, title=title, grid=grid)
        if file is not None:
            _files.write_all(file.parent, {file.name: _files.text_bytes(page)})
        return page

    def _repr_html_(self) -> str:
        return tables.render_html(self)


def interval_columns(interval: Interval) -> dict[str, Any]:
    """Return an interval as columns of a table."""
    return {
        "lower": interval.lower,
        "upper": interval.upper,
        **end_columns(interval),
        "confidence": interval.confidence,
        "status": interval.status,
    }


def end_columns(interval: Interval | None) -> dict[str, float | None]:
    """Return the intervals at both ends of the factor of unrecorded pairs, as columns.

    They are None where there is no such interval.
    """
    sampling: tuple[float | None, float | None] = (None, None)
    anything: tuple[float | None, float | None] = (None, None)
    if interval is not None:
        sampling = interval.sampling or sampling
        anything = interval.worst_case or anything
    return {
        "sampling_lower": sampling[0],
        "sampling_upper": sampling[1],
        "worst_case_lower": anything[0],
        "worst_case_upper": anything[1],
    }
