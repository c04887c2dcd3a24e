"""Sampled episodes, transitions and returns of a finite MDP.

Monte Carlo makes logs and shows the cost of sampling; ``exact`` has the values by
dynamic programming.

Model
-----
For an MDP with transitions P (S*A, S), rewards r(s, a) or r(s, a, s'), initial
distribution S_0 (S,) and discount gamma, under a policy pi (S, A):

    s_0 ~ S_0,    a_t ~ pi(. | s_t),    s_{t+1} ~ P(. | s_t, a_t),    t = 0 .. T - 1

An episode ends with its horizon T, or on entering an absorbing state with reward 0; one
that begins there has one step.

* ``sample_episodes`` gives the episodes as a log (``sampler``).
* ``sample_transitions`` gives n independent (s, a) ~ d (S, A) with s' ~ P(. | s, a)
  (``sampler``).
* ``sample_returns`` gives sums along each of n episodes alone, weighted by ratios zeta
  (4.2) (``returns``).

Sums along an episode, with W_0 = 1 and a ratio zeta(s, a, s') for each transition:

    G <- G + gamma^t r_t
    W_{t+1} = W_t zeta(s_t, a_t, s_{t+1})
    X <- X + gamma^t W_t r(s_t, a_t),    or
    X <- X + gamma^t W_{t+1} r(s_t, a_t, s_{t+1})

so that X estimates J of the target in which zeta P is the dynamics (per decision), as
does the last weight times G (trajectory). Its exact mean and variance are
``exact.weighted_return_moments``.

Method and guarantees
---------------------
(a, s') is one draw from an alias table of its state (``_rollout``), whose probabilities
are P pi to 2^-50: whole numbers of units 2^-62, compared with 62 random bits. Each step
of each episode has random bits of its own: Philox4x32-10, keyed by the seed, with a
counter of (step, stream, episode). So

* the same seed gives identical results for any number of threads or processes, forked
  or not;
* an episode depends neither on how many others there are nor on what is computed along
  it;
* episodes, transitions and returns are drawn from different streams: one seed for all
  three gives independent samples.

Work is shared by Python threads over kernels that release the interpreter
(``sampler``); runs of less than a million steps stay on the calling thread. A step of
returns takes less than half of what a plain compiled loop needs
(`tests/benchmarks/speed.py rollouts`).
"""

from oee_tabular.simulate.returns import SampledReturns, sample_returns
from oee_tabular.simulate.sampler import Drawn as Drawn
from oee_tabular.simulate.sampler import draw as draw
from oee_tabular.simulate.sampler import entry_rewards as entry_rewards
from oee_tabular.simulate.sampler import episodes_holding as episodes_holding
from oee_tabular.simulate.sampler import sample_episodes, sample_transitions

# what users find here; what is imported above "as" itself is for other rooms alone
__all__ = ["SampledReturns", "sample_episodes", "sample_returns", "sample_transitions"]
