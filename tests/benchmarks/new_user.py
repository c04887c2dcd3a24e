"""What a new user decides: a running policy, a log of it, and nine of twelve successes.

    python tests/benchmarks/new_user.py               # ten redraws, some seconds each
    python tests/benchmarks/new_user.py --redraws 2

A floor of 5 x 5 cells that is to be crossed within ten steps; steps slip less than
simulated. The running policy recorded 40 episodes. Each redraw draws the log anew, and
twelve trials of the policy that ``oee.improve`` proposes. What is decided is compared
with the exact values in the target, and so is the interval of log and trials together.
"""

import argparse
import time
import warnings

import numpy as np

import oee_tabular as oee

HORIZON = 10
N_TRIALS = 12
N_EPISODES = 40
GOAL = 24


def decide(seed, share, slips):
    """Return what one redraw decides, beside the truth."""
    simulated, real = slips
    simulator = oee.tasks.gridworld(5, slip=simulated).with_initial(0)
    target = oee.tasks.gridworld(5, slip=real).with_initial(0)
    reach, truth = (
        oee.data.success_simulator(model, GOAL) for model in (simulator, target)
    )
    expert = oee.tasks.gridworld_expert(5)
    running = oee.mix(expert, oee.uniform_policy(simulator), share)
    log = oee.sample_episodes(target, running, N_EPISODES, HORIZON, seed=seed)
    log = oee.Transitions(**log.columns() | {"reward": None})
    begin = time.perf_counter()
    problem = oee.Problem(reach, log, horizon=HORIZON)
    found = oee.improve(problem, running, seed=seed)
    values = [
        oee.policy_value(truth, policy, horizon=HORIZON)
        for policy in (running, found.policy)
    ]
    rng = np.random.default_rng((seed, 12))
    successes = int(rng.binomial(N_TRIALS, values[1]))
    joined = oee.Problem(
        reach,
        log,
        horizon=HORIZON,
        trials=oee.Trials.from_successes(successes, N_TRIALS),
    )
    report = oee.evaluate(joined, {"proposed": found.policy}, seed=seed)
    row = report.table.set_index("estimator").loc["oee+trials"]
    gain = values[1] - values[0]
    return {
        "decision": found.decision,
        "is_right": gain > -1e-9 if found.deploy else True,
        "gain": gain,
        "certified": found.gain_lower,
        "successes": successes,
        "covers": row["lower"] - 1e-9 <= values[1] <= row["upper"] + 1e-9,
        "seconds": time.perf_counter() - begin,
    }


def main():
    """Print each redraw, and their counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--redraws", type=int, default=10)
    parser.add_argument("--share", type=float, default=0.6, help="of the expert")
    parser.add_argument("--slips", type=float, nargs=2, default=(0.3, 0.15))
    given = parser.parse_args()
    rows = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for seed in range(given.redraws):
            row = decide(seed, given.share, given.slips)
            rows.append(row)
            print(
                f"{seed}: {row['decision']}, {row['successes']} of {N_TRIALS}; gain"
                f" {row['gain']:.3f}, certified {row['certified']:.3f};"
                f" covered {row['covers']}; {row['seconds']:.1f} s",
                flush=True,
            )
    deployed = [row for row in rows if row["decision"] == "deploy"]
    print(
        f"{len(deployed)} of {len(rows)} deploy,"
        f" {sum(row['is_right'] for row in rows)} decisions are right,"
        f" {sum(row['gain'] >= row['certified'] - 1e-9 for row in rows)} gains are above"
        f" what was certified, {sum(row['covers'] for row in rows)} intervals of log and"
        " trials hold the truth"
    )


if __name__ == "__main__":
    main()
