"""Wrong answers to the exercises of the assignments, more than assignment_answers has.

Each is written as a student writes it, with the beginning of the sentence that it gets.
"""

from assignment_answers import BOTH, RETURNS, SOLVED

EPISODES = """
values = []
for name in np.unique(episode):
    mine = episode == name
    rho = (policy / behavior)[state[mine], action[mine]]
    t = timestep[mine]
    weight = {weight}
    values.append((discount**{t} * weight * reward[mine]).sum())
return {end}
"""
TABLE = """
rho = policy[state, action] / behavior[state, action]
n, T = len(np.unique(episode)), timestep.max() + 1
i = {i}
ratio, pay = np.ones((n, T)), np.zeros((n, T))
here = np.zeros((n, T), dtype=bool)
ratio[i, timestep], pay[i, timestep], here[i, timestep] = rho, reward, True
weight = {weight}
step = {step}
return {out}
"""
BEFORE = "a = estimate(P, r, mu, discount, counts, policy)\n"
LONG_LOG = f"""P = target
{SOLVED}found = estimate(simulator, r, mu, discount, 1e9 * target, policy)
truth = mu @ V
"""


def episodes(weight="np.cumprod(rho)", end="np.mean(values)", t="t"):
    """Importance sampling episode by episode, with a line of its own."""
    return EPISODES.format(weight=weight, end=end, t=t)


def table(
    weight="np.cumprod(ratio, axis=1)",
    step="(weight * pay).sum(axis=0) / weight.sum(axis=0)",
    out="discount ** np.arange(T) @ step",
    i="np.cumsum(timestep == 0) - 1",
):
    """Weighted importance sampling on a table of episodes and steps."""
    return TABLE.format(weight=weight, step=step, out=out, i=i)


# exercise, what a student writes, a word of the hint
MORE_WRONG = [
    (
        "1_risk",
        "q @ g - p @ np.log(g + 1e-3)",
        "the risk is the sum of q g less the sum of",
    ),
    (
        "1_risk",
        "q @ g - p @ np.log(np.maximum(g, 1e-6))",
        "a small number is no 0: take log g as it",
    ),
    (
        "1_risk",
        "q @ g - p @ np.log(g + 1e-12)",
        "a small number is no 0: take log g as it",
    ),
    (
        "1_risk",
        "np.sum(q * (g - p / q * np.log(g)))",
        "where p = 0 the term p log g counts 0, also",
    ),
    (
        "1_risk",
        "t = p > 1e-5\nreturn q @ g - p[t] @ np.log(g[t])",
        "a small number is no 0: take log g as it",
    ),
    (
        "1_risk",
        "t = g > 1e-5\nreturn q[t] @ g[t] - p[t] @ np.log(g[t])",
        "a small number is no 0: take log g as it",
    ),
    (
        "1_risk",
        "t = p > 0\nreturn q[t] @ g[t] - p[t] @ np.log(g[t])",
        "where p = 0 only the term p log g is 0; q g",
    ),
    ("1_risk", "q @ g - p @ np.log1p(g)", "np.log1p(g) is log(1 + g); take np.log(g)."),
    ("1_risk", "q @ g - np.log(p @ g)", "this is the logarithm of a mean; the mean"),
    ("1_risk", "np.zeros(3)", "must return one number"),
    ("1_risk", "np.nan", "nan and inf come from a division by 0 or"),
    ("1_risk", "return", "returns nothing"),
    (
        "1_risk",
        "q @ g - p @ np.log(g) / len(g)",
        "the risk is the sum of q g less the sum of",
    ),
    (
        "1_risk",
        "2 * (q @ g - p[p > 0] @ np.log(g[p > 0]))",
        "this is the right result times 2; the risk",
    ),
    (
        "1_minimiser",
        "np.clip(p / (q + 1e-6), nu, mu)",
        "this is close and not exact: something",
    ),
    (
        "1_minimiser",
        "np.clip(p / np.maximum(q, 1e-3), nu, mu)",
        "small probabilities have a ratio as large",
    ),
    ("1_minimiser", "np.clip(p / q, 0.5, 2)", "the box is from nu to mu, which are"),
    (
        "1_minimiser",
        "np.clip(p / q, 1 / mu, mu)",
        "the lower end is nu, and not 1 / mu.",
    ),
    (
        "1_minimiser",
        "np.where((p / q < nu) | (p / q > mu), 1.0, p / q)",
        "what leaves the box goes to its nearer end,",
    ),
    (
        "1_minimiser",
        "np.where(p > 0, np.clip(p / q, nu, mu), 0)",
        "where p = 0 the ratio is 0, and g is the",
    ),
    (
        "1_minimiser",
        "np.where(p > 0, np.clip(p / q, nu, mu), 1)",
        "where p = 0 the ratio is 0, and g is the",
    ),
    (
        "1_minimiser",
        "np.clip(np.log(p / q), nu, mu)",
        "this cuts the logarithm; the box is for the",
    ),
    (
        "1_minimiser",
        "np.clip(p / q, nu, mu).sum()",
        "must return an array of shape (7,) with one",
    ),
    (
        "1_minimiser",
        "np.clip(p / q, nu, mu)[::-1]",
        "these are the right numbers in the reverse",
    ),
    (
        "1_minimiser",
        "np.clip(p / q, nu, mu).reshape(-1, 1)",
        "must return an array of shape (7,) with one",
    ),
    (
        "1_minimiser",
        "np.clip(p - q, nu, mu)",
        "this cuts the difference; the ratio p / q",
    ),
    (
        "1_minimiser",
        "np.full(len(p), np.nan)",
        "nan and inf come from a division by 0 or",
    ),
    (
        "1_minimiser",
        "np.clip(p / q, nu, mu).round(2)",
        "the result is rounded to 2 digits; leave it",
    ),
    (
        "1_minimiser",
        "np.clip(p / q, nu, mu) * 2",
        "this is the right result times 2; the risk",
    ),
    (
        "1_normalised",
        "p / q / (p / q).sum()",
        "it is q @ g that is 1, and not the sum of",
    ),
    ("1_normalised", "np.ones(len(p))", "g = 1 sums to 1 and is in the box; its risk"),
    (
        "1_normalised",
        """
g = np.clip(p / q, nu, mu)
for _ in range(3):
    g = np.clip(g / (q @ g), nu, mu)
return g
""",
        "with a multiplier l of the constraint, g =",
    ),
    (
        "1_normalised",
        """
lo, hi = 1.0, 100.0
for _ in range(100):
    m = (lo + hi) / 2
    g = np.clip(p / (m * q), nu, mu)
    if q @ g > 1:
        lo = m
    else:
        hi = m
return g
""",
        "the sum of q g is not 1 here. The values",
    ),
    (
        "1_normalised",
        """
lo, hi = 0.01, 1.0
for _ in range(100):
    m = (lo + hi) / 2
    g = np.clip(p / (m * q), nu, mu)
    if q @ g > 1:
        lo = m
    else:
        hi = m
return g
""",
        "q @ g of the cut ratio is above 1: here l >",
    ),
    (
        "1_normalised",
        """
lo, hi = 0.01, 100.0
for _ in range(15):
    m = (lo + hi) / 2
    g = np.clip(p / (m * q), nu, mu)
    if q @ g > 1:
        lo = m
    else:
        hi = m
return g
""",
        "with a multiplier l of the constraint, g =",
    ),
    (
        "1_normalised",
        """
lo, hi = 0.01, 100.0
for _ in range(100):
    m = (lo + hi) / 2
    g = np.clip(p / (m * q), nu, mu)
    if q @ g < 1:
        lo = m
    else:
        hi = m
return g
""",
        "this is the lower end everywhere: q @ g",
    ),
    (
        "1_normalised",
        """
lo, hi = 0.01, 100.0
for _ in range(100):
    m = (lo + hi) / 2
    g = np.clip(p / (m * q), nu, mu)
    if g.sum() > 1:
        lo = m
    else:
        hi = m
return g
""",
        "this is the lower end everywhere: q @ g",
    ),
    (
        "1_normalised",
        """
lo, hi = 0.01, 100.0
for _ in range(100):
    m = (lo + hi) / 2
    g = np.clip(p / (m * q), nu, mu)
    if p @ g > 1:
        lo = m
    else:
        hi = m
return g
""",
        "with a multiplier l of the constraint, g =",
    ),
    (
        "1_normalised",
        """
lo, hi = -0.9, 100.0
for _ in range(100):
    m = (lo + hi) / 2
    g = np.clip(p / (m * q), nu, mu)
    if q @ g > 1:
        lo = m
    else:
        hi = m
return m
""",
        "must return an array of shape (7,) with one",
    ),
    (
        "1_normalised",
        """
lo, hi = 0.01, 100.0
for _ in range(100):
    m = (lo + hi) / 2
    g = np.clip(p / (m * q), 0.5, 2)
    if q @ g > 1:
        lo = m
    else:
        hi = m
return g
""",
        "with a multiplier l of the constraint, g =",
    ),
    (
        "2_support",
        "bool(np.all(simulator[target > 1e-3] > 0))",
        "a small probability is a probability:",
    ),
    (
        "2_support",
        "bool(np.all(simulator[target > 0] > 1e-6))",
        "a small probability is a probability:",
    ),
    (
        "2_support",
        "bool(np.all(simulator[target > 0] > 1e-3))",
        "a small probability is a probability:",
    ),
    (
        "2_support",
        "bool(np.all(target <= simulator))",
        "the target's probability may be larger;",
    ),
    (
        "2_support",
        "bool(np.any(simulator[target > 0] > 0))",
        "True in every case. One common transition",
    ),
    (
        "2_support",
        "bool(np.any(simulator[target > 0] == 0))",
        "True and False are exchanged.",
    ),
    (
        "2_support",
        "bool(np.count_nonzero(target) <= np.count_nonzero(simulator))",
        "how many transitions there are says",
    ),
    (
        "2_support",
        "bool(np.all(simulator.sum(1)[target.sum(1) > 0] > 0))",
        "each action has a row of its own; do not",
    ),
    (
        "2_support",
        "bool(np.all(simulator.sum(0)[target.sum(0) > 0] > 0))",
        "each state has a row of its own; do not sum",
    ),
    (
        "2_support",
        "bool(np.all(simulator[0][target[0] > 0] > 0))",
        "the answer is False if there is a",
    ),
    (
        "2_support",
        "bool(np.all(simulator[:, 0][target[:, 0] > 0] > 0))",
        "the answer is False if there is a",
    ),
    (
        "2_support",
        "bool(np.isclose(target[simulator == 0], 0).all())",
        "a small probability is a probability;",
    ),
    (
        "2_support",
        "bool(np.isfinite(target / simulator).all())",
        "a transition that neither of the two makes",
    ),
    (
        "2_support",
        "bool(np.all(target[simulator == 0].sum() < 1e-5))",
        "a small probability is a probability:",
    ),
    (
        "2_support",
        "int(np.all(simulator[target > 0] > 0))",
        "must return True or False",
    ),
    ("2_support", "'yes'", "must return True or False"),
    ("2_support", "[True]", "must return True or False"),
    ("2_support", "np.array([True])", "must return True or False"),
    (
        "2_ratio",
        "target / np.maximum(simulator, 1e-3)",
        "divide by the simulator's probability as it",
    ),
    (
        "2_ratio",
        "target / np.maximum(simulator, 1e-5)",
        "divide by the simulator's probability as it",
    ),
    (
        "2_ratio",
        "target / np.maximum(simulator, 1e-8)",
        "divide by the simulator's probability as it",
    ),
    (
        "2_ratio",
        "target / (simulator + 1e-12)",
        "divide by the simulator's probability as it",
    ),
    (
        "2_ratio",
        "target / (simulator + 1e-8)",
        "this is close and not exact: something",
    ),
    (
        "2_ratio",
        "np.where(simulator > 1e-3, target / simulator, 0)",
        "divide by the simulator's probability as it",
    ),
    (
        "2_ratio",
        "np.where(simulator > 1e-5, target / simulator, 0)",
        "divide by the simulator's probability as it",
    ),
    (
        "2_ratio",
        "np.where(simulator > 0, target / simulator, 1)",
        "where the simulator never goes, write 0,",
    ),
    (
        "2_ratio",
        "np.minimum(np.where(simulator > 0, target / simulator, 0), 100)",
        "a ratio may be very large and is not cut;",
    ),
    (
        "2_ratio",
        "np.where(simulator > 0, target / simulator, 0).sum(axis=-1)",
        "must return an array of shape (3, 2, 3)",
    ),
    (
        "2_ratio",
        "np.where(simulator > 0, target / simulator, 0).transpose(1, 0, 2)",
        "must return an array of shape (3, 2, 3)",
    ),
    (
        "2_ratio",
        """
z = np.nan_to_num(target / simulator)
return z / z.sum(axis=-1, keepdims=True)
""",
        "the ratio itself need not sum to 1. What",
    ),
    (
        "2_ratio",
        "np.nan_to_num(target.transpose(2, 1, 0) / simulator)",
        "zeta[s, a, t] = target[s, a, t] /",
    ),
    (
        "2_ratio",
        "np.nan_to_num(target.mean(0, keepdims=True) / simulator, posinf=0)",
        "zeta[s, a, t] = target[s, a, t] /",
    ),
    (
        "2_ratio",
        "np.where(target > 0, target / simulator, 1)",
        "where the simulator never goes, write 0,",
    ),
    (
        "2_ratio",
        "np.where(simulator > 0, target / simulator, np.nan)",
        "0 / 0 is nan; where the simulator never",
    ),
    (
        "2_ratio",
        "np.round(np.where(simulator > 0, target / simulator, 0), 3)",
        "the result is rounded to 3 digits; leave it",
    ),
    (
        "2_ratio",
        "np.exp(np.nan_to_num(np.log(target) - np.log(simulator)))",
        "where the simulator never goes, write 0,",
    ),
    ("2_ratio", "target *= 2\nreturn target", "changes its argument target"),
    ("2_ratio", "target.astype(int)", "all entries are 0; zeta[s, a, t] ="),
    (
        "2_ratio",
        "np.full(target.shape, np.nan)",
        "nan and inf come from a division by 0 or",
    ),
    (
        "2_ratio",
        "(target / simulator).astype(str)",
        "must return an array of shape (3, 2, 3)",
    ),
    (
        "2_ratio",
        "(target > 0) & (simulator > 0)",
        "must return an array of shape (3, 2, 3)",
    ),
    ("2_ratio", "list(target)", "these are the target's probabilities;"),
    ("2_ratio", "target.reshape(-1)", "must return an array of shape (3, 2, 3)"),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
z = np.where(n > 0, counts / np.maximum(n, 1) / np.maximum(simulator, 1e-3), 1.0)
return np.where(simulator > 0, z, 0)
""",
        "a ratio may be very large and is not cut;",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
with np.errstate(all="ignore"):
    z = np.where(simulator > 0, counts / np.maximum(n, 1) / simulator, 0)
return np.where(n > 0, z, 1.0)
""",
        "a pair without counts has the ratio 1 only",
    ),
    (
        "2_counts",
        """
c = np.where(simulator > 0, counts, 0)
n = c.sum(-1, keepdims=True)
with np.errstate(all="ignore"):
    z = np.where(simulator > 0, c / np.maximum(n, 1) / simulator, 0)
return np.where(n > 0, z, 1.0 * (simulator > 0))
""",
        "a transition that the simulator never makes",
    ),
    (
        "2_counts",
        "n = counts.sum(0, keepdims=True)\nreturn counts / n / simulator",
        "the sum is over the next state, the last",
    ),
    (
        "2_counts",
        "n = counts.sum(1, keepdims=True)\nreturn counts / n / simulator",
        "the sum is over the next state, the last",
    ),
    (
        "2_counts",
        "n = counts.sum((0, 1), keepdims=True)\nreturn counts / n / simulator",
        "the last axis, and not over states and actions",
    ),
    (
        "2_counts",
        """
n = counts.sum((1, 2), keepdims=True)
f = np.where(n > 0, counts / np.maximum(n, 1), simulator)
return np.divide(f, simulator, out=np.zeros(f.shape), where=simulator > 0)
""",
        "divide by n(s, a), and not by the sum of the state",
    ),
    (
        "2_counts",
        """
n = counts.sum(1, keepdims=True)
f = np.where(n > 0, counts / np.maximum(n, 1), simulator)
return np.divide(f, simulator, out=np.zeros(f.shape), where=simulator > 0)
""",
        "the last axis, and not over actions",
    ),
    (
        "2_counts",
        """
n = counts.sum(0, keepdims=True)
f = np.where(n > 0, counts / np.maximum(n, 1), simulator)
return np.divide(f, simulator, out=np.zeros(f.shape), where=simulator > 0)
""",
        "the last axis, and not over states.",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = (counts + simulator) / (n + 1)
return np.divide(f, simulator, out=np.zeros(f.shape), where=simulator > 0)
""",
        "counts as one transition more of each pair",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = counts / (n + 1)
return np.divide(f, simulator, out=np.zeros(f.shape), where=simulator > 0)
""",
        "a number that is added to n(s, a), or taken",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
z = np.zeros_like(counts)
for i in np.ndindex(*counts.shape):
    if simulator[i] > 0:
        z[i] = counts[i] / n[i[0], i[1], 0] / simulator[i] if n[i[0], i[1], 0] else 1
return z
""",
        "the fractions are cut off: // gives none, and an array of",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = np.where(n > 0, counts / np.maximum(n, 1), 1 / counts.shape[-1])
return np.where(simulator > 0, f / np.where(simulator > 0, simulator, 1), 0)
""",
        "a pair (s, a) without counts keeps the",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = (counts + 1e-3) / (n + 1e-3 * counts.shape[-1])
return np.where(simulator > 0, f / np.where(simulator > 0, simulator, 1), 0)
""",
        "this is close and not exact: something",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = np.where(n > 0, counts / np.maximum(n, 1), 0)
return np.where(simulator > 0, f / np.where(simulator > 0, simulator, 1), 0)
""",
        "a pair without counts says nothing: its",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = np.where(n > 5, counts / np.maximum(n, 1), simulator)
return np.where(simulator > 0, f / np.where(simulator > 0, simulator, 1), 0)
""",
        "the frequencies of a pair, counts / (sum of",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = np.where(n > 1, counts / np.maximum(n, 1), simulator)
return np.where(simulator > 0, f / np.where(simulator > 0, simulator, 1), 0)
""",
        "each pair (s, a) has a sum of counts of its",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = np.where(counts > 0, counts / np.maximum(n, 1), simulator)
return np.where(simulator > 0, f / np.where(simulator > 0, simulator, 1), 0)
""",
        "a next state that was not seen has the frequency 0",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = np.where(n > 0, counts / np.maximum(n, 1), simulator)
return f / np.where(simulator > 0, simulator, 1)
""",
        "such a transition counts in n(s, a), and",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = np.where(n > 0, counts / np.maximum(n, 1), simulator)
z = np.where(simulator > 0, f / np.where(simulator > 0, simulator, 1), 0)
return z / (z * simulator).sum(-1, keepdims=True)
""",
        "a transition that the simulator never makes",
    ),
    (
        "2_counts",
        "n = counts.sum(-1)\nreturn counts / n / simulator",
        "raises ValueError",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = (counts + 3 * simulator) / (n + 3)
return np.divide(f, simulator, out=np.zeros(f.shape), where=simulator > 0)
""",
        "the frequencies of a pair, counts",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = (counts + 2 * simulator) / (n + 2)
return np.divide(f, simulator, out=np.zeros(f.shape), where=simulator > 0)
""",
        "counts as two transitions more",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = (counts + counts.shape[2] * simulator) / (n + counts.shape[2])
return np.divide(f, simulator, out=np.zeros(f.shape), where=simulator > 0)
""",
        "as many transitions as there are states more",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = counts // n
return np.divide(f, simulator, out=np.zeros(f.shape), where=simulator > 0)
""",
        "// cuts the fractions off",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = counts / np.maximum(n - 1, 1)
return np.divide(f, simulator, out=np.zeros(f.shape), where=simulator > 0)
""",
        "a number that is added to n(s, a), or taken",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = counts / counts.max(-1, keepdims=True)
return np.divide(f, simulator, out=np.zeros(f.shape), where=simulator > 0)
""",
        "and not by its largest count",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = counts / (counts > 0).sum(-1, keepdims=True)
return np.divide(f, simulator, out=np.zeros(f.shape), where=simulator > 0)
""",
        "and not by the number of its entries",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = counts * 1.0
return np.divide(f, simulator, out=np.zeros(f.shape), where=simulator > 0)
""",
        "counts are no probabilities",
    ),
    ("2_counts", "counts", "these are the counts"),
    ("2_counts", "simulator", "these are the simulator's probabilities"),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = np.where(n > 0, counts / np.maximum(n, 1), simulator)
z = np.divide(f, simulator, out=np.zeros(f.shape), where=simulator > 0)
return np.minimum(z, 4)
""",
        "what is above 4 is cut off",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = np.where(n > 0, counts / np.maximum(n, 1), simulator)
z = np.empty(counts.shape)
for k in np.ndindex(*z.shape):
    if simulator[k] > 0:
        z[k] = f[k] / simulator[k]
return z
""",
        "entries were never written: np.empty",
    ),
    (
        "2_ratio",
        "np.divide(target, simulator, where=simulator > 0)",
        "entries were never written: np.empty, and np.divide with where=",
    ),
    ("2_ratio", "target * simulator", "this is the product"),
    (
        "2_ratio",
        """
z = np.nan_to_num(target / simulator)
z[z < 0.05] = 0
return z
""",
        "the quotient is small and not 0",
    ),
    (
        "2_counts",
        """
n = counts.sum(-1, keepdims=True)
f = np.where(n > 0, counts / np.maximum(n, 1), simulator)
f = np.where((n > 0) & (f < 0.01), 0, f)
return np.divide(f, simulator, out=np.zeros(f.shape), where=simulator > 0)
""",
        "a small frequency is no 0",
    ),
    (
        "2_support",
        """
ok = True
for k in np.ndindex(*target.shape):
    if target[k] > 0 and simulator[k] == 0:
        ok = not ok
return ok
""",
        "One transition outside is enough, and so are two.",
    ),
    (
        "2_support",
        """
met, new = set(), {0}
while new:
    met |= new
    new = set(np.flatnonzero(target[sorted(met)].sum((0, 1)))) - met
met = sorted(met)
return bool(np.all(simulator[met][target[met] > 0] > 0))
""",
        "how many transitions there are says nothing",
    ),
    ("2_ratio", "1.0 * (simulator > 0)", "these are ones"),
    (
        "2_ratio",
        "np.nan_to_num(target / simulator).transpose(2, 1, 0)",
        "the axes 0 and 2 of the result are exchanged",
    ),
    (
        "2_ratio",
        """
z = np.zeros((3, 2, 3))
for k in np.ndindex(*z.shape):
    if simulator[k] > 0:
        z[k] = target[k] / simulator[k]
return z
""",
        "in case 0: take sizes from the arguments.",
    ),
    (
        "2_support",
        "bool(((target > 0).sum(2) <= (simulator > 0).sum(2)).all())",
        "how many transitions there are says nothing",
    ),
    ("2_support", "bool((simulator.T[target > 0] > 0).all())", "are exchanged"),
    (
        "3_values",
        """
V = np.zeros(len(r))
for _ in range(1000):
    V = (policy * (r + discount * P @ V)).sum(1)
return V
""",
        "with a discount near 1 rewards count for",
    ),
    (
        "3_values",
        """
M = np.eye(len(r)) - discount * np.einsum("sa,sat->st", policy, P)
return np.linalg.solve(M, (policy * r).sum(1)).round(3)
""",
        "the result is rounded to 3 digits; leave it",
    ),
    (
        "3_values",
        """
M = np.eye(len(r)) - discount * np.einsum("sa,sat->st", policy, P)
V = np.linalg.solve(M, (policy * r).sum(1))
V[-1] = 0
return V
""",
        "solve (I - discount P_pi) V = r_pi, where",
    ),
    (
        "3_values",
        """
M = np.eye(len(r)) - discount * np.einsum("sa,sat->st", policy, P)
V = np.linalg.solve(M, (policy * r).sum(1))
return V[:, None]
""",
        "must return an array of shape (5,) with one",
    ),
    (
        "3_values",
        """
M = np.eye(len(r)) - discount * np.einsum("sa,sat->st", policy, P)
V = np.linalg.solve(M, (policy * r).sum(1))
return r + discount * P @ V
""",
        "must return an array of shape (5,) with one",
    ),
    (
        "3_values",
        """
M = np.eye(len(r)) - discount * np.einsum("sa,sat->st", policy, P)
V = np.linalg.solve(M, (policy * r).sum(1))
return V.mean()
""",
        "must return an array of shape (5,) with one",
    ),
    (
        "3_values",
        """
M = np.eye(len(r)) + discount * np.einsum("sa,sat->st", policy, P)
return np.linalg.solve(M, (policy * r).sum(1))
""",
        "the matrix is I - discount P_pi, with a",
    ),
    (
        "3_values",
        """
M = np.eye(len(r)) - discount * np.einsum("sa,sat->st", policy, P)
return M @ (policy * r).sum(1)
""",
        "this multiplies by the matrix I - discount",
    ),
    (
        "3_values",
        """
M = np.eye(len(r)) - discount * np.einsum("sa,sat->st", policy, P)
return -np.linalg.solve(M, (policy * r).sum(1))
""",
        "the sign is wrong: this is the right result",
    ),
    (
        "3_values",
        """
M = np.eye(len(r)) - discount * P.sum(1)
return np.linalg.solve(M, (policy * r).sum(1))
""",
        "the transitions are summed over actions;",
    ),
    (
        "3_values",
        """
M = np.eye(len(r)) - 0.9 * np.einsum("sa,sat->st", policy, P)
return np.linalg.solve(M, (policy * r).sum(1))
""",
        "the discount is an argument, and not always",
    ),
    (
        "3_values",
        """
V = np.zeros(len(r))
for _ in range(3000):
    V = r.max(1) + discount * np.einsum("sa,sat->st", policy, P) @ V
return V
""",
        "this takes the best reward; average with",
    ),
    (
        "3_values",
        """
V = np.zeros(len(r))
while True:
    new = (policy * (r + discount * P @ V)).sum(1)
    if np.abs(new - V).max() < 1e-4:
        return new
    V = new
""",
        "this is close and not exact: something",
    ),
    (
        "3_horizon",
        """
M = np.eye(len(r)) - discount * np.einsum("sa,sat->st", policy, P)
V = np.linalg.solve(M, (policy * r).sum(1))
K = discount * np.einsum("sa,sat->st", policy, P)
return V - np.linalg.matrix_power(K, horizon) @ V
""",
        "with a discount of 1 the sum of T rewards",
    ),
    (
        "3_horizon",
        """
V = np.zeros(len(r))
for t in range(horizon):
    V = V + discount**t * (policy * r).sum(1)
return V
""",
        "begin with V = 0 and repeat V = r_pi +",
    ),
    (
        "3_horizon",
        """
V = np.zeros(len(r))
for _ in range(min(horizon, 100)):
    V = (policy * (r + discount * P @ V)).sum(1)
return V
""",
        "the horizon may be long: repeat the step as",
    ),
    (
        "3_horizon",
        """
V = np.zeros(len(r))
for _ in range(horizon):
    V = (r + discount * P @ V).max(axis=1)
return V
""",
        "these are the values of the best policy, by",
    ),
    (
        "3_horizon",
        """
V = np.zeros(len(r))
for _ in range(horizon):
    V = (r + discount * P @ V).mean(axis=1)
return V
""",
        "all actions count the same here; average",
    ),
    (
        "3_horizon",
        """
V = np.zeros(len(r))
for _ in range(horizon):
    V = (policy * (r + discount * P @ V)).sum(1)
return V * (1 - discount)
""",
        "this is the right result times (1 -",
    ),
    (
        "3_horizon",
        """
V = np.zeros(len(r))
for _ in range(horizon):
    V = (policy * (r + discount * P @ V)).sum(1)
return V / horizon
""",
        "this is the right result times 1 / horizon;",
    ),
    (
        "3_horizon",
        """
V = np.zeros(len(r))
for t in range(horizon):
    V = (policy * (r + discount**t * P @ V)).sum(1)
return V
""",
        "begin with V = 0 and repeat V = r_pi +",
    ),
    (
        "3_horizon",
        """
V = (policy * r).sum(1)
for _ in range(horizon):
    V = (policy * (r + discount * P @ V)).sum(1)
return V
""",
        "this has one reward too many: horizon T",
    ),
    (
        "3_horizon",
        """
V = np.zeros(len(r))
out = []
for _ in range(horizon):
    V = (policy * (r + discount * P @ V)).sum(1)
    out.append(V)
return out
""",
        "must return an array of shape (4,) with one",
    ),
    (
        "3_horizon",
        """
V = np.ones(len(r))
for _ in range(horizon):
    V = (policy * (r + discount * P @ V)).sum(1)
return V
""",
        "every entry is the right one plus 0.347928;",
    ),
    (
        "3_occupancy",
        """
P_pi = np.einsum("sa,sat->st", policy, P)
d = (1 - discount) * np.linalg.solve(np.eye(len(mu)) - discount * P_pi.T, mu)
return d[:, None] / policy.shape[1] + 0 * policy
""",
        "multiply the time in a state by the",
    ),
    (
        "3_occupancy",
        """
P_pi = P.mean(1)
d = (1 - discount) * np.linalg.solve(np.eye(len(mu)) - discount * P_pi.T, mu)
return d[:, None] * policy
""",
        "the way through the states follows the",
    ),
    (
        "3_occupancy",
        """
state, d = mu, np.zeros(policy.shape)
for t in range(500):
    d += (1 - discount) * discount**t * state[:, None] * policy
    state = np.einsum("s,sa,sat->t", state, policy, P)
return d
""",
        "with a discount near 1 rewards count for",
    ),
    (
        "3_occupancy",
        """
state, d = mu, np.zeros(policy.shape)
for t in range(500):
    d += state[:, None] * policy
    state = np.einsum("s,sa,sat->t", state, policy, P)
return d / d.sum()
""",
        "d(s) = (1 - discount) mu(s) + discount",
    ),
    (
        "3_occupancy",
        """
state, d = mu, np.zeros(policy.shape)
for t in range(20000):
    d += discount**t * state[:, None] * policy
    state = np.einsum("s,sa,sat->t", state, policy, P)
return d
""",
        "the factor (1 - discount) is missing: the",
    ),
    (
        "3_occupancy",
        """
state, d = mu, np.zeros(policy.shape)
for t in range(20000):
    state = np.einsum("s,sa,sat->t", state, policy, P)
    d += (1 - discount) * discount**t * state[:, None] * policy
return d
""",
        "the first step is missing: t begins at 0.",
    ),
    (
        "3_occupancy",
        """
P_pi = np.einsum("sa,sat->st", policy, P)
d = (1 - discount) * np.linalg.solve(np.eye(len(mu)) - discount * P_pi.T, mu)
return policy.T * d
""",
        "must return an array of shape (5, 2) with",
    ),
    (
        "3_occupancy",
        """
P_pi = np.einsum("sa,sat->st", policy, P)
d = (1 - discount) * np.linalg.solve(np.eye(len(mu)) - discount * P_pi.T, mu)
return d[:, None] + policy
""",
        "d(s) = (1 - discount) mu(s) + discount",
    ),
    (
        "3_occupancy",
        """
P_pi = np.einsum("sa,sat->st", policy, P)
d = np.linalg.solve(np.eye(len(mu)) - discount * P_pi.T, mu)
x = d[:, None] * policy
return x / x.sum(axis=1, keepdims=True)
""",
        "each state's entries sum to 1 here; all",
    ),
    (
        "3_occupancy",
        "np.full(policy.shape, 1 / policy.size)",
        "the pairs are not equally frequent; follow",
    ),
    (
        "3_occupancy",
        """
P_pi = np.einsum("sa,sat->st", policy, P)
d = (1 - discount) * np.linalg.solve(np.eye(len(mu)) - discount * P_pi.T, mu)
x = d[:, None] * policy
x[mu == 0] = 0
return x / x.sum()
""",
        "a state that leads to itself is a state as",
    ),
    (
        "4_per_decision",
        episodes("np.minimum(np.cumprod(rho), 1)"),
        "a weight may be above 1; it is not cut.",
    ),
    (
        "4_per_decision",
        episodes("np.minimum(np.cumprod(rho), 10)"),
        "weights may be large; they are not cut.",
    ),
    (
        "4_per_decision",
        episodes("rho[0]"),
        "the ratio of the first step is not enough;",
    ),
    (
        "4_per_decision",
        episodes("np.cumprod(rho)/np.cumprod(rho).sum()"),
        "in each episode the reward of step t has",
    ),
    (
        "4_per_decision",
        episodes(end="np.sum(values) / (episode.max() + 1)"),
        "divide by the number of episodes; their",
    ),
    (
        "4_per_decision",
        episodes(end="np.sum(values) / (timestep.max() + 1)"),
        "divide by the number of episodes, and not",
    ),
    (
        "4_per_decision",
        episodes(end="np.mean([v for v in values if v != 0] or [0.0])"),
        "a weight may be 0; the episode still counts",
    ),
    (
        "4_per_decision",
        episodes(t="(t + 1)"),
        "this is the right result times discount; in",
    ),
    (
        "4_per_decision",
        episodes(t="np.flatnonzero(mine)"),
        "discount by the step in the episode,",
    ),
    (
        "4_per_decision",
        episodes("np.cumprod(rho)[::-1]"),
        "in each episode the reward of step t has",
    ),
    (
        "4_per_decision",
        episodes("np.cumprod(policy[state[mine], action[mine]])"),
        "the ratio is policy / behavior; the",
    ),
    (
        "4_per_decision",
        episodes("np.cumprod(np.maximum(rho, 1e-3))"),
        "a weight may be 0; the episode still counts",
    ),
    (
        "4_per_decision",
        """
n = episode.max() + 1
total = 0
for e in range(n):
    w = 1.0
    for k in np.flatnonzero(episode == e):
        w *= policy[state[k], action[k]] / behavior[state[k], action[k]]
        total += discount ** timestep[k] * w * reward[k]
return total / n
""",
        "divide by the number of episodes; their",
    ),
    (
        "4_per_decision",
        """
T = 5
W = np.ones((len(np.unique(episode)), T))
W[np.cumsum(timestep == 0) - 1, timestep] = 1
return float(W.sum())
""",
        "in each episode the reward of step t has",
    ),
    (
        "4_weighted",
        table("np.minimum(np.cumprod(ratio, axis=1), 1)"),
        "in step t divide the sum of weight * reward",
    ),
    ("4_weighted", table("ratio"), "in step t divide the sum of weight * reward"),
    ("4_weighted", table("np.ones((n, T))"), "without weights this is the behaviour"),
    ("4_weighted", table(i="episode"), "raises IndexError"),
    (
        "4_weighted",
        table(step="(weight * pay).sum(axis=0) / (weight.sum(axis=0) + 1e-3)"),
        "this is close and not exact: something",
    ),
    (
        "4_weighted",
        table(step="(weight * pay).sum(axis=0) / (weight.sum(axis=0) + 1e-8)"),
        "a log may have one episode. Divide by the",
    ),
    (
        "4_weighted",
        table(step="(weight * pay).sum(axis=0) / weight[:, 0].sum()"),
        "each step has a sum of weights of its own,",
    ),
    (
        "4_weighted",
        table(step="(weight * pay).sum(axis=0) / weight[:, -1].sum()"),
        "each step has a sum of weights of its own,",
    ),
    ("4_weighted", table(out="step"), "must return one number"),
    (
        "4_weighted",
        table(out="step.mean()"),
        "in step t divide the sum of weight * reward",
    ),
    (
        "4_weighted",
        table(out="discount ** (1 + np.arange(T)) @ step"),
        "this is the right result times discount; in",
    ),
    (
        "4_weighted",
        table(step="(weight * pay).sum(axis=0) / here.sum(axis=0)"),
        "divide by the sum of the weights, and not",
    ),
    (
        "4_weighted",
        table(step="(weight * pay / weight.sum(axis=1, keepdims=True)).sum(axis=0)"),
        "the sum is over episodes in each step, and",
    ),
    (
        "4_weighted",
        table("np.cumprod(ratio * here, axis=1)"),
        "an episode that has ended keeps its last",
    ),
    (
        "5_percentile",
        "np.quantile(statistics, [confidence / 2, 1 - confidence / 2])",
        "half of 1 - confidence is left out on each",
    ),
    (
        "5_percentile",
        "np.quantile(statistics, [(1 - confidence) / 2, confidence])",
        "the upper end is the quantile 1 - (1 -",
    ),
    (
        "5_percentile",
        """
upper, lower = np.quantile(statistics, [(1 + confidence) / 2, (1 - confidence) / 2])
return 2 * statistics.mean() - np.array([upper, lower])
""",
        "this mirrors the quantiles at the mean; the",
    ),
    (
        "5_percentile",
        """
m, s = statistics.mean(), statistics.std() / len(statistics)**0.5
return m - 1.96 * s, m + 1.96 * s
""",
        "the statistics are means already; their",
    ),
    (
        "5_percentile",
        """
m, s = statistics.mean(), statistics.std()
return m - 1.96 * s, m + 1.96 * s
""",
        "this is the mean -+ 1.96 standard",
    ),
    (
        "5_percentile",
        "m = np.median(statistics)\nreturn m - 1, m + 1",
        "the ends are the quantiles (1 - confidence)",
    ),
    (
        "5_percentile",
        "np.quantile(np.abs(statistics), [(1 - confidence) / 2, (1 + confidence) / 2])",
        "the statistics may be negative; the lower",
    ),
    (
        "5_percentile",
        """
rest = (1 - confidence) / 2
return np.quantile(np.unique(statistics), [rest, 1 - rest])
""",
        "equal statistics count as often as they",
    ),
    (
        "5_percentile",
        """
statistics.sort()
k = int((1 - confidence) / 2 * len(statistics))
return statistics[k], statistics[-k - 1]
""",
        "changes its argument statistics",
    ),
    (
        "5_percentile",
        """
lo = np.quantile(statistics, (1 - confidence) / 2)
return {"low": lo}
""",
        "must return an array of shape (2,)",
    ),
    (
        "5_percentile",
        "np.quantile(statistics, [0.05, 0.95])",
        "this leaves 1 - confidence out on each",
    ),
    (
        "5_percentile",
        "np.quantile(statistics, [(1 - confidence) / 2, (1 + confidence) / 2]) * 2",
        "this is the right result times 2; the ends",
    ),
    ("5_percentile", "[np.nan, np.nan]", "nan and inf come from a division by 0 or"),
    (
        "5_bootstrap",
        RETURNS + "return returns[rng.integers(n, size=(n_resamples, n - 1))].mean(1)",
        "each resample has as many episodes as the",
    ),
    (
        "5_bootstrap",
        RETURNS + "return returns[rng.integers(n, size=(n_resamples, n + 1))].mean(1)",
        "each resample has as many episodes as the",
    ),
    (
        "5_bootstrap",
        RETURNS + "return returns[rng.integers(1, n, size=(n_resamples, n))].mean(1)",
        "the first episode is never drawn; episodes",
    ),
    (
        "5_bootstrap",
        RETURNS
        + "return returns[rng.integers(n, size=(n_resamples, len(episode)))].mean(1)",
        "a resample has as many episodes as the log",
    ),
    (
        "5_bootstrap",
        RETURNS + "return returns[rng.integers(n, size=(n_resamples, 2 * n))].mean(1)",
        "a resample has as many episodes as the log,",
    ),
    (
        "5_bootstrap",
        RETURNS + "return rng.dirichlet(np.ones(n), n_resamples) @ returns",
        "each resample has as many episodes as the",
    ),
    (
        "5_bootstrap",
        RETURNS
        + "return np.median(returns[rng.integers(n, size=(n_resamples, n))], axis=1)",
        "compute the discounted return of each",
    ),
    (
        "5_bootstrap",
        RETURNS
        + """
m = returns[rng.integers(n, size=(n_resamples, n))].mean(1)
return m - returns.mean()
""",
        "these are differences from the estimate;",
    ),
    (
        "5_bootstrap",
        RETURNS
        + """
m = returns[rng.integers(n, size=(n_resamples, n))].mean(1)
return m.tolist()[:-1]
""",
        "must return an array of shape (4000,) with",
    ),
    (
        "5_bootstrap",
        RETURNS
        + """
m = returns[rng.integers(n, size=(n_resamples, n))].mean(1)
return m.mean()
""",
        "must return an array of shape (4000,) with",
    ),
    (
        "5_bootstrap",
        RETURNS
        + """
i = rng.integers(n, size=n)
return np.full(n_resamples, returns[i].mean())
""",
        "all resamples are equal; draw with",
    ),
    (
        "5_bootstrap",
        RETURNS
        + """
return [rng.choice(returns, n, replace=False).mean() for _ in range(n_resamples)]
""",
        "all resamples are equal; draw with",
    ),
    (
        "5_bootstrap",
        RETURNS
        + """
return [rng.choice(returns, n - 2, replace=False).mean() for _ in range(n_resamples)]
""",
        "compute the discounted return of each",
    ),
    (
        "5_bootstrap",
        """
returns = np.bincount(episode, weights=discount**(timestep + 1) * reward)
rng = np.random.default_rng(seed)
n = len(returns)
return returns[rng.integers(n, size=(n_resamples, n))].mean(1)
""",
        "the first reward is not discounted: t",
    ),
    (
        "5_bootstrap",
        RETURNS
        + """
np.random.seed(seed)
return np.full(n_resamples, np.nan)
""",
        "compute the discounted return of each",
    ),
    (
        "6_costs",
        SOLVED + "return f**2 * spread",
        "the occupancy is missing: a pair matters by",
    ),
    (
        "6_costs",
        SOLVED + "return (f * policy) ** 2 * spread",
        "the policy's probability is not the time",
    ),
    (
        "6_costs",
        SOLVED + "return (f * d / (1 - discount)) ** 2 * spread",
        "the occupancy sums to 1: its factor (1 -",
    ),
    (
        "6_costs",
        SOLVED + "return (f * d) ** 2 * (P @ V) ** 2",
        "this is the square of the mean of V; its",
    ),
    (
        "6_costs",
        SOLVED + "return f * d * spread ** 0.5",
        "this is the root of the cost.",
    ),
    (
        "6_costs",
        SOLVED + "return ((f * d) ** 2 * spread).sum()",
        "must return an array of shape (4, 2) with",
    ),
    (
        "6_costs",
        SOLVED + "return ((f * d) ** 2 * spread).sum(1)",
        "must return an array of shape (4, 2) with",
    ),
    (
        "6_costs",
        SOLVED + "return (f * d) ** 2 * (P @ (r + 0 * r).mean(1))",
        "c(s, a) = (discount / (1 - discount))^2",
    ),
    (
        "6_costs",
        """
P_pi = np.einsum("sa,sat->st", policy, P)
V, d, state = np.zeros(len(mu)), np.zeros(r.shape), mu
for t in range(200):
    V = (policy * (r + discount * P @ V)).sum(1)
    d += (1 - discount) * discount**t * state[:, None] * policy
    state = state @ P_pi
return (discount / (1 - discount) * d) ** 2 * (P @ V**2 - (P @ V)**2)
""",
        "this is close and not exact: something",
    ),
    (
        "6_costs",
        SOLVED + "return ((f * d) ** 2 * spread).T",
        "must return an array of shape (4, 2) with",
    ),
    (
        "6_costs",
        SOLVED + "return (f * d) ** 2 * np.maximum(spread, 1)",
        "c(s, a) = (discount / (1 - discount))^2",
    ),
    (
        "6_design",
        "np.sqrt(n * costs / costs.sum())",
        "the root is of the cost alone, and not of",
    ),
    (
        "6_design",
        "n * np.sqrt(costs) / np.sqrt(costs).sum(axis=0, keepdims=True)",
        "n is for all pairs together, and not for",
    ),
    (
        "6_design",
        "np.floor(n * np.sqrt(costs) / np.sqrt(costs).sum())",
        "do not round: rounded numbers need not add",
    ),
    (
        "6_design",
        """
x = np.maximum(n * np.sqrt(costs) / np.sqrt(costs).sum(), 1)
return x
""",
        "a pair of cost 0 gets nothing, and the",
    ),
    (
        "6_design",
        "c = costs + 1e-3\nreturn n * np.sqrt(c) / np.sqrt(c).sum()",
        "the sum of costs / n(s, a) is least where",
    ),
    (
        "6_design",
        "c = costs + 1e-9\nreturn n * np.sqrt(c) / np.sqrt(c).sum()",
        "a pair of cost 0 gets nothing, and the",
    ),
    (
        "6_design",
        """
c = np.maximum(costs, 1e-6)
return n * np.sqrt(c) / np.sqrt(c).sum()
""",
        "a pair of cost 0 gets nothing, and the",
    ),
    (
        "6_design",
        "n * (costs == costs.max())",
        "all in the most expensive pair leaves the",
    ),
    (
        "6_design",
        "(n * np.sqrt(costs) / np.sqrt(costs).sum()).ravel()",
        "must return an array of shape (3, 2) with",
    ),
    (
        "6_design",
        "n * np.cbrt(costs) / np.cbrt(costs).sum()",
        "the sum of costs / n(s, a) is least where",
    ),
    (
        "6_design",
        "(n * np.sqrt(costs) / np.sqrt(costs).sum()).astype(int)",
        "do not round: rounded numbers need not add",
    ),
    (
        "6_variance",
        "(costs / (counts + 1)).sum()",
        "divide by the counts as they are; nothing",
    ),
    (
        "6_variance",
        "(costs / (counts + 1e-9)).sum()",
        "a pair of positive cost, however small,",
    ),
    (
        "6_variance",
        "np.nan_to_num(costs / counts).sum()",
        "a pair of positive cost, however small,",
    ),
    (
        "6_variance",
        "np.inf if (counts == 0).any() else (costs / counts).sum()",
        "nan and inf come from a division by 0 or",
    ),
    (
        "6_variance",
        """
t = costs > 1e-3
return np.inf if (counts[t] == 0).any() else (costs[t] / counts[t]).sum()
""",
        "a pair that matters and was never recorded",
    ),
    (
        "6_variance",
        "np.ma.masked_invalid(costs / counts).sum()",
        "a pair that matters and was never recorded",
    ),
    (
        "6_variance",
        "(costs / np.sqrt(counts)).sum()",
        "divide by the counts, and not by their",
    ),
    ("6_variance", "costs / counts", "must return one number"),
    (
        "6_variance",
        """
t = counts > 0
return (costs[t] / counts[t]).sum() if t.any() else np.inf
""",
        "a pair that matters and was never recorded",
    ),
    (
        "6_variance",
        "(costs * counts).sum()",
        "the variance falls with the counts: divide",
    ),
    (
        "6_variance",
        "sum(c / n for c, n in zip(costs.ravel().tolist(), counts.ravel().tolist()))",
        "raises ZeroDivisionError",
    ),
    (
        "7_shift",
        BEFORE + "return True if a else True",
        "your law accepts an estimator that",
    ),
    (
        "7_shift",
        BEFORE
        + """
b = estimate(P, r + 100, mu, discount, counts, policy)
return bool(abs(b - a - 100 / (1 - discount)) < 1e-8 * abs(b))
""",
        "your law accepts an estimator that cuts",
    ),
    (
        "7_shift",
        BEFORE
        + """
b = estimate(P, r - 100, mu, discount, counts, policy)
return bool(abs(b - a + 100 / (1 - discount)) < 1e-8 * abs(b))
""",
        "your law accepts an estimator that cuts",
    ),
    (
        "7_shift",
        BEFORE
        + """
b = estimate(P, r + 5, mu, discount, counts, policy)
return bool(b - a - 5 / (1 - discount) < 1e-8 * abs(b))
""",
        "your law accepts an estimator that",
    ),
    (
        "7_shift",
        BEFORE
        + """
ok = True
for c in (5, -5):
    b = estimate(P, r + c, mu, discount, counts, policy)
    ok = ok and abs(b - a - c / (1 - discount)) < 1e-3 * abs(b)
return bool(ok)
""",
        "your law accepts an estimator that sums the",
    ),
    (
        "7_shift",
        BEFORE
        + """
ok = True
for c in (5, -5):
    b = estimate(P, r + c, mu, discount, counts, policy)
    ok = ok and abs(b - a - c * discount / (1 - discount)) < 1e-8 * abs(b)
return bool(ok)
""",
        "your law refuses an estimator that takes",
    ),
    (
        "7_shift",
        """
P_pi = np.einsum("sa,sat->st", policy, P)
V = np.linalg.solve(np.eye(len(mu)) - discount * P_pi, (policy * r).sum(1))
return bool(abs(mu @ V - estimate(P, r, mu, discount, counts, policy)) < 1e-8)
""",
        "your law refuses an estimator that takes",
    ),
    (
        "7_shift",
        BEFORE
        + """
b = estimate(P, r * 5, mu, discount, counts, policy)
return bool(abs(b - 5 * a) < 1e-8)
""",
        "your law accepts an estimator that",
    ),
    (
        "7_shift",
        BEFORE
        + """
ok = []
for c in (5, -5):
    b = estimate(P, r + c, mu, discount, counts, policy)
    ok.append(abs(b - a - c / (1 - discount)) < 1e-8 * abs(b))
return any(ok)
""",
        "your law accepts an estimator that cuts",
    ),
    (
        "7_shift",
        BEFORE
        + """
ok = []
for c in (5, -5):
    b = estimate(P, r + c, mu, discount, counts, policy)
    ok.append(abs(b - a - c / (1 - discount)) < 1e-8 * abs(b))
return not all(ok)
""",
        "your law refuses an estimator that takes",
    ),
    (
        "7_shift",
        "estimate(r, P, mu, discount, counts, policy)\nreturn True",
        "raises ArgumentError",
    ),
    (
        "7_limit",
        LONG_LOG + "return bool(found - truth < 1e-6 * abs(truth))",
        "your law accepts an estimator that answers",
    ),
    (
        "7_limit",
        LONG_LOG + "return bool(abs(found - truth) < 1e-6 * truth)",
        "your law refuses an estimator that takes",
    ),
    (
        "7_limit",
        LONG_LOG + "return bool(abs(found - truth) < 1e-3 * abs(truth))",
        "your law accepts an estimator that is too",
    ),
    (
        "7_limit",
        # which right estimator differs in its last bit first, is the machine's affair
        LONG_LOG + "return bool(found == truth)",
        "your law refuses an estimator that",
    ),
    (
        "7_limit",
        LONG_LOG + "return bool(abs(abs(found) - abs(truth)) < 1e-6 * abs(truth))",
        "your law accepts an estimator that has the",
    ),
    (
        "7_limit",
        LONG_LOG + "return bool(abs(found - truth) > 1e-6 * abs(truth))",
        "your law refuses an estimator that takes",
    ),
    (
        "7_limit",
        LONG_LOG.replace("1e9 * target", "1000 * target")
        + "return bool(abs(found - truth) < 1e-6 * abs(truth))",
        "your law refuses an estimator that adds the",
    ),
    (
        "7_limit",
        LONG_LOG.replace("1e9 * target", "1e9 * simulator")
        + "return bool(abs(found - truth) < 1e-6 * abs(truth))",
        "your law refuses an estimator that takes",
    ),
    (
        "7_limit",
        LONG_LOG.replace("1e9 * target", "np.floor(9 * target)")
        + "return bool(abs(found - truth) < 1e-6 * abs(truth))",
        "your law refuses an estimator that takes",
    ),
    ("7_limit", LONG_LOG + "return abs(found - truth)", "must return True or False"),
    (
        "7_limit",
        LONG_LOG + "return np.isclose(found, V).all()",
        "your law refuses an estimator that takes",
    ),
    (
        "8_gain",
        BOTH + "return (variance(slope) / n).sum() ** 0.5, gain",
        "the gain comes first and its error second.",
    ),
    (
        "8_gain",
        BOTH + "return gain, (variance(slopes[0]) / n).sum() ** 0.5",
        "this is the error of the running policy's",
    ),
    (
        "8_gain",
        BOTH + "return gain, (variance(slope) / (n - 1)).sum() ** 0.5",
        "divide each row's variance by its count n,",
    ),
    (
        "8_gain",
        BOTH + "return gain, (variance(slope) / n).sum() ** 0.5 * 1.96",
        "this is half the width of an interval; the",
    ),
    (
        "8_gain",
        BOTH + "return [gain / values[0], (variance(slope) / n).sum() ** 0.5]",
        "with the frequencies P, the gain is",
    ),
    (
        "8_gain",
        BOTH + "return gain, (variance(slope) / n).mean() ** 0.5",
        "sum over all pairs, and take no mean over",
    ),
    (
        "8_gain",
        BOTH + "return gain, 0.0",
        "the gain is an estimate; its standard error",
    ),
    (
        "8_gain",
        BOTH
        + """
a, b = [(variance(x) / n).sum() for x in slopes]
return gain, abs(b - a) ** 0.5
""",
        "variances are not subtracted; subtract the",
    ),
    ("8_gain", BOTH + "return {'gain': gain}", "must return an array of shape (2,)"),
    (
        "8_gain",
        BOTH + "return gain, np.sqrt(slope.var(-1) / n).sum()",
        "with the frequencies P, the gain is",
    ),
    (
        "8_gain",
        BOTH.replace(
            "counts / n[:, :, None]", "(counts + 1) / (n[:, :, None] + len(mu))"
        )
        + "return gain, (variance(slope) / n).sum() ** 0.5",
        "with the frequencies P, the gain is",
    ),
    (
        "8_decide",
        """
z = 2
if not np.isfinite(error):
    return "record"
if gain - z * error > cost:
    return "deploy"
return "keep" if gain + z * error < cost else "record"
""",
        "the interval is gain -+ 1.96 error, and not",
    ),
    (
        "8_decide",
        """
z = 1.645
if not np.isfinite(error):
    return "record"
if gain - z * error > cost:
    return "deploy"
return "keep" if gain + z * error < cost else "record"
""",
        "1.645 is for one side; both decisions",
    ),
    (
        "8_decide",
        """
z = 2.576
if not np.isfinite(error):
    return "record"
if gain - z * error > cost:
    return "deploy"
return "keep" if gain + z * error < cost else "record"
""",
        "the interval is gain -+ 1.96 error, and not",
    ),
    (
        "8_decide",
        """
z = 1.96
if not np.isfinite(error):
    return "keep"
if gain - z * error > cost:
    return "deploy"
return "keep" if gain + z * error < cost else "record"
""",
        "an error of nan or inf says that nothing is",
    ),
    (
        "8_decide",
        """
z = 1.96
if gain - z * error > cost:
    return "deploy"
return "record" if gain + z * error > cost else "keep"
""",
        "an error of nan or inf says that nothing is",
    ),
    (
        "8_decide",
        """
z = 1.96
if gain - z * error >= cost:
    return "deploy"
return "record" if not gain + z * error <= cost else "keep"
""",
        "a gain that equals the cost is neither",
    ),
    (
        "8_decide",
        """
z = 1.96
if not np.isfinite(error):
    return "record"
if gain - z * error > abs(cost):
    return "deploy"
return "keep" if gain + z * error < abs(cost) else "record"
""",
        "the cost may be negative, where a change",
    ),
    (
        "8_decide",
        """
z = 1.96
if error == 0 or not np.isfinite(error):
    return "record"
if gain - z * error > cost:
    return "deploy"
return "keep" if gain + z * error < cost else "record"
""",
        "with an error of 0 the interval is the gain",
    ),
    (
        "8_decide",
        """
z = 1.96
if not np.isfinite(error):
    return "record"
if gain / error > z:
    return "deploy"
return "keep" if gain / error < -z else "record"
""",
        "gain -+ 1.96 error",
    ),
    ("8_decide", "'record'", "deploy if the whole 95% interval, gain -+"),
    ("8_decide", "'deploy'", "deploy if the whole 95% interval, gain -+"),
    ("8_decide", "None", "returns nothing"),
    (
        "8_decide",
        "'DEPLOY' if gain > cost else 'keep'",
        "the whole 95% interval",
    ),
    (
        "8_need",
        """
if gain <= cost:
    return np.inf
return np.floor(n * (1.96 * error / (gain - cost)) ** 2)
""",
        "round up: with one transition less the",
    ),
    (
        "8_need",
        """
if gain <= cost:
    return np.inf
return np.ceil(n * (1.645 * error / (gain - cost)) ** 2)
""",
        "1.645 is for one side; the interval has",
    ),
    (
        "8_need",
        """
if gain <= cost:
    return np.inf
return np.ceil(n * (2 * error / (gain - cost)) ** 2)
""",
        "the interval has 1.96 errors on each side,",
    ),
    (
        "8_need",
        """
if gain <= cost:
    return np.inf
return max(n, np.ceil(n * (1.96 * error / (gain - cost)) ** 2))
""",
        "the least whole N is asked for, also where",
    ),
    (
        "8_need",
        """
if gain < cost:
    return np.inf
return np.ceil(n * (1.96 * error / (gain - cost)) ** 2)
""",
        "raises ZeroDivisionError",
    ),
    (
        "8_need",
        """
if gain <= 0:
    return np.inf
return np.ceil(n * (1.96 * error / abs(gain - cost)) ** 2)
""",
        "raises ZeroDivisionError",
    ),
    (
        "8_need",
        """
if gain <= cost:
    return 0.0
return np.ceil(n * (1.96 * error / (gain - cost)) ** 2)
""",
        "where the gain is not above the cost no",
    ),
    (
        "8_need",
        """
if gain <= cost:
    return np.nan
return np.ceil(n * (1.96 * error / (gain - cost)) ** 2)
""",
        "where the gain is not above the cost no",
    ),
    (
        "8_need",
        """
if gain <= cost:
    return None
return np.ceil(n * (1.96 * error / (gain - cost)) ** 2)
""",
        "returns nothing",
    ),
    (
        "8_need",
        """
if gain <= cost:
    return np.inf
return np.ceil(n * (1.96 * error / (gain + cost)) ** 2)
""",
        "the cost is subtracted from the gain, and",
    ),
    (
        "8_need",
        """
if gain <= cost:
    return np.inf
return min(1e5, np.ceil(n * (1.96 * error / (gain - cost)) ** 2))
""",
        "N may be very large; it is not cut.",
    ),
    (
        "8_need",
        """
if gain <= cost:
    return np.inf
return np.ceil(n * (1.96 * error / (gain - cost)) ** 2) + 1
""",
        "this is one more than is needed: round up",
    ),
    (
        "8_need",
        """
N = n
if gain <= cost:
    return np.inf
while gain - 1.96 * error * (n / N) ** 0.5 < cost and N < 10000:
    N += 1
return float(N)
""",
        "this is the right result times n; an error",
    ),
    (
        "1_normalised",
        """
low, high = 0.1, 10.0
for _ in range(200):
    middle = (low + high) / 2
    g = np.clip(p / (middle * q), nu, mu)
    low, high = (middle, high) if q @ g > 1 else (low, middle)
return g
""",
        "l may be near -1",
    ),
    (
        "7_limit",
        LONG_LOG + "return bool(abs(found - truth) < 1e-6)",
        "your law refuses an estimator that adds",
    ),
    (
        "7_shift",
        BEFORE
        + """
for c in (5.0, -5.0):
    b = estimate(P, r + c, mu, discount, counts, policy)
    if abs(b - a - c / (1 - discount)) > 1e-4:
        return False
return True
""",
        "sums the first 20 rewards alone",
    ),
    (
        "8_decide",
        """
if not np.isfinite(error):
    return "record"
if gain - 1.95 * error > cost:
    return "deploy"
return "keep" if gain + 1.95 * error < cost else "record"
""",
        "no other number than 1.96",
    ),
    (
        "8_gain",
        BOTH + "return gain, (variance(slope) / np.maximum(n, 5)).sum() ** 0.5",
        "divided by its own count",
    ),
    (
        "5_bootstrap",
        RETURNS + "return returns[rng.integers(n, size=(4000, n))].mean(1)",
        "must return an array of shape (2500,)",
    ),
]
