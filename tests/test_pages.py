"""The site's pages tell the truth: their commands and code run, print what they show,
and name what is there.
"""

import math
import re
import shlex
import tomllib
from pathlib import Path

import nbformat
import numpy as np
import pytest
from helpers import run_command

import oee_tabular as oee
from oee_tabular.report.columns import EXACT, FULL, P_BEST, SIMULATOR

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"
PAGES = {path.stem: path.read_text() for path in NOTEBOOKS.glob("*.md")}
CHAPTERS = {
    path.stem: path.read_text()
    for path in sorted((NOTEBOOKS / "course").glob("[0-9]*.md"))
}
BLOCK = re.compile(r"^```(sh|python|text)\n(.*?)^```", re.S | re.M)


def command(line):
    """What a line of a shell block prints; it must end well."""
    words = shlex.split(line, comments=True)
    assert words[0] == "oee", line
    assert run_command(*words[1:]) == 0, line


def run(text, capsys, **names):
    """Every block in turn, in one name space; each text must be what the last line
    before it printed, where a line of three dots stands for any lines.

    A block of Python whose first line names a file is that file.
    """
    printed = ""
    for kind, block in BLOCK.findall(text):
        if kind == "text":
            pieces = [
                piece.split() for piece in re.split(r"^\.\.\.$", block, flags=re.M)
            ]
            pattern = " (?:.* )?".join(re.escape(" ".join(words)) for words in pieces)
            shown = f"{' '.join(printed.split())} "
            assert (
                re.fullmatch(f"{pattern} ?", shown) or printed.split() == block.split()
            )
        for line in block.replace("\\\n", "").splitlines() if kind == "sh" else ():
            capsys.readouterr()
            command(line)
            printed = capsys.readouterr().out
        if named := re.match(r"# (\w+\.py)\n", block):
            Path(named[1]).write_text(block)
        elif kind == "python":
            capsys.readouterr()
            exec(compile(block, "page", "exec"), names)
            printed = capsys.readouterr().out
    return printed


def runnable(page):
    """A page's text, what is not run left out."""
    return re.sub(r"<!-- not run -->\n```.*?^```", "", PAGES[page], flags=re.S | re.M)


def sections(page):
    """Heading -> text of a page's sections."""
    parts = re.split(r"^## (.+)\n", runnable(page), flags=re.M)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def test_the_guide_prints_what_it_shows(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run(sections("guide")["From a simulator, a log and a policy to a value"], capsys)


EXTRAS = {
    "From PRISM or Storm and back": "umbi",
    "Check the corrected simulator with PRISM or Storm": "umbi",
    "Use a cluster": "distributed",
}


@pytest.mark.parametrize("heading", sections("how_to"))
def test_every_how_to_runs(heading, tmp_path, monkeypatch, capsys):
    """Each alone, from an empty folder: no recipe needs the files of another."""
    if heading in EXTRAS:
        pytest.importorskip(EXTRAS[heading])
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    text = sections("how_to")[heading]
    assert BLOCK.search(text)
    run(text, capsys)


def test_files_that_several_recipes_write_are_the_same():
    files = {}
    for _, block in BLOCK.findall(PAGES["how_to"]):
        if named := re.match(r"# (\w+\.py)\n", block):
            files.setdefault(named[1], set()).add(block)
    assert files
    assert {name for name, blocks in files.items() if len(blocks) > 1} == set()


def rendered_lines(text):
    """How many lines of 100 letters a section has; code as it stands, folded one not."""
    text = re.sub(r"<details>.*?</details>", "", text, flags=re.S)
    parts = re.split(r"^```.*\n", text, flags=re.M)
    lines = sum(len(block.splitlines()) for block in parts[1::2])
    for prose in parts[::2]:
        prose = re.sub(r"<!--.*?-->", "", re.sub(r"\]\([^)]*\)", "]", prose))
        for paragraph in re.split(r"\n\s*\n|\n(?=\||- )", prose):
            lines += math.ceil(len(" ".join(paragraph.split())) / 100)
    return lines


def test_every_recipe_is_at_most_a_screen():
    parts = re.split(r"^## (.+)\n", PAGES["how_to"], flags=re.M)
    lengths = dict(zip(parts[1::2], map(rendered_lines, parts[2::2]), strict=True))
    assert {name: lines for name, lines in lengths.items() if lines > 40} == {}


def test_every_recipe_answers_a_question_of_the_index():
    top = PAGES["how_to"].partition("\n## ")[0]
    anchors = [
        re.sub(r"[^\w -]", "", name.lower()).replace(" ", "-")
        for name in re.findall(r"^## (.+)$", PAGES["how_to"], re.M)
    ]
    linked = re.findall(r"\]\(#([\w-]+)\)", top)
    assert sorted(linked) == sorted(anchors)
    for question in (
        "How much data do I need?",
        "My log has other column names",
        "My simulator can only be sampled",
        "My robot has a delay",
        "I have twelve trials",
        "Which policy?",
    ):
        assert question in top


def test_the_page_of_an_estimator_of_one_s_own(tmp_path, monkeypatch, capsys):
    """Its first block is the file that its commands read."""
    # workers would import and load for as long as they work
    monkeypatch.setenv("LOKY_MAX_CPU_COUNT", "1")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(BLOCK.search(PAGES["own_estimator"])[2])
    run(runnable("own_estimator"), capsys)
    assert "mine:smoothed" in (tmp_path / "league" / "league.md").read_text()


@pytest.mark.parametrize(
    "page",
    [
        "peers",
        "other_libraries",
        "intervals",
        "deciding",
        "statements",
        "trials",
        "assignments",
    ],
)
def test_pages_print_what_they_show(page, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "```text" in PAGES[page]
    run(runnable(page), capsys)


@pytest.mark.filterwarnings("ignore")
def test_the_oracle_finds_what_the_page_says(capsys):
    """Where the two packages are that the script compares; they are no dependencies."""
    pytest.importorskip("mdptoolbox")
    pytest.importorskip("quantecon")
    section = PAGES["peers"].partition("## An oracle for other packages\n")[2]
    code, shown = (block for _, block in BLOCK.findall(section))
    exec(compile(code, "peers", "exec"), {})
    printed = capsys.readouterr().out.split()
    # rounding errors differ from machine to machine
    for word, expected in zip(printed, shown.split(), strict=True):
        if re.match(r"[\d.]+e-", expected):
            assert float(word) < 1e-12
        else:
            assert word == expected


@pytest.mark.filterwarnings("ignore::oee_tabular.exceptions.OeeWarning")
@pytest.mark.parametrize("chapter", CHAPTERS)
def test_chapters_print_what_they_show(chapter, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(CHAPTERS[chapter], capsys)


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_a_chapter_has_all_its_parts(chapter):
    """A theorem with its proof, code with its output, an exercise with its solution, and
    a link to the next chapter that there is.
    """
    text = CHAPTERS[chapter]
    number = int(chapter[:2])
    assert text.startswith(f"# {number}. ")
    for part in ("*Proof", "```python", "```text", "**Exercise ", "<details>"):
        assert part in text, part
    assert text.count("**Theorem") + text.count("**Lemma") >= 1
    for label in re.findall(r"\*\*(?:Theorem|Definition|Lemma|Exercise) (\d+)\.", text):
        assert int(label) == number
    following = [name for name in CHAPTERS if name.startswith(f"{number + 1:02}_")]
    assert all(f"({name}.md)" in text for name in following)


def test_the_landing_page_shows_the_command_s_answer(tmp_path, monkeypatch, capsys):
    """Its one command is the README's; the answer is the beginning of what it prints."""
    (kind, block), (_, answer) = BLOCK.findall(PAGES["index"])
    assert kind == "sh"
    line = block.strip().rpartition(" && ")[2].removeprefix(".venv/bin/")
    monkeypatch.chdir(tmp_path)
    command(line)
    printed = capsys.readouterr().out
    assert printed.split()[: len(answer.split())] == answer.split()
    assert (tmp_path / "page.html").is_file()


def test_getting_started_prints_what_it_shows(tmp_path, monkeypatch, capsys):
    """The first command needs an installation; the others run as they stand."""
    monkeypatch.chdir(tmp_path)
    first, _, rest = PAGES["getting_started"].partition("## 2.")
    assert ".venv/bin/oee evaluate" in first
    run(rest, capsys)
    assert (tmp_path / "page.html").is_file()


def test_the_glossary_has_what_a_report_shows():
    """Each column and each estimator of the first command's report, and z."""
    block = re.search(r"```{glossary}\n(.*?)```", PAGES["glossary"], re.S)[1]
    terms = {line.lower() for line in block.splitlines() if re.match(r"\S", line)}
    columns = {*FULL, "95% interval", P_BEST, SIMULATOR, EXACT, "below the top row by"}
    # what a number, a list of names and the notes are needs no entry
    known = {"interval", "estimator", "error", "note"}
    names = {"oee", "simulator", "model-based", "pdis", "wpdis", "is", "wis", "fqe"}
    for word in columns | names | {"z", "mdp", "dr", "fqe-zero", "dualdice"}:
        assert word.lower() in terms | known, word


def test_the_first_pages_say_what_oee_stands_for():
    for text in (TEXT, PAGES["getting_started"], PAGES["glossary"]):
        head = " ".join(text.partition("## 2.")[0].split())[:1500]
        assert re.search(r"[Oo]ff-environment evaluation", head)
        assert "oee" in head


def test_a_clone_is_made_where_one_is_needed():
    """The address is the reader's: no host is named."""
    contributing = (NOTEBOOKS.parent / ".github" / "CONTRIBUTING.md").read_text()
    for text in (TEXT, PAGES["getting_started"], PAGES["install"], contributing):
        assert "git clone <address of this repository> oee_tabular" in text


def test_the_page_of_installing_lists_every_extra():
    project = tomllib.loads((NOTEBOOKS.parent / "pyproject.toml").read_text())
    extras = list(project["project"]["optional-dependencies"])
    listed = re.findall(r"^\| `(\w+)` \|", PAGES["install"], re.M)
    assert sorted(listed) == sorted(extras)
    named = re.findall(r"pip install (?:-e )?[\"']\.\[([\w,]+)\]", PAGES["install"])
    assert {name for names in named for name in names.split(",")} <= set(extras)


def test_what_the_site_says_to_cite_is_what_the_readme_says():
    def entries(text):
        block = re.search(r"```bibtex\n(.*?)```", text, re.S)[1]
        return re.sub(r"\s", "", block)

    assert entries(PAGES["citing"]) == entries(TEXT)


@pytest.mark.parametrize("page", sorted(PAGES))
def test_files_and_tests_that_a_page_mentions_exist(page):
    for path, test in re.findall(
        r"`((?:tests|notebooks)/[\w/.]+)(?:::(\w+))?`", PAGES[page]
    ):
        assert (NOTEBOOKS.parent / path).exists(), path
        assert not test or f"def {test}(" in (NOTEBOOKS.parent / path).read_text(), test
    for path in re.findall(r"\]\((?!https?:|api/)([\w/.]+)(?:#[\w-]*)?\)", PAGES[page]):
        assert (NOTEBOOKS / path).exists(), path


def test_names_in_the_table_of_the_paper_exist():
    table = PAGES["paper"].split("## What the default is")[0]
    for name in re.findall(
        r"`((?:estimators|tasks|inference|exact)\.\w+|[a-z]+_[a-z_]+|[A-Z]\w+)(?![\w/.])",
        table,
    ):
        found = oee
        for part in name.split("."):
            found = getattr(found, part)


# ---- the README: its example prints what it shows, what it names is there, and it is
# one screen after another

README = NOTEBOOKS.parent / "README.md"
TEXT = README.read_text()


def test_own_arrays_print_what_the_readme_shows(capsys):
    code, shown = (
        re.search(rf"```{kind}\n(.*?)```", TEXT, re.S).group(1)
        for kind in ("python", "text")
    )
    assert len(code.splitlines()) <= 16  # two of them imports
    exec(compile(code, "README.md", "exec"), {})
    assert capsys.readouterr().out.split() == shown.split()


def test_the_readme_is_short():
    assert len(TEXT.splitlines()) <= 120
    assert max(map(len, TEXT.splitlines())) <= 120


def test_files_that_the_readme_mentions_exist():
    for path in re.findall(r"`((?:tests|notebooks)/[\w/.]+)`|\]\(([\w/.]+)\)", TEXT):
        assert (README.parent / "".join(path)).exists(), path


def test_ci_runs_the_second_command():
    line = next(line for line in TEXT.splitlines() if '-e ".[dev]"' in line)
    assert line.startswith("python3 -m venv .venv && ")
    assert "pip install --quiet -e" in (README.parent / ".ci" / "run").read_text()


COMMANDS = sorted(
    {
        " ".join(found.split())
        for found in re.findall(r"(?:`|\.venv/bin/)(oee \w[^`\n]*)", TEXT)
    }
)
# else minutes
SMALL = {
    "oee bench": " --families inventory20 --sizes 3 --seeds 1 --jobs 1 --output bench"
}


@pytest.mark.parametrize("line", COMMANDS)
def test_commands_of_the_readme_run(line, tmp_path, monkeypatch):
    """Own files and an own estimator stand for the words in capitals and for
    module:object.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    oee.FiniteMDP(np.full((2, 2, 2), 0.5), [[0, 1], [1, 0]], 0, 0.9).save("SIM.npz")
    oee.Transitions([0, 1, 1], [0, 1, 0], [1, 1, 0]).save("LOG.csv")
    np.save("POLICY.npy", [[0.5, 0.5], [1.0, 0.0]])
    (tmp_path / "own_of_readme.py").write_text(
        re.search(r"```python\n(.*?)```", PAGES["own_estimator"], re.S)[1]
    )
    own = {
        "SIM": "SIM.npz",
        "LOG": "LOG.csv",
        "POLICY": "POLICY.npy",
        "module:object": "own_of_readme:smoothed",
    }
    words = re.sub("|".join(own), lambda found: own[found[0]], line)
    command(words + SMALL.get(" ".join(line.split()[:2]), ""))


def test_every_command_of_the_readme_is_found():
    assert {line.split()[1] for line in COMMANDS} == {
        "evaluate",
        "check",
        "bench",
        "reproduce",
    }


# ---- what pages and notebooks say of things that change


def read_book(path):
    return nbformat.read(path, as_version=4)


BOOKS = {path.stem: read_book(path) for path in sorted(NOTEBOOKS.glob("[0-9]*.ipynb"))}


def prose():
    """Name -> the text of a page, or of a notebook's cells of text."""
    books = {
        name: "\n\n".join(
            cell.source for cell in book.cells if cell.cell_type == "markdown"
        )
        for name, book in BOOKS.items()
    }
    return PAGES | books


def test_lines_that_install_work_from_a_clone():
    """The package is in no index: what installs it names a folder."""
    texts = prose() | {
        path.name: path.read_text()
        for path in (NOTEBOOKS.parent / "oee_tabular").rglob("*.py")
    }
    texts["README"] = README.read_text()
    for name, text in texts.items():
        assert not re.search(r"pip install\s+['\"]?oee[-_]tabular", text), name


def test_families_are_counted_right():
    pytest.importorskip("icu_sepsis")
    number = len(oee.bench.families())
    counted = 0
    for name, text in prose().items():
        for found in re.findall(
            r"(\d+) (?:\*families of|families of environment|kinds of change)", text
        ):
            assert int(found) == number, name
            counted += 1
    assert counted >= 3


def outputs_of(cell):
    """The text that a cell of code printed, tables without their HTML."""
    return "\n".join(
        output.get("text", "") or output.get("data", {}).get("text/plain", "")
        for output in cell.get("outputs", [])
    )


def test_columns_that_a_notebook_explains_exist():
    """A list of "- **name**" or "- *name*" after a report explains what it shows."""
    checked = 0
    for name, book in BOOKS.items():
        cells = list(book.cells)
        for before, cell in zip(cells, cells[1:], strict=False):
            shown = outputs_of(before) if before.cell_type == "code" else ""
            if cell.cell_type != "markdown" or "95% interval" not in shown:
                continue
            for word in re.findall(r"^- \*{1,2}([^*]+)\*{1,2}", cell.source, re.M):
                assert word in shown, (name, word)
                checked += 1
    assert checked >= 3


def test_no_bound_that_is_printed_is_negative():
    for name, book in BOOKS.items():
        for cell in book.cells:
            assert not re.search(r"at most -", outputs_of(cell)), name
