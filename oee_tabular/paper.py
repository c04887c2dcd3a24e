"""The paper, equation by equation, numbers as printed.

"Off Environment Evaluation Using Convex Risk Minimization". Dense arrays, nothing fast,
nothing general: read it beside the paper. Arrows name what users call; the tests hold
all of those to this page. Nothing is checked here: inf or nan among the arguments gives
inf or nan, float32 computes in single precision, rows that do not sum to 1 and empty
boxes give numbers without meaning. What users call checks them. Not as printed:
``algorithm_1`` clips g to the box [nu, mu] after each step, which the paper does not
print.

The letters are those of the paper:

- P: (S, A, S), P[s, a, s'] = P(s' | s, a); te and tr are target and simulator
- r: (S, A) rewards; S_0: (S,) law of the start; gamma: discount
- pi: (S, A), pi[s, a] = pi(a | s)
- nu, mu: the box of g; lam: the paper's lambda_n

Eq. 3.4 is a definition: MDP_tr and MDP_te differ in P alone.
-> FiniteMDP.with_transitions

Assumption V.1: nu <= g <= mu with nu < 1 < mu. Assumption V.2: p / q is in the class.
-> ratio.check_assumptions
"""

import numpy as np

__all__ = (
    "J",
    "J_of_products",
    "algorithm_1",
    "beta",
    "d",
    "d_moves",
    "lemma",
    "risk",
    "theorem_1",
    "theorem_2",
    "zeta",
    "zeta_of",
)


def J(P, r, S_0, pi, gamma):
    """Eq. 3.1: J = E sum_t gamma^t r(s_t, a_t) = S_0 . (I - gamma P_pi)^-1 r_pi.

    -> policy_value

    Eq. 4.1 is the same by the tower property:
    r(s_0, a_0) + gamma E[r(s_1, a_1) + gamma E[...]].
    -> state_values
    """
    P_pi = np.einsum("sa,sat->st", pi, P)
    r_pi = (pi * r).sum(axis=1)
    return S_0 @ np.linalg.solve(np.eye(len(P)) - gamma * P_pi, r_pi)


def d(P, S_0, pi, gamma):
    """Eq. 3.2: d(s, a) = (1 - gamma) sum_t gamma^t Pr(s_t = s, a_t = a).

    J = sum d r / (1 - gamma).
    -> occupancy
    """
    P_pi = np.einsum("sa,sat->st", pi, P)
    return (
        np.linalg.solve(np.eye(len(P)) - gamma * P_pi.T, (1 - gamma) * S_0)[:, None]
        * pi
    )


def d_moves(P, S_0, pi, gamma):
    """Eq. 3.3: d(s, a, s') = d(s, a) P(s' | s, a).

    -> occupancy(of="transition")
    """
    return d(P, S_0, pi, gamma)[:, :, None] * P


# Eq. 3.5, importance sampling: E_p[G] = E_q[(p / q) G], for any G, where q > 0 wherever
# p > 0.
# -> policy_is_moments


def risk(g, p, q, lam=0.0):
    """Eq. 3.6: KL(p || q) = 1 - min_g risk(g), which is reached at g = p / q.

    risk = sum q g - sum p log g + lam / 2 I(g)^2 with I(g)^2 = sum g^2. With samples, p
    and q are the shares of n draws each.
    -> ratio.density_ratio(...).objective, .divergence
    """
    return q @ g - p[p > 0] @ np.log(g[p > 0]) + lam / 2 * (g @ g)


def beta(p, q, nu, mu, lam=0.0, normalized=False, accuracy=1e-10, **settings):
    """Eq. 3.7: argmin of the risk over nu <= g <= mu, stated as it is printed.

    The paper leaves the constraint sum q g = 1 to luck (its experiments on the
    gridworld); ``normalized`` states it. g is within about sqrt(accuracy), because the
    risk is flat at its least; ``settings`` are Clarabel's.
    -> ratio.density_ratio
    """
    import cvxpy as cp

    g = cp.Variable(len(p))
    cost = q @ g - p[p > 0] @ cp.log(g[p > 0]) + lam / 2 * cp.sum_squares(g)
    constraints = [g >= nu, g <= mu]
    if normalized:
        constraints.append(q @ g == 1)
    within = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), accuracy)
    cp.Problem(cp.Minimize(cost), constraints).solve(
        solver="CLARABEL", **within | settings
    )
    return g.value


def zeta(P_te, P_tr):
    """Eq. 4.3: zeta(s' | s, a) = P_te(s' | s, a) / P_tr(s' | s, a).

    It is 1 where the simulator never goes.
    -> true_ratio
    """
    return np.divide(P_te, P_tr, out=np.ones_like(P_tr), where=P_tr > 0)


def zeta_of(beta_moves, beta_pairs):
    """Eq. 4.4: zeta = beta(s, a, s') / beta(s, a).

    Each beta is a d_te / d_tr; rows of zeta * P_tr have any sum.
    -> ratio.Quotient
    """
    return beta_moves / beta_pairs[:, :, None]


def J_of_products(zeta, P_tr, r, S_0, pi, gamma, T):
    """Eq. 4.2: sum_{t < T} gamma^t E_tr[zeta_1 ... zeta_t r(s_t, a_t)].

    zeta_k belongs to transition k. It is the value of the chain zeta * P_tr. The
    product starts at k = 1 (there is no transition before s_0), the expectation is over
    one path, and the sum over t is there (the paper's second line loses it).
    -> estimators.OffEnvironment
    """
    K = np.einsum("sa,sat->st", pi, zeta * P_tr)
    alpha = S_0
    total = 0.0
    for t in range(T):
        total = total + gamma**t * alpha @ (pi * r).sum(axis=1)
        alpha = alpha @ K
    return total


def algorithm_1(
    D_te, D_tr, shape, nu, mu, lam=0.0, eta=0.1, N=64, iterations=10_000, seed=0
):
    """Algorithm 1 on tables: stochastic gradient descent on eq. 3.7 for both ratios.

    Returns beta(s, a, s') and beta(s, a). D_te, D_tr: (n, 3) integers s, a, s'; shape:
    (S, A).
    -> ratio.Quotient(normalized=False, solver=ratio.Sgd(...))
    """
    (S, A) = shape
    draw = np.random.default_rng(seed)
    g_sas = np.ones((S, A, S))
    g_sa = np.ones((S, A))
    for _ in range(iterations):
        # lines 1 and 2, then 3 and 4: fresh batches for each
        for g, width in ((g_sa, 2), (g_sas, 3)):
            p = np.zeros(g.shape)
            q = np.zeros(g.shape)
            for share, D in ((p, D_te), (q, D_tr)):
                np.add.at(
                    share, tuple(D[draw.integers(len(D), size=N), :width].T), 1 / N
                )
            g[...] = np.clip(g - eta * (q - p / g + lam * g), nu, mu)
    return g_sas, g_sa


def theorem_1(n, nu, mu, delta, D_inf, K):
    """Eq. 5.1 (Theorem V.1): a bound on sup (g_n - g*)^2, with probability 1 - delta.

    -> theory.estimation_bound

    Wrong: no K fits all P and Q (it must grow as 1 / min q), as
    theory.universal_constant_counterexample shows.
    """
    spread = mu + max(np.log(mu), -np.log(nu)) + np.sqrt(2 * np.log(1 / delta))
    return K * np.exp(D_inf) * spread / np.sqrt(n)


def lemma(error, nu, mu):
    """Eq. 5.2 (Lemma V.1): a bound on sup abs(zeta_n - zeta*).

    Both ratios are within ``error`` = M(G, delta) / n^(1/4). True with probability
    1 - 2 delta, and loose: (mu + nu) / nu^2 is the tight factor.
    -> theory.ratio_error_bound
    """
    return mu * (1 + nu * mu) / nu**2 * error


def theorem_2(T, R, gamma, error, nu):
    """Eq. 5.3 (Theorem V.2): a bound on (J_te - J^zeta_n)^2 over t = 0..T.

    Rewards are at most R in size. The bracket is printed in closed form; gamma / nu
    times it is the sum below.
    -> theory.value_error_bound

    False: t for t^2, no factor of the lemma, and 1 / nu bounds no zeta, as
    theory.value_bound_counterexample shows.
    """
    return T * error**2 * R**2 * sum(t * (gamma / nu) ** t for t in range(1, T + 1))
