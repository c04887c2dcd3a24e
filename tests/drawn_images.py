"""The site's schematic is stored as the SVG that ``plots.schematic`` draws.

PYTHONPATH=. python tests/drawn_images.py          draws it and stores it again
"""

import re
from pathlib import Path

from oee_tabular import plots

SCHEMATIC = Path(__file__).parents[1] / "notebooks" / "images" / "schematic.svg"
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


def comparable(text):
    """A drawing without ids, which matplotlib makes of random letters, and with numbers
    that its releases round alike.
    """
    plain = re.sub(r'\s?(id|xlink:href|clip-path)="[^"]*"', "", text)
    return re.sub(r"-?\d+\.\d+", lambda number: f"{float(number[0]):.1f}", plain)


if __name__ == "__main__":
    SCHEMATIC.write_text(schematic())
