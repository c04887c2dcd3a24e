"""Drawings of the site are stored as SVG whose colours follow the page's: the schematic
that ``plots.schematic`` draws, and the pictures of the built-in example.

PYTHONPATH=. python tests/drawn_images.py          draws them and stores them again
"""

import re
from pathlib import Path

import oee_tabular as oee
from oee_tabular import plots

IMAGES = Path(__file__).parents[1] / "notebooks" / "images"
SCHEMATIC = IMAGES / "schematic.svg"
# A picture's name -> the estimators of the built-in example that it shows, and its alt
# text in the pages. ``oee evaluate --estimators ... --output`` writes it as PNG.
EXAMPLES = {
    "answer": (
        ("simulator", "oee"),
        "Three policies: what the simulator says, the estimate with its interval, the"
        " true value",
    ),
    "default": (
        (
            "simulator",
            "oee",
            "oee-product",
            "ratio-of-ratios",
            "model-based",
            "pdis",
            "wpdis",
            "oracle-product",
        ),
        "Values of three policies on the paper's grid, by eight estimators",
    ),
}
TITLE = "What is asked: the value in the target of a policy that a simulator made"
DESCRIPTION = (
    "Five boxes with arrows between them. The simulator, whose transition probabilities"
    " are known and somewhat wrong, makes the policy. The target, the real robot, whose"
    " probabilities are unknown, records the log: a few transitions by another policy."
    " Simulator and target differ, and nobody knows how. The policy is not run in the"
    " target. The simulator, corrected by the log, evaluates it. The answer is the value"
    " of the policy in the target, and the log says how sure that is: an interval."
)


def schematic():
    """The text of the schematic's file."""
    drawn = plots.figure_svg(
        plots.schematic,
        name="schematic",
        title=TITLE,
        description=DESCRIPTION,
        size=(6.4, 3.6),
    )
    return drawn + "\n"


def example(name):
    """The text of a picture's file."""
    estimators, alt = EXAMPLES[name]
    default = oee.tasks.embedded_default(seed=0, discount=0.99)
    problem = oee.Problem(
        default.simulator,
        default.log,
        horizon=default.horizon,
        episodes=default.episodes,
        behavior_policy=default.behavior_policy,
    )
    report = oee.evaluate(
        problem,
        default.policies,
        target=default.target,
        estimators=estimators,
        normalized=True,
        seed=0,
    )
    height = 1.8 + 0.27 * (len(report.rows()) + len(report.answers))
    drawn = plots.figure_svg(
        report.plot, name=name, title=alt, description=alt, size=(7.2, height)
    )
    return drawn + "\n"


def comparable(text):
    """A drawing without ids, which matplotlib makes of random letters, and with numbers
    that its releases round alike.
    """
    plain = re.sub(r'\s?(id|xlink:href|clip-path)="[^"]*"', "", text)
    return re.sub(r"-?\d+\.\d+", lambda number: f"{float(number[0]):.1f}", plain)


if __name__ == "__main__":
    SCHEMATIC.write_text(schematic())
    for drawn in EXAMPLES:
        (IMAGES / f"{drawn}.svg").write_text(example(drawn))
