"""CartPole with a mistaken gravity (the paper's Section VI.B), and its policies.

A pole is balanced on a cart by Gymnasium's dynamics (Euler steps of 0.02 s, forces of
-10 and 10 N), bit for bit; beside them N(0, noise^2) on each component of the state in
each step, and the paper's reward: 1 per step, the failing one included, 0 afterwards.
An episode begins uniformly in [-0.05, 0.05]^4 and ends beyond 2.4 m or 12 degrees.

The acceleration of the angle depends on (theta, theta', force) only. For a policy that
looks at the angle alone, (theta, theta') is therefore a Markov process by itself, and
the discretisation may leave the cart out; the one thing lost is the end of the track,
which hardly any episode reaches within 100 steps. A log's transitions that end there
are truncated to it.

The expert pushes to the right with probability sigma(w_1 theta + w_2 theta' + w_3). It
is trained in the simulator (gravity 10) by the cross-entropy method [1], which keeps a
Gaussian over w, samples a population, runs each candidate for some episodes, and fits
the Gaussian to the elite; the expert is its last mean. Two iterations only: the paper's
expert is no perfect balancer either, and its figure is that of a policy which acts at
random (a deterministic one does not fit it).

``EXPERT`` is what ``train_expert()`` returns, to the last bit. Of the seeds 0 to 3999
its seed is the one whose policy comes nearest (mean absolute difference of
probabilities .020 on 20 000 visited states) to
sigma(17.685 theta + 1.367 theta' - .199), the expert that this task was first measured
with. The choice used no data of the target.

Reference: [1] R. Rubinstein, The cross-entropy method for combinatorial and continuous
optimization, 1999.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import freeze
from oee_tabular._keywords import suggest_keywords
from oee_tabular.continuous.task.base import ContinuousTask, Moves
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array, BoolArray, IntArray, Seed

ANGLE_LIMIT = 12 * 2 * np.pi / 360  # rad
X_LIMIT = 2.4  # m
START = 0.05  # the largest absolute value of each coordinate of an initial state
FORCE = 10.0  # N
TAU = 0.02  # s
POLE_MASS = 0.1  # kg
HALF_LENGTH = 0.5  # m
TOTAL_MASS = 0.1 + 1.0  # kg
PAPER_NOISE = 1e-4
# theta in units of its limit, theta' in rad/s, the constant
SCALE = np.array([ANGLE_LIMIT, 1.0, 1.0])
# deviation of the first Gaussian, and its floor later, in units of ``SCALE``
SPREAD = 2.0
SMALLEST_SPREAD = 0.05
MOST_STEPS = 10**11  # an hour or more
EXPERT_SEED = 2346
# what train_expert() returns
EXPERT = (15.45452587148293, 1.4249703129710485, -0.14295940315497063)


@suggest_keywords
@dataclass(frozen=True)
class CartPole(ContinuousTask):
    """Gymnasium's CartPole under another gravity, with process noise.

    The state is (x, x', theta, theta'): the cart's position in m and velocity in m/s,
    the pole's angle from the vertical in rad and its angular velocity in rad/s. Action
    0 pushes the cart with -10 N, action 1 with 10 N, each for 0.02 s. The reward is 1
    for every step, the failing one included. An episode ends beyond 2.4 m or 12
    degrees.

    Parameters
    ----------
    gravity : float, default 10.0
        The gravity in m/s^2. The paper's simulator has 10, its targets 7.5 to 15;
        Gymnasium's default is 9.8.
    noise : float, default 1e-4
        The standard deviation of the Gaussian noise that each step adds to each
        component of the state; the paper's is 1e-4.
    form : {'angle', 'full'}, default 'angle'
        What is discretised: (theta, theta'), exact for policies of the angle, or the
        whole state (x, x', theta, theta').

    See Also
    --------
    cartpole_policy : The expert, mixed with the uniform policy.
    train_expert : Train the expert.

    Examples
    --------
    >>> task = CartPole(gravity=9.8, noise=0.0)
    >>> task.moves(
    ...     np.array([[0.0, 0.0, 0.2, 1.0]]), np.array([1]), np.zeros((1, 4))
    ... ).terminated.tolist()
    [True]
    """

    state_names = ("x", "x_dot", "theta", "theta_dot")
    actions = freeze(np.array([-FORCE, FORCE]))
    n_disturbances = 4
    terminates = True

    gravity: float = 10.0
    noise: float = PAPER_NOISE
    form: Literal["angle", "full"] = "angle"
    name: str = field(default="CartPole", init=False)

    def __post_init__(self) -> None:
        _checks.number_in(self.gravity, "gravity", 0.0, np.inf)
        _checks.number_in(self.noise, "noise", 0.0, np.inf)
        _checks.one_of(self.form, "form", ("angle", "full"))
        high = np.array([1.2, 2.5, ANGLE_LIMIT, 3.2])
        used = slice(2, 4) if self.form == "angle" else slice(0, 4)
        object.__setattr__(self, "feature_names", self.state_names[used])
        object.__setattr__(self, "feature_low", freeze(-high[used]))
        object.__setattr__(self, "feature_high", freeze(high[used]))
        object.__setattr__(self, "periodic", (False,) * len(high[used]))
        default_cells = (32, 32) if self.form == "angle" else 1000
        object.__setattr__(self, "default_cells", default_cells)

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """Take one step of 0.02 s from each state.

        Parameters
        ----------
        states : ndarray of shape (n, 4)
            Position (m), velocity (m/s), angle (rad) and angular velocity (rad/s).
        actions : ndarray of int, shape (n,)
            0 for -10 N and 1 for 10 N.
        disturbance : ndarray of shape (n, 4)
            Draws of N(0, I), which ``noise`` multiplies.

        Returns
        -------
        Moves
            The next states, rewards of 1, and whether the next states are terminal.

        Notes
        -----
        Products and sums stand in the order of Gymnasium's own, so that they agree to
        the last bit.
        """
        force = self.actions[np.asarray(actions, dtype=np.int64)]
        x, x_dot, theta, theta_dot = np.asarray(states, dtype=np.float64).T
        cosine = np.cos(theta)
        sine = np.sin(theta)
        push = force + POLE_MASS * HALF_LENGTH * np.square(theta_dot) * sine
        temp = push / TOTAL_MASS
        inertia = HALF_LENGTH * (4.0 / 3.0 - POLE_MASS * np.square(cosine) / TOTAL_MASS)
        theta_acc = (self.gravity * sine - cosine * temp) / inertia
        x_acc = temp - POLE_MASS * HALF_LENGTH * theta_acc * cosine / TOTAL_MASS
        steps = (
            x + TAU * x_dot,
            x_dot + TAU * x_acc,
            theta + TAU * theta_dot,
            theta_dot + TAU * theta_acc,
        )
        following = np.stack(steps, axis=1) + self.noise * disturbance
        return Moves(following, np.ones(len(states)), self.terminated(following))

    def initial_states(self, n: int, rng: np.random.Generator) -> Array:
        """Draw states uniformly from [-0.05, 0.05]^4.

        Parameters
        ----------
        n : int
            How many states are drawn.
        rng : numpy.random.Generator
            The source of random numbers.

        Returns
        -------
        ndarray of shape (n, 4)
            The states.
        """
        return rng.uniform(-START, START, (n, 4))

    def initial_points(self) -> tuple[Array, Array]:
        """Return a lattice of midpoints that represents the uniform initial states.

        Returns
        -------
        states : ndarray of shape (m, 4)
            64 midpoints in each of theta and theta', the cart at rest at 0; with the
            form 'full' 12 in each coordinate.
        weights : ndarray of shape (m,)
            Equal weights, which sum to 1.
        """
        k = len(self.feature_names)
        n = 64 if self.form == "angle" else 12
        line = START * ((2.0 * np.arange(n) + 1.0) / n - 1.0)
        lattice = np.stack(np.meshgrid(*[line] * k, indexing="ij"), axis=-1)
        points = self.embed(lattice.reshape(-1, k))
        return points, np.full(len(points), 1.0 / len(points))

    def terminated(self, states: Array) -> BoolArray:
        """Return which states lie beyond 2.4 m or 12 degrees.

        Parameters
        ----------
        states : ndarray of shape (n, 4)
            The states.

        Returns
        -------
        ndarray of bool, shape (n,)
            Whether each state is terminal.
        """
        is_off_track = np.abs(states[:, 0]) > X_LIMIT
        return np.asarray(is_off_track | (np.abs(states[:, 2]) > ANGLE_LIMIT))

    def end_shows(self, states: Array) -> BoolArray:
        """Return which ends show in the features; those of the track do not.

        Parameters
        ----------
        states : ndarray of shape (n, 4)
            Terminal states.

        Returns
        -------
        ndarray of bool, shape (n,)
            Whether the angle is beyond 12 degrees, or the form is 'full'.
        """
        return np.asarray((np.abs(states[:, 2]) > ANGLE_LIMIT) | (self.form == "full"))

    def features(self, states: Array) -> Array:
        """Return (theta, theta'), or the whole state with the form 'full'.

        Parameters
        ----------
        states : ndarray of shape (n, 4)
            The states.

        Returns
        -------
        ndarray of shape (n, 2) or (n, 4)
            The features, in rad and rad/s, with the form 'full' also in m and m/s.
        """
        return np.ascontiguousarray(states[:, 2:]) if self.form == "angle" else states

    def embed(self, features: Array) -> Array:
        """Return states with these features, the cart at rest in the middle.

        Parameters
        ----------
        features : ndarray of shape (n, 2) or (n, 4)
            The features.

        Returns
        -------
        ndarray of shape (n, 4)
            The states.
        """
        if self.form == "full":
            return features
        return np.concatenate([np.zeros_like(features), features], axis=1)

    def parameters(self) -> dict[str, Any]:
        """Return gravity, noise and form by name.

        Returns
        -------
        dict
            The parameters.
        """
        return {"gravity": self.gravity, "noise": self.noise, "form": self.form}


@suggest_keywords
@dataclass(frozen=True)
class CartPolePolicy:
    """The expert mixed with the uniform policy: delta * uniform + (1 - delta) * expert.

    It is a function of states (n, 4) giving probabilities (n, 2) of pushing to the left
    and to the right.

    Parameters
    ----------
    delta : float, default 0.0
        The share of the uniform policy, in [0, 1]. The sense is opposite to the
        gridworld's, as in the paper.
    deterministic : bool, default False
        Whether the expert takes its more probable action. Otherwise it pushes to the
        right with probability sigma(w_1 theta + w_2 theta' + w_3).
    weights : tuple of three floats, optional
        The weights w, for theta in rad and theta' in rad/s; by default the shipped
        expert's.

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
        weights = _checks.float_array(self.weights, "weights", ndim=1)
        _checks.require_finite(weights, "weights")
        if weights.shape != (3,):
            raise ArgumentError(
                "weights",
                "must be three numbers, of theta, theta' and 1; they have shape"
                f" {weights.shape}",
            )

    def __call__(self, states: Array) -> Array:
        """Return the probabilities (n, 2) of pushing to the left and to the right."""
        lean = (
            self.weights[0] * states[:, 2]
            + self.weights[1] * states[:, 3]
            + self.weights[2]
        )
        if self.deterministic:
            right = (lean > 0).astype(np.float64)
        else:
            right = 1.0 / (1.0 + np.exp(-lean))
        right = 0.5 * self.delta + (1.0 - self.delta) * right
        return np.stack([1.0 - right, right], axis=1)


cartpole_policy = CartPolePolicy


@suggest_keywords
def train_expert(
    *,
    seed: Seed = EXPERT_SEED,
    iterations: int = 2,
    population: int = 64,
    elite: int = 8,
    episodes: int = 32,
    horizon: int = 200,
    task: CartPole | None = None,
) -> tuple[float, float, float]:
    """Train the weights of a logistic expert by the cross-entropy method.

    Parameters
    ----------
    seed : int, Generator or SeedSequence, default 2346
        The source of random numbers. The same seed gives the same bits; the default
        trains the expert that is shipped.
    iterations : int, default 2
        The number of iterations.
    population : int, default 64
        The number of candidates that each iteration draws.
    elite : int, default 8
        The number of best candidates to which the Gaussian is fitted.
    episodes : int, default 32
        The number of episodes by which each candidate is scored.
    horizon : int, default 200
        The largest number of steps of an episode. A candidate's score is its mean
        number of steps.
    task : CartPole, optional
        The task in which candidates are run; by default the paper's simulator, gravity
        10.

    Returns
    -------
    tuple of three floats
        The weights, for theta in rad and theta' in rad/s.

    Raises
    ------
    ValueError
        If a number is not a positive integer, or ``elite`` is above ``population``.

    Notes
    -----
    Costs iterations * population * episodes * horizon steps: a tenth of a second by
    default.

    Examples
    --------
    >>> [round(weight, 3) for weight in train_expert()]
    [15.455, 1.425, -0.143]
    """
    for name, value in (
        ("iterations", iterations),
        ("population", population),
        ("elite", elite),
        ("episodes", episodes),
        ("horizon", horizon),
    ):
        _checks.positive_integer(value, name)
    if elite > population:
        raise ArgumentError(
            "elite", f"must be at most the population, {population}; it is {elite}"
        )
    _checks.require_memory(16.0 * population * episodes, "population", population)
    n_steps = iterations * population * episodes * horizon
    if n_steps > MOST_STEPS:
        raise ArgumentError(
            "horizon",
            "must leave a number of steps that ends, iterations * population * episodes"
            f" * horizon <= {MOST_STEPS:g}; it is {n_steps:g}",
        )
    simulator = CartPole()
    if task is not None:
        simulator = _checks.instance(task, CartPole, "task")
    rng = _checks.generator(seed)
    mean = np.zeros(3)
    deviation = np.full(3, SPREAD)
    for _ in range(iterations):
        candidates = mean + deviation * rng.standard_normal((population, 3))
        weights = np.repeat(candidates / SCALE, episodes, axis=0)
        steps = _lengths(simulator, weights, horizon, rng)
        scores = steps.reshape(-1, episodes).mean(axis=1)
        best = candidates[np.argsort(-scores, kind="stable")[:elite]]
        mean = best.mean(axis=0)
        deviation = np.maximum(best.std(axis=0), SMALLEST_SPREAD)
    first, second, third = (mean / SCALE).tolist()
    return first, second, third


def _lengths(
    task: CartPole, weights: Array, horizon: int, rng: np.random.Generator
) -> Array:
    """Return the lengths (n,) of episodes, each under weights of its own (n, 3)."""
    alive = np.arange(len(weights))
    lengths = np.zeros(len(weights))
    states = task.initial_states(len(weights), rng)
    for _ in range(horizon):
        w = weights[alive]
        lean = w[:, 0] * states[:, 2] + w[:, 1] * states[:, 3] + w[:, 2]
        # u < 1 / (1 + e^-lean), without a division; clipped so that exp is finite
        odds = 1.0 + np.exp(-np.clip(lean, -500.0, 500.0))
        right = rng.random(len(alive)) * odds < 1.0
        moved = task.step(states, right.astype(np.int64), rng)
        lengths[alive] += 1.0
        alive = alive[~moved.terminated]
        states = moved.next_state[~moved.terminated]
    return lengths
