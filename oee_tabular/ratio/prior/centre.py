"""The centre of the prior: an average of candidate rows, weighted by what the log says for each.

Candidates: the simulator itself; its tilt by log P, which may vary over the states (``tilt``, ``local_tilt``); its tilts
along V, and along log P and V; and tilts along 1, 2, ... features of the library, each the most telling one beside those
before (``selection``). The evidence of a candidate is that of the counts given Dirichlet(kappa) rows around it, kappa at its
best for each kind of rows, less the size of its parameters (Laplace), less a price for each feature: ``EXPECTED`` nats for one
that theory names beforehand, ``SEARCHED`` for one found by searching, and ``UNSEEN`` times the share of the policies' time in
open rows that the log has never visited (in the simulator; without policies, of those rows), since a feature moves those as
well, on the word of the others. The weights are proportional to the evidence to the power ``TEMPER``.

The three prices and the power were chosen on the families of ``oee bench`` (sizes 0.3 to 30). At 0.3, ``UNSEEN`` 3, 4, 8: the
5% bound of the worst cell is 2.6, 2.2, 1.8 times its reference, the paper's grid .19, .22, .40 of maximum likelihood; prices
of 0 and 1, 3 and 4, and powers of 0.3 to 1 differ by less than 0.02 in the geometric mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from oee_tabular._checks import Array, IntArray
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.rows import Rows
from oee_tabular.ratio.prior.library import SMOOTH, Feature, by_action, columns_of, library, name_of
from oee_tabular.ratio.prior.local_tilt import LocalTilt
from oee_tabular.ratio.prior.neighbours import Neighbours, smooth_functions
from oee_tabular.ratio.prior.selection import Selected, Selection
from oee_tabular.ratio.prior.strength import StrengthChoice, choose_strength, kinds_of_rows
from oee_tabular.ratio.prior.tilt import Tilt
from oee_tabular.ratio.result import Made, Part

EXPECTED, SEARCHED, UNSEEN = 1.0, 3.0, 4.0
ENTRY = 2.0  # nats that a feature must gain to be tried at all
TEMPER = 0.75
LEAST = 1e-3  # weight below which a candidate is left out


def fit_centre(
    observed: Array,
    simulator: FiniteMDP,
    values: Sequence[Array],
    tilt: Tilt | LocalTilt,
    tilt_evidence: float,
    *,
    time: Array | None = None,
    solver: str = "dual",
    log: Log | None = None,
) -> tuple[Part, ...]:
    """The parts of the centre, the heaviest first, for counts on the simulator's entries.

    Parameters
    ----------
    observed : (entries,) counts
    simulator : FiniteMDP
    values : V of the policies that matter, (S,) each
    time : (S*A,) the policies' time in the simulator, None: every row matters alike
    tilt : by log P, of all rows; ``tilt_evidence`` : integral of its likelihood over its parameters, as a logarithm
    solver : "dual", or a cvxpy solver for theta along given features
    log : ``Log.of(observed, simulator, tilt)``, where it is known

    Notes
    -----
    Cost: a few dozen passes over the visited rows with the library's columns, some 20 numbers an entry.
    """
    whole, log = tilt.whole, Log.of(observed, simulator, tilt) if log is None else log
    if log is None:
        return (Part("simulator", 1.0, 0.0, _as_simulated, whole),)
    rows, is_open = log.rows, np.diff(whole.indptr) > 1
    visited = np.zeros(len(whole), dtype=np.bool_)
    visited[rows.number] = True
    matters = np.where(is_open, 1.0 if time is None else time, 0.0)
    unseen = UNSEEN * float(matters[~visited].sum()) / max(float(matters.sum()), 1e-300)
    likelihood = _likelihood(log.counts, log.tilted / rows.weights)
    candidates = [
        _Candidate("simulator", rows.weights, 0.0, _as_simulated, score=log.simulator.score),
        _Candidate(
            "tilt by log P", log.tilted, likelihood - tilt_evidence + EXPECTED + unseen, tilt.at, tilt.information,
            gap=tilt.gap, score=log.tilt_score,
        ),
        *_along_features(log, library(simulator, values, rows, log.levels), simulator, whole, unseen, solver),
    ]  # fmt: skip
    return _averaged(candidates, log, whole)


def _as_simulated(rows: Rows) -> tuple[Array, None]:
    return rows.weights, None


@dataclass(frozen=True, eq=False)
class Log:
    """The visited open rows, their counts and kinds, and their rows under the tilt of all: the same for every policy."""

    rows: Rows
    counts: Array
    kind: IntArray
    tilted: Array
    levels: Array  # the smoothest functions on the simulator's graph, (S, count)

    @classmethod
    def of(
        cls, observed: Array, simulator: FiniteMDP, tilt: Tilt | LocalTilt, graph: Neighbours | None = None
    ) -> Log | None:
        """None where no open row was visited; ``graph`` as in ``smooth_functions``."""
        visited = (tilt.whole.sums(observed) > 0) & (np.diff(tilt.whole.indptr) > 1)
        if not visited.any():
            return None
        rows = tilt.whole.select(visited)
        counts = observed[rows.entries]
        levels = smooth_functions(simulator, SMOOTH, graph)
        return cls(rows, counts, kinds_of_rows(counts, rows), tilt.at(rows)[0], levels)

    def strength(self, model: Array) -> StrengthChoice:
        """kappa around the rows ``model``."""
        return choose_strength(self.counts, model, self.rows, kind=self.kind)

    @cached_property
    def simulator(self) -> StrengthChoice:
        """kappa around the simulator."""
        return self.strength(self.rows.weights)

    @cached_property
    def tilt_score(self) -> float:
        """The evidence of kappa around the tilt."""
        return self.strength(self.tilted).score


@dataclass(frozen=True, eq=False)
class _Candidate:
    """Rows where the log has been, what the parameters cost (nats), how others are made; the evidence, where known."""

    name: str
    model: Array
    cost: float
    at: Made
    information: Any = None
    theta: dict[str, float] = field(default_factory=dict)
    gap: float = 0.0
    counted: Array | None = None
    score: float | None = None


def _likelihood(counts: Array, ratio: Array) -> float:
    """sum n ln zeta, over what was seen."""
    seen = counts > 0
    return float(counts[seen] @ np.log(ratio[seen]))


def _along_features(
    log: Log, features: list[Feature], simulator: FiniteMDP, whole: Rows, unseen: float, solver: str
) -> list[_Candidate]:
    """The tilts along V, along log P and V, and along the features found one after the other."""
    base = np.column_stack([feature.column(log.rows) for feature in features])
    selection = Selection(log.rows, log.counts, base, by_action(features, simulator.n_actions))
    start = log.simulator.by_row
    found = []
    numbers = {feature.name: j for j, feature in enumerate(features)}
    values = [j for name, j in numbers.items() if name.startswith("V") and not features[j].by_deviation]
    for j in values:
        for chosen in ([(j, 0)], [(numbers["log P"], 0), (j, 0)]):
            if all(selection.allowed[part, k] for k, part in chosen):
                first = selection.fit(chosen, start)
                kappa = log.strength(first.model).by_row
                found.append((selection.fit(chosen, kappa, first), kappa))
    price = np.full(selection.allowed.shape, ENTRY)
    path = selection.path(start, price)
    if path:
        kappa = log.strength(path[-1].model).by_row
        found += [(fitted, kappa) for fitted in selection.path(kappa, price)]
    if solver != "dual":
        found = [(selection.by_cvxpy(fitted, kappa, solver), kappa) for fitted, kappa in found]
    candidates = []
    for fitted, kappa in found:
        counted = np.ones(len(whole))
        counted[log.rows.number] = selection.counted(kappa)
        candidates.append(_of_features(fitted, selection.scale, counted, features, whole, unseen))
    return candidates


def _of_features(
    fitted: Selected, scale: Array, counted: Array, features: list[Feature], whole: Rows, unseen: float
) -> _Candidate:
    """A tilt along chosen features as a candidate."""

    def at(rows: Rows) -> tuple[Array, Array]:
        columns = columns_of(fitted.chosen, lambda j: features[j].column(rows), scale, rows.spread(rows.action))
        model, _ = rows.tilt(columns @ fitted.theta)
        return model, columns - rows.spread(rows.mean(model, columns))

    names = [name_of(chosen, features) for chosen in fitted.chosen]
    price = sum(EXPECTED if features[j].expected and part == 0 else SEARCHED for j, part in fitted.chosen)
    scales = [scale[part, j] for j, part in fitted.chosen]
    theta = {name: float(t / size) for name, t, size in zip(names, fitted.theta, scales, strict=True)}
    cost = fitted.size + price + unseen * len(names)
    return _Candidate(" + ".join(names), fitted.model, cost, at, fitted.information, theta, fitted.gap, counted)


def _averaged(candidates: list[_Candidate], log: Log, whole: Rows) -> tuple[Part, ...]:
    """The average by evidence to the power ``TEMPER``; the same features in another order count once."""
    first = {frozenset(c.theta) or c.name: c for c in reversed(candidates)}
    distinct = {c.name: c for c in reversed(first.values())}
    scores = {name: log.strength(c.model).score if c.score is None else c.score for name, c in distinct.items()}
    evidence = {name: scores[name] - c.cost for name, c in distinct.items()}
    evidence = {name: e for name, e in evidence.items() if np.isfinite(e)}  # not so of a fit that rounding has broken
    best = max(evidence.values())
    weights = {name: float(np.exp(TEMPER * (e - best))) for name, e in evidence.items()}
    total = sum(weights.values())
    kept = {name: w / total for name, w in weights.items() if w >= LEAST * total}
    total = sum(kept.values())
    return tuple(
        Part(name, w / total, evidence[name], c.at, whole, c.information, c.theta, c.gap, c.counted)
        for name, w in sorted(kept.items(), key=lambda item: -item[1])
        for c in [distinct[name]]
    )
