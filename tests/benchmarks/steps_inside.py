"""How far ends are followed inside the set of models: are more steps worth their time?

    python tests/benchmarks/steps_inside.py                  # 240 problems, six minutes
    python tests/benchmarks/steps_inside.py --problems 40

With a horizon J, and with any horizon a gain, may be least inside the set of models, and
an end that is found there takes steps until its gradient promises little. Each problem
is drawn anew: two to four states, few transitions, policies that are certain. Its ends
are sought with several limits of these steps, and compared with those of four times the
steps, a hundredth of the promise and ten times the work. Problems with even seeds are
those by which the limits are chosen; odd ones are kept aside.
"""

import argparse
import itertools
import time
from unittest import mock

import numpy as np

import oee_tabular as oee
from oee_tabular.inference import profile_ascent
from oee_tabular.inference.gain import Gain

NAMES = ("MAX_STEPS_INSIDE", "LEAST_PROMISED", "MAX_INSIDE_WORK")
OWN = tuple(getattr(profile_ascent, name) for name in NAMES)
MOST = (4 * OWN[0], OWN[1] / 100.0, 10 * OWN[2])
MISSED = 1e-4  # of the width: an end that is nearer by more counts


def settings():
    """Yield the package's own limits, and others that differ in one."""
    yield OWN
    for steps in (5, 10, 20, 80):
        yield steps, *OWN[1:]
    for promised in (1e-2, 1e-3, 1e-5):
        yield OWN[0], promised, OWN[2]
    for work in (OWN[2] // 10, OWN[2] * 10):
        yield *OWN[:2], work


def draw_problem(seed):
    """Return a simulator, a log, two policies, a horizon and a factor."""
    rng = np.random.default_rng([2026, seed])
    n_states, n_actions = int(rng.integers(2, 5)), int(rng.integers(2, 4))
    P = np.zeros((n_states, n_actions, n_states))
    for s, a in np.ndindex(n_states, n_actions):
        n_next = int(rng.integers(1, min(3, n_states) + 1))
        to = rng.choice(n_states, n_next, replace=False)
        P[s, a, to] = rng.dirichlet(np.ones(n_next))
    rewards = rng.integers(-5, 6, size=P.shape).astype(float)
    simulator = oee.FiniteMDP(P, rewards, np.eye(n_states)[0], rng.choice([0.9, 0.99]))
    n = int(rng.integers(1, 16))
    state, action = rng.integers(0, n_states, n), rng.integers(0, n_actions, n)
    pairs = zip(state, action, strict=True)
    after = [rng.choice(n_states, p=P[s, a]) for s, a in pairs]
    log = oee.Transitions(state, action, after)
    policies = np.eye(n_actions)[rng.integers(0, n_actions, (2, n_states))]
    factor = float(rng.choice([1.0, 3.0, np.inf]))
    return simulator, log, policies, int(rng.integers(2, 9)), factor


def find_ends(problem):
    """Return ends, with the width of their interval, that limits are asked about."""
    simulator, log, (policy, running), horizon, factor = problem
    ends = []
    for steps in (horizon, None):
        given = oee.Problem(simulator, log, horizon=steps)
        if steps is not None:
            found = oee.interval(given, policy, unrecorded=factor)
            ends += [(-found.lower, found.width), (found.upper, found.width)]
        pairs = ((policy, running), (running, policy))
        gains = [
            Gain(given, given, *pair, 0.95, (None, None), factor).lower
            for pair in pairs
            if not np.array_equal(*pair)
        ]
        # the lower end of one gain is the upper end of the other
        ends += [(-gain, -sum(gains)) for gain in gains]
    return ends


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--problems", type=int, default=240)
    asked = parser.parse_args()
    tried = list(settings())
    nearer = {key: [] for key in itertools.product(tried, (0, 1))}
    seconds = dict.fromkeys(tried, 0.0)
    for seed in range(asked.problems):
        problem = draw_problem(seed)
        found = {}
        for limits in (*tried, MOST):
            begun = time.process_time()
            values = dict(zip(NAMES, limits, strict=True))
            with mock.patch.multiple(profile_ascent, **values):
                found[limits] = find_ends(problem)
            if limits in seconds:
                seconds[limits] += time.process_time() - begun
        for limits in tried:
            pairs = zip(found[MOST], found[limits], strict=True)
            nearer[limits, seed % 2] += [
                (most - end) / width
                for (most, width), (end, _) in pairs
                if width > 1e-9
            ]
    print("steps, promised, work: ends that come nearer (most of the width), seconds")
    for limits in tried:
        parts = []
        for name, kept in (("to choose", 0), ("kept aside", 1)):
            short = np.array([*nearer[limits, kept], 0.0])
            count = int((short > MISSED).sum())
            parts.append(f"{name} {count} of {len(short) - 1} ({short.max():.1e})")
        mark = " (the package's)" if limits == OWN else ""
        print(f"{limits}: {', '.join(parts)}, {seconds[limits]:.0f}{mark}")


if __name__ == "__main__":
    main()
