"""Models from logs that memory does not hold."""

import pytest

import oee_tabular as oee


@pytest.mark.parametrize(
    ("sizes", "name"),
    [
        ({"n_states": 3 * 10**9}, "n_states"),
        ({"n_actions": 10**10}, "n_actions"),
        ({"n_states": 10**6, "n_actions": 10**5}, "n_states"),
    ],
)
def test_a_model_beyond_memory_is_refused_before_it_is_made(sizes, name):
    log = oee.Transitions([0, 1], [0, 1], [1, 0], reward=[1.0, 2.0])
    with pytest.raises(ValueError, match=rf"^{name} must be small enough for this"):
        oee.FiniteMDP.from_log(log, 0.9, **sizes)
