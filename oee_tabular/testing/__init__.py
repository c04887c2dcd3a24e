"""Tools for those who write estimators: laws that they must satisfy, exact comparisons, Hypothesis strategies.

``check_estimator`` runs an estimator through the laws; ``compare_with_oracle`` shows its bias, variance and error beside exact
limits and bounds; ``mdps``, ``policies``, ``mdp_pairs``, ``horizons`` and ``logs`` draw problems (they need hypothesis:
``pip install '.[testing]'``; the rest does not).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from oee_tabular.testing.cases import CASES, Case, case, padded_log, relabelled_log
from oee_tabular.testing.conformance import CLAIMS, DEFAULT, LAWS, Verdict, Verdicts, check_estimator, claims_of
from oee_tabular.testing.oracles import Comparison, compare_with_oracle

if TYPE_CHECKING:
    from oee_tabular.testing.strategies import horizons, logs, mdp_pairs, mdps, policies

_STRATEGIES = ("horizons", "logs", "mdp_pairs", "mdps", "policies")

__all__ = [
    "CASES",
    "CLAIMS",
    "DEFAULT",
    "LAWS",
    "Case",
    "Comparison",
    "Verdict",
    "Verdicts",
    "case",
    "check_estimator",
    "claims_of",
    "compare_with_oracle",
    "horizons",
    "logs",
    "mdp_pairs",
    "mdps",
    "padded_log",
    "policies",
    "relabelled_log",
]


def __getattr__(name: str) -> Any:
    if name in _STRATEGIES:  # hypothesis is imported on use
        from oee_tabular.testing import strategies

        return getattr(strategies, name)
    raise AttributeError(f"module 'oee_tabular.testing' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
