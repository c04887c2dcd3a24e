"""Which of three policies is worth most: how often ``contest`` and the largest value are right, on families of the bench."""

from __future__ import annotations

from typing import TYPE_CHECKING

from oee_tabular.estimators import ModelBased
from oee_tabular.exact import policy_value
from oee_tabular.lab.bench.families import HELD, families
from oee_tabular.lab.findings import percent
from oee_tabular.lab.panels import Panels
from oee_tabular.lab.registry import Cell, Row, Stream, experiment
from oee_tabular.mdp import mix, uniform_policy
from oee_tabular.report import contest

if TYPE_CHECKING:
    import pandas as pd

TUNED = (
    "inventory20", "queue25", "machine", "forest12", "river_swim", "corridor30", "floor_slippery", "floor_chequered",
    "garnet_dirichlet100", "garnet_worse", "garnet_tempered", "elevator",
)  # fmt: skip


def compare_rules(table: pd.DataFrame) -> str:
    """How often each rule is right, and how often contest is wrong."""
    share = {str(rule): rows[["right", "wrong", "cannot_say"]].mean() for rule, rows in table.groupby("rule")}
    ours, oee = share["contest"], share["largest value of oee"]
    return (
        f"contest is right in {percent(ours['right'])}, cannot say in {percent(ours['cannot_say'])}, wrong in "
        f"{percent(ours['wrong'])}; the largest value of oee is wrong in {percent(oee['wrong'])}"
    )


@experiment(
    "Which policy is worth most: right, wrong, cannot say",
    axes={"family": (*TUNED, *HELD), "size": (3.0, 10.0, 30.0)}, smoke={"family": ("machine",)}, group="sureness",
    keys=("families", "size", "rule"), measures=("right", "wrong", "cannot_say"), finding=compare_rules,
    draw=Panels("right", curves="rule", x="size", xlabel="transitions per stochastic pair", ylabel="share that is right",
                by=("families",), title="{families} families", axes={"xticks": (3, 10, 30)}),
)  # fmt: skip
def ranking(settings: Cell, stream: Stream) -> list[Row]:
    """Three policies: the family's, four fifths of it, and the one that recorded the log (the rest of each is uniform).
    "contest" names the best policy or says that the log cannot tell; the others always name the one with the largest value.
    """
    family = families(int(settings["repetition"]))[str(settings["family"])]
    uniform = uniform_policy(family.simulator)
    policies = {"new": family.policy, "four fifths": mix(family.policy, uniform, 0.8), "recorded": family.data_policy}
    values = {name: policy_value(family.target, policy, horizon=family.horizon) for name, policy in policies.items()}
    best = max(values, key=values.__getitem__)
    problem = family.problem(family.size(float(settings["size"])), stream.generator())
    report = contest(problem, policies)
    shown = {result.policy: result.estimate.value for result in report.results}
    likelihood = {name: ModelBased(fallback="simulator")(problem, policy).value for name, policy in policies.items()}
    named = {"contest": report.best, "largest value of oee": max(shown, key=shown.__getitem__),
             "largest value of maximum likelihood": max(likelihood, key=likelihood.__getitem__)}  # fmt: skip
    kind = "held" if settings["family"] in HELD else "tuned"
    facts: Row = {"families": kind, "gap": values[best] - sorted(values.values())[-2]}
    return [
        {**facts, "rule": rule, "right": float(name == best), "wrong": float(name not in (best, None)),
         "cannot_say": float(name is None)}
        for rule, name in named.items()
    ]  # fmt: skip
