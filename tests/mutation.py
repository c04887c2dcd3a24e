"""Mutation testing of one package in a copy of the repository. Run by hand; needs mutmut 3.8.

    python tests/mutation.py PACKAGE [SAMPLE [SEED]]

Mutants of ``oee_tabular/PACKAGE`` (all, or a random SAMPLE of them) against that package's tests and the table of bad calls;
prints the score with its 95% interval (Wilson) and what each survivor changed. The configuration is [tool.mutmut] in
pyproject.toml.
"""

import glob
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
LEFT_OUT = {  # half a minute each, and nothing that the others leave
    "exact": [
        "tests/exact/test_planning.py::test_peers_agree",
        "tests/exact/test_moments.py::test_against_monte_carlo_with_bounded_weights",
    ],
    "estimators": [
        "tests/estimators/test_estimators.py::test_the_linearised_error_of_self_normalised_estimates",
    ],
    # it reads the stack, to which mutmut adds frames
    "ratio": ["tests/ratio/test_samples.py::test_collinear_and_constant_features"],
}
WORDS = {0: "survived", 1: "killed", 3: "killed", 5: "no test", 33: "no test", 24: "timeout", -24: "timeout", 36: "timeout",
         152: "timeout", 255: "timeout"}  # fmt: skip
LIST = (
    "from mutmut.__main__ import *; set_start_method('fork', force=True); os.makedirs('mutants'); copy_src_dir(); "
    "copy_also_copy_files(); setup_source_paths(); create_mutants(2)"
)


def copy_of(folder, package):
    """The repository without its history, set up for one package's tests."""
    ignored = shutil.ignore_patterns("__pycache__", ".*", "mutants")
    for name in ("oee_tabular", "tests"):
        shutil.copytree(ROOT / name, folder / name, ignore=ignored)
    shutil.copy(ROOT / "README.md", folder)
    chosen = [
        f"tests/{package}",
        "tests/test_bad_calls.py",
        *(f"--deselect={test}" for test in LEFT_OUT.get(package, [])),
    ]
    text = (ROOT / "pyproject.toml").read_text()
    line = f"pytest_add_cli_args_test_selection = {json.dumps(chosen)}"
    (folder / "pyproject.toml").write_text(re.sub(r"^pytest_add_cli_args_test_selection = .*$", line, text, flags=re.M))


def results(folder, package):
    """The exit code of each mutant's tests; None where they were not run."""
    found = {}
    for path in glob.glob(str(folder / "mutants" / "oee_tabular" / package / "*.meta")):
        found |= json.loads(Path(path).read_text())["exit_code_by_key"]
    return found


def main(package, sample=0, seed=0):
    """Run, and print what became of the mutants."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    threads["NUMBA_THREADING_LAYER"] = "workqueue"  # which a fork does not break
    with tempfile.TemporaryDirectory() as name:
        folder, environment = Path(name), os.environ | threads | {"CI": "true"}
        environment.pop("PYTHONPATH", None)
        copy_of(folder, package)
        options = {"cwd": folder, "env": environment}
        subprocess.run([sys.executable, "-c", LIST], **options, check=True, stdout=subprocess.DEVNULL)
        names = sorted(results(folder, package))
        total = len(names)
        if sample:
            names = random.Random(seed).sample(names, min(sample, total))
        subprocess.run(["mutmut", "run", *names], **options, check=True)
        codes = results(folder, package)
        became = Counter(WORDS.get(codes[each], "crashed") for each in names)
        for each in names:
            if WORDS.get(codes[each]) in ("survived", "no test"):
                print(subprocess.run(["mutmut", "show", each], **options, capture_output=True, text=True).stdout)
    n, won = len(names), sum(became[word] for word in ("killed", "timeout", "crashed"))
    share, z = won / n, 1.96
    middle, half = share + z * z / (2 * n), z * (share * (1 - share) / n + z * z / (4 * n * n)) ** 0.5
    ends = [(middle + sign * half) / (1 + z * z / n) for sign in (-1, 1)]
    print(f"{package}: {n} of {total} mutants, {dict(became)}; score {share:.1%}", end="")
    print(f" (95% interval {ends[0]:.1%} to {ends[1]:.1%})" if n < total else "")


if __name__ == "__main__":
    main(sys.argv[1], *(int(word) for word in sys.argv[2:]))
