"""Simulators and policies of one's own, by words and files."""

import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose

import oee_tabular as oee

OWN = '''
import gymnasium, numpy as np, oee_tabular as oee
from gymnasium import spaces

def named(slip=0.3):
    return oee.tasks.gridworld(3, slip=slip).with_names([f"r{s // 3}c{s % 3}" for s in range(9)], ["n", "e", "s", "w"])

class Corridor(gymnasium.Env):
    """Three places; forwards succeeds in 3 of 4."""

    observation_space, action_space = spaces.Discrete(3), spaces.Discrete(2)

    def __init__(self, table=True, chance=0.75):
        self.chance, self.initial_state_distrib = chance, np.array([1.0, 0.0, 0.0])
        if table:
            self.P = {s: {a: [(1.0, s, -1.0, False)] for a in (0, 1)} for s in range(3)}
            for s in (0, 1):
                self.P[s][1] = [(chance, s + 1, -1.0, s == 1), (1 - chance, s, -1.0, False)]

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = 0
        return 0, {}

    def step(self, action):
        self.place += int(action == 1 and self.np_random.random() < self.chance)
        return self.place, -1.0, self.place == 2, False, {}

if "OwnCorridor-v0" not in gymnasium.registry:
    gymnasium.register("OwnCorridor-v0", entry_point=Corridor)
number = 3

def north_then_east(place):
    return "n" if place != "r0c0" else {"e": 0.5, "n": 0.5}

def unsure(place):
    return {"n": 0.5}

def broken():
    raise KeyError("gone")
'''


@pytest.fixture(autouse=True)
def own(folder):
    (folder / "own_worlds.py").write_text(OWN)
    yield folder
    sys.modules.pop("own_worlds", None)


@pytest.mark.parametrize(
    "spec",
    [
        "own_worlds:Corridor",
        "own_worlds:OwnCorridor-v0",
        "own_worlds:Corridor,chance=0.5",
    ],
)
def test_environments_of_one_s_own(run, spec):
    run("export", spec, "--output made.npz --discount 0.9")
    chance = 0.5 if "0.5" in spec else 0.75
    made = oee.FiniteMDP.load("made.npz")
    assert made.transitions.toarray()[1, :3].tolist() == [1 - chance, chance, 0.0]
    assert made.discount == 0.9
    run("sample", spec, "--episodes 3 --output own.csv")
    assert oee.Transitions.load("own.csv").terminated.sum() == 3


def test_a_function_s_mdp_and_one_that_is_sampled(run):
    run("export own_worlds:named,slip=0.2 --output made.npz")
    made = oee.FiniteMDP.load("made.npz")
    assert made.action_names == ("n", "e", "s", "w")
    assert (
        abs(made.transitions - oee.tasks.gridworld(3, slip=0.2).transitions).max() == 0
    )
    run("export own_worlds:named --discount 0.5 --output made.npz --overwrite")
    assert oee.FiniteMDP.load("made.npz").discount == 0.5
    run(
        "export own_worlds:Corridor,table=False --output sampled.npz"
        " --samples-per-pair 400"
    )
    sampled = oee.FiniteMDP.load("sampled.npz")
    assert_allclose(sampled.transitions.toarray()[1], [0.25, 0.75, 0.0], atol=0.1)


@pytest.mark.parametrize(
    ("spec", "text"),
    [
        (
            "own_worlds:nothing",
            (
                "has no object 'nothing' (it has Corridor, broken, named,"
                " north_then_east, unsure)"
            ),
        ),
        (
            "own_worlds:number",
            (
                "or a Gymnasium environment, or a class or function that makes one;"
                " found int"
            ),
        ),
        (
            "own_worlds:broken",
            "'own_worlds:broken' cannot be made; it raises KeyError: 'gone'",
        ),
        ("own_worlds:named,slop=1", "cannot be made; it raises TypeError"),
        ("not_a_module:Thing", "module 'not_a_module' cannot be found, neither in "),
        ("own_worlds:OwnCorridor-v7", "near: OwnCorridor-v0"),
        (
            "own_worlds:Corridor,table=False",
            "export own_worlds:Corridor,table=False --samples-per-pair 100",
        ),
        ("Unheard-v0", "(your own: module:Class or module:EnvId-v0)"),
    ],
)
def test_what_is_no_simulator(run, spec, text):
    assert text in run("export", spec, "--output made.npz", code=2)


ACTIONS = oee.tasks.gridworld_expert(3).argmax(axis=1)
TABLES = {
    "words": [
        "state,action",
        *(f"r{s // 3}c{s % 3},{'nesw'[a]}" for s, a in enumerate(ACTIONS)),
    ],
    "numbers": ["action,state", *(f"{a},{s}" for s, a in enumerate(ACTIONS))],
    "wide": [
        "state,n,e,s,w",
        *(",".join(map(str, [s, *np.eye(4)[a]])) for s, a in enumerate(ACTIONS)),
    ],
    "long": [
        "state,action,probability",
        *(f"{s},{a},.75\n{s},{(a + 1) % 4},.25" for s, a in enumerate(ACTIONS)),
    ],
}


def test_policies_from_files(run, folder):
    np.save("array.npy", ACTIONS)
    np.savez("named.npz", policy=np.eye(4)[ACTIONS], other=np.zeros(3))
    for name, lines in TABLES.items():
        (folder / f"{name}.csv").write_text("\n".join(lines))
    for file in ("array.npy", "named.npz", *(f"{name}.csv" for name in TABLES)):
        run("policy sim.npz", file, "--output made.npy --overwrite")
        made = np.load("made.npy")
        assert (made.argmax(axis=1) == ACTIONS).all()
        assert_allclose(made.max(axis=1), 0.75 if file == "long.csv" else 1.0)
    said = run("policy sim.npz array.npy --output made.npy --overwrite")
    assert said == "made.npy: policy of 9 states and 4 actions\n"


@pytest.mark.parametrize(
    ("table", "text"),
    [
        (
            "state,do\nr0c0,north",
            (
                "must have the columns state and action, with probability or without,"
                " or state and one"
            ),
        ),
        ("place,action\nhere,n", "it has place, action and 1 rows"),
        ("state,action\n", "and 0 rows"),
        (
            "state,action\nr0c0,north",
            "must be one of the simulator's names; it is 'north'",
        ),
        (
            "state,action\nr0c9,n",
            (
                "row 0 (line 2): column 'state' must be one of the simulator's names; it"
                " is 'r0c9' (did you mean 'r0c"
            ),
        ),
        (
            "state,action\nr0c0,n\nr0c0,e",
            "must have one row for each state; state r0c0 has two",
        ),
        (
            "state,n,e,s,w\nr0c0,1,0,0,0\nr0c0,1,0,0,0",
            "must have one row for each state; state r0c0 has two",
        ),
        (
            "state,action\nr0c0,n",
            (
                "must have every state that is not terminal; state r0c1 is not there (7"
                " such"
            ),
        ),
        ("state,action,probability\nr0c0,n,0.4", "it sums to 0.4"),
        (
            "state,action,probability\nr0c0,n,much",
            "row 0 (line 2): column 'probability' must be a number from 0 to 1",
        ),
        (
            "state,action,probability\nr0c0,n,.5\nr0c0,n,.5",
            "one row for each state and action; state r0c0, action n has",
        ),
    ],
)
def test_tables_that_are_no_policy(run, folder, table, text):
    (folder / "pi.csv").write_text(table)
    assert text in run("policy sim.npz pi.csv --output made.npy", code=2)


def test_a_policy_that_is_a_function_of_one_s_own(run):
    run("policy sim.npz own_worlds:north_then_east --output made.npy")
    expected = np.zeros((9, 4))
    expected[:, 0] = 1.0
    expected[0] = [0.5, 0.5, 0.0, 0.0]
    assert_allclose(np.load("made.npy"), expected)
    for name, text in (
        ("unsure", "it sums to 0.5"),
        ("north", "'own_worlds' has no object 'north' (it has Corridor"),
    ):
        assert text in run(
            f"policy sim.npz own_worlds:{name} --output other.npy", code=2
        )


def test_another_start(run):
    words = (
        "evaluate --simulator sim.npz --log log.csv --estimators simulator --json"
        " --initial"
    )
    first = run(words, "r2c1")
    second = run(words, "7")
    assert first.replace('"r2c1"', '"7"') == second
    grid = oee.FiniteMDP.load("sim.npz").with_initial(7)
    assert f'"value": {oee.policy_value(grid, oee.optimal_policy(grid))!r}' in first
    assert "--initial must be one of the MDP's names; it is 'r2c7'" in run(
        words, "r2c7", code=2
    )
    assert "--initial must be in 0..8; it is 9" in run(words, "9", code=2)
