"""No ratio without support: what the error says."""

import numpy as np
import pytest
from scipy import sparse

from oee_tabular import FiniteMDP
from oee_tabular.ratio.support import refuse_unsupported


def test_moves_outside_the_support_in_words():
    """The four heaviest, by weight; their number and share; what leads out."""
    rows = np.zeros((6, 1, 6))
    rows[:, 0, 0] = 1.0
    simulator = FiniteMDP(rows, np.zeros(6), [1, 0, 0, 0, 0, 0], 0.9)
    counts = np.zeros((6, 6))
    counts[0], counts[1, 0] = [9, 1, 2, 3, 4, 5], 6
    with pytest.raises(ValueError, match=r"^log must stay where") as caught:
        refuse_unsupported(sparse.csr_array(counts), simulator)
    assert str(caught.value) == (
        "log must stay where the simulator has probability: it gives probability 0 to 5 different moves (15 of 30 in all), the "
        "heaviest: s=0, a=0 -> s'=5 (5); s=0, a=0 -> s'=4 (4); s=0, a=0 -> s'=3 (3); s=0, a=0 -> s'=2 (2). No ratio exists "
        "there. No action leads from 0 to 5 in the simulator, so that action noise does not help. If the target can do this, "
        "give it some probability, P[0, 0] *= 0.99; P[0, 0, 5] += 0.01; if it is a fault of the log, leave those rows out; "
        "else a mixture of simulator parameters, or states that tell such moves apart. Or: simulator.with_support_of(log, "
        'epsilon) (--impossible allow=0.01) gives every such move some; Problem(..., impossible="drop") '
        "(--impossible drop) leaves them out and has them lead anywhere"
    )
    with pytest.raises(ValueError, match=r"^target must stay where"):
        refuse_unsupported(sparse.csr_array(counts), simulator, what="target")
    counts[0, 1:] = 0
    refuse_unsupported(sparse.csr_array(counts), simulator)
