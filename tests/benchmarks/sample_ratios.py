"""Benchmark of the density ratio from samples against densratio and adapt: run by hand, printed as a markdown table.

    python tests/benchmarks/sample_ratios.py [--seeds N] [--environment FOLDER]

The peers are installed into a virtual environment of their own: a temporary one, or FOLDER, where what is there already is
used. All programs get the same samples, as .npz files, and give the ratio at the same points; the truth stays here.

Gaussians   N(.5, .8) against N(0, 1), 1000 points of each; error: mean of |g - true ratio| over the sample of q
categories  50 categories, p and q uniform on the simplex (redrawn until x_q shows every category), 2000 draws of each as
            one-hot points (adapt: category numbers, which serve it better); error: sum q |g - p/q|

Times are CPU seconds of fit and evaluation on one thread, after a warm-up; a call is repeated until 0.05 s have gone, and its
time is the median. "documented": the lists of parameters in the example of the peer's documentation, from which it selects;
"defaults": no parameter given (adapt then selects nothing).

Compared with each method of the peers are the call that our documentation names for the problem (RECOMMENDED: the quadratic
features have the ratio of any two Gaussians; categories are counted) and the call that names nothing.
"""

import argparse
import contextlib
import io
import json
import math
import os
import subprocess
import sys
import tempfile
import time
import venv
import warnings
from pathlib import Path

import numpy as np

CATEGORIES = 50
PEERS = ("densratio", "adapt")
RECOMMENDED = {"Gaussians": "log-linear, quadratic", "categories": "p/q of the counts"}


def gaussians(seed, n=1000):
    """The two samples, the points at which g is asked for, the truth there, and the points' weights in the error."""
    rng = np.random.default_rng(seed)
    p, q = rng.normal(0.5, 0.8, n), rng.normal(0.0, 1.0, n)
    true = np.exp(0.5 * q**2 - 0.5 * ((q - 0.5) / 0.8) ** 2) / 0.8
    return p[:, None], q[:, None], q[:, None], true, np.full(n, 1.0 / n)


def categories(seed, n=2000):
    """The same for one-hot points; p/q of the counts is finite."""
    rng = np.random.default_rng(seed)
    points = np.eye(CATEGORIES)
    while True:
        p, q = rng.dirichlet(np.ones(CATEGORIES), 2)
        x_p, x_q = (points[rng.choice(CATEGORIES, n, p=w)] for w in (p, q))
        if x_q.any(axis=0).all():
            return x_p, x_q, points, p / q, q


PROBLEMS = {"Gaussians": gaussians, "categories": categories}


def oee_tabular():
    """(problem, name) -> function of (x_p, x_q, x)."""
    import oee_tabular as oee

    def fit(**options):
        return lambda p, q, x: oee.density_ratio_samples(p, q, **options).at(x)

    return {
        ("Gaussians", "log-linear, quadratic"): fit(features="quadratic"),
        ("Gaussians", "default"): fit(),
        ("Gaussians", "kernel"): fit(kernel="gaussian"),
        ("categories", "p/q of the counts"): lambda p, q, x: oee.density_ratio(p.sum(axis=0), q.sum(axis=0)).ratio,
        ("categories", "kernel, same category or not"): fit(kernel=lambda x, c: x @ c.T),
        ("categories", "default"): fit(),
    }


def densratio():
    """As its README calls it."""
    from densratio import densratio as fit

    def method(name):
        return lambda p, q, x: fit(p, q, method=name, verbose=False).compute_density_ratio(x)

    return {(problem, f"{name}, defaults"): method(name) for problem in PROBLEMS for name in ("uLSIF", "KLIEP")}


def adapt():
    """The classes' defaults, and the examples of their documentation."""
    from adapt.instance_based import KLIEP, ULSIF

    def method(kind, **options):
        def call(p, q, x):
            if x.shape[1] > 1:
                p, q, x = (points.argmax(axis=1)[:, None].astype(float) for points in (p, q, x))
            model = kind(Xt=p, verbose=0, random_state=0, **options)
            model.fit_weights(q, p)
            return model.predict_weights(x)

        return call

    methods = {
        "ULSIF, defaults": method(ULSIF),
        "ULSIF, documented": method(ULSIF, kernel="rbf", lambdas=[0.1, 1.0, 10.0], gamma=[0.1, 1.0, 10.0]),
        "KLIEP, defaults": method(KLIEP),
        "KLIEP, documented": method(KLIEP, kernel="rbf", gamma=[0.1, 1.0]),
    }
    return {(problem, name): call for problem in PROBLEMS for name, call in methods.items()}


def attempt(call, p, q, x, seconds=0.05):
    """g at x and the median CPU seconds of the calls that fit in ``seconds`` (one at least), or what went wrong."""
    times = []
    while sum(times) < seconds:
        np.random.seed(0)  # noqa: NPY002, the peers draw from it
        start = time.process_time()
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                g = np.asarray(call(p, q, x), dtype=float).ravel()
        except Exception as error:
            return {"error": f"{type(error).__name__}: {error}"}
        times.append(time.process_time() - start)
    return {"time": float(np.median(times)), "g": g.tolist()}


def work(program, folder):
    """Run by the environment's Python: the program's methods on all samples of the folder; writes program.json there."""
    warnings.simplefilter("ignore")
    methods = {"oee_tabular": oee_tabular, "densratio": densratio, "adapt": adapt}[program]()
    results = []
    for (problem, name), call in methods.items():
        for number, file in enumerate(sorted(folder.glob(f"{problem}-*.npz"))):
            with np.load(file) as samples:
                p, q, x = (samples[key] for key in ("x_p", "x_q", "x"))
            if number == 0:
                attempt(call, p, q, x)  # warm
            results.append({"problem": problem, "name": name, "file": file.stem, **attempt(call, p, q, x)})
    (folder / f"{program}.json").write_text(json.dumps(results))


def environment(folder):
    """The Python of an environment with the peers, and for each peer that it lacks the reason."""
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    if not python.exists():
        print(f"installing {' and '.join(PEERS)} ...", file=sys.stderr)
        venv.create(folder, with_pip=True)
    missing = {}
    for peer in PEERS:
        if subprocess.run([python, "-c", f"import {peer}"], capture_output=True).returncode == 0:
            continue
        done = subprocess.run([python, "-m", "pip", "install", "-q", peer], capture_output=True, text=True)
        if done.returncode:
            missing[peer] = "cannot be installed"
    return python, missing


def run(program, python, folder):
    """The results of one program, from a process with one thread; a text where it failed as a whole."""
    threads = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
    done = subprocess.run(
        [python, __file__, "--work", program, "--folder", folder],
        env={**os.environ, **threads, "TF_CPP_MIN_LOG_LEVEL": "3"},
        capture_output=True,
        text=True,
    )
    if done.returncode:
        return f"failed: {(done.stderr.strip().splitlines() or ['no message'])[-1]}"
    return json.loads((folder / f"{program}.json").read_text())


def summarise(results, truths):
    """(problem, name) -> the errors of the seeds (nan: failed), the median time, and the first failure's text."""
    rows = {}
    for result in results:
        true, weights = truths[result["file"]]
        row = rows.setdefault((result["problem"], result["name"]), {"errors": [], "times": [], "text": ""})
        failed = "error" in result
        row["errors"].append(math.nan if failed else float(weights @ np.abs(np.array(result["g"]) - true)))
        row["times"].append(math.nan if failed else result["time"])
        row["text"] = row["text"] or result.get("error", "")
    return rows


def table(rows, failures):
    """One markdown table, and after it what our recommended call and our default do not reach."""
    print(
        "| problem | program | method | mean error | standard error | median time (s) | mean time (s) | times recommended |"
        " times default |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for (program, problem, name), row in rows.items():
        errors, times = np.array(row["errors"]), np.array(row["times"])
        if np.isnan(errors).any():
            print(f"| {problem} | {program} | {name} | failed: {row['text'][:100]} | | | | | |")
            continue
        spread = errors.std(ddof=1) / math.sqrt(len(errors)) if len(errors) > 1 else math.nan
        ours = (rows["oee_tabular", problem, of] for of in (RECOMMENDED[problem], "default"))
        faster = " | ".join(f"{np.median(times) / np.median(own['times']):.3g}" for own in ours)
        print(
            f"| {problem} | {program} | {name} | {errors.mean():.3f} | {spread:.3f} | {np.median(times):.2g} | "
            f"{times.mean():.2g} | {faster} |"
        )
    for program, text in failures.items():
        print(f"| all | {program} | {text} | | | | | | |")
    if all(program == "oee_tabular" for program, _, _ in rows):
        print("\nNo peer ran: nothing is compared.")
        return
    for title, names in (("recommended call", RECOMMENDED), ("default call", dict.fromkeys(PROBLEMS, "default"))):
        found = [line for problem, name in names.items() for line in shortfalls(rows, problem, name)]
        print(f"\nOur {title} ({', '.join(f'{problem}: {name!r}' for problem, name in names.items())}):")
        print("error no worse, and at least 20 times as fast, than every method of the peers that ran", end="")
        print(", but for:\n" + "\n".join(f"- {line}" for line in found) if found else ".")


def shortfalls(rows, problem, name):
    """The peers' methods that err less than ours or take less than 20 times as long (medians), in words."""
    own = rows["oee_tabular", problem, name]
    for (program, of, method), row in rows.items():
        if of != problem or program == "oee_tabular" or np.isnan(row["errors"]).any():
            continue
        excess = np.array(own["errors"]) - np.array(row["errors"])
        if excess.mean() > 0:
            yield (
                f"{problem}: the error is {excess.mean():.3f} above {program}'s {method!r} "
                f"(standard error of the difference {excess.std() / math.sqrt(max(len(excess) - 1, 1)):.3f})"
            )
        if (faster := float(np.median(row["times"]) / np.median(own["times"]))) < 20:
            yield f"{problem}: only {faster:.2g} times as fast as {program}'s {method!r}"


def main(seeds, folder):
    with tempfile.TemporaryDirectory() as temporary:
        shared = Path(temporary)
        truths = {}
        for problem, draw in PROBLEMS.items():
            for seed in range(seeds):
                p, q, x, true, weights = draw(seed)
                np.savez(shared / f"{problem}-{seed:03d}.npz", x_p=p, x_q=q, x=x)
                truths[f"{problem}-{seed:03d}"] = true, weights
        python, failures = environment(shared / "environment" if folder is None else folder)
        rows = {}
        for program in ("oee_tabular", *PEERS):
            if program in failures:
                continue
            results = run(program, sys.executable if program == "oee_tabular" else python, shared)
            if isinstance(results, str):
                failures[program] = results
            else:
                rows |= {(program, *key): row for key, row in summarise(results, truths).items()}
        if "oee_tabular" in failures:
            raise RuntimeError(failures["oee_tabular"])
        table({key: rows[key] for problem in PROBLEMS for key in rows if key[1] == problem}, failures)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--environment", type=Path)
    parser.add_argument("--work", help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.work:
        work(given.work, given.folder)
    else:
        main(given.seeds, given.environment)
