"""A cart with a hanging load, as a user would bring it: are values and intervals right?

    python tests/benchmarks/own_cart.py                       # 20 logs, some ten minutes
    python tests/benchmarks/own_cart.py --kind noise --logs 5
    python tests/benchmarks/own_cart.py --kind quiet --logs 5
    python tests/benchmarks/own_cart.py --kind starts --logs 5

The simulator has no friction and no wind, and a command acts at once. In the target the
wheels rub, gusts push the load, and a command acts two steps later. The policy gives
continuous commands. Its true value comes from 100 000 rollouts in the target. ``noise``
adds sensor noise to the logged states; ``quiet`` records the policy itself from one
start almost without noise; ``starts`` does so from many starts, and writes the first
of them into all episodes, as a recorder that notes the state before a reset.
Such a log is false; where its commands betray the true starts, as in log 3, the value
is too.
"""

import argparse
import time

import numpy as np

import oee_tabular as oee
from oee_tabular.report import Settings, evaluate_continuous
from oee_tabular.tasks import ContinuousTask, Moves

HORIZON = 80
DISCOUNT = 0.99
FORCE = 4.0
STEP = 0.1
N_EPISODES = 60


class Pushed(ContinuousTask):
    """A system that commands push and gusts disturb, and that never ends.

    Its ``push`` returns the next states, its ``reward`` is of these.
    """

    terminates = False
    n_disturbances = 1

    def moves(self, states, actions, disturbance):
        after = self.push(states, self.actions[actions, 0], disturbance[:, 0])
        return Moves(after, self.reward(after), np.zeros(len(states), dtype=bool))

    def reward_between(self, states, actions, next_states):
        return self.reward(next_states)


class HangingLoad(Pushed):
    """A cart that carries a load on a rope of 1 m, and should stop at place 0."""

    name = "hanging load"
    state_names = feature_names = ("place", "speed", "angle", "spin")
    feature_low = np.array([-8.0, -8.0, -3.0, -8.0])
    feature_high = -feature_low
    periodic = (False,) * 4

    def __init__(self, levels=5, friction=0.0, gust=0.0):
        self.actions = np.linspace(-FORCE, FORCE, levels)[:, None]
        self.friction = friction
        self.gust = gust

    def initial_points(self):
        return np.array([[2.0, 0.0, 0.0, 0.0]]), np.ones(1)

    def initial_states(self, n, rng):
        states = np.zeros((n, 4))
        states[:, 0] = 2.0 + 0.3 * rng.standard_normal(n)
        return states

    def push(self, states, commands, gusts):
        """Return the states after a step under commands (n,), in four small steps."""
        place, speed, angle, spin = states.T
        for _ in range(4):
            h = STEP / 4.0
            pull = commands - self.friction * speed
            turning = -9.81 * np.sin(angle) - pull * np.cos(angle) - 0.3 * spin
            speed = speed + h * pull
            spin = spin + h * turning + self.gust * gusts * np.sqrt(h)
            place = place + h * speed
            angle = angle + h * spin
        return np.stack([place, speed, angle, spin], axis=1)

    @staticmethod
    def reward(after):
        return -(after[:, 0] ** 2) - after[:, 2] ** 2


def controller(states):
    """Return the commands of the policy, (n, 1)."""
    gains = np.array([0.6, 1.3, -1.5, -0.3])
    return np.clip(-(states @ gains), -FORCE, FORCE)[:, None]


def run(n, rng, noise_of_commands, gust=0.25, has_one_start=False):
    """Return states (T + 1, n, 4), commands (T, n) and rewards (T, n) in the target."""
    target = HangingLoad(friction=0.4, gust=gust)
    states = target.initial_states(n, rng)
    if has_one_start:
        states[:] = states[0]
    waiting = [np.zeros(n), np.zeros(n)]
    path, given, rewards = [states], [], []
    for _ in range(HORIZON):
        command = controller(states)[:, 0]
        command += noise_of_commands * rng.standard_normal(n)
        command = np.clip(command, -FORCE, FORCE)
        waiting.append(command)
        states = target.push(states, waiting.pop(0), rng.standard_normal(n))
        path.append(states)
        given.append(command)
        rewards.append(target.reward(states))
    return np.array(path), np.array(given), np.array(rewards)


def record(kind, seed):
    """Return a log of the target."""
    rng = np.random.default_rng(seed)
    if kind in ("quiet", "starts"):
        path, commands, rewards = run(
            N_EPISODES, rng, 0.001, gust=0.001, has_one_start=kind == "quiet"
        )
        path[0] = path[0, :1]
    else:
        path, commands, rewards = run(N_EPISODES, rng, 1.5)
    if kind == "noise":
        path = path + rng.standard_normal(path.shape) * [0.03, 0.1, 0.03, 0.1]
    before, after = (
        each.transpose(1, 0, 2).reshape(-1, 4) for each in (path[:-1], path[1:])
    )
    return oee.ContinuousTransitions(
        before,
        commands.T.reshape(-1, 1),
        after,
        rewards.T.ravel(),
        episode=np.repeat(np.arange(N_EPISODES), HORIZON),
    )


def true_value(n=100_000, gust=0.25):
    """Return the policy's value in the target and its standard error."""
    rewards = run(n, np.random.default_rng(10**6), 0.0, gust)[2]
    returns = DISCOUNT ** np.arange(HORIZON) @ rewards
    return float(returns.mean()), float(returns.std() / np.sqrt(n))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--kind", choices=["plain", "noise", "quiet", "starts"], default="plain"
    )
    parser.add_argument("--logs", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="the first log's seed")
    given = parser.parse_args()
    is_quiet = given.kind in ("quiet", "starts")
    truth, error = true_value(gust=0.001 if is_quiet else 0.25)
    print(f"true value {truth:.3f} (standard error {error:.3f})", flush=True)
    values, errors, held = [], [], []
    for seed in range(given.first, given.first + given.logs):
        start = time.process_time()
        report = evaluate_continuous(
            HangingLoad(),
            record(given.kind, seed),
            {"mine": controller},
            horizon=HORIZON,
            discount=DISCOUNT,
            settings=Settings(episodes=4000),
            estimators=["oee"],
            seed=seed,
        )
        first = report.results[0]
        print(
            f"log {seed}: {first.estimator} {first.estimate}; {report.answer}"
            f" [{time.process_time() - start:.0f} s]",
            flush=True,
        )
        estimate = first.estimate
        if estimate.interval is not None:
            lower, upper = estimate.interval
            values.append(estimate.value)
            errors.append(estimate.standard_error)
            held.append(lower <= truth <= upper)
    if values:
        print(
            f"{len(values)} values: mean {np.mean(values):.3f}, error"
            f" {np.mean(values) - truth:.3f}, scatter {np.std(values, ddof=1):.3f}, mean"
            f" standard error {np.mean(errors):.3f}; {sum(held)} intervals hold the truth"
        )


if __name__ == "__main__":
    main()
