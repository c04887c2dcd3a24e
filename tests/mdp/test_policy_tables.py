"""Policies as pandas tables: labels count, their order does not."""

import numpy as np
import pandas as pd
import pytest

import oee_tabular as oee
from oee_tabular.mdp import check_policy

NAMES, ACTIONS = [f"r{s // 3}c{s % 3}" for s in range(9)], ["north", "east", "south", "west"]
MDP = oee.tasks.gridworld(3, slip=0.3).with_names(NAMES, ACTIONS)
TABLE = np.random.default_rng(0).dirichlet(np.ones(4), size=9)
CHOSEN = TABLE.argmax(axis=1)
SHUFFLED = np.random.default_rng(1).permutation(9)


def test_every_form_is_the_same_policy_in_any_order():
    wide = pd.DataFrame(TABLE, index=NAMES, columns=ACTIONS).iloc[SHUFFLED, ::-1]
    assert (check_policy(wide, MDP) == TABLE).all()
    assert (check_policy(wide.rename_axis("state").reset_index(), MDP) == TABLE).all()
    numbers = pd.DataFrame(TABLE, index=np.arange(9)).iloc[SHUFFLED]
    assert (check_policy(numbers, MDP) == TABLE).all()
    assert (check_policy(pd.DataFrame(TABLE), MDP) == TABLE).all()
    long = pd.DataFrame(
        [(NAMES[s], ACTIONS[a], TABLE[s, a]) for s in SHUFFLED for a in range(4)],
        columns=["state", "action", "probability"],
    )
    assert (check_policy(long, MDP) == TABLE).all()
    actions = pd.Series([ACTIONS[a] for a in CHOSEN], index=NAMES).iloc[SHUFFLED]
    alone = actions.rename_axis("state").rename("action").reset_index()
    for given in (actions, alone, pd.Series(CHOSEN), pd.Series(CHOSEN, index=range(9)).iloc[SHUFFLED]):
        assert (check_policy(given, MDP).argmax(axis=1) == CHOSEN).all()


@pytest.mark.parametrize(
    ("policy", "text"),
    [
        (pd.Series("north", index=["r0c0", "r0c0"]), r"policy must have a row for each state; state r0c0 has two"),
        (pd.Series("nort", index=NAMES), r"policy\['r0c0'\] must be one of the MDP's names; it is 'nort'"),
        (pd.DataFrame({"state": NAMES, "act": 0}), r"policy must have the columns state .* it has state, act and 9 rows"),
        (pd.DataFrame({"state": NAMES[:1], "action": ["north"], "probability": ["x"]}), r"must have numbers .*; it has 'x'"),
    ],
)  # fmt: skip
def test_tables_that_are_none(policy, text):
    with pytest.raises(ValueError, match=f"^{text}" if text.startswith("policy") else text):
        check_policy(policy, MDP)
