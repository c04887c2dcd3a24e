"""V on graphs of every kind, ours against scipy's SuperLU, BiCGSTAB and LAPACK, each near discount 1 and in three sizes.

Every clock starts with the MDP of one action: I - gamma P and its factors are made inside, ours with all checks. ``error`` is
the largest |r + gamma P V - V| over the largest |V|. As a script it prints peer's time / ours, the best peer's alone:

    python tests/benchmarks/graphs.py [PART OF A CASE'S NAME ...]
"""

import sys

import numpy as np
from common import interleaved, per_call, rows_of
from scipy import sparse
from scipy.sparse import linalg as sparse_linalg

import oee_tabular as oee
from oee_tabular import exact

DISCOUNTS = (0.99, 0.999, 0.9999)


def from_edges(rows, columns, n, rng):
    """Random chances on these edges, rows normalised."""
    kernel = sparse.coo_array((rng.random(len(rows)) + 0.1, (rows, columns)), shape=(n, n)).tocsr()
    return sparse.csr_array(sparse.diags_array(1.0 / kernel.sum(axis=1)) @ kernel)


def ring(n, reach, rng):
    """``reach`` neighbours on each side."""
    steps = np.concatenate([np.arange(-reach, 0), np.arange(1, reach + 1)])
    rows = np.repeat(np.arange(n), len(steps))
    return from_edges(rows, (rows + np.tile(steps, n)) % n, n, rng)


def small_world(n, reach, rng, far=0.01):
    """A ring of which a share of the links leads anywhere."""
    steps = np.concatenate([np.arange(-reach, 0), np.arange(1, reach + 1)])
    rows = np.repeat(np.arange(n), len(steps))
    columns = (rows + np.tile(steps, n)) % n
    away = rng.random(len(rows)) < far
    columns[away] = rng.integers(0, n, away.sum())
    return from_edges(rows, columns, n, rng)


def chain(n, rng):
    """A step up or down, even chances; staying at the ends."""
    at = np.arange(n)
    rows, columns = np.concatenate([at, at]), np.concatenate([np.minimum(at + 1, n - 1), np.maximum(at - 1, 0)])
    return sparse.coo_array((np.full(2 * n, 0.5), (rows, columns)), shape=(n, n)).tocsr()


def queue(n, rng, batch=10):
    """One leaves, up to ``batch`` arrive."""
    chances = rng.dirichlet(np.ones(batch + 1))
    rows = np.repeat(np.arange(n), batch + 1)
    columns = np.clip(rows - 1 + np.tile(np.arange(batch + 1), n), 0, n - 1)
    kernel = sparse.coo_array((np.tile(chances, n), (rows, columns)), shape=(n, n)).tocsr()
    kernel.sum_duplicates()
    return kernel


def layered(n, rng, width=4, entries=4, shuffle=True):
    """Levels of a few states that lead to their own level or one of the next two; states in any order."""
    rows = np.repeat(np.arange(n), entries)
    ahead = (rows // width + rng.integers(0, 3, len(rows))) * width + rng.integers(0, width, len(rows))
    new = rng.permutation(n) if shuffle else np.arange(n)
    return from_edges(new[rows], new[np.minimum(ahead, n - 1)], n, rng)


def grid(side, rng, torus=False):
    """Four neighbours."""
    at = np.arange(side * side).reshape(side, side)
    ends = []
    for axis in (0, 1):
        for step in (1, -1):
            moved = np.roll(at, step, axis)
            if not torus:
                edge = [slice(None)] * 2
                edge[axis] = 0 if step == 1 else side - 1
                moved[tuple(edge)] = at[tuple(edge)]
            ends.append(moved.ravel())
    return from_edges(np.tile(at.ravel(), 4), np.concatenate(ends), side * side, rng)


def cube(side, rng):
    """Six neighbours, on a torus."""
    at = np.arange(side**3).reshape(side, side, side)
    ends = [np.roll(at, step, axis).ravel() for axis in range(3) for step in (1, -1)]
    return from_edges(np.tile(at.ravel(), 6), np.concatenate(ends), side**3, rng)


def random_graph(n, entries, rng):
    """Anywhere."""
    rows = np.repeat(np.arange(n), entries)
    return from_edges(rows, rng.integers(0, n, len(rows)), n, rng)


def tree(n, rng, branches=2):
    """Up and down a tree."""
    child = np.arange(1, n)
    parent = (child - 1) // branches
    return from_edges(np.concatenate([child, parent, [0]]), np.concatenate([parent, child, [0]]), n, rng)


def random_tree(n, rng):
    """Each state hangs on a random earlier one; states in any order."""
    child = np.arange(1, n)
    parent, new = rng.integers(0, child), rng.permutation(n)
    return from_edges(
        np.concatenate([new[child], new[parent], [0]]), np.concatenate([new[parent], new[child], [0]]), n, rng
    )


def power_law(n, rng, links=3):
    """Links to states as they have links already (Barabasi and Albert), both ways."""
    ends = list(range(links))
    rows, columns = [], []
    for state in range(links, n):
        for other in {ends[i] for i in rng.integers(0, len(ends), links)}:
            rows += [state, other]
            columns += [other, state]
            ends += [state, other]
    rows, columns = [*rows, *range(n)], [*columns, *range(n)]
    return from_edges(np.array(rows), np.array(columns), n, rng)


def blocks(n, rng, count=10, entries=5, far=0.001):
    """Random graphs that seldom meet."""
    size = n // count
    rows = np.repeat(np.arange(n), entries)
    columns = rows // size * size + rng.integers(0, size, len(rows))
    inside = from_edges(rows, np.minimum(columns, n - 1), n, rng)
    return sparse.csr_array((1 - far) * inside + far * random_graph(n, entries, rng))


def bipartite(n, entries, rng):
    """From each half to anywhere in the other."""
    rows = np.repeat(np.arange(n), entries)
    columns = rng.integers(0, n // 2, len(rows)) + np.where(rows < n // 2, n // 2, 0)
    return from_edges(rows, np.minimum(columns, n - 1), n, rng)


def banded(n, rng, reach=8, entries=5):
    """Some of the neighbours within reach; states in any order."""
    rows = np.repeat(np.arange(n), entries)
    columns = np.clip(rows + rng.integers(-reach, reach + 1, len(rows)), 0, n - 1)
    new = rng.permutation(n)
    return from_edges(new[rows], new[columns], n, rng)


def restart(kernel, chance, rng):
    """With a small chance back to state 0."""
    n = kernel.shape[0]
    back = sparse.csr_array((np.full(n, chance), (np.arange(n), np.zeros(n, dtype=int))), shape=(n, n))
    return sparse.csr_array((1.0 - chance) * kernel + back)


def graphs():
    """(name, maker) of every kernel."""
    sizes = (500, 5_000, 20_000)
    for n in sizes:
        for reach in (2, 3, 10):
            yield f"ring {n}, {reach} a side", lambda rng, n=n, reach=reach: ring(n, reach, rng)
        yield f"chain {n}", lambda rng, n=n: chain(n, rng)
        yield f"queue {n}", lambda rng, n=n: queue(n, rng)
        yield f"layered {n}", lambda rng, n=n: layered(n, rng)
        yield f"small world {n}", lambda rng, n=n: small_world(n, 3, rng)
        yield f"random {n}, 2", lambda rng, n=n: random_graph(n, 2, rng)
        yield f"random {n}, 5", lambda rng, n=n: random_graph(n, 5, rng)
    for side in (40, 100, 200):
        yield f"grid {side}", lambda rng, side=side: grid(side, rng)
    for n in sizes[:2]:
        yield f"tree {n}", lambda rng, n=n: tree(n, rng)
        yield f"random tree {n}", lambda rng, n=n: random_tree(n, rng)
        yield f"power law {n}", lambda rng, n=n: power_law(n, rng)
        yield f"blocks {n}", lambda rng, n=n: blocks(n, rng)
        yield f"bipartite {n}", lambda rng, n=n: bipartite(n, 3, rng)
        yield f"banded {n}", lambda rng, n=n: banded(n, rng)
        yield f"narrow grid {n}", lambda rng, n=n: sparse.csr_array(sparse.kron(chain(n // 5, rng), chain(5, rng)))
        yield f"ring with restart {n}", lambda rng, n=n: restart(ring(n, 3, rng), 0.01, rng)
    yield "torus 70", lambda rng: grid(70, rng, torus=True)
    yield "cube 15", lambda rng: cube(15, rng)


def peers(mdp):
    """Name -> call."""
    n, kernel, rewards = mdp.n_states, mdp.transitions, mdp.rewards[:, 0]

    def matrix():
        return sparse.eye_array(n, format="csr") - mdp.discount * kernel

    def superlu(**options):
        return sparse_linalg.splu(sparse.csc_array(matrix()), **options).solve(rewards)

    def bicgstab():
        x, info = sparse_linalg.bicgstab(matrix(), rewards, rtol=1e-12, atol=0.0, maxiter=3000)
        if info:
            raise RuntimeError(f"info {info}: not converged")
        return x

    calls = {"bicgstab": bicgstab}
    if n <= 1000:
        calls["lapack"] = lambda: np.linalg.solve(matrix().toarray(), rewards)
    calls["colamd"] = superlu
    calls["mmd"] = lambda: superlu(permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    return calls


EXPANDERS = ("random", "power law", "blocks", "bipartite")


def cases(part=()):
    """(case, mdp, whether direct solvers finish) of every graph and discount."""
    for name, make in graphs():
        if part and not any(p in name for p in part):
            continue
        rng = np.random.default_rng(0)
        kernel, n = make(rng), 0
        n = kernel.shape[0]
        direct = n <= 1000 or name.startswith("random tree") or not name.startswith((*EXPANDERS, "small world"))
        for discount in DISCOUNTS:
            mdp = oee.FiniteMDP(kernel, rng.normal(size=n), np.full(n, 1 / n), discount)
            yield f"{name}, {discount}", mdp, direct


def against(case, mdp, direct, seconds=0.2):
    """Rows of one evaluation."""
    policy = np.ones((mdp.n_states, 1))
    calls = {"ours": lambda: exact.evaluate_policy(mdp, policy).values}
    calls |= {k: v for k, v in peers(mdp).items() if direct or k == "bicgstab"}
    repeat = 1 + 2_000 // mdp.n_states
    timed = interleaved({n: per_call(c, repeat) for n, c in calls.items()}, seconds=seconds)

    def miss(x):
        return np.abs(mdp.rewards[:, 0] + mdp.discount * (mdp.transitions @ x) - x).max() / np.abs(x).max()

    yield from rows_of("V", case, timed, miss, repeat)


def rows(*, quick):
    """The table's rows."""
    for case, mdp, direct in cases(("500,",) if quick else ()):
        yield from against(case, mdp, direct)


if __name__ == "__main__":
    for case, mdp, direct in cases(sys.argv[1:]):
        timed = {r["program"]: r["seconds"] for r in against(case, mdp, direct)}
        own, best = timed.pop("ours"), min(timed, key=lambda k: timed[k] if timed[k] == timed[k] else np.inf)
        method = exact.evaluate_policy(mdp, np.ones((mdp.n_states, 1))).method
        print(
            f"{timed[best] / own:6.2f}  {case:32} {own * 1e3:8.2f} ms  {method:16} {best} {timed[best] * 1e3:.2f}",
            flush=True,
        )
