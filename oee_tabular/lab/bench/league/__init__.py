"""League of the estimators, from the rows of a run.

The rows give numbers of each cell (family x size x estimator), and the cells give the
league. A cell's reference is max(min(RMSE of maximum likelihood, RMSE of the
simulator), eff / 2) on the same logs, with eff = sqrt(efficiency bound / n). A ratio
is *surely* above 1.1 where the 5% quantile of its paired bootstrap over the seeds is.
No estimator can know the reference, and none can reach it everywhere; ``floor`` says
how near a rule can come that sees the value alone (``best_rule``).

==============  ========================================================================
file            what is in it
==============  ========================================================================
``rows``        the columns that a run's rows must have
``cells``       numbers of each cell: ratios, their bootstrap, intervals
``best_rule``   the floor
``summary``     a row for each estimator and kind of families, and its errors
``league``      ``League``, and ``league_of``, which makes it of rows
``labels``      what estimators are called
``texts``       what is printed, the page, the LaTeX table
``pictures``    profile, sizes, heat map
``files``       all of these as bytes, by name
==============  ========================================================================
"""

from oee_tabular.lab.bench.league.best_rule import ERRORS as ERRORS
from oee_tabular.lab.bench.league.best_rule import LEAST as LEAST
from oee_tabular.lab.bench.league.best_rule import floor as floor
from oee_tabular.lab.bench.league.files import league_files as league_files
from oee_tabular.lab.bench.league.labels import LIKELIHOOD as LIKELIHOOD
from oee_tabular.lab.bench.league.labels import SIMULATOR as SIMULATOR
from oee_tabular.lab.bench.league.labels import check_labels as check_labels
from oee_tabular.lab.bench.league.labels import labels_of as labels_of
from oee_tabular.lab.bench.league.league import League, league_of
from oee_tabular.lab.bench.league.summary import FAR as FAR
from oee_tabular.lab.bench.league.summary import NEAR as NEAR
from oee_tabular.lab.bench.league.summary import SURE_RATIO as SURE_RATIO
from oee_tabular.lab.bench.league.summary import geometric_mean as geometric_mean
from oee_tabular.lab.bench.league.summary import league_of_cells as league_of_cells
from oee_tabular.lab.bench.league.texts import EXPLAINED as EXPLAINED

# what users find here; what is imported above "as" itself is for other files alone
__all__ = ["League", "league_of"]
