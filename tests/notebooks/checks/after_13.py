"""What the cells of notebook 13 leave is what its text says."""

import itertools

PNG = b"\x89PNG"


def after_13_04(Choice, evaluated, sentence):
    assert "is possible" in sentence(Choice())
    assert "excludes" in sentence(Choice(n=3000))
    assert "excludes" in sentence(Choice(simulator=0.3))
    # slips lead the random policy nowhere else
    promised, *_, truth = evaluated(Choice(simulator=0.6, share=0.0))
    assert abs(promised - truth) < 1e-9
    widths = [
        upper - lower
        for _, _, lower, upper, _ in (
            evaluated(Choice(0.1, 0.1, 100)),
            evaluated(Choice(0.1, 0.1, 1000)),
            evaluated(Choice(n=300)),
            evaluated(Choice(n=300, share=1.0)),
        )
    ]
    assert widths[0] > 2 * widths[1]
    assert widths[2] > widths[3]
    hits = [evaluated(Choice(n=300, seed=seed)) for seed in range(20)]
    assert sum(lower <= truth <= upper for _, _, lower, upper, truth in hits) >= 19
    # at the ends of all sliders
    for simulator, target, n, share in itertools.product(
        (0.0, 0.6), (0.0, 0.6), (100, 5000), (0.0, 1.0)
    ):
        promised, value, lower, upper, truth = evaluated(
            Choice(simulator, target, n, share)
        )
        assert lower <= value <= upper
        assert max(promised, value, truth) < 0


def after_13_06(Choice, believed, grid, walk):
    choice = Choice()
    for mdp in (believed(choice.simulator), grid(choice.target)):
        states = walk(mdp, choice)
        assert (states[0], states[-1]) == (0, 24)


def after_13_10(
    MAX_STEPS, again, chosen, controls, panel, record, robots, values, walking, words
):
    """The controls, as a browser would move them."""
    assert len(panel.children) == 8
    before = robots.value, values.value, words.value
    assert before[0][:4] == before[1][:4] == PNG
    record.click()
    assert controls["n"].value == 200
    assert (robots.value == before[0], values.value == before[1]) == (True, False)
    assert words.value.startswith("200 transitions")
    again.click()
    assert chosen().seed == 1
    assert words.value.endswith("of 2 logs.")
    for step in (0, 3, MAX_STEPS):
        walking.value = step
        assert robots.value[:4] == PNG
    for name in ("simulator", "target", "share"):
        for end in (controls[name].min, controls[name].max):
            controls[name].value = end
            assert chosen().__dict__[name] == end
            assert values.value[:4] == PNG
    controls["n"].value = controls["n"].max
    record.click()  # there is no more
    assert controls["n"].value == controls["n"].max
