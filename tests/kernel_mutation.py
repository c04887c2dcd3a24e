"""Mutation testing of compiled kernels, which mutmut cannot wrap. Run by hand:

    python tests/kernel_mutation.py MODULE[,MODULE ...] [SAMPLE [SEED]]        such as exact/_finite,exact/solvers/_bicgstab

One operator, number or truth value of ``oee_tabular/MODULE.py`` is changed at a time, in a copy of the repository, and the
tests of the package that it stands in are run, compiled as ever. Prints what each survivor changed, and the score with its 95%
interval (Wilson). Many survivors are no fault: buffers that are too large, tolerances, orders that only cost time.
"""

import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import Queue

ROOT = Path(__file__).parents[1]
WORKERS, TIMEOUT = 2, 300
COMPARED = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
COMPUTED = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Add, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult, ast.Mod: ast.Add,
    ast.LShift: ast.RShift, ast.RShift: ast.LShift, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.BitXor: ast.BitAnd,
    ast.Pow: ast.Mult,
}  # fmt: skip


def changed(node):
    """The source of the node with one change, or None; the node is left as it is."""
    old = ast.unparse(node)
    if isinstance(node, ast.Compare) and type(node.ops[0]) in COMPARED:
        kept, node.ops[0] = node.ops[0], COMPARED[type(node.ops[0])]()
        new, node.ops[0] = ast.unparse(node), kept
    elif isinstance(node, ast.BinOp | ast.AugAssign) and type(node.op) in COMPUTED:
        kept, node.op = node.op, COMPUTED[type(node.op)]()
        new, node.op = ast.unparse(node), kept
    elif isinstance(node, ast.BoolOp):
        kept, node.op = node.op, ast.Or() if isinstance(node.op, ast.And) else ast.And()
        new, node.op = ast.unparse(node), kept
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub | ast.Invert):
        new = ast.unparse(node.operand)
    elif isinstance(node, ast.Name) and node.id in ("max", "min"):
        new = "min" if node.id == "max" else "max"
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        new = str(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        new = repr(node.value + 1 if isinstance(node.value, int) else 2.0 * node.value or 1.0)
    else:
        return None
    return None if new == old else f"({new})" if isinstance(node, ast.expr) else new


def mutants(path):
    """(line, old, new, whole text) of each."""
    text = path.read_text()
    lines = text.splitlines(keepends=True)
    starts = [0]
    for line in lines:
        starts.append(starts[-1] + len(line))
    for function in ast.parse(text).body:
        if not isinstance(function, ast.FunctionDef):
            continue
        for statement in function.body:
            for node in ast.walk(statement):
                if isinstance(node, ast.expr | ast.stmt) and (new := changed(node)) is not None:
                    low = starts[node.lineno - 1] + node.col_offset
                    high = starts[node.end_lineno - 1] + node.end_col_offset
                    yield node.lineno, text[low:high], new, text[:low] + new + text[high:]


def dependents(module):
    """The files that have this one's kernels compiled into theirs, in whose caches a change is not seen."""
    found, left = set(), [module]
    while left:
        name = left.pop()
        found.add(name)
        folder, stem = name.rsplit("/", 1)
        forms = f"from oee_tabular/{name} import", f"from oee_tabular/{folder} import {stem}"
        lines = [form.replace("/", ".") for form in forms]
        for path in (ROOT / "oee_tabular").glob("**/_*.py"):
            other = str(path.relative_to(ROOT / "oee_tabular").with_suffix(""))
            if other not in found and any(line in path.read_text() for line in lines):
                left.append(other)
    return found


def run(folder, tests):
    """Whether the tests pass there; a test that crashes or does not return fails."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-x",
        "-p",
        "no:cacheprovider",
        "--hypothesis-profile=mutation",
        tests,
    ]
    environment = os.environ | threads | {"PYTHONPATH": str(folder), "CI": "true"}
    try:
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, timeout=TIMEOUT)
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def main(modules, sample=0, seed=0):
    """Run, and print what became of the mutants."""
    found = [(name, *one) for name in modules.split(",") for one in mutants(ROOT / f"oee_tabular/{name}.py")]
    total = len(found)
    if sample:
        found = random.Random(seed).sample(found, min(sample, total))
    packages = {name: name.split("/")[0] for name, *_ in found}
    with tempfile.TemporaryDirectory() as name:
        folders = Queue()
        for number in range(WORKERS):
            folder = Path(name) / str(number)
            for part in ("oee_tabular", "tests"):
                shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns("__pycache__", ".*"))
            for part in ("README.md", "pyproject.toml"):
                shutil.copy(ROOT / part, folder)
            for package in set(packages.values()):
                if not run(folder, f"tests/{package}"):  # and fills the caches
                    sys.exit(f"tests/{package} fails as it is")
            folders.put(folder)

        def killed(mutant):
            module, line, old, new, text = mutant
            folder = folders.get()
            package, kept = folder / "oee_tabular", Path(f"{folder}.kept")
            shutil.copytree(package, kept)
            (package / f"{module}.py").write_text(text)
            for one in dependents(module):
                at = package / one
                for path in (at.parent / "__pycache__").glob(f"{at.name}.*.nb*"):
                    path.unlink()
            alive = run(folder, f"tests/{packages[module]}")
            shutil.rmtree(package)
            kept.rename(package)
            folders.put(folder)
            if alive:
                print(f"{module}.py:{line}: {old!r} -> {new!r}", flush=True)
            return not alive

        with ThreadPoolExecutor(WORKERS) as pool:
            won = sum(pool.map(killed, found))
    n, z = len(found), 1.96
    share = won / n
    middle, half = share + z * z / (2 * n), z * (share * (1 - share) / n + z * z / (4 * n * n)) ** 0.5
    ends = [(middle + sign * half) / (1 + z * z / n) for sign in (-1, 1)]
    print(f"{modules}: {won} of {n} killed ({total} in all): {share:.1%} (95% interval {ends[0]:.1%} to {ends[1]:.1%})")


if __name__ == "__main__":
    main(sys.argv[1], *(int(word) for word in sys.argv[2:]))
