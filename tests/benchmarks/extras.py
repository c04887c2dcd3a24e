"""How much room an installation takes, and what each extra adds to it.

python tests/benchmarks/extras.py          all of them; extras.py dask site for some

Each is installed into an environment of its own with the newest releases that pip
finds. Sizes are those of all files of its packages, compiled Python included, in
units of 10^6 bytes; pip and what a new environment has by itself are subtracted.
"""

import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def megabytes(folder):
    """The size of all files below a folder."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return sum(path.stat().st_size for path in files if not path.is_symlink()) / 1e6


def install(target):
    """(megabytes, number of packages, seconds) of an installation of its own."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        pip = [f"{folder}/bin/python", "-m", "pip", "--disable-pip-version-check"]
        before = megabytes(Path(folder))
        start = time.perf_counter()
        subprocess.run([*pip, "install", "--quiet", target], check=True, cwd=ROOT)
        seconds = time.perf_counter() - start
        size = megabytes(Path(folder)) - before
        listed = subprocess.run(
            [*pip, "list", "--format=freeze"],
            check=True,
            capture_output=True,
            text=True,
        )
        names = [line.partition("==")[0] for line in listed.stdout.splitlines()]
        own = {"pip", "setuptools", "oee-tabular", "oee_tabular"}
        return size, len(set(names) - own), seconds


def main(extras):
    """A row for the package alone, and one for what each extra adds."""
    alone, packages, seconds = install(".")
    print("| extra | packages | MB | seconds |", "| --- | --- | --- | --- |", sep="\n")
    print(f"| none | {packages} | {alone:.0f} | {seconds:.0f} |", flush=True)
    for extra in extras or PROJECT["optional-dependencies"]:
        try:
            size, number, seconds = install(f".[{extra}]")
        except subprocess.CalledProcessError:
            print(f"| {extra} | cannot be installed here | | |", flush=True)
            continue
        added = f"+{number - packages} | +{size - alone:.0f}"
        print(f"| {extra} | {added} | {seconds:.0f} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
