"""Sampled episodes, transitions and returns of a finite MDP.

Monte Carlo is here to make logs and to show what sampling costs; what dynamic programming can give is in ``exact``.
The same seed gives the same bits for any number of threads.
"""

from oee_tabular.simulate.logs import sample_episodes, sample_transitions
from oee_tabular.simulate.returns import SampledReturns, sample_returns

__all__ = [
    "SampledReturns",
    "sample_episodes",
    "sample_returns",
    "sample_transitions",
]
