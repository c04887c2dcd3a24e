"""V of policies on graphs of many kinds, beside SuperLU: a table in Markdown.

    git worktree add ../before c81a0ed
    PYTHONPATH=. python tests/benchmarks/graphs.py [--kept-aside] [--before ../before]

Ours is ``policy_value`` as it is called, and its linear solve alone with the bound on
the error. SuperLU gets I - gamma P_pi ready; it is ``scipy.sparse.linalg.splu`` and its
``solve`` in the best of two orders, COLAMD and MMD_AT_PLUS_A, the latter in symmetric
mode. Programs take turns in one process; times are CPU milliseconds with one BLAS
thread, medians. A ratio above 1 is in favour of the package.

The constants of ``exact/solvers/elimination.py`` were chosen on the graphs of
``CHOSEN_ON``. Those of ``KEPT_ASIDE`` were made when the constants stood.
"""

import argparse
import datetime
import platform
from functools import partial
from pathlib import Path

import mdps
import numpy as np
import speed
from scipy import sparse
from scipy.sparse import linalg
from scipy.spatial import KDTree
from threadpoolctl import threadpool_limits

import oee_tabular as oee
from oee_tabular import exact
from oee_tabular.exact.system import System, policy_system
from oee_tabular.exact.values import solve

# ---- edges of graphs: (n, rng, options) -> rows, columns


def both_ways(rows, columns):
    return np.concatenate([rows, columns]), np.concatenate([columns, rows])


def with_far_links(edges, n, rng, far):
    """A share of the links leads anywhere."""
    rows, columns = edges
    away = rng.random(len(rows)) < far
    columns = np.array(columns)
    columns[away] = rng.integers(0, n, away.sum())
    return rows, columns


def comb(n, rng, reach=2, far=0.02):
    """``reach`` neighbours on each side of a path, and far links."""
    rows, columns = mdps.ring(n, rng, reach)
    is_around = np.abs(rows - columns) > n // 2
    columns = np.where(is_around, rows, columns)
    return with_far_links((rows, columns), n, rng, far)


def watts_strogatz(n, rng, degree=4, far=0.05):
    """Links of a ring, a share of which is rewired; both ways."""
    rows = np.repeat(np.arange(n), degree // 2)
    columns = (rows + np.tile(np.arange(1, degree // 2 + 1), n)) % n
    return both_ways(*with_far_links((rows, columns), n, rng, far))


def tree(n, rng, arity=2):
    """Every state has ``arity`` children."""
    child = np.arange(1, n)
    return both_ways(child, (child - 1) // arity)


def random_tree(n, rng):
    """Every state hangs on one drawn from those before it."""
    child = np.arange(1, n)
    return both_ways(child, (rng.random(n - 1) * child).astype(int))


def barabasi(n, rng, links=1):
    """Every state joins ``links`` states drawn by their number of links."""
    ends = list(range(links + 1))
    rows = list(range(links))
    columns = list(range(1, links + 1))
    for state in range(links + 1, n):
        for other in sorted({ends[rng.integers(len(ends))] for _ in range(links)}):
            rows.append(state)
            columns.append(other)
            ends += [state, other]
    return both_ways(np.array(rows), np.array(columns))


def geometric(n, rng, degree=6):
    """Points in a square that are near each other are linked; all may stay."""
    radius = np.sqrt(degree / (np.pi * n))
    pairs = KDTree(rng.random((n, 2))).query_pairs(radius, output_type="ndarray")
    rows, columns = both_ways(*pairs.T)
    return np.append(rows, np.arange(n)), np.append(columns, np.arange(n))


def hypercube(n, rng):
    bits = int(np.log2(n))
    rows = np.repeat(np.arange(2**bits), bits)
    return rows, rows ^ np.tile(1 << np.arange(bits), 2**bits)


def expander(n, rng, permutations=2):
    """Every state leads to its place in some permutations, and back."""
    parts = [both_ways(np.arange(n), rng.permutation(n)) for _ in range(permutations)]
    return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])


def random(n, rng, entries=3):
    rows = np.repeat(np.arange(n), entries)
    return rows, rng.integers(0, n, len(rows))


def lattice(n, rng, dimensions=2, far=0.0):
    """A square or a cube, with far links (teleports)."""
    side = round(n ** (1.0 / dimensions))
    number = np.arange(side**dimensions).reshape([side] * dimensions)
    ahead = [np.moveaxis(number, axis, 0) for axis in range(dimensions)]
    rows, columns = both_ways(
        np.concatenate([part[:-1].ravel() for part in ahead]),
        np.concatenate([part[1:].ravel() for part in ahead]),
    )
    return with_far_links((rows, columns), number.size, rng, far)


def ladder(n, rng, far=0.01):
    """Two paths with rungs, and far links."""
    at = np.arange(n // 2)
    edges = both_ways(
        np.concatenate([at[:-1], at[:-1] + n // 2, at]),
        np.concatenate([at[1:], at[1:] + n // 2, at + n // 2]),
    )
    return with_far_links(edges, n // 2 * 2, rng, far)


def caveman(n, rng, size=10, far=0.002):
    """Cliques in a row, one link between neighbours, and far links."""
    rows = np.repeat(np.arange(n), size)
    clique = np.minimum(rows // size * size + np.tile(np.arange(size), n), n - 1)
    rows, columns = with_far_links((rows, clique), n, rng, far)
    path = both_ways(np.arange(n - 1), np.arange(1, n))
    return np.append(rows, path[0]), np.append(columns, path[1])


def cactus(n, rng, size=8):
    """Rings that share a state with one before."""
    rows = [0]
    columns = [0]
    for begin in range(1, n - size + 2, size - 1):
        ring = [int(rng.integers(begin)), *range(begin, begin + size - 1)]
        rows += ring
        columns += ring[1:] + ring[:1]
    return both_ways(np.array(rows), np.array(columns))


def spider(n, rng, arms=20):
    """Paths from one state."""
    at = np.arange(1, n)
    return both_ways(at, np.where((at - 1) % (n // arms) == 0, 0, at - 1))


# name, edges, states, options
CHOSEN_ON = (
    ("comb, 2% far", comb, 15_000, {}),
    ("comb, .2% far", comb, 15_000, {"far": 0.002}),
    ("comb of reach 3, .5% far", comb, 30_000, {"reach": 3, "far": 0.005}),
    ("comb of reach 1, 1% far", comb, 10_000, {"reach": 1, "far": 0.01}),
    ("ring of reach 3, 1% far", mdps.ring, 500, {"far": 0.01}),
    ("ring of reach 3, 1% far", mdps.ring, 5_000, {"far": 0.01}),
    ("ring of reach 3, 1% far", mdps.ring, 20_000, {"far": 0.01}),
    ("ring of reach 5, 1% far", mdps.ring, 1_000, {"reach": 5, "far": 0.01}),
    ("small world of degree 4, 5%", watts_strogatz, 500, {}),
    ("small world of degree 4, 10%", watts_strogatz, 2_000, {"far": 0.1}),
    ("small world of degree 4, 1%", watts_strogatz, 20_000, {"far": 0.01}),
    ("small world of degree 6, 3%", watts_strogatz, 5_000, {"degree": 6, "far": 0.03}),
    ("small world of degree 4, 10%", watts_strogatz, 10_000, {"far": 0.1}),
    ("binary tree", tree, 200, {}),
    ("binary tree", tree, 500, {}),
    ("random tree", random_tree, 500, {}),
    ("random tree", random_tree, 20_000, {}),
    ("Barabasi and Albert, 1 link", barabasi, 500, {}),
    ("Barabasi and Albert, 2 links", barabasi, 1_000, {"links": 2}),
    ("band of reach 8", mdps.banded, 500, {}),
    ("band of reach 20", mdps.banded, 500, {"reach": 20}),
    ("band of reach 20", mdps.banded, 5_000, {"reach": 20}),
    ("geometric, degree 6", geometric, 500, {}),
    ("geometric, degree 6", geometric, 5_000, {}),
    ("geometric, degree 5", geometric, 10_000, {"degree": 5}),
    ("hypercube", hypercube, 1_024, {}),
    ("expander of degree 4", expander, 1_000, {}),
    ("random, 2 next states", random, 500, {"entries": 2}),
    ("ladder, 1% far", ladder, 5_000, {}),
    ("grid", lattice, 900, {}),
    ("grid", lattice, 10_000, {}),
    ("grid, 1% teleports", lattice, 2_500, {"far": 0.01}),
    ("cube", lattice, 8_000, {"dimensions": 3}),
    ("cliques of 10 in a row", caveman, 3_000, {}),
    ("cactus", cactus, 3_000, {}),
    ("spider", spider, 500, {}),
    ("layered", mdps.layers, 5_000, {}),
)
KEPT_ASIDE = (
    ("comb, 1% far", comb, 6_000, {"far": 0.01}),
    ("comb of reach 4, 1% far", comb, 9_000, {"reach": 4, "far": 0.01}),
    ("comb of reach 1, 3% far", comb, 25_000, {"reach": 1, "far": 0.03}),
    ("ring of reach 6, .5% far", mdps.ring, 4_000, {"reach": 6, "far": 0.005}),
    ("ring of reach 2, 2% far", mdps.ring, 700, {"reach": 2, "far": 0.02}),
    ("small world of degree 4, 3%", watts_strogatz, 800, {"far": 0.03}),
    ("small world of degree 8, 2%", watts_strogatz, 3_000, {"degree": 8, "far": 0.02}),
    (
        "small world of degree 6, .5%",
        watts_strogatz,
        12_000,
        {"degree": 6, "far": 0.005},
    ),
    ("small world of degree 4, 15%", watts_strogatz, 1_500, {"far": 0.15}),
    ("tree of arity 4", tree, 700, {"arity": 4}),
    ("random tree", random_tree, 300, {}),
    ("random tree", random_tree, 5_000, {}),
    ("Barabasi and Albert, 1 link", barabasi, 3_000, {}),
    ("Barabasi and Albert, 2 links", barabasi, 2_000, {"links": 2}),
    ("band of reach 10", mdps.banded, 700, {"reach": 10}),
    ("band of reach 15", mdps.banded, 2_000, {"reach": 15}),
    ("band of reach 40", mdps.banded, 3_000, {"reach": 40}),
    ("geometric, degree 7", geometric, 2_000, {"degree": 7}),
    ("geometric, degree 9", geometric, 6_000, {"degree": 9}),
    ("geometric, degree 6", geometric, 20_000, {}),
    ("hypercube", hypercube, 2_048, {}),
    ("expander of degree 4", expander, 2_000, {}),
    ("expander of degree 6", expander, 700, {"permutations": 3}),
    ("random, 3 next states", random, 1_200, {}),
    ("ladder, 2% far", ladder, 3_000, {"far": 0.02}),
    ("ladder, .5% far", ladder, 12_000, {"far": 0.005}),
    ("grid", lattice, 3_025, {}),
    ("grid", lattice, 22_500, {}),
    ("grid, .3% teleports", lattice, 4_900, {"far": 0.003}),
    ("cube", lattice, 3_375, {"dimensions": 3}),
    ("cliques of 8 in a row", caveman, 2_000, {"size": 8}),
    ("cactus of rings of 5", cactus, 1_000, {"size": 5}),
    ("spider", spider, 6_000, {"arms": 50}),
    ("layered, 6 wide", mdps.layers, 1_500, {"width": 6}),
)


def make(edges, n, options, discount):
    """The MDP of one action of a graph, with random probabilities and rewards."""
    rng = np.random.default_rng(n)
    rows, columns = edges(n, rng, **options)
    n_states = 1 + max(rows.max(), columns.max())
    weights = rng.random(len(rows)) + 0.1
    kernel = sparse.coo_array((weights, (rows, columns)), (n_states, n_states)).tocsr()
    kernel = sparse.csr_array(sparse.diags_array(1.0 / kernel.sum(axis=1)) @ kernel)
    initial = np.full(n_states, 1.0 / n_states)
    return oee.FiniteMDP(kernel, rng.normal(size=n_states), initial, discount)


def superlu(matrix, rewards, **options):
    return lambda: linalg.splu(matrix, **options).solve(rewards)


def compare(mdp):
    """Seconds of each program."""
    n = mdp.n_states
    policy = np.ones((n, 1))
    rewards = mdp.rewards[:, 0]
    system = policy_system(mdp, policy)
    matrix = sparse.csc_array(
        sparse.eye_array(n) - mdp.discount * sparse.csr_array(mdp.transitions)
    )
    ours = {"ours": partial(oee.policy_value, mdp, policy)}
    peers = {
        # a new system has nothing cached
        "solve": lambda: lambda: solve(System(system.kernel, n_roundings=1), rewards),
        "COLAMD": lambda: superlu(matrix, rewards, permc_spec="COLAMD"),
        "MMD": lambda: superlu(
            matrix,
            rewards,
            permc_spec="MMD_AT_PLUS_A",
            options={"SymmetricMode": True},
        ),
    }
    found = speed.compare("V", "", ours, peers)
    return {line["program"]: line["seconds"] for line in found}


def main():
    """The command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kept-aside", action="store_true")
    parser.add_argument("--discount", type=float, default=0.999)
    parser.add_argument("--before", type=Path, help="another checkout of the package")
    parser.add_argument("--answer", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    speed.Other.is_self = options.answer
    words = ["--discount", str(options.discount)]
    words += ["--kept-aside"] if options.kept_aside else []
    if options.before:
        speed.Other.begin(options.before, words, __file__)
    if not options.answer:
        print(f"{datetime.date.today()}, {platform.machine()}\n")
        print(
            "| graph | states | ours, ms | solver | SuperLU, ms | SuperLU / ours |"
            " SuperLU / the solve | before / ours |"
        )
        print("|" + "---|" * 8)
    with threadpool_limits(limits=1):
        for name, edges, n, chosen in KEPT_ASIDE if options.kept_aside else CHOSEN_ON:
            mdp = make(edges, n, chosen, options.discount)
            seconds = compare(mdp)
            if options.answer:
                continue
            method = exact.evaluate_policy(mdp, np.ones((mdp.n_states, 1))).method
            best = np.nanmin([seconds["COLAMD"], seconds["MMD"]])
            before = seconds.get(speed.BEFORE + "ours", np.nan)
            print(
                f"| {name} | {mdp.n_states} | {1e3 * seconds['ours']:.3g} | {method} |"
                f" {1e3 * best:.3g} | {best / seconds['ours']:.2g} |"
                f" {best / seconds['solve']:.2g} | {before / seconds['ours']:.2g} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
