"""False first rows of episodes: how often are they seen, and how often cried of wrongly?

    python tests/benchmarks/first_rows.py                # 160 logs, a quarter of an hour
    python tests/benchmarks/first_rows.py --logs 40

A recorder that notes the state before a reset writes a false first row into each
episode. The package says so where first rows make more than half of what a correction
leaves unexplained, their mean square is more than 10 times that of second rows, and at
least 5 of them are as large. Each log here is of a system drawn anew: a cart with a
hanging load, or a chain of masses and springs with a friction that the simulator lacks;
its noise, delay, length, number of episodes and spread of starts are drawn as well. Of
each log there is a true version and three false ones. Even seeds are those by which other
thresholds are compared; odd ones are kept aside.
"""

import argparse
import itertools
import sys
from pathlib import Path
from unittest import mock

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import oee_tabular as oee
from benchmarks.own_cart import HangingLoad, Pushed
from oee_tabular.continuous.correction import residual, starts
from oee_tabular.continuous.correction.choice import choose_correction

KINDS = ("true", "last of the episode before", "one start for all", "zeros")
SHARES, RATIOS, NUMBERS = (0.3, 0.5, 0.7), (5.0, 10.0, 20.0), (3, 5, 10)


class Chain(Pushed):
    """Masses on a line between springs; a command pushes the first one."""

    name = "chain"
    periodic: tuple[bool, ...]

    def __init__(self, n_masses=1, stiffness=1.0, friction=0.0, gust=0.0):
        kinds = ("place", "speed")
        names = [f"{kind}_{k}" for k in range(n_masses) for kind in kinds]
        self.state_names = self.feature_names = tuple(names)
        self.feature_low = np.full(2 * n_masses, -10.0)
        self.feature_high = -self.feature_low
        self.periodic = (False,) * 2 * n_masses
        self.actions = np.linspace(-1.0, 1.0, 5)[:, None]
        self.stiffness, self.friction, self.gust = stiffness, friction, gust

    def initial_points(self):
        return np.ones((1, len(self.state_names))), np.ones(1)

    def initial_states(self, n, rng):
        return 1.0 + 0.3 * rng.standard_normal((n, len(self.state_names)))

    def push(self, states, commands, gusts):
        """Return the states after a step under commands (n,)."""
        place, speed = states[:, ::2].copy(), states[:, 1::2].copy()
        for _ in range(4):
            ends = np.pad(place, ((0, 0), (1, 1)))
            force = self.stiffness * (ends[:, 2:] - 2.0 * place + ends[:, :-2])
            force -= self.friction * speed * (1.0 + np.abs(speed))
            force[:, 0] += 2.0 * commands
            speed = speed + 0.025 * force
            speed[:, -1] += self.gust * gusts * np.sqrt(0.025)
            place = place + 0.025 * speed
        return np.stack([place, speed], axis=2).reshape(states.shape)

    @staticmethod
    def reward(after):
        return -(after**2).sum(axis=1)


def draw_systems(rng):
    """Return a simulator and a target that differs from it."""
    friction, gust = rng.uniform(0.05, 0.6), rng.choice([0.001, 0.02, 0.25])
    if rng.random() < 0.5:
        return HangingLoad(), HangingLoad(friction=friction, gust=gust)
    known = {"n_masses": int(rng.integers(1, 4)), "stiffness": rng.uniform(0.3, 3.0)}
    return Chain(**known), Chain(**known, friction=friction, gust=gust)


def record(seed):
    """Return a simulator, and the arrays of a log of its target."""
    rng = np.random.default_rng(seed)
    simulator, target = draw_systems(rng)
    n_episodes, n_steps = int(rng.integers(6, 60)), int(rng.integers(10, 80))
    n_late = int(rng.integers(0, 3))
    spread, noise = rng.choice([0.1, 1.0]), rng.choice([0.001, 0.1, 1.0])
    states = target.initial_states(n_episodes, rng)
    states = states.mean(axis=0) + spread * (states - states.mean(axis=0))
    largest = target.actions.max()
    gains = rng.uniform(0.1, 0.6) * np.resize([1.0, 1.5], states.shape[1])
    waiting = [np.zeros(n_episodes)] * n_late
    path, given = [states], []
    for _ in range(n_steps):
        command = -(states @ gains) + noise * largest * rng.standard_normal(n_episodes)
        command = np.clip(command, -largest, largest)
        waiting = [*waiting, command]
        gusts = rng.standard_normal(n_episodes)
        states = target.push(states, waiting[0], gusts)
        waiting = waiting[1:]
        path.append(states)
        given.append(command)
    return simulator, np.array(path), np.array(given)


def log_of(path, given, kind):
    """Return a log of states (T + 1, n, d) and commands, with first rows of a kind."""
    before = path[:-1].copy()
    if kind == "last of the episode before":
        before[0, 1:] = path[-1, :-1]
    elif kind == "one start for all":
        before[0] = path[0, :1]
    elif kind == "zeros":
        before[0] = 0.0
    n_steps, n_episodes = given.shape
    rows = [
        each.transpose(1, 0, 2).reshape(n_steps * n_episodes, -1)
        for each in (before, path[1:])
    ]
    episode = np.repeat(np.arange(n_episodes), n_steps)
    return oee.ContinuousTransitions(
        rows[0],
        given.T.reshape(-1, 1),
        rows[1],
        np.zeros(len(episode)),
        episode=episode,
    )


def ask_of(simulator, log):
    """Return what a correction of the simulator asks ``odd_starts`` about a log."""
    asked = []

    def listen(*arguments):
        asked.append(arguments)
        return np.zeros(arguments[1].shape[1])

    with mock.patch.object(residual, "odd_starts", listen):
        choose_correction(simulator, log, history=0)
    return asked[0]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=160)
    given = parser.parse_args()
    used = starts.MIN_SHARE, starts.MIN_RATIO, starts.MIN_EPISODES
    choices = [used, *itertools.product(SHARES, RATIOS, NUMBERS)]
    said = np.zeros((2, len(KINDS), len(choices)))
    number = np.zeros(2)
    for seed in range(given.logs):
        simulator, path, commands = record(seed)
        number[seed % 2] += 1
        for k, kind in enumerate(KINDS):
            log = log_of(path, commands, kind)
            asked = ask_of(simulator, log)
            for c, thresholds in enumerate(choices):
                starts.MIN_SHARE, starts.MIN_RATIO, starts.MIN_EPISODES = thresholds
                said[seed % 2, k, c] += starts.odd_starts(*asked).any()
            starts.MIN_SHARE, starts.MIN_RATIO, starts.MIN_EPISODES = used
    print("share, ratio, episodes: false first rows said of, in % of logs")
    print("compared | kept aside: " + ", ".join(KINDS))
    shares = said / number[:, None, None]
    for c, thresholds in enumerate(choices):
        texts = [" ".join(f"{x:4.0%}" for x in shares[half, :, c]) for half in (0, 1)]
        mark = "  (used)" if c == 0 else ""
        print(f"{thresholds}: {' | '.join(texts)}{mark}")


if __name__ == "__main__":
    main()
