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
from functools import partial

import gymnasium
import numpy as np
from scipy.special import ndtr

from oee_tabular.continuous.correction import choose_correction
from oee_tabular.continuous.parameters import fit_parameters, parameters_of
from oee_tabular.continuous.task import DerivedTask, Moves
from oee_tabular.data import ContinuousTransitions
from oee_tabular.lab.robots.changes import classic
from oee_tabular.lab.robots.changes.cases import Change
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


def errors_of(case, task):
    """Of the values of a task's own dynamics, for a policy near the log's and one far from it."""
    return np.array([(case.returns(task, delta) - case.returns(case.target, delta)).mean() for delta in case.deltas])


def study_hidden_state(n_logs, n_values):
    """Delays, lags and sensor noise."""
    simulator, options = CartPole(10.0), {"deltas": (0.2, 0.8), "horizon": 100, "scale": 0.01}
    targets = {f"delay {k}": (Delay(simulator, k), k) for k in (1, 2, 3)}
    targets |= {f"lag {lag}": (Lag(simulator, lag), 0) for lag in (0.3, 0.5, 0.7)}
    targets["sensor noise"] = SensorNoise(simulator, 0.01), 0
    for name, (target, lag) in targets.items():
        case = Change(name, simulator, target, cartpole_policy, **options)
        n_said, n_named, errors, chosen = 0, 0, [], []
        for seed in range(n_logs):
            log = case.log(10_000, seed)
            hidden = [c.history for c in ResidualSimulator(simulator, log, seed=0).coordinates if c.hidden]
            best = max(hidden, key=lambda effect: effect.lag_r_squared, default=None)
            n_said += bool(hidden)
            n_named += best is not None and (best.lag, best.of) == (lag, "action")
            if seed < n_values:
                chosen.append(choose_correction(simulator, log, seed=0))
                errors.append(errors_of(case, chosen[-1].learned if chosen[-1].is_trusted else simulator))
        near, far = np.abs(errors).mean(axis=0)
        print(
            f"{name}: said {n_said} of {n_logs}, lag named {n_named}, steps {[c.steps for c in chosen]}, trusted "
            f"{sum(c.is_trusted for c in chosen)} of {n_values}; mean |error| near {near:.4f} far {far:.4f} (simulator "
            "{:+.4f} {:+.4f})".format(*errors_of(case, simulator)),
            flush=True,
        )


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
    """Markov targets of which hidden state should not be said."""
    cases = {
        "Pendulum with cogging": (classic.Pendulum(), Cogging(), classic.swinging(0.3), 10_000, 200),
        "MountainCar with drag": (classic.MountainCar(), Drag(), classic.rocking(0.3), 10_000, 200),
        "CartPole, 10% random actions": (
            CartPole(10.0), RandomActions(CartPole(10.0), 0.1), cartpole_policy(0.3), 10_000, 100),
    }  # fmt: skip
    for name, levels, steps in (("InvertedPendulum-v5", 9, 100), ("Reacher-v5", 3, 50), ("Hopper-v5", 2, 200)):
        model = gymnasium.make(name).unwrapped.model
        physics = {"body_mass": 1.3 * model.body_mass, "dof_damping": 1.5 * model.dof_damping + 0.02}
        text = ",".join(f"{key}={x.tolist()}".replace(" ", "") for key, x in physics.items())
        simulator, target = (gymnasium_simulator(spec, actions=levels).task for spec in (name, f"{name}:{text}"))
        policy = balancing(target) if name == "InvertedPendulum-v5" else uniform(target)
        cases[name] = simulator, target, policy, 5000, steps
    for name, (simulator, target, policy, n, steps) in cases.items():
        make = target.record if name.endswith("v5") else partial(record, target)
        logs = (make(policy, n_transitions=n, max_steps=steps, seed=seed) for seed in range(n_logs))
        said = [any(c.hidden for c in ResidualSimulator(simulator, log, seed=0).coordinates) for log in logs]
        print(f"{name}: hidden state said in {sum(said)} of {n_logs}", flush=True)


def study_parameters(_, n_logs):
    """Least squares on 300 transitions where the structure is right, and on 10 000 where it is not."""
    cartpole, pendulum = classic.ChangedCartPole(10.0), classic.Pendulum()
    changed = classic.ChangedCartPole(12.5, pole=1.3, force=0.8)
    heavy, cogging = classic.Pendulum(mass=1.2, gravity=11.0, friction=0.1), Cogging(mass=1.2, gravity=11.0)
    cart = {"deltas": (0.1, 0.6), "horizon": 100, "episodes": 2000, "scale": 0.01}
    swing = {"deltas": (0.1, 0.6), "horizon": 200, "episodes": 2000}
    for case, n in (
        (Change("CartPole, right", cartpole, changed, cartpole_policy, **cart), 300),
        (Change("Pendulum, right", pendulum, heavy, classic.swinging, **swing), 300),
        (
            Change("CartPole, 5% random actions", cartpole, RandomActions(changed, 0.05), cartpole_policy, **cart),
            10_000,
        ),
        (Change("Pendulum, cogging", pendulum, cogging, classic.swinging, **swing), 10_000),
    ):
        names = ("gravity", "pole", "force") if case.simulator is cartpole else ("mass", "gravity", "friction")
        errors, n_taken = [], 0
        for seed in range(n_logs):
            log = case.log(n, seed)
            fit = fit_parameters(*parameters_of(case.simulator, names), log)
            chosen = choose_correction(case.simulator, log, fit=fit, seed=0)
            both = chosen.learned if chosen.fit is not None else ResidualSimulator(fit.task, log, seed=0)
            n_taken += chosen.fit is not None
            tasks = case.simulator, fit.task, chosen.plain, both, chosen.learned
            errors.append([errors_of(case, task) for task in tasks])
        rows = zip(
            ("simulator", "parameters", "residual", "both", "in front"), np.abs(errors).mean(axis=0), strict=True
        )
        text = "; ".join(f"{row} {near:.4f} {far:.4f}" for row, (near, far) in rows)
        print(f"{case.task}: parameters taken in {n_taken} of {n_logs}; mean |error| near, far: {text}", flush=True)


if __name__ == "__main__":
    n_logs, n_values, word = (*sys.argv[1:], *(None,) * 3)[:3]
    studies = {"parameters": study_parameters, "hidden": study_hidden_state, "alarms": study_false_alarms}
    for study in [studies[word]] if word else studies.values():
        study(int(n_logs or 10), int(n_values or n_logs or 10))
