"""The result of an evaluation, ``Report``: its content, and its views and files."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oee_tabular import _checks, _files
from oee_tabular._results import checked
from oee_tabular.estimators import Problem
from oee_tabular.exceptions import ArgumentError
from oee_tabular.plots import draw_or_warn, figure_files, plot_values
from oee_tabular.report import tables, text
from oee_tabular.report.content import (
    Content,
    explain_intervals,
    gather_content,
    make_answers,
    make_comparison,
    make_dict,
    make_record,
    make_trials,
    write_headline,
)
from oee_tabular.report.files import check_output, check_page, write_report
from oee_tabular.report.notes import LOG
from oee_tabular.report.rows import Result, first_results
from oee_tabular.report.text import Answer
from oee_tabular.report.uncertainty import Uncertainty
from oee_tabular.typing import Array, SeedNumbers

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes


def add_log_notes(report: Report, notes: Sequence[str]) -> Report:
    """Return a report with what the reader of its log warned of.

    They are its last warnings, which are about no row in particular, and the fact
    ``log_notes``.
    """
    # a continuous task's report has some of them already
    new = [note for note in notes if note not in report.warnings]
    if not new:
        return report
    sentences = [f"While the log was read: {note.removesuffix('.')}." for note in new]
    # warnings beyond the end of ``kinds`` are of no kind
    unnamed = ("",) * (len(report.warnings) - len(report.kinds))
    return replace(
        report,
        warnings=(*report.warnings, *sentences),
        kinds=(*report.kinds, *unnamed, *[LOG] * len(new)),
        facts=dict(report.facts) | {"log_notes": new},
    )


@dataclass(frozen=True)
class Source:
    """What a report without a finite problem was made from.

    Attributes
    ----------
    task : str
        The name of the continuous task.
    n_transitions : int
        The number of transitions of the log.
    """

    task: str
    n_transitions: int


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
    kinds : tuple of str
        The kind of each warning, such as that of its finding, which ranks it among the
        notes. Warnings beyond its end are of no kind.
    source : Source or None
        The task and the size of the log, where there is no ``problem``.

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
    kinds: tuple[str, ...] = ()
    source: Source | None = None

    @cached_property
    def content(self) -> Content:
        """Return what the report says as data, of which every form is a view."""
        return gather_content(self)

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
        return make_answers(self)

    @property
    def headline(self) -> str:
        """Return the answer in a sentence or two.

        It states the value of a single policy, or which of several policies is worth
        most. A log that contradicts the simulator's rewards, or that covers less than
        half of what a policy does, is named first, and so are rows of the log that
        could not be read where they are more than 1%; rewards that were rounded, or
        change each value by less than a twentieth of half its interval, are not.
        """
        return write_headline(self, text.policy_worth)

    @property
    def brief(self) -> str:
        """Return the headline without what the interval assumes, which is a note."""
        return write_headline(self, text.policy_value)

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
        return [make_record(self, result) for result in self.results]

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
              interval, or None.
        """
        return make_trials(self)

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
        return make_comparison(self)

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

        The short form is the answer, one table, the three notes that matter most, and
        what the value was made from. Its last line says what is left out.

        Parameters
        ----------
        all : bool, default False
            Whether to show the rows that a short report leaves out: importance sampling
            that rests on a few episodes.
        verbose : bool, default False
            Whether to show every note, what each interval is, a row for each estimator
            of several policies, and columns of diagnostics.

        Returns
        -------
        str
            The text; ``print(report)`` prints the short form.
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
        """Explain the intervals of the table, one sentence for each kind.

        Rows of one method whose intervals were made otherwise have a sentence each.

        Parameters
        ----------
        rows : sequence of dict
            Some of ``records()``.

        Returns
        -------
        list of str
            A sentence for each kind, with the estimators whose interval it is. The
            policies stand beside them where the same estimator's intervals differ.

        Raises
        ------
        ValueError
            If ``rows`` are not records of a report.
        """
        needed = {"interval_method", "estimator"}
        given = _checks.collection(rows, "rows", "a Report's records()")
        for row in given:
            if not isinstance(row, Mapping) or not row.keys() >= needed:
                raise ArgumentError(
                    "rows", f"must be a Report's records(); one is {_checks.show(row)}"
                )
        return [
            text.legend(method, names, self.confidence, meaning)
            for method, meaning, names in explain_intervals(self, given)
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
        return make_dict(self)

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
        it is a slide. Files of these names are replaced. report.json is ``to_dict``
        with one field more: ``files``, the SHA-256 of each file by its name (its own is
        that of the JSON without it).

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
        return tables.render_html(self.content)
