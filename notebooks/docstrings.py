"""Docstrings are plain text with formulas, not markup: what would be markup is escaped
before napoleon reads it.
"""

import itertools
import re

SECTIONS = {
    "Parameters",
    "Returns",
    "Raises",
    "Notes",
    "Examples",
    "Attributes",
    "Yields",
    "Warns",
    "See Also",
    "References",
}
RULE = re.compile(r"^-{3,}$")
NAMED = re.compile(r"(\*{0,2}\w+)((?: \(.*\))?)")
CODE = re.compile(r"(``[^`]+``|(?<![\w*])\*\w+\*(?![\w*]))")  # and *emphasis* of a word
# a shorter first line of an entry is broken on purpose: it has the type, and the text
# follows
FULL = 95
OUTSIDE = re.compile(r", (?![^(]*\))")  # commas that are not inside of parentheses


def plain(lines):
    """The lines for napoleon: names of attributes and parameters apart from what is
    said of them, the rest escaped.
    """
    out = []
    section = ""
    for k, line in enumerate(lines):
        stripped = line.strip()
        if (
            stripped in SECTIONS
            and k + 1 < len(lines)
            and RULE.match(lines[k + 1].strip())
        ):
            section = stripped
            out.append(line)
        elif (
            RULE.match(stripped)
            or stripped.startswith(">>>")
            or (section == "Examples" and stripped)
        ):
            out.append(line)
        elif section in ("Attributes", "Parameters") and (entry := entries(line)):
            more = continued(lines, k)
            gap = [""] if more and " : " in line and len(line) < FULL else []
            # names that share a line share the lines that follow it
            for name, said in entry:
                out += [name, *([f"    {escaped(said)}"] if said else []), *gap]
                out += [escaped(text) for text in more if name != entry[-1][0]]
        else:
            out.append(escaped(line))
    return out


def entries(line):
    """(name, what is said) of an entry ``a, b (of what) : text``; nothing of another
    line.
    """
    if not line or line[0].isspace():
        return []
    names, _, text = line.partition(" : ")
    found = [NAMED.fullmatch(part) for part in OUTSIDE.split(names)]
    if not all(found):
        return []
    return [
        (match[1].replace("*", r"\*"), f"{match[2].strip()} {text}".strip())
        for match in found
    ]


def continued(lines, k):
    """The indented lines after the k-th."""
    return list(itertools.takewhile(lambda line: line.startswith(" "), lines[k + 1 :]))


def escaped(line):
    """The line with what is markup in reStructuredText escaped, outside ``code`` and
    *emphasis*.
    """
    parts = CODE.split(line)
    return "".join(
        (
            part
            if CODE.fullmatch(part)
            else re.sub(r"([\\*|`])|(?<=\w)_(?=\W|$)", lambda m: "\\" + m[0], part)
        )
        for part in parts
    )
