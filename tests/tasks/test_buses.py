"""Rust's bus engines: the counts, the models, the logs, and what they show."""

import subprocess
import sys
from pathlib import Path

import bus_counts
import numpy as np
import pytest
from benchmarks import buses as study
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats

import oee_tabular as oee
from oee_tabular.estimators import ModelBased, OffEnvironment
from oee_tabular.exceptions import ArgumentError
from oee_tabular.inference import compare_policies
from oee_tabular.ratio import Tied
from oee_tabular.tasks import BusEngines, bus_engines, named_task

ROOT = Path(__file__).parents[2]
MONTHS = {1: 360, 2: 192, 3: 3312, 4: 4292}
REPLACED = {1: 0, 2: 0, 3: 27, 4: 33}
# months in which the mileage grew by 0, 1 and 2 bins
INCREMENTS = {
    1: [71, 284, 5],
    2: [75, 115, 2],
    3: [1036, 2245, 31],
    4: [1710, 2527, 55],
}
GROUPS = st.integers(1, 4)
BUSES = bus_engines()


def increments_of(log):
    """Return how many bins the mileage grew by in each month."""
    return log.next_state - np.where(log.action == 1, 0, log.state)


def test_the_shipped_counts_are_those_of_the_original_file():
    original = bus_counts.find_original()
    if original is None:
        pytest.skip("econirl is not installed")
    lines = bus_counts.HERE.read_text(encoding="utf-8").splitlines()
    rows = [tuple(map(int, line.split(","))) for line in lines if line[0].isdigit()]
    assert rows == bus_counts.count_months(original)


def test_the_script_counts_months_that_have_a_successor(tmp_path):
    """Two buses of one group; the second one was not recorded in its month 3."""
    months = [(1, 1, 0, 0), (1, 2, 1, 1), (1, 3, 0, 0), (1, 4, 0, 0)]
    months += [(2, 1, 5, 0), (2, 2, 5, 0), (2, 4, 7, 0)]
    lines = ["bus_id,period,mileage,mileage_bin,replaced,group"]
    lines += [f"{bus},{month},0.5,{bin},{new},3" for bus, month, bin, new in months]
    path = tmp_path / "buses.csv"
    path.write_text("\n".join(lines))
    assert bus_counts.count_months(path) == [
        (3, 0, 0, 0, 1),
        (3, 0, 0, 1, 1),
        (3, 1, 1, 0, 1),
        (3, 5, 0, 5, 1),
    ]


def test_the_script_needs_the_original_file():
    if bus_counts.find_original() is not None:
        pytest.skip("econirl is installed")
    ended = subprocess.run(
        [sys.executable, ROOT / "tests" / "bus_counts.py"],
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 1
    assert "give the path of rust_bus_original.csv" in ended.stderr


def test_the_file_says_where_it_is_from_and_under_which_licence():
    header = "\n".join(bus_counts.read_header())
    for text in ("Rust", "1987", "econirl 0.1.1", "MIT License", "bus_counts.py"):
        assert text in header


@pytest.mark.parametrize("group", MONTHS)
def test_the_log_is_all_recorded_months(group):
    log = bus_engines(target_group=group).log
    assert len(log) == MONTHS[group]
    assert log.action.sum() == REPLACED[group]
    counts = np.bincount(increments_of(log), minlength=3)
    assert counts.tolist() == INCREMENTS[group]


def test_replacements_are_followed_by_bin_0():
    """All but one, in which the next month is in bin 1: not as in the model."""
    following = np.concatenate(
        [
            log.next_state[log.action == 1]
            for log in (bus_engines(target_group=g).log for g in MONTHS)
        ]
    )
    assert np.bincount(following).tolist() == [59, 1]


@given(real=GROUPS, simulated=GROUPS, state=st.integers(0, 89))
def test_a_model_has_the_increments_of_its_group(real, simulated, state):
    buses = bus_engines(simulator_group=simulated, target_group=real)
    for mdp, group in ((buses.simulator, simulated), (buses.target, real)):
        shares = np.array(INCREMENTS[group]) / MONTHS[group]
        rows = mdp.transitions[[2 * state, 2 * state + 1]].toarray()
        for row, start in zip(rows, (state, 0), strict=True):
            expected = np.zeros(90)
            np.add.at(expected, np.minimum(start + np.arange(3), 89), shares)
            assert_allclose(row, expected, rtol=1e-14, atol=1e-16)
        assert_allclose(mdp.rewards[state], [-0.002293 * state, -2.55], rtol=1e-14)
        assert mdp.initial[0] == 1.0
        # any group's target stays in the support of any other
        oee.true_ratio(buses.target, buses.simulator)


def test_the_values():
    """Check the values by a sum over months that has no code of the package."""
    for mdp, value in ((BUSES.simulator, -7.64), (BUSES.target, -7.19)):
        group = 3 if mdp is BUSES.simulator else 4
        shares = np.array(INCREMENTS[group]) / MONTHS[group]
        now = np.eye(1, 90)[0]
        total = 0.0
        for month in range(4000):
            new = now[60:].sum()
            costs = 0.002293 * (now[:60] @ np.arange(60)) + 2.55 * new
            total -= 0.99**month * costs
            base = now.copy()
            base[60:] = 0.0
            base[0] += new
            now = sum(
                p * np.append(np.zeros(k), base)[:90] for k, p in enumerate(shares)
            )
        assert_allclose(oee.policy_value(mdp, BUSES.policy), total, rtol=1e-10)
        assert round(total, 2) == value


def test_the_policy_and_how_engines_were_replaced():
    assert BUSES.policy[:60, 1].sum() == 0
    assert BUSES.policy[60:, 0].sum() == 0
    log = BUSES.log
    overall = 33 / 4292
    for state in (0, 41, 60, 89):
        here = log.state == state
        share = (log.action[here].sum() + overall) / (here.sum() + 1)
        assert_allclose(BUSES.data_policy[state, 1], share)
    assert_allclose(BUSES.data_policy.sum(axis=1), 1.0)


def test_the_keys_of_the_tie():
    """Entries with one key are one increment, apart from those of the last bin."""
    matrix = BUSES.simulator.transitions.tocoo()
    start = np.where(matrix.row % 2 == 1, 0, matrix.row // 2)
    is_free = start < 88
    assert_array_equal(BUSES.tie[is_free], (matrix.col - start)[is_free])
    last = {
        (int(s), int(t)): int(key)
        for s, t, key in zip(
            start[~is_free], matrix.col[~is_free], BUSES.tie[~is_free], strict=True
        )
    }
    assert last == {(88, 88): 0, (88, 89): 3, (89, 89): 4}
    # the ratio of a tie on all recorded months is that of the two groups' shares
    zeta = Tied(BUSES.tie, strength=0.0).fit(BUSES.log, BUSES.simulator)
    shares = {g: np.array(INCREMENTS[g]) / MONTHS[g] for g in (3, 4)}
    assert_allclose(zeta.values.data[:3], shares[4] / shares[3], rtol=1e-6)


@settings(deadline=None, max_examples=20)
@given(group=GROUPS, n=st.integers(1, 192), seed=st.integers(0, 2**32))
def test_months_that_are_drawn(group, n, seed):
    whole = bus_engines(target_group=group)
    one = bus_engines(n, seed=seed, target_group=group)
    again = bus_engines(n, seed=seed, target_group=group)
    assert len(one.log) == n
    assert_array_equal(one.log.state, again.log.state)
    # without replacement: no transition more often than it was recorded
    left = whole.log.counts(90, 2) - one.log.counts(90, 2)
    assert left.toarray().min() >= 0
    other = bus_engines(n, seed=seed, source="target", target_group=group)
    assert len(other.log) == n
    pairs = whole.log.counts(90, 2).sum(axis=1)
    assert (pairs[other.log.state * 2 + other.log.action] > 0).all()


def test_all_recorded_months_are_a_draw_of_their_number():
    drawn = bus_engines(4292, seed=5).log
    counts = [log.counts(90, 2).toarray() for log in (drawn, BUSES.log)]
    assert_array_equal(*counts)
    with pytest.raises(ArgumentError, match="n_months must be at most 4292"):
        bus_engines(4293, seed=5)


def test_the_result_is_checked():
    with pytest.raises(ValueError, match="policy"):
        BusEngines(
            BUSES.simulator,
            BUSES.target,
            BUSES.policy[0],
            BUSES.log,
            BUSES.data_policy,
            BUSES.tie,
        )


def test_the_name_of_the_command():
    task = named_task("bus_engines")
    assert_array_equal(task.mdp.transitions.data, BUSES.simulator.transitions.data)
    assert_array_equal(task.expert(), BUSES.policy)
    for spec in ("bus_engines:4", "bus_engines:group=4"):
        other = named_task(spec, discount=0.9).mdp
        assert_array_equal(other.transitions.data, BUSES.target.transitions.data)
        assert other.discount == 0.9


def errors_of(estimator, n_months, n_draws):
    """Return the errors of an estimator on as many draws of recorded months."""
    truth = oee.policy_value(BUSES.target, BUSES.policy)
    errors = []
    for k in range(n_draws):
        log = BUSES.log.draw(n_months, seed=[n_months, k])
        problem = oee.Problem(BUSES.simulator, log)
        errors.append(estimator(problem, BUSES.policy, seed=0).value - truth)
    return np.array(errors)


@pytest.mark.filterwarnings("ignore")
def test_a_tie_needs_a_tenth_of_the_months_that_counting_needs():
    """The small twin of ``python tests/benchmarks/buses.py``."""
    counting = ModelBased(fallback="simulator")
    tied = OffEnvironment(ratio=Tied(BUSES.tie))
    rmse = {
        name: np.sqrt(np.mean(errors_of(estimator, n, 12) ** 2))
        for name, estimator, n in (
            ("tied at 30", tied, 30),
            ("counting at 300", counting, 300),
            ("default at 30", OffEnvironment(), 30),
        )
    }
    simulator = abs(
        oee.policy_value(BUSES.simulator, BUSES.policy)
        - oee.policy_value(BUSES.target, BUSES.policy)
    )
    assert rmse["tied at 30"] < 0.5 * rmse["counting at 300"]
    # the default does harm here: it is farther off than the simulator
    assert rmse["default at 30"] > simulator


def by_age(state, action, following):
    """Return keys of the increment and 20 bins of the engine's age."""
    start = np.where(action == 1, 0, state)
    return following - start + 3 * (start // 20)


def test_the_months_reject_one_wear_and_not_wear_by_age():
    problem = oee.Problem(BUSES.simulator, BUSES.log)
    counted = ModelBased(fallback="simulator")(problem, BUSES.policy).value
    ends = {
        name: oee.interval(problem, BUSES.policy, tie=tie)
        for name, tie in (("none", None), ("one", BUSES.tie), ("age", by_age))
    }
    found = {name: (round(i.lower, 2), round(i.upper, 2)) for name, i in ends.items()}
    assert found == {
        "none": (-7.51, -7.29),
        "one": (-7.28, -7.11),
        "age": (-7.49, -7.27),
    }
    assert round(counted, 2) == -7.42
    tied = OffEnvironment(ratio=Tied(by_age))(problem, BUSES.policy).value
    assert round(tied, 2) == -7.38
    start = np.where(BUSES.log.action == 1, 0, BUSES.log.state)
    age = np.minimum(start // 20, 3)
    grown = increments_of(BUSES.log)
    table = [np.bincount(grown[age == k], minlength=3) for k in range(4)]
    found = stats.chi2_contingency(table)
    assert (round(found.statistic), found.dof) == (111, 6)


def test_the_best_bin_of_the_simulator_is_better_in_the_months():
    assert oee.optimal_policy(BUSES.simulator)[:, 1].argmax() == 43
    assert oee.optimal_policy(BUSES.target)[:, 1].argmax() == 41
    other = (np.arange(90) >= 43).astype(int)
    problem = oee.Problem(BUSES.simulator, BUSES.log)
    compared = compare_policies(problem, {"43": other, "60": BUSES.policy})
    assert compared.names[0] == "43"
    assert_allclose(compared.values[0] - compared.values[1], 0.53, atol=0.005)
    ends = (compared.lower[1, 0], compared.upper[1, 0])
    assert_allclose(ends, (-0.65, -0.40), atol=0.006)


def test_the_league_marks_them_as_real():
    found = oee.bench.run("oee", families="rust_buses", sizes=3, seeds=3)
    assert set(found.league["families"]) == {"real"}
    assert str(found).startswith("real families")
    family = oee.bench.families()["rust_buses"]
    assert_array_equal(family.target.transitions.data, BUSES.target.transitions.data)
    # a user's own family of that name is not known to be measured
    mine = oee.bench.run("oee", families={"rust_buses": family}, sizes=3, seeds=1)
    assert set(mine.league["families"]) == {"held"}


def test_the_study_runs(capsys, monkeypatch):
    """The small twin of the study."""
    monkeypatch.setattr(study, "SIZES", (30,))
    monkeypatch.setattr(sys, "argv", ["buses.py", "3"])
    study.main()
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "{'target': -7.194, 'counted': -7.417}"
    assert [line.split()[1] for line in lines[1::2]] == [
        *("simulator", "counting", "default", "tie", "by")
    ]


def test_the_study_of_decisions_runs(capsys, monkeypatch):
    monkeypatch.setattr(study, "DECISION_SIZES", (100, 1000))
    monkeypatch.setattr(sys, "argv", ["buses.py", "2", "improve"])
    study.main()
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:3] for line in lines] == [
        ["100", "deploys", "in"],
        ["1000", "deploys", "in"],
    ]
    assert "0 are worse" in lines[1]
