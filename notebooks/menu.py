"""The site's menu: four groups, with the pages of each."""

# group -> its page -> title -> page; what is used first in front
GROUPS = {
    "learn": {
        "Getting started": "getting_started",
        "Notebooks and a syllabus": "syllabus",
        "Twelve short chapters": "course/index",
        "Assignments": "assignments",
        "Playground": "playground",
        "Gallery": "gallery",
        "Glossary": "glossary",
    },
    "use": {
        "Install": "install",
        "User guide": "guide",
        "How-to": "how_to",
        "What an interval assumes": "intervals",
        "Deciding with what you know": "deciding",
        "I have twelve trials": "trials",
        "An estimator of your own": "own_estimator",
        "FQE and DICE": "peers",
        "SCOPE-RL and offline-rl-ope": "other_libraries",
    },
    "reference": {
        "Public names": "api/index",
        "The commands": "api/commands",
        "From the paper to the code": "paper",
        "Laws": "statements",
        "Promises": "promises",
        "Benchmark": "benchmark",
    },
    "about": {
        "Release notes": "changes",
        "Citing, the paper, related packages": "citing",
        "Security": "security",
        "Dependencies": "api/dependencies",
        "Development": "development",
    },
}


def pages_below(page, below):
    """Yield a page and all that stand below it; ``below`` maps a page to its next."""
    yield page
    for child in below.get(page, ()):
        yield from pages_below(child, below)


def menu(page, below):
    """Return the four groups with their pages, for the menu of a page."""
    shown = []
    for group, pages in GROUPS.items():
        title = group.capitalize()
        overview = {f"{title}: overview": group}
        is_current = page in pages_below(group, below)
        entries = [*overview.items(), *pages.items()]
        shown.append({"title": title, "current": is_current, "pages": entries})
    return shown
