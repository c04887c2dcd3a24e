"""What CartPole's policies are worth, by Monte Carlo: ``cartpole_truth.csv``, made by ``make()``.

Values are (1 - discount) sum_{t<100} discount^t r_t, discount 0.99: at most 0.634, a pole that never falls. Each is the mean of
400 000 episodes; its standard error stands beside it (at most 3e-4). The simulator's own value, which a user has and which
calibration needs, has other random numbers than the truth that estimates are held to.

    python -m oee_tabular.lab.robots.cartpole_truth     makes the table again, the same to the last bit (five minutes)
"""

from __future__ import annotations

import functools
import hashlib
from importlib import resources
from pathlib import Path

import numpy as np
import pandas as pd

from oee_tabular._checks import Array
from oee_tabular.continuous.cartpole.dynamics import PAPER_NOISE, CartPole
from oee_tabular.continuous.cartpole.expert import cartpole_policy
from oee_tabular.continuous.episodes import MonteCarlo, monte_carlo_value

DELTAS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
GRAVITIES = (7.5, 10.0, 12.5, 15.0)
SIMULATED = 10.0
HORIZON, EPISODES = 100, 400_000
CASES = {
    "target": (GRAVITIES, PAPER_NOISE, False),
    "target without noise": (GRAVITIES, 0.0, False),  # Gymnasium's
    "simulator": ((SIMULATED,), PAPER_NOISE, False),
    "deterministic expert": ((SIMULATED,), PAPER_NOISE, True),
}


def monte_carlo(case: str, gravity: float, delta: float, episodes: int = EPISODES) -> MonteCarlo:
    """One value of the table, with its own random numbers."""
    _, noise, deterministic = CASES[case]
    words = hashlib.sha256(f"cartpole {case} {gravity:g} {delta:g}".encode()).digest()
    return monte_carlo_value(
        CartPole(gravity, noise), cartpole_policy(delta, deterministic=deterministic), episodes, HORIZON,
        seed=np.frombuffer(words[:16], dtype=">u4").tolist(), normalized=True,
    )  # fmt: skip


def make(episodes: int = EPISODES) -> pd.DataFrame:
    """The whole table: case, gravity, delta, value, standard_error, episodes."""
    keys = [
        (case, gravity, delta) for case, (gravities, _, _) in CASES.items() for gravity in gravities for delta in DELTAS
    ]
    found = [monte_carlo(*key, episodes) for key in keys]
    table = pd.DataFrame(keys, columns=["case", "gravity", "delta"])
    errors = [each.standard_error for each in found]
    return table.assign(value=[each.value for each in found], standard_error=errors, episodes=episodes)


@functools.cache
def table() -> pd.DataFrame:
    """The shipped table."""
    with resources.files("oee_tabular.lab.robots").joinpath("cartpole_truth.csv").open() as handle:
        return pd.read_csv(handle)


def values(case: str, gravity: float, column: str = "value") -> Array:
    """(6,) values at each of ``DELTAS``, or their standard errors."""
    own = table().query("case == @case and gravity == @gravity").set_index("delta")[column]
    return np.asarray(own.reindex(DELTAS), dtype=np.float64)


if __name__ == "__main__":
    make().to_csv(Path(__file__).with_suffix(".csv"), index=False, lineterminator="\n")
