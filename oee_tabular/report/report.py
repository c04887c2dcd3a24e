"""The report of an evaluation: its rows, text and files (``Evaluation``), and the page that is drawn of them."""

from __future__ import annotations

import os

from oee_tabular import _files
from oee_tabular.report import contents
from oee_tabular.report.files import check_page
from oee_tabular.report.results import Evaluation


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
    [('pdis', 9.72, -0.35)]
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

        file = None if path is None else check_page(path)
        text = render(self, title=title, grid=grid)
        if file is not None:
            _files.write_all(file.parent, {file.name: text.encode()})
        return text
