#!/usr/bin/env python3
"""Checks the table in core/README.md that ties the paper's symbols to the code, in both directions.

The table has the columns symbol | equation | variable | function | file. Every variable and function must occur in the
row's file (a path below core/), every equation must be tagged there in a comment, as in [SBC Eq. 10], and every
equation tagged anywhere in core must be in the table. A tag may name several: [SBC Eq. 8, 9], [SBC Eq. 7 to 10].
"""
import re

import house

COLUMNS = ["symbol", "equation", "variable", "function", "file"]
TAG = re.compile(r"\[SBC\b[^\]]*?\bEqs?\.\s*([^\]]*)\]")
NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(?:::[A-Za-z_][A-Za-z0-9_]*)*")


def equations(text):
    """The numbers of all equations tagged in a text."""
    numbers = set()
    for tag in TAG.findall(text):
        for first, last in re.findall(r"(\d+)(?:\s*(?:to|-|–)\s*(\d+))?", tag.split(";")[0]):
            numbers |= set(range(int(first), int(last or first) + 1))
    return numbers


def comments(text):
    return "\n".join(re.findall(r"//[^\n]*|/\*.*?\*/", text, re.DOTALL))


def cells(line):
    # A bar inside a formula is written \| in Markdown.
    return [c.replace("\\|", "|").strip() for c in re.split(r"(?<!\\)\|", line.strip().strip("|"))]


def table(readme):
    """The rows below the header with our columns, as dictionaries, and None where there is no such header."""
    lines = readme.splitlines()
    for i, line in enumerate(lines):
        if line.lstrip().startswith("|") and [c.lower() for c in cells(line)] == COLUMNS:
            rows = []
            for row in lines[i + 2:]:
                if not row.lstrip().startswith("|"):
                    break
                rows.append(dict(zip(COLUMNS, cells(row))))
            return rows
    return None


def check(root):
    core = root / "core"
    readme = core / "README.md"
    if not readme.is_file():
        return ["core/README.md is missing"]
    rows = table(readme.read_text())
    if not rows:
        return [f"core/README.md has no table with the columns {' | '.join(COLUMNS)}"]
    violations, listed = [], set()
    for row in rows:
        where = f"core/README.md, row {row['symbol']}"
        missing = [c for c in COLUMNS if c not in row]
        if missing:
            violations.append(f"{where}: has no {', '.join(missing)}")
            continue
        listed |= equations(row["equation"])
        files = [core / f.removeprefix("core/") for f in re.findall(r"[\w./]+\.\w+", row["file"])]
        absent = [f for f in files if not f.is_file()]
        if absent or not files:
            violations.append(f"{where}: no such file: {row['file']}")
            continue
        text = "\n".join(f.read_text() for f in files)
        for column in ("variable", "function"):
            for name in NAME.findall(row[column]):
                # A qualified name is declared without its qualifier inside the class or namespace.
                if not re.search(rf"\b{re.escape(name.split('::')[-1])}\b", text):
                    violations.append(f"{where}: {column} {name} does not occur in {row['file']}")
        for number in sorted(equations(row["equation"]) - equations(comments(text))):
            violations.append(f"{where}: no comment in {row['file']} is tagged [SBC Eq. {number}]")
    for path in house.sources(core):
        for number in sorted(equations(path.read_text()) - listed):
            violations.append(f"{path.relative_to(root)}: [SBC Eq. {number}] is not in core/README.md")
    return violations


def self_test():
    header = "# Core\n\n| Symbol | Equation | Variable | Function | File |\n|---|---|---|---|---|\n"
    code = "// the projection [SBC Eq. 8, 9]\nRow project(const Moments& moments);\n"

    def violates(row, files=None):
        return len(house.found_in(check, {"core/README.md": header + row, **(files or {"core/estimate/p.h": code})}))

    assert violates("| M | [SBC Eq. 8], [SBC Eq. 9] | `moments` | `project` | `estimate/p.h` |\n") == 0
    assert violates("| \\|w\\| | [SBC Eq. 8 to 9] | `moments` | `Row::project` | core/estimate/p.h |\n") == 0
    assert violates("| M | [SBC Eq. 8, 9] | `moment` | `project` | `estimate/p.h` |\n") == 1
    assert violates("| M | [SBC Eq. 8, 9] | `moments` | `projected` | `estimate/p.h` |\n") == 1
    assert violates("| M | [SBC Eq. 8, 9] | `moments` | `project` | `estimate/q.h` |\n") == 1
    assert violates("| M | [SBC Eq. 8, 9, 10] | `moments` | `project` | `estimate/p.h` |\n") == 1
    assert violates("| M | [SBC Eq. 8] | `moments` | `project` | `estimate/p.h` |\n") == 1
    assert violates("| M | [SBC Eq. 8, 9] | `moments` |\n") >= 1
    untagged = {"core/estimate/p.h": code.replace("// the projection", "Row x; const char* t =")}
    assert violates("| M | [SBC Eq. 8, 9] | `moments` | `project` | `estimate/p.h` |\n", untagged) == 2
    assert house.found_in(check, {"core/README.md": "# Core\n"}) != []
    assert house.found_in(check, {"core/estimate/p.h": code}) == ["core/README.md is missing"]


if __name__ == "__main__":
    house.run(check, self_test)
