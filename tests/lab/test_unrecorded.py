"""Tests of the redrawn families, and of the study of pairs that nobody recorded."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular.estimators import OffEnvironment
from oee_tabular.inference.evidence import gather
from oee_tabular.inference.profile_ascent import likelihood_ends
from oee_tabular.lab.bench import families_redrawn
from oee_tabular.lab.bench.families_unrecorded import FAULTS, families
from oee_tabular.lab.bench.sources import choose_families
from oee_tabular.lab.experiment import Stream
from oee_tabular.lab.experiments import unrecorded as study

RESULTS = Path(__file__).parents[2] / "notebooks" / "results"
EVERY = families(3)
OTHERS = families(4)
TUNED = [name for name, half in study.SPLIT.items() if half == "tuned"]


def unrecordable(family):
    """Return which pairs the recorded policy never takes."""
    return family.data_policy == 0


@pytest.mark.parametrize("name", study.SPLIT)
def test_a_kind_has_two_policies_on_models_that_are_drawn_by_the_seed(name):
    near = EVERY[name]
    far = EVERY[f"{name}_far"]
    assert near.simulator is far.simulator
    assert near.target is far.target
    assert np.array_equal(near.data_policy, far.data_policy)
    assert 20 <= near.simulator.n_states <= 120
    assert near.open_rows >= 9
    distances = [
        np.abs(family.policy - near.data_policy).sum() for family in (near, far)
    ]
    assert 0 < distances[0] < distances[1]
    assert not near.identical
    assert OTHERS[name].truth != near.truth
    assert families(3)[name].truth == near.truth
    log = near.log(50, seed=0)
    assert not unrecordable(near)[log.state, log.action].any()


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_lies_where_nobody_recorded(name):
    for every in (EVERY, OTHERS):
        for family in (every[name], every[f"{name}_far"]):
            hidden = unrecordable(family)
            time = oee.occupancy(family.target, family.policy)
            time = np.where(family.target.absorbing()[:, None], 0.0, time)
            assert 0.005 < time[hidden].sum() / time.sum() < 0.081
            moved = np.abs(
                family.target.transitions.toarray()
                - family.simulator.transitions.toarray()
            ).sum(axis=1)
            taken = family.data_policy.reshape(-1) > 0
            assert moved[~taken].mean() > moved[taken].mean()


def test_each_sort_is_divided_in_halves():
    for split in (families_redrawn.SPLIT, study.families_unrecorded.SPLIT):
        halves = list(split.values())
        assert halves.count("tuned") == halves.count("held") == len(split) / 2
    assert list(EVERY) == [
        name for kind in study.SPLIT for name in (kind, f"{kind}_far")
    ]


def test_the_bench_takes_them_by_name():
    source = "oee_tabular.lab.bench.families_unrecorded:families"
    assert choose_families(source, 0) == (source, tuple(EVERY))


@pytest.fixture(scope="module")
def rows():
    """Return the rows of the study on two small logs."""
    found = []
    for name, size in (("worn_out", 1.0), ("pig", 3.0)):
        cell = {"family": name, "size": size, "repetition": 0}
        found += [
            {**cell, **row}
            for row in study.unrecorded.run(cell, Stream("unrecorded", 0, cell))
        ]
    return pd.DataFrame(found)


def test_the_saved_rows_are_today_s(rows):
    """The twin of ``results/unrecorded``: four rows of its table are made again."""
    saved = pd.read_csv(RESULTS / "unrecorded" / "tuned" / "sample.csv")
    keys = ["family", "size", "policy"]
    ours, theirs = (
        part.sort_values(keys).reset_index(drop=True) for part in (rows, saved)
    )
    assert len(ours) == len(theirs) == 4
    for name in ("truth", "value", "se", "likelihood", "worst_3", "best_3"):
        assert_allclose(ours[name], theirs[name], rtol=1e-7, err_msg=name)
    for name in ("low_inf", "high_inf"):  # found by a search
        assert_allclose(ours[name], theirs[name], rtol=1e-3, err_msg=name)


@pytest.mark.parametrize("name", ["worn_out", "pig"])
def test_the_quoted_rule_is_the_package_s(rows, name):
    size = {"worn_out": 1.0, "pig": 3.0}[name]
    chosen = rows[(rows.family == name) & (rows["size"] == size)]
    lower, upper = study.intervals_by_rule(chosen)[study.QUOTED]
    stream = Stream("unrecorded", 0, {"family": name, "size": size, "repetition": 0})
    every = families(0)
    problem = every[name].problem(every[name].size(size), stream.generator())
    far = every[f"{name}_far"].policy
    for k, policy in enumerate((every[name].policy, far)):
        found = oee.interval(problem, policy)
        width = found.upper - found.lower
        assert_allclose(
            [found.lower, found.upper],
            [np.asarray(lower)[k], np.asarray(upper)[k]],
            atol=1e-3 * width,
        )


def test_the_parts_give_the_default_value(rows):
    values = study.values_by_rule(rows)
    assert_allclose(values["lengthened freely"], rows.value, rtol=1e-12)
    assert_allclose(values["not lengthened"], values["default"], rtol=0.5)


def test_intervals_of_larger_factors_hold_those_of_smaller_ones(rows):
    assert_allclose(rows.worst_1, rows.model, rtol=1e-9)
    assert_allclose(rows.best_1, rows.model, rtol=1e-9)
    ends = study.intervals_by_rule(rows)
    for form in ("fit {}", "fit {}, recorded", "fit {}, squares", "likelihood {}"):
        names = [form.format(f"{factor:g}") for factor in study.FACTORS]
        present = [name for name in names if name in ends]
        assert len(present) >= 5
        for small, large in zip(present, present[1:], strict=False):
            assert (ends[large][0] <= ends[small][0] + 1e-6).all()
            assert (ends[large][1] >= ends[small][1] - 1e-6).all()


def test_the_ends_of_one_unrecorded_pair_are_those_of_its_best_distributions():
    """Check a pair of three next states, with rewards 0, 1 and 2 there, by hand."""
    table = np.zeros((4, 1, 4))
    table[0, 0, 1:] = [0.2, 0.5, 0.3]
    table[[1, 2, 3], 0, [1, 2, 3]] = 1.0
    simulator = oee.FiniteMDP(table, [0.0, 0.0, 1.0, 2.0], [1, 0, 0, 0], 0.5)
    log = oee.Transitions([1], [0], [1])
    problem = oee.Problem(simulator, log)
    evidence = gather(problem, np.ones((4, 1)))
    fitted = simulator.transitions.data
    # at factor 2: at most .4, 1 and .6; at least .1, .25 and .15
    low, high = study.find_extremes(evidence, fitted, 2.0)
    assert_allclose([low, high], [0.45 + 2 * 0.15, 0.3 + 2 * 0.6])
    low, high = study.find_extremes(evidence, fitted, np.inf)
    assert_allclose([low, high], [0.0, 2.0])
    bound = study.within_factor(evidence, fitted, 2.0)
    ends = [end.value for end in likelihood_ends(bound, 0.95)]
    assert_allclose(ends, [0.75, 1.5], rtol=1e-6)


def test_factor_1_leaves_the_fit_and_no_factor_the_usual_interval():
    family = EVERY["worn_out"]
    problem = family.problem(family.size(1.0), seed=0)
    zeta = OffEnvironment().fit(problem, family.policy, np.random.default_rng(0))
    evidence = gather(problem, family.policy)
    fitted = zeta.values.data * problem.simulator.transitions.data
    at_one = study.within_factor(evidence, fitted, 1.0)
    is_open = evidence.rows.spread(evidence.n) == 0
    assert_allclose(at_one.low[is_open], at_one.high[is_open])
    assert study.within_factor(evidence, fitted, np.inf) is evidence
    usual = oee.interval(problem, family.policy, unrecorded=np.inf)
    ends = [end.value for end in likelihood_ends(evidence, 0.95)]
    assert_allclose(ends, [usual.lower, usual.upper])


def test_the_tables_of_a_study(rows):
    many = pd.concat([rows.assign(repetition=i) for i in range(4)], ignore_index=True)
    values = study.compare_values(many)
    assert_allclose(values.loc[("likelihood", "mean", "maximum likelihood")], 1.0)
    summary, kinds = study.compare_intervals(many)
    assert set(summary["sort"]) == {"ordinary", "fault"}
    assert summary.covers.between(0, 1).all()
    assert set(kinds.family) == {"worn_out", "pig"}
    assert "%" in study.find(many)
