"""From a problem and policies to a table, warnings in plain language, a picture and a JSON file."""

from __future__ import annotations

import json
import math
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular import __version__, _checks, _files, advice
from oee_tabular.estimators import Estimate, Estimator, Problem
from oee_tabular.estimators.names import default_names, named_estimators
from oee_tabular.exact import policy_value
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.sureness import Sureness, as_records, how_sure

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Result:
    """One estimate of one policy."""

    policy: str
    estimator: str
    estimate: Estimate


@dataclass(frozen=True)
class Report:
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
    sureness : likelihood (and guaranteed) intervals of each policy, and the sentences that end the report
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
    sureness: Sureness = field(default_factory=lambda: Sureness({}, ()))

    @property
    def unit(self) -> str:
        """What a value is, in words."""
        span = "t >= 0" if self.horizon is None else f"t = 0..{self.horizon - 1}"
        factor = "(1 - discount) * " if self.normalized else ""
        return f"{factor}sum of discount^t * reward over {span}, discount {self.discount:g}"

    @property
    def scale(self) -> float:
        """(1 - discount) if normalized, else 1."""
        return 1.0 - self.discount if self.normalized else 1.0

    def records(self) -> list[dict[str, Any]]:
        """The results as plain rows, in the report's unit."""
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
                    "true_value": None if truth is None else truth * factor,
                    "error": None if truth is None else (estimate.value - truth) * factor,
                    "status": estimate.status,
                    "notes": list(self.notes.get((result.policy, result.estimator), ())),
                    **estimate.diagnostics,
                }
            )
        return rows

    @property
    def table(self) -> pd.DataFrame:
        """One row per policy and estimator, every diagnostic a column."""
        import pandas as pd

        return pd.DataFrame(self.records())

    def __str__(self) -> str:
        level = f"{self.confidence:.0%} interval"
        header = [
            "policy",
            "estimator",
            "value",
            "std. error",
            level,
            "eff. n",
            "coverage",
            "max weight",
            "row-sum err.",
            "note",
        ]
        if self.truth:
            header.insert(5, "error")
        body = [self._cells(row) for row in self.records()]
        lines = _aligned([header, *body], numeric_from=2)
        lines.insert(1, "-" * max(len(line) for line in lines))
        text = [f"Value: {self.unit}", f"Simulator: {self.facts['simulator']}", f"Log: {self.facts['log']}", "", *lines]
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
        interval = "" if row["lower"] is None else f"[{row['lower']:.4g}, {row['upper']:.4g}]"
        coverage = row.get("coverage")
        row_sum = row.get("row_sum_error")
        cells = [
            row["policy"],
            row["estimator"],
            f"{row['value']:.5g}",
            _number(row["standard_error"], ".2g"),
            interval,
            _number(row.get("effective_sample_size"), ".0f"),
            "" if coverage is None else f"{100 * coverage:.1f}%",
            _number(row.get("largest_weight"), ".3g"),
            "" if row_sum is None else ("0" if row_sum < 1e-9 else f"{row_sum:.2g}"),
            "".join(f"[{k}]" for k in self.notes.get((row["policy"], row["estimator"]), ())),
        ]
        if self.truth:
            cells.insert(5, _number(row["error"], "+.2g"))
        return cells

    def to_dict(self) -> dict[str, Any]:
        """Everything, as plain values (nan and infinities become None)."""
        plain: dict[str, Any] = _plain(
            {
                "version": __version__,
                "unit": self.unit,
                "discount": self.discount,
                "horizon": self.horizon,
                "normalized": self.normalized,
                "confidence": self.confidence,
                "interval": "value plus or minus normal quantile times standard error",
                "seed": self.seed if isinstance(self.seed, int) else None,
                "facts": dict(self.facts),
                "results": self.records(),
                "intervals": as_records(self.sureness, self.scale),
                "conclusion": list(self.sureness.sentences),
                "warnings": list(self.warnings),
            }
        )
        return plain

    def to_json(self) -> str:
        """``to_dict`` as JSON."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)

    def save(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write report.json, table.csv and values.png into ``folder``: all of them or none."""
        from oee_tabular import plots

        check_output(folder)
        target = Path(folder)
        contents = {
            "report.json": (self.to_json() + "\n").encode(),
            "table.csv": self.table.to_csv(index=False).encode(),
            "values.png": plots.figure_png(lambda ax: plots.plot_values(self.records(), ax, unit=self.unit)),
        }
        _files.write_all(target, contents)
        return [target / name for name in contents]


def check_output(folder: str | os.PathLike[str]) -> None:
    """``folder`` can be made and written; a ValueError before any work is done otherwise."""
    path = Path(folder)
    nearest = path
    while not nearest.exists() and nearest != nearest.parent:
        nearest = nearest.parent
    if not nearest.is_dir():
        raise ValueError(f"output must be a folder that can be written; {str(nearest)!r} is a file")
    try:
        with tempfile.TemporaryFile(dir=nearest):
            pass
    except OSError as error:
        raise ValueError(
            f"output must be a folder that can be written; {str(nearest)!r} is not writable ({error.strerror})"
        ) from None


def evaluate(
    problem: Problem,
    policies: Any,
    *,
    estimators: Sequence[str | Estimator] | Mapping[str, Estimator] | None = None,
    confidence: float = 0.95,
    seed: Any = None,
    normalized: bool = False,
    target: FiniteMDP | None = None,
    facts: Mapping[str, Any] | None = None,
    guaranteed: bool = False,
) -> Report:
    """Evaluate policies in the target by several estimators.

    Parameters
    ----------
    problem : Problem
    policies : (S, A) array, a list of them, or a mapping name -> array
    estimators : names, estimators, or a mapping name -> estimator; None: the simulator, off-environment evaluation, the
        model-based baseline, and importance sampling where the log allows it
    confidence : level of the intervals, value plus or minus the normal quantile times the standard error
    seed : int, or anything that ``numpy.random.SeedSequence`` takes; every (policy, estimator) has a stream of its own
    normalized : whether the report multiplies by (1 - discount)
    target : the true target, where it is known (teaching, research): adds its exact values and the errors
    guaranteed : whether the intervals that hold at any sample size are computed too (``interval(method="robust")``)
    facts : more to keep in the report's ``facts`` (names of files, how the simulator was changed)

    Raises
    ------
    ValueError
        Bad arguments, and what the estimators that were asked for raise.
    """
    from tqdm.auto import tqdm

    if not isinstance(problem, Problem):
        raise ValueError(f"problem must be a Problem(simulator, log, ...); got {type(problem).__name__}")
    if target is not None and target.transitions.shape != problem.simulator.transitions.shape:
        raise ValueError(
            f"target must have the simulator's {problem.simulator.n_states} states and {problem.simulator.n_actions} actions; "
            f"it has {target.n_states} and {target.n_actions}"
        )
    level = _checks.number_in(confidence, "confidence", 0.0, 1.0, open_ends=True)
    if normalized and problem.simulator.discount == 1.0:
        raise ValueError("normalized must be False at discount 1: the factor (1 - discount) would be 0")
    named_policies = {
        name: check_policy(policy, problem.simulator, name=f"policy {name!r}")
        for name, policy in _named(policies).items()
    }
    chosen, left_out = _chosen(problem, estimators, target)
    truth = {}
    if target is not None:
        truth = {name: policy_value(target, pi, horizon=problem.horizon) for name, pi in named_policies.items()}
    quantile = NormalDist().inv_cdf(0.5 + level / 2.0)
    results: list[Result] = []
    findings: list[advice.Finding] = []
    cells = [(i, p, j, e) for i, p in enumerate(named_policies) for j, e in enumerate(chosen)]
    for i, policy, j, estimator in tqdm(cells, desc="evaluating", disable=None, delay=1.0, leave=False):
        stream = np.random.SeedSequence(seed, spawn_key=(i, j))
        estimate = chosen[estimator](problem, named_policies[policy], seed=stream)
        error = estimate.standard_error
        if estimate.interval is None and error is not None and math.isfinite(estimate.value):
            interval = (estimate.value - quantile * error, estimate.value + quantile * error)
            estimate = replace(estimate, interval=interval)
        results.append(Result(policy, estimator, estimate))
        findings += advice.about_estimate(policy, estimator, estimate)
    about = [*((text, False) for text in left_out), *advice.about_problem(problem)]
    general = [text for text, _ in about]
    on_models = tuple(k for k, (_, concerns) in enumerate(about, start=1) if concerns)
    told = advice.sentences(findings)
    notes = {
        (result.policy, result.estimator): (() if "n_episodes" in result.estimate.diagnostics else on_models)
        + tuple(
            k for k, (_, pairs) in enumerate(told, start=1 + len(general)) if (result.policy, result.estimator) in pairs
        )
        for result in results
    }
    known = {"simulator": repr(problem.simulator), "log": problem.log.describe(), "rewards": problem.rewards}
    known |= facts or {}
    return Report(
        tuple(results),
        truth,
        (*general, *(sentence for sentence, _ in told)),
        notes,
        level,
        normalized,
        problem.simulator.discount,
        problem.horizon,
        seed,
        known,
        how_sure(
            problem, named_policies, level, guaranteed=guaranteed,
            scale=1.0 - problem.simulator.discount if normalized else 1.0,
        ),
    )  # fmt: skip


def _named(policies: Any) -> dict[str, Any]:
    if isinstance(policies, Mapping):
        found = {str(name): policy for name, policy in policies.items()}
    elif isinstance(policies, list | tuple) and (not policies or np.ndim(policies[0]) >= 2):
        found = {f"policy {k}": policy for k, policy in enumerate(policies)}
    else:
        found = {"policy": policies}
    if not found:
        raise ValueError("policies must hold at least one; it is empty")
    return found


def _chosen(
    problem: Problem, estimators: Sequence[str | Estimator] | Mapping[str, Estimator] | None, target: FiniteMDP | None
) -> tuple[dict[str, Estimator], list[str]]:
    if estimators is None:
        names, left_out = default_names(problem)
        return named_estimators(names, target), left_out
    if isinstance(estimators, Mapping):
        return dict(estimators), []
    found: dict[str, Estimator] = {}
    for item in [estimators] if isinstance(estimators, str) else estimators:
        if isinstance(item, str):
            found |= named_estimators([item], target)
        elif callable(item):
            label = type(item).__name__
            while label in found:
                label += "'"
            found[label] = item
        else:
            raise ValueError(f"estimators must be names or callables; got {item!r}")
    if not found:
        raise ValueError("estimators must name at least one; it is empty")
    return found, []


def _number(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def _aligned(rows: Sequence[Sequence[str]], *, numeric_from: int) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        "  ".join(
            cell.rjust(width) if k >= numeric_from else cell.ljust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
