"""The paper's theorems with both sides of each, and correct bounds.

The proofs are in notebooks/statements.md. Functions whose names end in ``_bound`` give
a right-hand side from its constants; those that end in ``_sides`` give both sides on
given tables or MDPs as ``Sides(left, right)``, each computed without tolerance.
Divergences and risks are in nats.

**Ratios** (``theorem_1``). p and q (n,) are distributions, g* = p/q, the paper's class
is nu <= g <= mu with nu < 1 < mu, and the risk is L(g) = sum q g - sum p log g. Theorem
V.1 (eq. 5.1) bounds, with probability 1 - delta::

    |ghat - g*|_inf^2  <=  K e^{D_inf(P || Q)} M / sqrt(n),
    M = mu + max(log mu, -log nu) + sqrt(2 log(1 / delta))

No universal K exists (``universal_constant_counterexample``): it must contain 1 / min q
and the size of the class. With P and Q fixed the bound is true for large n, but the
error itself has the rate n^-1/2, not n^-1/4 as the theorem states. For tables
``sup_error_bound`` is true. The excess risk L(g) - L(g*) = E_p phi(g/g*), phi(u) = u -
1 - log u, controls the L2(P) norm: E_p (g - g*)^2 <= 2 mu^2 times it.

**zeta** (``theorem_2``). Lemma V.1 (eq. 5.2) for zeta = beta_sas' / beta_sa is true:
the sup error of zhat is at most mu (1 + nu mu) / nu^2 times that of both betahat; the
tight constant is (mu + nu) / nu^2.

**Values** (``theorem_2``, ``bounds``). P' is the target and K the model of it, zhat * P
or any other kernel (S*A, S), with the target's rewards, initial distribution and
discount g. R is the largest absolute reward, alpha_t the distribution of (s_t, a_t),
and eta the largest over (s, a) of sum_s' abs(K - P') = E_P abs(zhat - zeta). Theorem
V.2 (eq. 5.3) is false as stated (``value_bound_counterexample``). True bounds::

    (A)  any rows:       |J(K) - J'| <= R sum_t g^t ((1 + eta)^t - 1)
    (B)  rows sum to 1:  |J(K) - J'| <= R sum_t g^t min(2, t eta)
                                     <= R g eta / (1 - g)^2
    (C)  rows sum to 1:  |J(K) - J'| <= R sum_t g^t min(2, sqrt(2 KL_t)),
                         KL_t = sum_{k<t} E_K[KL(K || P')(s_k, a_k)]
         corrected V.2:  (J(K) - J')^2 <= 2 T R^2 error^2 sum_{t=1..T} t g^{2t},
                         error = max |zhat/zeta - 1|

(A) is exponential in the horizon, and so are the errors that attain it.

A horizon T means the rewards at t = 0..T-1, as everywhere in this package; Theorem
V.2's own sum runs over t = 0..T. A reward r(s, a) at t rests on t transitions, a reward
r(s, a, s') on t + 1: (A), (B), (C) count transitions, and are larger by one step in the
second case. The simulation lemma (``theorem_2``) is an equality for any nonnegative K::

    J' - J(K) = g/(1-g) <d', (P' - K) V_K> = g/(1-g) <d_K, (P' - K) V'>.
"""

from oee_tabular.theory.bounds import (
    kl_path_bound,
    kl_path_sides,
    normalised_bound,
    normalised_sides,
    path_kl,
    unnormalised_bound,
    unnormalised_sides,
)
from oee_tabular.theory.theorem_1 import (
    EstimationCounterexample,
    Sides,
    estimation_bound,
    estimation_sides,
    excess_risk,
    renyi_divergence,
    squared_error_sides,
    sup_error_bound,
    universal_constant_counterexample,
)
from oee_tabular.theory.theorem_2 import (
    SimulationLemma,
    corrected_value_error_bound,
    ratio_error_bound,
    ratio_error_sides,
    simulation_lemma,
    value_bound_counterexample,
    value_error_bound,
    value_error_sides,
)

__all__ = [
    "EstimationCounterexample",
    "Sides",
    "SimulationLemma",
    "corrected_value_error_bound",
    "estimation_bound",
    "estimation_sides",
    "excess_risk",
    "kl_path_bound",
    "kl_path_sides",
    "normalised_bound",
    "normalised_sides",
    "path_kl",
    "ratio_error_bound",
    "ratio_error_sides",
    "renyi_divergence",
    "simulation_lemma",
    "squared_error_sides",
    "sup_error_bound",
    "universal_constant_counterexample",
    "unnormalised_bound",
    "unnormalised_sides",
    "value_bound_counterexample",
    "value_error_bound",
    "value_error_sides",
]
