"""CartPole's policies, and their expert, trained by the cross-entropy method in the simulator (gravity 10).

The expert pushes to the right with probability sigma(w_1 theta + w_2 theta' + w_3). The method [1] keeps a Gaussian over w,
samples a population, runs each candidate for some episodes, and fits the Gaussian to the elite; the expert is its last mean.
Two iterations only: the paper's expert is no perfect balancer either, and its figure is that of a policy which acts at random
(a deterministic one does not fit it).

``EXPERT`` is what ``train_expert()`` returns, to the last bit. Of the seeds 0 to 3999 its seed is the one whose policy
comes nearest (mean |difference of probabilities| .020 on 20 000 visited states) to sigma(17.685 theta + 1.367 theta' - .199),
the expert that this task was first measured with. The choice saw no target.

Reference: [1] R. Rubinstein, The cross-entropy method for combinatorial and continuous optimization, 1999.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular.continuous.cartpole.dynamics import ANGLE_LIMIT, CartPole

SCALE = np.array([ANGLE_LIMIT, 1.0, 1.0])  # theta in units of its limit, theta' in rad/s, the constant
EXPERT_SEED = 2346
EXPERT = (15.45452587148293, 1.4249703129710485, -0.14295940315497063)  # what train_expert() returns


@dataclass(frozen=True)
class CartPolePolicy:
    """pi_delta = delta * uniform + (1 - delta) * expert, a function of states (n, 4) giving probabilities (n, 2).

    Parameters
    ----------
    delta : share of the uniform policy, in [0, 1]: the opposite sense to the gridworld, as in the paper
    deterministic : whether the expert takes its likelier action; else it pushes to the right with probability
        sigma(w_1 theta + w_2 theta' + w_3)
    weights : w, the shipped expert's by default

    Examples
    --------
    >>> cartpole_policy(1.0)(np.zeros((1, 4))).tolist()
    [[0.5, 0.5]]
    """

    delta: float = 0.0
    deterministic: bool = False
    weights: tuple[float, float, float] = EXPERT

    def __post_init__(self) -> None:
        _checks.number_in(self.delta, "delta", 0.0, 1.0)
        _checks.boolean(self.deterministic, "deterministic")

    def __call__(self, states: Array) -> Array:
        """(n, 2) probabilities of pushing to the left and to the right."""
        lean = self.weights[0] * states[:, 2] + self.weights[1] * states[:, 3] + self.weights[2]
        right = (lean > 0).astype(np.float64) if self.deterministic else 1.0 / (1.0 + np.exp(-lean))
        right = 0.5 * self.delta + (1.0 - self.delta) * right
        return np.stack([1.0 - right, right], axis=1)


cartpole_policy = CartPolePolicy


def train_expert(
    *,
    seed: Any = EXPERT_SEED,
    iterations: int = 2,
    population: int = 64,
    elite: int = 8,
    episodes: int = 32,
    horizon: int = 200,
    spread: float = 2.0,
    smallest_spread: float = 0.05,
    task: CartPole | None = None,
) -> tuple[float, float, float]:
    """The weights (w_1, w_2, w_3) of a logistic expert, by the cross-entropy method.

    Parameters
    ----------
    seed : the same seed gives the same bits; the default trains the expert that is shipped
    iterations, population, elite : samples in each iteration, and how many of the best the Gaussian is fitted to
    episodes, horizon : each candidate's score is its mean number of steps (at most ``horizon``) over so many episodes
    spread, smallest_spread : standard deviation of the first Gaussian, and its floor later, for theta in units of 12 degrees
    task : CartPole, by default the paper's simulator, gravity 10

    Returns
    -------
    tuple of 3 floats
        For theta in rad and theta' in rad/s.

    Notes
    -----
    iterations * population * episodes * horizon steps: a tenth of a second by default.

    Examples
    --------
    >>> [round(weight, 3) for weight in train_expert()]
    [15.455, 1.425, -0.143]
    """
    for name, value in (("iterations", iterations), ("population", population), ("elite", elite),
                        ("episodes", episodes), ("horizon", horizon)):  # fmt: skip
        _checks.positive_integer(value, name)
    if elite > population:
        raise ValueError(f"elite must be at most the population, {population}; it is {elite}")
    low = _checks.number_in(smallest_spread, "smallest_spread", 0.0, np.inf)
    deviation = np.full(3, _checks.number_in(spread, "spread", 0.0, np.inf))
    simulator, rng, mean = task or CartPole(), _checks.generator(seed), np.zeros(3)
    for _ in range(iterations):
        candidates = mean + deviation * rng.standard_normal((population, 3))
        steps = _lengths(simulator, np.repeat(candidates / SCALE, episodes, axis=0), horizon, rng)
        scores = steps.reshape(-1, episodes).mean(axis=1)
        best = candidates[np.argsort(-scores, kind="stable")[:elite]]
        mean, deviation = best.mean(axis=0), np.maximum(best.std(axis=0), low)
    first, second, third = (mean / SCALE).tolist()
    return first, second, third


def _lengths(task: CartPole, weights: Array, horizon: int, rng: np.random.Generator) -> Array:
    """(n,) lengths of episodes, each under weights of its own (n, 3)."""
    alive, lengths = np.arange(len(weights)), np.zeros(len(weights))
    states = task.initial_states(len(weights), rng)
    for _ in range(horizon):
        w = weights[alive]
        lean = w[:, 0] * states[:, 2] + w[:, 1] * states[:, 3] + w[:, 2]
        right = rng.random(len(alive)) * (1.0 + np.exp(-np.clip(lean, -500.0, 500.0))) < 1.0
        moved = task.step(states, right.astype(np.int64), rng)
        lengths[alive] += 1.0
        alive, states = alive[~moved.terminated], moved.next_state[~moved.terminated]
    return lengths
