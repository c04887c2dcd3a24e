"""No ratio without support: the error's text."""

import numpy as np
import pytest
from scipy import sparse

from oee_tabular import FiniteMDP
from oee_tabular.ratio.support import refuse_unsupported


def test_moves_outside_the_support_in_words():
    """The four most frequent; their number and share; the remedies."""
    rows = np.zeros((6, 1, 6))
    rows[:, 0, 0] = 1.0
    simulator = FiniteMDP(rows, np.zeros(6), [1, 0, 0, 0, 0, 0], 0.9)
    counts = np.zeros((6, 6))
    counts[0], counts[1, 0] = [9, 1, 2, 3, 4, 5], 6
    with pytest.raises(ValueError, match=r"^log must stay in") as caught:
        refuse_unsupported(sparse.csr_array(counts), simulator)
    assert str(caught.value) == (
        "log must stay in the simulator's support: the simulator gives probability 0 to 5 of its transitions (15 of 30 with "
        "repetitions): s=0, a=0 -> s'=5 (5); s=0, a=0 -> s'=4 (4); s=0, a=0 -> s'=3 (3); s=0, a=0 -> s'=2 (2), .... "
        "No action leads from 0 to 5 in the simulator, so action noise does not help. Fix one of these: (1) if the target can "
        "do this, give it probability: P[0, 0] *= 0.99; P[0, 0, 5] += 0.01; (2) if the log is wrong, remove these transitions "
        "from it; (3) simulator.with_support_of(log, epsilon) (--impossible allow=0.01) gives each of them some probability; "
        '(4) Problem(..., impossible="drop") (--impossible drop) leaves them out, and intervals let them lead anywhere; '
        "(5) use a mixture of simulator parameters, or states that distinguish such transitions"
    )
    with pytest.raises(ValueError, match=r"^target must stay in"):
        refuse_unsupported(sparse.csr_array(counts), simulator, what="target")
    counts[0, 1:] = 0
    refuse_unsupported(sparse.csr_array(counts), simulator)
