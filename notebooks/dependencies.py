"""The page of dependencies and licences, from the metadata of what is installed where
the site is built.
"""

import re
from importlib.metadata import PackageNotFoundError, distribution

from packaging.requirements import Requirement

HEAD = """# Dependencies

What `pip install .` brings in a clone, with what that needs in turn: the releases that were installed where this page was made,
and the licences that their metadata name. Optional ones come with the extras of `pyproject.toml`.

| package | release | licence | needed by |
| --- | --- | --- | --- |
"""


def licence(metadata):
    """The licence that a package's metadata name: an expression, a short text, or the
    classifiers' words.
    """
    words = [
        line.split(" :: ")[-1]
        for line in metadata.get_all("Classifier", [])
        if line.startswith("License ::")
    ]
    text = (metadata.get("License") or "").strip()
    short = text if text and "\n" not in text and len(text) < 80 else ""
    first = next((line.strip() for line in text.splitlines() if line.strip()), "")
    return (
        metadata.get("License-Expression")
        or short
        or ", ".join(words)
        or first[:80]
        or "not named"
    )


def needed(name, extras=()):
    """The packages that one needs here, with the extras that it asks them for."""
    for line in distribution(name).requires or ():
        requirement = Requirement(line)
        if requirement.marker is None or any(
            requirement.marker.evaluate({"extra": extra}) for extra in ("", *extras)
        ):
            yield (
                re.sub(r"[-_.]+", "-", requirement.name).lower(),
                tuple(requirement.extras),
            )


def dependencies(root="oee-tabular"):
    """{package: the packages that need it}, root and packages that are not installed
    left out.
    """
    found = {}
    waiting = [(root, ())]
    while waiting:
        parent, extras = waiting.pop()
        for name, further in needed(parent, extras):
            try:
                distribution(name)
            except PackageNotFoundError:
                continue
            if name not in found or further:
                waiting.append((name, further))
            found.setdefault(name, set()).add(parent)
    return found


def page():
    """The page, in Markdown."""
    rows = []
    for name, parents in sorted(dependencies().items()):
        metadata = distribution(name).metadata
        rows.append(
            f"| {metadata['Name']} | {metadata['Version']} | {licence(metadata)} |"
            f" {', '.join(sorted(parents))} |"
        )
    return HEAD + "\n".join(rows) + "\n"
