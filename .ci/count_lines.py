"""Counts the lines of code under crates/*/src: without comments, blank lines and unit tests.

    python3 .ci/count_lines.py [COMMIT]

With a commit, counts the files of that commit. Prints a line for each crate, and the sum.
"""

import re
import subprocess
import sys
from collections import Counter
from pathlib import Path


def code_lines(text: str) -> int:
    """Return the lines of a Rust file that are neither blank, nor comments, nor its module of tests."""
    # A file's unit tests are its last module, so nothing but tests follows.
    text = re.split(r"^#\[cfg\(test\)\]\n(?:pub(?:\(crate\))? )?mod \w+ \{", text, maxsplit=1, flags=re.M)[0]
    lines = (line.strip() for line in text.splitlines())
    return sum(1 for line in lines if line and not line.startswith("//"))


def is_rust(path: str) -> bool:
    """Return whether a path is Rust under crates/*/src."""
    parts = path.split("/")
    return path.endswith(".rs") and parts[0] == "crates" and parts[2] == "src"


def without_tests(texts: dict[str, str]) -> dict[str, str]:
    """Leave out the files of unit tests, which the file above them declares as modules of tests."""
    tests = set()
    for path, text in texts.items():
        at = Path(path)
        folder = at.parent if at.stem in ("mod", "lib", "main") else at.with_suffix("")
        for name in re.findall(r"^#\[cfg\(test\)\]\n(?:pub(?:\(\w+\))? )?mod (\w+);", text, flags=re.M):
            tests |= {f"{folder}/{name}.rs", f"{folder}/{name}/mod.rs"}
    return {path: text for path, text in texts.items() if path not in tests}


def files(commit: str | None) -> dict[str, str]:
    """Return the text of each file of a commit, or of the working tree."""
    if commit is None:
        listed = subprocess.run(["git", "ls-files", "-co", "--exclude-standard", "crates"], capture_output=True, text=True, check=True)
        paths = [path for path in listed.stdout.splitlines() if is_rust(path) and Path(path).exists()]
        return {path: Path(path).read_text() for path in paths}
    listed = subprocess.run(["git", "ls-tree", "-r", "--name-only", commit, "crates"], capture_output=True, text=True, check=True)
    show = lambda path: subprocess.run(["git", "show", f"{commit}:{path}"], capture_output=True, text=True, check=True).stdout
    return {path: show(path) for path in listed.stdout.splitlines() if is_rust(path)}


def main() -> None:
    counts: Counter[str] = Counter()
    for path, text in without_tests(files(sys.argv[1] if len(sys.argv) > 1 else None)).items():
        counts[path.split("/")[1]] += code_lines(text)
    for crate, lines in sorted(counts.items()):
        print(f"{lines:7} {crate}")
    print(f"{sum(counts.values()):7} in all")


main()
