"""What the house checks share: the layers of core, a made-up tree for self-tests, and how to report."""
import sys
import tempfile
from pathlib import Path

# Each layer includes itself and what is to its left.
LAYERS = ("base", "cage", "query", "solve", "sample", "estimate", "smooth", "bind")
SOURCES = {".h", ".hpp", ".cpp", ".cc"}


def sources(folder):
    return sorted(p for p in folder.rglob("*") if p.suffix in SOURCES)


def tree(files):
    """A temporary folder with the given files (path -> text); remove it with cleanup()."""
    holder = tempfile.TemporaryDirectory()
    for name, text in files.items():
        path = Path(holder.name) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return holder


def found_in(check, files):
    """The violations that `check` finds in a made-up tree."""
    with tree(files) as folder:
        return check(Path(folder))


def run(check, self_test):
    """The command line of a check: a folder, or --self-test."""
    if sys.argv[1:] == ["--self-test"]:
        self_test()
        print("the check finds what it must and accepts what it must")
        return
    violations = check(Path(sys.argv[1]))
    print("\n".join(violations) or "no violation")
    sys.exit(1 if violations else 0)
