"""What an evaluation found: as text, as rows, as JSON and as files."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oee_tabular import __version__, _checks, _files
from oee_tabular.estimators import Estimate, Problem
from oee_tabular.estimators.base import IN_VALUES_UNIT
from oee_tabular.exceptions import ArgumentError
from oee_tabular.inference import Interval
from oee_tabular.plots import figure_png, plot_values
from oee_tabular.report import tables, text
from oee_tabular.report.files import check_output, check_page, plain
from oee_tabular.report.text import Answer
from oee_tabular.report.uncertainty import LIKELIHOOD, OWN, Uncertainty, descending_key
from oee_tabular.typing import Array

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

VALUES = IN_VALUES_UNIT | {  # columns that (1 - discount) multiplies
    "value",
    "standard_error",
    "lower",
    "upper",
    "sampling_lower",
    "sampling_upper",
    "true_value",
    "error",
}


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


def first_results(results: Sequence[Result]) -> dict[str, Result]:
    """Of each policy the one to say first: a finite value, corrected by the log where
    there is one, the simulator's last.
    """

    def order(result: Result) -> tuple[bool, bool, bool, bool]:
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


@dataclass(frozen=True)
class Report:
    """What ``oee evaluate`` prints and draws; ``print(report)`` begins with the answer.

    Attributes
    ----------
    results : one entry per policy and estimator; estimates are raw discounted sums
    truth : exact value of each policy in the target, where the target is known
    warnings : about the values, in plain language
    notes : for each (policy, estimator), the numbers (from 1) of the warnings that
        concern it
    confidence : of the intervals
    normalized : whether table, picture and JSON multiply values by (1 - discount)
    discount, horizon, seed, facts : how it was computed
    uncertainty : intervals of each policy, the comparison of the policies, and their
        sentences
    problem, policies : what was evaluated, for the pictures of ``to_html``
    hidden : the (policy, estimator) whose rows a short table leaves out: importance
        sampling that rests on a few episodes

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
    policies: Mapping[str, Array] = field(
        default_factory=dict, repr=False, compare=False
    )
    hidden: frozenset[tuple[str, str]] = frozenset()

    @property
    def unit(self) -> str:
        """What a value is, as a formula."""
        span = "t >= 0" if self.horizon is None else f"t = 0..{self.horizon - 1}"
        factor = "(1 - discount) * " if self.normalized else ""
        return (
            f"{factor}sum of discount^t * reward over {span}, discount"
            f" {self.discount:g}"
        )

    @property
    def meaning(self) -> str:
        """What a value is, in words."""
        factor = f"{1.0 - self.discount:.4g} × " if self.normalized else ""
        discounted, end = (
            ("", "")
            if self.discount == 1.0
            else ("discounted ", f" (discount {self.discount:g})")
        )
        span = "the rewards" if self.horizon is None else f"{self.horizon} rewards"
        return f"{factor}the {discounted}sum of {span}{end}"

    @property
    def scale(self) -> float:
        """(1 - discount) if normalized, else 1."""
        return 1.0 - self.discount if self.normalized else 1.0

    @property
    def answers(self) -> list[Answer]:
        """What there is to say of each policy: the value that the log corrects, where
        there is one, with its interval.
        """
        answers = []
        for policy, first in first_results(self.results).items():
            row = self._record(first)
            alone = (
                r
                for r in self.results
                if r.policy == policy and not r.estimate.is_from_log
            )
            simulator = next(map(self._record, alone), {})
            likelihood = self.uncertainty.intervals.get(policy, {}).get(LIKELIHOOD)
            unrecorded = (
                0
                if likelihood is None
                else int(likelihood.diagnostics.get("unrecorded_pairs", 0))
            )
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
                    first.estimate.is_from_log,
                )
            )
        return answers

    @property
    def headline(self) -> str:
        """The answer in a sentence or two: the policy's value, or which of several
        policies is worth most.

        It first names a log that contradicts the simulator's rewards or covers less
        than half of what a policy does.
        """
        answers = [answer for answer in self.answers if math.isfinite(answer.value)]
        if not answers:
            return text.NO_VALUE
        sentences = [text.policy_worth(answer, self.confidence) for answer in answers]
        if len(self.answers) > 1 and self.uncertainty.ranking:
            sentences = [text.silent_log(answers), self.uncertainty.ranking]
        sentences.insert(0, self.uncertainty.caveat)
        conflict = (
            None
            if self.problem is None or self.problem.rewards == "log"
            else self.problem.reward_conflict
        )
        if conflict is not None:
            where = str(conflict)
            sentences.insert(
                0, text.REWARD_CONFLICT.format(f"{where[0].upper()}{where[1:]}")
            )
        return " ".join(filter(None, sentences))

    @property
    def answer(self) -> str:
        """The headline; of several policies also the value of each, with its interval,
        beside the simulator's.

        >>> import oee_tabular as oee
        >>> pair = oee.testing.case("ragged")
        >>> oee.evaluate(pair.problem(1000, seed=0), {"new": pair.policy}, seed=0).answer.split("about")[0]
        'In the target, the policy “new” is worth '
        """
        answers = [answer for answer in self.answers if math.isfinite(answer.value)]
        if len(self.answers) == 1 or not answers or not self.uncertainty.ranking:
            return self.headline
        ordered = sorted(answers, key=lambda answer: descending_key(answer.value))
        return " ".join(
            [
                self.headline,
                *(text.policy_worth(answer, self.confidence) for answer in ordered),
            ]
        )

    def records(self) -> list[dict[str, Any]]:
        """The results as plain rows, in the report's unit (diagnostics that are values
        as well).
        """
        return [self._record(result) for result in self.results]

    def _record(self, result: Result) -> dict[str, Any]:
        estimate = result.estimate
        truth = self.truth.get(result.policy)
        method = estimate.diagnostics.get("interval_method", OWN)
        lower, upper = estimate.interval or (None, None)
        row = {
            "policy": result.policy,
            "estimator": result.estimator,
            "value": estimate.value,
            "standard_error": estimate.standard_error,
            "lower": lower,
            "upper": upper,
            **sampling_columns(
                self.uncertainty.likelihood.get(result.policy)
                if method == LIKELIHOOD
                else None
            ),
            "interval_method": None if lower is None else method,
            "true_value": truth,
            "error": None if truth is None else estimate.value - truth,
            "status": estimate.status,
            "notes": list(self.notes.get((result.policy, result.estimator), ())),
        }
        return self._in_unit(row | estimate.diagnostics | row)

    def _in_unit(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """A row whose values are in the report's unit."""
        return {
            key: x * self.scale if key in VALUES and x is not None else x
            for key, x in row.items()
        }

    @property
    def table(self) -> pd.DataFrame:
        """One row per policy and estimator, every diagnostic a column."""
        import pandas as pd

        return pd.DataFrame(self.records())

    def comparison(self) -> list[dict[str, Any]]:
        """A row each policy, best first: its value and interval, P(best), and by how
        much it is worth less than the best.

        P(best), and the ends of a difference, are None where the log cannot say. The
        intervals of all differences cover together; one that is the difference of two
        likelihood intervals' ends covers where both of these do.
        [] of a single policy.
        """
        compared = self.uncertainty.comparison
        decision = self.uncertainty.decision
        if compared is None or decision is None:
            return []
        table = []
        known = self.uncertainty.likelihood
        rows = [self._record(result) for result in first_results(self.results).values()]
        best, *_ = rows = sorted(rows, key=lambda row: descending_key(row["value"]))
        for row in rows:
            policy = row["policy"]
            less = best["value"] - row["value"]
            lower, upper = (
                self.scale * end
                for end in compared.bounds(best["policy"], policy, known)
            )
            has_ends = row is not best and math.isfinite(lower)
            table.append(
                {key: row[key] for key in ("policy", "value", "lower", "upper")}
                | self._in_unit(sampling_columns(known.get(policy)))
                | {
                    "probability_best": decision.probability_best[policy],
                    "unrecorded_share": float(
                        compared.unrecorded_share[compared.names.index(policy)]
                    ),
                    "less_by": None if row is best else less,
                    "less_by_lower": min(lower, less) if has_ends else None,
                    "less_by_upper": max(upper, less) if has_ends else None,
                }
            )
        return table

    @property
    def best(self) -> str | None:
        """The policy that is worth most; None where the log cannot say, or several are
        worth the same.
        """
        return (
            None
            if self.uncertainty.decision is None
            else self.uncertainty.decision.best
        )

    def __repr__(self) -> str:
        return self.to_text()

    def to_text(self, *, all: bool = False, verbose: bool = False) -> str:
        """The report as text for a terminal of 100 columns.

        Parameters
        ----------
        all : whether rows stand there that a short report leaves out (importance
            sampling that rests on a few episodes)
        verbose : whether every note stands there, and the table has columns of
            diagnostics
        """
        return tables.render(
            self,
            all=_checks.boolean(all, "all"),
            verbose=_checks.boolean(verbose, "verbose"),
        )

    def rows(self, *, all: bool = False) -> list[dict[str, Any]]:
        """The records that stand in the table: ``all``, or those of a short report."""
        shows_all = _checks.boolean(all, "all")
        return [
            row
            for row in self.records()
            if shows_all or (row["policy"], row["estimator"]) not in self.hidden
        ]

    def legend(self, rows: Sequence[Mapping[str, Any]]) -> list[str]:
        """What the intervals of the table are, for each method; ``rows`` are some of
        ``records()``.
        """
        members: dict[str, dict[str, None]] = {}
        for row in _checks.collection(rows, "rows", "a Report's records()"):
            if not isinstance(row, Mapping) or not row.keys() >= {
                "interval_method",
                "estimator",
            }:
                raise ArgumentError(
                    "rows", f"must be a Report's records(); one is {_checks.show(row)}"
                )
            if row["interval_method"] is not None:
                members.setdefault(str(row["interval_method"]), {})[
                    str(row["estimator"])
                ] = None
        return [
            text.legend(method, list(names), self.confidence)
            for method, names in members.items()
        ]

    def to_dict(self) -> dict[str, Any]:
        """Everything, as plain values (nan and infinities become None)."""
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
            "conclusion": list(self.uncertainty.sentences),
            "warnings": list(self.warnings),
        }
        return {key: plain(value) for key, value in found.items()}

    def to_json(self) -> str:
        """``to_dict`` as JSON."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)

    def plot(self, ax: Axes | None = None, *, all: bool = False) -> Axes:
        """Draw the values with their intervals (``plots.plot_values``); without ``ax``
        on new axes.

        Parameters
        ----------
        ax : matplotlib Axes; None makes them
        all : whether rows stand there that a short report leaves out
        """
        rows = self.rows(all=all)
        # lines that say "no value"
        limits = (
            None if any(math.isfinite(row["value"]) for row in rows) else (0.0, 1.0)
        )
        return plot_values(
            rows, ax, title=self.headline, unit=self.meaning, limits=limits
        )

    def save(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write report.json, table.csv and values.png into ``folder``: all of them or
        none.
        """
        check_output(folder, "folder")
        target = Path(folder)
        contents = {
            "report.json": (self.to_json() + "\n").encode(),
            "table.csv": _files.csv_bytes(self.table),
            "values.png": figure_png(
                self.plot,
                size=(7.2, 1.8 + 0.27 * (len(self.rows()) + len(self.answers))),
            ),
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
        """The report as one self-contained page, for people who did not run it; written
        to ``path`` if one is given.

        Parameters
        ----------
        path : .html or .htm file; its folder is made, the file appears whole or not at
            all
        title : of the page
        grid : (rows, columns) of a task whose states are cells, row * columns + column;
            None: the simulator's layout, or the transitions that it makes
            (``plots.map_of``). Other tasks get a picture of the states where a policy
            spends its time

        Returns
        -------
        The page's text. The same input and seed give the same text.

        Raises
        ------
        ValueError
            A path that cannot be written, a grid that has not as many cells as there
            are states.

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
        return tables.render_html(self)


def interval_columns(interval: Interval) -> dict[str, Any]:
    """An interval as columns of a table."""
    about = {"confidence": interval.confidence, "status": interval.status}
    return (
        {"lower": interval.lower, "upper": interval.upper}
        | sampling_columns(interval)
        | about
    )


def sampling_columns(interval: Interval | None) -> dict[str, float | None]:
    """The interval from the recorded transitions alone, as columns of a table; None
    where there is none.
    """
    lower, upper = (
        (None, None)
        if interval is None or interval.sampling is None
        else interval.sampling
    )
    return {"sampling_lower": lower, "sampling_upper": upper}
