"""The paper's assumptions about p, q and the box."""

import numpy as np
from numpy.testing import assert_allclose

from oee_tabular.ratio.support import check_assumptions


def test_assumptions_that_hold_and_fail():
    found = check_assumptions([1, 3, 0, 4], [2, 2, 2, 2], lower=0.5, upper=1.5)
    assert found.box_contains_one
    assert (found.inside, found.supported, found.below, found.above, found.unsupported) == (False, True, 1, 1, 0)
    assert (found.smallest, found.largest) == (0.0, 2.0)
    assert_allclose(found.renyi_infinity, np.log(2.0))
    assert check_assumptions([1, 1, 2], [1, 0, 1], lower=0.0, upper=9.0).unsupported == 1
    lost = check_assumptions([1, 1], [1, 0], lower=1.0, upper=np.inf)
    assert (lost.box_contains_one, lost.supported, lost.unsupported, lost.renyi_infinity) == (False, False, 1, np.inf)
    assert not check_assumptions([1, 1], [1, 1], lower=0.0, upper=1.0).box_contains_one
    edge = check_assumptions([1, 3], [2, 2], lower=0.5, upper=1.5)
    assert edge.inside
    assert (
        str(edge) == "nu < 1 < mu: holds; nu <= p/q <= mu: holds, p/q from 0.5 to 1.5; support: holds; D_inf = 0.4055"
    )
    assert str(lost) == (
        "nu < 1 < mu: fails; nu <= p/q <= mu: fails (1 entries below, 0 above), p/q from 0.5 to 0.5; support: fails at 1 "
        "entries; D_inf = inf"
    )
