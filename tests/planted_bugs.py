"""Plant bugs one by one in a copy of the package and print which tests find them. Run by hand.

    python tests/planted_bugs.py [NUMBER ...]

The bug seeds of the project's theory notes, 1 to 16. Each must be found by at least one test; exit code 1 if one is not.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
MOMENTS, BOUNDS = "tests/exact/test_moments.py", "tests/exact/test_efficiency.py"
VALUES, RATIOS = "tests/exact/test_values.py", "tests/ratio/test_transition.py"
INTERVALS = "tests/inference/test_intervals.py"
# number: (what, file, text, what takes its place, the tests that are run)
BUGS = {
    1: (
        "second moment with w for w^2",
        "exact/_moments.py",
        "spread += prob[x] * w[x] * w[x] * next_var[j]",
        "spread += prob[x] * w[x] * next_var[j]",
        MOMENTS,
    ),
    2: (
        "trajectory product with one factor too many",
        "exact/_moments.py",
        "plain = left == 0 and not by_move",
        "plain = False",
        MOMENTS,
    ),
    3: (
        "occupancy left unnormalised",
        "exact/occupancy.py",
        "start = (1.0 - mdp.discount) * mdp.initial",
        "start = mdp.initial",
        VALUES,
    ),
    4: (
        "asymptotic variance with d for d^2",
        "exact/efficiency.py",
        "    return _weighted_sum(row_variances(target.transitions, target.transitions.data, gradient), share)\n",
        "    d = occupancy(target, policy, horizon=horizon).reshape(-1)\n    spread = row_variances(target.transitions, "
        "target.transitions.data, gradient)\n    return _weighted_sum(spread / np.maximum(d, 1e-300), share)\n",
        BOUNDS,
    ),
    5: (
        "asymptotic variance without gamma",
        "exact/occupancy.py",
        "found = (model.discount * known)[",
        "found = (1.0 * known)[",
        BOUNDS,
    ),
    6: (
        "doubly robust second moment without its cross term",
        "exact/_moments.py",
        "                    y = 0.0 if end else gamma * (next_mean[j] - k[tk, j])\n"
        "                    if by_move:\n"
        "                        y += (pay[x] - shift[t]) * scale[t]\n"
        "                    off",
        "                    y = 0.0 if end else gamma * next_mean[j]\n"
        "                    if by_move:\n"
        "                        y += (pay[x] - shift[t]) * scale[t]\n"
        "                    off",
        MOMENTS,
    ),
    7: (
        "ratio inverted",
        "ratio/transition.py",
        "data / simulator.transitions.data, ",
        "simulator.transitions.data / data.clip(1e-9), ",
        RATIOS,
    ),
    8: (
        "ratio 1 outside the support",
        "ratio/transition.py",
        '    refuse_unsupported(target.transitions, simulator, what="target")\n',
        "",
        RATIOS,
    ),
    9: (
        "forward measure discounted twice",
        "exact/_finite.py",
        "back = Kernel(*transposed(indptr, indices, data, size), 1.0)",
        "back = Kernel(*transposed(indptr, indices, data, size), gamma)",
        VALUES,
    ),
    10: (
        "finite-horizon value that forgets gamma",
        "exact/_finite.py",
        "out[s] = rewards[s] + gamma * total",
        "out[s] = rewards[s] + total",
        VALUES,
    ),
    11: (
        "KL direction swapped in the ball",
        "inference/_robust.py",
        "            u = (p[i] - phat[i]) / phat[i]\n            if abs(u) < 1e-4:\n                total += phat[i] *",
        "            u = (phat[i] - p[i]) / p[i]\n            if abs(u) < 1e-4:\n                total += p[i] *",
        INTERVALS,
    ),
    12: (
        "no union bound",
        "inference/ambiguity.py",
        "level = (1.0 - confidence) / max(counted, 1)",
        "level = 1.0 - confidence",
        INTERVALS,
    ),
    13: (
        "unvisited rows trusted silently",
        "inference/ambiguity.py",
        "    c = -order * special.lambertw(-np.exp(np.log(level) / order - 1.0), k=-1).real\n"
        "    return np.where(n > 0, c / np.maximum(n, 1.0), np.inf)",
        "    c = -order * special.lambertw(-np.exp(np.log(level) / order - 1.0), k=-1).real\n"
        "    return np.where(n > 0, c / np.maximum(n, 1.0), 1e-12)",
        INTERVALS,
    ),
    14: (
        "total variation for L1",
        "inference/ambiguity.py",
        "bound = np.sqrt(2.0 * (np.log",
        "bound = 0.5 * np.sqrt(2.0 * (np.log",
        INTERVALS,
    ),
    15: (
        "box around the empirical rows",
        "inference/ambiguity.py",
        "        low * probability,\n",
        "        low * phat,\n",
        INTERVALS,
    ),
    16: (
        "robust policy evaluation stopped after one sweep",
        "inference/ambiguity.py",
        "most: int = 100",
        "most: int = 1",
        INTERVALS,
    ),
}


def killers(number):
    """The names of the tests that fail with the bug planted (at most ten)."""
    what, name, text, instead, where = BUGS[number]
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for part in ("oee_tabular", "tests", "pyproject.toml", "README.md"):
            source = ROOT / part
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(source, copy / part, ignore=ignored) if source.is_dir() else shutil.copy(
                source, copy / part
            )
        path = copy / "oee_tabular" / name
        code = path.read_text()
        if code.count(text) != 1:
            raise SystemExit(f"bug {number} ({what}): its text is {code.count(text)} times in {name}, not once")
        path.write_text(code.replace(text, instead))
        command = [sys.executable, "-m", "pytest", "-q", "-n", "2", "--maxfail=10", "-p", "no:cacheprovider", where]
        environment = os.environ | {"PYTHONPATH": str(copy), "CI": "true"}
        done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=False)
    found = re.findall(r"^(?:FAILED|ERROR) (\S+)", done.stdout, flags=re.M)
    if not found and done.returncode not in (0, 1):
        raise SystemExit(f"bug {number} ({what}): pytest ended with {done.returncode}\n{done.stdout[-2000:]}")
    return sorted(set(found))


def main(numbers):
    """Plant each; 1 if one lives."""
    alive = 0
    for number in numbers or BUGS:
        found = killers(number)
        alive += not found
        print(f"{number:2d} {BUGS[number][0]}: {'ALIVE' if not found else f'killed by {len(found)}'}", flush=True)
        for name in found[:4]:
            print(f"     {name}")
    return 1 if alive else 0


if __name__ == "__main__":
    sys.exit(main([int(word) for word in sys.argv[1:]]))
