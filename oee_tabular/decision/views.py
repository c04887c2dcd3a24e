"""A decision as sentence, table, JSON and page."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from oee_tabular import _checks, _printing
from oee_tabular.decision.candidates import (
    BUILT_IN,
    CORRECTED,
    LOG,
    RECORDED,
    SIMULATOR,
    recorded_name,
)
from oee_tabular.report import plain

if TYPE_CHECKING:
    from oee_tabular.decision.improvement import Improvement

TITLES = {
    "deploy": "Deploy the new policy",
    "keep": "Keep the running policy",
    "record": "Record more first",
}


def write_number(number: float, *others: float) -> str:
    """Write a gain with as many digits as its distance from others asks for.

    One that is not 0 is not written as 0: a decision rests on its sign.
    """
    if not math.isfinite(number):
        return "-"
    if number == 0.0:
        return "0"
    known = [x for x in (number, *others) if math.isfinite(x)]
    text = format(number, _printing.spec(min(known), max(known)))
    return text if float(text) else f"{number:.1g}"


def write_count(number: int) -> str:
    """Write a count with spaces between thousands: 44 177."""
    return f"{number:,}".replace(",", " ")


def write_sentence(found: Improvement) -> str:
    """Write what to do, and the numbers that it rests on."""
    level = f"{100 * found.confidence:.4g}%"
    gain = write_number(found.gain, found.gain_lower)
    lower = write_number(found.gain_lower, found.gain)
    if found.decision == "deploy":
        return (
            f"Deploy “{found.name}”: in the target it gains about {gain} over the"
            f" running policy, and at least {lower} (lower end of the {level}"
            " interval)."
        )
    if found.decision == "keep":
        if found.gain == 0.0:
            return "Keep the running policy: no candidate gains anything over it."
        remedy = "more transitions cannot show that it is better"
        if found.plan is not None:
            remedy = (
                f"it would take about {write_count(found.plan.n)} transitions, more than"
                " ten times the log, to show that it is better"
            )
        return (
            "Keep the running policy: the best candidate,"
            f" “{found.name}”, gains about {gain} (lower end of the {level} interval:"
            f" {lower}), and {remedy}."
        )
    advice = ""
    if found.plan is not None:
        plural = "s" if found.plan.n > 1 else ""
        advice = (
            f" To certify a gain takes about {write_count(found.plan.n)} more"
            f" transition{plural}, if not more (the command “oee plan” says which)."
            f" {found.plan.advice}"
        )
    certified = f"but it may lose {lower.lstrip('-−')}"
    if not math.isfinite(found.gain_lower):
        certified = "but it was made from this log's counts, which cannot certify it"
    elif found.gain_lower == 0.0:
        certified = "but no gain is certain"
    return (
        f"Record more first: “{found.name}” gains about {gain} over the running policy,"
        f" {certified} (lower end of the {level} interval).{advice}"
    )


def list_rows(found: Improvement) -> list[list[str]]:
    """Return the header and a row for each candidate, the largest lower end first."""
    rows = [["candidate", "gain", f"lower end, {100 * found.confidence:.4g}%"]]

    def order(each: Any) -> tuple[float, float]:
        """Return the lower end and the gain, nan last."""
        ends = (each.gain_lower, each.gain)
        return tuple(-x if math.isfinite(x) else math.inf for x in ends)  # type: ignore[return-value]

    for each in sorted(found.candidates, key=order):
        rows.append(
            [
                each.name,
                write_number(each.gain, each.gain_lower),
                write_number(each.gain_lower, each.gain),
            ]
        )
    return rows


def write_notes(found: Improvement) -> list[str]:
    """Write what the numbers are, and what they assume."""
    lower = (
        "lower end: the least gain of all models that the log does not reject, where"
        f" {_write_assumption(found)}; the policy with the highest one is deployed,"
        " if that is above 0 (an end of 0 promises no gain)"
    )
    notes = [
        *_explain_names(found),
        f"gain: value minus that of the running policy; {_printing.SUM}",
        lower,
        *_explain_optimism(found),
    ]
    if any(not math.isfinite(each.gain_lower) for each in found.candidates):
        notes.append(
            "-: no lower end for a policy that was made from the log's own counts;"
            " certify it by another log, or by a part of this one (split)"
        )
    if found.split is not None:
        notes.append(
            f"{_printing.share(found.split)} of the log made the policies, the rest"
            f" certified them (split, seed {found.seed})"
        )
    return notes


def _explain_names(found: Improvement) -> list[str]:
    """Write how the package made the candidates that are its own."""
    names = {each.name for each in found.candidates}
    told = []
    if CORRECTED in names:
        told.append(
            f"{CORRECTED}: the best policy in the simulator corrected by the log"
        )
    kept = [least for least in RECORDED if recorded_name(least) in names]
    if kept:
        labels = ", ".join(f"{least}+" for least in kept)
        often = _printing.listing(
            ["once" if least == 1 else f"{least} times" for least in kept]
        )
        same = "the same, but it"
        if CORRECTED not in names:
            same = "the best policy in the simulator corrected by the log that"
        told.append(
            f"recorded {labels}: {same} takes another action than the running policy"
            f" only where the log has that action at least {often} in the state"
            " (if nowhere, it is the running policy, which gains 0)"
        )
    if SIMULATOR in names:
        told.append(f"{SIMULATOR}: the best policy in the simulator as it is")
    if LOG in names:
        told.append(f"{LOG}: the best policy in the log's frequencies")
    if told and not names <= set(BUILT_IN):
        told.append("all others: the candidates that were given")
    return ["; ".join(told)] if told else []


def _explain_optimism(found: Improvement) -> list[str]:
    """Write by how much ends of policies that this log made were lowered, and why."""
    made = (CORRECTED, *map(recorded_name, RECORDED))
    cut = {each.name: each.optimism for each in found.candidates if each.name in made}
    if not any(cut.values()):
        return []
    by = ", ".join(f"“{name}” {x:.2g}" for name, x in cut.items())
    return [
        "A policy that was made from this log looks better in it than it is. Halves of"
        " the log show by how much: one makes a policy, the other judges it. The lower"
        f" ends above have this subtracted, the gains do not: {by}"
    ]


def _write_assumption(found: Improvement) -> str:
    """Write what pairs that were never recorded may do."""
    if math.isinf(found.unrecorded):
        return (
            "pairs that were never recorded may do anything that the simulator allows"
        )
    if found.unrecorded == 1.0:
        return "pairs that were never recorded behave as estimated"
    return (
        "pairs that were never recorded differ from the estimate by at most the factor"
        f" {found.unrecorded:g}"
    )


def write_text(found: Improvement) -> str:
    """Write sentence, table and notes for the terminal."""
    rows = list_rows(found)
    name, gain, lower = (max(len(row[k]) for row in rows) for k in range(3))
    lines = [f"{a:<{name}}  {b:>{gain}}  {c:>{lower}}" for a, b, c in rows]
    return "\n".join([found.sentence, "", *lines, *write_notes(found)])


def to_dict(found: Improvement) -> dict[str, Any]:
    """Return the decision as what JSON holds."""
    content = {
        "decision": found.decision,
        "deploy": found.deploy,
        "sentence": found.sentence,
        "policy": found.name,
        "gain": found.gain,
        "gain_lower": found.gain_lower,
        "confidence": found.confidence,
        "unrecorded": "inf" if math.isinf(found.unrecorded) else found.unrecorded,
        "split": found.split,
        "seed": found.seed,
        "candidates": [
            {
                "policy": each.name,
                "gain": each.gain,
                "gain_lower": each.gain_lower,
                "optimism": each.optimism,
            }
            for each in found.candidates
        ],
        "plan": None if found.plan is None else found.plan.to_dict(),
    }
    made: dict[str, Any] = plain(content)
    return made


def render_page(found: Improvement, title: str | None = None) -> str:
    """Write the page of a decision."""
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    header, *rows = list_rows(found)
    environment = Environment(
        loader=ChoiceLoader(
            [
                PackageLoader("oee_tabular.decision"),
                PackageLoader("oee_tabular.report"),  # its style
            ]
        ),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template("decision.html.j2").render(
        title=title or TITLES[found.decision],
        sentence=found.sentence,
        header=header,
        rows=rows,
        notes=write_notes(found),
        plan=None if found.plan is None else str(found.plan),
    )
    return _checks.escape_controls(page, keep="\n\t") + "\n"
