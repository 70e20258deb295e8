"""Compares the "uses" columns of ARCHITECTURE.md with the code: crates with the manifests, modules
of psfield and conv-core with the paths `crate::...` in their files."""

import re
import sys
import tomllib
from pathlib import Path

CRATES = Path("crates")
PAGE = Path("ARCHITECTURE.md").read_text()


def code_names(text: str) -> list[str]:
    """The names in backquotes, without remarks in parentheses."""
    return re.findall(r"`([\w-]+)`", re.sub(r"\([^)]*\)", "", text))


def rows(heading: str) -> dict[str, set[str]]:
    """The first table after a heading: for each name in the first column, the names in the second."""
    section = PAGE[PAGE.index(heading) :]
    lines = section[section.index("\n|---") :].split("\n")[2:]
    table = lines[: next(i for i, line in enumerate(lines) if not line.startswith("|"))]
    cells = [line.split("|") for line in table]
    return {name: set(code_names(row[2])) for row in cells for name in code_names(row[1])}


def crates() -> dict[str, set[str]]:
    """The crates of the workspace that each manifest names."""
    manifests = [tomllib.loads(path.read_text()) for path in CRATES.glob("*/Cargo.toml")]
    own = {manifest["package"]["name"] for manifest in manifests}
    dependencies = tomllib.loads(Path("Cargo.toml").read_text())["workspace"]["dependencies"]
    packages = {key: spec.get("package", key) for key, spec in dependencies.items() if isinstance(spec, dict)}
    return {
        manifest["package"]["name"]: {packages.get(key) for key in manifest.get("dependencies", {})} & own
        for manifest in manifests
    }


def modules(crate: str) -> dict[str, set[str]]:
    """The modules that each top-level module of a crate names, tests and comments left out."""
    source = CRATES / crate / "src"
    library = (source / "lib.rs").read_text()
    tops = set(re.findall(r"(?m)^(?:pub )?mod (\w+);", library)) - {"error"}
    home = {top: top for top in tops}
    for module, items in re.findall(r"(?m)^\s*(?:pub(?:\(crate\))? )?use (\w+)::(\{[^}]*\}|\w+);", library):
        home |= {item: module for item in re.findall(r"\w+", items) if module in tops and item not in tops}
    found: dict[str, set[str]] = {}
    for path in source.rglob("*.rs"):
        top = path.relative_to(source).parts[0].removesuffix(".rs")
        if top not in tops or path.stem == "tests":
            continue
        text = re.sub(r"//.*", "", path.read_text().split("#[cfg(test)]\nmod tests {")[0])
        used = set(re.findall(r"\bcrate::(\w+)", text))
        for items in re.findall(r"\bcrate::\{((?:[^{}]|\{[^}]*\})*)\}", text):
            used |= set(re.findall(r"(?:^|,)\s*(\w+)", re.sub(r"\{[^}]*\}", "", items)))
        found.setdefault(top, set()).update({home[name] for name in used if name in home} - {top})
    return found


def check(what: str, page: dict[str, set[str]], code: dict[str, set[str]]) -> int:
    """Prints each difference and returns their number."""
    wrong = 0
    for name in sorted(page.keys() | code.keys()):
        for used in sorted(page.get(name, set()) ^ code.get(name, set())):
            place = "only in ARCHITECTURE.md" if used in page.get(name, set()) else "missing in ARCHITECTURE.md"
            print(f"{what}: {name} -> {used}: {place}", file=sys.stderr)
            wrong += 1
    return wrong


differences = check("crates", rows("## Crates"), crates())
differences += check("psfield", rows("`psfield/src`."), modules("psfield"))
differences += check("conv-core", rows("`conv-core/src`."), modules("conv-core"))
sys.exit(differences > 0)
