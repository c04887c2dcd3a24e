"""Laws that estimators must satisfy, exact comparisons, Hypothesis strategies.

``check_estimator`` runs an estimator through the ``laws`` on the pairs of ``cases``;
``as_code`` writes small MDPs, logs and policies as code (``code``);
``compare_with_oracle`` shows its bias, variance and error beside exact limits and
bounds (``oracles``); ``mdps``, ``policies``, ``mdp_pairs``, ``horizons`` and ``logs``
draw problems (``strategies``; they need hypothesis: ``pip install '.[testing]'``).
``exercises`` and ``assignments`` check the answers of students.

Objects. v(D, pi) is the estimate from a log D, J the value of pi in the target, L the
estimator's own limit, r the rewards, b and c numbers, sigma a permutation of states and
actions; E is the mean over independent logs.

=================  ===================================================================
Law                What it says
=================  ===================================================================
well_formed        v is finite, or there is a status or a ValueError, on problems with
                   one state, one action, one episode, ...
input_unchanged    D, pi, simulator and horizon are after a call what they were, to
                   the bit
reproducible       v of one seed has the same bits each time
seeds              v of any seed has the same bits, unless the estimator is random
support            There is no v, and no L but J, where the target has transitions
                   with simulator probability 0
exact              v = J (or L) on a log that has each episode as often as it is
                   probable, to 1e-6 or what the estimator declares (``tolerance``)
limit              E v -> L, also where pairs are never recorded that pi takes
consistent         E v -> J and L = J
ragged             The same on episodes that end
identical          The same where the target is the simulator
unbiased           E v = J from 3 episodes
relabelling        v(sigma D, sigma pi) = v(D, pi)
scale              v of rewards b r is b v
shift              v of rewards r + c is v + c sum_t gamma^t
padding            Rows in an absorbing state after an episode's end do not change v
after_end          The same, whatever actions those rows have
=================  ===================================================================

Other equalities hold to 1e-8. Means are over logs of 4800 episodes: a t test, which a right
estimator fails with a chance of 1e-5.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from oee_tabular.testing.cases import CASES, Case, case, padded_log, relabelled_log
from oee_tabular.testing.code import as_code
from oee_tabular.testing.conformance import LAWS, check_estimator
from oee_tabular.testing.conformance import check_module as check_module
from oee_tabular.testing.conformance import own_estimator as own_estimator
from oee_tabular.testing.oracles import OracleComparison, compare_with_oracle
from oee_tabular.testing.subject import CLAIMS, DEFAULT, Verdict, Verdicts, claims_of

if TYPE_CHECKING:
    from oee_tabular.testing.strategies import horizons, logs, mdp_pairs, mdps, policies

_STRATEGIES = ("horizons", "logs", "mdp_pairs", "mdps", "policies")
# what users find here; what is imported above "as" itself is for other rooms alone
__all__ = [
    "CASES",
    "CLAIMS",
    "DEFAULT",
    "LAWS",
    "Case",
    "OracleComparison",
    "Verdict",
    "Verdicts",
    "as_code",
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
    if name not in _STRATEGIES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    # hypothesis is imported on use
    return getattr(importlib.import_module("oee_tabular.testing.strategies"), name)


def __dir__() -> list[str]:
    return __all__
