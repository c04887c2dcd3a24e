"""Pictures: functions that take arrays and draw on an ``ax``, which they return.

Colours are Okabe and Ito's, which colour-blind readers can tell apart; markers and
lines differ as well. Axes are labelled, with units.

- ``values``, ``curves``: intervals, bars and curves
- ``maps``, ``grids``: where states lie on a grid; heat maps of them
- ``paths``, ``animation``: policies and episodes on a map, in a picture and in a GIF
- ``diagram``: simulator, target, policy, log and value
- ``files``: PNG, PDF and SVG files
- ``slide_style``: slides, 1920 x 1080 pixels with large letters
- ``style``: colours, markers and lines
"""

from oee_tabular.plots.animation import animate_two
from oee_tabular.plots.curves import (
    label_ends,
    plot_curves,
    plot_errors,
    plot_variance_growth,
)
from oee_tabular.plots.diagram import schematic
from oee_tabular.plots.files import figure_files as figure_files
from oee_tabular.plots.files import figure_png, figure_svg, save_figure
from oee_tabular.plots.grids import (
    plot_coverage,
    plot_grid,
    plot_occupancy,
    plot_ratio,
)
from oee_tabular.plots.maps import Map, detect_grid, map_of
from oee_tabular.plots.paths import plot_paths, plot_policy
from oee_tabular.plots.slide_style import fit_slide as fit_slide
from oee_tabular.plots.slide_style import has_slides as has_slides
from oee_tabular.plots.slide_style import slides
from oee_tabular.plots.style import COLORS, LINES, MARKERS
from oee_tabular.plots.style import DIVERGING as DIVERGING
from oee_tabular.plots.style import INK as INK
from oee_tabular.plots.style import disable_math as disable_math
from oee_tabular.plots.style import draw_or_warn as draw_or_warn
from oee_tabular.plots.style import own_style as own_style
from oee_tabular.plots.style import series as series
from oee_tabular.plots.style import shorten as shorten
from oee_tabular.plots.values import plot_intervals, plot_states, plot_values

# what users find here; what is imported above "as" itself is for other rooms alone
__all__ = [
    "COLORS",
    "LINES",
    "MARKERS",
    "Map",
    "animate_two",
    "detect_grid",
    "figure_png",
    "figure_svg",
    "label_ends",
    "map_of",
    "plot_coverage",
    "plot_curves",
    "plot_errors",
    "plot_grid",
    "plot_intervals",
    "plot_occupancy",
    "plot_paths",
    "plot_policy",
    "plot_ratio",
    "plot_states",
    "plot_values",
    "plot_variance_growth",
    "save_figure",
    "schematic",
    "slides",
]
