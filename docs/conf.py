"""Settings of the site: ``python -m sphinx -W --keep-going -b html docs target/site``."""

import os
import re
from pathlib import Path

import psfield

DOCS = Path(__file__).resolve().parent

project = "psfield"
author = "the psfield developers"
copyright = f"2026, {author}"
release = psfield.__version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
]
templates_path = ["templates"]
exclude_patterns = ["decisions/README.md", "gallery", "requirements.txt", "tutorials"]

# Names in docstrings stand in single backticks.
default_role = "py:obj"
autodoc_member_order = "bysource"
autodoc_typehints = "none"
# PyTorch is too large to be installed for the site alone.
autodoc_mock_imports = ["torch"]
toc_object_entries_show_parents = "hide"
numpydoc_show_class_members = False

myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3

sphinx_gallery_conf = {
    "examples_dirs": ["tutorials", "gallery"],
    "gallery_dirs": ["generated/tutorials", "generated/gallery"],
    # Every script is run, in the order of its name.
    "filename_pattern": "",
    "within_subsection_order": "FileNameSortKey",
    "copyfile_regex": r"(README|GALLERY_HEADER)\.(rst|txt)",
    "min_reported_time": 5,
    "remove_config_comments": True,
}

# Publishers refuse programs.
linkcheck_ignore = ["https://doi.org/"]

html_theme = "pydata_sphinx_theme"
html_title = "psfield"
html_show_sourcelink = False
html_sidebars = {page: [] for page in ("index", "start", "generated/gallery/index")}
html_theme_options = {
    "header_links_before_dropdown": 7,
    "navbar_persistent": ["search-button"],
    "navigation_with_keys": False,
    "show_prev_next": False,
}

#: Files outside of the site that a page of it includes, and that page.
INCLUDED = {
    (page.parent / name).resolve(): f"/{page.relative_to(DOCS)}"
    for page in DOCS.rglob("*.md")
    for name in re.findall(r"^```{include} (\S+)", page.read_text(encoding="utf-8"), re.M)
}


def relink(text: str, page: Path) -> str:
    """Make the links of a page lead to pages of the site. In the repository they lead to files.

    A link that shows the name of a page's file shows the title on the site.
    """

    def on_the_site(link: re.Match[str]) -> str:
        target = (page.parent / link[2]).resolve()
        if not target.exists():
            return link[0]
        name = INCLUDED.get(target, f"/{os.path.relpath(target, DOCS)}")
        name = re.sub(r"^/((?:tutorials|gallery)/\w+)\.py$", r"/generated/\1.rst", name)
        is_page = name.endswith(".md") and link[1].endswith(target.name)
        return f"[{'' if is_page else link[1]}]({name}"

    return re.sub(r"\[([^][]*)\]\((?!\w+:|/)([^)#\s]+)", on_the_site, text)


def relink_page(app, docname, source):
    """Relink a page in ``docs/``."""
    page = Path(app.env.doc2path(docname))
    if page.suffix == ".md":
        source[0] = relink(source[0], page)


def relink_included(app, path, parent, source):
    """Relink a page that another page includes."""
    source[0] = relink(source[0], DOCS / path)


def setup(app):
    """Connect the functions above."""
    app.connect("source-read", relink_page)
    app.connect("include-read", relink_included)
