"""Writes the notices of the software that the command and the Python package contain.

    python3 .ci/third_party.py TARGET > THIRD_PARTY_NOTICES

Collects the licence files of every crate that is linked for the target, of the C sources in
fitsio-sys, and the notices of Rust's standard library.
"""

import html
import json
import re
import subprocess
import sys
from pathlib import Path

PRODUCTS = ("psfield-cli", "psfield-python")
NAME = re.compile(r"(licen[cs]e|copying|copyright|notice|unlicense)", re.IGNORECASE)
#: Files of C sources that hold their licence in their first comment.
HEADERS = {"fitsio-sys": ("ext/cfitsio/zlib/zlib.h",)}
#: Texts for crates that come without a licence file.
OWN = {"MIT": Path("LICENSE-MIT"), "Apache-2.0": Path("LICENSE-APACHE")}
RULE = "=" * 80


def output(*command):
    """Return what a command prints."""
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def linked_packages(target):
    """Return the packages from elsewhere that the products contain, sorted by name."""
    options = ("--format-version=1", "--locked", "--all-features")
    metadata = json.loads(output("cargo", "metadata", *options, "--filter-platform", target))
    packages = {package["id"]: package for package in metadata["packages"]}
    nodes = {node["id"]: node for node in metadata["resolve"]["nodes"]}
    wanted = [key for key, package in packages.items() if package["name"] in PRODUCTS]
    found = set()
    while wanted:
        key = wanted.pop()
        # Macros run in the compiler. No product contains them.
        if key not in found and not is_macro(packages[key]):
            found.add(key)
            # Kind `None`: neither a build dependency nor one of tests.
            wanted += [
                dependency["pkg"]
                for dependency in nodes[key]["deps"]
                if any(kind["kind"] is None for kind in dependency["dep_kinds"])
            ]
    others = [packages[key] for key in found if packages[key]["source"]]
    return sorted(others, key=lambda package: (package["name"], package["version"]))


def is_macro(package):
    """Return whether a package holds procedural macros."""
    return any("proc-macro" in target["kind"] for target in package["targets"])


def texts_of(package):
    """Return the texts of the licences of a package."""
    folder = Path(package["manifest_path"]).parent
    files = sorted(path for path in folder.rglob("*") if NAME.match(path.name) and path.is_file())
    texts = [path.read_text(errors="replace") for path in files if path.suffix != ".rs"]
    if not any(path.parent == folder for path in files):
        texts.append(text_without_file(package))
    for header in HEADERS.get(package["name"], ()):
        texts.append((folder / header).read_text().split("*/")[0].removeprefix("/*"))
    return texts


def text_without_file(package):
    """Return the text of the licence that the manifest of a package names."""
    named = re.split(r" OR |/", package["license"])
    licence = next(name for name in OWN if name in named)
    authors = ", ".join(package["authors"]) or f"the authors of {package['name']}"
    text = OWN[licence].read_text()
    return re.sub(r"(?m)^Copyright \(c\) .*$", lambda _: f"Copyright (c) {authors}", text)


def standard_library():
    """Return the notices of Rust's standard library, which come with the compiler as HTML."""
    folder = Path(output("rustc", "--print", "sysroot").strip()) / "share/doc/rust"
    page = (folder / "COPYRIGHT-library.html").read_text()
    page = re.sub(r"(?s)<head>.*?</head>", "", page)
    text = html.unescape(re.sub(r"<[^>]+>", "", page))
    return re.sub(r"\n\s*\n\s*\n", "\n\n", text)


def main(target):
    """Print the list of packages and each text once."""
    packages = linked_packages(target)
    users = {}
    for package in packages:
        for text in texts_of(package):
            # Copies of a licence often differ only in blanks, signs and capitals.
            words = tuple(re.findall(r"\w+", text.lower()))
            _, names = users.setdefault(words, (text.strip("\n"), []))
            names.append(f"{package['name']} {package['version']}")
    print("Software that the program psfield and the Python package psfield contain\n")
    for package in packages:
        print(f"{package['name']} {package['version']}: {package['license']}")
        print(f"    {package['repository'] or package['homepage'] or 'no address given'}")
    print("CFITSIO and zlib (in fitsio-sys), Rust's standard library")
    for text, names in users.values():
        print(f"\n{RULE}\n{', '.join(dict.fromkeys(names))}\n{RULE}\n\n{text}")
    print(f"\n{RULE}\nRust's standard library\n{RULE}\n\n{standard_library()}")


if __name__ == "__main__":
    main(sys.argv[1])
