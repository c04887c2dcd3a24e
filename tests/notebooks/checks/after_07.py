"""What the cells of notebook 07 leave is what its text says."""

import numpy as np


def after_07_03(found):
    assert found["delta"].width < found["likelihood"].width < found["robust"].width


def after_07_05(coverage):
    assert coverage["delta"] < 0.85 < coverage["likelihood, box"]
    assert coverage["robust, box"] == 1.0


def after_07_08(J, found):
    assert J not in found["delta"]
    assert J not in found["bootstrap"]
    assert all(J in i for name, i in found.items() if "box" in name or "1.6" in name)


def after_07_10(widths):
    assert widths["two columns silent"][-1] > 0.5 * widths["two columns silent"][1]
    assert widths["recorded everywhere"][-1] < 0.3 * widths["recorded everywhere"][1]


def after_07_12(narrow):
    assert np.isnan(narrow.width)
    assert "contradict" in narrow.status


def after_07_14(compared, se_difference):
    assert se_difference < 0.5 * compared.standard_errors[1]


def after_07_14b(report):
    assert report.uncertainty.ranking.startswith("The log cannot say")


def after_07_17(bound):
    assert (
        bound["ideal (target known)"]
        <= bound["planned in the simulator"]
        < 1.1 * bound["ideal (target known)"]
    )
    assert bound["uniform"] > 3 * bound["planned in the simulator"]


def after_07_21(plan, share):
    assert plan.unrecorded > 0
    assert 0.2 < share < 0.9


def after_07_23(found):
    assert found["+ 1000 planned"].width < 0.6 * found["+ 1000 of the same"].width


def after_07_25(se_free, se_run):
    assert se_free <= se_run


def after_07_19(found):
    for rmse, predicted in found.values():
        assert 0.75 < rmse / predicted < 1.35
