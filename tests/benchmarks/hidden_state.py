"""Targets with hidden state, and with dynamics that no parameter has: delays, lags,
sensor noise, cogging.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from oee_tabular.continuous.task.base import DerivedTask, Moves
from oee_tabular.data import ContinuousTransitions
from oee_tabular.lab.experiments import classic

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
    """Does what was asked some steps ago, at first as asked; the hidden coordinates are
    the last commands.
    """

    def moves(self, states, actions, disturbance):
        last = states[:, self.task.n_state :]
        done = np.where(last[:, -1] == NONE, actions, last[:, -1]).astype(np.int64)
        moved = self.task.moves(self.own(states), done, disturbance)
        return Moves(
            np.column_stack([moved.next_state, actions, last[:, :-1]]),
            moved.reward,
            moved.terminated,
        )


class Lag(Hidden):
    """CartPole with a force u <- lag u + (1 - lag) a, at first 0."""

    def __init__(self, task, lag):
        super().__init__(task, 1)
        self.lag = lag

    def moves(self, states, actions, disturbance):
        own = self.own(states)
        force = states[:, -1]
        force = (
            self.lag * np.where(force == NONE, 0.0, force)
            + (1.0 - self.lag) * self.actions[actions]
        )
        ends = [
            self.task.moves(own, np.full(len(own), a), disturbance).next_state
            for a in (0, 1)
        ]
        share = ((force - self.actions[0]) / (self.actions[1] - self.actions[0]))[
            :, None
        ]
        # a step is linear in the force
        following = ends[0] * (1.0 - share) + ends[1] * share
        return Moves(
            np.column_stack([following, force]),
            np.ones(len(own)),
            self.task.terminated(following),
        )


class SensorNoise(Hidden):
    """The hidden coordinates are the state; what is shown has noise on it."""

    def __init__(self, task, deviation):
        super().__init__(task, task.n_state)
        self.deviation = deviation
        self.n_disturbances = task.n_disturbances + task.n_state

    def initial_states(self, n, rng):
        own = self.task.initial_states(n, rng)
        return np.column_stack(
            [own + self.deviation * rng.standard_normal(own.shape), own]
        )

    def moves(self, states, actions, disturbance):
        d = self.task.n_state
        k = self.task.n_disturbances
        moved = self.task.moves(
            np.ascontiguousarray(states[:, d:]), actions, disturbance[:, :k]
        )
        shown = moved.next_state + self.deviation * disturbance[:, k:]
        return Moves(
            np.column_stack([shown, moved.next_state]), moved.reward, moved.terminated
        )


class RandomActions(DerivedTask):
    """A share of the actions is any."""

    def __init__(self, task, share):
        super().__init__(task, f"{task.name}, random actions")
        self.share = share
        self.n_disturbances = task.n_disturbances + 2

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
        torque = self.cogging * np.sin(4.0 * states[:, 0]) + self.dry * np.tanh(
            10.0 * states[:, 1]
        )
        speed = np.clip(moved.next_state[:, 1] - 0.15 * torque, -8.0, 8.0)
        return Moves(
            np.column_stack([states[:, 0] + 0.05 * speed, speed]),
            moved.reward,
            moved.terminated,
        )


def shown(log, d):
    """The log without the hidden coordinates."""
    columns = log.columns()
    return ContinuousTransitions(
        **(columns | {k: columns[k][:, :d] for k in ("state", "next_state")})
    )


def of_own(policy, d):
    return lambda states: policy(np.ascontiguousarray(states[:, :d]))
