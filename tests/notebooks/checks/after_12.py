"""What the cells of notebook 12 leave is what its text says."""


def after_12_07(errors):
    assert errors["tie"][1] < 1.2 * errors["counting"][3]
    assert errors["default"][0] > errors["simulator"][0]


def after_12_09(widths):
    assert all(a > b for a, b in zip(widths["default"], widths["tie"], strict=True))


def after_12_11(test):
    assert test.pvalue < 1e-10


def after_12_13(counted, found):
    assert counted in found["wear by age"]
    assert counted not in found["one wear"]


def after_12_15(errors):
    assert errors["tie by age"][3] < 0.6 * errors["simulator"][3] < errors["tie"][3]


def after_12_17(best, compared):
    assert compared.names[0] == f"from bin {best}"


def after_12_17b(decisions, gain):
    assert decisions[300].decision == "record"
    assert decisions[1000].decision == "deploy"
    assert decisions[1000].gain_lower < gain


def after_12_19(widths):
    assert widths["planned"] < widths["as recorded"]
