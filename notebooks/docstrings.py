"""Docstrings are plain text with formulas, not markup: what would be markup is escaped before napoleon reads it."""

import re

SECTIONS = {
    "Parameters", "Returns", "Raises", "Notes", "Examples", "Attributes", "Yields", "Warns", "See Also", "References",
}  # fmt: skip
RULE = re.compile(r"^-{3,}$")
NAMED = re.compile(r"(\*{0,2}\w+)((?: \(.*\))?)")
OUTSIDE = re.compile(r", (?![^(]*\))")  # commas that are not inside of parentheses


def plain(lines):
    """The lines for napoleon: names of attributes and parameters apart from what is said of them, the rest escaped."""
    out, section = [], ""
    for k, line in enumerate(lines):
        stripped = line.strip()
        if stripped in SECTIONS and k + 1 < len(lines) and RULE.match(lines[k + 1].strip()):
            section = stripped
            out.append(line)
        elif RULE.match(stripped) or stripped.startswith(">>>") or (section == "Examples" and stripped):
            out.append(line)
        elif section in ("Attributes", "Parameters") and (entry := entries(line)):
            last = entry.pop()
            for name, said in entry:  # all but the last: what is said goes on in the lines that follow
                out += [name, f"    {escaped(f'{said} {continued(lines, k)}'.strip())}"]
            out += [last[0], *([f"    {escaped(last[1])}"] if last[1] else [])]
        else:
            out.append(escaped(line))
    return out


def entries(line):
    """(name, what is said) of an entry ``a, b (of what) : text``; nothing of another line."""
    if not line or line[0].isspace():
        return []
    names, _, text = line.partition(" : ")
    found = [NAMED.fullmatch(part) for part in OUTSIDE.split(names)]
    if not all(found):
        return []
    return [(match[1].replace("*", r"\*"), f"{match[2].strip()} {text}".strip()) for match in found]


def continued(lines, k):
    """What the indented lines after the k-th say, in one."""
    said = []
    for line in lines[k + 1 :]:
        if not line.startswith(" "):
            break
        said.append(line.strip())
    return " ".join(said)


def escaped(line):
    """The line with what is markup in reStructuredText escaped, outside ``code``."""
    parts = re.split(r"(``[^`]+``)", line)
    return "".join(
        part if part.startswith("``") else re.sub(r"([\\*|`])|(?<=\w)_(?=\W|$)", lambda m: "\\" + m[0], part)
        for part in parts
    )
