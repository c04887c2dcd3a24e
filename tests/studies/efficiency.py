"""The asymptotic variances of the plug-in and of the paper's ratio of ratios, against simulation. Run by hand.

    python tests/studies/efficiency.py              writes tests/studies/efficiency.csv and prints it

5 x 5 grid, slip 0.3 simulated, 0.1 real, discount 0.95, infinite horizon, the policy half expert and half uniform; n = 1e5 rows
drawn uniformly over (s, a) from the target, and as many from the simulator for the ratio of ratios; 20 000
repetitions. ``exact`` is ``efficiency_bound`` for the plug-in (the maximum-likelihood model) and
``ratio_of_ratios_variance`` for the others, both multiplied by nothing: n * variance of J, a discounted sum.
"""

from pathlib import Path

import numpy as np
import pandas as pd

import oee_tabular as oee
from oee_tabular.exact import ratio_of_ratios_variance

N, REPETITIONS, CHUNK = 100_000, 20_000, 500
TABLE = Path(__file__).with_name("efficiency.csv")


def dense(mdp):
    """(S, A, S)."""
    return mdp.transitions.toarray().reshape(mdp.n_states, mdp.n_actions, mdp.n_states)


def study(repetitions=REPETITIONS, n=N, seed=0):
    """One row for each estimator."""
    simulator = oee.tasks.gridworld(5, 0.3, discount=0.95)
    target = oee.tasks.gridworld(5, 0.1, discount=0.95)
    policy = oee.mix(oee.tasks.gridworld_expert(5), oee.uniform_policy(target), 0.5)
    share = np.full((25, 4), 0.01)
    p, q = dense(target), dense(simulator)
    rng = np.random.default_rng(seed)
    reward = simulator.transition_rewards.toarray().reshape(q.shape)  # r(s, a, s'), known
    values = {"plug-in": [], "ratio of ratios": [], "ratio of ratios, rows normalised": []}
    for _ in range(repetitions // CHUNK):
        ours, theirs = (
            rng.multinomial(n, (share[:, :, None] * rows).reshape(-1), size=CHUNK).reshape(CHUNK, *rows.shape)
            for rows in (p, q)
        )
        likelihood = ours / ours.sum(axis=3, keepdims=True)
        moves = np.divide(ours, theirs, out=np.zeros(ours.shape), where=theirs > 0)
        kernel = moves * (theirs.sum(axis=3) / ours.sum(axis=3))[..., None] * q
        normalised = kernel / kernel.sum(axis=3, keepdims=True)
        for name, rows in zip(values, (likelihood, kernel, normalised), strict=True):
            system = np.eye(25) - 0.95 * np.einsum("sa,nsat->nst", policy, rows)
            paid = np.einsum("sa,nsat,sat->ns", policy, rows, reward)
            values[name].append(np.linalg.solve(system, paid[..., None])[..., 0] @ target.initial)
    arguments = (simulator, target, policy, share, share)
    exact = {
        "plug-in": oee.efficiency_bound(target, policy, share),
        "ratio of ratios": ratio_of_ratios_variance(*arguments),
        "ratio of ratios, rows normalised": ratio_of_ratios_variance(*arguments, rows="normalised"),
    }
    rows = []
    for name, parts in values.items():
        found = n * np.concatenate(parts).var()
        rows.append({"estimator": name, "simulated": found, "exact": exact[name], "ratio": found / exact[name],
                     "n": n, "repetitions": repetitions})  # fmt: skip
    return pd.DataFrame(rows)


if __name__ == "__main__":
    table = study()
    table.to_csv(TABLE, index=False, float_format="%.6g")
    print(table.to_string(index=False))
