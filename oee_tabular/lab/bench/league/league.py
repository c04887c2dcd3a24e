"""League of a run: its rows, cells, a row for each estimator, texts and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any

import pandas as pd

from oee_tabular import _files
from oee_tabular._results import checked, conform
from oee_tabular.lab.bench.league.cells import cell_rows, wide
from oee_tabular.lab.bench.league.files import league_files
from oee_tabular.lab.bench.league.labels import ELSE, LIKELIHOOD, check_labels
from oee_tabular.lab.bench.league.pictures import draw_heat, draw_profile, draw_sizes
from oee_tabular.lab.bench.league.rows import require_frames, require_rows
from oee_tabular.lab.bench.league.summary import league_errors, league_of_cells
from oee_tabular.lab.bench.league.texts import (
    count_failures,
    league_latex,
    league_page,
    league_text,
)
from oee_tabular.lab.run import refuse_links
from oee_tabular.typing import Array


@checked()
@dataclass(frozen=True, eq=False)
class League:
    """Results of a run of the benchmark.

    ``str`` shows the league table, what it means, and why estimators had no value.

    Attributes
    ----------
    table : DataFrame
        A row for each family, size, seed and estimator.
    cells : DataFrame
        A row for each family, size and estimator, over the seeds.
    league : DataFrame
        A row for each estimator and kind of families ("tuned", "held", "real"),
        over the cells.
    labels : mapping of str to str
        By the names of some estimators what texts, tables and pictures call them.

    Raises
    ------
    ValueError
        If a frame lacks a column of which texts, scores or pictures are made, has
        something else than texts or real numbers there, or two rows where there is one;
        if a row of ``table`` or ``league`` has no cell; or if ``with_labels`` would
        refuse the labels.

    See Also
    --------
    run : Measures estimators and returns a league.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> found = oee.bench.run("oee", families=["machine"], sizes=[3, 10], seeds=3)
    >>> (
    ...     sorted(found.cells["size"].unique().tolist()),
    ...     found.league["families"].tolist(),
    ...     found.scores()["oee"].shape,
    ... )
    ([3.0, 10.0], ['tuned', 'tuned', 'tuned'], (3, 2))
    """

    table: pd.DataFrame
    cells: pd.DataFrame
    league: pd.DataFrame
    labels: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse frames without what is made of them, and labels that cannot be shown."""
        require_frames(self.table, self.cells, self.league)
        check_labels(self.labels, list(self.league["estimator"].unique()))

    def __repr__(self) -> str:
        """Return the numbers of estimators, cells and rows."""
        return (
            f"League({len(self.league)} estimators, {len(self.cells)} cells,"
            f" {len(self.table)} rows)"
        )

    def __str__(self) -> str:
        """Return the league table, what it means, and why values are missing."""
        return league_text(self._labelled()[1], count_failures(self.table))

    def with_labels(self, labels: Mapping[str, str]) -> League:
        """Return the same league with other texts for some estimators.

        Parameters
        ----------
        labels : mapping of str to str
            By the name of an estimator what its rows, columns and curves are called in
            texts, the LaTeX table and pictures. The data frames keep the names.

        Returns
        -------
        League
            The league with these labels besides its own.

        Raises
        ------
        ValueError
            If a name is none of the estimators', or if two would be called the same, or
            one an empty text or one of several lines.

        Examples
        --------
        >>> import oee_tabular as oee
        >>> found = oee.bench.run("oee", families=["machine"], sizes=3, seeds=2)
        >>> "OEE (ours) & tuned & " in found.with_labels(
        ...     {"oee": "OEE (ours)"}
        ... ).to_latex()
        True
        """
        names = list(self.league["estimator"].unique())
        return replace(self, labels={**self.labels, **check_labels(labels, names)})

    def _labelled(self) -> tuple[pd.DataFrame, pd.DataFrame]:
        """Return ``cells`` and ``league`` with labels in place of names."""
        texts = {LIKELIHOOD: f"{LIKELIHOOD}, else {ELSE[LIKELIHOOD]}", **self.labels}
        cells, league = (
            frame.assign(
                estimator=[texts.get(name, name) for name in frame["estimator"]]
            )
            for frame in (self.cells, self.league)
        )
        return cells, league

    def errors(self) -> pd.DataFrame:
        """Compute standard errors of the league's numbers, over the seeds.

        Those of mean ratios follow from the bootstrap over the seeds of each cell,
        whose families are taken as given; those of a coverage are binomial.

        Returns
        -------
        DataFrame
            A row for each row of ``league``, with the columns "over reference",
            "worst", "over eff" and "coverage". What has no error is nan.
        """
        return league_errors(self.cells, self.league)

    def scores(self) -> dict[str, Array]:
        """Compute abs(error) / reference of each log, by estimator.

        Returns
        -------
        dict of str to ndarray of shape (seeds, cells)
            The scores of each estimator, smaller is better: runs x tasks, as
            ``rliable`` takes them. A log without a value has nan.
        """
        keys = ["family", "size", "estimator"]
        both = self.table.merge(self.cells[[*keys, "rmse", "ratio"]], on=keys)
        both["score"] = both["error"].abs() * both["ratio"] / both["rmse"]
        groups = both.groupby("estimator", sort=False)
        return {
            str(name): wide(own, "seed", "score", ["family", "size"]).to_numpy()
            for name, own in groups
        }

    def profile(self, figure: Any) -> None:
        """Draw for each estimator the share of cells whose ratio is at most tau.

        Parameters
        ----------
        figure : matplotlib.figure.Figure
            An empty figure, which is drawn on and resized.
        """
        draw_profile(figure, self._labelled()[0])

    def sizes(self, figure: Any) -> None:
        """Draw the RMSE over eff of each estimator by size of the log.

        A point is the geometric mean over the families, with a standard error over
        them.

        Parameters
        ----------
        figure : matplotlib.figure.Figure
            An empty figure, which is drawn on and resized.
        """
        draw_sizes(figure, self._labelled()[0])

    def heat(self, figure: Any) -> None:
        """Draw the ratio of each family and size, with a number in each cell.

        There is a panel for each estimator that is no reference.

        Parameters
        ----------
        figure : matplotlib.figure.Figure
            An empty figure, which is drawn on and resized.
        """
        draw_heat(figure, self._labelled()[0], self.cells["estimator"])

    def page(self, about: Mapping[str, str], command: str) -> str:
        """Return the league as a page of markdown.

        Parameters
        ----------
        about : mapping of str to str
            What the simulator of each family has wrong, by the family's name.
        command : str
            The command that made the run; an empty text is left out.

        Returns
        -------
        str
            The page, with links to the pictures that ``save`` writes beside it.
        """
        conform(about, "about", dict[str, str])
        conform(command, "command", str)
        failed = count_failures(self.table)
        return league_page(self._labelled()[1], failed, about, command)

    def to_latex(self) -> str:
        """Return the league as a LaTeX table (booktabs).

        Returns
        -------
        str
            A ``tabular`` environment with a row for each estimator and kind of
            families. Standard errors (``errors``) stand in parentheses.
        """
        return league_latex(self._labelled()[1], self.errors())

    def save(
        self,
        folder: str | PathLike[str],
        *,
        about: Mapping[str, str] | None = None,
        command: str = "",
        labels: Mapping[str, str] | None = None,
    ) -> list[Path]:
        """Write the tables, the page and three pictures into a folder, all or none.

        Parameters
        ----------
        folder : str or path
            Where table.csv, cells.csv, league.csv, league.md, league.tex and the
            pictures go, each as PNG, PDF and SVG.
        about : mapping of str to str, optional
            What the simulator of each family has wrong, by the family's name.
        command : str, optional
            The command that made the run, for the page.
        labels : mapping of str to str, optional
            What estimators are called in the page, the LaTeX table and the pictures
            (``with_labels``); the CSV files keep their names.

        Returns
        -------
        list of Path
            The files that were written.

        Raises
        ------
        ValueError
            If one of the files is a link or something else that is no plain file, or if
            ``with_labels`` refuses the labels.
        """
        conform(folder, "folder", str | PathLike)
        _files.local(folder, "folder")
        conform(about, "about", dict[str, str] | None)
        contents = league_files(self, about, command, labels)
        refuse_links(Path(folder))
        _files.write_all(Path(folder), contents)
        return [Path(folder) / name for name in contents]


def league_of(table: pd.DataFrame) -> League:
    """Make the league of a run's rows.

    Parameters
    ----------
    table : DataFrame
        Columns family, families, size, seed, estimator, value, standard_error, error,
        lower, upper, seconds, covered, bound, identical, status and truth, and distance
        where it is known. Among the
        estimators are the references "maximum-likelihood" and "simulator".

    Returns
    -------
    League
        The table with its cells and its league.

    See Also
    --------
    run : Measures estimators and returns their league.

    Examples
    --------
    >>> row = {
    ...     "family": "f",
    ...     "families": "held",
    ...     "size": 3.0,
    ...     "standard_error": 0.2,
    ...     "lower": 0.0,
    ...     "upper": 2.0,
    ...     "seconds": 0.1,
    ...     "covered": 1.0,
    ...     "bound": 0.01,
    ...     "identical": False,
    ...     "status": "ok",
    ...     "truth": 1.0,
    ... }
    >>> errors = {
    ...     "maximum-likelihood": (0.2, -0.2),
    ...     "simulator": (0.4, 0.4),
    ...     "mine": (0.1, 0.1),
    ... }
    >>> rows = [
    ...     {
    ...         **row,
    ...         "seed": seed,
    ...         "estimator": name,
    ...         "value": 1 + pair[seed],
    ...         "error": pair[seed],
    ...     }
    ...     for seed in (0, 1)
    ...     for name, pair in errors.items()
    ... ]
    >>> league_of(pd.DataFrame(rows)).cells[["estimator", "ratio"]].round(
    ...     3
    ... ).values.tolist()
    [['maximum-likelihood', 1.0], ['simulator', 2.0], ['mine', 0.5]]
    """
    require_rows(table)
    groups = table.groupby(["family", "size"], sort=False)
    cells = pd.DataFrame([row for key, part in groups for row in cell_rows(key, part)])
    return League(table, cells, league_of_cells(cells))
