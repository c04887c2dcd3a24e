"""Problems on which the default's prior and its soft threshold are confirmed; neither was made for them.

    python tests/benchmarks/prior_problems.py [--seeds N] [--problems SEED]    N logs (10) of a problem and size

Printed for the families of ``lab.bench.families_shifts`` that were seen and for those kept aside, for 3, 10 and 30 transitions
per stochastic state-action pair, with eff = sqrt(efficiency_bound / n) and b = |simulator's error| / eff:

over ML       RMSE of the value over that of maximum likelihood: geometric mean, worst, share of problems above 1.1
over ref      RMSE over max(min(RMSE of ML, |simulator's error|), eff / 2): the same, and the share whose 5% bootstrap bound
              over logs is above 1.1, apart for b of at least 1 and below
centre fits   median of RMSE(model value) over the root mean square of its standard error if the centre fits
"""

import argparse

import numpy as np

import oee_tabular as oee
from oee_tabular.lab.bench.families_shifts import FAMILIES

SIZES = (3, 10, 30)


def rms(x, axis=None):
    """Root mean square."""
    return np.sqrt(np.mean(np.square(x), axis=axis))


def measure_cell(name, family, size, n_seeds):
    """The ratios of one problem and size, from ``n_seeds`` logs."""
    n = family.size(size)
    bound = oee.efficiency_bound(family.target, family.policy, family.data_distribution, horizon=family.horizon)
    bias = abs(oee.policy_value(family.simulator, family.policy, horizon=family.horizon) - family.truth)
    eff, rows = np.sqrt(bound / n), []
    for seed in range(n_seeds):
        estimate = oee.estimators.OffEnvironment()(family.problem(n, [seed, size]), family.policy)
        values = (estimate.diagnostics[key] for key in ("model_value", "maximum_likelihood_value"))
        within = estimate.diagnostics["standard_error_if_centre_fits"]
        rows.append([estimate.value - family.truth, *(value - family.truth for value in values), within])
    logs = np.array(rows)

    def over_ref(logs):
        errors = rms(logs, axis=-2)
        return errors[..., 0] / np.maximum(np.minimum(errors[..., 2], bias), eff / 2)

    drawn = over_ref(logs[np.random.default_rng(0).integers(0, n_seeds, (2000, n_seeds))])
    value, model, likelihood, within = rms(logs, axis=0)
    return {
        "problem": name, "size": size, "b": bias / eff, "over_ml": value / likelihood, "over_ref": float(over_ref(logs)),
        "bound": float(np.quantile(drawn, 0.05)), "centre": model / within,
    }  # fmt: skip


def summarize(ratios):
    """Geometric mean, worst, and share above 1.1."""
    x = np.array(ratios)
    return f"{np.exp(np.log(x).mean()):.2f}, {x.max():.2f}, {(x > 1.1).mean():.2f}"


def describe_half(title, cells):
    """Lines for each size and the five worst problems."""
    yield f"{title}: over ML; over ref (geometric mean, worst, above 1.1); surely at b >= 1, below; centre fits"
    for size in SIZES:
        here = [cell for cell in cells if cell["size"] == size]
        surely = [[cell["bound"] > 1.1 for cell in here if (cell["b"] >= 1) == large] for large in (True, False)]
        shares = ", ".join(f"{sum(found)} of {len(found)}" for found in surely)
        ml, ref = (summarize([cell[key] for cell in here]) for key in ("over_ml", "over_ref"))
        yield f"{size:3d}: {ml}; {ref}; {shares}; {np.median([cell['centre'] for cell in here]):.2f}"
    for cell in sorted(cells, key=lambda cell: -cell["over_ref"])[:5]:
        yield (
            f"     {cell['problem']} at {cell['size']}: over ref {cell['over_ref']:.2f} (5% bound {cell['bound']:.2f}), "
            f"over ML {cell['over_ml']:.2f}, b {cell['b']:.2f}"
        )


def main():
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--problems", type=int, default=0, help="the seed of the problems' parameters")
    options = parser.parse_args()
    for title, names in (("seen", list(FAMILIES)[::2]), ("kept aside", list(FAMILIES)[1::2])):
        families = {name: FAMILIES[name](np.random.default_rng(options.problems)) for name in names}
        cells = [measure_cell(*item, size, options.seeds) for item in families.items() for size in SIZES]
        print("\n".join(describe_half(title, cells)), flush=True)


if __name__ == "__main__":
    main()
