"""Values of options: a text that is a file's name as a whole, and values that the
command does not use.
"""

import json
import os
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

import oee_tabular as oee

SHORT = "--simulator sim.npz --log log.csv --quick --json"


def values(run, *words):
    """The policies and their values."""
    made = json.loads(run("evaluate", SHORT, *words))
    return {
        row["policy"]: row["value"]
        for row in made["results"]
        if row["estimator"] == "oee"
    }


@pytest.fixture
def policies(folder):
    """Two policies in files, and their values."""
    for name, action in (("a", 0), ("b", 2)):
        np.save(f"{name}.npy", np.eye(4)[np.full(9, action)])
    return folder


@pytest.mark.parametrize("name", ["best=b.npy", "lr=0.1/b.npy", "x=y=b.npy", "=b.npy"])
def test_a_file_of_the_whole_text_is_the_policy(run, policies, name):
    (policies / name).parent.mkdir(exist_ok=True)
    (policies / name).write_bytes((policies / "b.npy").read_bytes())
    (policies / "b.npy").unlink()
    (expected,) = values(run, f"--policy m=./{name}").values()
    assert values(run, f"--policy {name}") == {name: expected}
    assert values(run, f"--policy m={name} --policy m2=a.npy")["m"] == expected


def test_two_files_that_may_be_meant_are_both_named(run, policies):
    (policies / "best=a.npy").write_bytes((policies / "b.npy").read_bytes())
    said = run("evaluate", SHORT, "--policy best=a.npy", code=2)
    assert "--policy must be clear; 'best=a.npy' and 'a.npy' are files" in said
    both = values(run, "--policy best=./a.npy --policy other=best=a.npy")
    assert both["best"] == values(run, "--policy a.npy")["a.npy"]
    assert both["other"] == values(run, "--policy b.npy")["b.npy"]


def test_a_file_that_is_not_there_is_named_whole(run, policies):
    (policies / "lr=0.1").mkdir()
    said = run("evaluate", SHORT, "--policy lr=0.1/nope.npy", code=2)
    assert "no such file: lr=0.1/nope.npy" in said
    said = run("evaluate", SHORT, "--policy best=0.2/nope.npy", code=2)
    assert "no such file: 0.2/nope.npy" in said


def test_settings_are_no_files(run, folder):
    words = "plan --simulator sim.npz --log log.csv --transitions 9 --policy uniform"
    words = f"{words} --plan-option model=simulator --json"
    expected = run(words)
    (folder / "model=simulator").touch()
    (folder / "simulator").touch()
    assert run(words) == expected


def test_a_page_in_a_folder_whose_name_has_a_sign(run, folder):
    (folder / "lr=0.1").mkdir()
    run("evaluate", SHORT, "--policy uniform --report lr=0.1/page.html")
    run("evaluate", SHORT, "--policy uniform --report Title=page.html")
    assert "Title" in (folder / "page.html").read_text()
    assert (folder / "lr=0.1" / "page.html").is_file()
    (folder / "0.1").mkdir()
    said = run("evaluate", SHORT, "--policy uniform --report lr=0.1/page.html", code=2)
    assert "--report must be clear; 'lr=0.1/page.html' and '0.1/page.html'" in said


@pytest.mark.parametrize(
    ("name", "spec"),
    [
        ("mix:0.5.npy", "--policy {}"),
        ("json:dumps.npy", "--policy {}"),
        ("a,b.npy", "--policy {}"),
        ("mix:0.5.npy", "--policy a.npy --behavior {}"),
        ("b=a.npy", "--policy a.npy --behavior {}"),
    ],
)
def test_names_of_policies_that_look_like_words(run, policies, name, spec):
    (policies / name).write_bytes((policies / "a.npy").read_bytes())
    (expected,) = values(run, "--policy a.npy").values()
    assert next(iter(values(run, spec.format(name)).values())) == expected


@pytest.mark.parametrize("name", ["json:sim.npz", "gridworld:3.npz", "a=b,c.npz"])
def test_names_of_simulators_that_look_like_words(run, folder, name):
    (folder / name).write_bytes((folder / "sim.npz").read_bytes())
    assert "9 states" in run("info", name)
    run(f"evaluate --simulator {name} --log log.csv --quick --estimators oee")


@pytest.mark.parametrize("name", ["log[1].csv", "lo*.csv", "a=b.csv", "minari:x,y.csv"])
def test_names_of_logs_that_look_like_patterns(run, folder, name):
    expected = oee.Transitions.load("log.csv").describe()
    (folder / "log1.csv").write_text("no log")
    (folder / name).write_bytes((folder / "log.csv").read_bytes())
    assert expected in run("info", f"'{name}'")
    run(f"counts '{name}' --output counts.npz")


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("--action-noise=-0.1", "--action-noise must be in [0, 1]; it is -0.1"),
        ("--action-noise=nan", "--action-noise must be in [0, 1]; it is nan"),
        ("--policy mix:2", "--policy must be mix:WEIGHT with a weight in [0, 1]"),
        ("--policy mix:nan", "--policy must be mix:WEIGHT with a weight in [0, 1]"),
        ("--behavior mix:-1", "--behavior must be mix:WEIGHT"),
        ("--quick --box 0.5,2", "--quick must be left out with --box"),
        ("--quick --box 3,2", "--box must be LOWER,UPPER"),
        ("--unrecorded 0.5", "--unrecorded must be in [1, inf]; it is 0.5"),
        ("--unrecorded nan", "--unrecorded must be in [1, inf]; it is nan"),
        ("--unrecorded 3x", "--unrecorded must be a number from 1 to inf; it is '3x'"),
        ("--interval-seconds 0", "--interval-seconds must be a number of seconds"),
        ("--interval-seconds inf", "--interval-seconds must be a number of seconds"),
        ("--quick --unrecorded inf", "--quick must be left out with --unrecorded inf"),
        ("--quick --interval-seconds 2", "--quick must be left out with --interval-s"),
        ("--quick --horizon 0 --estimators oee", "--horizon must be a positive"),
    ],
)
def test_errors_name_the_option(run, folder, words, text):
    assert text in run("evaluate --simulator sim.npz --log log.csv", words, code=2)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("evaluate --quick --box 0.5", "--box must be LOWER,UPPER"),
        (
            "compare --simulator sim.npz --log log.csv --policy uniform --policy"
            " optimal --quick --box 0.5,2",
            "--quick must be left out with --box",
        ),
        (
            "compare --simulator sim.npz --log log.csv --policy uniform --policy"
            " optimal --unrecorded 0",
            "--unrecorded must be in [1, inf]; it is 0",
        ),
        (
            "evaluate --simulator cartpole --log log.csv --unrecorded 2",
            "--unrecorded must be left out for a continuous task",
        ),
        (
            "sample cartpole --episodes 1 --initial 0 --output s.npz",
            "--initial must be left out for a continuous task",
        ),
        (
            "sample cartpole --episodes 1 --discount 7 --output s.npz",
            "--discount must be left out for a continuous task",
        ),
        (
            "export gridworld:3,slip=0.3 --samples-per-pair 0 --output x.npz",
            "--samples-per-pair must be a positive integer; it is 0",
        ),
        (
            "export gridworld:3,slip=0.3 --action-noise=-1 --output x.npz",
            "--action-noise must be in [0, 1]",
        ),
        ("reproduce --list --seeds 0", "--seeds must be left out with --list"),
        ("reproduce --list --jobs 0", "--jobs must be left out with --list"),
        ("reproduce --list --dask x:1", "--dask must be left out with --list"),
        ("reproduce --list nothing", "ID must be left out with --list"),
    ],
)
def test_values_that_are_not_used_are_refused(run, folder, words, text):
    assert text in run(words, code=2)
    assert not {"s.npz", "x.npz"} & {path.name for path in folder.iterdir()}


@pytest.fixture
def foreign(policies):
    """The name of a policy's file that is no UTF-8; some systems have no such names."""
    name = os.fsdecode(b"q\xff.npy")
    try:
        (policies / name).write_bytes((policies / "a.npy").read_bytes())
    except OSError:
        pytest.skip("file names are text here")
    return name


@pytest.mark.parametrize("option", ["{}", "p\udcff=a.npy", "half=./{}"])
def test_names_of_policies_that_are_no_text_are_escaped(run, foreign, option):
    words = f"--policy {option.format(foreign)}"
    asked = "evaluate --simulator sim.npz --log log.csv --quick --estimators oee"
    run(asked, words, "--output out --report page.html")
    label = "half" if option.startswith("half") else f"{option[0]}\\udcff"
    label = label.replace("{", "q")
    for file in ("out/table.csv", "page.html"):
        assert label in Path(file).read_text()
    table = json.loads(Path("out/report.json").read_text())
    assert label in table["results"][0]["policy"]


def test_commands_take_policies_whose_names_are_no_text(run, foreign):
    data = "--simulator sim.npz --log log.csv"
    run("compare", data, f"--quick --json --policy {foreign} --policy b.npy")
    run("plan", data, f"--policy {foreign} --minus {foreign} --transitions 9 --json")
    words = f"--running b.npy --candidate {foreign} --report page.html"
    with suppress(AssertionError):  # 3, where nothing is to be deployed
        run("improve", data, words)
    assert "q\\udcff.npy" in Path("page.html").read_text()
    run("policy sim.npz", foreign, "--output c.npy")


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("--guaranteed --quick", "--guaranteed must be left out with --quick: the two"),
        ("--quick --guaranteed", "--guaranteed must be left out with --quick: the two"),
        ("--raw --normalized", "--normalized must be left out with --raw: the two"),
        ("--raw --normalized --raw", "--normalized must be left out with --raw"),
        ("--quick --quick", "--quick must be given once; it is given 2 times"),
        ("--json --json --json", "--json must be given once; it is given 3 times"),
        ("--seed 1 --seed 2", "--seed must be given once; it is given 2 times"),
        ("--output ''", "--output must name a file or a folder; it is ''"),
        ("--features ''", "--features must name a file or a folder; it is ''"),
        ("--report ''", "path of the report must be text, not empty"),
        ("--seed 1.5", "Invalid value for '--seed'"),
        ("--seed 1.5", "'1.5'"),
        ("--seed=-1", "-1"),
        ("--confidence 95%", "'95%'"),
        ("--horizon ''", "''"),
    ],
)
def test_errors_of_words_say_what_was_given(run, folder, words, text):
    asked = "evaluate --simulator sim.npz --log log.csv"
    assert text in run(asked, words, code=2)


@pytest.mark.parametrize("number", ["1e3", "many", "9" * 5000])
def test_numbers_that_are_none_are_shown_in_short(run, folder, number):
    said = run("plan --simulator sim.npz --log log.csv --transitions", number, code=2)
    assert number[:50] in said
    assert len(said) < 1000


@pytest.mark.parametrize(
    "words",
    [
        "gridworld:3,slip=0.3 --output x.npz",
        "recycling_robot --output x.npz",
        "sim.npz --output x.npz",
        "own_model:make --output x.npz",
        "cartpole --output x.npz",
    ],
)
def test_samples_are_for_environments_that_are_stepped(run, folder, words):
    (folder / "own_model.py").write_text(
        "import oee_tabular as oee\nmake = oee.tasks.gridworld(3, slip=0.3)\n"
    )
    said = run("export", words, "--samples-per-pair 3", code=2)
    name = words.partition(" ")[0]
    assert f"--samples-per-pair must be left out for '{name}', " in said
    assert "it is for an environment that is stepped); it is 3" in said


@pytest.mark.parametrize("option", ["--transitions", "--episodes"])
@pytest.mark.parametrize("simulator", ["sim.npz", "cartpole", "FrozenLake-v1"])
def test_a_log_that_memory_does_not_hold_is_named_as_given(
    run, folder, simulator, option
):
    number = 99999999999999
    said = run("sample", simulator, option, number, "--output l.csv", code=2)
    assert f"{option} must be small enough for this machine's memory; {number}" in said


def test_advice_fits_the_command(run, folder):
    words = "sample sim.npz --transitions 9 --task-option state=1 --output l.csv"
    said = run(words, code=2)
    assert "(oee sample cartpole:gravity=10); 'sim.npz' is none" in said
    words = "evaluate --simulator sim.npz --log log.csv --task-option state=1"
    assert "(--simulator cartpole:gravity=10)" in run(words, code=2)


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="only Linux has it")
@pytest.mark.parametrize(
    "words",
    ["policy sim.npz uniform", "export sim.npz", "counts log.csv"],
)
def test_a_file_in_a_folder_that_takes_none_cannot_be_written(run, folder, words):
    ending = ".npy" if "policy" in words else ".npz"
    said = run(words, f"--output /proc/x{ending}", code=2)
    assert f"/proc/x{ending}: cannot be written" in said


@pytest.mark.parametrize("words", ["reproduce --smoke fig1a", "bench", "evaluate"])
def test_a_folder_below_a_file_is_refused_before_the_work(run, folder, words):
    said = run(words, "--output sim.npz/x", code=2)
    assert "--output must be a folder that can be written; 'sim.npz' is a file" in said
