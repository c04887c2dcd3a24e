"""How much room an installation takes, and what each extra adds to it.

python tests/benchmarks/extras.py          all of them; extras.py dask site for some

The package is installed into a new environment with the newest releases that pip finds,
and each extra in turn is added to it and removed again. Sizes are those of all files of
the packages, compiled Python included, in units of 10^6 bytes; pip and what a new
environment has by itself are subtracted.
"""

import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def megabytes(folder):
    """The size of all files below a folder."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return sum(path.stat().st_size for path in files if not path.is_symlink()) / 1e6


class Environment:
    """An environment of its own, in a folder."""

    def __init__(self, folder):
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        self.folder = Path(folder)
        self.pip = [f"{folder}/bin/python", "-m", "pip", "--disable-pip-version-check"]

    def run(self, *words):
        """What pip prints; an error where it fails."""
        done = subprocess.run(
            [*self.pip, *words], check=True, cwd=ROOT, capture_output=True, text=True
        )
        return done.stdout

    def names(self):
        """The packages that are installed."""
        lines = self.run("list", "--format=freeze").splitlines()
        return {line.partition("==")[0] for line in lines}


def main(extras):
    """A row for the package alone, and one for what each extra adds."""
    with tempfile.TemporaryDirectory() as folder:
        environment = Environment(folder)
        before = environment.names(), megabytes(environment.folder)
        environment.run("install", ".")
        alone = environment.names(), megabytes(environment.folder)
        # the package itself is not counted
        number, size = len(alone[0] - before[0]) - 1, alone[1] - before[1]
        print("| extra | packages | MB |", "| --- | --- | --- |", sep="\n")
        print(f"| none | {number} | {size:.0f} |", flush=True)
        for extra in extras or PROJECT["optional-dependencies"]:
            try:
                environment.run("install", f".[{extra}]")
            except subprocess.CalledProcessError:
                print(f"| {extra} | cannot be installed here | |", flush=True)
                continue
            added = environment.names() - alone[0]
            size = megabytes(environment.folder) - alone[1]
            print(f"| {extra} | +{len(added)} | +{size:.0f} |", flush=True)
            if added:
                environment.run("uninstall", "--yes", *sorted(added))


if __name__ == "__main__":
    main(sys.argv[1:])
