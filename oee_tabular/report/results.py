"""What an evaluation found: as rows, as text, as JSON and as files."""

from __future__ import annotations

import json
import math
import os
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular import __version__, _files, _printing
from oee_tabular._checks import Array
from oee_tabular.estimators import Estimate, Problem
from oee_tabular.estimators.base import IN_VALUES_UNIT
from oee_tabular.inference import Interval
from oee_tabular.report.files import check_output
from oee_tabular.report.quoting import LIKELIHOOD, METHODS, OWN
from oee_tabular.report.sureness import Sureness, as_records, sampling_columns

if TYPE_CHECKING:
    import pandas as pd


COLUMNS: tuple[tuple[str, str, Callable[[float], str]], ...] = (  # of diagnostics, in the table and on the page
    ("effective_sample_size", "eff. n", "{:.0f}".format),
    ("coverage", "coverage", _printing.share),
    ("largest_weight", "max weight", "{:.3g}".format),
    ("row_sum_error", "row-sum err.", lambda error: "0" if error < 1e-9 else f"{error:.2g}"),
)


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
class Evaluation:
    """A ``Report`` but for its page; its attributes are explained there."""

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
    sureness: Sureness = field(default_factory=Sureness)
    problem: Problem | None = field(default=None, repr=False, compare=False)
    policies: Mapping[str, Array] = field(default_factory=dict, repr=False, compare=False)

    @property
    def unit(self) -> str:
        """What a value is, in words."""
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
                    **sampling_columns(self._likelihood(result), factor),
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

    def _likelihood(self, result: Result) -> Interval | None:
        """The likelihood interval, where the result quotes it."""
        if result.estimate.diagnostics.get("interval_method") != LIKELIHOOD:
            return None
        return self.sureness.intervals.get(result.policy, {}).get(LIKELIHOOD)

    @property
    def table(self) -> pd.DataFrame:
        """One row per policy and estimator, every diagnostic a column."""
        import pandas as pd

        return pd.DataFrame(self.records())

    def _header(self) -> list[str]:
        interval = [f"{self.confidence:.0%} interval", *(["error"] if self.truth else [])]
        return ["policy", "estimator", "value", "std. error", *interval, *(title for _, title, _ in COLUMNS), "note"]

    def _legend(self) -> list[str]:
        """What the column of intervals holds: for each method its estimators, and what it is."""
        members: dict[str, dict[str, None]] = {}
        for row in self.records():
            if row["interval_method"] is not None:
                members.setdefault(row["interval_method"], {})[row["estimator"]] = None
        return [
            f"{self.confidence:.0%} interval of {', '.join(names)} ({method}): {METHODS.get(method, method)}."
            for method, names in members.items()
        ]

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        body = [self._cells(row) for row in self.records()]
        lines = aligned([self._header(), *body], numeric_from=2)
        lines.insert(1, "-" * max(len(line) for line in lines))
        text = [f"Value: {self.unit}", f"Simulator: {self.facts['simulator']}", f"Log: {self.facts['log']}"]
        text += [*([f"Target: {self.facts['target']}"] if "target" in self.facts else []), "", *lines]
        if self._legend():
            text += ["", *self._legend()]
        if self.truth:
            values = ", ".join(f"{name}: {value * self.scale:.6g}" for name, value in self.truth.items())
            text += ["", f"Exact value in the target: {values}"]
        if self.warnings:
            numbered = (f"  [{k}] {warning}" for k, warning in enumerate(self.warnings, start=1))
            text += ["", "Read before use:", *numbered]
        if self.sureness.sentences:
            text += ["", *self.sureness.sentences]
        return "\n".join(text)

    def _cells(self, row: Mapping[str, Any]) -> list[str]:
        ends = row["lower"], row["upper"]
        form, interval = (".5g", "") if ends[0] is None else (_printing.spec(*ends), _printing.interval(*ends))
        return [
            row["policy"],
            row["estimator"],
            format(row["value"], form),
            shown(row["standard_error"], ".2g"),
            interval,
            *([shown(row["error"], "+.2g")] if self.truth else []),
            *diagnostic_cells(row),
            "".join(f"[{k}]" for k in row["notes"]),
        ]

    def to_dict(self) -> dict[str, Any]:
        """Everything, as plain values (nan and infinities become None)."""
        found: dict[str, object] = plain(
            {
                "version": __version__,
                "unit": self.unit,
                "discount": self.discount,
                "horizon": self.horizon,
                "normalized": self.normalized,
                "confidence": self.confidence,
                "interval": self._legend(),
                "seed": self.seed if isinstance(self.seed, int) else None,
                "facts": dict(self.facts),
                "results": self.records(),
                "intervals": as_records(self.sureness, self.scale),
                "conclusion": list(self.sureness.sentences),
                "warnings": list(self.warnings),
            }
        )
        return found

    def to_json(self) -> str:
        """``to_dict`` as JSON."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)

    def save(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write report.json, table.csv and values.png into ``folder``: all of them or none."""
        from oee_tabular import plots

        check_output(folder, "folder")
        target = Path(folder)
        contents = {
            "report.json": (self.to_json() + "\n").encode(),
            "table.csv": _files.csv_bytes(self.table),
            "values.png": plots.figure_png(
                lambda ax: plots.plot_values(self.records(), ax, unit=textwrap.fill(self.meaning, 60)),
                size=(min(9.0, 3.4 + 0.35 * len(self.results)), 4.8),
            ),
        }
        _files.write_all(target, contents)
        return [target / name for name in contents]

    def _repr_html_(self) -> str:
        return _printing.table(
            self._header(),
            [self._cells(row) for row in self.records()],
            caption=f"Value: {self.unit} ({'normalised' if self.normalized else 'not normalised'})",
            text_columns=2,
            below=[
                *self._legend(),
                *(f"{name}: exact value in the target {value * self.scale:.6g}" for name, value in self.truth.items()),
                *(f"[{k}] {warning}" for k, warning in enumerate(self.warnings, start=1)),
                *self.sureness.sentences,
            ],
        )


def shown(value: float | None, form: str) -> str:
    """A number, or nothing."""
    return "" if value is None else format(value, form)


def diagnostic_cells(row: Mapping[str, Any]) -> list[str]:
    """A record's ``COLUMNS``, empty where it has none."""
    return ["" if row.get(key) is None else words(row[key]) for key, _, words in COLUMNS]


def aligned(rows: Sequence[Sequence[str]], *, numeric_from: int) -> list[str]:
    """The lines of a table; columns from ``numeric_from`` on stand to the right."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        "  ".join(
            cell.rjust(width) if k >= numeric_from else cell.ljust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


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
