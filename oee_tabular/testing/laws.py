"""Laws about where an estimator's values go: its limit, J in the target, the mean over logs."""

from __future__ import annotations

from typing import Any

import numpy as np

from oee_tabular._checks import Array
from oee_tabular.testing.calls import Broken, Refused, Subject, shorten
from oee_tabular.testing.cases import Case
from oee_tabular.testing.comparing import exactly, tends_to

FEW, MANY = 3, 400  # episodes of a log, and logs, for unbiasedness
ERRORS = 4.0  # standard errors that a mean may be off


def limit(subject: Subject) -> str:
    """Its values tend to ``estimator.limit``, also where the log never shows some (s, a) that the policy takes."""
    found = []
    for pair in [*subject.cases("ragged"), subject.one_case("moves"), subject.one_case("partial")]:
        try:
            goal = subject.limit(pair, **_data(pair))
        except Refused as refused:
            if not pair.name.startswith("partial"):
                raise
            found.append(f"{pair.name}: refused ({shorten(refused.text, 60)})")
            continue
        assert goal is not None
        found.append(tends_to(subject, pair, goal, "its limit"))
    return "; ".join(found)


def consistent(subject: Subject) -> str:
    """Its values tend to J_target under full support; so does its own limit, where it has one."""
    found = []
    for pair in [*subject.cases("ragged"), subject.one_case("moves")]:
        truth = pair.truth
        for data in ({}, _data(pair)):
            own = subject.limit(pair, **data)
            if own is not None:
                exactly(own, truth, f"{pair.name}: its limit is not J_target", _limit_example(pair))
        found.append(tends_to(subject, pair, truth, "J_target"))
    return "; ".join(found)


def identical(subject: Subject) -> str:
    """Where the target is the simulator (zeta = 1) its values tend to J of both, and its limit is J."""
    pair = subject.one_case("same ragged")
    own = subject.limit(pair, **_data(pair))
    if own is not None:
        exactly(own, pair.truth, f"{pair.name}: its limit is not J", _limit_example(pair))
    return tends_to(subject, pair, pair.truth, "J")


def ragged(subject: Subject) -> str:
    """A chain that pays 1 while it lives: episodes that are over count as paying nothing, they are not left out."""
    pair = subject.one_case("survival")
    return tends_to(subject, pair, pair.truth, "J_target")


def unbiased(subject: Subject) -> str:
    """The mean over many logs of few episodes is J_target within 4 standard errors."""
    found = []
    for pair in (subject.one_case("ragged"), subject.one_case("moves")):
        logs = pair.logs(FEW, MANY, seed=subject.log_seed(sum(pair.name.encode()), FEW))
        values: Array = np.array([subject.value(pair, log, seed=k) for k, log in enumerate(logs)])
        mean, error = float(values.mean()), float(values.std(ddof=1) / np.sqrt(MANY))
        off = abs(mean - pair.truth)
        numbers = (
            f"{pair.name}: mean {mean:.5g} ± {error:.2g} of {MANY} logs of {FEW} episodes, J_target {pair.truth:.5g}"
        )
        if not off <= ERRORS * error + 1e-9 * max(1.0, abs(pair.truth)):
            apart = (
                f"{off / error:.1f} standard errors" if error > 1e-12 * abs(mean) else f"{off:.3g}, and does not vary"
            )
            text = f"{numbers}: off by {apart}"
            raise Broken(
                "fails",
                text,
                f"pair = case({pair.name!r}); mean over seeds of the value on pair.problem({FEW}, seed=seed)",
            )
        found.append(numbers)
    return "; ".join(found)


def _data(pair: Case) -> dict[str, Any]:
    return {"behavior_policy": pair.behavior.copy(), "data_distribution": pair.data_distribution}


def _limit_example(pair: Case) -> str:
    return (
        f"pair = case({pair.name!r}); estimator.limit(pair.simulator, pair.target, pair.policy, horizon={pair.horizon})"
    )
