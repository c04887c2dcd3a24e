"""Labels of a league's rows, and what the references are called."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from oee_tabular import _checks
from oee_tabular._results import conform
from oee_tabular.estimators.names import ALIASES
from oee_tabular.exceptions import ArgumentError

# The references, which are always measured.
LIKELIHOOD = "maximum-likelihood"
SIMULATOR = "simulator"
# what stands for unrecorded pairs in estimators that differ there alone
ELSE = {
    LIKELIHOOD: "simulator",
    "model-based": "stay",
    "fqe": "simulator",
    "fqe-zero": "0",
}


def labels_of(chosen: Mapping[str, Any]) -> dict[str, str]:
    """Return what rows of the package's estimators are called by what they do.

    Some differ in nothing but what stands for unrecorded pairs.
    """
    kinds = {
        name: ALIASES.get(given, given)
        for name, given in chosen.items()
        if isinstance(given, str)
    }
    return {
        name: f"{name}, else {ELSE[kind]}"
        for name, kind in kinds.items()
        if kind in ELSE
    }


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
