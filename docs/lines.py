#!/usr/bin/env python3
"""Counts the production lines of commits: without blank lines, comments and tests.

Usage: python3 docs/lines.py COMMIT [COMMIT ...]

Rust is formatted at 100 columns first, as rustfmt.toml says today, so that the count does not
depend on the width that a commit used. Rust, JavaScript, CSS, HTML, shell and Python count.
Documents, settings (TOML), benches, examples and scripts that measure (docs/) do not.
"""
import collections
import pathlib
import re
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).parent.parent
COMMENT = {
    ".rs": "//", ".js": "//", ".css": "/*", ".html": "<!--", ".sh": "#", ".py": "#",
}
TESTS = re.compile(r"(^|/)(tests|benches|examples|docs|\.ci)/|(^|/)(test_\w+\.py|tests\.rs)$")
TEST_MODULE = re.compile(
    r"^( *)#\[cfg\(test\)\]\n(?: *#\[.*\]\n)* *(?:pub )?mod (\w+)( \{|;)", re.M
)


def without_test_modules(text):
    """Rust without the modules that only tests have. Their end is at their own indentation."""
    while found := TEST_MODULE.search(text):
        end = found.end()
        if found[3] != ";":
            end = re.compile(rf"^{found[1]}\}}", re.M).search(text, end).end()
        text = text[: found.start()] + text[end:]
    return text


def production_lines(file):
    """Lines of one file that neither are blank nor only a comment."""
    text = file.read_text()
    if file.suffix == ".rs":
        text = without_test_modules(text)
    lines = (line.strip() for line in text.splitlines())
    return sum(1 for line in lines if line and not line.startswith(COMMENT[kind(file)]))


def kind(file):
    """Suffix of a file, or that of its interpreter."""
    if file.suffix in COMMENT or file.suffix:
        return file.suffix
    with file.open("rb") as opened:
        first = opened.readline()
    return ".sh" if first.startswith(b"#!") and b"sh" in first else ""


def count(commit, folder):
    """Production lines per directory of two levels, in a copy of `commit`."""
    archive = subprocess.run(["git", "archive", commit], cwd=ROOT, check=True, capture_output=True)
    subprocess.run(["tar", "-x", "-C", folder], input=archive.stdout, check=True)
    files = [file for file in sorted(folder.rglob("*")) if file.is_file() and not file.is_symlink()]
    files = [file for file in files if not TESTS.search(str(file.relative_to(folder)))]
    files = [file for file in files if kind(file) in COMMENT]
    rust = [str(file) for file in files if file.suffix == ".rs"]
    form = ["rustfmt", "--edition", "2024", "--config", "max_width=100,use_small_heuristics=Max"]
    subprocess.run(form + rust, check=True, capture_output=True)
    lines = collections.Counter()
    for file in files:
        place = file.relative_to(folder).parts
        lines["/".join(place[: 2 if place[0] in ("services", "deploy") else 1])] += (
            production_lines(file)
        )
    return lines


def main():
    commits = sys.argv[1:]
    if not commits:
        sys.exit(__doc__)
    counts = []
    for commit in commits:
        with tempfile.TemporaryDirectory() as folder:
            counts.append(count(commit, pathlib.Path(folder)))
    print(f"{'':24}" + "".join(f"{commit[:12]:>14}" for commit in commits))
    for place in sorted(set().union(*counts)):
        print(f"{place:24}" + "".join(f"{lines[place]:14}" for lines in counts))
    print(f"{'all':24}" + "".join(f"{lines.total():14}" for lines in counts))


if __name__ == "__main__":
    main()
