r"""What to record next, so that the policies' values have the least variance.

What is recorded are state-action pairs, or what a behaviour policy visits.

Objects: x = (s, a) a row of the S*A; P' the model (S*A, S) at which variances are
evaluated; pi the policies, k = 1..K; n_x the log's counts (S*A,); q a distribution over
rows, (S*A,), of the next n transitions.

**Costs** (``costs``). From n_x observations of each row the best estimator of J has the
asymptotic variance sum_x c_x / n_x,

    c_x = Var_{s' ~ P'(.|x)}[G_x(s')],   G_x(s') = dJ / dP'(s' | x).

A row that P' makes deterministic has c_x = 0, which would leave the model's claim for
ever untested. Its cost is *optimistic* instead, the largest variance that is still
plausible: max Var_P[G_x] over

    lower_ratio R <= P <= upper_ratio R,
    R(.|s, a) = 0.9 P(.|s, a) + 0.05 mean_b P(.|s, b) + 0.05 1{s' = s},

P the simulator: something like another action is carried out, or nothing happens.
Without a box, any distribution on the support of R, with variance (range of G_x / 2)^2.
In a row with n_x observations, all of the one outcome, that outcome has moreover a
probability of at least (1 - confidence)^(1 / n_x), the exact (Clopper-Pearson) bound.
Terminal states cost 0. With a policy ``minus`` what is estimated is the gain J(pi) -
J(minus), and G is the difference of the two gradients, here and everywhere below.

**Plans** (``collection``, ``programs``, ``plan``). After n more transitions,
distributed as q, the variance of policy k is sum_x c_kx / (n_x + n q_x). A plan
minimises the largest relative inefficiency, convex in q,

    max_k F_k(q),   F_k(q) = sum_x C_kx / (b_x + q_x),   b_x = n_x / n,

with C_k = c_k / n over the least variance that a plan for k alone reaches: over all q
("free"; for one policy and no log Neyman's n_x ~ sqrt(c_x), value (sum sqrt c)^2 / n
[1]), or over what a behaviour policy can record ("behavior"), q in the occupancy
polytope of the collection MDP, which starts again after a transition with probability
rho (``restart``),

    q >= 0,   sum_a q(s', a) = rho mu_0(s') + (1 - rho) sum_x q(x) P'(s' | x)

    for every s'.

It is solved by an interior point method [2]: a Newton step for q, the multipliers v of
the flow (M q = m, kappa = M' v) and z of q >= 0, where conjugate gradients solve for v;
and one for the weights w of the policies, of which sum_k w_k F_k is least. Then q is
what the policy q / sum_a q records.

**Certificate.** For any v, with kappa = v(s) - (1 - rho) E_P' v(s') made nonnegative by
a constant added to v (Lagrange),

    sum_x min_{q >= 0} [sum_k w_k C_kx / (b_x + q) + kappa_x q]  -  rho mu_0 . v
        <=   min_q max_k F_k(q).

``Plan.gap`` is the distance of the two sides over the value, however q was found; gap =
0 is the equivalence theorem [3].

**Advice** (``advice``). The next pairs, one transition after another, that most reduce
the widths of the intervals.

References: [1] J. Neyman, J. Royal Statistical Society 97, 1934. [2] S. Wright,
Primal-Dual Interior-Point Methods, 1997. [3] F. Pukelsheim, Optimal Design of
Experiments, 1993, chapter 7.
"""

from oee_tabular.design.collection import plan_data_collection
from oee_tabular.design.plan import Outlook, Plan

__all__ = ["Outlook", "Plan", "plan_data_collection"]
