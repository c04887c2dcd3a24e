"""League of the estimators, from the rows of a run.

The rows give numbers of each cell (family x size x estimator), and the cells give the
league. A cell's reference is max(min(RMSE of maximum likelihood, RMSE of the
simulator), eff / 2) on the same logs, with eff = sqrt(efficiency bound / n). A ratio
is *surely* above 1.1 where the 5% quantile of its paired bootstrap over the seeds is.

No estimator can know the reference, and none can reach it everywhere; ``floor`` says
how near a rule can come that sees the value alone. Let x be the maximum-likelihood
value less the simulator's and b the simulator's error, over eff, so that x ~ N(b, 1)
for large n. A rule delta(x) has the ratio sqrt(E (delta(x) - b)^2) / max(min(|b|, 1),
1/2) at b. No rule has a ratio below 1.22 at every b (T. Armstrong, P. Kline and L. Sun,
Adapting to Misspecification, 2023, arXiv 2305.14265). ``floor(b)`` is the ratio at b of
the rule whose worst ratio is least. An estimator that sees more than the value, such as
where the log differs from the simulator, can be below it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from oee_tabular import _checks, _files
from oee_tabular._results import checked, conform
from oee_tabular.exceptions import ArgumentError
from oee_tabular.lab.experiment import draw_bytes, pipe_table
from oee_tabular.lab.run import refuse_links
from oee_tabular.plots import (
    DIVERGING,
    INK,
    disable_math,
    draw_or_warn,
    series,
    shorten,
)
from oee_tabular.typing import Array, BoolArray, RealArrayLike

# The references, which are always measured.
LIKELIHOOD = "maximum-likelihood"
SIMULATOR = "simulator"
# A ratio is over max(min(RMSE of maximum likelihood, simulator's error), LEAST * eff).
LEAST = 0.5
ERRORS = np.array(
    [
        0.0,
        0.1,
        0.2,
        0.3,
        0.4,
        0.5,
        0.6,
        0.7,
        0.8,
        0.9,
        1.0,
        1.25,
        1.5,
        1.75,
        2.0,
        2.5,
        3.0,
        4.0,
        5.0,
    ]
)
FLOOR_RATIOS = np.array(
    [  # python tests/benchmarks/floor.py
        1.009,
        1.019,
        1.048,
        1.093,
        1.153,
        1.224,
        1.086,
        0.991,
        0.922,
        0.869,
        0.827,
        0.933,
        1.027,
        1.103,
        1.160,
        1.217,
        1.222,
        1.214,
        1.224,
    ]
)
N_RESAMPLES = 2000  # of the seeds
# A ratio is surely above SURE_RATIO where this quantile of its bootstrap is.
SURE_QUANTILE = 0.05
SURE_RATIO = 1.1
OVER = "over likelihood"
# A policy is near the recorded one, or far, by the total variation between the shares of
# state-action pairs of both in the target.
NEAR = 0.3
FAR = 0.5
# Intervals count on logs of at least so many transitions per stochastic pair that cover
# more than this share of the policy's time.
MIN_INTERVAL_SIZE = 3.0
MIN_INTERVAL_COVER = 0.9
MIN_FAMILY_LOGS = 10  # below it a family's coverage is not called the worst
NORMAL = 1.959963984540054


def wide(
    frame: pd.DataFrame,
    index: str | list[str],
    values: str,
    columns: str | list[str] = "estimator",
) -> pd.DataFrame:
    """Pivot a table to a column for each estimator, or each value of ``columns``."""
    return frame.pivot(index=index, columns=columns, values=values)  # noqa: PD010 (the other one drops what is nan)


def _cell_rows(key: Any, part: pd.DataFrame) -> list[dict[str, Any]]:
    """Return one row for each estimator of a cell."""
    family, size = key
    errors = wide(part, ["seed"], "error")
    first = part.drop_duplicates("seed").set_index("seed").reindex(errors.index)
    eff = np.sqrt(first["bound"].to_numpy())
    is_counted = (first["covered"] > MIN_INTERVAL_COVER).to_numpy() & (
        size >= MIN_INTERVAL_SIZE
    )
    is_far_known = "distance" in first
    rows = []
    for name, mine in part.groupby("estimator", sort=False):
        mine = mine.set_index("seed").reindex(errors.index)
        known = errors[name].notna().to_numpy()
        squares = (errors[[name, LIKELIHOOD, SIMULATOR]].to_numpy()[known] ** 2).T
        ratios = {}
        if known.any():
            ratios = _ratios(squares, eff[known])
        rows.append(
            {
                "family": family,
                "size": size,
                "estimator": name,
                "families": first["families"].iloc[0],
                "identical": bool(first["identical"].iloc[0]),
                "seeds": len(mine),
                "failed": int((~known).sum()),
                **ratios,
                "bias": float(errors[name].mean()),
                "covered": float(first["covered"].mean()),
                "distance": float(
                    first["distance"].mean() if is_far_known else math.nan
                ),
                **_intervals(mine, eff, is_counted),
                "seconds": float(mine["seconds"].dropna().median()),
            }
        )
    return rows


def _ratios(squares: Array, eff: Array) -> dict[str, float]:
    """Compute the RMSE of an estimator and of both references, and their ratios.

    ``squares`` (3, seeds) are squared errors. ``low`` is the 5% bootstrap quantile of
    the estimator's ratio, ``ratio_error`` its standard error as a share of it (as
    ``rmse_error`` of the RMSE), ``floor`` the floor at the simulator's error.
    """
    n = squares.shape[1]
    mean_eff = math.sqrt(float(np.mean(eff**2)))
    least = LEAST * mean_eff if math.isfinite(mean_eff) else 0.0
    samples = np.vstack([np.full(n, 1.0 / n), resamples(n)])
    rmse, likelihood, simulator = (np.sqrt(samples @ own) for own in squares)
    ratio = _divide(rmse, np.maximum(np.minimum(likelihood, simulator), least))
    unit = mean_eff if 0 < mean_eff < math.inf else math.nan
    return {
        "rmse": float(rmse[0]),
        LIKELIHOOD: float(likelihood[0]),
        SIMULATOR: float(simulator[0]),
        "ratio": float(ratio[0]),
        "low": float(np.quantile(ratio[1:], SURE_QUANTILE, method="lower")),
        "ratio_error": _spread_of_log(ratio[1:], n),
        "rmse_error": _spread_of_log(rmse[1:], n),
        "b": float(simulator[0] / unit),
        "floor": float(floor(simulator[0] / unit)),
        "over_likelihood": float(_divide(rmse, likelihood)[0]),
        "over_eff": float(rmse[0] / unit),
    }


def _spread_of_log(samples: Array, n: int) -> float:
    """Return the standard error of a positive number, as a share of it.

    It is the standard deviation of its logarithm over bootstrap samples of ``n`` seeds;
    nan where there is one seed, or a sample is 0 or infinite.
    """
    is_number = (samples > 0) & np.isfinite(samples)
    if n < 2 or not is_number.all():
        return math.nan
    return float(np.log(samples).std())


def _divide(own: Array, reference: Array) -> Array:
    """Divide own by reference, with the ratio 1 where both are 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where((own == 0) & (reference == 0), 1.0, own / reference))


@functools.lru_cache(maxsize=8)
def resamples(seeds: int) -> Array:
    """Return the shares of the seeds in each bootstrap sample, (resamples, seeds).

    They are the same for every cell of as many seeds.
    """
    drawn = np.random.default_rng(seeds).multinomial(
        seeds, np.full(seeds, 1 / seeds), size=N_RESAMPLES
    )
    return np.asarray(drawn / seeds)


def _intervals(
    mine: pd.DataFrame, eff: Array, is_counted: BoolArray
) -> dict[str, float]:
    """Count the logs whose intervals cover the truth, and measure the widths.

    Both the reported interval and value +- 1.96 standard errors have the number of logs
    that count, how many of them cover the truth, and the median width / (2 * 1.96 eff).
    """
    half = NORMAL * mine["standard_error"]
    numbers = dict[str, float]()
    ends = {
        "": (mine["lower"], mine["upper"]),
        "se_": (mine["value"] - half, mine["value"] + half),
    }
    for prefix, (lower, upper) in ends.items():
        here = is_counted & np.isfinite(lower) & np.isfinite(upper)
        is_measured = here & (eff > 0) & np.isfinite(eff)
        relative = ((upper - lower) / (2.0 * NORMAL * eff))[is_measured]
        covers = here & mine["truth"].between(lower, upper)
        numbers[f"{prefix}logs"] = int(here.sum())
        numbers[f"{prefix}held"] = int(covers.sum())
        numbers[f"{prefix}width"] = float(relative.dropna().median())
    return numbers


def _league_row(cells: pd.DataFrame) -> dict[str, Any]:
    """Summarize one estimator over the cells of one kind of families."""
    known = cells[cells["ratio"].notna()]
    worst = None
    if len(known):
        worst = known.iloc[int(known["ratio"].to_numpy().argmax())]
    worst_ratio = math.nan
    worst_cell = ""
    if worst is not None:
        worst_ratio = float(worst["ratio"])
        worst_cell = f"{worst['family']} at {worst['size']:g}"
    sums = cells[["logs", "held", "se_logs", "se_held"]].sum()
    by = cells.groupby("family", sort=False)[["logs", "held"]].sum()
    share = (by["held"] / by["logs"])[by["logs"] >= MIN_FAMILY_LOGS]
    return {
        "estimator": cells["estimator"].iloc[0],
        "families": cells["families"].iloc[0],
        "cells": len(cells),
        "over reference": geometric_mean(known["ratio"]),
        "floor": geometric_mean(known["floor"]),
        "worst": worst_ratio,
        "worst cell": worst_cell,
        "surely above 1.1": float((known["low"] > SURE_RATIO).mean()),
        OVER: geometric_mean(known["over_likelihood"]),
        "over eff": geometric_mean(known["over_eff"]),
        **_by_distance(known),
        "logs": int(sums["logs"]),
        "coverage": float(sums["held"] / (sums["logs"] or math.nan)),
        "worst family": str(share.idxmin()) if len(share) else "",
        "its coverage": float(share.min()),
        "width": float(cells["width"].dropna().median()),
        "coverage of 1.96 se": float(sums["se_held"] / (sums["se_logs"] or math.nan)),
        "width of 1.96 se": float(cells["se_width"].dropna().median()),
        "seconds": float(cells["seconds"].mean()),
        "failed": int(cells["failed"].sum()),
    }


def _by_distance(cells: pd.DataFrame) -> dict[str, float]:
    """Return "over likelihood" of policies near the recorded one, far, and between."""
    distance = cells.get("distance", pd.Series(math.nan, cells.index))
    groups = {
        f"{OVER}, near": distance < NEAR,
        f"{OVER}, between": distance.between(NEAR, FAR, inclusive="left"),
        f"{OVER}, far": distance >= FAR,
    }
    return {
        label: geometric_mean(cells["over_likelihood"][is_here])
        for label, is_here in groups.items()
    }


def floor(error: RealArrayLike) -> Array:
    """Return the ratio of the best rule where the simulator's error is ``error`` eff.

    From 5 on it is that of 5.

    Examples
    --------
    >>> floor(np.array([0.0, 0.5, 1.0, 3.0, 50.0])).round(2).tolist()
    [1.01, 1.22, 0.83, 1.22, 1.22]
    """
    return np.asarray(np.interp(np.abs(error), ERRORS, FLOOR_RATIOS))


def geometric_mean(values: pd.Series[float]) -> float:
    """Compute exp(mean log) of the values that are numbers.

    It is nan without any, and where one of them is 0: such a mean would be 0 whatever
    the others are.
    """
    numbers = pd.Series(values, dtype=float)
    if (numbers == 0).any():
        return math.nan
    return float(np.exp(np.log(numbers).mean()))


# what stands for unrecorded pairs in estimators that differ there alone
ELSE = {
    LIKELIHOOD: "simulator",
    "model-based": "stay",
    "fqe": "simulator",
    "fqe-zero": "0",
}
SHARES = ("surely above 1.1", "coverage", "its coverage", "coverage of 1.96 se")
PICTURES = {
    "profile": "Share of cells by ratio",
    "sizes": "RMSE by size",
    "heat": "Ratio by family and size",
}
KINDS = ("png", "pdf", "svg")  # of each picture
MAX_HEAT_POWER = (
    3.0  # powers of two on either side of 1 that the heat map's colours tell apart
)
N_CURVES = 10  # estimators that the picture over sizes shows
EXPLAINED = (
    "A ratio is the RMSE over max(min(RMSE of maximum likelihood, RMSE of the"
    " simulator), eff / 2) on the same logs, where eff = sqrt(efficiency bound / n) and"
    " maximum likelihood has the simulator in unrecorded pairs. `over reference`:"
    " geometric mean of the ratios over cells (family x size). `floor`: the same of the"
    " best rule that sees the value alone. `surely above 1.1`: share of cells where the"
    " 5% quantile of the paired bootstrap over the seeds is above 1.1. `over"
    " likelihood`, `over eff`: RMSE over maximum likelihood's, over eff; `near`,"
    " `between`, `far`: of families whose policy is less than 0.3 from the recorded one,"
    " from 0.3 to 0.5, and farther, as the total variation between the shares of"
    " state-action pairs. `coverage`,"
    " `width`: of the reported interval, over logs of at least 3 transitions per"
    " stochastic pair that cover more than 90% of the policy's time; widths are over 2"
    " x 1.96 eff. `of 1.96 se`: of value +- 1.96 standard errors. `seconds`: processor"
    " time of one log. `else` in a name: what stands for unrecorded pairs, the"
    " simulator's transitions, a state that stays as it is, or Q = 0. A mean is empty"
    " where the estimator is exactly right in a cell. Tuned families are those on which a"
    " constant of the default was chosen; in real ones the simulator and the target are"
    " both measured."
)


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
        """Refuse a league without estimators, and labels that cannot be shown."""
        if "estimator" not in self.league:
            raise ArgumentError(
                "league",
                "must have a column estimator; it has"
                f" {', '.join(map(str, self.league.columns)) or 'none'}",
            )
        check_labels(self.labels, list(self.league["estimator"].unique()))

    def __repr__(self) -> str:
        """Return the numbers of estimators, cells and rows."""
        return (
            f"League({len(self.league)} estimators, {len(self.cells)} cells,"
            f" {len(self.table)} rows)"
        )

    def __str__(self) -> str:
        """Return the league table, what it means, and why values are missing."""
        league = self._labelled()[1].astype(object)
        for column in league.columns[2:]:
            form = "{:.0%}" if column in SHARES else "{:.3g}"
            texts = (
                form.format(x) if isinstance(x, float) else str(x)
                for x in league[column]
            )
            league[column] = np.where(league[column].isna(), "", list(texts))
        tables = []
        for kind, part in league.groupby("families", sort=False):
            columns = part.drop(columns="families").set_index("estimator")
            tables.append(f"{kind} families\n{columns.T.to_string()}")
        parts = [*tables, EXPLAINED]
        failed = [
            f"{row.estimator}: no value on {row.logs} logs: {row.status}"
            for row in self._failures().itertuples()
        ]
        if failed:
            parts.append("\n".join(failed))
        return "\n\n".join(parts)

    def _failures(self) -> pd.DataFrame:
        """Count the rows without a value by estimator and status."""
        lost = self.table[self.table["value"].isna()]
        return (
            lost.groupby(["estimator", "status"], sort=False)
            .size()
            .rename("logs")
            .reset_index()
        )

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
        keys = ["families", "estimator"]
        # cells that an older version wrote have no errors
        own = {"ratio_error": math.nan, "rmse_error": math.nan, **self.cells}
        cells = pd.DataFrame(own)
        groups = dict(iter(cells.groupby(keys, sort=False)))
        rows = []
        for row in self.league.to_dict("records"):
            part = groups[row["families"], row["estimator"]]
            known = part[part["ratio"].notna()]
            worst = math.nan
            if len(known):
                worst = float(
                    known["ratio_error"].iloc[int(known["ratio"].to_numpy().argmax())]
                )
            share = row["coverage"]
            rows.append(
                {
                    "over reference": row["over reference"]
                    * _error_of_mean(known["ratio_error"]),
                    "worst": row["worst"] * worst,
                    "over eff": row["over eff"]
                    * _error_of_mean(part["rmse_error"][part["over_eff"].notna()]),
                    "coverage": math.sqrt(share * (1 - share) / row["logs"])
                    if row["logs"]
                    else math.nan,
                }
            )
        return pd.DataFrame(rows, index=self.league.index)

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
        _require_figure(figure)
        ax = _axes(
            figure,
            xlabel="tau: RMSE over the reference's",
            ylabel="share of cells with a ratio of at most tau",
        )
        cells, _ = self._labelled()
        ratio = cells["ratio"]
        known = ratio[(ratio > 0) & np.isfinite(ratio)]
        low = 0.5
        high = 2.0
        if len(known):
            low = max(known.min() / 1.2, 1e-3)
            high = min(known.max() * 1.2, 1e3)
        for k, (name, own) in enumerate(cells.groupby("estimator", sort=False)):
            ratios = np.clip(np.sort(own["ratio"].dropna().to_numpy()), low, high)
            share = np.arange(len(ratios) + 1) / len(own)
            ax.step(
                [low, *ratios, high],
                [*share, share[-1]],
                where="post",
                markevery=0.12,
                ms=5,
                label=shorten(name),
                **series(k),
            )
        ax.axvline(1.0, color=INK, lw=0.9, ls=(0, (4, 2)))
        ax.set(xscale="log", ylim=(0.0, 1.02))
        disable_math(ax.legend(fontsize="small", loc="best").get_texts())

    def sizes(self, figure: Any) -> None:
        """Draw the RMSE over eff of each estimator by size of the log.

        A point is the geometric mean over the families, with a standard error over
        them.

        Parameters
        ----------
        figure : matplotlib.figure.Figure
            An empty figure, which is drawn on and resized.
        """
        _require_figure(figure)
        ax = _axes(
            figure, xlabel="transitions per stochastic pair", ylabel="RMSE over eff"
        )
        cells, _ = self._labelled()
        over_eff = cells["over_eff"]
        logs = cells.assign(log=np.log(over_eff.where(over_eff > 0)))
        shown = list(logs.groupby("estimator", sort=False))[:N_CURVES]
        for k, (name, own) in enumerate(shown):
            points = own.groupby("size")["log"].agg(["mean", "sem"])
            shift = 1.0 + 0.02 * (k - N_CURVES / 2)
            middle = np.exp(points["mean"].to_numpy())
            error = points["sem"].fillna(0.0).to_numpy()
            ends = [
                (middle * -np.expm1(-error)).tolist(),
                (middle * np.expm1(error)).tolist(),
            ]
            ax.errorbar(
                points.index * shift,
                middle,
                ends,
                **series(k),
                ms=5,
                capsize=2,
                label=shorten(name),
            )
        ax.set(xscale="log", yscale="log")
        disable_math(ax.legend(fontsize="small", loc="best").get_texts())

    def heat(self, figure: Any) -> None:
        """Draw the ratio of each family and size, with a number in each cell.

        There is a panel for each estimator that is no reference.

        Parameters
        ----------
        figure : matplotlib.figure.Figure
            An empty figure, which is drawn on and resized.
        """
        _require_figure(figure)
        references = [LIKELIHOOD, SIMULATOR]
        cells, _ = self._labelled()
        own_names = dict(zip(cells["estimator"], self.cells["estimator"], strict=True))
        names = [
            name
            for name in cells["estimator"].unique()
            if own_names[name] not in references
        ]
        # A run of the references alone shows them.
        names = names or list(own_names)
        families = list(self.cells["family"].unique())
        sizes = sorted(self.cells["size"].unique())
        figure.set_size_inches(
            2.6 + (1.2 + 0.62 * len(sizes)) * len(names), 1.6 + 0.25 * len(families)
        )
        axes: Any = figure.subplots(1, len(names), squeeze=False, sharey=True)[0]
        for ax, name in zip(axes, names, strict=True):
            own = cells[cells["estimator"] == name]
            ratios = (
                wide(own, "family", "ratio", "size")
                .reindex(index=families, columns=sizes)
                .to_numpy()
            )
            with np.errstate(divide="ignore"):
                power = np.clip(np.log2(ratios), -MAX_HEAT_POWER, MAX_HEAT_POWER)
            image = ax.imshow(
                power,
                cmap=DIVERGING,
                vmin=-MAX_HEAT_POWER,
                vmax=MAX_HEAT_POWER,
                aspect="auto",
            )
            for (i, j), ratio in np.ndenumerate(ratios):
                color = "black" if abs(power[i, j]) < 0.6 * MAX_HEAT_POWER else "white"
                text = "-" if np.isnan(ratio) else f"{ratio:.2g}"
                ax.text(j, i, text, ha="center", va="center", fontsize=8.5, color=color)
            ax.set_title(shorten(name), fontsize="medium")
            ax.set_xticks(
                range(len(sizes)), [f"{size:g}" for size in sizes], fontsize=9
            )
            ax.set_yticks(
                range(len(families)),
                [shorten(family) for family in families],
                fontsize=9,
            )
            ax.set_xlabel("transitions per stochastic pair", fontsize="small")
            disable_math([ax.title, *ax.get_yticklabels()])
        bar = figure.colorbar(image, ax=list(axes), shrink=0.6)
        bar.set_ticks(
            [-3, -2, -1, 0, 1, 2, 3], labels=["1/8", "1/4", "1/2", "1", "2", "4", "8"]
        )
        bar.ax.tick_params(labelsize=9)
        bar.set_label("RMSE over the reference's", fontsize="small")

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
        parts = ["# Estimators on families of environment shift"]
        if command:
            parts.append(f"`{command}`")
        _, league = self._labelled()
        for kind, part in league.groupby("families", sort=False):
            table = (
                part.drop(columns="families")
                .set_index("estimator")
                .T.reset_index(names="measure")
            )
            parts += [f"## {str(kind).capitalize()} families", pipe_table(table)]
        parts.append(EXPLAINED)
        parts += [f"![{text}]({name}.png)" for name, text in PICTURES.items()]
        failed = self._failures()
        if len(failed):
            parts += ["## Without a value", pipe_table(failed)]
        if about:
            frame = pd.DataFrame(
                {
                    "family": list(about),
                    "what the simulator has wrong": list(about.values()),
                }
            )
            parts += ["## Families", pipe_table(frame)]
        return "\n\n".join(parts) + "\n"

    def to_latex(self) -> str:
        """Return the league as a LaTeX table (booktabs).

        Returns
        -------
        str
            A ``tabular`` environment with a row for each estimator and kind of
            families. Standard errors (``errors``) stand in parentheses.
        """
        shown = [
            "estimator",
            "families",
            "cells",
            "over reference",
            "floor",
            "worst",
            "over eff",
            "coverage",
            "width",
        ]
        errors = self.errors()
        texts = self._labelled()[1][shown].astype(object)
        for name in errors:
            texts[name] = [
                _with_error(value, error)
                for value, error in zip(self.league[name], errors[name], strict=True)
            ]
        return texts.rename(columns=str.capitalize).to_latex(
            index=False,
            escape=True,  # of names and labels, which are plain text
            na_rep="--",
            float_format="%.2f",
            column_format="llrrrrrrr",  # two columns of text, seven of numbers
        )

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


def league_files(
    league: League,
    about: Mapping[str, str] | None = None,
    command: str = "",
    labels: Mapping[str, str] | None = None,
) -> dict[str, bytes]:
    """Return the bytes of the files that ``League.save`` writes, by name."""
    shown = league.with_labels({} if labels is None else labels)
    contents = {
        "table.csv": _files.csv_bytes(league.table),
        "cells.csv": _files.csv_bytes(league.cells, float_format="%.6g"),
        "league.csv": _files.csv_bytes(league.league, float_format="%.6g"),
        "league.md": _files.text_bytes(shown.page(about or {}, command)),
        "league.tex": _files.text_bytes(shown.to_latex()),
    }
    for name in PICTURES:
        draw = functools.partial(
            draw_bytes, getattr(shown, name), salt="bench", kinds=KINDS
        )
        pictures = draw_or_warn(f"{name}.png", draw)
        contents |= {f"{name}.{kind}": data for kind, data in (pictures or {}).items()}
    return contents


def check_labels(
    labels: Mapping[str, str], names: Sequence[str], name: str = "labels"
) -> dict[str, str]:
    """Return labels of estimators by name; refuse those that cannot be shown.

    ``names`` are the estimators of the league; ``name`` is the argument's, in errors.
    """
    texts: dict[str, str] = conform(labels, name, dict[str, str])
    for estimator, text in texts.items():
        if estimator not in names:
            raise ArgumentError(
                name,
                f"must be of estimators in the league, {', '.join(names)}; got"
                f" {_checks.show(estimator)}",
            )
        if not text.strip() or not text.isprintable():
            raise ArgumentError(
                f"{name}[{estimator!r}]",
                "must be a text of one line, with a letter or a digit; it is"
                f" {_checks.show(text)}",
            )
    shown = [texts.get(own, own) for own in names]
    for text in shown:
        if shown.count(text) > 1:
            raise ArgumentError(
                name,
                f"must give each estimator another text; {_checks.show(text)} would be"
                " there twice",
            )
    return texts


def _error_of_mean(errors: pd.Series[float]) -> float:
    """Return the standard error of a geometric mean, as a share of it.

    ``errors`` are those of the independent numbers, as shares of them.
    """
    if not len(errors):
        return math.nan
    return float(np.sqrt((errors.to_numpy() ** 2).sum())) / len(errors)


def _with_error(value: float, error: float) -> str:
    """Write a number with its standard error in parentheses, if there is one."""
    if math.isnan(value):
        return "--"
    return f"{value:.2f}" + ("" if math.isnan(error) else f" ({error:.2f})")


def _axes(figure: Any, **labels: str) -> Any:
    """Return the only axes of a figure, with these labels."""
    figure.set_size_inches(7.0, 4.4)
    ax = figure.subplots()
    ax.set(**labels)
    return ax


def _require_figure(figure: object) -> None:
    """Require a figure of matplotlib."""
    if not callable(getattr(type(figure), "set_size_inches", None)):
        raise ArgumentError(
            "figure",
            f"must be a matplotlib.figure.Figure; got {type(figure).__name__}",
        )


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
    _require_rows(table)
    groups = table.groupby(["family", "size"], sort=False)
    cells = pd.DataFrame([row for key, part in groups for row in _cell_rows(key, part)])
    return League(table, cells, league_of_cells(cells))


TEXT_COLUMNS = ("family", "families", "estimator", "status")
NUMBER_COLUMNS = (
    *("size", "value", "standard_error", "error", "lower", "upper"),
    *("seconds", "covered", "bound", "truth"),
)


def _require_rows(table: pd.DataFrame) -> None:
    """Require the rows of a run: their columns, one of each log, and the references."""
    conform(table, "table", pd.DataFrame)
    wanted = [*TEXT_COLUMNS, *NUMBER_COLUMNS, "seed", "identical"]
    missing = [name for name in wanted if name not in table.columns]
    if missing:
        raise ArgumentError(
            "table", f"must have the columns {', '.join(wanted)}; it lacks {missing[0]}"
        )
    if not len(table) or not table.columns.is_unique:
        raise ArgumentError(
            "table", f"must have rows, and each column once; it has {len(table)} rows"
        )
    for name in NUMBER_COLUMNS:
        try:
            table[name].astype(float)
        except (TypeError, ValueError):
            raise ArgumentError(
                f"table[{name!r}]", f"must be numbers; it is {table[name].dtype}"
            ) from None
    key = ["family", "size", "seed", "estimator"]
    if table.duplicated(key).any():
        row = int(np.argmax(table.duplicated(key)))
        raise ArgumentError(
            "table", f"must have one row for each {', '.join(key)}; row {row} is double"
        )
    for cell, part in table.groupby(["family", "size"], sort=False):
        for reference in (LIKELIHOOD, SIMULATOR):
            if not (part["estimator"] == reference).any():
                raise ArgumentError(
                    "table",
                    f"must have rows of {reference!r} for each family and size; those"
                    f" of {cell} have none",
                )


def league_of_cells(cells: pd.DataFrame) -> pd.DataFrame:
    """Return one row for each estimator and kind of families, over their cells."""
    groups = cells.groupby(["families", "estimator"], sort=False)
    return pd.DataFrame([_league_row(part) for _, part in groups])
