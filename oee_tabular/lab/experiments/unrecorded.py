"""Experiment on the interval and the value where pairs were never recorded.

The interval lets pairs that were never recorded differ from the estimate by a factor k:
P / k <= P' <= k P around the rows P = zeta P of the default's fit, in those pairs
alone. Recorded pairs are bound by their counts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from oee_tabular._sparse import row_sums
from oee_tabular.estimators import Estimate, ModelBased, OffEnvironment, Problem
from oee_tabular.exact import occupancy, policy_value, reweight
from oee_tabular.inference.evidence import Evidence, gather, unrecorded_share
from oee_tabular.inference.likelihood import likelihood_ends
from oee_tabular.lab.bench import facts_of
from oee_tabular.lab.bench import families_redrawn, families_unrecorded
from oee_tabular.lab.experiment import Cell, Row, Stream
from oee_tabular.mdp.rows import Rows
from oee_tabular.ratio import Conditional, TransitionRatio
from oee_tabular.ratio.prior.strength import choose_strength
from oee_tabular.typing import Array

FACTORS = (1.0, 2.0, 3.0, 5.0, 10.0)
SPLIT = {**families_redrawn.SPLIT, **families_unrecorded.SPLIT}
FAULTS = tuple(families_unrecorded.SPLIT)
SIZES = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
LEAST_SIZE = 1.0  # of the logs whose intervals are computed


def within_factor(evidence: Evidence, fitted: Array, factor: float) -> Evidence:
    """Return the evidence in which unrecorded rows are within a factor of fitted ones.

    ``fitted`` (entries,) are the fitted rows; recorded rows stay as they are.
    """
    is_open = evidence.rows.spread(evidence.n) == 0
    rows = fitted / evidence.rows.spread(evidence.rows.sums(fitted))
    return replace(
        evidence,
        phat=np.where(is_open, rows, evidence.phat),
        low=np.where(is_open, rows / factor, evidence.low),
        high=np.where(is_open, np.minimum(rows * factor, 1.0), evidence.high),
    )


def parts_of(estimate: Estimate) -> Row:
    """Return the numbers that the default's value is made of."""
    facts = estimate.diagnostics
    names = {
        "ml": "maximum_likelihood_value",
        "model": "model_value",
        "one_step": "one_step_value",
        "se": "one_step_standard_error",
        "unrecorded_se": "unrecorded_standard_error",
        "se_fit": "standard_error_if_centre_fits",
        "moved": "moved",
        "unrecorded": "unrecorded_share",
        "effective": "effective_sample_size",
        "strength": "strength",
    }
    found = {
        name: float(facts.get(given, np.nan))  # type: ignore[arg-type]
        for name, given in names.items()
    }
    return {"value": estimate.value, **found}


def gains(problem: Problem, zeta: TransitionRatio) -> Row:
    """Return by how much the fitted prior's evidence is above the simulator's.

    ``gain`` is at the fitted tilt, ``gain_net`` less what its parameters cost.
    """
    assert zeta._influence is not None
    tilt = zeta._influence.tilt
    rows = zeta._influence.rows
    counts = zeta._influence.counts
    if tilt is None:
        return {"gain": 0.0, "gain_net": 0.0, "strength_simulator": np.nan}
    own = choose_strength(counts, rows.weights, rows)
    fitted = choose_strength(counts, tilt.at(rows), rows)
    blocks, d = tilt.penalty.shape
    hessian = np.zeros((blocks * d, blocks * d))
    hessian[:d, :d] = tilt.covariances.sum(axis=0)
    for a in range(blocks - 1):
        at = slice((1 + a) * d, (2 + a) * d)
        hessian[:d, at] = hessian[at, :d] = hessian[at, at] = tilt.covariances[a]
    penalty = tilt.penalty.reshape(-1)
    theta = tilt.theta[:blocks].reshape(-1)
    scaled = np.eye(len(penalty)) + hessian / np.sqrt(np.outer(penalty, penalty))
    cost = 0.5 * float(penalty @ theta**2) + 0.5 * float(np.linalg.slogdet(scaled)[1])
    gain = fitted.score - own.score
    return {
        "gain": gain,
        "gain_net": gain - cost,
        "strength_simulator": own.strength,
    }


def thickness(problem: Problem, zeta: TransitionRatio, policy: Array) -> Row:
    """Return how many transitions are behind the policy's time in recorded pairs.

    ``thickness`` is the harmonic mean of the counts by squared time, ``thin`` the mean
    of 1 / count by time.
    """
    time = occupancy(reweight(problem.model, zeta), policy, horizon=problem.horizon)
    n = row_sums(problem.counts)
    is_open = np.diff(problem.model.transitions.indptr) > 1
    has_data = (n > 0) & is_open
    d = time.reshape(-1)[has_data]
    n = n[has_data]
    return {
        "thickness": float((d**2).sum() / (d**2 / n).sum()),
        "thin": float((d / n).sum() / d.sum()),
        "recorded_pairs": int(has_data.sum()),
    }


def measure(family: Any, problem: Problem, *, has_intervals: bool) -> Row:
    """Measure value and interval of a family's policy on a log."""
    policy = family.policy
    default = OffEnvironment()
    zeta = default.fit(problem, policy, np.random.default_rng(0))
    estimate = OffEnvironment(ratio=zeta)(problem, policy)
    fixed = OffEnvironment(ratio=Conditional(prior="simulator"))(problem, policy)
    evidence = gather(problem, policy)
    row: Row = {
        **parts_of(estimate),
        "ml": ModelBased(fallback="simulator")(problem, policy).value,
        "simulator": policy_value(
            family.simulator, policy, horizon=family.horizon
        ),
        "value_simulator": fixed.value,
        "model_simulator": float(fixed.diagnostics.get("model_value", np.nan)),
        **gains(problem, zeta),
        "unrecorded_ml": unrecorded_share(evidence),
        "model_one": OffEnvironment(ratio=Conditional(strength=1.0))(
            problem, policy
        ).model_value,
        **thickness(problem, zeta, policy),
    }
    fitted = zeta.values.data * problem.simulator.transitions.data
    kinds = {f"{k:g}": within_factor(evidence, fitted, k) for k in FACTORS}
    kinds["inf"] = evidence
    for name, one in kinds.items():
        low = high = np.nan
        if has_intervals:
            low, high = (end.value for end in likelihood_ends(one, 0.95))
        row |= {f"low_{name}": low, f"high_{name}": high}
    return row


def measure_cell(settings: Cell, stream: Stream) -> list[Row]:
    """Measure both policies of a kind on one log."""
    seed = stream.seed + int(settings["repetition"])
    every = families_unrecorded.families(seed)
    name = str(settings["family"])
    near, far = every[name], every[f"{name}_far"]
    problem = near.problem(near.size(float(settings["size"])), stream.generator())
    rows = []
    for where, family in (("near", near), ("far", far)):
        facts = facts_of(family, problem)
        rows.append(
            {
                "policy": where,
                "families": SPLIT[name],
                "kind": "fault" if name in FAULTS else "ordinary",
                **{key: facts[key] for key in ("n", "truth", "covered", "bound")},
                **measure(
                    family,
                    problem,
                    has_intervals=float(settings["size"]) >= LEAST_SIZE,
                ),
            }
        )
    return rows
