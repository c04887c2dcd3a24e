"""What an evaluation found: as text, as rows, as JSON and as files."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular import __version__, _checks, _files
from oee_tabular._checks import Array
from oee_tabular.estimators import Estimate, Problem
from oee_tabular.estimators.base import IN_VALUES_UNIT
from oee_tabular.inference import Interval
from oee_tabular.plots import figure_png, plot_values
from oee_tabular.report import terminal, text
from oee_tabular.report.files import check_output, check_page
from oee_tabular.report.interval_choice import OWN
from oee_tabular.report.text import Answer
from oee_tabular.report.uncertainty import LIKELIHOOD, Uncertainty, sampling_columns

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Result:
    """One estimate of one policy.

    Attributes
    ----------
    policy, estimator : their names in the report
    estimate : Estimate, a discounted sum (never multiplied by 1 - discount)

    Examples
    --------
    >>> Result("expert", "oee", Estimate(1.25, 0.5))
    Result(policy='expert', estimator='oee', estimate=Estimate(1.25 ± 0.5 (standard error)))
    """

    policy: str
    estimator: str
    estimate: Estimate


def headline(results: Sequence[Result]) -> Result:
    """Of one policy's, the one to say first: a finite value, corrected by the log where there is one, the simulator's last."""

    def order(result: Result) -> tuple[bool, bool, bool, bool]:
        found = result.estimate
        return not math.isfinite(found.value), not found.is_headline, found.model_value is None, not found.is_from_log

    return min(results, key=order)


@dataclass(frozen=True)
class Report:
    """What ``oee evaluate`` prints and draws; ``print(report)`` begins with the answer.

    Attributes
    ----------
    results : one entry per policy and estimator; estimates are raw discounted sums
    truth : exact value of each policy in the target, where the target is known
    warnings : what the numbers do not tell, in plain language
    notes : for each (policy, estimator), the numbers (from 1) of the warnings that concern it
    confidence : of the intervals
    normalized : whether table, picture and JSON multiply values by (1 - discount)
    discount, horizon, seed, facts : how it was computed
    uncertainty : intervals of each policy, the comparison of the policies, and their sentences
    problem, policies : what was evaluated, for the pictures of ``to_html``
    hidden : the (policy, estimator) whose rows a short table leaves out: importance sampling that rests on a few episodes

    Examples
    --------
    >>> import oee_tabular as oee
    >>> pair = oee.testing.case("ragged")
    >>> report = oee.evaluate(pair.problem(1000, seed=0), pair.policy, estimators=["pdis"], target=pair.target, seed=0)
    >>> [(row["estimator"], round(row["value"], 2), round(row["error"], 2)) for row in report.records()]
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
    seed: Any
    facts: Mapping[str, Any]
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    problem: Problem | None = field(default=None, repr=False, compare=False)
    policies: Mapping[str, Array] = field(default_factory=dict, repr=False, compare=False)
    hidden: frozenset[tuple[str, str]] = frozenset()

    @property
    def unit(self) -> str:
        """What a value is, as a formula."""
        span = "t >= 0" if self.horizon is None else f"t = 0..{self.horizon - 1}"
        factor = "(1 - discount) * " if self.normalized else ""
        return f"{factor}sum of discount^t * reward over {span}, discount {self.discount:g}"

    @property
    def meaning(self) -> str:
        """What a value is, in words without formulas."""
        factor = "" if not self.normalized else f", times {1.0 - self.discount:.4g}"
        paid = "" if self.discount == 1.0 else f", each step counting {self.discount:g} times the one before"
        span = "" if self.horizon is None else f" of {self.horizon} steps"
        return f"the sum of the rewards{span}{paid}{factor}"

    @property
    def scale(self) -> float:
        """(1 - discount) if normalized, else 1."""
        return 1.0 - self.discount if self.normalized else 1.0

    @property
    def answers(self) -> list[Answer]:
        """What there is to say of each policy: the value that the log corrects, where there is one, with its interval."""
        answers, rows = [], self.records()
        for policy in dict.fromkeys(result.policy for result in self.results):
            own = [result for result in self.results if result.policy == policy]
            first = headline(own)
            row = rows[self.results.index(first)]
            simulator = next((r.estimate for r in own if not r.estimate.is_from_log), None)
            error = None if simulator is None else simulator.standard_error
            likelihood = self.uncertainty.intervals.get(policy, {}).get(LIKELIHOOD)
            unrecorded = 0 if likelihood is None else int(likelihood.diagnostics.get("unvisited_rows", 0))
            answers.append(
                Answer(
                    policy, row["estimator"], row["value"], row["lower"], row["upper"], row["interval_method"],
                    None if simulator is None else simulator.value * self.scale,
                    None if error is None else error * self.scale,
                    row["true_value"], row.get("coverage"), unrecorded, first.estimate.is_from_log,
                )
            )  # fmt: skip
        return answers

    @property
    def headline(self) -> str:
        """The answer in a sentence or two: the policy's value, or which of several policies is worth most.

        A log that contradicts the simulator's rewards, or covers less than half of what a policy does, is said first.
        """
        answers = [answer for answer in self.answers if math.isfinite(answer.value)]
        if not answers:
            return text.NO_VALUE
        conflict = None if self.problem is None or self.problem.rewards == "log" else self.problem.reward_conflict
        first = "" if conflict is None else text.reward_conflict(str(conflict))
        if len(self.answers) == 1:
            told = text.policy_worth(answers[0], self.confidence)
        else:
            told = " ".join(filter(None, (text.silent_log(answers), self.uncertainty.ranking)))
        return " ".join(filter(None, (first, told)))

    @property
    def answer(self) -> str:
        """The headline; of several policies also the value of each, with its interval, beside the simulator's.

        >>> import oee_tabular as oee
        >>> pair = oee.testing.case("ragged")
        >>> oee.evaluate(pair.problem(1000, seed=0), {"new": pair.policy}, seed=0).answer.split("about")[0]
        'In the target, the policy “new” is worth '
        """
        answers = [answer for answer in self.answers if math.isfinite(answer.value)]
        if len(self.answers) == 1 or not answers:
            return self.headline
        ordered = sorted(answers, key=lambda answer: -answer.value)
        return " ".join([self.headline, *(text.policy_worth(answer, self.confidence) for answer in ordered)])

    def records(self) -> list[dict[str, Any]]:
        """The results as plain rows, in the report's unit (diagnostics that are values as well)."""
        rows = []
        for result in self.results:
            estimate, factor = result.estimate, self.scale
            error, interval = estimate.standard_error, estimate.interval
            truth = self.truth.get(result.policy)
            rows.append(
                {
                    "policy": result.policy,
                    "estimator": result.estimator,
                    "value": estimate.value * factor,
                    "standard_error": None if error is None else error * factor,
                    "lower": None if interval is None else interval[0] * factor,
                    "upper": None if interval is None else interval[1] * factor,
                    **sampling_columns(self._likelihood_interval(result), factor),
                    "interval_method": None if interval is None else estimate.diagnostics.get("interval_method", OWN),
                    "true_value": None if truth is None else truth * factor,
                    "error": None if truth is None else (estimate.value - truth) * factor,
                    "status": estimate.status,
                    "notes": list(self.notes.get((result.policy, result.estimator), ())),
                    **{
                        name: x * factor if name in IN_VALUES_UNIT else x
                        for name, x in estimate.diagnostics.items()
                        if name != "interval_method"
                    },
                }
            )
        return rows

    def _likelihood_interval(self, result: Result) -> Interval | None:
        """The likelihood interval, where the result quotes it."""
        if result.estimate.diagnostics.get("interval_method") != LIKELIHOOD:
            return None
        return self.uncertainty.intervals.get(result.policy, {}).get(LIKELIHOOD)

    @property
    def table(self) -> pd.DataFrame:
        """One row per policy and estimator, every diagnostic a column."""
        import pandas as pd

        return pd.DataFrame(self.records())

    def comparison(self) -> list[dict[str, Any]]:
        """A row each policy, best first: its value and interval, P(best), and by how much it is worth less than the best.

        P(best), and the ends of a difference, are None where the log cannot say. The intervals of all differences cover
        together; one that is the difference of two likelihood intervals' ends covers where both of these do.
        [] of a single policy.
        """
        compared, decision = self.uncertainty.comparison, self.uncertainty.decision
        if compared is None or decision is None:
            return []
        answers = sorted(self.answers, key=lambda answer: -answer.value if math.isfinite(answer.value) else math.inf)
        rows, best, known = [], answers[0].policy, self.uncertainty.likelihood
        for answer in answers:
            less, is_best = answers[0].value - answer.value, answer.policy == best
            lower, upper = (self.scale * end for end in compared.bounds(best, answer.policy, known))
            has_ends = not is_best and math.isfinite(lower)
            rows.append(
                {
                    "policy": answer.policy,
                    "value": answer.value,
                    "lower": answer.lower,
                    "upper": answer.upper,
                    **sampling_columns(self.uncertainty.likelihood.get(answer.policy), self.scale),
                    "probability_best": decision.probability_best[answer.policy],
                    "unseen_share": float(compared.unseen_share[compared.names.index(answer.policy)]),
                    "less_by": None if is_best else less,
                    "less_by_lower": min(lower, less) if has_ends else None,
                    "less_by_upper": max(upper, less) if has_ends else None,
                }
            )
        return rows

    @property
    def best(self) -> str | None:
        """The policy that is worth most; None where the log cannot say, or several are worth the same."""
        return self.uncertainty.best

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        return self.to_text()

    def to_text(self, *, all: bool = False, verbose: bool = False) -> str:
        """The report as text for a terminal of 100 columns.

        Parameters
        ----------
        all : whether rows stand there that a short report leaves out (importance sampling that rests on a few episodes)
        verbose : whether every note stands there, and the table has columns of diagnostics
        """
        return terminal.render(self, all=_checks.boolean(all, "all"), verbose=_checks.boolean(verbose, "verbose"))

    def rows(self, *, all: bool = False) -> list[dict[str, Any]]:
        """The records that stand in the table: ``all``, or those of a short report."""
        shows_all = _checks.boolean(all, "all")
        return [row for row in self.records() if shows_all or (row["policy"], row["estimator"]) not in self.hidden]

    def legend(self, rows: Sequence[Mapping[str, Any]]) -> list[str]:
        """What the column of intervals holds, for each method."""
        members: dict[str, dict[str, None]] = {}
        for row in rows:
            if row["interval_method"] is not None:
                members.setdefault(row["interval_method"], {})[row["estimator"]] = None
        return [text.legend(method, list(names), self.confidence) for method, names in members.items()]

    def to_dict(self) -> dict[str, Any]:
        """Everything, as plain values (nan and infinities become None)."""
        found: dict[str, object] = plain(
            {
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
                "intervals": self.uncertainty.records(self.scale),
                "best": self.best,
                "comparison": self.comparison(),
                "conclusion": list(self.uncertainty.sentences),
                "warnings": list(self.warnings),
            }
        )
        return found

    def to_json(self) -> str:
        """``to_dict`` as JSON."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)

    def plot(self, ax: Axes | None = None, *, all: bool = False) -> Axes:
        """Draw the values with their intervals (``plots.plot_values``); without ``ax`` on new axes.

        Parameters
        ----------
        ax : matplotlib Axes; None makes them
        all : whether rows stand there that a short report leaves out
        """
        rows = self.rows(all=all)
        has_value = any(math.isfinite(row["value"]) for row in rows)
        limits = None if has_value else (0.0, 1.0)  # lines that say "no value"
        return plot_values(rows, ax, title=self.headline, unit=self.meaning, limits=limits)

    def save(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write report.json, table.csv and values.png into ``folder``: all of them or none."""
        check_output(folder, "folder")
        target = Path(folder)
        contents = {
            "report.json": (self.to_json() + "\n").encode(),
            "table.csv": _files.csv_bytes(self.table),
            "values.png": figure_png(self.plot, size=(7.2, 1.8 + 0.27 * (len(self.rows()) + len(self.answers)))),
        }
        _files.write_all(target, contents)
        return [target / name for name in contents]

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
        grid : (rows, columns) of a task whose states are cells, row * columns + column; None: the simulator's layout, or the
            transitions that it makes (``plots.map_of``). Other tasks get a picture of the states where a policy spends its time

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
        page = render(self, title=title, grid=grid)
        if file is not None:
            _files.write_all(file.parent, {file.name: page.encode()})
        return page

    def _repr_html_(self) -> str:
        return terminal.render_html(self)


def plain(value: object) -> Any:
    """Without numpy's types, infinities and nan (None): what JSON holds."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
