"""Answers to the code exercises of the assignments: right ones of a second kind, and
wrong ones that students give, each with a word of the hint that it gets.

An answer is written as a student writes it, with numpy alone. The first kind of right
answers stands in the instructor's notebooks.
"""

import numpy as np

from oee_tabular.testing.assignments import TASKS


def written(exercise, text):
    """The function of an expression, or of the body of a function."""
    call = TASKS[exercise]
    body = text if "return" in text or "raise" in text else f"return {text}"
    lines = [f"    {line}" for line in body.strip("\n").split("\n")]
    names = {"np": np}
    exec(f"def {call}:\n" + "\n".join(lines), names)
    return names[call.partition("(")[0]]


# with loops, or another way to the same
SECOND_KIND = {
    "1_risk": """
total = 0.0
for k in range(len(g)):
    total += q[k] * g[k]
    if p[k] > 0:
        total -= p[k] * np.log(g[k])
return total
""",
    "1_minimiser": """
g = []
for x in range(len(p)):
    best = p[x] / q[x]
    if best < nu:
        best = nu
    if best > mu:
        best = mu
    g.append(best)
return g
""",
    # the factor of the free values, for each number of values at the ends
    "1_normalised": """
order = np.argsort(p / q)
n = len(p)
for low in range(n + 1):
    for high in range(n + 1 - low):
        g = np.empty(n)
        g[order[:low]] = nu
        g[order[n - high :]] = mu
        free = order[low : n - high]
        rest = 1 - nu * q[order[:low]].sum() - mu * q[order[n - high :]].sum()
        if len(free) == 0:
            if abs(rest) > 1e-12:
                continue
        else:
            if p[free].sum() <= 0:
                continue
            g[free] = p[free] / q[free] * rest / p[free].sum()
            factor = rest / p[free].sum()
            ends = factor * p / q
            if g[free].min() < nu - 1e-12 or g[free].max() > mu + 1e-12:
                continue
            if (ends[order[:low]] > nu + 1e-12).any():
                continue
            if (ends[order[n - high :]] < mu - 1e-12).any():
                continue
        return g
return np.ones(n)
""",
    "2_support": """
for s in range(target.shape[0]):
    for a in range(target.shape[1]):
        for t in range(target.shape[2]):
            if target[s, a, t] > 0 and simulator[s, a, t] == 0:
                return False
return True
""",
    "2_ratio": """
zeta = np.zeros(target.shape)
for at in np.ndindex(*target.shape):
    if simulator[at] > 0:
        zeta[at] = target[at] / simulator[at]
return zeta
""",
    "2_counts": """
zeta = 1.0 * (simulator > 0)
for s, a in np.ndindex(*counts.shape[:2]):
    n = counts[s, a].sum()
    if n:
        for t in range(counts.shape[2]):
            if simulator[s, a, t]:
                zeta[s, a, t] = counts[s, a, t] / n / simulator[s, a, t]
return zeta
""",
    "3_values": """
V = np.zeros(len(r))
while True:
    new = np.zeros(len(r))
    for s in range(len(r)):
        for a in range(r.shape[1]):
            new[s] += policy[s, a] * (r[s, a] + discount * P[s, a] @ V)
    if np.abs(new - V).max() < 1e-12:
        return new
    V = new
""",
    "3_horizon": """
P_pi = sum(policy[:, a, None] * P[:, a] for a in range(r.shape[1]))
r_pi = sum(policy[:, a] * r[:, a] for a in range(r.shape[1]))
V, power = 0, np.eye(len(r))
for t in range(horizon):
    V = V + discount**t * power @ r_pi
    power = power @ P_pi
return V
""",
    "3_occupancy": """
state = mu
d = np.zeros(policy.shape)
for t in range(30_000):
    d += (1 - discount) * discount**t * state[:, None] * policy
    state = np.einsum("s,sa,sat->t", state, policy, P)
return d
""",
    "4_per_decision": """
values = []
for name in np.unique(episode):
    mine = episode == name
    s, a, t = state[mine], action[mine], timestep[mine]
    weight = np.cumprod(policy[s, a] / behavior[s, a])
    values.append((discount**t * weight * reward[mine]).sum())
return np.mean(values)
""",
    "4_weighted": """
last, value = {}, 0.0
for name in np.unique(episode):
    last[name] = 1.0
for t in range(max(timestep) + 1):
    above = 0.0
    for row in np.flatnonzero(timestep == t):
        pair = state[row], action[row]
        last[episode[row]] *= policy[pair] / behavior[pair]
        above += last[episode[row]] * reward[row]
    value += discount**t * above / sum(last.values())
return value
""",
    "5_percentile": """
ordered = sorted(statistics)
k = int((1 - confidence) / 2 * len(ordered))
return ordered[k], ordered[len(ordered) - 1 - k]
""",
    "5_bootstrap": """
returns = []
for name in sorted(set(episode)):
    total = 0.0
    for row in range(len(reward)):
        if episode[row] == name:
            total += discount ** timestep[row] * reward[row]
    returns.append(total)
rng = np.random.default_rng(seed)
return [
    np.mean(rng.choice(returns, size=len(returns))) for _ in range(n_resamples)
]
""",
    "6_costs": """
n, k = r.shape
V, d = np.zeros(n), np.zeros((n, k))
state = mu.copy()
for t in range(4000):
    V = (policy * (r + discount * P @ V)).sum(axis=1)
    d += (1 - discount) * discount**t * state[:, None] * policy
    state = np.einsum("s,sa,sat->t", state, policy, P)
c = np.zeros((n, k))
for s in range(n):
    for a in range(k):
        mean = sum(P[s, a, t] * V[t] for t in range(n))
        spread = sum(P[s, a, t] * (V[t] - mean) ** 2 for t in range(n))
        c[s, a] = (discount * d[s, a] / (1 - discount)) ** 2 * spread
return c
""",
    "6_design": """
total = sum(c**0.5 for c in costs.ravel())
return [[n * c**0.5 / total for c in row] for row in costs]
""",
    "6_variance": """
total = 0.0
for c, m in zip(costs.ravel(), counts.ravel()):
    if c > 0:
        total += c / m if m else float("inf")
return total
""",
    "7_shift": """
first = estimate(P, r, mu, discount, counts, policy)
changes = []
for c in [100, -100, 0.5]:
    changes.append(estimate(P, r + c, mu, discount, counts, policy) - first)
right = np.array([100, -100, 0.5]) / (1 - discount)
return np.abs(changes - right).max() < 1e-7 * np.abs(right).max()
""",
    "7_limit": """
V = np.zeros(len(r))
for _ in range(3000):
    V = (policy * (r + discount * target @ V)).sum(axis=1)
found = estimate(simulator, r, mu, discount, target * 1e9, policy)
return np.isclose(found, mu @ V, rtol=1e-6, atol=0)
""",
    # the variance of each policy's slopes and their covariance, row by row
    "8_gain": """
n = counts.sum(axis=2)
P = counts / counts.sum(axis=2, keepdims=True)
J, d, V = [], [], []
for policy in (running, candidate):
    v, x, state = np.zeros(len(r)), np.zeros(r.shape), mu.copy()
    for t in range(4000):
        v = (policy * (r + discount * P @ v)).sum(axis=1)
        x += discount**t * state[:, None] * policy
        state = np.einsum("s,sa,sat->t", state, policy, P)
    J.append(mu @ v)
    d.append(discount * x)
    V.append(v)
square = 0.0
for s in range(len(r)):
    for a in range(r.shape[1]):
        slope = d[1][s, a] * V[1] - d[0][s, a] * V[0]
        square += (P[s, a] @ slope**2 - (P[s, a] @ slope) ** 2) / n[s, a]
return [J[1] - J[0], max(square, 0) ** 0.5]
""",
    "8_decide": """
lower, upper = gain - 1.96 * error, gain + 1.96 * error
answer = "record"
if lower > cost:
    answer = "deploy"
elif upper < cost:
    answer = "keep"
return answer
""",
    "8_need": """
N = np.inf
if gain - cost > 0:
    N = float(int(n * 1.96**2 * error**2 / (gain - cost) ** 2))
    while gain - 1.96 * error * (n / max(N, 1e-9)) ** 0.5 < cost:
        N += 1
return N
""",
}

P_PI = 'np.einsum("sa,sat->st", policy, P)'
SOLVED = f"""
P_pi = {P_PI}
inverse = np.linalg.inv(np.eye(len(mu)) - discount * P_pi)
V = inverse @ (policy * r).sum(axis=1)
d = (1 - discount) * (mu @ inverse)[:, None] * policy
f = discount / (1 - discount)
spread = P @ V**2 - (P @ V) ** 2
"""
BOTH = """
n = counts.sum(axis=-1)
P = counts / n[:, :, None]
values, slopes = [], []
for policy in (running, candidate):
    P_pi = np.einsum("sa,sat->st", policy, P)
    inverse = np.linalg.inv(np.eye(len(mu)) - discount * P_pi)
    V = inverse @ (policy * r).sum(axis=1)
    d = (1 - discount) * (mu @ inverse)[:, None] * policy
    values.append(mu @ V)
    slopes.append(discount / (1 - discount) * d[:, :, None] * V)
gain = values[1] - values[0]

def variance(slope):
    mean = (P * slope).sum(axis=-1, keepdims=True)
    return (P * (slope - mean) ** 2).sum(axis=-1)

slope = slopes[1] - slopes[0]
"""
RETURNS = """
returns = np.bincount(episode, weights=discount**timestep * reward)
rng = np.random.default_rng(seed)
n = len(returns)
"""
RHO = "rho = policy[state, action] / behavior[state, action]\n"


def episodes(weight, end):
    """Importance sampling with one line of its own for the weight."""
    return f"""
values = []
for name in np.unique(episode):
    mine = episode == name
    rho = (policy / behavior)[state[mine], action[mine]]
    t = timestep[mine]
    weight = {weight}
    values.append((discount**t * weight * reward[mine]).sum())
return {end}
"""


def table(weight, step, factor="discount ** np.arange(T)"):
    """Weighted importance sampling on a table of episodes and steps."""
    return f"""
{RHO}
n, T = len(np.unique(episode)), timestep.max() + 1
i = np.cumsum(timestep == 0) - 1
ratio, pay = np.ones((n, T)), np.zeros((n, T))
here = np.zeros((n, T), dtype=bool)
ratio[i, timestep], pay[i, timestep], here[i, timestep] = rho, reward, True
weight = {weight}
step = {step}
return {factor} @ step
"""


# exercise, what a student writes, a word of the hint
WRONG = [
    ("1_risk", "q @ g + p @ np.log(g)", "subtracted"),
    ("1_risk", "p @ g - q @ np.log(g)", "exchanged"),
    ("1_risk", "q @ g - q @ np.log(g)", "over p, the target"),
    ("1_risk", "np.mean(q * g - p * np.log(g))", "the sum over x"),
    ("1_risk", "q @ g - p @ np.log2(g)", "natural logarithm"),
    ("1_risk", "-p @ np.log(g)", "as g grows"),
    ("1_risk", "1 - (q @ g - p @ np.log(g))", "1 less the risk"),
    ("1_risk", "p[p > 0] @ np.log(p[p > 0] / q[p > 0])", "does not depend on g"),
    ("1_risk", "g.sum() - p @ np.log(g)", "the weights q"),
    ("1_risk", "q @ g - p @ np.log(g)", "also where g = 0"),
    ("1_risk", "round(q @ g - p[p > 0] @ np.log(g[p > 0]), 2)", "rounded"),
    ("1_risk", "q * g - p * np.log(g)", "one number"),
    ("1_risk", "g /= 2\nreturn q @ g - p @ np.log(g)", "changes its argument g"),
    ("1_minimiser", "p / q", "without the box"),
    ("1_minimiser", "np.clip(q / p, nu, mu)", "not q / p"),
    ("1_minimiser", "np.minimum(p / q, mu)", "lower end nu"),
    ("1_minimiser", "np.maximum(p / q, nu)", "upper end mu"),
    (
        "1_minimiser",
        "g = np.clip(p / q, nu, mu)\nreturn g / (q @ g)",
        "the scale alone",
    ),
    ("1_minimiser", "np.clip(p / q, mu, nu)", "Hint"),
    ("1_minimiser", "np.clip(p, nu, mu) / np.clip(q, nu, mu)", "found alone"),
    ("1_normalised", "np.clip(p / q, nu, mu)", "inside of the box must change"),
    ("1_normalised", "g = np.clip(p / q, nu, mu)\nreturn g / (q @ g)", "one factor"),
    (
        "1_normalised",
        "g = np.clip(p / q, nu, mu)\nreturn np.clip(g / (q @ g), nu, mu)",
        "changes q @ g again",
    ),
    ("1_normalised", "p / q", "without the box"),
    (
        "1_normalised",
        "g = np.clip(p / q, nu, mu)\nreturn g + (1 - q @ g)",
        "share a factor",
    ),
    ("2_support", "bool(np.all((simulator > 0) <= (target > 0)))", "other way round"),
    ("2_support", "bool(np.all((simulator > 0) == (target > 0)))", "not be equal"),
    ("2_support", "bool(np.all(simulator > 0))", "is no fault"),
    (
        "2_support",
        "bool(np.all((simulator > 0) | (target < 1e-6)))",
        "small probability",
    ),
    ("2_support", "True", "True in every case"),
    ("2_support", "False", "False in every case"),
    ("2_support", "(simulator > 0) | (target == 0)", "True or False"),
    ("2_ratio", "simulator / target", "target over simulator"),
    ("2_ratio", "target / simulator", "0 / 0 is nan"),
    ("2_ratio", "np.nan_to_num(target / simulator, nan=1.0)", "and not 1"),
    ("2_ratio", "target - simulator", "difference"),
    ("2_ratio", "np.log(target / simulator)", "logarithm"),
    ("2_ratio", "np.clip(target / simulator, 0, 1)", "may be above 1"),
    ("2_ratio", "target / (simulator + 1e-3)", "treat zeros apart"),
    ("2_ratio", "target / simulator.mean(axis=1, keepdims=True)", "average over"),
    ("2_ratio", "target.sum(axis=1) / simulator.sum(axis=1)", "array of shape"),
    ("2_counts", "np.nan_to_num(counts / simulator)", "no probabilities"),
    ("2_counts", "counts / counts.sum(-1, keepdims=True) / simulator", "0 / 0 is nan"),
    (
        "2_counts",
        "np.nan_to_num(counts / counts.sum() / simulator)",
        "sum of all counts",
    ),
    (
        "2_counts",
        "n = counts.sum(-1, keepdims=True)\n"
        "return np.nan_to_num(counts / n / simulator)",
        "says nothing",
    ),
    ("2_counts", "counts / counts.sum(-1, keepdims=True)", "divide them by"),
    (
        "2_counts",
        "n = counts + (simulator > 0)\n"
        "return np.nan_to_num(n / n.sum(-1, keepdims=True) / simulator)",
        "is a prior",
    ),
    (
        "2_counts",
        "counts / counts.sum(axis=0, keepdims=True) / simulator",
        "last axis",
    ),
    (
        "3_values",
        f"np.linalg.solve(np.eye(len(r)) - discount * {P_PI}.T, (policy * r).sum(1))",
        "transposed",
    ),
    (
        "3_values",
        "np.linalg.solve(np.eye(len(r)) - discount * P.mean(axis=1), r.mean(axis=1))",
        "count the same",
    ),
    (
        "3_values",
        f"np.linalg.solve(np.eye(len(r)) - discount * {P_PI}, r.mean(axis=1))",
        "rewards are averaged",
    ),
    (
        "3_values",
        f"np.linalg.solve(np.eye(len(r)) - discount * {P_PI}, r.sum(axis=1))",
        "summed over actions",
    ),
    (
        "3_values",
        "V = np.zeros(len(r))\nfor _ in range(5000):\n"
        "    V = (r + discount * P @ V).max(axis=1)\nreturn V",
        "best policy",
    ),
    (
        "3_values",
        "V = np.zeros(len(r))\nfor _ in range(40):\n"
        "    V = (policy * (r + discount * P @ V)).sum(1)\nreturn V",
        "iterate V",
    ),
    (
        "3_values",
        f"(1 - discount) * np.linalg.solve("
        f"np.eye(len(r)) - discount * {P_PI}, (policy * r).sum(1))",
        "the sum itself",
    ),
    (
        "3_values",
        f"discount * np.linalg.solve("
        f"np.eye(len(r)) - discount * {P_PI}, (policy * r).sum(1))",
        "t begins at 0",
    ),
    ("3_values", "(policy * r).sum(axis=1)", "first reward alone"),
    (
        "3_values",
        f"np.linalg.solve(np.eye(len(r)) - {P_PI}, (policy * r).sum(1))",
        "Hint",
    ),
    ("3_values", "r + discount * P @ np.zeros(len(r))", "array of shape"),
    (
        "3_values",
        "V = np.zeros(len(P))\nfor a in range(P.shape[0]):\n"
        "    V += policy[:, a] * r[:, a]\nreturn V",
        "IndexError",
    ),
    (
        "3_horizon",
        "V = np.zeros(len(r))\nfor _ in range(horizon + 1):\n"
        "    V = (policy * (r + discount * P @ V)).sum(1)\nreturn V",
        "too many",
    ),
    (
        "3_horizon",
        "V = np.zeros(len(r))\nfor _ in range(horizon - 1):\n"
        "    V = (policy * (r + discount * P @ V)).sum(1)\nreturn V",
        "too few",
    ),
    (
        "3_horizon",
        "V = np.zeros(len(r))\nfor _ in range(horizon):\n"
        "    V = (policy * (r + P @ V)).sum(1)\nreturn V",
        "discount is missing",
    ),
    (
        "3_horizon",
        f"np.linalg.solve(np.eye(len(r)) - discount * {P_PI}, (policy * r).sum(1))",
        "without a horizon",
    ),
    (
        "3_occupancy",
        f"np.linalg.solve(np.eye(len(mu)) - discount * {P_PI}.T, mu)[:, None] * policy",
        "factor (1 - discount)",
    ),
    (
        "3_occupancy",
        f"(1 - discount) * np.linalg.solve("
        f"np.eye(len(mu)) - discount * {P_PI}, mu)[:, None] * policy",
        "flow goes forward",
    ),
    (
        "3_occupancy",
        f"(1 - discount) * np.linalg.solve("
        f"np.eye(len(mu)) - discount * {P_PI}.T, np.ones(len(mu)) / len(mu))[:, None]"
        " * policy",
        "drawn from mu",
    ),
    (
        "3_occupancy",
        f"(1 - discount) * np.linalg.solve(np.eye(len(mu)) - discount * {P_PI}.T, mu)",
        "array of shape",
    ),
    ("3_occupancy", "mu[:, None] * policy", "first step alone"),
    ("4_per_decision", episodes("np.prod(rho)", "np.mean(values)"), "Stop at t"),
    (
        "4_per_decision",
        episodes("np.append(1.0, np.cumprod(rho)[:-1])", "np.mean(values)"),
        "the action of step t",
    ),
    (
        "4_per_decision",
        episodes("np.cumprod(1 / rho)", "np.mean(values)"),
        "policy / behavior",
    ),
    ("4_per_decision", episodes("rho", "np.mean(values)"), "Multiply the ratios"),
    ("4_per_decision", episodes("1.0", "np.mean(values)"), "behaviour policy's value"),
    (
        "4_per_decision",
        episodes("np.cumprod(rho) / discount**t", "np.mean(values)"),
        "discount is missing",
    ),
    (
        "4_per_decision",
        RHO + "w = np.cumprod(rho)\n"
        "return (discount**timestep * w * reward).sum() / len(np.unique(episode))",
        "runs on",
    ),
    (
        "4_per_decision",
        episodes("np.cumprod(rho)", "sum(values) / len(state)"),
        "not of rows",
    ),
    ("4_per_decision", episodes("np.cumprod(rho)", "sum(values)"), "take the mean"),
    (
        "4_per_decision",
        episodes("np.cumprod(rho)", "np.median(values)"),
        "mean over episodes",
    ),
    ("4_per_decision", episodes("np.cumsum(rho)", "np.mean(values)"), "rho_0 rho_1"),
    ("4_per_decision", episodes("np.cumprod(rho)", "values"), "one number"),
    (
        "4_weighted",
        table("np.cumprod(ratio, axis=1)", "(weight * pay).sum(axis=0) / n"),
        "sum of its weights",
    ),
    (
        "4_weighted",
        table(
            "np.cumprod(ratio, axis=1) * here",
            "(weight * pay).sum(axis=0) / weight.sum(axis=0)",
        ),
        "keeps its last weight",
    ),
    (
        "4_weighted",
        table(
            "np.prod(ratio, axis=1, keepdims=True) * np.ones(T)",
            "(weight * pay).sum(axis=0) / weight.sum(axis=0)",
        ),
        "stop at t",
    ),
    (
        "4_weighted",
        table(
            "np.cumprod(1 / ratio, axis=1)",
            "(weight * pay).sum(axis=0) / weight.sum(axis=0)",
        ),
        "policy / behavior",
    ),
    (
        "4_weighted",
        table(
            "np.cumprod(ratio, axis=1)",
            "(weight * pay).sum(axis=0) / weight.sum(axis=0)",
            "np.ones(T)",
        ),
        "discount is missing",
    ),
    (
        "4_weighted",
        table("np.cumprod(ratio, axis=1)", "(weight * pay).sum(axis=0) / weight.max()"),
        "sum of weight",
    ),
    (
        "5_percentile",
        "np.quantile(statistics, [1 - confidence, confidence])",
        "to be halved",
    ),
    (
        "5_percentile",
        "np.quantile(statistics, [(1 + confidence) / 2, (1 - confidence) / 2])",
        "comes first",
    ),
    (
        "5_percentile",
        "m, s = statistics.mean(), statistics.std()\n"
        "return m - 1.959964 * s, m + 1.959964 * s",
        "symmetric",
    ),
    (
        "5_percentile",
        "np.percentile(statistics, [(1 - confidence) / 2, (1 + confidence) / 2])",
        "takes percents",
    ),
    ("5_percentile", "[min(statistics), max(statistics)]", "least and the largest"),
    ("5_percentile", "np.quantile(statistics, [0.025, 0.975])", "not always 0.95"),
    ("5_percentile", "np.quantile(statistics, [0, confidence])", "nothing out below"),
    (
        "5_percentile",
        "k = int((1 - confidence) / 2 * len(statistics))\n"
        "return statistics[k], statistics[int((1 + confidence) / 2 * len(statistics))]",
        "sort them first",
    ),
    ("5_percentile", "np.quantile(statistics, (1 - confidence) / 2)", "shape (2,)"),
    (
        "5_bootstrap",
        "rng = np.random.default_rng(seed)\nx = discount**timestep * reward\n"
        "k = len(x)\n"
        "return x[rng.integers(k, size=(n_resamples, k))].sum(1) / len(set(episode))",
        "whole episodes",
    ),
    (
        "5_bootstrap",
        "rng = np.random.default_rng(seed)\nx = discount**timestep * reward\n"
        "k = len(x)\nreturn x[rng.integers(k, size=(n_resamples, k))].mean(1)",
        "means over rows",
    ),
    (
        "5_bootstrap",
        "rng = np.random.default_rng(seed)\n"
        "x = np.bincount(episode, weights=reward)\nn = len(x)\n"
        "return x[rng.integers(n, size=(n_resamples, n))].mean(1)",
        "discount is missing",
    ),
    (
        "5_bootstrap",
        RETURNS + "return np.array("
        "[rng.permutation(returns).mean() for _ in range(n_resamples)])",
        "with replacement",
    ),
    ("5_bootstrap", RETURNS + "return rng.choice(returns, n_resamples)", "not one"),
    (
        "5_bootstrap",
        RETURNS + "return returns[rng.integers(n, size=(n_resamples, n // 2))].mean(1)",
        "not half",
    ),
    (
        "5_bootstrap",
        RETURNS + "return returns[rng.integers(n, size=(n_resamples, n))].sum(1)",
        "the statistic is the mean",
    ),
    (
        "5_bootstrap",
        RETURNS
        + "return rng.normal(returns.mean(), returns.std() / n**0.5, n_resamples)",
        "no normal distribution",
    ),
    (
        "5_bootstrap",
        RETURNS + "rng = np.random.default_rng()\n"
        "return returns[rng.integers(n, size=(n_resamples, n))].mean(1)",
        "two calls with one seed",
    ),
    (
        "5_bootstrap",
        RETURNS + "rng = np.random.default_rng(0)\n"
        "return returns[rng.integers(n, size=(n_resamples, n))].mean(1)",
        "another seed",
    ),
    (
        "5_bootstrap",
        RETURNS
        + "return np.sort(returns[rng.integers(n, size=(n_resamples, n))].mean(1))",
        "do not sort",
    ),
    (
        "5_bootstrap",
        RETURNS + "return returns[rng.integers(n, size=(n, n_resamples))].mean(1)",
        "array of shape",
    ),
    (
        "5_bootstrap",
        RETURNS + "return returns[rng.integers(n - 1, size=(n_resamples, n))].mean(1)",
        "last episode is never drawn",
    ),
    ("6_costs", SOLVED + "return f**2 * d * spread", "enters squared"),
    ("6_costs", SOLVED + "return d**2 * spread", "is missing"),
    ("6_costs", SOLVED + "return f * d**2 * spread", "enters squared"),
    (
        "6_costs",
        SOLVED + "return (d / (1 - discount)) ** 2 * spread",
        "discounted once",
    ),
    ("6_costs", SOLVED + "return (f * d) ** 2 * spread**0.5", "not its standard"),
    ("6_costs", SOLVED + "return (f * d) ** 2 * (P @ V**2)", "the square of the mean"),
    ("6_costs", SOLVED + "return (f * d) ** 2 * V.var()", "not over all states"),
    (
        "6_costs",
        SOLVED + "return (f * d.sum(1, keepdims=True)) ** 2 * spread",
        "not in the state",
    ),
    ("6_costs", SOLVED + "return (f * d) ** 2 * P.var(axis=2)", "not of the"),
    ("6_design", "n * costs / costs.sum()", "root of the cost"),
    ("6_design", "np.full(costs.shape, n / costs.size)", "equal costs"),
    ("6_design", "np.sqrt(costs) / np.sqrt(costs).sum()", "multiply by n"),
    ("6_design", "n * np.sqrt(costs / costs.sum())", "root of the sum"),
    ("6_design", "n * costs**2 / (costs**2).sum()", "not to its square"),
    (
        "6_design",
        "np.round(n * np.sqrt(costs) / np.sqrt(costs).sum())",
        "do not round",
    ),
    (
        "6_design",
        "n * np.sqrt(costs) / np.sqrt(costs).sum(axis=1, keepdims=True)",
        "all pairs together",
    ),
    ("6_design", "n * (1 / costs) / (1 / costs).sum()", "Hint"),
    ("6_variance", "costs.sum() / counts.sum()", "pair by pair"),
    ("6_variance", "np.mean(costs / counts)", "not the mean"),
    ("6_variance", "np.sqrt((costs / counts).sum())", "standard error"),
    ("6_variance", "(costs / counts).sum()", "0 / 0 is nan"),
    (
        "6_variance",
        "(costs[counts > 0] / counts[counts > 0]).sum()",
        "silence for certainty",
    ),
    ("6_variance", "(costs / np.maximum(counts, 1)).sum()", "not one transition"),
    ("7_shift", "True", "accepts an estimator that multiplies"),
    ("7_shift", "False", "refuses an estimator"),
    (
        "7_shift",
        "a = estimate(P, r, mu, discount, counts, policy)\n"
        "b = estimate(P, r + 1, mu, discount, counts, policy)\n"
        "return abs(b - a - 1) < 1e-8",
        "refuses an estimator",
    ),
    (
        "7_shift",
        "a = estimate(P, r, mu, discount, counts, policy)\n"
        "b = estimate(P, r + 0.01, mu, discount, counts, policy)\n"
        "return abs(b - a - 0.01 / (1 - discount)) < 1e-8",
        "accepts an estimator",
    ),
    (
        "7_shift",
        "a = estimate(P, r, mu, discount, counts, policy)\n"
        "b = estimate(P, r + 1, mu, discount, counts, policy)\n"
        "return abs(b - a - 1 / (1 - discount)) < 0.1 * abs(a)",
        "accepts an estimator",
    ),
    (
        "7_shift",
        "a = estimate(P, r, mu, discount, counts, policy)\n"
        "b = estimate(P, 2 * r, mu, discount, counts, policy)\n"
        "return abs(b - 2 * a) < 1e-8",
        "accepts an estimator",
    ),
    (
        "7_shift",
        "a = estimate(P, r, mu, discount, counts, policy)\n"
        "r += 1\n"
        "b = estimate(P, r, mu, discount, counts, policy)\n"
        "return abs(b - a - 1 / (1 - discount)) < 1e-8",
        "changes its argument r",
    ),
    ("7_shift", "estimate(P, r, mu, discount, counts, policy)", "True or False"),
    (
        "7_shift",
        "a = estimate(P, r, mu, discount, counts, policy)\n"
        "b = estimate(P, r + 5, mu, discount, counts, policy)\n"
        "return a + 5 / (1 - discount) == b",
        "refuses an estimator",
    ),
    ("7_limit", "True", "accepts an estimator that answers with the simulator"),
    ("7_limit", "False", "refuses an estimator"),
    (
        "7_limit",
        "P = target\n" + SOLVED + "found = estimate("
        "simulator, r, mu, discount, 1e9 * target, policy)\n"
        "return bool(abs(found - mu @ V) < 0.035 * abs(mu @ V))",
        "by 1%",
    ),
    (
        "7_limit",
        "P = simulator\n" + SOLVED + "found = estimate("
        "simulator, r, mu, discount, 1e9 * target, policy)\n"
        "return bool(abs(found - mu @ V) < 1e-6 * abs(mu @ V))",
        "refuses an estimator",
    ),
    (
        "7_limit",
        "P = target\n" + SOLVED + "found = estimate("
        "simulator, r, mu, discount, 10 * target, policy)\n"
        "return bool(abs(found - mu @ V) < 1e-6 * abs(mu @ V))",
        "refuses an estimator that adds",
    ),
    (
        "7_limit",
        "P = target\n" + SOLVED + "found = estimate("
        "target, r, mu, discount, 1e9 * target, policy)\n"
        "return bool(abs(found - mu @ V) < 1e-6 * abs(mu @ V))",
        "accepts an estimator that answers with the simulator",
    ),
    ("8_gain", BOTH + "return -gain, (variance(slope) / n).sum() ** 0.5", "less the"),
    (
        "8_gain",
        BOTH + "a, b = [(variance(x) / n).sum() for x in slopes]\n"
        "return gain, (a + b) ** 0.5",
        "not independent",
    ),
    (
        "8_gain",
        BOTH + "a, b = [(variance(x) / n).sum() ** 0.5 for x in slopes]\n"
        "return gain, a + b",
        "only at worst",
    ),
    ("8_gain", BOTH + "return gain, (variance(slopes[1]) / n).sum() ** 0.5", "alone"),
    ("8_gain", BOTH + "return gain, (variance(slope) / n).sum()", "its root"),
    ("8_gain", BOTH + "return gain, variance(slope).sum() ** 0.5", "by its count"),
    (
        "8_gain",
        BOTH + "return gain, (variance(slope) / n.sum()).sum() ** 0.5",
        "whole log's",
    ),
    (
        "8_gain",
        BOTH + "return gain, ((P * slope**2).sum(-1) / n).sum() ** 0.5",
        "square of their mean",
    ),
    ("8_gain", BOTH + "return gain", "array of shape (2,)"),
    ("8_decide", '"deploy" if gain > cost else "keep"', "use its standard error"),
    (
        "8_decide",
        'if gain - 1.96 * error > 0:\n    return "deploy"\n'
        'return "keep" if gain + 1.96 * error < 0 else "record"',
        "not with 0",
    ),
    (
        "8_decide",
        'if gain - error > cost:\n    return "deploy"\n'
        'return "keep" if gain + error < cost else "record"',
        "Hint",
    ),
    (
        "8_decide",
        'if gain - 1.96 * error > cost:\n    return "deploy"\nreturn "keep"',
        "record more",
    ),
    (
        "8_decide",
        'if gain - 1.96 * error > cost:\n    return "deploy"\nreturn "record"',
        "keep the running policy",
    ),
    (
        "8_decide",
        'if gain + 1.96 * error > cost:\n    return "deploy"\nreturn "keep"',
        "little is known",
    ),
    (
        "8_decide",
        'if gain - 1.96 * error > cost:\n    return "keep"\n'
        'return "deploy" if gain + 1.96 * error < cost else "record"',
        "exchanged",
    ),
    ("8_decide", "gain - 1.96 * error > cost", "'deploy' or 'keep' or 'record'"),
    ("8_decide", '"Deploy" if gain > cost else "Keep"', "'deploy' or 'keep'"),
    ("8_need", "np.ceil(n * 1.96 * error / (gain - cost))", "with the square"),
    ("8_need", "np.ceil(n * (error / (gain - cost)) ** 2)", "1.96 is missing"),
    ("8_need", "np.ceil(n * (1.96 * error / gain) ** 2)", "exceed the cost"),
    ("8_need", "np.ceil((1.96 * error / (gain - cost)) ** 2)", "multiply by n"),
    ("8_need", "np.ceil(n * (1.96 * error / (gain - cost)) ** 2)", "is enough: inf"),
    ("8_need", "n * (1.96 * error / (gain - cost)) ** 2", "round up"),
]
