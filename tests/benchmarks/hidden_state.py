"""Hidden state and fitted parameters on tasks that nothing was tuned for.

``python tests/benchmarks/hidden_state.py [LOGS [VALUES [parameters|hidden|alarms]]]``: logs of each
task, and on how many of them values are computed.

Delays and lags of the motor, sensor noise: is it said, is the lag named, what is the error of the value in front for a policy
near and one far from the log's. False alarms on Markov targets. Parameters by least squares, where the structure is right and
where it is not. About 25 minutes on one core with ten logs of each.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import gymnasium
import numpy as np
from scipy.special import ndtr

from oee_tabular.continuous.correction import choose_correction
from oee_tabular.continuous.episodes import paired_returns
from oee_tabular.continuous.parameters import fit_parameters, parameters_of
from oee_tabular.continuous.task import DerivedTask, Moves
from oee_tabular.data import ContinuousTransitions
from oee_tabular.lab.robots.changes import classic
from oee_tabular.tasks import CartPole, ResidualSimulator, cartpole_policy, gymnasium_simulator, record

NONE = -99.0  # no command yet


class Hidden(DerivedTask):
    """A task with coordinates behind its own that no log shows."""

    def __init__(self, task, extra):
        super().__init__(task, f"{task.name}, hidden")
        self.state_names = (*task.state_names, *(f"hidden_{k}" for k in range(extra)))

    def own(self, states):
        return np.ascontiguousarray(states[:, : self.task.n_state])

    def initial_states(self, n, rng):
        own = self.task.initial_states(n, rng)
        return np.column_stack([own, np.full((n, self.n_state - own.shape[1]), NONE)])


class Delay(Hidden):
    """Does what was asked some steps ago, at first as asked; the hidden coordinates are the last commands."""

    def moves(self, states, actions, disturbance):
        last = states[:, self.task.n_state :]
        done = np.where(last[:, -1] == NONE, actions, last[:, -1]).astype(np.int64)
        moved = self.task.moves(self.own(states), done, disturbance)
        return Moves(np.column_stack([moved.next_state, actions, last[:, :-1]]), moved.reward, moved.terminated)


class Lag(Hidden):
    """CartPole with a force u <- lag u + (1 - lag) a, at first 0."""

    def __init__(self, task, lag):
        super().__init__(task, 1)
        self.lag = lag

    def moves(self, states, actions, disturbance):
        own, force = self.own(states), states[:, -1]
        force = self.lag * np.where(force == NONE, 0.0, force) + (1.0 - self.lag) * self.actions[actions]
        ends = [self.task.moves(own, np.full(len(own), a), disturbance).next_state for a in (0, 1)]
        share = ((force - self.actions[0]) / (self.actions[1] - self.actions[0]))[:, None]
        following = ends[0] * (1.0 - share) + ends[1] * share  # a step is linear in the force
        return Moves(np.column_stack([following, force]), np.ones(len(own)), self.task.terminated(following))


class SensorNoise(Hidden):
    """The hidden coordinates are the state; what is shown has noise on it."""

    def __init__(self, task, deviation):
        super().__init__(task, task.n_state)
        self.deviation, self.n_disturbances = deviation, task.n_disturbances + task.n_state

    def initial_states(self, n, rng):
        own = self.task.initial_states(n, rng)
        return np.column_stack([own + self.deviation * rng.standard_normal(own.shape), own])

    def moves(self, states, actions, disturbance):
        d, k = self.task.n_state, self.task.n_disturbances
        moved = self.task.moves(np.ascontiguousarray(states[:, d:]), actions, disturbance[:, :k])
        shown = moved.next_state + self.deviation * disturbance[:, k:]
        return Moves(np.column_stack([shown, moved.next_state]), moved.reward, moved.terminated)


class RandomActions(DerivedTask):
    """A share of the actions is any."""

    def __init__(self, task, share):
        super().__init__(task, f"{task.name}, random actions")
        self.share, self.n_disturbances = share, task.n_disturbances + 2

    def moves(self, states, actions, disturbance):
        uniform = ndtr(disturbance[:, -2:])
        anything = (uniform[:, 0] * self.n_actions).astype(np.int64)
        done = np.where(uniform[:, 1] < self.share, anything, actions)
        return self.task.moves(states, done, disturbance[:, :-2])


@dataclass(frozen=True)
class Cogging(classic.Pendulum):
    """A torque that depends on the angle, and dry friction."""

    cogging: float = 0.3
    dry: float = 0.3

    def moves(self, states, actions, disturbance):
        moved = super().moves(states, actions, disturbance)
        torque = self.cogging * np.sin(4.0 * states[:, 0]) + self.dry * np.tanh(10.0 * states[:, 1])
        speed = np.clip(moved.next_state[:, 1] - 0.15 * torque, -8.0, 8.0)
        return Moves(np.column_stack([states[:, 0] + 0.05 * speed, speed]), moved.reward, moved.terminated)


class Drag(classic.MountainCar):
    """Air that brakes."""

    def moves(self, states, actions, disturbance):
        place, speed = states.T
        faster = speed + self.actions[actions] * self.force - np.cos(3.0 * place) * self.gravity
        faster = np.clip(faster - 2.0 * speed * np.abs(speed), -0.07, 0.07)
        place = np.clip(place + faster, -1.2, 0.6)
        following = np.column_stack([place, np.where((place == -1.2) & (faster < 0), 0.0, faster)])
        return Moves(following, np.full(len(states), -1.0), self.terminated(following))


def shown(log, d):
    """The log without the hidden coordinates."""
    columns = log.columns()
    return ContinuousTransitions(**(columns | {k: columns[k][:, :d] for k in ("state", "next_state")}))


def of_own(policy, d):
    return lambda states: policy(np.ascontiguousarray(states[:, :d]))


def value(task, policy, episodes, horizon, scale):
    seed = np.random.SeedSequence(1)
    return scale * paired_returns(task, policy, episodes, horizon, discount=0.99, seed=seed).mean()


def study_hidden_state(n_logs, n_values):
    simulator, said, named = CartPole(10.0), 0, 0
    targets = {f"delay {k}": (Delay(simulator, k), k) for k in (1, 2, 3)}
    targets |= {f"lag {lag}": (Lag(simulator, lag), 0) for lag in (0.3, 0.5, 0.7)}
    targets["sensor noise"] = SensorNoise(simulator, 0.01), 0
    for name, (target, lag) in targets.items():
        errors, steps, trusted, found = [], [], [], [0, 0]
        policies = [of_own(cartpole_policy(delta), 4) for delta in (0.2, 0.8)]
        truths = [value(target, policy, 4000, 100, 0.01) for policy in policies]
        for seed in range(n_logs):
            log = shown(
                record(target, of_own(cartpole_policy(0.3), 4), n_transitions=10_000, max_steps=100, seed=seed), 4
            )
            plain = ResidualSimulator(simulator, log, seed=0)
            hidden = [c.history for c in plain.coordinates if c.hidden]
            found[0] += bool(hidden)
            best = max(hidden, key=lambda effect: effect.lag_r_squared, default=None)
            found[1] += best is not None and (best.lag, best.of) == (lag, "action")
            if seed >= n_values:
                continue
            chosen = choose_correction(simulator, log, seed=0)
            front = chosen.learned if chosen.is_trusted else simulator
            errors.append([value(front, p, 4000, 100, 0.01) - truth for p, truth in zip(policies, truths, strict=True)])
            steps.append(chosen.steps)
            trusted.append(chosen.is_trusted)
        said, named = said + found[0] * (name != "sensor noise"), named + found[1]
        near, far = np.abs(errors).mean(axis=0)
        before = [value(simulator, p, 4000, 100, 0.01) - truth for p, truth in zip(policies, truths, strict=True)]
        print(
            f"{name}: said {found[0]} of {n_logs}, lag named {found[1]}, steps {steps}, trusted {sum(trusted)} of {n_values}; "
            f"mean |error| near {near:.4f} far {far:.4f} (simulator {before[0]:+.4f} {before[1]:+.4f})",
            flush=True,
        )
    print(f"delays and lags: said {said} of {6 * n_logs}, lag named {named} of {3 * n_logs}", flush=True)


def uniform(task):
    return lambda states: np.full((len(states), task.n_actions), 1.0 / task.n_actions)


def balancing(task):
    """InvertedPendulum: towards the upright pole, three tenths at random."""
    commands = task.actions.ravel()

    def policy(states):
        wanted = np.clip(states @ [1.0, 20.0, 1.5, 3.0], commands.min(), commands.max())
        nearest = np.abs(wanted[:, None] - commands).argmin(axis=1)
        return 0.7 * np.eye(len(commands))[nearest] + 0.3 / len(commands)

    return policy


def study_false_alarms(n_logs, _):
    alarms = 0
    cases = {
        "Pendulum with cogging": (classic.Pendulum(), Cogging(), classic.swinging(0.3), 200),
        "MountainCar with drag": (classic.MountainCar(), Drag(), classic.rocking(0.3), 200),
        "CartPole, 10% random actions": (CartPole(10.0), RandomActions(CartPole(10.0), 0.1), cartpole_policy(0.3), 100),
    }
    for name, levels, steps in (("InvertedPendulum-v5", 9, 100), ("Reacher-v5", 3, 50), ("Hopper-v5", 2, 200)):
        model = gymnasium.make(name).unwrapped.model
        physics = {"body_mass": 1.3 * model.body_mass, "dof_damping": 1.5 * model.dof_damping + 0.02}
        text = ",".join(f"{key}={x.tolist()}".replace(" ", "") for key, x in physics.items())
        simulator, target = (gymnasium_simulator(spec, actions=levels).task for spec in (name, f"{name}:{text}"))
        policy = balancing(target) if name == "InvertedPendulum-v5" else uniform(target)
        cases[name] = simulator, target, policy, steps
    for name, (simulator, target, policy, steps) in cases.items():
        n = 5000 if name.endswith("v5") else 10_000
        make = target.record if name.endswith("v5") else lambda *a, target=target, **k: record(target, *a, **k)
        said = 0
        for seed in range(n_logs):
            log = make(policy, n_transitions=n, max_steps=steps, seed=seed)
            said += any(c.hidden for c in ResidualSimulator(simulator, log, seed=0).coordinates)
        alarms += said
        print(f"{name}: hidden state said in {said} of {n_logs}", flush=True)
    print(f"false alarms: {alarms} of {6 * n_logs}", flush=True)


def study_parameters(_, n_logs):
    changed = {"pole": 1.3, "force": 0.8}
    cartpole, pendulum = classic.ChangedCartPole(10.0), classic.Pendulum()
    heavy = classic.Pendulum(mass=1.2, gravity=11.0, friction=0.1)
    cases = {
        "CartPole, right": (cartpole, classic.ChangedCartPole(12.5, **changed), ("gravity", "pole", "force"), 300),
        "Pendulum, right": (pendulum, heavy, ("mass", "gravity", "friction"), 300),
        "CartPole, 5% random actions": (
            cartpole, RandomActions(classic.ChangedCartPole(12.5, **changed), 0.05), ("gravity", "pole", "force"), 10_000),
        "Pendulum, cogging": (pendulum, Cogging(mass=1.2, gravity=11.0), ("mass", "gravity", "friction"), 10_000),
    }  # fmt: skip
    for name, (simulator, target, names, n) in cases.items():
        is_cartpole = name.startswith("CartPole")
        acting, horizon, scale = (cartpole_policy, 100, 0.01) if is_cartpole else (classic.swinging, 200, 1.0)
        policies = [acting(delta) for delta in (0.1, 0.6)]
        truths = [value(target, policy, 2000, horizon, scale) for policy in policies]
        errors, taken = [], 0
        for seed in range(n_logs):
            log = record(target, acting(0.3), n_transitions=n, max_steps=horizon, seed=seed)
            fit = fit_parameters(*parameters_of(simulator, names), log)
            chosen = choose_correction(simulator, log, fit=fit, seed=0)
            both = chosen.learned if chosen.fit is not None else ResidualSimulator(fit.task, log, seed=0)
            taken += chosen.fit is not None
            tasks = simulator, fit.task, chosen.plain, both, chosen.learned
            errors.append([[value(task, p, 2000, horizon, scale) - truth for p, truth in zip(policies, truths, strict=True)]
                           for task in tasks])  # fmt: skip
        rows = ("simulator", "parameters", "residual", "both", "in front")
        each = np.abs(errors).mean(axis=0)
        told = "; ".join(f"{row} {near:.4f} {far:.4f}" for row, (near, far) in zip(rows, each, strict=True))
        print(f"{name}: parameters taken in {taken} of {n_logs}; mean |error| near, far: {told}", flush=True)


if __name__ == "__main__":
    given = dict(enumerate(sys.argv[1:]))
    n_logs = int(given.get(0, 10))
    n_values = int(given.get(1, n_logs))
    for word, study in {
        "parameters": study_parameters,
        "hidden": study_hidden_state,
        "alarms": study_false_alarms,
    }.items():
        if given.get(2, word) == word:
            study(n_logs, n_values)
