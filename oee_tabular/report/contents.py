"""What the page says, in words and numbers ready to be set: no HTML here."""

from __future__ import annotations

import math
import platform
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import metadata

from oee_tabular import __version__, _printing
from oee_tabular.estimators.names import NAMED
from oee_tabular.report.quoting import LIKELIHOOD, METHODS
from oee_tabular.report.results import Evaluation, headline

LIBRARIES = ("numpy", "scipy", "numba", "cvxpy", "clarabel", "gymnasium", "matplotlib", "jinja2")

SAMPLING = "sampling interval"
CALLED: Mapping[str, str] = {"robust": "guaranteed"}


@dataclass(frozen=True)
class Answer:
    """What to say first about one policy, in the report's unit; ``lower`` and ``upper`` are None where there is no interval.

    ``unseen``: how many state-action pairs that it can reach were never recorded. ``from_log`` is False where it is what the
    simulator alone says.
    """

    policy: str
    value: float
    estimator: str
    lower: float | None
    upper: float | None
    method: str | None
    simulator: float | None
    truth: float | None
    coverage: float | None
    unseen: int
    sentence: str
    from_log: bool
    simulator_error: float | None = None


def number(value: float | None, digits: int = 4) -> str:
    """A number to read: a real minus sign, an en dash for none."""
    if value is None:
        return "–"
    if math.isnan(value):
        return "no value"
    return f"{value:#.{digits}g}".removesuffix(".").replace("-", "−") if value else "0"


def within(value: float | None, lower: float | None, upper: float | None) -> str:
    """A number to read, with as many digits as its interval has."""
    if value is None or lower is None or upper is None or not math.isfinite(value):
        return number(value)
    return format(value, _printing.spec(lower, upper)).replace("-", "−")


def between(lower: float | None, upper: float | None, joint: str = " to ") -> str:
    """An interval to read."""
    if lower is None or upper is None:
        return "–"
    return f"{within(lower, lower, upper)}{joint}{within(upper, lower, upper)}"


def answers(report: Evaluation) -> list[Answer]:
    """One answer a policy: the value that the log corrects, where there is one, with its interval."""
    found, rows = [], report.records()
    for policy in dict.fromkeys(result.policy for result in report.results):
        own = [result for result in report.results if result.policy == policy]
        first = headline(own)
        best = rows[report.results.index(first)]
        known = next((r.estimate for r in own if not r.estimate.is_from_log), None)
        alone = None if known is None else known.value * report.scale
        error = None if known is None or known.standard_error is None else known.standard_error * report.scale
        sure = report.sureness.intervals.get(policy, {}).get(LIKELIHOOD)
        unseen = 0 if sure is None else int(sure.diagnostics.get("unvisited_rows", 0))
        found.append(
            Answer(
                policy, best["value"], best["estimator"], best["lower"], best["upper"], best["interval_method"],
                alone, best["true_value"], best.get("coverage"), unseen,
                sentence(report.sureness.policies.get(policy, "")), first.estimate.is_from_log, error,
            )
        )  # fmt: skip
    return found


def sentence(text: str) -> str:
    """A sentence to read: a capital first, real minus signs."""
    return re.sub(r"(?<![\w.])-(?=\d)", "−", text[:1].upper() + text[1:])


def first_words(report: Evaluation, found: list[Answer]) -> tuple[str, str]:
    """The answer in one sentence, and what to read beside it."""
    valued = [a for a in found if math.isfinite(a.value)]
    if not valued:
        return "No estimator could give the value of a policy in the target.", "The notes below say why."
    if len(found) == 1:
        return f"In the target, the policy “{valued[0].policy}” is worth {_worth(valued[0], report)}.", ""
    worth = [f"“{a.policy}” is worth {_worth(a, report)}" for a in sorted(valued, key=lambda answer: -answer.value)]
    return report.sureness.ranking, f"In the target, {'. '.join(worth)}."


def _worth(answer: Answer, report: Evaluation) -> str:
    """The value with its interval, beside what the simulator says and, where it is known, the truth."""
    told = f"about {within(answer.value, answer.lower, answer.upper)}"
    if answer.lower is not None:
        level = f"{report.confidence:.4%}".rstrip("0%").rstrip(".") + "%"
        told += f", and with {level} confidence between {between(answer.lower, answer.upper, ' and ')}"
    if answer.simulator is not None and answer.from_log:
        told += f"; the simulator says {within(answer.simulator, answer.lower, answer.upper)}"
        if answer.simulator_error is not None:
            told += f" (standard error {number(answer.simulator_error, 2)}, since it was sampled)"
    if answer.truth is not None:
        told += f"; exactly, which is known here, it is {number(answer.truth)}"
    return told


def alone(report: Evaluation, policy: str) -> dict[str, tuple[float, float] | None]:
    """The intervals of a policy that stand beside no value, by what they are called; None where the method gave none."""
    beside = {row["interval_method"] for row in report.records() if row["policy"] == policy}
    intervals = report.sureness.intervals.get(policy, {})
    shown = {
        f"{CALLED.get(method, method)} interval": (found.lower, found.upper) if found.status == "ok" else None
        for method, found in intervals.items()
        if method not in beside
    }
    likelihood = intervals.get(LIKELIHOOD)
    if likelihood is not None and likelihood.sampling not in (None, (likelihood.lower, likelihood.upper)):
        shown[SAMPLING] = likelihood.sampling
    return shown


def interval_words(ends: tuple[float, float] | None, scale: float) -> str:
    """An interval in a table cell."""
    return "none" if ends is None else between(ends[0] * scale, ends[1] * scale)


def method_facts(report: Evaluation) -> list[tuple[str, str]]:
    """How it was computed."""
    facts = report.facts
    names = list(dict.fromkeys(result.estimator for result in report.results))
    found = [
        ("A value is", f"{report.unit} ({'normalised' if report.normalized else 'not normalised'})"),
        ("Simulator", facts["simulator"]),
        ("Simulator from", facts.get("simulator_name")),
        ("Log of the target", facts["log"]),
        ("Log from", facts.get("log_name")),
        ("Target", facts.get("target")),
        ("Rewards paid by models", "the log's mean where it has any" if facts.get("rewards") == "log" else "the simulator's"),
        ("Horizon", "infinite" if report.horizon is None else f"{report.horizon} rewards"),
        ("Discount", f"{report.discount:g}"),
        ("Estimators", ", ".join(names)),
        ("Seed", seed_words(report.seed).removeprefix("seed ")),
    ]  # fmt: skip
    if "policy_names" in facts:
        found.append(("Policies from", ", ".join(f"{name}: {spec}" for name, spec in facts["policy_names"].items())))
    told = [(name, str(value)) for name, value in found if value is not None]
    known = {
        "simulator",
        "simulator_name",
        "log",
        "log_name",
        "log_files",
        "rewards",
        "policy_names",
        "date",
        "discount",
    }
    return told + [
        (str(key).replace("_", " "), str(value)) for key, value in facts.items() if key not in known and value
    ]


def seed_words(seed: object) -> str:
    """A seed that can be given again, or what stood in its place."""
    return f"seed {seed}" if isinstance(seed, int) else "no seed given" if seed is None else "seeded by an object"


def versions() -> list[tuple[str, str]]:
    """oee_tabular's, Python's and the libraries' versions."""
    found = [("oee_tabular", __version__), ("Python", platform.python_version())]
    for name in LIBRARIES:
        try:
            found.append((name, metadata.version(name)))
        except metadata.PackageNotFoundError:
            continue
    return found


def glossary(report: Evaluation) -> list[tuple[str, str]]:
    """What the words of the tables mean, for a reader who did not run it."""
    used = dict.fromkeys(result.estimator for result in report.results)
    found = [(name, NAMED[name].meaning) for name in used if name in NAMED]
    if any("robust" in methods for methods in report.sureness.intervals.values()):
        found.append(
            ("guaranteed interval", "Holds with the confidence given however few moves the log has; the widest.")
        )
    if any(SAMPLING in alone(report, policy) for policy in report.sureness.intervals):
        meaning = (
            "From the recorded transitions alone: the value plus or minus a normal quantile times its standard error. "
        )
        meaning += "State-action pairs that were never recorded are as estimated."
        found.append((SAMPLING, meaning))
    methods = dict.fromkeys([*(row["interval_method"] for row in report.records()), LIKELIHOOD])
    return [
        *found,
        *((f"interval: {name}", f"{sentence(METHODS[name])}.") for name in methods if name in METHODS),
        ("std. error", "Standard error, in the unit of the value."),
        ("eff. n", "Effective sample size: how many equally informative moves (or episodes) the value rests on."),
        ("coverage", "Share of the policy's discounted time in state-action pairs that the log has seen."),
        ("max weight", "The largest ratio, target over simulator or policy over behaviour."),
        ("row-sum err.", "How far rows of corrected probabilities are from summing to 1."),
    ]  # fmt: skip
