"""Results that the playground page shows: one run of ``evaluate`` for each setting.

PYTHONPATH=. python notebooks/playground.py --output notebooks/static/playground_results.js

The page is ``playground.md``, its script ``static/playground.js``. A setting is the slip
of the simulator, the slip of the target, the number of transitions, and the policy. Log
k of a target is drawn with seed k. It is the same for every simulator and policy, and a
smaller log is its beginning.
"""

import argparse
import datetime
import functools
import itertools
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import oee_tabular as oee
from oee_tabular import _files
from oee_tabular.lab.run import code_version

SIZE = 5
SLIPS = (0.0, 0.1, 0.2, 0.3)
COUNTS = (300, 1000, 3000, 10_000)  # of transitions in a log
SHARES = (0.0, 0.5, 1.0)  # of the expert in the policy; the rest is uniform
N_LOGS = 20
N_EPISODES = 300  # of the uniform policy, which a log is drawn from
MAX_STEPS = 10_000
CONFIDENCE = 0.95
# Slip 0 makes nearly every log impossible. This is the first remedy that the error names.
ACTION_NOISE = 0.01
N_DECIMALS = 4
# A page on a disk may not fetch a file, but it may load a script.
BEFORE = "window.playgroundResults = "
AFTER = ";\n"


@functools.cache
def grid(slip: float) -> oee.FiniteMDP:
    """Make the gridworld with a slip."""
    return oee.tasks.gridworld(SIZE, slip)


def believed_grid(slip: float) -> oee.FiniteMDP:
    """Make the simulator with a slip, which allows what a log may contain."""
    mdp = grid(slip)
    return mdp if slip else mdp.with_action_noise(ACTION_NOISE)


def policies() -> dict[str, np.ndarray]:
    """Make the evaluated policies, by the share of the expert."""
    return {
        f"{share:.0%} expert": oee.tasks.gridworld_policy(SIZE, share)
        for share in SHARES
    }


@functools.cache
def episodes(slip: float, seed: int) -> oee.Transitions:
    """Sample the episodes of a target that a log is drawn from."""
    target = grid(slip)
    return oee.sample_episodes(
        target, oee.uniform_policy(target), N_EPISODES, MAX_STEPS, seed=seed
    )


def draw_log(slip: float, count: int, seed: int) -> oee.Transitions:
    """Draw a log of a target. A smaller log of the same seed is its beginning."""
    return episodes(slip, seed).draw(count, seed=seed)


def evaluate_log(
    simulator_slip: float, target_slip: float, count: int, seed: int
) -> list[list[float]]:
    """Evaluate every policy on one log: value, lower end and upper end of each."""
    log = draw_log(target_slip, count, seed)
    problem = oee.Problem(believed_grid(simulator_slip), log)
    report = oee.evaluate(
        problem, policies(), estimators="oee", confidence=CONFIDENCE, seed=seed
    )
    rows = report.table[["value", "lower", "upper"]].to_numpy()
    return rows.round(N_DECIMALS).tolist()


def exact_values() -> list[list[float]]:
    """Compute the value of every policy at every slip."""
    return [
        [
            round(oee.policy_value(grid(slip), policy), N_DECIMALS)
            for policy in policies().values()
        ]
        for slip in SLIPS
    ]


def compute() -> dict[str, object]:
    """Compute everything that the page needs."""
    shape = (len(SLIPS), len(SLIPS), len(COUNTS), len(SHARES), N_LOGS, 3)
    logs = np.empty(shape)
    axes = (range(len(SLIPS)), range(len(SLIPS)), range(len(COUNTS)), range(N_LOGS))
    for i, j, k, seed in itertools.product(*axes):
        logs[i, j, k, :, seed] = evaluate_log(SLIPS[i], SLIPS[j], COUNTS[k], seed)
    return {
        "version": code_version(),
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "size": SIZE,
        "discount": grid(SLIPS[0]).discount,
        "expert": oee.tasks.gridworld_expert(SIZE).argmax(axis=1).tolist(),
        "slips": SLIPS,
        "counts": COUNTS,
        "shares": SHARES,
        "confidence": CONFIDENCE,
        "values": exact_values(),  # [slip][policy]
        # [slip of the simulator][of the target][count][policy][seed]: value, interval
        "logs": logs.tolist(),
    }


def read_results(path: Path) -> dict[str, object]:
    """Read the file that this command writes."""
    text = path.read_text(encoding="utf-8")
    return json.loads(text.removeprefix(BEFORE).removesuffix(AFTER))


def covered(results: dict[str, object]) -> np.ndarray:
    """Say which intervals cover; axes as those of ``logs``, without the last."""
    logs = np.asarray(results["logs"])
    truth = np.asarray(results["values"])[None, :, None, :, None]
    # an end is rounded, and so is the truth
    slack = 10.0**-N_DECIMALS
    return (logs[..., 1] <= truth + slack) & (truth <= logs[..., 2] + slack)


def main(arguments: Sequence[str] | None = None) -> None:
    """Compute the results, write the file, and print how often the intervals cover."""
    parser = argparse.ArgumentParser(description="Results of the playground page.")
    parser.add_argument("--output", type=Path, required=True, help="a file .js")
    parser.add_argument("--overwrite", action="store_true")
    given = parser.parse_args(arguments)
    output = _files.new_file(
        given.output, "--output", overwrite=given.overwrite, endings=(".js",)
    )
    results = compute()
    text = BEFORE + json.dumps(results, separators=(",", ":")) + AFTER
    with output.writing(), _files.whole_file(given.output) as handle:
        handle.write(text.encode())
    found = covered(results)
    print(f"{found.sum()} of {found.size} intervals cover ({found.mean():.1%})")
    for count, share in zip(COUNTS, found.mean(axis=(0, 1, 3, 4)), strict=True):
        print(f"{count} transitions: {share:.1%}")


if __name__ == "__main__":
    main()
